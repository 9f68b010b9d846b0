"""The numbers that files hold: how they are written (plain, with a unit, uncertain, drawn), and what is possible."""

from __future__ import annotations

import contextlib
import csv
import itertools
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from pydantic_core import PydanticCustomError, core_schema

from missionsim.errors import did_you_mean
from missionsim.inputs import units
from missionsim.inputs.base import told, wrong
from missionsim.inputs.parameter import STATUSES, Distribution, Parameter
from missionsim.inputs.tree import as_written

_UNSAID = 1e5
"""Upper limits from here on only keep out nonsense; a message does not name them."""
_KEYS = ("value", "sd", "low", "high", "distribution", "unit", "status", "source", "note")
_MAX_EMPIRICAL = 100_000
DRAWN = {
    "normal": ("mean", "sd"),
    "truncated_normal": ("mean", "sd", "low", "high"),
    "lognormal": ("mean", "sd"),
    "uniform": ("low", "high"),
    "triangular": ("low", "mode", "high"),
    "discrete": ("values", "weights"),
    "empirical": ("values", "file", "column"),
}
"""Kinds of distribution, and the keys of each."""


class _Wrong(list[Mapping[str, object]]):
    """What is wrong with one quantity."""

    def tell(self, message: str, got: str, allowed: str, *at: str, hint: str = "") -> None:
        self.append({"message": message, "got": got, "allowed": allowed, "hint": hint, "at": at})

    @contextlib.contextmanager
    def at(self, *keys: str) -> Iterator[None]:
        """What is told inside is wrong below these keys."""
        try:
            yield
        except PydanticCustomError as problem:
            entries = (problem.context or {})["entries"]
            self.extend({**entry, "at": (*keys, *entry["at"])} for entry in entries)


@dataclass(frozen=True)
class QuantityOf:
    """pydantic annotation: accepts number, text with unit or mapping, gives a `Parameter`."""

    dimension: str
    """Key of `units.DIMENSIONS`; empty for any unit."""
    low: float = -math.inf
    high: float = math.inf
    """Both: allowed values, SI; with `strict_low` the low end itself is not allowed, with `strict_high` the high
    end."""
    strict_low: bool = False
    bounds: bool = False
    """low/high of the mapping are bounds of a fit, not a uniform distribution (parameters of effects)."""
    percent_slope: bool = False
    strict_high: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        fields = core_schema.plain_serializer_function_ser_schema(_serialize)
        return core_schema.with_info_plain_validator_function(self._validate, serialization=fields)

    def __get_pydantic_json_schema__(self, schema: core_schema.CoreSchema, handler: Any) -> dict[str, Any]:
        from missionsim.inputs.schemas import quantity_schema

        return quantity_schema(self)

    def allowed(self) -> str:
        """What may be written, for messages."""
        return str(units.DIMENSIONS[self.dimension]) if self.dimension else "a number, with a unit or without"

    def _validate(self, raw: Any, info: core_schema.ValidationInfo) -> Parameter:
        if isinstance(raw, Parameter):
            return raw
        issues = _Wrong()
        if isinstance(raw, Mapping):
            parameter = self._mapping(raw, issues, (info.context or {}).get("folder"))
        else:
            value, unit = self._number(raw)
            parameter = Parameter(value, unit=unit)
        if parameter is not None:
            self._check_range(parameter, raw, issues)
        if issues or parameter is None:
            raise told(issues)
        return parameter

    def _number(self, raw: Any, unit: str = "") -> tuple[float, str]:
        """SI value and unit of one number or text; `unit`: that of a plain number where any unit may stand."""
        allowed = self.allowed()
        if isinstance(raw, bool) or not isinstance(raw, (int, float, str)):
            raise wrong("not a number", as_written(raw), allowed)
        try:
            if isinstance(raw, str) and self.percent_slope and raw.rstrip().endswith("%") and (p := units.split(raw)):
                return math.atan(p[0] / 100), "rad"
            if isinstance(raw, str):
                value, given = units.parse(raw, self.dimension)
                unit = given or unit
            elif self.dimension:
                dimension = units.DIMENSIONS[self.dimension]
                value, unit = dimension.plain_to_si(float(raw)), dimension.si
            else:
                factor, unit = units.any_unit(unit) if unit else (1.0, "")
                value = float(raw) * factor
        except units.UnitError as problem:
            usual = self.dimension and problem.allowed == str(units.DIMENSIONS[self.dimension])
            allowed = allowed if usual else problem.allowed
            comma = isinstance(raw, str) and re.match(r"\s*[-+]?\d+,\d", raw)
            hint = raw.strip().replace(",", ".", 1) if comma else problem.hint
            raise wrong(problem.message, problem.got, allowed, hint=hint) from None
        except OverflowError:
            raise wrong("number too large", as_written(raw), allowed) from None
        if not math.isfinite(value):
            raise wrong("not a finite number", as_written(raw), allowed)
        return value, unit

    def _spread(self, raw: Any, value: float | None, unit: str = "") -> float:
        """Standard deviation, SI; a percentage is of the value."""
        parts = units.split(raw) if isinstance(raw, str) else None
        if isinstance(raw, str) and raw.rstrip().endswith("%") and parts:
            if value is None:
                raise wrong("a relative sd needs a value", raw, "a sd with a unit")
            spread = abs(value) * parts[0] / 100
        else:
            spread = self._number(raw, unit)[0]
            if self.dimension == "temperature" and parts and parts[1]:  # 4 K of spread are 4 degrees, not −269 °C
                spread -= units.unit_factor(parts[1], self.dimension)[1]
        if spread < 0:
            raise wrong("standard deviation below zero", as_written(raw), "0 or more")
        return spread

    def _mapping(self, raw: Mapping[str, Any], issues: _Wrong, folder: Path | None) -> Parameter | None:
        for key in raw:
            if key not in _KEYS:
                hint = did_you_mean(str(key), _KEYS)
                issues.tell(f"unknown key '{key}'", str(key), ", ".join(_KEYS), key, hint=hint)
        texts = {key: raw.get(key, "") for key in ("unit", "status", "source", "note")}
        for key, text in texts.items():
            if not isinstance(text, str):
                issues.tell(f"{key} must be text", as_written(text), "text", key)
                texts[key] = ""
        if (status := texts["status"]) and status not in STATUSES:
            hint = did_you_mean(status, STATUSES)
            issues.tell("unknown status", as_written(status), ", ".join(STATUSES), "status", hint=hint)
        unit = texts["unit"]
        if unit and self.dimension:
            issues.tell("unit belongs beside the number", as_written(unit), self.allowed(), "unit")
        before = len(issues)
        given: dict[str, float | None] = dict.fromkeys(("value", "low", "high", "sd"))
        for key in given:
            if key not in raw or (key == "sd" and len(issues) > before):
                continue
            with issues.at(key):
                found = ""
                if key != "sd":
                    given[key], found = self._number(raw[key], texts["unit"])
                else:
                    given[key] = self._spread(raw[key], given["value"], texts["unit"])
                    if isinstance(raw[key], str) and not raw[key].rstrip().endswith("%"):
                        found = self._number(raw[key])[1]
                if not self.dimension and found and unit and not units.same_dimension(found, unit):
                    told_as = f"{key} in another unit than its value"
                    raise wrong(told_as, as_written(raw[key]), f"a number in {unit}")
                unit = unit or (found if key != "sd" else "")
        distribution = None
        if "distribution" in raw and len(issues) == before:
            with issues.at("distribution"):
                distribution = self._distribution(raw["distribution"], given["value"], folder, texts["unit"])
        if unit and not self.dimension and len(issues) == before:
            with issues.at("unit"):
                unit = self._number(1.0, unit)[1]  # the numbers are SI from here on, and so is the name of their unit
        if len(issues) > before:
            return None
        value, low, high, sd = given.values()
        if low is not None and high is not None and low > high:
            got = f"{as_written(raw['low'])} > {as_written(raw['high'])}"
            issues.tell("low above high", got, "low <= high", "low")
            return None
        if value is None and distribution is not None:
            value = distribution.mean
        if value is None and low is not None and high is not None:
            value = (low + high) / 2
        if value is None:
            if not any(issue["hint"] in ("value", "low", "high", "distribution") for issue in issues):  # misspelt
                issues.tell("no value", as_written(raw), "value, low and high, or a distribution")
            return None
        near = 1e-9 * abs(value)  # 35 cm are 0.35000000000000003 m
        if (low is not None and value < low - near) or (high is not None and value > high + near):
            allowed = f"{as_written(raw.get('low'))} to {as_written(raw.get('high'))}"
            issues.tell("value outside its own low and high", as_written(raw.get("value")), allowed, "value")
        least, most = (-math.inf, math.inf) if distribution is None or "value" not in raw else distribution.ends
        if not least - near <= value <= most + near:  # a run would take what no draw is, as feet beside metres
            allowed = f"{least:g} to {most:g}, in SI" if self.dimension else f"{least:g} to {most:g}"
            issues.tell("value outside its own distribution", as_written(raw["value"]), allowed, "value")
        if distribution is None and sd is not None and sd > 0:
            floor = low if low is not None else (self.low if math.isfinite(self.low) and not self.bounds else None)
            roof = high if high is not None else (self.high if math.isfinite(self.high) and not self.bounds else None)
            cut = floor is not None or roof is not None
            distribution = Distribution("truncated_normal" if cut else "normal", value, sd, floor, roof)
        elif distribution is None and sd is None and not self.bounds and low is not None and high is not None:
            distribution = Distribution("uniform", low=low, high=high) if high > low else None
        if sd is None and distribution is not None:
            sd = distribution.sd
        unit = unit or (units.DIMENSIONS[self.dimension].si if self.dimension else "1")
        origin = (texts["status"], texts["source"], unit)
        return Parameter(value, sd, low, high, distribution, *origin, note=texts["note"])

    def _distribution(self, raw: Any, value: float | None, folder: Path | None, unit: str) -> Distribution:
        if not isinstance(raw, Mapping):
            raise wrong("a distribution is a mapping", as_written(raw), "{kind: normal, sd: …}")
        kind = raw.get("kind")
        if not isinstance(kind, str) or kind not in DRAWN:
            hint = did_you_mean(kind, DRAWN) if isinstance(kind, str) else ""
            raise wrong("unknown kind of distribution", as_written(kind), ", ".join(DRAWN), "kind", hint=hint)
        needs, issues, what = (DRAWN[kind], _Wrong(), f"{'an' if kind == 'empirical' else 'a'} {kind} distribution")
        for key in raw:
            if key != "kind" and key not in needs:
                message, allowed = f"unknown key '{key}' of {what}", ", ".join(("kind", *needs))
                issues.tell(message, str(key), allowed, key, hint=did_you_mean(str(key), needs))
        if kind in ("discrete", "empirical"):
            with issues.at():
                found = self._from_values(raw, kind, what, folder, unit)
            if issues:
                raise told(issues)
            return found
        numbers: dict[str, float | None] = {}
        for key in sorted(needs, key="sd".__eq__):  # a relative sd needs the mean
            with issues.at(key):
                if key in raw and key == "sd":
                    numbers[key] = self._spread(raw[key], numbers.get("mean"), unit)
                elif key in raw:
                    numbers[key] = self._number(raw[key], unit)[0]
                elif key in ("mean", "mode"):
                    numbers[key] = value
        optional = ("low", "high") if kind == "truncated_normal" else ()
        for key in needs if not issues else ():
            if numbers.get(key) is None and key not in optional:
                issues.tell(f"{what} needs '{key}'", as_written(raw), ", ".join(needs))
        if issues:
            raise told(issues)
        low, high, mode, mean = (numbers.get(key) for key in ("low", "high", "mode", "mean"))
        if low is not None and high is not None and low >= high:
            raise wrong("low must be below high", as_written(raw), "low < high")
        if mode is not None and low is not None and high is not None and not low <= mode <= high:
            raise wrong("mode outside low and high", as_written(mode), "low <= mode <= high")
        if kind == "lognormal" and (mean is None or mean <= 0):
            raise wrong("a lognormal distribution needs a mean above 0", as_written(mean), "> 0")
        return Distribution(kind, mean, numbers.get("sd"), low, high, mode)

    def _from_values(
        self, raw: Mapping[str, Any], kind: str, what: str, folder: Path | None, unit: str
    ) -> Distribution:
        source, file = raw.get("values"), raw.get("file")
        lines: list[int] | None = None
        if kind == "empirical" and ("file" in raw or "column" in raw):
            if source is not None:
                raise wrong("values and file together", as_written(raw), "one of them")
            source, lines = _read_column(file, raw.get("column"), folder)
        if not isinstance(source, (list, tuple)) or not source:
            raise wrong(f"{what} needs values", as_written(source), "a list of numbers", "values")
        if len(source) > _MAX_EMPIRICAL:
            raise wrong("too many values", str(len(source)), f"at most {_MAX_EMPIRICAL}")
        values: list[float] = []
        for index, item in enumerate(source):
            try:
                values.append(self._number(item, unit)[0])
            except PydanticCustomError as problem:
                entry = (problem.context or {})["entries"][0]
                if lines is None:
                    raise told([{**entry, "at": ("values", index)}]) from None
                where = f"{entry['message']}, in column '{raw['column']}' of {file}, line {lines[index]}"
                raise told([{**entry, "message": where}]) from None
        weights = raw.get("weights", [1.0] * len(values)) if kind == "discrete" else [1.0] * len(values)
        good = isinstance(weights, (list, tuple)) and len(weights) == len(values)
        good = good and all(type(item) in (int, float) and 0 <= item < 1e300 for item in weights)
        total = math.fsum(weights) if good else 0.0
        if total <= 0:
            allowed = f"{len(values)} numbers of 0 or more"
            raise wrong("weights do not fit the values", as_written(weights), allowed, "weights")
        return Distribution(kind, values=tuple(values), weights=tuple(float(item) / total for item in weights))

    def _check_range(self, parameter: Parameter, raw: Any, issues: _Wrong) -> None:
        """Nominal value and given range inside what is physically possible."""
        si = units.DIMENSIONS[self.dimension].si if self.dimension else parameter.unit
        shown = "" if si == "1" else f" {si}"
        if math.isfinite(self.low) and self.high < _UNSAID and not self.strict_low:
            allowed = f"{self.low:g} to {'less than ' * self.strict_high}{self.high:g}{shown}"
        elif math.isfinite(self.low):
            most = f", {'less than' if self.strict_high else 'at most'} {self.high:g}{shown}"
            most = most if self.high < _UNSAID else ""
            allowed = f"{'more than' if self.strict_low else 'at least'} {self.low:g}{shown}{most}"
        else:
            allowed = f"at most {self.high:g}{shown}"
        distribution = parameter.distribution
        candidates = [("value", parameter.value), ("low", parameter.low), ("high", parameter.high)]
        if distribution is not None and distribution.kind not in ("normal", "lognormal"):
            candidates += [("distribution", end) for end in distribution.ends if math.isfinite(end)]
        for key, number in candidates:
            if number is None:
                continue
            beyond = number < self.low or number > self.high
            beyond |= self.strict_low and number <= self.low and key == "value"
            drawn = key == "value" or (distribution is not None and bool(distribution.values))
            beyond |= self.strict_high and number >= self.high and drawn
            if beyond:
                given = raw.get(key, number) if isinstance(raw, Mapping) else raw
                if number > self.high >= _UNSAID and math.isfinite(self.low):
                    allowed += f", at most {self.high:g}{shown}"
                unit, size = {"fraction": ("%", 0.01), "angle": ("deg", math.pi / 180)}.get(self.dimension, ("", 0.0))
                plain = unit and isinstance(given, (int, float)) and abs(number) > 1
                hint = f"{given:g} {unit}" if plain and self.low <= number * size <= self.high else ""
                at = (key,) if isinstance(raw, Mapping) and key in raw else ()
                issues.tell("impossible value", as_written(given), allowed, *at, hint=hint)
                return


def _serialize(one: Any) -> Any:
    """What a parameter holds but its place in the file; the number where that is all."""
    if not isinstance(one, Parameter):
        return one
    given = {k: v for k, v in vars(one).items() if k not in ("note", "path", "line") and v is not None and v != ""}
    return given if given.keys() - {"value", "unit"} else one.value


def _read_column(file: Any, column: Any, folder: Path | None) -> tuple[list[Any], list[int]]:
    """Texts of a column of a CSV file, and their lines."""
    if not isinstance(file, str) or not isinstance(column, str):
        allowed = "{kind: empirical, file: values.csv, column: power_w}"
        raise wrong("an empirical distribution needs file and column", "", allowed)
    home = (folder or Path()).resolve()
    path = (home / file).resolve()
    try:
        # files of others may name any path: only what lies with them is read, and nothing that never ends
        if not path.is_relative_to(home) or not path.is_file():
            raise OSError
        with open(path, newline="", encoding="utf-8-sig") as handle:
            reader = csv.DictReader(handle)
            names = list(reader.fieldnames or ())
            filled = ((row[column], reader.line_num) for row in reader if row.get(column) not in (None, ""))
            found = list(itertools.islice(filled, _MAX_EMPIRICAL + 1)) if column in names else []
    except (OSError, UnicodeDecodeError, csv.Error, ValueError):
        raise wrong(f"cannot read {file}", file, "a CSV file beside or below this YAML file") from None
    if column not in names:
        hint = did_you_mean(column, names)
        raise wrong(f"no column '{column}' in {file}", column, ", ".join(names[:12]), "column", hint=hint)
    if not found:
        raise wrong(f"no numbers in column '{column}' of {file}", "", "one number a line")
    return [text for text, _ in found], [line for _, line in found]


@dataclass(frozen=True)
class ConditionOf(QuantityOf):
    """A free covariate: number, text with a unit, mapping, or (text that does not begin with a number) a word."""

    def _validate(self, raw: Any, info: core_schema.ValidationInfo) -> Parameter | str:  # type: ignore[override]
        if isinstance(raw, str) and units.split(raw) is None and 0 < len(raw) <= 200:
            return raw
        return super()._validate(raw, info)


Length = Annotated[Parameter, QuantityOf("length", 0.0)]
Coordinate = Annotated[Parameter, QuantityOf("length", -1e12, 1e12)]
Distance = Annotated[Parameter, QuantityOf("length", 0.0, 1e12, strict_low=True)]
Speed = Annotated[Parameter, QuantityOf("speed", 0.0, 60.0, strict_low=True)]
Acceleration = Annotated[Parameter, QuantityOf("acceleration", 1e-6, 50.0)]
Angle = Annotated[Parameter, QuantityOf("angle")]
Slope = Annotated[Parameter, QuantityOf("angle", -1.3, 1.3, percent_slope=True)]
YawRate = Annotated[Parameter, QuantityOf("yaw rate", 0.0, 30.0, strict_low=True)]
YawAcceleration = Annotated[Parameter, QuantityOf("yaw acceleration", 0.0, 1000.0, strict_low=True)]
Mass = Annotated[Parameter, QuantityOf("mass", 0.0, 1e6)]
BodyMass = Annotated[Parameter, QuantityOf("mass", 0.0, 1e6, strict_low=True)]
Power = Annotated[Parameter, QuantityOf("power", 0.0, 1e6)]
Voltage = Annotated[Parameter, QuantityOf("voltage", 0.0, 2000.0, strict_low=True)]
Resistance = Annotated[Parameter, QuantityOf("resistance", 0.0, 1e6)]
Duration = Annotated[Parameter, QuantityOf("duration", 0.0, 1e9)]
Period = Annotated[Parameter, QuantityOf("duration", 0.0, 1e9, strict_low=True)]
Frequency = Annotated[Parameter, QuantityOf("frequency", 0.0, 1e11)]
Temperature = Annotated[Parameter, QuantityOf("temperature", -90.0, 90.0)]
Fraction = Annotated[Parameter, QuantityOf("fraction", 0.0, 1.0)]
Chance = Annotated[Parameter, QuantityOf("fraction", 0.0, 1.0, strict_high=True)]
"""Of failing, each time: 1 would never succeed."""
Share = Annotated[Parameter, QuantityOf("fraction", 0.0, 1.0, strict_low=True, strict_high=True)]
Efficiency = Annotated[Parameter, QuantityOf("fraction", 0.0, 1.0, strict_low=True)]
Ratio = Annotated[Parameter, QuantityOf("number", 0.0, 100.0, strict_low=True)]
Peukert = Annotated[Parameter, QuantityOf("number", 1.0, 2.0)]
AnyNumber = Annotated[Parameter, QuantityOf("")]
Condition = Annotated[Parameter | str, ConditionOf("")]
EffectNumber = Annotated[Parameter, QuantityOf("", bounds=True)]

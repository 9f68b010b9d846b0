"""Numbers of a YAML file: with a unit, perhaps uncertain, with status and source, as `Parameter`."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

from pydantic import GetJsonSchemaHandler
from pydantic_core import PydanticCustomError, core_schema

from missionsim.errors import did_you_mean
from missionsim.spec import units
from missionsim.spec.distributions import KINDS, Distribution

STATUSES = ("published", "fitted", "assumed", "measured")
_KEYS = ("value", "sd", "low", "high", "distribution", "unit", "status", "source", "note")
_MAX_EMPIRICAL = 100_000


@dataclass(frozen=True)
class Parameter:
    """A number of a robot, environment or mission file.

    Attributes
    ----------
    value : float
        Nominal value in the SI unit `unit` (energies J, angles rad, temperatures degC).
    sd : float or None
        Standard deviation, same unit.
    low, high : float or None
        Range that was given; bounds of a fit for parameters of effects, of a uniform distribution elsewhere.
    distribution : Distribution or None
        What a Monte Carlo draws from; None for a certain number.
    status, source, note : str
        ``published``, ``fitted``, ``assumed``, ``measured`` or empty, and where the number comes from.
    unit : str
        SI unit; for parameters of effects and motion models the unit that the file names.
    path : str
        Dotted path in its file, such as ``components.laser.loads.0.power``; empty for a default.
    line : int
        1-based line in its file, 0 where there is none.
    """

    value: float
    sd: float | None = None
    low: float | None = None
    high: float | None = None
    distribution: Distribution | None = None
    status: str = ""
    source: str = ""
    unit: str = "1"
    note: str = ""
    path: str = ""
    line: int = 0

    def __float__(self) -> float:
        return self.value

    @property
    def uncertain(self) -> bool:
        """Whether a Monte Carlo varies it."""
        return self.distribution is not None

    def with_value(self, value: float) -> Parameter:
        """The same parameter at another nominal value."""
        return replace(self, value=float(value))

    def scaled(self, factor: float, unit: str) -> Parameter:
        """`factor` times the parameter, in another unit."""

        def times(number: float | None) -> float | None:
            return None if number is None else number * factor

        distribution = None if self.distribution is None else self.distribution.scaled(factor)
        return replace(
            self,
            value=self.value * factor,
            sd=times(self.sd),
            low=times(self.low),
            high=times(self.high),
            distribution=distribution,
            unit=unit,
        )


class Issue(ValueError):
    """One thing wrong inside a quantity, at a key below it."""

    def __init__(self, message: str, got: str = "", allowed: str = "", hint: str = "", at: tuple[str | int, ...] = ()):
        super().__init__(message)
        self.entry = {"message": message, "got": got, "allowed": allowed, "hint": hint, "at": at}


@dataclass(frozen=True)
class QuantityOf:
    """pydantic annotation: accepts number, text with unit or mapping, gives a `Parameter`.

    Attributes
    ----------
    dimension : str
        Key of `units.DIMENSIONS`; empty for any unit.
    low, high : float
        Allowed values, SI; with `strict_low` the low end itself is not allowed.
    bounds : bool
        low/high of the mapping are bounds of a fit, not a uniform distribution (parameters of effects).
    """

    dimension: str
    low: float = -math.inf
    high: float = math.inf
    strict_low: bool = False
    bounds: bool = False
    percent_slope: bool = False

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> core_schema.CoreSchema:
        return core_schema.with_info_plain_validator_function(
            self._validate,
            serialization=core_schema.plain_serializer_function_ser_schema(_serialize),
        )

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        plain = units.DIMENSIONS[self.dimension].plain if self.dimension else "SI"
        text = {"type": "string", "pattern": r"^\s*[-+]?(\d+(\.\d*)?|\.\d+)([eE][-+]?\d+)?\s*\S*.*$"}
        number: dict[str, Any] = {"type": "number", "description": f"in {plain}"}
        if self.dimension and not self.percent_slope:
            factor = units.plain_to_si(1.0, self.dimension)
            if math.isfinite(self.low):
                number["exclusiveMinimum" if self.strict_low else "minimum"] = self.low / factor
            if math.isfinite(self.high):
                number["maximum"] = self.high / factor
        part = {"anyOf": [{"type": "number"}, text]}
        mapping = {
            "x-quantity": "mapping",
            "description": "an uncertain number, or one with its status and source",
            "type": "object",
            "additionalProperties": False,
            "properties": {
                "value": part,
                "sd": part,
                "low": part,
                "high": part,
                "distribution": {
                    "type": "object",
                    "additionalProperties": False,
                    "required": ["kind"],
                    "properties": {
                        "kind": {"enum": list(KINDS)},
                        "mean": part,
                        "sd": part,
                        "low": part,
                        "high": part,
                        "mode": part,
                        "values": {"type": "array", "items": part},
                        "weights": {"type": "array", "items": {"type": "number", "minimum": 0}},
                        "file": {"type": "string"},
                        "column": {"type": "string"},
                    },
                },
                "unit": {"type": "string"},
                "status": {"enum": list(STATUSES)},
                "source": {"type": "string"},
                "note": {"type": "string"},
            },
        }
        what = units.allowed_text(self.dimension) if self.dimension else "a number, with a unit or without"
        return {"x-quantity": self._label(), "description": what, "anyOf": [number, text, mapping]}

    def _label(self) -> str:
        """Name of this quantity among a schema's definitions."""
        kind = "slope" if self.percent_slope else self.dimension or "any number"
        ends = [f"from {self.low:g}"] * math.isfinite(self.low) + [f"to {self.high:g}"] * math.isfinite(self.high)
        return " ".join([kind, *(["above"] if self.strict_low else []), *ends])

    def _validate(self, raw: Any, info: core_schema.ValidationInfo) -> Parameter:
        if isinstance(raw, Parameter):
            return raw
        issues: list[Issue] = []
        parameter = None
        try:
            if isinstance(raw, Mapping):
                folder = (info.context or {}).get("folder") if isinstance(info.context, dict) else None
                parameter = self._mapping(raw, issues, folder)
            else:
                value, unit = self._number(raw)
                parameter = Parameter(value, unit=unit)
            if parameter is not None:
                self._check_range(parameter, raw, issues)
        except Issue as issue:
            issues.append(issue)
        if issues or parameter is None:
            raise PydanticCustomError(
                "quantity",
                "{text}",
                {"text": "; ".join(str(issue) for issue in issues), "entries": [issue.entry for issue in issues]},
            )
        return parameter

    def _number(self, raw: Any, at: tuple[str | int, ...] = (), unit: str = "") -> tuple[float, str]:
        """SI value and unit of one number or text."""
        allowed = units.allowed_text(self.dimension) if self.dimension else "a number, with a unit or without"
        if isinstance(raw, bool) or not isinstance(raw, (int, float, str)):
            raise Issue("not a number", _shown(raw), allowed, at=at)
        try:
            if isinstance(raw, str):
                if self.percent_slope and raw.rstrip().endswith("%") and (parts := units.split(raw)):
                    return math.atan(parts[0] / 100), "rad"
                if not self.dimension:
                    value, given = units.parse_any(raw)
                    return _finite(value, raw, allowed, at), given or unit
                value = units.parse_quantity(raw, self.dimension)
            elif self.dimension:
                value = units.plain_to_si(float(raw), self.dimension)
            else:
                factor, unit = units.any_unit(unit) if unit else (1.0, "")
                value = float(raw) * factor
        except units.UnitError as problem:
            raise Issue(problem.message, problem.got, problem.allowed, problem.hint, at) from None
        except OverflowError:
            raise Issue("number too large", _shown(raw), allowed, at=at) from None
        return _finite(value, raw, allowed, at), units.DIMENSIONS[self.dimension].si if self.dimension else unit

    def _spread(self, raw: Any, value: float | None, at: tuple[str | int, ...]) -> float:
        """Standard deviation, SI; a percentage is of the value."""
        if isinstance(raw, str) and raw.rstrip().endswith("%") and (parts := units.split(raw)):
            if value is None:
                raise Issue("a relative sd needs a value", raw, "a sd with a unit", at=at)
            spread = abs(value) * parts[0] / 100
        else:
            spread = self._number(raw, at)[0]
        if spread < 0:
            raise Issue("standard deviation below zero", _shown(raw), "0 or more", at=at)
        return spread

    def _mapping(self, raw: Mapping[str, Any], issues: list[Issue], folder: Path | None) -> Parameter | None:
        for key in raw:
            if key not in _KEYS:
                issues.append(
                    Issue(f"unknown key '{key}'", str(key), ", ".join(_KEYS), did_you_mean(str(key), _KEYS), (key,))
                )
        texts = {}
        for key in ("unit", "status", "source", "note"):
            text = raw.get(key, "")
            if not isinstance(text, str):
                issues.append(Issue(f"{key} must be text", _shown(text), "text", at=(key,)))
                text = ""
            texts[key] = text
        if texts["status"] and texts["status"] not in STATUSES:
            issues.append(
                Issue(
                    "unknown status",
                    _shown(texts["status"]),
                    ", ".join(STATUSES),
                    did_you_mean(texts["status"], STATUSES),
                    ("status",),
                )
            )
        given: dict[str, float | None] = {"value": None, "low": None, "high": None, "sd": None}
        unit = texts["unit"]
        if unit and self.dimension:
            issues.append(
                Issue("unit belongs beside the number", _shown(unit), units.allowed_text(self.dimension), at=("unit",))
            )
        failed = False
        for key in ("value", "low", "high"):
            if key in raw:
                try:
                    given[key], found = self._number(raw[key], (key,), unit)
                    unit = unit or found
                except Issue as issue:
                    issues.append(issue)
                    failed = True
        if "sd" in raw and not failed:
            try:
                given["sd"] = self._spread(raw["sd"], given["value"], ("sd",))
            except Issue as issue:
                issues.append(issue)
                failed = True
        distribution = None
        if "distribution" in raw and not failed:
            distribution = self._distribution(raw["distribution"], given["value"], issues, folder)
            failed = distribution is None
        if failed:
            return None
        value, low, high, sd = given["value"], given["low"], given["high"], given["sd"]
        if low is not None and high is not None and low > high:
            issues.append(
                Issue("low above high", f"{_shown(raw['low'])} > {_shown(raw['high'])}", "low <= high", at=("low",))
            )
            return None
        if value is None and distribution is not None:
            value = distribution.mean
        if value is None and low is not None and high is not None:
            value = (low + high) / 2
        if value is None:
            issues.append(Issue("no value", _shown(raw), "value, low and high, or a distribution"))
            return None
        outside = (low is not None and value < low) or (high is not None and value > high)
        if outside:
            issues.append(
                Issue(
                    "value outside its own low and high",
                    _shown(raw.get("value")),
                    f"{_shown(raw.get('low'))} to {_shown(raw.get('high'))}",
                    at=("value",),
                )
            )
        if distribution is None:
            distribution = self._implied(value, sd, low, high)
        spread = sd if sd is not None else distribution.sd if distribution is not None else None
        default = units.DIMENSIONS[self.dimension].si if self.dimension else ""
        return Parameter(
            value,
            spread,
            low,
            high,
            distribution,
            texts["status"],
            texts["source"],
            unit or default or "1",
            texts["note"],
        )

    def _implied(self, value: float, sd: float | None, low: float | None, high: float | None) -> Distribution | None:
        """Distribution of value with sd and/or low and high: (truncated) normal, or uniform."""
        if sd is not None and sd > 0:
            floor = low if low is not None else (self.low if math.isfinite(self.low) and not self.bounds else None)
            roof = high if high is not None else (self.high if math.isfinite(self.high) and not self.bounds else None)
            if floor is None and roof is None:
                return Distribution("normal", value, sd)
            return Distribution("truncated_normal", value, sd, floor, roof)
        if sd is None and not self.bounds and low is not None and high is not None and high > low:
            return Distribution("uniform", low=low, high=high)
        return None

    def _distribution(
        self, raw: Any, value: float | None, issues: list[Issue], folder: Path | None
    ) -> Distribution | None:
        where: tuple[str | int, ...] = ("distribution",)
        if not isinstance(raw, Mapping):
            issues.append(Issue("a distribution is a mapping", _shown(raw), "{kind: normal, sd: …}", at=where))
            return None
        kind = raw.get("kind")
        if kind not in KINDS:
            hint = did_you_mean(kind, KINDS) if isinstance(kind, str) else ""
            issues.append(Issue("unknown kind of distribution", _shown(kind), ", ".join(KINDS), hint, (*where, "kind")))
            return None
        needs = {
            "normal": ("mean", "sd"),
            "truncated_normal": ("mean", "sd", "low", "high"),
            "lognormal": ("mean", "sd"),
            "uniform": ("low", "high"),
            "triangular": ("low", "mode", "high"),
            "discrete": ("values", "weights"),
            "empirical": ("values", "file", "column"),
        }[kind]
        before = len(issues)
        for key in raw:
            if key != "kind" and key not in needs:
                issues.append(
                    Issue(
                        f"unknown key '{key}' of a {kind} distribution",
                        str(key),
                        ", ".join(("kind", *needs)),
                        did_you_mean(str(key), needs),
                        (*where, key),
                    )
                )
        if kind in ("discrete", "empirical"):
            return self._from_values(raw, kind, issues, where, folder, before)
        numbers: dict[str, float | None] = {}
        for key in (key for key in needs if key != "sd"):
            try:
                if key in raw:
                    numbers[key] = self._number(raw[key], (*where, key))[0]
                elif key in ("mean", "mode"):
                    numbers[key] = value
            except Issue as issue:
                issues.append(issue)
        if "sd" in needs and "sd" in raw:
            try:
                numbers["sd"] = self._spread(raw["sd"], numbers.get("mean"), (*where, "sd"))
            except Issue as issue:
                issues.append(issue)
        if len(issues) > before:
            return None
        optional = ("low", "high") if kind == "truncated_normal" else ()
        for key in needs:
            if numbers.get(key) is None and key not in optional:
                issues.append(Issue(f"a {kind} distribution needs '{key}'", _shown(raw), ", ".join(needs), at=where))
        if len(issues) > before:
            return None
        low, high, mode, mean = (numbers.get(key) for key in ("low", "high", "mode", "mean"))
        if low is not None and high is not None and low >= high:
            issues.append(Issue("low must be below high", _shown(raw), "low < high", at=where))
        elif mode is not None and low is not None and high is not None and not low <= mode <= high:
            issues.append(Issue("mode outside low and high", _shown(mode), "low <= mode <= high", at=where))
        elif kind == "lognormal" and (mean is None or mean <= 0):
            issues.append(Issue("a lognormal distribution needs a mean above 0", _shown(mean), "> 0", at=where))
        if len(issues) > before:
            return None
        return Distribution(kind, mean, numbers.get("sd"), low, high, mode)

    def _from_values(
        self,
        raw: Mapping[str, Any],
        kind: str,
        issues: list[Issue],
        where: tuple[str | int, ...],
        folder: Path | None,
        before: int,
    ) -> Distribution | None:
        source = raw.get("values")
        try:
            if kind == "empirical" and "file" in raw:
                if source is not None:
                    raise Issue("values and file together", _shown(raw), "one of them", at=where)
                source = _read_column(raw.get("file"), raw.get("column"), folder, where)
            if not isinstance(source, (list, tuple)) or not source:
                raise Issue(
                    f"a {kind} distribution needs values", _shown(source), "a list of numbers", at=(*where, "values")
                )
            if len(source) > _MAX_EMPIRICAL:
                raise Issue("too many values", str(len(source)), f"at most {_MAX_EMPIRICAL}", at=where)
            values = tuple(self._number(item, (*where, "values", index))[0] for index, item in enumerate(source))
            weights = raw.get("weights", [1.0] * len(values)) if kind == "discrete" else [1.0] * len(values)
            good = (
                isinstance(weights, (list, tuple))
                and len(weights) == len(values)
                and all(
                    isinstance(item, (int, float)) and not isinstance(item, bool) and 0 <= item < 1e300
                    for item in weights
                )
            )
            total = math.fsum(weights) if good else 0.0
            if not good or total <= 0:
                raise Issue(
                    "weights do not fit the values",
                    _shown(weights),
                    f"{len(values)} numbers of 0 or more",
                    at=(*where, "weights"),
                )
        except Issue as issue:
            issues.append(issue)
            return None
        if len(issues) > before:
            return None
        return Distribution(kind, values=values, weights=tuple(float(item) / total for item in weights))

    def _check_range(self, parameter: Parameter, raw: Any, issues: list[Issue]) -> None:
        """Nominal value and given range inside what is physically possible."""
        si = units.DIMENSIONS[self.dimension].si if self.dimension else parameter.unit
        shown = "" if si == "1" else f" {si}"
        if math.isfinite(self.low) and math.isfinite(self.high):
            allowed = f"{self.low:g} to {self.high:g}{shown}"
        elif math.isfinite(self.low):
            allowed = f"{'more than' if self.strict_low else 'at least'} {self.low:g}{shown}"
        else:
            allowed = f"at most {self.high:g}{shown}"
        distribution = parameter.distribution
        candidates = [("value", parameter.value), ("low", parameter.low), ("high", parameter.high)]
        if distribution is not None and distribution.kind in (
            "uniform",
            "triangular",
            "discrete",
            "empirical",
            "truncated_normal",
        ):
            low = min(distribution.values) if distribution.values else distribution.low
            high = max(distribution.values) if distribution.values else distribution.high
            candidates += [("distribution", low), ("distribution", high)]
        for key, number in candidates:
            if number is None:
                continue
            wrong = (
                number < self.low or number > self.high or (self.strict_low and number <= self.low and key == "value")
            )
            if wrong:
                at = (key,) if isinstance(raw, Mapping) and key in raw else ()
                given = raw.get(key, number) if isinstance(raw, Mapping) else raw
                hint = ""
                if self.dimension == "fraction" and 1 < number <= 100 and isinstance(given, (int, float)):
                    hint = f"{given:g} %"
                issues.append(Issue("impossible value", _shown(given), allowed, hint, at))
                return


@dataclass(frozen=True)
class _ConditionOf(QuantityOf):
    """A free covariate: number, text with a unit, mapping, or (text that does not begin with a number) a word."""

    def _validate(self, raw: Any, info: core_schema.ValidationInfo) -> Parameter | str:  # type: ignore[override]
        if isinstance(raw, str) and units.split(raw) is None and 0 < len(raw) <= 200:
            return raw
        return super()._validate(raw, info)


def quantity(dimension: str, low: float = -math.inf, high: float = math.inf, *, strict: bool = False) -> QuantityOf:
    """Shorthand for the annotations in the models."""
    return QuantityOf(dimension, low, high, strict)


def _finite(value: float, raw: Any, allowed: str, at: tuple[str | int, ...]) -> float:
    if not math.isfinite(value):
        raise Issue("not a finite number", _shown(raw), allowed, at=at)
    return value


def _shown(raw: Any) -> str:
    from missionsim.spec.tree import as_written

    return as_written(raw)


def _read_column(file: Any, column: Any, folder: Path | None, where: tuple[str | int, ...]) -> list[Any]:
    if not isinstance(file, str) or not isinstance(column, str):
        raise Issue(
            "an empirical distribution needs file and column",
            "",
            "{kind: empirical, file: values.csv, column: power_w}",
            at=where,
        )
    path = (folder or Path()) / file
    try:
        with open(path, newline="", encoding="utf-8-sig") as handle:
            reader = csv.DictReader(handle)
            names = list(reader.fieldnames or ())
            if column not in names:
                raise Issue(
                    f"no column '{column}' in {file}",
                    column,
                    ", ".join(names[:12]),
                    did_you_mean(column, names),
                    (*where, "column"),
                )
            result: list[Any] = []
            for row in reader:
                if row[column] not in (None, ""):
                    result.append(row[column])
                if len(result) > _MAX_EMPIRICAL:
                    break
            return result
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as problem:
        if isinstance(problem, Issue):
            raise
        raise Issue(f"cannot read {file}", file, "a CSV file beside this YAML file", at=(*where, "file")) from None


def _serialize(parameter: Any) -> Any:
    if not isinstance(parameter, Parameter):
        return parameter
    extras = {
        "sd": parameter.sd,
        "low": parameter.low,
        "high": parameter.high,
        "status": parameter.status or None,
        "source": parameter.source or None,
    }
    given = {key: value for key, value in extras.items() if value is not None}
    if parameter.distribution is not None:
        given["distribution"] = parameter.distribution.as_dict()
    return {"value": parameter.value, "unit": parameter.unit} | given if given else parameter.value


Length = Annotated[Parameter, quantity("length", 0.0)]
Coordinate = Annotated[Parameter, quantity("length")]
Distance = Annotated[Parameter, quantity("length", 0.0, strict=True)]
Speed = Annotated[Parameter, quantity("speed", 0.0, 60.0, strict=True)]
Acceleration = Annotated[Parameter, quantity("acceleration", 0.0, 50.0, strict=True)]
Angle = Annotated[Parameter, quantity("angle")]
Slope = Annotated[Parameter, QuantityOf("angle", -1.3, 1.3, percent_slope=True)]
YawRate = Annotated[Parameter, quantity("yaw rate", 0.0, 30.0, strict=True)]
YawAcceleration = Annotated[Parameter, quantity("yaw acceleration", 0.0, 1000.0, strict=True)]
Mass = Annotated[Parameter, quantity("mass", 0.0, 1e6)]
Power = Annotated[Parameter, quantity("power", 0.0, 1e6)]
Energy = Annotated[Parameter, quantity("energy", 0.0, strict=True)]
Voltage = Annotated[Parameter, quantity("voltage", 0.0, 2000.0, strict=True)]
Resistance = Annotated[Parameter, quantity("resistance", 0.0, 1e6)]
Duration = Annotated[Parameter, quantity("duration", 0.0, 1e9)]
Period = Annotated[Parameter, quantity("duration", 0.0, 1e9, strict=True)]
Frequency = Annotated[Parameter, quantity("frequency", 0.0, 1e11)]
Temperature = Annotated[Parameter, quantity("temperature", -90.0, 90.0)]
Fraction = Annotated[Parameter, quantity("fraction", 0.0, 1.0)]
Efficiency = Annotated[Parameter, quantity("fraction", 0.0, 1.0, strict=True)]
Ratio = Annotated[Parameter, quantity("number", 0.0, 100.0, strict=True)]
Peukert = Annotated[Parameter, quantity("number", 1.0, 2.0)]
AnyNumber = Annotated[Parameter, QuantityOf("")]
Condition = Annotated[Parameter | str, _ConditionOf("")]
EffectNumber = Annotated[Parameter, QuantityOf("", bounds=True)]

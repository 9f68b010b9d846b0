"""The written forms of an uncertain number: value with sd, low and high, or a named distribution."""

from __future__ import annotations

import csv
import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from missionsim.errors import did_you_mean
from missionsim.inputs import units
from missionsim.inputs.parameter import KINDS, STATUSES, Distribution, Issue, Issues, Parameter
from missionsim.inputs.tree import as_written

_KEYS = ("value", "sd", "low", "high", "distribution", "unit", "status", "source", "note")
_MAX_EMPIRICAL = 100_000
_NEEDS = {
    "normal": ("mean", "sd"),
    "truncated_normal": ("mean", "sd", "low", "high"),
    "lognormal": ("mean", "sd"),
    "uniform": ("low", "high"),
    "triangular": ("low", "mode", "high"),
    "discrete": ("values", "weights"),
    "empirical": ("values", "file", "column"),
}


class UncertainReader:
    """Reads the mapping form; `missionsim.inputs.quantity.QuantityOf` reads the numbers in it."""

    dimension: str
    low: float
    high: float
    bounds: bool

    def _number(self, raw: Any, at: tuple[str | int, ...] = (), unit: str = "") -> tuple[float, str]:
        """SI value and unit of one number or text."""
        raise TypeError("only its subclasses know the unit")

    def _spread(self, raw: Any, value: float | None, at: tuple[str | int, ...], unit: str = "") -> float:
        """Standard deviation, SI; a percentage is of the value."""
        if isinstance(raw, str) and raw.rstrip().endswith("%") and (parts := units.split(raw)):
            if value is None:
                raise Issue("a relative sd needs a value", raw, "a sd with a unit", at=at)
            spread = abs(value) * parts[0] / 100
        else:
            spread = self._number(raw, at, unit)[0] - self._zero_of(raw)
        if spread < 0:
            raise Issue("standard deviation below zero", as_written(raw), "0 or more", at=at)
        return spread

    def _alike(self, key: str, raw: Any, unit: str, other: str) -> None:
        """Refuse a number of another kind than the one before it, where any unit may stand."""
        if not self.dimension and unit and other and not units.same_dimension(unit, other):
            raise Issue(f"{key} in another unit than its value", as_written(raw), f"a number in {other}", at=(key,))

    def _zero_of(self, raw: Any) -> float:
        """Where the unit of a number begins: 4 K of spread are 4 degrees, not −269 °C."""
        if not self.dimension:
            return 0.0  # units with an offset are refused there
        parts = units.split(raw) if isinstance(raw, str) else None
        try:
            return units.unit_factor(parts[1], self.dimension)[1] if parts and parts[1] else 0.0
        except units.UnitError:
            return 0.0

    def _mapping(self, raw: Mapping[str, Any], issues: Issues, folder: Path | None) -> Parameter | None:
        for key in raw:
            if key not in _KEYS:
                issues.tell(f"unknown key '{key}'", str(key), ", ".join(_KEYS), did_you_mean(str(key), _KEYS), (key,))
        texts = {key: raw.get(key, "") for key in ("unit", "status", "source", "note")}
        for key, text in texts.items():
            if not isinstance(text, str):
                issues.tell(f"{key} must be text", as_written(text), "text", at=(key,))
                texts[key] = ""
        if (status := texts["status"]) and status not in STATUSES:
            hint = did_you_mean(status, STATUSES)
            issues.tell("unknown status", as_written(status), ", ".join(STATUSES), hint, ("status",))
        given: dict[str, float | None] = dict.fromkeys(("value", "low", "high", "sd"))
        unit = texts["unit"]
        if unit and self.dimension:
            allowed = units.allowed_text(self.dimension)
            issues.tell("unit belongs beside the number", as_written(unit), allowed, at=("unit",))
        before = len(issues)
        for key in ("value", "low", "high"):
            with issues:
                if key in raw:
                    given[key], found = self._number(raw[key], (key,), texts["unit"])
                    self._alike(key, raw[key], found, unit)
                    unit = unit or found
        distribution = None
        with issues:
            if "sd" in raw and len(issues) == before:
                given["sd"] = self._spread(raw["sd"], given["value"], ("sd",), texts["unit"])
                if isinstance(raw["sd"], str) and not raw["sd"].rstrip().endswith("%"):
                    self._alike("sd", raw["sd"], self._number(raw["sd"], ("sd",))[1], unit)
        if "distribution" in raw and len(issues) == before:
            distribution = self._distribution(raw["distribution"], given["value"], issues, folder)
        if len(issues) > before:
            return None
        value, low, high, sd = given["value"], given["low"], given["high"], given["sd"]
        if low is not None and high is not None and low > high:
            got = f"{as_written(raw['low'])} > {as_written(raw['high'])}"
            issues.tell("low above high", got, "low <= high", at=("low",))
            return None
        if value is None and distribution is not None:
            value = distribution.mean
        if value is None and low is not None and high is not None:
            value = (low + high) / 2
        if value is None:
            issues.tell("no value", as_written(raw), "value, low and high, or a distribution")
            return None
        if (low is not None and value < low) or (high is not None and value > high):
            allowed = f"{as_written(raw.get('low'))} to {as_written(raw.get('high'))}"
            issues.tell("value outside its own low and high", as_written(raw.get("value")), allowed, at=("value",))
        distribution = distribution or self._implied(value, sd, low, high)
        if sd is None and distribution is not None:
            sd = distribution.sd
        unit = unit or (units.DIMENSIONS[self.dimension].si if self.dimension else "1")
        told = (texts["status"], texts["source"], unit)
        return Parameter(value, sd, low, high, distribution, *told, note=texts["note"])

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

    def _distribution(self, raw: Any, value: float | None, issues: Issues, folder: Path | None) -> Distribution | None:
        where: tuple[str | int, ...] = ("distribution",)
        if not isinstance(raw, Mapping):
            issues.tell("a distribution is a mapping", as_written(raw), "{kind: normal, sd: …}", at=where)
            return None
        kind = raw.get("kind")
        if kind not in KINDS:
            hint = did_you_mean(kind, KINDS) if isinstance(kind, str) else ""
            issues.tell("unknown kind of distribution", as_written(kind), ", ".join(KINDS), hint, (*where, "kind"))
            return None
        needs, before = _NEEDS[kind], len(issues)
        for key in raw:
            if key != "kind" and key not in needs:
                message, allowed = f"unknown key '{key}' of {_a(kind)} distribution", ", ".join(("kind", *needs))
                issues.tell(message, str(key), allowed, did_you_mean(str(key), needs), (*where, key))
        if kind in ("discrete", "empirical"):
            with issues:
                found = self._from_values(raw, kind, where, folder)
                return found if len(issues) == before else None
            return None
        numbers: dict[str, float | None] = {}
        for key in sorted(needs, key="sd".__eq__):  # a relative sd needs the mean
            with issues:
                if key in raw and key == "sd":
                    numbers[key] = self._spread(raw[key], numbers.get("mean"), (*where, key))
                elif key in raw:
                    numbers[key] = self._number(raw[key], (*where, key))[0]
                elif key in ("mean", "mode"):
                    numbers[key] = value
        if len(issues) > before:
            return None
        optional = ("low", "high") if kind == "truncated_normal" else ()
        for key in needs:
            if numbers.get(key) is None and key not in optional:
                issues.tell(f"{_a(kind)} distribution needs '{key}'", as_written(raw), ", ".join(needs), at=where)
        if len(issues) > before:
            return None
        low, high, mode, mean = (numbers.get(key) for key in ("low", "high", "mode", "mean"))
        if low is not None and high is not None and low >= high:
            issues.tell("low must be below high", as_written(raw), "low < high", at=where)
        elif mode is not None and low is not None and high is not None and not low <= mode <= high:
            issues.tell("mode outside low and high", as_written(mode), "low <= mode <= high", at=where)
        elif kind == "lognormal" and (mean is None or mean <= 0):
            issues.tell("a lognormal distribution needs a mean above 0", as_written(mean), "> 0", at=where)
        return Distribution(kind, mean, numbers.get("sd"), low, high, mode) if len(issues) == before else None

    def _value(
        self, raw: Mapping[str, Any], rows: list[int] | None, index: int, item: Any, where: tuple[str | int, ...]
    ) -> float:
        """One of the values, told by its row where they are those of a CSV file."""
        if rows is None:
            return self._number(item, (*where, "values", index))[0]
        try:
            return self._number(item)[0]
        except Issue as issue:
            told = issue.entry
            message = f"{told['message']}, in column '{raw['column']}' of {raw['file']}, line {rows[index]}"
            raise Issue(message, str(told["got"]), str(told["allowed"]), str(told["hint"]), where) from None

    def _from_values(
        self, raw: Mapping[str, Any], kind: str, where: tuple[str | int, ...], folder: Path | None
    ) -> Distribution:
        source: Any = raw.get("values")
        rows: list[int] | None = None
        if kind == "empirical" and ("file" in raw or "column" in raw):
            if source is not None:
                raise Issue("values and file together", as_written(raw), "one of them", at=where)
            source, rows = _read_column(raw.get("file"), raw.get("column"), folder, where)
        if not isinstance(source, (list, tuple)) or not source:
            message = f"{_a(kind)} distribution needs values"
            raise Issue(message, as_written(source), "a list of numbers", at=(*where, "values"))
        if len(source) > _MAX_EMPIRICAL:
            raise Issue("too many values", str(len(source)), f"at most {_MAX_EMPIRICAL}", at=where)
        values = tuple(self._value(raw, rows, index, item, where) for index, item in enumerate(source))
        weights = raw.get("weights", [1.0] * len(values)) if kind == "discrete" else [1.0] * len(values)
        good = isinstance(weights, (list, tuple)) and len(weights) == len(values)
        good = good and all(type(item) in (int, float) and 0 <= item < 1e300 for item in weights)
        total = math.fsum(weights) if good else 0.0
        if total <= 0:
            allowed = f"{len(values)} numbers of 0 or more"
            raise Issue("weights do not fit the values", as_written(weights), allowed, at=(*where, "weights"))
        return Distribution(kind, values=values, weights=tuple(float(item) / total for item in weights))


def _a(kind: str) -> str:
    return f"an {kind}" if kind == "empirical" else f"a {kind}"


def _read_column(
    file: Any, column: Any, folder: Path | None, where: tuple[str | int, ...]
) -> tuple[list[Any], list[int]]:
    """Texts of a column of a CSV file, and their lines."""
    if not isinstance(file, str) or not isinstance(column, str):
        allowed = "{kind: empirical, file: values.csv, column: power_w}"
        raise Issue("an empirical distribution needs file and column", "", allowed, at=where)
    home = (folder or Path()).resolve()
    path = (home / file).resolve()
    try:
        # files of others may name any path: only what lies with them is read, and nothing that never ends
        if not path.is_relative_to(home) or not path.is_file():
            raise OSError
        with open(path, newline="", encoding="utf-8-sig") as handle:
            reader = csv.DictReader(handle)
            names = list(reader.fieldnames or ())
            if column not in names:
                hint = did_you_mean(column, names)
                raise Issue(f"no column '{column}' in {file}", column, ", ".join(names[:12]), hint, (*where, "column"))
            filled = ((row[column], reader.line_num) for row in reader if row[column] not in (None, ""))
            found = list(itertools.islice(filled, _MAX_EMPIRICAL + 1))
            if not found:
                raise Issue(f"no numbers in column '{column}' of {file}", "", "one number a line", at=where)
            return [text for text, _ in found], [line for _, line in found]
    except (OSError, UnicodeDecodeError, csv.Error, ValueError) as problem:
        if isinstance(problem, Issue):
            raise
        raise Issue(f"cannot read {file}", file, "a CSV file beside or below this YAML file", at=where) from None

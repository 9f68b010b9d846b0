"""The kinds of numbers that the files hold, each with its unit and what is physically possible."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any

from pydantic import GetJsonSchemaHandler
from pydantic_core import core_schema

from missionsim.inputs import units
from missionsim.inputs.base import told
from missionsim.inputs.parameter import KINDS, STATUSES, Issue, Issues, Parameter
from missionsim.inputs.tree import as_written
from missionsim.inputs.uncertain import UncertainReader

_UNSAID = 1e5
"""Upper limits from here on only keep out nonsense; a message does not name them."""


@dataclass(frozen=True)
class QuantityOf(UncertainReader):
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

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        from missionsim.inputs.schemas import unit_pattern

        plain = units.DIMENSIONS[self.dimension].plain if self.dimension else "SI"
        text = {"type": "string", "pattern": unit_pattern(self.dimension, self.percent_slope)}
        number: dict[str, Any] = {"type": "number", "description": f"in {plain}"}
        if self.dimension and not self.percent_slope:
            factor = units.plain_to_si(1.0, self.dimension)
            if math.isfinite(self.low):
                number["exclusiveMinimum" if self.strict_low else "minimum"] = self.low / factor
            if math.isfinite(self.high):
                number["exclusiveMaximum" if self.strict_high else "maximum"] = self.high / factor
        part = {"anyOf": [{"type": "number"}, {"type": "string", "pattern": unit_pattern("")}]}
        mapping = {
            "x-quantity": "mapping",
            "description": "an uncertain number, or one with its status and source",
            "type": "object",
            "additionalProperties": False,
            "properties": {
                **dict.fromkeys(("value", "sd", "low", "high"), part),
                "distribution": {
                    "type": "object",
                    "additionalProperties": False,
                    "required": ["kind"],
                    "properties": {
                        "kind": {"enum": list(KINDS)},
                        **dict.fromkeys(("mean", "sd", "low", "high", "mode"), part),
                        "values": {"type": "array", "items": part},
                        "weights": {"type": "array", "items": {"type": "number", "minimum": 0}},
                        **{key: {"type": "string"} for key in ("file", "column")},
                    },
                },
                "unit": {"type": "string"},
                "status": {"enum": list(STATUSES)},
                **{key: {"type": "string"} for key in ("source", "note")},
            },
        }
        what = self._allowed()
        return {"x-quantity": self._label(), "description": what, "anyOf": [number, text, mapping]}

    def _allowed(self) -> str:
        """What may be written, for messages."""
        return units.allowed_text(self.dimension) if self.dimension else "a number, with a unit or without"

    def _label(self) -> str:
        """Name of this quantity among a schema's definitions."""
        kind = "slope" if self.percent_slope else self.dimension or "any number"
        last = f"{'below' if self.strict_high else 'to'} {self.high:g}"
        ends = [f"from {self.low:g}"] * math.isfinite(self.low) + [last] * math.isfinite(self.high)
        return " ".join([kind, *(["above"] if self.strict_low else []), *ends])

    def _validate(self, raw: Any, info: core_schema.ValidationInfo) -> Parameter:
        if isinstance(raw, Parameter):
            return raw
        issues = Issues()
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
            raise told(issue.entry for issue in issues)
        return parameter

    def _number(self, raw: Any, at: tuple[str | int, ...] = (), unit: str = "") -> tuple[float, str]:
        """SI value and unit of one number or text."""
        allowed = self._allowed()
        if isinstance(raw, bool) or not isinstance(raw, (int, float, str)):
            raise Issue("not a number", as_written(raw), allowed, at=at)
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
            usual = self.dimension and problem.allowed == units.allowed_text(self.dimension)
            told = allowed if usual else problem.allowed
            raise Issue(problem.message, problem.got, told, problem.hint, at) from None
        except OverflowError:
            raise Issue("number too large", as_written(raw), allowed, at=at) from None
        return _finite(value, raw, allowed, at), units.DIMENSIONS[self.dimension].si if self.dimension else unit

    def _check_range(self, parameter: Parameter, raw: Any, issues: Issues) -> None:
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
            low = min(distribution.values) if distribution.values else distribution.low
            high = max(distribution.values) if distribution.values else distribution.high
            candidates += [("distribution", low), ("distribution", high)]
        for key, number in candidates:
            if number is None:
                continue
            wrong = number < self.low or number > self.high
            wrong |= self.strict_low and number <= self.low and key == "value"
            drawn = key == "value" or (distribution is not None and bool(distribution.values))
            wrong |= self.strict_high and number >= self.high and drawn
            if wrong:
                at = (key,) if isinstance(raw, Mapping) and key in raw else ()
                given = raw.get(key, number) if isinstance(raw, Mapping) else raw
                hint = ""
                if number > self.high >= _UNSAID and math.isfinite(self.low):
                    allowed += f", at most {self.high:g}{shown}"
                if self.dimension == "fraction" and 1 < number <= 100 and isinstance(given, (int, float)):
                    hint = f"{given:g} %"
                issues.tell("impossible value", as_written(given), allowed, hint, at)
                return


@dataclass(frozen=True)
class ConditionOf(QuantityOf):
    """A free covariate: number, text with a unit, mapping, or (text that does not begin with a number) a word."""

    def _validate(self, raw: Any, info: core_schema.ValidationInfo) -> Parameter | str:  # type: ignore[override]
        if isinstance(raw, str) and units.split(raw) is None and 0 < len(raw) <= 200:
            return raw
        return super()._validate(raw, info)


def _finite(value: float, raw: Any, allowed: str, at: tuple[str | int, ...]) -> float:
    if not math.isfinite(value):
        raise Issue("not a finite number", as_written(raw), allowed, at=at)
    return value


def _serialize(one: Any) -> Any:
    """What a parameter holds but its place in the file; the number where that is all."""
    if not isinstance(one, Parameter):
        return one
    given = {k: v for k, v in vars(one).items() if k not in ("note", "path", "line") and v is not None and v != ""}
    return given if given.keys() - {"value", "unit"} else one.value


__all__ = ["Issue", "Parameter", "QuantityOf"]


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
Power = Annotated[Parameter, QuantityOf("power", 0.0, 1e6)]
Energy = Annotated[Parameter, QuantityOf("energy", 0.0, strict_low=True)]
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

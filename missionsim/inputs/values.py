"""The kinds of numbers that the files hold, each with its unit and what is physically possible."""

from dataclasses import dataclass
from typing import Annotated, Any

from pydantic_core import core_schema

from missionsim.inputs import units
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.quantity import QuantityOf

__all__ = ["Parameter", "QuantityOf"]


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

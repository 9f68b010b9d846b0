"""The kinds of numbers that the files hold, each with its unit and what is physically possible."""

from __future__ import annotations

import math
from typing import Annotated

from missionsim.inputs.parameter import Issue, Parameter
from missionsim.inputs.quantity import ConditionOf, QuantityOf

__all__ = ["Issue", "Parameter", "QuantityOf", "quantity"]


def quantity(dimension: str, low: float = -math.inf, high: float = math.inf, *, strict: bool = False) -> QuantityOf:
    """Shorthand for the annotations in the models."""
    return QuantityOf(dimension, low, high, strict)


Length = Annotated[Parameter, quantity("length", 0.0)]
Coordinate = Annotated[Parameter, quantity("length", -1e12, 1e12)]
Distance = Annotated[Parameter, quantity("length", 0.0, 1e12, strict=True)]
Speed = Annotated[Parameter, quantity("speed", 0.0, 60.0, strict=True)]
Acceleration = Annotated[Parameter, quantity("acceleration", 1e-6, 50.0)]
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
Chance = Annotated[Parameter, QuantityOf("fraction", 0.0, 1.0, strict_high=True)]
"""Of failing, each time: 1 would never succeed."""
Efficiency = Annotated[Parameter, quantity("fraction", 0.0, 1.0, strict=True)]
Ratio = Annotated[Parameter, quantity("number", 0.0, 100.0, strict=True)]
Peukert = Annotated[Parameter, quantity("number", 1.0, 2.0)]
AnyNumber = Annotated[Parameter, QuantityOf("")]
Condition = Annotated[Parameter | str, ConditionOf("")]
EffectNumber = Annotated[Parameter, QuantityOf("", bounds=True)]

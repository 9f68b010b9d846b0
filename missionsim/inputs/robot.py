"""The robot file: body, batteries, components, motion, control schemes and effects."""

from typing import Annotated, Literal

from pydantic import Field, JsonValue, model_validator

from missionsim.inputs.base import Expression, FileModel, Identifier, Model, Name, ParameterName, Text, wrong
from missionsim.inputs.battery import BatterySpec
from missionsim.inputs.components import ComponentSpec, LinkSpec, SwitchboardSpec
from missionsim.inputs.schemes import ProcessorSpec, SchemeSpec
from missionsim.inputs.values import (
    Acceleration,
    AnyNumber,
    EffectNumber,
    Fraction,
    Length,
    Mass,
    Parameter,
    Speed,
    YawAcceleration,
    YawRate,
)

Drive = Literal["differential", "skid_steer", "mecanum", "omni", "ackermann"]


class BodySpec(Model):
    """Mass, drive and limits."""

    mass: Mass | None = None
    drive: Drive
    max_speed: Speed
    max_lateral_speed: Speed | None = None
    max_acceleration: Acceleration | None = None
    max_deceleration: Acceleration | None = None
    max_yaw_rate: YawRate = Parameter(1.0, status="assumed", unit="rad/s")
    max_yaw_acceleration: YawAcceleration | None = None
    max_payload: Mass | None = None
    track_width: Length | None = None
    regeneration: Fraction = Parameter(0.0, status="assumed")

    @property
    def moves_sideways(self) -> bool:
        """Whether `move` segments with a direction are possible."""
        return self.drive in ("mecanum", "omni")


class MotionSpec(Model):
    """Base power of moving, on one battery; `model` is a registered motion model, ``expression`` or ``none``."""

    battery: Identifier
    model: Identifier = "polynomial"
    power: Expression | None = None
    standing: Expression | None = None
    parameters: dict[ParameterName, AnyNumber] = Field(default_factory=dict)
    options: dict[Identifier, JsonValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _expression(self) -> "MotionSpec":
        if self.model == "expression" and self.power is None:
            raise wrong("motion model 'expression' needs 'power'", "no power", 'power: "c3*v + c4"')
        if self.model != "expression" and self.power is not None:
            raise wrong(
                "'power' belongs to motion model 'expression'", f"model: {self.model}", "model: expression", "power"
            )
        return self


class EffectSpec(Model):
    """An added effect: one of the library (`effect`), or the user's own (`name` and `power`).

    With `candidate` it is no part of the power model, only one more thing that a diagnosis may find.
    """

    effect: Name | None = None
    name: Identifier | None = None
    battery: Identifier
    power: Expression | None = None
    component: Identifier | None = None
    parameters: dict[Name, EffectNumber] = Field(default_factory=dict)
    options: dict[Identifier, JsonValue] = Field(default_factory=dict)
    candidate: bool = False
    origin: dict[str, JsonValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one(self) -> "EffectSpec":
        if (self.effect is None) == (self.power is None):
            raise wrong(
                "an effect is one of the library or an expression",
                "both" if self.effect else "neither",
                'effect: grade, or name: my_term with power: "k * …"',
            )
        if self.effect is None and self.name is None:
            raise wrong("an effect of your own needs a name", "no name", "name: my_term")
        return self


class RobotSpec(FileModel):
    """A robot file."""

    kind: Literal["robot"]
    name: Identifier
    title: Text = ""
    notes: Text = ""
    sources: dict[Identifier, Text] = Field(default_factory=dict)
    body: BodySpec
    batteries: Annotated[dict[Identifier, BatterySpec], Field(min_length=1, max_length=100)]
    motion: MotionSpec | None = None
    components: dict[Identifier, ComponentSpec] = Field(default_factory=dict)
    links: dict[Identifier, LinkSpec] = Field(default_factory=dict)
    switchboards: dict[Identifier, SwitchboardSpec] = Field(default_factory=dict)
    processor: ProcessorSpec | None = None
    schemes: dict[Identifier, SchemeSpec] = Field(default_factory=dict)
    origin: dict[str, JsonValue] = Field(default_factory=dict)
    effects: tuple[EffectSpec, ...] = ()
    idle_scheme: Identifier | None = None

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Components that a scheme's table, rules or navigation names: they make a hardware configuration."""
        found: dict[str, None] = {}
        for scheme in self.schemes.values():
            for rules in (scheme.sensors, *scheme.navigation.values()):
                found |= dict.fromkeys([*rules.required, *rules.optional])
            for row in scheme.processor:
                found |= dict.fromkeys(row.sensors)
        return tuple(name for name in self.components if name in found)

"""The robot file: body, batteries, components, motion, control schemes and effects."""

import itertools
from dataclasses import replace
from typing import Annotated, Literal

from pydantic import AfterValidator, Field, JsonValue

from missionsim.errors import Fault, did_you_mean
from missionsim.glossary import COLUMNS, column_of
from missionsim.inputs import values
from missionsim.inputs.base import (
    DescribedFile,
    Expression,
    Identifier,
    Model,
    Name,
    ParameterName,
    Sensors,
    Text,
    either,
    told,
    wrong,
)
from missionsim.inputs.battery import BatterySpec
from missionsim.inputs.parameter import Parameter


class LawSpec(Model):
    """Power that depends on a rate, the speed, a load…: an expression over parameters and glossary columns (`power`),
    or a registered law (`model`)."""

    power: Expression | None = None
    model: Identifier | None = None
    rate: values.Frequency | None = None
    parameters: dict[ParameterName, values.AnyNumber] = Field(default_factory=dict)

    _one = either("power", "model", "a law has either a power or a model", 'power: "k*rate", or model: multicore_cpu')


class LoadSpec(Model):
    """What one unit of a component takes from one battery."""

    battery: Identifier
    power: values.Power | None = None
    law: LawSpec | None = None
    through: Identifier | None = None

    _one = either("power", "law", "a load has either a power or a law", "power: 2.3 W, or law: {power: …}")


class StartupSpec(Model):
    """Time between switching on and being ready, and the power meanwhile (per unit, on the first load's battery)."""

    duration: values.Duration
    power: values.Power | None = None


class ComponentSpec(Model):
    """A sensor, board, screen or radio."""

    title: Text = ""
    units: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1
    always_on: bool = False
    loads: Annotated[tuple[LoadSpec, ...], Field(min_length=1, max_length=50)]
    relay: Identifier | None = None
    requires: tuple[Identifier, ...] = ()
    startup: StartupSpec | None = None


class LinkSpec(Model):
    """Converter or USB link between a component and its battery: power at the battery = power / efficiency."""

    battery: Identifier
    efficiency: values.Efficiency = Parameter(1.0)
    title: Text = ""


class SwitchboardSpec(Model):
    """Relay board: its own power for 0, 1, 2… activated relays."""

    battery: Identifier
    power: Annotated[tuple[values.Power, ...], Field(min_length=1, max_length=100)]
    title: Text = ""


class ProcessorSpec(Model):
    """The computer whose power the control schemes' tables give.

    `fallback` says what holds for a set of sensors that no row of the scheme's table names: ``nearest`` takes the row
    with the fewest units differing (the larger power of equals), marked assumed; ``refuse`` is a fault.
    """

    battery: Identifier
    idle: values.Power | None = None
    fallback: Literal["nearest", "refuse"] = "nearest"


class ProcessorRow(Model):
    """Processor power for one hardware configuration; sensors that are not named are off."""

    navigation: Identifier | None = None
    sensors: Sensors = Field(default_factory=dict)
    power: values.Power
    source: Text = ""
    status: Literal["", "published", "fitted", "assumed", "measured"] = ""

    def _check(self) -> None:
        """Status and source of the row belong to its power."""
        told = replace(self.power, status=self.power.status or self.status, source=self.power.source or self.source)
        self.__dict__["power"] = told


class SensorRules(Model):
    """Sensors that a scheme needs, and those that it may use, with units."""

    required: Sensors = Field(default_factory=dict)
    optional: Sensors = Field(default_factory=dict)


class BehaviourSpec(Model):
    """How the robot does otherwise than planned: distance ×, speed ×, extra standing time.

    The last four are left to chance, run by run, in a Monte Carlo: obstacles at a mean distance from each other, each
    with a stop of a mean time, and relocalisation at the end of a segment, which fails and is tried again.
    """

    path_stretch: values.Ratio | None = None
    speed_tracking: values.Ratio | None = None
    dwell: values.Duration | None = None
    obstacle_spacing: values.Distance | None = None
    obstacle_stop: values.Duration | None = None
    relocalisation_failure: values.Chance | None = None
    relocalisation_time: values.Duration | None = None


class SchemeSpec(Model):
    """A control scheme."""

    title: Text = ""
    motion: bool = True
    image_analysis: bool = False
    max_speed: values.Speed | None = None
    sensors: SensorRules = SensorRules.model_construct()
    default_sensors: Sensors = Field(default_factory=dict)
    navigation: dict[Identifier, SensorRules] = Field(default_factory=dict)
    default_navigation: Identifier | None = None
    processor: tuple[ProcessorRow, ...] = ()
    behaviour: BehaviourSpec = BehaviourSpec.model_construct()

    def sensor_rules(self, navigation: str | None = None) -> tuple[dict[str, int], dict[str, int]]:
        """Required units, and the most units allowed (required ones among them), under a navigation."""
        chosen = self.navigation.get(navigation or self.default_navigation or "")
        rules = (self.sensors,) if chosen is None else (self.sensors, chosen)

        def most(*given: dict[str, int]) -> dict[str, int]:
            return {name: max(one.get(name, 0) for one in given) for name in itertools.chain(*given)}

        required = most(*(rule.required for rule in rules))
        return required, most(*(rule.optional for rule in rules), required)


Drive = Literal["differential", "skid_steer", "mecanum", "omni", "ackermann"]


class BodySpec(Model):
    """Mass, drive and limits."""

    mass: values.BodyMass | None = None
    drive: Drive
    max_speed: values.Speed
    max_lateral_speed: values.Speed | None = None
    max_acceleration: values.Acceleration | None = None
    max_deceleration: values.Acceleration | None = None
    max_yaw_rate: values.YawRate = Parameter(1.0, status="assumed", unit="rad/s")
    max_yaw_acceleration: values.YawAcceleration | None = None
    max_payload: values.Mass | None = None
    track_width: values.Length | None = None
    regeneration: values.Fraction = Parameter(0.0, status="assumed")


class MotionSpec(Model):
    """Base power of moving, on one battery; `model` is a registered motion model, ``expression`` or ``none``."""

    battery: Identifier
    model: Identifier = "polynomial"
    power: Expression | None = None
    standing: Expression | None = None
    parameters: dict[ParameterName, values.AnyNumber] = Field(default_factory=dict)
    options: dict[Identifier, JsonValue] = Field(default_factory=dict)

    def _check(self) -> None:
        if self.model == "expression" and self.power is None:
            raise wrong("motion model 'expression' needs 'power'", "no power", 'power: "c3*v + c4"')
        if self.model != "expression" and self.power is not None:
            raise wrong(
                "'power' belongs to motion model 'expression'", f"model: {self.model}", "model: expression", "power"
            )


def _ranges(origin: dict[str, JsonValue]) -> dict[str, JsonValue]:
    """What `origin` says of the logs: least and greatest values, names of floors."""
    ranges = origin.get("range", {})
    if not isinstance(ranges, dict):
        raise wrong("must be a mapping", ranges, "{speed_m_s: [0, 1.2], surface: [tiles]}", "range")
    faults: list[dict[str, object]] = []
    for name, limits in ranges.items():
        listed = limits if isinstance(limits, list) else []
        numbers = [float(x) for x in listed if isinstance(x, int | float) and not isinstance(x, bool)]
        fault: dict[str, object] = {"got": str(limits), "hint": "", "at": ("range", name)}
        if name == "surface":
            if not listed or not all(isinstance(text, str) for text in listed):
                faults.append(fault | {"message": "must be the names of floors", "allowed": "[tiles, carpet]"})
        elif column_of(name) is None:
            known = [column.name for column in COLUMNS]
            told_as = {"message": "no quantity of the glossary", "got": name, "allowed": "columns of logs, surface"}
            faults.append(fault | told_as | {"hint": did_you_mean(name, known)})
        elif len(numbers) != 2 or len(listed) != 2 or numbers[0] > numbers[1]:
            allowed = "two numbers in the unit of the name, such as [0, 1.2]"
            faults.append(fault | {"message": "must be the least and the greatest value", "allowed": allowed})
    if faults:
        raise told(faults)
    return origin


Origin = Annotated[dict[str, JsonValue], AfterValidator(_ranges)]


class EffectSpec(Model):
    """An added effect: one of the library (`effect`), or the user's own (`name` and `power`).

    With `candidate` it is no part of the power model, only one more thing that a diagnosis may find.
    """

    effect: Name | None = None
    name: Identifier | None = None
    battery: Identifier
    power: Expression | None = None
    component: Identifier | None = None
    parameters: dict[Name, values.EffectNumber] = Field(default_factory=dict)
    options: dict[Identifier, JsonValue] = Field(default_factory=dict)
    candidate: bool = False
    origin: Origin = Field(default_factory=dict)

    _one = either(
        "effect",
        "power",
        "an effect is one of the library or an expression",
        'effect: grade, or name: my_term with power: "k * …"',
    )

    def _check(self) -> None:
        if self.effect is None and self.power is not None and self.name is None:
            raise wrong("an effect of your own needs a name", "no name", "name: my_term")


class RobotSpec(DescribedFile):
    """A robot file."""

    kind: Literal["robot"]
    name: Identifier
    body: BodySpec
    batteries: Annotated[dict[Identifier, BatterySpec], Field(min_length=1, max_length=100)]
    motion: MotionSpec | None = None
    components: dict[Identifier, ComponentSpec] = Field(default_factory=dict)
    links: dict[Identifier, LinkSpec] = Field(default_factory=dict)
    switchboards: dict[Identifier, SwitchboardSpec] = Field(default_factory=dict)
    processor: ProcessorSpec | None = None
    schemes: dict[Identifier, SchemeSpec] = Field(default_factory=dict)
    origin: Origin = Field(default_factory=dict)
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

    def faults(self) -> list[Fault]:
        """What parts of the file say of each other; see `missionsim.inputs.check_robot`."""
        from missionsim.inputs.check_robot import check_robot

        return check_robot(self)

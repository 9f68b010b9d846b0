"""Control schemes of a robot file: sensors, processor power, behaviour."""

from dataclasses import replace
from typing import Literal

from pydantic import Field, model_validator

from missionsim.inputs.base import Identifier, Model, Sensors, Text
from missionsim.inputs.values import Chance, Distance, Duration, Power, Ratio, Speed


class ProcessorSpec(Model):
    """The computer whose power the control schemes' tables give.

    `fallback` says what holds for a set of sensors that no row of the scheme's table names: ``nearest`` takes the row
    with the fewest units differing (the larger power of equals), marked assumed; ``refuse`` is a fault.
    """

    battery: Identifier
    idle: Power | None = None
    fallback: Literal["nearest", "refuse"] = "nearest"


class ProcessorRow(Model):
    """Processor power for one hardware configuration; sensors that are not named are off."""

    navigation: Identifier | None = None
    sensors: Sensors = Field(default_factory=dict)
    power: Power
    source: Text = ""
    status: Literal["", "published", "fitted", "assumed", "measured"] = ""

    @model_validator(mode="after")
    def _tell_power(self) -> "ProcessorRow":
        """Status and source of the row belong to its power."""
        told = replace(self.power, status=self.power.status or self.status, source=self.power.source or self.source)
        self.__dict__["power"] = told
        return self


class SensorRules(Model):
    """Sensors that a scheme needs, and those that it may use, with units."""

    required: Sensors = Field(default_factory=dict)
    optional: Sensors = Field(default_factory=dict)


class BehaviourSpec(Model):
    """How the robot does otherwise than planned: distance ×, speed ×, extra standing time.

    The last four are left to chance, run by run, in a Monte Carlo: obstacles at a mean distance from each other, each
    with a stop of a mean time, and relocalisation at the end of a segment, which fails and is tried again.
    """

    path_stretch: Ratio | None = None
    speed_tracking: Ratio | None = None
    dwell: Duration | None = None
    obstacle_spacing: Distance | None = None
    obstacle_stop: Duration | None = None
    relocalisation_failure: Chance | None = None
    relocalisation_time: Duration | None = None


class SchemeSpec(Model):
    """A control scheme."""

    title: Text = ""
    motion: bool = True
    image_analysis: bool = False
    max_speed: Speed | None = None
    sensors: SensorRules = SensorRules.model_construct()
    default_sensors: Sensors = Field(default_factory=dict)
    navigation: dict[Identifier, SensorRules] = Field(default_factory=dict)
    default_navigation: Identifier | None = None
    processor: tuple[ProcessorRow, ...] = ()
    behaviour: BehaviourSpec = BehaviourSpec.model_construct()

    def sensor_rules(self, navigation: str | None = None) -> tuple[dict[str, int], dict[str, int]]:
        """Required units, and the most units allowed (required ones among them), under a navigation."""
        chosen = self.navigation.get(navigation or self.default_navigation or "", None)
        required = dict(self.sensors.required)
        allowed = dict(self.sensors.optional)
        for rules in [chosen] if chosen is not None else []:
            for name, count in rules.required.items():
                required[name] = max(count, required.get(name, 0))
            for name, count in rules.optional.items():
                allowed[name] = max(count, allowed.get(name, 0))
        for name, count in required.items():
            allowed[name] = max(count, allowed.get(name, 0))
        return required, allowed

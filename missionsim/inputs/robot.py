"""The robot file: body, batteries, components, motion, control schemes and effects."""

import contextlib
import itertools
from dataclasses import replace
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, JsonValue

from missionsim.errors import Fault
from missionsim.inputs import units, values
from missionsim.inputs.base import (
    DescribedFile,
    Expression,
    Identifier,
    Model,
    Name,
    Origin,
    ParameterName,
    Sensors,
    Text,
    alone,
    check_rising,
    either,
    wrong,
)
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.values import QuantityOf


class _CapacityOf(QuantityOf):
    """Energy, or charge when the text is in Ah (converted with the nominal voltage by `BatterySpec`)."""

    def allowed(self) -> str:
        return f"{super().allowed()}, or a charge such as 20 Ah (with nominal_voltage)"

    def _number(self, raw: Any, unit: str = "") -> tuple[float, str]:
        if isinstance(raw, str) and (parts := units.split(raw)) and parts[1]:
            with contextlib.suppress(units.UnitError):
                value, _ = units.parse(raw, "charge")
                if value <= 0:
                    raise wrong("impossible value", f"'{raw}'", "more than 0")
                return value, "C"
        return super()._number(raw, unit)


Capacity = Annotated[Parameter, _CapacityOf("energy", 0.0, 1e12, strict_low=True)]


class ConstantEnergy(Model):
    """The papers' battery: a store of energy, times an ageing factor."""

    kind: Literal["constant_energy"] = "constant_energy"
    ageing: values.Efficiency = Parameter(1.0)


class EquivalentCircuit(Model):
    """Open-circuit voltage over the state of charge, internal resistance, Peukert's law, ageing, cut-off."""

    kind: Literal["equivalent_circuit"]
    open_circuit_voltage: Annotated[
        tuple[tuple[values.Fraction, values.Voltage], ...], Field(min_length=2, max_length=1000)
    ]
    resistance: values.Resistance
    peukert: values.Peukert = Parameter(1.0)
    rated_time: values.Period = Parameter(20 * 3600.0, unit="s")
    ageing: values.Efficiency = Parameter(1.0)
    cut_off: values.Voltage | None = None

    def _check(self) -> None:
        charges = [point[0].value for point in self.open_circuit_voltage]
        voltages = [point[1].value for point in self.open_circuit_voltage]
        check_rising(charges, "states of charge must increase", "0 … 1 in order", "open_circuit_voltage")
        if charges[0] != 0.0 or charges[-1] != 1.0:
            raise wrong("the curve must run from 0 to 1", charges, "first 0, last 1", "open_circuit_voltage")
        if any(later < earlier for earlier, later in pairwise(voltages)):
            raise wrong("voltages must not fall with charge", voltages, "rising voltages", "open_circuit_voltage")
        if self.cut_off is not None and self.cut_off.value >= voltages[-1]:
            allowed = f"below {voltages[-1]:g} V"
            raise wrong("cut-off above the full battery's voltage", self.cut_off.value, allowed, "cut_off")


BatteryModel = Annotated[
    Annotated[ConstantEnergy | EquivalentCircuit, Field(discriminator="kind")],
    BeforeValidator(alone("kind", str), json_schema_input_type=str | ConstantEnergy | EquivalentCircuit),
]


class TaperSpec(Model):
    """Constant current up to a charge, then constant voltage: the power into the battery falls to a part when full."""

    from_: values.Fraction = Field(alias="from")
    end_power: values.Efficiency

    def _check(self) -> None:
        if self.from_.value >= 1.0:
            raise wrong("a taper that begins when the battery is full", "100 %", "from: 80 %", "from")


Lateness = Annotated[Parameter, QuantityOf("duration", -60.0, 60.0)]
Lag = Annotated[Parameter, QuantityOf("duration", 0.0, 60.0)]


class MeterSpec(Model):
    """How far the power in logs is behind the motion in them: a delay (negative: ahead) and a first-order lag."""

    delay: Lateness = Parameter(0.0, unit="s")
    lag: Lag = Parameter(0.0, unit="s")


Relative = Annotated[Parameter, QuantityOf("fraction", 0.0, 100.0, strict_low=True)]
Curve = Annotated[tuple[tuple[values.Temperature, Relative], ...], Field(min_length=2, max_length=1000)]


class TemperatureSpec(Model):
    """Capacity and resistance over the ambient temperature, relative to what the file gives; flat beyond the ends."""

    capacity: Curve | None = None
    resistance: Curve | None = None

    def _check(self) -> None:
        for key in ("capacity", "resistance"):
            degrees = [point[0].value for point in getattr(self, key) or ()]
            check_rising(degrees, "temperatures must increase", "[[0 degC, 80 %], [25 degC, 100 %]]", key)


class BatterySpec(Model):
    """One battery. `capacity` is in J, or in C where the file gives Ah: use `capacity_j`."""

    capacity: Capacity
    nominal_voltage: values.Voltage | None = None
    reserve: values.Fraction = Parameter(0.0, status="assumed")
    initial_charge: values.Fraction = Parameter(1.0, status="assumed")
    model: BatteryModel = ConstantEnergy.model_construct()
    max_charge_power: values.Power | None = None
    charge_efficiency: values.Efficiency = Parameter(1.0, status="assumed")
    charge_taper: TaperSpec | None = None
    over_temperature: TemperatureSpec | None = None
    meter: MeterSpec | None = None

    def _check(self) -> None:
        if self.nominal_voltage is None and self.capacity.unit == "C":
            message, allowed = "a capacity in Ah needs nominal_voltage", "nominal_voltage: 14.8 V"
            raise wrong(message, "no nominal_voltage", allowed, "capacity")

    @property
    def capacity_j(self) -> float:
        """Capacity when new, J."""
        factor = self.nominal_voltage.value if self.capacity.unit == "C" and self.nominal_voltage else 1.0
        return self.capacity.value * factor

    @property
    def capacity_wh(self) -> float:
        """Capacity when new, Wh."""
        return self.capacity_j / 3600.0

    @property
    def capacity_c(self) -> float | None:
        """Capacity when new as charge, C (A s); None where the nominal voltage is unknown."""
        if self.capacity.unit == "C":
            return self.capacity.value
        return self.capacity.value / self.nominal_voltage.value if self.nominal_voltage else None


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

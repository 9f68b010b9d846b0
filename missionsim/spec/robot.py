"""The robot file: body, batteries, components, motion, control schemes and effects."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, JsonValue, StringConstraints, model_validator
from pydantic_core import PydanticCustomError

from missionsim.spec import units
from missionsim.spec.base import FileModel, Identifier, Model, Name, Text
from missionsim.spec.values import (
    Acceleration,
    AnyNumber,
    Duration,
    EffectNumber,
    Efficiency,
    Fraction,
    Frequency,
    Issue,
    Length,
    Mass,
    Parameter,
    Period,
    Peukert,
    Power,
    QuantityOf,
    Ratio,
    Resistance,
    Speed,
    Voltage,
    YawAcceleration,
    YawRate,
)

Drive = Literal["differential", "skid_steer", "mecanum", "omni", "ackermann"]
Count = Annotated[int, Field(strict=True, ge=0, le=1000)]
ParameterName = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=60)]
Expression = Annotated[
    str,
    BeforeValidator(lambda raw: str(raw) if type(raw) in (int, float) else raw),
    StringConstraints(strict=True, min_length=1, max_length=2000),
]
Sensors = dict[Identifier, Count]


class _CapacityOf(QuantityOf):
    """Energy, or charge when the text is in Ah (converted with the nominal voltage by `BatterySpec`)."""

    def _number(self, raw: Any, at: tuple[str | int, ...] = (), unit: str = "") -> tuple[float, str]:
        if isinstance(raw, str) and (parts := units.split(raw)) and parts[1]:
            try:
                value = units.parse_quantity(raw, "charge")
            except units.UnitError:
                pass
            else:
                if value <= 0:
                    raise Issue("impossible value", f"'{raw}'", "more than 0", at=at)
                return value, "C"
        return super()._number(raw, at, unit)


Capacity = Annotated[Parameter, _CapacityOf("energy", 0.0, 1e12, strict_low=True)]


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


class ConstantEnergy(Model):
    """The papers' battery: a store of energy, times an ageing factor."""

    kind: Literal["constant_energy"] = "constant_energy"
    ageing: Efficiency = Parameter(1.0)


class EquivalentCircuit(Model):
    """Open-circuit voltage over the state of charge, internal resistance, Peukert's law, ageing, cut-off."""

    kind: Literal["equivalent_circuit"]
    open_circuit_voltage: Annotated[tuple[tuple[Fraction, Voltage], ...], Field(min_length=2, max_length=1000)]
    resistance: Resistance
    peukert: Peukert = Parameter(1.0)
    rated_time: Period = Parameter(20 * 3600.0, unit="s")
    ageing: Efficiency = Parameter(1.0)
    cut_off: Voltage | None = None

    @model_validator(mode="after")
    def _increasing(self) -> EquivalentCircuit:
        charges = [point[0].value for point in self.open_circuit_voltage]
        voltages = [point[1].value for point in self.open_circuit_voltage]
        if any(later <= earlier for earlier, later in zip(charges, charges[1:], strict=False)):
            raise _wrong("states of charge must increase", charges, "0 … 1 in order", "open_circuit_voltage")
        if charges[0] != 0.0 or charges[-1] != 1.0:
            raise _wrong("the curve must run from 0 to 1", charges, "first 0, last 1", "open_circuit_voltage")
        if any(later < earlier for earlier, later in zip(voltages, voltages[1:], strict=False)):
            raise _wrong("voltages must not fall with charge", voltages, "rising voltages", "open_circuit_voltage")
        if self.cut_off is not None and self.cut_off.value >= voltages[-1]:
            raise _wrong(
                "cut-off above the full battery's voltage", self.cut_off.value, f"below {voltages[-1]:g} V", "cut_off"
            )
        return self


def _named_kind(raw: Any) -> Any:
    return {"kind": raw} if isinstance(raw, str) else raw


BatteryModel = Annotated[
    Annotated[ConstantEnergy | EquivalentCircuit, Field(discriminator="kind")],
    BeforeValidator(_named_kind, json_schema_input_type=str | ConstantEnergy | EquivalentCircuit),
]


class BatterySpec(Model):
    """One battery. `capacity` is in J, or in C where the file gives Ah: use `capacity_j`."""

    capacity: Capacity
    nominal_voltage: Voltage | None = None
    reserve: Fraction = Parameter(0.0, status="assumed")
    initial_charge: Fraction = Parameter(1.0, status="assumed")
    model: BatteryModel = ConstantEnergy()
    max_charge_power: Power | None = None
    charge_efficiency: Efficiency = Parameter(1.0, status="assumed")

    @model_validator(mode="after")
    def _voltage_known(self) -> BatterySpec:
        needs_voltage = self.capacity.unit == "C" or isinstance(self.model, EquivalentCircuit)
        if needs_voltage and self.nominal_voltage is None and self.capacity.unit == "C":
            raise _wrong(
                "a capacity in Ah needs nominal_voltage", "no nominal_voltage", "nominal_voltage: 14.8 V", "capacity"
            )
        return self

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
    rate: Frequency | None = None
    parameters: dict[ParameterName, AnyNumber] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one(self) -> LawSpec:
        if (self.power is None) == (self.model is None):
            raise _wrong(
                "a law has either a power or a model",
                "both" if self.power else "neither",
                'power: "k*rate", or model: multicore_cpu',
            )
        return self


class LoadSpec(Model):
    """What one unit of a component takes from one battery."""

    battery: Identifier
    power: Power | None = None
    law: LawSpec | None = None
    through: Identifier | None = None

    @model_validator(mode="after")
    def _one(self) -> LoadSpec:
        if (self.power is None) == (self.law is None):
            raise _wrong(
                "a load has either a power or a law",
                "both" if self.power else "neither",
                "power: 2.3 W, or law: {power: …}",
            )
        return self


class StartupSpec(Model):
    """Time between switching on and being ready, and the power meanwhile (per unit, on the first load's battery)."""

    duration: Duration
    power: Power | None = None


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
    efficiency: Efficiency = Parameter(1.0)
    title: Text = ""


class SwitchboardSpec(Model):
    """Relay board: its own power for 0, 1, 2… activated relays."""

    battery: Identifier
    power: Annotated[tuple[Power, ...], Field(min_length=1, max_length=100)]
    title: Text = ""


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
    def _tell_power(self) -> ProcessorRow:
        """Status and source of the row belong to its power."""
        told = replace(self.power, status=self.power.status or self.status, source=self.power.source or self.source)
        self.__dict__["power"] = told
        return self


class SensorRules(Model):
    """Sensors that a scheme needs, and those that it may use, with units."""

    required: Sensors = Field(default_factory=dict)
    optional: Sensors = Field(default_factory=dict)


class BehaviourSpec(Model):
    """How the robot does otherwise than planned: distance ×, speed ×, extra standing time."""

    path_stretch: Ratio | None = None
    speed_tracking: Ratio | None = None
    dwell: Duration | None = None


class SchemeSpec(Model):
    """A control scheme."""

    title: Text = ""
    motion: bool = True
    image_analysis: bool = False
    max_speed: Speed | None = None
    sensors: SensorRules = SensorRules()
    default_sensors: Sensors = Field(default_factory=dict)
    navigation: dict[Identifier, SensorRules] = Field(default_factory=dict)
    default_navigation: Identifier | None = None
    processor: tuple[ProcessorRow, ...] = ()
    behaviour: BehaviourSpec = BehaviourSpec()

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


class MotionSpec(Model):
    """Base power of moving, on one battery; `model` is a registered motion model, ``expression`` or ``none``."""

    battery: Identifier
    model: Identifier = "polynomial"
    power: Expression | None = None
    standing: Expression | None = None
    parameters: dict[ParameterName, AnyNumber] = Field(default_factory=dict)
    options: dict[Identifier, JsonValue] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _expression(self) -> MotionSpec:
        if self.model == "expression" and self.power is None:
            raise _wrong("motion model 'expression' needs 'power'", "no power", 'power: "c3*v + c4"')
        if self.model != "expression" and self.power is not None:
            raise _wrong(
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
    def _one(self) -> EffectSpec:
        if (self.effect is None) == (self.power is None):
            raise _wrong(
                "an effect is one of the library or an expression",
                "both" if self.effect else "neither",
                'effect: grade, or name: my_term with power: "k * …"',
            )
        if self.effect is None and self.name is None:
            raise _wrong("an effect of your own needs a name", "no name", "name: my_term")
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
    effects: tuple[EffectSpec, ...] = ()
    idle_scheme: Identifier | None = None

    @property
    def sensor_names(self) -> tuple[str, ...]:
        """Components that any scheme's table, rules or navigation names: the ones that make a hardware configuration."""
        found: dict[str, None] = {}
        for scheme in self.schemes.values():
            for rules in (scheme.sensors, *scheme.navigation.values()):
                found |= dict.fromkeys([*rules.required, *rules.optional])
            for row in scheme.processor:
                found |= dict.fromkeys(row.sensors)
        return tuple(name for name in self.components if name in found)

    def processor_power(self, scheme: str | None, navigation: str | None, sensors: Mapping[str, int]) -> Parameter:
        """Processor power of a hardware configuration, W.

        Parameters
        ----------
        scheme, navigation : str or None
            None is idle: `processor.idle` (or 0 W).
        sensors : mapping
            Units that are on; components that no scheme names are ignored.

        Returns
        -------
        Parameter
            The row's power; with status ``assumed`` and a note where the nearest row had to be taken.

        Raises
        ------
        KeyError
            Unknown scheme, or no row and `processor.fallback` is ``refuse``.
        """
        zero = Parameter(0.0, unit="W")
        if self.processor is None:
            return zero
        if scheme is None and self.idle_scheme is not None:
            scheme = self.idle_scheme
        if scheme is None:
            return self.processor.idle or zero
        spec = self.schemes[scheme]
        if not spec.processor:
            return self.processor.idle or zero
        known = self.sensor_names
        wanted = {name: int(count) for name, count in sensors.items() if count and name in known}
        nav = navigation if navigation in spec.navigation else spec.default_navigation
        rows = [row for row in spec.processor if row.navigation in (None, nav)] or list(spec.processor)

        def differing(row: ProcessorRow) -> int:
            names = {*wanted, *row.sensors}
            return sum(abs(wanted.get(name, 0) - row.sensors.get(name, 0)) for name in names)

        best = min(rows, key=lambda row: (differing(row), row.navigation is None, -row.power.value))
        if differing(best) == 0:
            return best.power
        if self.processor.fallback == "refuse":
            raise KeyError(f"no processor power for {scheme}, {nav or 'no navigation'}, {wanted or 'no sensors'}")
        return replace(
            best.power, status="assumed", note=f"nearest row: {best.navigation or scheme} with {dict(best.sensors)}"
        )


def _wrong(message: str, got: object, allowed: str, *at: str) -> PydanticCustomError:
    entry = {"message": message, "got": str(got), "allowed": allowed, "hint": "", "at": at}
    return PydanticCustomError("quantity", "{text}", {"text": message, "entries": [entry]})

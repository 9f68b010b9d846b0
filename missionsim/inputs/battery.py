"""Batteries of a robot file."""

import contextlib
from itertools import pairwise
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from missionsim.inputs import units, values
from missionsim.inputs.base import Model, alone, check_rising, wrong
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

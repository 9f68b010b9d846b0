"""From the battery of a robot file to the engine's battery."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from missionsim.engine.batteries import Battery, ConstantEnergy, EquivalentCircuit
from missionsim.inputs.battery import BatterySpec
from missionsim.inputs.battery import EquivalentCircuit as CircuitSpec
from missionsim.inputs.values import Parameter


def build_battery(name: str, spec: BatterySpec, number: Callable[[Parameter], float], initial: float) -> Battery:
    """The battery of a robot file.

    Parameters
    ----------
    name : str
    spec : BatterySpec
    number : callable
        Value of a parameter, drawn or nominal.
    initial : float
        State of charge at the start, as a fraction.

    Notes
    -----
    The capacity of an `equivalent_circuit` is the energy under its open-circuit curve, times the charge, times the
    ageing factor; a capacity in Wh becomes a charge through the nominal voltage, or the mean of the curve.
    """
    factor = spec.nominal_voltage.value if spec.capacity.unit == "C" and spec.nominal_voltage else 1.0
    new_j = number(spec.capacity) * factor
    aged = number(spec.model.ageing)
    if not isinstance(spec.model, CircuitSpec):
        capacity = new_j * aged
        return ConstantEnergy(name, capacity, initial * capacity)
    circuit = spec.model
    states = np.array([number(point[0]) for point in circuit.open_circuit_voltage])
    volts = np.array([number(point[1]) for point in circuit.open_circuit_voltage])
    if spec.capacity.unit == "C":
        charge = number(spec.capacity)
    else:
        charge = new_j / (number(spec.nominal_voltage) if spec.nominal_voltage else float(np.trapezoid(volts, states)))
    return EquivalentCircuit(
        name,
        float(np.trapezoid(volts, states)) * charge * aged,
        initial,
        charge * aged,
        (states, volts),
        number(circuit.resistance),
        number(circuit.peukert),
        number(circuit.rated_time),
        0.0 if circuit.cut_off is None else number(circuit.cut_off),
    )

"""What a run is set up from: numbers of the files or drawn ones, batteries, covariates that the model reads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.engine.batteries import Battery, ConstantEnergy, EquivalentCircuit
from missionsim.errors import Fault, InputError
from missionsim.inputs.battery import BatterySpec
from missionsim.inputs.battery import EquivalentCircuit as CircuitSpec
from missionsim.inputs.values import Parameter
from missionsim.physics import Array
from missionsim.plan.asked import EXTRAS
from missionsim.plan.legs import Plan

T = TypeVar("T", float, Array)

_BODY = (("body_mass_kg", "body.mass"), ("regeneration", "body.regeneration"))
"""Constants of the power model and where the robot file has them."""
PIECES = 8
"""Of constant power in which a battery's charge is topped up at constant voltage."""


def build_battery(
    name: str,
    spec: BatterySpec,
    number: Callable[[Parameter], float],
    initial: float,
    temperature_c: float | None = None,
) -> Battery:
    """The battery of a robot file.

    `number`: value of a parameter, drawn or nominal; `initial`: state of charge at the start, as a fraction;
    `temperature_c`: ambient, for batteries whose capacity or resistance depends on it.

    The capacity of an `equivalent_circuit` is the energy under its open-circuit curve, times the charge, times the
    ageing factor; a capacity in Wh becomes a charge through the nominal voltage, or the mean of the curve.
    """
    factor = spec.nominal_voltage.value if spec.capacity.unit == "C" and spec.nominal_voltage else 1.0
    new_j = number(spec.capacity) * factor
    over = spec.over_temperature
    aged = number(spec.model.ageing) * (1.0 if over is None else _at(over.capacity, temperature_c, number))
    steps = _taper(spec, number)
    if not isinstance(spec.model, CircuitSpec):
        capacity = new_j * aged
        return ConstantEnergy(name, capacity, initial * capacity, steps)
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
        number(circuit.resistance) * (1.0 if over is None else _at(over.resistance, temperature_c, number)),
        number(circuit.peukert),
        number(circuit.rated_time),
        0.0 if circuit.cut_off is None else number(circuit.cut_off),
        steps,
    )


def _at(curve: Any, temperature_c: float | None, number: Callable[[Parameter], float]) -> Any:
    """What a curve over temperature gives; 1 without a curve or where no temperature is known."""
    if curve is None or temperature_c is None:
        return 1.0
    degrees, parts = (np.array([number(point[i]) for point in curve]) for i in (0, 1))
    made = np.asarray(np.interp(temperature_c, degrees, parts))
    return float(made) if made.ndim == 0 else made


def _taper(spec: BatterySpec, number: Callable[[Parameter], float]) -> tuple[tuple[float, float], ...]:
    """Up to which charge which part of the full power goes into a battery; the last up to full.

    At constant voltage current and power fall in proportion to what is missing, down to `end_power`. The pieces take
    as long as this does: their power is the logarithmic mean of that at their ends.
    """
    taper = spec.charge_taper
    if taper is None or (end := number(taper.end_power)) >= 1.0:
        return ((1.0, 1.0),)
    begin = number(taper.from_)
    levels = np.linspace(begin, 1.0, PIECES + 1)
    powers = np.linspace(1.0, end, PIECES + 1)
    parts = (powers[:-1] - powers[1:]) / np.log(powers[:-1] / powers[1:])
    return ((begin, 1.0), *zip(levels[1:].tolist(), parts.tolist(), strict=True))


def check_covariates(plan: Plan, model: PowerModel) -> None:
    """Refuse a mission that does not say what the robot's effects need to know (temperature, processor load…).

    Raises InputError: with the effect, the column and a segment that lacks it.
    """
    keys = {column: key for key, column in EXTRAS}
    wanted = {name: term.effect for term in model.terms for name in term.effect.needs if name in keys}
    if not wanted:
        return
    faults: dict[str, Fault] = {}
    for leg in plan.legs:
        known = dict(leg.settings.extra)
        for name, effect in wanted.items():
            if name not in known and name not in faults:
                segment = plan.segments[leg.segment]
                faults[name] = effect.place.fault(
                    f"effect '{effect.id}' of the robot needs '{keys[name]}', which segment '{segment.name}' lacks",
                    allowed=f"defaults: {{{keys[name]}: …}}, or a value on the segment",
                )
    if faults:
        raise InputError(faults.values())


def split_values(values: Mapping[str, T], model: PowerModel) -> tuple[dict[str, T], dict[str, T]]:
    """Numbers of files by path, and parameters of the power model; a path into the robot file is both."""
    if not values:
        return {}, {}
    numbers = {name: value for name, value in values.items() if "/" not in name}
    drawn = {name: value for name, value in values.items() if "/" in name}
    if any(name.startswith("robot.") for name in numbers):
        for name, parameter in model.parameters.items():
            path = f"robot.{parameter.path}"
            if parameter.path and path in numbers:
                drawn.setdefault(name, numbers[path] * parameter.times if parameter.times != 1.0 else numbers[path])
        for name, path in [*_BODY, *{(term.link[0], term.link[0]) for term in model.terms if term.link[0]}]:
            if f"robot.{path}" in numbers:
                drawn.setdefault(name, numbers[f"robot.{path}"])
    return numbers, drawn

"""What a run is set up from: numbers, files' or drawn, batteries, covariates; and what in a run is strange."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, TypeVar

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.effects.timeline import Timeline
from missionsim.engine.batteries import Battery, ConstantEnergy, EquivalentCircuit
from missionsim.engine.meter import Energies
from missionsim.engine.outcome import J_PER_WH
from missionsim.errors import Fault, InputError
from missionsim.expressions import Place
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import BatterySpec
from missionsim.inputs.robot import EquivalentCircuit as CircuitSpec
from missionsim.labels import Labels
from missionsim.numerals import rounded
from missionsim.physics import Array, Int64s
from missionsim.plan.asked import EXTRAS
from missionsim.plan.legs import Plan, SegmentInfo
from missionsim.runs.covariates import COVARIATES

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

    def at_temperature(what: str) -> float:
        """What a curve over temperature gives; 1 without a curve or where no temperature is known."""
        curve = getattr(spec.over_temperature, what, None)
        if curve is None or temperature_c is None:
            return 1.0
        degrees, parts = (np.array([number(point[i]) for point in curve]) for i in (0, 1))
        made: Any = np.asarray(np.interp(temperature_c, degrees, parts))
        return float(made) if made.ndim == 0 else made  # of many runs, arrays

    factor = spec.nominal_voltage.value if spec.capacity.unit == "C" and spec.nominal_voltage else 1.0
    new_j = number(spec.capacity) * factor
    aged = number(spec.model.ageing) * at_temperature("capacity")
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
        number(circuit.resistance) * at_temperature("resistance"),
        number(circuit.peukert),
        number(circuit.rated_time),
        0.0 if circuit.cut_off is None else number(circuit.cut_off),
        steps,
    )


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
    """Refuse a mission that does not say what the robot's effects need to know (temperature, processor load…). Raises
    InputError: with the effect, the column and a segment that lacks it."""
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


BEYOND = 0.05
"""Part of the range of the logs by which a mission may leave it before that is told."""
TOLERANCE = 1e-9
"""Relative to the energy of the battery's terms, or to its capacity: below it is rounding."""


def doubts(
    model: PowerModel,
    line: Timeline,
    energies: Energies,
    charge_wh: Mapping[str, Array],
    batteries: Mapping[str, Battery],
    segments: Sequence[SegmentInfo],
    places: Mapping[str, Place],
    file: str,
) -> tuple[Fault, ...]:
    """Warnings about batteries that are charged by what should draw from them.

    A component or a law with negative power is told wherever it has it; a formula of motion or of an added effect where
    the whole battery is charged, unless that is while braking or descending of a robot that regenerates. Terms that the
    engine itself limits to what a robot gives back are none of it. `energies`: battery → term key → energy of each
    interval [J], shape (n,); `charge_wh` (shape (n,)): at the end of each interval; `places`: of the batteries in the
    robot file. They stand at the place of the formula; what leaves the range of the logs, at its segment in `file`.
    """
    found: list[Fault] = []
    if not len(line):
        return ()
    back = np.zeros(len(line), dtype=bool)  # where a robot that regenerates slows down or descends
    if float(model.constants.get("regeneration", 0.0)) > 0.0:
        back = np.asarray((line.columns["accel_m_s2"] < 0.0) | (line.columns["slope_rad"] < 0.0))
    for term in model.terms:
        joules = energies[term.key.battery].get(term.key)
        if joules is None or term.effect.recovers or term.effect.back or not (negative := joules < 0.0).any():
            continue
        parts = energies[term.key.battery].values()
        scale = float(sum(np.abs(part).sum() for part in parts))
        if term.effect.id not in _OF_COMPONENTS:
            negative = negative & (np.sum(list(parts), axis=0) < 0.0) & ~back
        if (given := -float(joules[negative].sum())) <= TOLERANCE * scale:
            continue
        told = (
            f"the power of '{term.key.name}' is negative: it charges battery '{term.key.battery}' with "
            f"{rounded(given / J_PER_WH, 4)} Wh in {_named(line.segment[negative], segments)}; is the sign right?"
        )
        allowed = "power that is drawn is positive"
        found.append(term.effect.place.warning(told, got=term.effect.equation, allowed=allowed))
    for name, battery in batteries.items():
        full = battery.capacity_j / J_PER_WH
        beyond = charge_wh[name] > full * (1.0 + TOLERANCE)
        if beyond.any():
            most = float(charge_wh[name].max())
            found.append(
                places[name].warning(
                    f"battery '{name}' comes to {100.0 * most / full:.4g} % of its capacity in "
                    f"{_named(line.segment[beyond], segments)}: more than it can hold, {rounded(most - full, 4)} Wh "
                    "beyond full; the surplus is counted as if it were kept"
                )
            )
    return (*found, *_beyond(model, line, segments, file))


def _beyond(model: PowerModel, line: Timeline, segments: Sequence[SegmentInfo], file: str) -> list[Fault]:
    """Warnings where the mission leaves the range of the logs that the model's effects were fitted to."""
    read = {name for term in model.terms for name in (*term.effect.needs, term.effect.covariate)} | _ALWAYS_TOLD
    found: list[Fault] = []
    floors = line.columns.get("surface")
    if model.floors and isinstance(floors, Labels):
        for number, floor in enumerate(floors.names):
            strange = floors.codes == number
            if floor and floor not in model.floors and np.any(strange):
                numbers = line.segment[np.broadcast_to(strange, (len(line),))]
                there, place = _named(numbers, segments), Place(file, segments[int(numbers[0])].line)
                measured = ", ".join(sorted(model.floors))
                told = f"floor '{floor}' in {there}: the logs that this robot was fitted to have {measured}"
                found.append(place.warning(told, got=floor, allowed=measured))
    for name, (low, high) in model.known.items():
        one = COVARIATES.get(name)
        if one is None or one.text or name not in read or name not in line.columns:
            continue
        values = np.broadcast_to(np.asarray(line.columns[name], dtype=float), (len(line),))
        if one.magnitude:
            values, low, high = np.abs(values), 0.0, max(abs(low), abs(high))
        if name == "speed_m_s":
            low = min(low, 0.0)  # every drive begins at rest
        room = BEYOND * (high - low)
        over = np.maximum(values - high, low - values)
        if not np.any(over > room):
            continue
        worst = int(np.argmax(over))
        measured = f"{low * one.factor:.3g} to {high * one.factor:.3g} {one.unit}".strip()
        there = f"{values[worst] * one.factor:.3g} {one.unit}".strip()
        worst_in = int(line.segment[worst])
        message = (
            f"{one.title} {there} in {_named(line.segment[over > room], segments, worst_in)}: the logs that this "
            f"robot was fitted to have {measured}"
        )
        found.append(Place(file, segments[worst_in].line).warning(message, got=there, allowed=measured))
    return found


_ALWAYS_TOLD = {"slope_rad", "payload_kg"}
"""Told even where no term reads them: a base that was fitted on the level knows nothing of a ramp."""
_OF_COMPONENTS = ("law", "component", "always_on", "startup", "switchboard", "processor")


def _named(numbers: Int64s, segments: Sequence[SegmentInfo], first: int | None = None) -> str:
    """Segments by name, `first` before the others."""
    ordered = sorted(np.unique(numbers).tolist(), key=lambda i: i != first)
    names = list(dict.fromkeys(segments[i].label or segments[i].name for i in ordered))
    more = f" and {len(names) - 1} more" if len(names) > 1 else ""
    return f"segment '{names[0]}'{more}"

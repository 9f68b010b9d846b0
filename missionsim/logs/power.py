"""Measured power of each battery, from power, voltage × current or cumulative energy, and which rows are refreshes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import Fault, did_you_mean
from missionsim.glossary import COLUMNS, column_of
from missionsim.logs.raw import ColumnData
from missionsim.physics import Array

Bools = NDArray[np.bool_]

_SLOW_SHARE = 0.3
"""Share of repeated neighbours above which a column may come from a slower topic."""
_SLOWEST_S = 15.0
"""A refresh slower than this is not a topic's rate but a value that stays."""


MEASURED = "power_<battery>_w, or voltage_<battery>_v and current_<battery>_a, or energy_<battery>_wh"
"""Columns of which a log needs some."""


def measured_batteries(names: Iterable[str]) -> dict[str, str]:
    """Battery → what its power comes from: ``power``, ``voltage*current`` or ``energy``, in column order."""
    kinds: dict[str, set[str]] = {}
    for name in names:
        found = column_of(name)
        if found is not None and "<battery>" in found[0].name:
            kinds.setdefault(found[1], set()).add(found[0].name.split("_")[0])
    ways = (("power", {"power"}), ("voltage*current", {"voltage", "current"}), ("energy", {"energy"}))
    chosen = {battery: next((way for way, needs in ways if needs <= have), "") for battery, have in kinds.items()}
    return {battery: way for battery, way in chosen.items() if way}


def measures(name: str) -> bool:
    """Whether a column belongs to what is measured of a battery."""
    found = column_of(name)
    return found is not None and "<battery>" in found[0].name


def missing_columns(names: Iterable[str], file: str, header_line: Callable[[], int]) -> list[Fault]:
    """Faults for the columns that every log has to have (`header_line` is called only where there are any)."""
    names = list(names)
    faults = []
    known = [column.name.replace("<battery>", "robot") for column in COLUMNS if "<component>" not in column.name]
    if "time_s" not in names:
        near = did_you_mean("time_s", [name for name in names if column_of(name) is None], 0.4)
        allowed, hint = "time in seconds from the start of the run", f"rename '{near}' or use a map" if near else ""
        told, got = "the column 'time_s' is missing", ", ".join(names)[:200]
        faults.append(Fault(file, header_line(), 0, told, "time_s", got, allowed, hint))
    if not measured_batteries(names):
        half = {"voltage_<battery>_v": "current_{}_a", "current_<battery>_a": "voltage_{}_v"}
        of = {name: found for name in names if (found := column_of(name)) is not None}
        hints = [f"'{half[c.name].format(b)}' beside '{name}'" for name, (c, b) in of.items() if c.name in half]
        alike = ("power", "volt", "curr", "energy", "battery", "watt", "p_")
        if not hints and (name := next((name for name in names if name not in of and name.startswith(alike)), "")):
            near = did_you_mean(name, known, 0.5)
            hints = [f"'{name}' as {near or 'power_robot_w'} (rename it, or use a map)"]
        told, got = "no battery is measured", ", ".join(names)[:200]
        faults.append(Fault(file, header_line(), 0, told, "power_<battery>_w", got, MEASURED, *hints[:1]))
    return faults


@dataclass(frozen=True)
class Refresh:
    """How often a column really changes."""

    fresh: Bools
    """Rows with a new value. Shape (n,)."""
    period_s: float
    """Typical time between them [s]."""


def refreshes(values: Array, time_s: Array) -> Refresh | None:
    """Find out whether a column repeats the values of a slower topic.

    `values`, `time_s`: shape (n,). Gives None where the column changes in most rows, or stays for other reasons: at a
    plateau, or standing still.

    A slower topic shows as runs of equal values of nearly equal length whose values hardly ever come back; a coarse
    meter or a robot that stands still gives runs of every length, or few distinct values.
    """
    n = len(values)
    if n < 20:
        return None
    if float(np.ptp(values)) <= 1e-6 * float(np.abs(values).max()):
        return None  # a constant with rounding noise
    change = np.r_[True, values[1:] != values[:-1]]
    starts = np.flatnonzero(change)
    if len(starts) < 5 or len(starts) > (1 - _SLOW_SHARE) * n:
        return None
    lengths = np.diff(np.r_[starts, n])[1:-1]
    alive = values[starts][1:-1] != 0.0
    if alive.sum() < 4:
        return None
    lengths = lengths[alive]
    typical = float(np.median(lengths))
    step_s = float(np.median(np.diff(time_s[: min(n, 20000)])))
    distinct = len(np.unique(values[starts[:2000]])) / min(len(starts), 2000)
    regular = float(np.mean(np.abs(lengths - typical) <= max(1.0, 0.35 * typical)))
    if typical < 2 or typical * step_s > _SLOWEST_S or distinct < 0.25 or regular < 0.6:
        return None
    return Refresh(change, typical * step_s)


def power_from_energy(energy_wh: Array, time_s: Array) -> tuple[Array, Bools | None]:
    """Mean power around each row from a cumulative energy.

    `energy_wh` (shape (n,)): cumulative energy at each row [Wh]; `time_s` (shape (n,)): [s]. Gives `power_w` (shape
    (n,)): [W]. Where the counter moves in most rows: the energy between the half-way points to the neighbours, over
    that time. Where it moves in fewer rows: its increment over the time since it moved before. `fresh`: rows in which
    the counter moved; None for the first case.
    """
    n = len(time_s)
    moved = np.flatnonzero(np.diff(energy_wh) != 0.0) + 1
    if n < 3 or len(moved) >= 0.8 * (n - 1):
        after, before = np.minimum(np.arange(n) + 1, n - 1), np.maximum(np.arange(n) - 1, 0)
        return (energy_wh[after] - energy_wh[before]) / (time_s[after] - time_s[before]) * 3600.0, None
    if not len(moved):
        return np.zeros(n), None
    edges = np.r_[0, moved]
    mean_w = np.diff(energy_wh[edges]) / np.diff(time_s[edges]) * 3600.0
    counts = np.diff(edges)
    power = np.empty(n)
    power[0] = mean_w[0]
    power[1 : edges[-1] + 1] = np.repeat(mean_w, counts)
    power[edges[-1] + 1 :] = mean_w[-1]
    fresh = np.zeros(n, dtype=bool)
    fresh[moved] = True
    return power, fresh


def battery_power(columns: Mapping[str, ColumnData], battery: str, kind: str) -> tuple[Array, Bools | None]:
    """Power of one battery [W], shape (n,), and its refresh mask where the kind of column gives one."""
    if kind == "power":
        return np.array(columns[f"power_{battery}_w"], dtype=np.float64), None
    if kind == "voltage*current":
        return np.asarray(columns[f"voltage_{battery}_v"]) * np.asarray(columns[f"current_{battery}_a"]), None
    return power_from_energy(np.asarray(columns[f"energy_{battery}_wh"]), np.asarray(columns["time_s"]))

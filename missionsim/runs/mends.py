"""A run without one fault that its log may have: another unit or sign, an inverted switch, a column that hangs."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from missionsim.physics import Array
from missionsim.runs.covariates import is_switch
from missionsim.runs.run import Run

SPEEDS = {3.6: "km/h", 2.2369: "mph", 3.2808: "ft/s", 100.0: "cm/s", 1000.0: "mm/s", 1.0 / 3.6: "m/s divided by 3.6"}
STANDS = 0.15
"""Part of a run over which a column must stand still to be looked at."""
LARGER = 1.5
"""Times the values of any other run, from which a column may be in another unit (assumed)."""


def larger(name: str, run: Run, others: Sequence[Run]) -> int:
    """1 where a column of a run is larger than in any other run, −1 where it is smaller, else 0."""
    sizes = np.array([np.quantile(np.abs(one.number(name)), (0.95, 0.99)) for one in others if name in one.columns])
    low, high = np.quantile(np.abs(run.number(name)), (0.95, 0.99))
    if not len(sizes):
        return 0
    return int(low > LARGER * sizes[:, 1].max()) - int(high < sizes[:, 0].min() / LARGER)


def divided(run: Run, name: str, factor: float) -> Run:
    """A run with a column divided by a factor; an acceleration that belongs to another speed goes."""
    gone = "accel_m_s2" if name == "speed_m_s" else ""
    columns = {own: data for own, data in run.columns.items() if own != gone}
    return replace(run, columns={**columns, name: run.number(name) / factor})


def mended(run: Run, others: Sequence[Run]) -> Iterator[tuple[str, Run]]:
    """A run without one fault that its log may have, and the fault in words."""
    for name, factors in _FACTORS.items():
        if name in run.columns:
            size = larger(name, run, others)
            for factor, words in factors.items():
                if (factor > 0.0 and (factor > 1.0) != (size > 0)) or size == 0 < factor:
                    continue
                yield f"{name} {words}", divided(run, name, factor)
    for name in filter(is_switch, run.columns):
        state = run.number(name)
        if {*np.unique(state).tolist()} == {0.0, 1.0}:
            yield (
                f"{name} is 1 where it should be 0 (inverted?)",
                replace(run, columns={**run.columns, name: 1.0 - state}),
            )
    for name in ("speed_m_s", "slope_rad", "yaw_rate_rad_s", *(f"power_{battery}_w" for battery in run.power_w)):
        if name in run.columns and (stretch := _standing(run.number(name))):
            first, last = stretch
            keep = np.ones(run.rows, dtype=bool)
            keep[first : last + 1] = False
            since, till = run.time_s[first], run.time_s[last]
            yield (
                f"{name} stands at {run.number(name)[first]:.4g} from {since:.6g} to {till:.6g} s",
                run.rows_where(keep),
            )


_FACTORS: Mapping[str, Mapping[float, str]] = {
    "slope_rad": {
        -1.0: "has the other sign",
        180.0 / np.pi: "is 57 or 100 times too large (degrees or per cent?)",
        100.0: "is 57 or 100 times too large (degrees or per cent?)",
    },
    "speed_m_s": {factor: f"is {factor:.3g} times too large ({unit}?)" for factor, unit in SPEEDS.items()},
    "yaw_rate_rad_s": {180.0 / np.pi: "is 57.3 times too large (degrees?)"},
    "accel_m_s2": {-1.0: "has the other sign", 9.81: "is 9.81 times too large (g?)"},
}


def _standing(values: Array) -> tuple[int, int] | None:
    """First and last row of the longest stretch of one value, where it is much of the run."""
    starts = np.flatnonzero(np.diff(values, prepend=np.nan) != 0.0)
    lengths = np.diff(np.r_[starts, len(values)])
    longest = int(np.argmax(lengths))
    if not STANDS * len(values) < lengths[longest] < 0.95 * len(values):
        return None
    return int(starts[longest]), int(starts[longest] + lengths[longest] - 1)

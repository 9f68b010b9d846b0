"""Sums over rows from which a comparison is made: per battery, run and axis, in one pass over blocks."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.compare.axes import Axis, LabelAxis, NumberAxis
from missionsim.compare.place import PlaceGrid
from missionsim.compare.recorder import Series
from missionsim.compare.replay import ReplayBlock
from missionsim.compare.stages import Driven
from missionsim.effects.covariates import is_moving, is_text
from missionsim.effects.model import TermKey
from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S
from missionsim.labels import Labels

ACCELERATING_M_S2 = 0.05
"""Rate of the speed from which the robot counts as speeding up or slowing down."""
MOTIONS = ("standing", "driving straight", "turning on the spot", "driving a curve", "speeding up", "slowing down")
_NUMBERS: tuple[tuple[str, str, str, float, bool], ...] = (
    ("speed_m_s", "speed", "m/s", 1.0, False),
    ("yaw_rate_rad_s", "yaw rate (magnitude)", "rad/s", 1.0, True),
    ("accel_m_s2", "acceleration", "m/s²", 1.0, False),
    ("lateral_speed_m_s", "sideways speed (magnitude)", "m/s", 1.0, True),
    ("slope_rad", "slope", "°", 180.0 / math.pi, False),
    ("payload_kg", "payload", "kg", 1.0, False),
    ("temp_ambient_c", "ambient temperature", "°C", 1.0, False),
    ("temp_motor_c", "motor temperature", "°C", 1.0, False),
    ("cpu_load", "processor load", "", 1.0, False),
    ("cpu_freq_hz", "processor clock", "GHz", 1e-9, False),
    ("access_point_distance_m", "distance to the access point", "m", 1.0, False),
)
_TEXTS = (("surface", "surface"), ("scheme", "control scheme"), ("navigation", "navigation"), ("segment", "segment"))


@dataclass
class RunSums:
    """Sums of one battery over one run.

    Attributes
    ----------
    seconds, measured_j, model_j, square_w2s : float
        Time, measured and modelled energy, integral of the squared power error.
    series : Series
        Power over time, joined to a bounded number of points.
    terms : dict of TermKey to float
        Modelled energy by term [J].
    """

    seconds: float = 0.0
    measured_j: float = 0.0
    model_j: float = 0.0
    square_w2s: float = 0.0
    series: Series = field(default_factory=Series)
    terms: dict[TermKey, float] = field(default_factory=dict)


class Accumulator:
    """Everything that a comparison keeps of the rows.

    Parameters
    ----------
    by : iterable of str
        Further log columns to look at.
    behaviour : bool
        Whether way and time are summed per control scheme, to be held against a plan.
    """

    def __init__(self, by: Iterable[str] = (), behaviour: bool = False) -> None:
        self.axes: dict[str, Axis] = {}
        self.places = PlaceGrid()
        self.runs: dict[str, dict[str, RunSums]] = {}
        self.rows = 0
        self.driven: dict[str, Driven] | None = {} if behaviour else None
        self._by = tuple(by)

    def add(self, run: str, block: ReplayBlock) -> None:
        """Add the rows of a block of `run`."""
        self.rows += len(block.time_s)
        placed = list(self._cells(run, block))
        segment = next((cells for axis, cells in placed if axis.name == "segment"), None)
        weights: dict[str, NDArray[np.float64]] = {}
        for battery, measured in block.measured_w.items():
            model = block.model_w[battery]
            error = model - measured
            gap = -error * block.dt_s
            square = -error * gap
            weights |= {f"{battery}:gap": gap, f"{battery}:square": square, f"{battery}:seconds": block.dt_s}
            self._add_run(run, battery, block, float(gap.sum()), float(square.sum()), segment)
        if self.driven is not None:
            _add_driven(self.driven, block)
        for axis, cells in placed:
            axis.add(cells, weights)
        self.places.add(block.covariates, weights)

    def segment_names(self) -> tuple[str, ...]:
        """Names of the segments by the codes in the series; empty where the logs name none."""
        axis = self.axes.get("segment")
        return axis.names if isinstance(axis, LabelAxis) else ()

    def _add_run(
        self, run: str, battery: str, block: ReplayBlock, gap_j: float, square: float, segment: NDArray[np.int64] | None
    ) -> None:
        sums = self.runs.setdefault(run, {}).setdefault(battery, RunSums())
        measured = _dot(block.measured_w[battery], block.dt_s)
        seconds = float(block.dt_s.sum())
        sums.seconds += seconds
        sums.measured_j += measured
        sums.model_j += measured - gap_j
        sums.square_w2s += square
        sums.series.add(block.time_s, block.dt_s, block.measured_w[battery], block.model_w[battery], segment)
        for key, power in block.terms[battery].items():
            joules = _dot(power, block.dt_s) if np.ndim(power) else float(power) * seconds
            sums.terms[key] = sums.terms.get(key, 0.0) + joules

    def _cells(self, run: str, block: ReplayBlock) -> Iterable[tuple[Axis, NDArray[np.int64]]]:
        cov = block.covariates
        for name, column, fresh in _axis_columns(run, block, self._by):
            axis = self.axes.setdefault(name, fresh)
            cells = axis.place(column)
            if cells is not None:
                yield axis, cells
        if "speed_m_s" in cov:
            motion = Labels(kinds_of_motion(cov), MOTIONS)
            axis = self.axes.setdefault("motion", LabelAxis("motion", "kind of motion"))
            cells = axis.place(motion)
            assert cells is not None
            yield axis, cells


def _add_driven(driven: dict[str, Driven], block: ReplayBlock) -> None:
    cov, count = block.covariates, len(block.time_s)
    zero = np.zeros(count)
    speed = np.hypot(cov.get("speed_m_s", zero), cov.get("lateral_speed_m_s", zero))
    driving = speed >= STILL_SPEED_M_S
    standing = ~np.asarray(is_moving({"speed_m_s": zero, **cov}))
    scheme = cov.get("scheme")
    labels = scheme if isinstance(scheme, Labels) else Labels(np.full(count, -1, dtype=np.int64), ())
    for code, name in [*enumerate(labels.names), (-1, "")]:
        rows = labels.codes == code
        if not rows.any():
            continue
        seconds = np.where(rows, block.dt_s, 0.0)
        sums = driven.setdefault(name, Driven())
        sums.distance_m += _dot(speed[driving], seconds[driving])
        sums.driving_s += float(seconds[driving].sum())
        sums.turning_s += float(seconds[~driving & ~standing].sum())
        sums.standing_s += float(seconds[standing].sum())
        for battery, model in block.model_w.items():
            sums.energy_j[battery] = sums.energy_j.get(battery, 0.0) + _dot(model, seconds)


def kinds_of_motion(cov: Mapping[str, Any]) -> NDArray[np.int64]:
    """Index into `MOTIONS` of each row, shape (n,)."""
    speed = np.abs(cov["speed_m_s"])
    moving = np.asarray(is_moving(cov))
    turning = np.abs(cov.get("yaw_rate_rad_s", np.zeros(len(speed)))) >= 2.0 * STILL_YAW_RATE_RAD_S
    kinds = moving * np.where(turning, 3, 1)
    kinds[turning & (speed < STILL_SPEED_M_S)] = 2
    rate = np.sign(cov["speed_m_s"]) * cov["accel_m_s2"]
    straight = kinds == 1
    kinds[straight & (rate > ACCELERATING_M_S2)] = 4
    kinds[straight & (rate < -ACCELERATING_M_S2)] = 5
    return np.asarray(kinds, dtype=np.int64)


def _dot(a: NDArray[np.float64], b: NDArray[np.float64]) -> float:
    # not BLAS, whose threads cost more than these short products and round by their number
    return float(np.einsum("i,i->", a, b))


def _axis_columns(run: str, block: ReplayBlock, by: tuple[str, ...]) -> Iterable[tuple[str, Any, Axis]]:
    """Name, column and a new axis of everything in a block along which the error is looked at."""
    cov = {name: column for name, column in block.covariates.items() if name not in block.assumed}
    for name, title, unit, factor, magnitude in _NUMBERS:
        if name in cov:
            yield name, cov[name], NumberAxis(name, title, unit, factor, magnitude)
    for name, title in _TEXTS:
        if name in cov:
            yield name, cov[name], LabelAxis(name, title)
    for name in sorted(cov):
        if name.startswith("on_") and not name.startswith("on_time_"):
            yield name, cov[name], LabelAxis(name, f"units of {name[3:]} on")
    for name in by:
        if name in cov and is_text(cov[name]):
            yield name, cov[name], LabelAxis(name, name)
        elif name in cov:
            yield name, cov[name], NumberAxis(name, name, "")
    yield "time_since_start_s", block.time_s, NumberAxis("time_since_start_s", "time since start", "s")
    yield "run", Labels(np.zeros(len(block.time_s), dtype=np.int64), (run,)), LabelAxis("run", "run")

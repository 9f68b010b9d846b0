"""Sums over rows from which a comparison is made: per battery, run and axis, in one pass over blocks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.compare.axes import Axis, LabelAxis, NumberAxis, PlaceGrid
from missionsim.effects.covariates import is_text
from missionsim.effects.model import TermKey
from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.covariates import COVARIATES, is_switch, may_be_cause
from missionsim.runs.drive import Driven
from missionsim.runs.error import RunError
from missionsim.runs.motion import MOTIONS, Motion, Still, dot, kinds_of_motion, motions

MAX_BUCKETS = 4096
_ENERGIES = ("measured_j", "model_j")
_LOWS = ("measured_low_w", "error_low_w")
_HIGHS = ("measured_high_w", "error_high_w")


@dataclass
class Series:
    """Buckets of neighbouring rows, one row each for short logs."""

    columns: dict[str, Array] = field(default_factory=dict)
    """``start_s`` (since the start of the run), ``seconds``, ``measured_j``, ``model_j`` and the lowest and highest
    measured power and power error (model minus measured) in each bucket [W]. Shape (n,)."""
    rows: int = 1
    """Rows in a bucket (except the last of a block)."""

    def add(
        self, time_s: Array, seconds: Array, measured_w: Array, model_w: Array, segment: NDArray[np.int64] | None = None
    ) -> None:
        """Append the rows of a block, arrays of shape (n,); `segment` is a code, -1 where there is none."""
        error = model_w - measured_w
        block = {
            "start_s": time_s,
            "seconds": seconds,
            "measured_j": measured_w * seconds,
            "model_j": model_w * seconds,
            "measured_low_w": measured_w,
            "measured_high_w": measured_w,
            "error_low_w": error,
            "error_high_w": error,
            "segment": np.full(len(time_s), -1.0) if segment is None else segment.astype(float),
        }
        while len(time_s) / self.rows > MAX_BUCKETS:
            self.rows *= 2
        block = _join(block, self.rows)
        if self.columns:
            block = {name: np.concatenate([self.columns[name], values]) for name, values in block.items()}
        while len(block["start_s"]) > MAX_BUCKETS:
            block = _join(block, 2)
            self.rows *= 2
        self.columns = block

    @property
    def middle_s(self) -> Array:
        """Middle of each bucket [s]."""
        return self.columns["start_s"] + 0.5 * self.columns["seconds"]

    @property
    def progress(self) -> Array:
        """Share of the run's time that is over at the end of each bucket."""
        spent = np.cumsum(self.columns["seconds"])
        return np.asarray(spent / spent[-1])

    def power_w(self, which: str) -> Array:
        """Mean power of each bucket, `which` of ``measured`` and ``model`` [W]."""
        return self.columns[f"{which}_j"] / np.maximum(self.columns["seconds"], 1e-12)


def _join(columns: dict[str, Array], rows: int) -> dict[str, Array]:
    if rows == 1:
        return {name: np.array(values, dtype=float) for name, values in columns.items()}
    starts = np.arange(0, len(columns["start_s"]), rows)
    joined = {name: columns[name][starts] for name in ("start_s", "segment")}
    joined |= {"seconds": np.add.reduceat(columns["seconds"], starts)}
    joined |= {name: np.add.reduceat(columns[name], starts) for name in _ENERGIES}
    joined |= {name: np.minimum.reduceat(columns[name], starts) for name in _LOWS}
    joined |= {name: np.maximum.reduceat(columns[name], starts) for name in _HIGHS}
    return joined


@dataclass
class RunSums:
    """Sums of one battery over one run."""

    error: RunError
    series: Series = field(default_factory=Series)
    """Power over time, joined to a bounded number of points."""
    terms: dict[TermKey, float] = field(default_factory=dict)
    """Modelled energy by term [J]."""


class Accumulator:
    """Everything that a comparison keeps of the rows.

    `by`: further log columns to look at; `still`: given where way and time are summed per control scheme, to be held
    against a plan: what counts as standing.
    """

    def __init__(self, by: Iterable[str] = (), still: Still | None = None) -> None:
        self.axes: dict[str, Axis] = {}
        self.places = PlaceGrid()
        self.runs: dict[str, dict[str, RunSums]] = {}
        self.rows = 0
        self.motion: dict[str, dict[str, Motion]] = {}
        self._still = still
        self._by = tuple(by)

    def add(self, run: str, block: Driven) -> None:
        """Add the rows of a block of `run`."""
        self.rows += len(block.time_s)
        placed = list(self._cells(run, block))
        segment = next((cells for axis, cells in placed if axis.name == "segment"), None)
        weights: dict[str, Array] = {}
        for battery, measured in block.measured_w.items():
            model = block.model_w[battery]
            error = model - measured
            gap = -error * block.dt_s
            square = -error * gap
            weights |= {f"{battery}:gap": gap, f"{battery}:square": square, f"{battery}:seconds": block.dt_s}
            self._add_run(run, battery, block, segment)
        if self._still is not None:
            own = self.motion.setdefault(run, {})
            for scheme, part in motions(block.covariates, block.dt_s, block.model_w, self._still).items():
                own.setdefault(scheme, Motion()).add(part)
        for axis, cells in placed:
            axis.add(cells, weights)
        self.places.add(block.covariates, weights)

    def segment_names(self) -> tuple[str, ...]:
        """Names of the segments by the codes in the series; empty where the logs name none."""
        axis = self.axes.get("segment")
        return axis.names if isinstance(axis, LabelAxis) else ()

    def _add_run(self, run: str, battery: str, block: Driven, segment: NDArray[np.int64] | None) -> None:
        seconds, measured, model = block.dt_s, block.measured_w[battery], block.model_w[battery]
        error = RunError.of(run, measured, model, seconds)
        sums = self.runs.setdefault(run, {}).get(battery)
        if sums is None:
            sums = self.runs[run][battery] = RunSums(error)
        else:
            sums.error += error
        sums.series.add(block.time_s, seconds, measured, model, segment)
        for key, power in block.terms[battery].items():
            joules = dot(power, seconds) if np.ndim(power) else float(power) * error.seconds
            sums.terms[key] = sums.terms.get(key, 0.0) + joules

    def _cells(self, run: str, block: Driven) -> Iterable[tuple[Axis, NDArray[np.int64]]]:
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


def _axis_columns(run: str, block: Driven, by: tuple[str, ...]) -> Iterable[tuple[str, Any, Axis]]:
    """Name, column and a new axis of everything in a block along which the error is looked at."""
    cov = {name: column for name, column in block.covariates.items() if name not in block.assumed}
    for name, known in COVARIATES.items():
        if name in cov and known.shown:
            yield name, cov[name], _axis(name, cov[name])
    for name in sorted(cov):
        if name in block.run.columns and name not in (*COVARIATES, "time_s") and may_be_cause(name):
            yield name, cov[name], _axis(name, cov[name])
    for name in by:
        if name in cov:
            yield name, cov[name], _axis(name, cov[name])
    yield "time_since_start_s", block.time_s, NumberAxis("time_since_start_s", "time since start", "s")
    yield "run", Labels(np.zeros(len(block.time_s), dtype=np.int64), (run,)), LabelAxis("run", "run")


def _axis(name: str, column: Any) -> Axis:
    known = COVARIATES.get(name)
    title = known.title if known is not None else f"units of {name[3:]} on" if is_switch(name) else name
    if is_text(column) or is_switch(name):
        return LabelAxis(name, title)
    return NumberAxis(name, title, *((known.unit, known.factor, known.magnitude) if known is not None else ("",)))

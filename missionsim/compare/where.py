"""Where the model fails: sums over rows in one pass, and covariates ranked by what they explain of the error."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from missionsim.compare.axes import Axis, Bin, LabelAxis, NumberAxis, PlaceGrid
from missionsim.effects.covariates import is_text
from missionsim.effects.model import TermKey
from missionsim.files import Json, fields_of
from missionsim.labels import Labels
from missionsim.numerals import watts
from missionsim.physics import Array, Int64s
from missionsim.runs.covariates import COVARIATES, is_switch, may_be_cause
from missionsim.runs.drive import Driven
from missionsim.runs.error import RunError
from missionsim.runs.motion import MOTIONS, Motion, Still, dot, kinds_of_motion, motions

MAX_BUCKETS = 4096
_JOINED = {
    np.add: ("seconds", "measured_j", "model_j"),
    np.minimum: ("measured_low_w", "error_low_w"),
    np.maximum: ("measured_high_w", "error_high_w"),
}


@dataclass
class Series:
    """Buckets of neighbouring rows, one row each for short logs."""

    columns: dict[str, Array] = field(default_factory=dict)
    """``start_s`` (since the start of the run), ``seconds``, ``measured_j``, ``model_j`` and the lowest and highest
    measured power and power error (model minus measured) in each bucket [W]. Shape (n,)."""
    rows: int = 1
    """Rows in a bucket (except the last of a block)."""

    def add(
        self, time_s: Array, seconds: Array, measured_w: Array, model_w: Array, segment: Int64s | None = None
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
    for how, names in _JOINED.items():
        joined |= {name: how.reduceat(columns[name], starts) for name in names}
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
        placed: list[tuple[Axis, Int64s]] = []
        for column, fresh in _axis_columns(run, block, self._by):
            axis = self.axes.setdefault(fresh.name, fresh)
            if (cells := axis.place(column)) is not None:
                placed.append((axis, cells))
        segment = next((cells for axis, cells in placed if axis.name == "segment"), None)
        weights: dict[str, Array] = {}
        for battery, measured in block.measured_w.items():
            error = block.model_w[battery] - measured
            gap = -error * block.dt_s
            square = -error * gap
            weights |= {f"{battery}:gap": gap, f"{battery}:square": square, f"{battery}:seconds": block.dt_s}
            found = RunError.of(run, measured, block.model_w[battery], block.dt_s)
            if (sums := self.runs.setdefault(run, {}).get(battery)) is None:
                sums = self.runs[run][battery] = RunSums(found)
            else:
                sums.error += found
            sums.series.add(block.time_s, block.dt_s, measured, block.model_w[battery], segment)
            for key, power in block.terms[battery].items():
                joules = dot(power, block.dt_s) if np.ndim(power) else float(power) * found.seconds
                sums.terms[key] = sums.terms.get(key, 0.0) + joules
        if self._still is not None:
            own = self.motion.setdefault(run, {})
            for scheme, part in motions(block.covariates, block.dt_s, block.model_w, self._still).items():
                own.setdefault(scheme, Motion()).add(part)
        for axis, cells in placed:
            axis.add(cells, weights)
        self.places.add(block.covariates, weights)


def _axis_columns(run: str, block: Driven, by: tuple[str, ...]) -> Iterator[tuple[Any, Axis]]:
    """Column and a new axis of everything in a block along which the error is looked at."""
    cov = {name: column for name, column in block.covariates.items() if name not in block.assumed}
    others = sorted(name for name in block.run.columns if name not in (*COVARIATES, "time_s") and may_be_cause(name))
    for name in [*(name for name, known in COVARIATES.items() if known.shown), *others, *by]:
        if name not in cov:
            continue
        known, switch = COVARIATES.get(name), is_switch(name)
        title = known.title if known is not None else f"units of {name[3:]} on" if switch else name
        if is_text(cov[name]) or switch:
            yield cov[name], LabelAxis(name, title)
        elif known is None:
            yield cov[name], NumberAxis(name, title, "")
        else:
            yield cov[name], NumberAxis(name, title, known.unit, known.factor, known.magnitude)
    yield block.time_s, NumberAxis("time_since_start_s", "time since start", "s")
    yield Labels(np.zeros(len(block.time_s), dtype=np.int64), (run,)), LabelAxis("run", "run")
    if "speed_m_s" in block.covariates:
        yield Labels(kinds_of_motion(block.covariates), MOTIONS), LabelAxis("motion", "kind of motion")


BLOCK_S = 20.0
"""Errors nearer in time than this count as one observation, since power errors last for many seconds."""
WORTH_SAYING = 0.02
"""Explained share of the squared error below which a covariate is not spoken of."""
LESSER_SHARE = 0.15
"""Nor of one that explains less than this share of what the strongest explains."""
CHART_BINS = 40
CHART_THIN_SHARE = 0.0005


@dataclass(frozen=True, kw_only=True)
class Where(Bin):
    """Error within one value or range of one covariate."""

    by: str
    title: str
    unit: str
    """All three: covariate: its name, and for people."""
    share_of_gap: float
    """Part of the sum of the magnitudes of the energy gaps of this covariate's values, 0 to 1."""
    share_of_squared_error: float
    """Part of the integral of the squared power error, 0 to 1."""
    explains: float
    """This value's part of what its covariate explains (`Dependence.explained`). It is shared out by time × |bias| ×
    |bias − overall bias|: values where the model is right, or as wrong as everywhere, get none of it."""

    @property
    def gap_wh(self) -> float:
        """Measured minus modelled energy [Wh]; the values of one covariate add up to the battery's gap."""
        return self.gap_j / 3600.0

    def to_json(self) -> Json:
        """The contract's fields and ours beside them."""
        contract = "by value share_of_gap bias_w seconds"
        return fields_of(self, f"{contract} low high unit gap_wh share_of_squared_error explains")

    @property
    def phrase(self) -> str:
        """The value as part of a sentence: ``on carpet``, ``at speed 0.4 to 0.5 m/s``."""
        words = {"surface": "on", "motion": "while", "place": "near", "run": "in"}
        if self.by in words:
            return f"{words[self.by]} {self.value}"
        if self.by.startswith("on_"):
            return f"with {self.value} {self.by[3:]} on"
        return f"at {self.title} {self.value}{' ' + self.unit if self.unit else ''}"


@dataclass(frozen=True)
class Dependence:
    """How much of the error depends on one covariate."""

    by: str
    title: str
    unit: str
    explained: float
    """Part of the squared error about the overall bias that the bias by value explains, after an allowance for chance
    (adjusted R² with one observation per `BLOCK_S`); 0 where nothing is explained."""
    values: tuple[Where, ...]
    """In order of the covariate."""
    fine: tuple[Bin, ...]
    """The same in narrower ranges, for charts."""


def dependences(sums: Accumulator, battery: str) -> list[Dependence]:
    """Every covariate with at least two values, the one that explains most first."""
    found = []
    for axis in sums.axes.values():
        bins = axis.bins(battery)
        if len(bins) > 1:
            fine = axis.bins(battery, CHART_BINS, CHART_THIN_SHARE)
            found.append(_dependence(axis.name, axis.title, axis.unit, bins, fine))
    cells = sums.places.coarse_cells(battery)
    if len(cells) > 1:
        found.append(_dependence("place", "place on the map", "", cells, cells))
    return sorted(found, key=lambda dependence: (-dependence.explained, dependence.by))


def ranked(found: Sequence[Dependence]) -> list[Where]:
    """Values of covariates, those that explain most of the error first."""
    values = (where for dependence in found for where in dependence.values)
    return sorted(values, key=lambda one: (-one.explains, -one.share_of_squared_error, one.by, one.value))


def _dependence(by: str, title: str, unit: str, bins: Sequence[Bin], fine: Sequence[Bin]) -> Dependence:
    seconds = sum(one.seconds for one in bins)
    gap = sum(one.gap_j for one in bins)
    square = sum(one.square_w2s for one in bins)
    sizes = sum(abs(one.gap_j) for one in bins)
    bias = -gap / seconds
    about_bias = max(square - bias * bias * seconds, 0.0)
    between = sum(one.seconds * (one.bias_w - bias) ** 2 for one in bins)
    raw = min(between / about_bias, 1.0) if about_bias > 0.0 else 0.0
    observations = seconds / BLOCK_S
    free = observations - len(bins)
    adjusted = max(0.0, 1.0 - (1.0 - raw) * (observations - 1.0) / free) if free > 0.0 else 0.0
    weights = [one.seconds * abs(one.bias_w * (one.bias_w - bias)) for one in bins]
    weight = sum(weights)
    values = tuple(
        Where(
            **{name: getattr(one, name) for name in ("value", "low", "high", "seconds", "gap_j", "square_w2s")},
            by=by,
            title=title,
            unit=unit,
            share_of_gap=abs(one.gap_j) / sizes if sizes > 0.0 else 0.0,
            share_of_squared_error=one.square_w2s / square if square > 0.0 else 0.0,
            explains=adjusted * own / weight if weight > 0.0 else 0.0,
        )
        for one, own in zip(bins, weights, strict=True)
    )
    return Dependence(by, title, unit, adjusted, values, tuple(fine))


def in_words(found: Sequence[Dependence]) -> list[str]:
    """Sentences on the three covariates that explain most; one sentence where none explains anything."""
    least = max(WORTH_SAYING, LESSER_SHARE * max((dependence.explained for dependence in found), default=0.0))
    telling = [dependence for dependence in found if dependence.explained >= least][:3]
    if not telling:
        return [
            f"No logged quantity goes with as much as {100.0 * WORTH_SAYING:.0f} % of the error's variance; what is "
            "fainter is for `missionsim diagnose` to say."
        ]
    sentences = []
    for dependence in telling:
        worst = max(dependence.values, key=lambda where: where.explains)
        s = worst.seconds
        duration = f"{s:.0f} s" if s < 600.0 else f"{s / 60.0:.0f} min" if s < 7200.0 else f"{s / 3600.0:.1f} h"
        sentences.append(
            f"The error varies with {dependence.title}, which goes with {100.0 * dependence.explained:.0f} % of its "
            f"variance: most {worst.phrase}, where the model is {watts(abs(worst.bias_w))} "
            f"{'too high' if worst.bias_w > 0.0 else 'too low'} on average during {duration}."
        )
    if telling[0].by == "accel_m_s2":
        sentences.append(
            "A shift between the clocks of power and motion looks like an error that varies with acceleration; "
            "`missionsim diagnose` aligns the clocks first."
        )
    return sentences

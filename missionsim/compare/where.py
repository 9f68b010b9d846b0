"""Where the model fails: values of the covariates ranked by what they explain of the error, and said in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from missionsim.compare.accumulate import Accumulator
from missionsim.compare.axes import Bin
from missionsim.files import Json, fields_of

BLOCK_S = 20.0
"""Errors nearer in time than this count as one observation, since power errors last for many seconds."""
WORTH_SAYING = 0.02
"""Explained share of the squared error below which a covariate is not spoken of."""
LESSER_SHARE = 0.15
"""Nor of one that explains less than this share of what the strongest explains."""
CHART_BINS = 40
CHART_THIN_SHARE = 0.0005


@dataclass(frozen=True, kw_only=True)
class Where:
    """Error within one value or range of one covariate."""

    by: str
    title: str
    unit: str
    """All three: covariate: its name, and for people."""
    value: str
    low: float | None
    high: float | None
    """Both: ends of a range in `unit`."""
    share_of_gap: float
    """Part of the sum of the magnitudes of the energy gaps of this covariate's values, 0 to 1."""
    share_of_squared_error: float
    """Part of the integral of the squared power error, 0 to 1."""
    gap_wh: float
    """Measured minus modelled energy; the values of one covariate add up to the battery's gap."""
    bias_w: float
    """Mean of model minus measured power."""
    seconds: float
    explains: float
    """This value's part of what its covariate explains (`Dependence.explained`). It is shared out by time × |bias| ×
    |bias − overall bias|: values where the model is right, or as wrong as everywhere, get none of it."""

    def to_json(self) -> Json:
        """The contract's fields and ours beside them."""
        contract = "by value share_of_gap bias_w seconds"
        return fields_of(self, f"{contract} low high unit gap_wh share_of_squared_error explains")

    @property
    def phrase(self) -> str:
        """The value as part of a sentence."""
        return phrase(self.by, self.title, self.value, self.unit)


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
    keys = (f"{battery}:seconds", f"{battery}:gap", f"{battery}:square")
    found = []
    for axis in sums.axes.values():
        bins = axis.bins(*keys)
        if len(bins) > 1:
            fine = axis.bins(*keys, CHART_BINS, CHART_THIN_SHARE)
            found.append(_dependence(axis.name, axis.title, axis.unit, bins, fine))
    cells = sums.places.coarse_cells(battery)
    if len(cells) > 1:
        bins = [Bin(cell.value, None, None, cell.seconds, cell.gap_j, cell.square_w2s) for cell in cells]
        found.append(_dependence("place", "place on the map", "", bins, bins))
    return sorted(found, key=lambda dependence: (-dependence.explained, dependence.by))


def ranked(found: Sequence[Dependence]) -> list[Where]:
    """All values of all covariates, those that explain most of the squared error first."""
    return sorted(
        (where for dependence in found for where in dependence.values),
        key=lambda where: (-where.explains, -where.share_of_squared_error, where.by, where.value),
    )


def _dependence(by: str, title: str, unit: str, bins: list[Bin], fine: list[Bin]) -> Dependence:
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
            by=by,
            title=title,
            unit=unit,
            value=one.value,
            low=one.low,
            high=one.high,
            share_of_gap=abs(one.gap_j) / sizes if sizes > 0.0 else 0.0,
            share_of_squared_error=one.square_w2s / square if square > 0.0 else 0.0,
            gap_wh=one.gap_j / 3600.0,
            bias_w=one.bias_w,
            seconds=one.seconds,
            explains=adjusted * own / weight if weight > 0.0 else 0.0,
        )
        for one, own in zip(bins, weights, strict=True)
    )
    return Dependence(by, title, unit, adjusted, values, tuple(fine))


def in_words(found: Sequence[Dependence], limit: int = 3) -> list[str]:
    """Sentences on the covariates that explain most; one sentence where none explains anything."""
    least = max(WORTH_SAYING, LESSER_SHARE * max((dependence.explained for dependence in found), default=0.0))
    telling = [dependence for dependence in found if dependence.explained >= least][:limit]
    if not telling:
        return ["The error shows no clear dependence on any logged quantity."]
    sentences = []
    for dependence in telling:
        worst = max(dependence.values, key=lambda where: where.explains)
        sentences.append(
            f"The error varies with {dependence.title}, which goes with {100.0 * dependence.explained:.0f} % of its "
            f"variance: most {worst.phrase}, where the model is {abs(worst.bias_w):.3g} W "
            f"{'too high' if worst.bias_w > 0.0 else 'too low'} on average during {_duration(worst.seconds)}."
        )
    if telling[0].by == "accel_m_s2":
        sentences.append(
            "A shift between the clocks of power and motion looks like an error that varies with acceleration; "
            "`missionsim diagnose` aligns the clocks first."
        )
    return sentences


def _duration(seconds: float) -> str:
    if seconds < 600.0:
        return f"{seconds:.0f} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 7200.0 else f"{seconds / 3600.0:.1f} h"


def phrase(by: str, title: str, value: str, unit: str) -> str:
    """A covariate's value as part of a sentence: ``on carpet``, ``at speed 0.4 to 0.5 m/s``."""
    if by == "surface":
        return f"on {value}"
    if by == "motion":
        return f"while {value}"
    if by == "place":
        return f"near {value}"
    if by == "run":
        return f"in run {value}"
    if by.startswith("on_"):
        return f"with {value} {by[3:]} on"
    return f"at {title} {value}{' ' + unit if unit else ''}"

"""What an identification finds, as frozen records."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from missionsim.identify.choose import Choice
from missionsim.identify.data import Array, Candidate, Settings


@dataclass(frozen=True)
class Estimate:
    """A coefficient or shape parameter; ``low`` and ``high`` hold about 95 %, systematic allowance included."""

    name: str
    value: float
    low: float
    high: float
    sd: float
    unit: str


@dataclass(frozen=True)
class FoundEffect:
    """One missing effect.

    ``gain_nats`` is the log-likelihood that is lost without it, ``p_runs`` the p-value from whole runs only (NaN
    with fewer than three), ``indistinguishable_from`` all effects that these data cannot tell from it.
    """

    effect: str
    parameters: tuple[Estimate, ...]
    energy_share: float
    energy_share_sd: float
    p_value: float
    p_runs: float
    gain_nats: float
    indistinguishable_from: tuple[str, ...]
    confidence: str


@dataclass(frozen=True)
class CandidateReport:
    """Why a candidate was accepted or not, and how small an effect of it would have been seen.

    ``absorption`` is the part of the effect that hides in the recalibration of the base model.
    """

    effect: str
    accepted: bool
    reason: str
    smallest_detectable_share: float
    absorption: float


@dataclass(frozen=True)
class BaseShift:
    """Recalibration of a base parameter: relative shift and its standard error."""

    parameter: str
    shift: float
    sd: float
    shift_in_prior_sd: float


@dataclass(frozen=True)
class Pair:
    """How well effect ``a`` can be told from effect ``b``: correlation and expected log-likelihood lead [nats]."""

    a: str
    b: str
    r: float
    separation_nats: float

    @property
    def verdict(self) -> str:
        """In words."""
        if self.separation_nats >= 5:
            return "separable"
        return "weak" if self.separation_nats >= 2 else "these data cannot tell"


@dataclass(frozen=True)
class Structure:
    """Something that remains in the residual and depends on a covariate (or is periodic).

    ``size_share`` is its mean size as share of the mean power; ``knots`` and ``curve_w`` give its shape
    (multiplied by the covariate ``times``, if any).
    """

    covariate: str
    p_value: float
    gain_nats: float
    size_share: float
    shape: str
    knots: tuple[float, ...] = ()
    curve_w: tuple[float, ...] = ()
    times: str = ""


@dataclass(frozen=True)
class Unexplained:
    """What is left: share of the residual variance beyond the noise model, and the structures found."""

    share_of_residual: float
    depends_on: tuple[str, ...]
    shape: str
    structures: tuple[Structure, ...] = ()


@dataclass(frozen=True)
class NoiseReport:
    """Noise found: total relative sd, correlation times, differences between runs."""

    sd_share: float
    fast_s: float
    slow_s: float
    meter_offset_w: float
    meter_gain: float
    motion_gain: float
    overdispersion: float


@dataclass(frozen=True)
class ClockReport:
    """Delay and lag of the power behind the motion that were found and applied [s]."""

    delay_s: float
    lag_s: float
    run_delay_s: Mapping[str, float]
    at_edge: bool


@dataclass(frozen=True)
class Identification:
    """All findings of one battery; ``choice`` keeps the fitted model for later questions."""

    verdict: str
    effects: tuple[FoundEffect, ...]
    candidates: tuple[CandidateReport, ...]
    recalibration: tuple[BaseShift, ...]
    clock: ClockReport
    noise: NoiseReport
    unexplained: Unexplained
    pairs: tuple[Pair, ...]
    remarks: tuple[str, ...]
    mean_power_w: float
    residual_share: Mapping[str, float]
    settings: Settings
    library: tuple[Candidate, ...]
    choice: Choice
    covariance: Array | None = None
    shapes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    demoted: tuple[str, ...] = ()

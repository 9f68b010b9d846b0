"""What goes into the identification: runs as plain arrays, candidate effects, settings."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Refit = Callable[[Mapping[str, float]], Sequence[Array]]

ALPHA = 0.002
"""At 0.01, effects that make 1 or 2 % of the energy brought a wrong name beside them or in their place in some 2 % of
the synthetic worlds; most of these stood between the two levels, hardly any of the right ones."""
DEFAULT_PRIOR_SD = 0.03
"""Relative standard deviation of a base parameter where the robot file gives none (assumed)."""


@dataclass(frozen=True)
class RunData:
    """One measured run at the raw rate of its log; every array has shape (n,).

    Parameters
    ----------
    run : name of the run
    time_s : time of each row, strictly increasing [s]
    dt_s : time that each row stands for [s]
    measured_w : measured mean power around each row [W]; NaN where nothing was measured
    base_w : power of the base model [W]
    gradient : base parameter -> derivative of the base model after the logarithm of that parameter [W]
    columns : candidate column -> its power for coefficient 1 [W per unit of the coefficient]
    covariates : what the remaining error may depend on (``speed_m_s``, ``yaw_rate_rad_s``, ...)
    fresh : rows at which the power value was really refreshed; None when every row is
    """

    run: str
    time_s: Array
    dt_s: Array
    measured_w: Array
    base_w: Array
    gradient: Mapping[str, Array] = field(default_factory=dict)
    columns: Mapping[str, Array] = field(default_factory=dict)
    covariates: Mapping[str, Array] = field(default_factory=dict)
    fresh: NDArray[np.bool_] | None = None

    def __post_init__(self) -> None:
        n = len(self.time_s)
        named: dict[str, Array] = {"dt_s": self.dt_s, "measured_w": self.measured_w, "base_w": self.base_w}
        for group in (self.gradient, self.columns, self.covariates):
            named.update(group)
        for name, values in named.items():
            if np.shape(values) != (n,):
                raise ValueError(f"run {self.run}: {name} has shape {np.shape(values)}, expected ({n},)")
        if n < 2 or not bool(np.all(np.diff(self.time_s) > 0)):
            raise ValueError(f"run {self.run}: time_s must hold at least two strictly increasing values")


@dataclass(frozen=True)
class Candidate:
    """One effect of the library.

    ``columns`` are alternatives, one for each entry of ``shape`` (a grid of time constants counts as one
    effect). Where ``levels`` is set, the columns are instead levels of a label (floors) with a coefficient each.

    Parameters
    ----------
    effect : identifier of the effect
    columns : names in `RunData.columns`
    sign : +1 or -1 where physics fixes the sign of the coefficient, 0 where it is free (the search still lets a
        calibration twin only add power: a base that asks too much is recalibration, however far)
    unit : unit of the coefficient
    coefficient : name of the coefficient
    shape : values of the shape parameters of each column
    prior : base parameter of which this effect is the calibration twin (a shift of that parameter looks the same)
    refit : exact columns, one array a run, for any other values of the shape parameters
    covariate : main covariate, used to split by condition and to judge the form
    levels : label of each column, e.g. the floor
    shape_bounds : lowest and highest value of each shape parameter for the refit
    """

    effect: str
    columns: tuple[str, ...]
    sign: int = 1
    unit: str = "1"
    coefficient: str = "k"
    shape: tuple[Mapping[str, float], ...] = ()
    prior: str | None = None
    refit: Refit | None = None
    covariate: str = ""
    levels: tuple[str, ...] = ()
    shape_bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)


@dataclass(frozen=True)
class Settings:
    """Choices of the method; the defaults are those of the published comparison or stricter.

    Parameters
    ----------
    alpha : family-wise false alarm rate of an effect that enters the model
    period_s : analysis period [s]; slower logs keep their own
    min_share : effects below this share of the energy are called negligible
    max_effects : most effects that enter
    recalibration_limit : shifts of a base parameter up to this many prior sd are recalibration
    block_s : length of the blocks of the robust standard errors [s]
    form_ratio : an effect explaining less than this part of what a free curve over its covariate explains has
        the wrong form
    rival_loss : a rival of the same covariate within this part of the effect's own gain is not told apart, because
        forms are never exact
    noisy_rival_loss : the same for a rival of another covariate, whose noise weakens what it explains
    systematic : relative systematic allowance of a coefficient (covariate noise), measured on synthetic worlds
    form_error : relative error of an effect's form; weighs more the more of the effect hides in recalibration
    align : estimate delay and lag of the power meter
    """

    alpha: float = ALPHA
    period_s: float = 1.0
    min_share: float = 0.004
    max_effects: int = 6
    recalibration_limit: float = 4.0
    block_s: float = 20.0
    form_ratio: float = 0.85
    rival_loss: float = 0.03
    noisy_rival_loss: float = 0.12
    systematic: float = 0.07
    form_error: float = 0.03
    align: bool = True

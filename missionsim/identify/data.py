"""What goes into the identification: runs as plain arrays, candidate effects, and what their columns must obey."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field
from functools import cached_property

import numpy as np

from missionsim.identify.settings import NEVER_ON_PART, SHAPE_NATS, Settings
from missionsim.numerals import rounded
from missionsim.physics import Array, Bools, Ints

Refit = Callable[[Mapping[str, float]], Sequence[Array]]


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
    begin_s : when it began [s since 1970]; not a number where that is not known
    at_rest : rows in which the robot stands; None where nothing tells
    texts : covariate of texts -> the texts that its numbers stand for
    """

    run: str
    time_s: Array
    dt_s: Array
    measured_w: Array
    base_w: Array
    gradient: Mapping[str, Array] = field(default_factory=dict)
    columns: Mapping[str, Array] = field(default_factory=dict)
    covariates: Mapping[str, Array] = field(default_factory=dict)
    _: KW_ONLY
    fresh: Bools | None = None
    begin_s: float = math.nan
    at_rest: Bools | None = None
    texts: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

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
    unlogged : loads of which nothing tells when they were on and that may be what this effect explains, with their
        power together [W]
    by_clock : whether it goes by time since something began, or by starts: by nothing that a sensor measures
    plausible : beyond so many times the coefficient ``asked`` the finding says that it may stand for something else
    asked : the coefficient that the robot's mass asks for
    beyond : in words, what a coefficient is that many times ``asked``
    never_on : loads whose switch is logged and never on, with their power [W]: an effect of about that size may be one
        of them, and the column stuck
    """

    effect: str
    columns: tuple[str, ...]
    sign: int = 1
    unit: str = "1"
    coefficient: str = "k"
    shape: tuple[Mapping[str, float], ...] = ()
    prior: str | None = None
    refit: Refit | None = None
    _: KW_ONLY
    covariate: str = ""
    levels: tuple[str, ...] = ()
    shape_bounds: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    unlogged: tuple[tuple[str, ...], float] = ((), 0.0)
    by_clock: bool = False
    plausible: float = math.inf
    asked: float = 1.0
    beyond: str = ""
    never_on: Mapping[str, float] = field(default_factory=dict)

    def much(self, size: float) -> str:
        """In words, that a coefficient is beyond all that is plausible; empty where it is not."""
        times = size / self.asked
        return f"{rounded(times)} {self.beyond}" if times > self.plausible else ""

    def may_be(self, size_w: float) -> tuple[str, ...]:
        """The loads of `never_on` that an effect of a size [W] may be."""
        return tuple(name for name, watts in self.never_on.items() if NEVER_ON_PART * watts < size_w <= watts)


@dataclass(frozen=True)
class Column:
    """One regression column: which candidate it belongs to and what one share of energy means for it."""

    candidate: int
    position: int
    name: str
    watts_per_unit: float
    """Mean |power| for coefficient 1; the column is divided by it and multiplied by the mean measured power."""
    shape: tuple[tuple[str, float], ...] = ()
    """The shape parameters after a refit; runs that are made like these need the column at them."""


@dataclass(frozen=True)
class Layout:
    """What all runs have in common: parameter order, priors, column scales, analysis step.

    ``prior_sd`` holds the relative sd of each base parameter, then those of the nuisances.
    """

    parameters: tuple[str, ...]
    prior_sd: Array
    columns: tuple[Column, ...]
    mean_power_w: float
    step_s: float

    def unit(self, column: int) -> float:
        """Coefficient of a column for a share of 1."""
        return self.mean_power_w / self.columns[column].watts_per_unit


@dataclass(frozen=True)
class Constraints:
    """What a set of columns must obey: signs, and one column of a grid at a time; and whose columns they are.

    ``sign`` (p,) and ``effect`` (p,) by column; ``joint`` (p,) is True for levels of one label, which may be in
    together.
    """

    sign: Ints
    effect: Ints
    joint: Bools
    candidates: Sequence[Candidate] = ()
    settings: Settings = field(default_factory=Settings)

    @classmethod
    def of(
        cls,
        layout: Layout,
        candidates: Sequence[Candidate],
        settings: Settings = Settings(),  # noqa: B008 (frozen)
    ) -> Constraints:
        """Constraints of the columns of a layout."""
        own = [candidates[c.candidate] for c in layout.columns]
        return cls(
            np.array([c.sign if c.prior is None or c.sign else 1 for c in own], dtype=np.intp),
            np.array([c.candidate for c in layout.columns], dtype=np.intp),
            np.array([bool(c.levels) for c in own], dtype=bool),
            candidates,
            settings,
        )

    @cached_property
    def grid_nats(self) -> Array:
        """Nats that each column owes to its grid of shapes, which bends towards noise and other forms, shape (p,)."""
        number = np.bincount(self.effect)[self.effect]
        return np.where(self.joint | (number == 1), 0.0, np.maximum(np.log(number), SHAPE_NATS))

    def of_column(self, column: int) -> Candidate:
        """The effect of a column."""
        return self.candidates[int(self.effect[column])]

    def split(self, chosen: Sequence[int], effect: int) -> tuple[list[int], list[int]]:
        """Chosen columns of an effect (its number), and the others."""
        own = [k for k in chosen if self.effect[k] == effect]
        return own, [k for k in chosen if self.effect[k] != effect]

    def numbers(self, chosen: Iterable[int]) -> list[int]:
        """Numbers of the effects of some columns, each once, in their order."""
        return list(dict.fromkeys(int(self.effect[k]) for k in chosen))

    def compatible(self, column: int, chosen: Sequence[int]) -> bool:
        """Whether a column may join a set."""
        return all(o != column and (self.effect[o] != self.effect[column] or self.joint[column]) for o in chosen)

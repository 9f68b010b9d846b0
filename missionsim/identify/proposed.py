"""A law that the library does not hold, as plain records: the forms that the data cannot tell apart, and one curve."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import ClassVar

from missionsim.files import Json, fields_of
from missionsim.glossary import column_of
from missionsim.identify.settings import AS_MUCH
from missionsim.numerals import rounded
from missionsim.runs.covariates import known

CLOCKS = frozenset({"time_s", "moving_time_s"})
"""Quantities that pass whatever the robot does: what else rises through a run looks like them."""
FAR_BETTER = 2.0 / 3.0
"""Part of the left-out error that a law may leave where it takes the place of effects in a base that is far off."""


def plain(name: str) -> str:
    """A quantity in words."""
    if name == "time_s":
        return "time since the start"
    if name.startswith("on_time_"):
        return f"time since {name[8:-2].replace('_', ' ')} was switched on"
    return f"{name[3:]} being on" if name.startswith("on_") else known(name).word or known(name).title


def unit_of(name: str) -> str:
    """Unit of a quantity for people; empty of a plain number, and of what the glossary does not hold."""
    column = column_of(name)
    unit = column[0].unit if column is not None else known(name).unit
    return {"1": "", "degC": "°C"}.get(unit, unit.replace("^2", "²"))


def state(name: str, value: float | str) -> str:
    """``speed 0.47 m/s``: a quantity and its value."""
    return f"{plain(name)} {value if isinstance(value, str) else rounded(value, 2)} {unit_of(name)}".strip()


class Record:
    """A plain record whose JSON is its fields, but for those that are not told."""

    untold: ClassVar[tuple[str, ...]] = ()

    def to_json(self) -> Json:
        """The fields, tuples as lists."""
        return fields_of(self, " ".join(name for name in vars(self) if name not in self.untold))


@dataclass(frozen=True)
class Law:
    """One form of the set."""

    formula: str
    """As a robot file writes it under ``power:``."""
    symbol: str
    """The same for people."""
    unit: str
    k: float
    low: float
    high: float
    """All three: coefficient with its 95 % interval, in `unit`."""
    energy_share: float
    behind_nats: float
    """How far its likelihood lies behind the best."""
    _: KW_ONLY
    variables: tuple[str, ...]

    def to_json(self) -> Json:
        """All fields."""
        told = {"formula": self.formula, "parameters": {"k": fields_of(self, "value=k low high unit")}}
        return told | fields_of(self, "energy_share behind_nats depends_on=variables")


@dataclass(frozen=True)
class Curve(Record):
    """Power of the law over its leading quantity [W], the others held; arrays of shape (points,).

    ``low`` and ``high`` bound it for all forms of the set together (about 95 %).
    """

    variable: str
    unit: str
    x: tuple[float, ...]
    watts: tuple[float, ...]
    low: tuple[float, ...]
    high: tuple[float, ...]
    at: Mapping[str, float | str]
    usual: float
    """Median of the leading quantity where the law acts."""
    _: KW_ONLY
    spans: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Range in the logs of each other quantity that has one."""
    untold: ClassVar[tuple[str, ...]] = ("spans",)

    def times(self, factor: float) -> Curve:
        """The curve of laws whose coefficients are all greater by a factor."""
        watts, low, high = (tuple(factor * w for w in values) for values in (self.watts, self.low, self.high))
        return replace(self, watts=watts, low=low, high=high)


@dataclass(frozen=True)
class Proposal:
    """A law that the library does not hold."""

    laws: tuple[Law, ...]
    """Forms that these data cannot tell apart; the plainest of the best first."""
    certain: tuple[str, ...]
    possible: tuple[str, ...]
    """Both: quantities that every form depends on, and those that only some do."""
    curve: Curve | None
    """None for a law with a memory or of a rate."""
    energy_share: float
    share_sd: float
    rise_nats: float
    penalty_nats: float
    """Both: rise of the likelihood, and what chance makes of so many tries."""
    _: KW_ONLY
    tried: int
    left_out_rmse_w: tuple[float, float]
    left_out_energy_pct: tuple[float, float]
    """Both: errors of runs left out one at a time, without the law and with it."""
    better: int
    runs: int
    """Both: left-out runs predicted better, of those in which it acts."""
    experiment: str
    """What to drive to tell the forms apart."""
    instead_of: tuple[str, ...] = ()
    """Effects of the library that stood in for it."""
    goes_with: tuple[str, ...] = ()
    """Quantities that it may follow as well, since they hardly change where it acts."""
    effect: str = ""
    """That of the library which it is, seen and not named: no other form does better."""
    like: str = ""
    """That of the library which acts in this way, if the base is fitted anew; not named."""
    heldout_rmse_w: tuple[float, float] | None = None
    heldout_energy_pct: tuple[float, float] | None = None
    """Both: errors of runs that nothing was fitted to."""

    @property
    def far_better(self) -> bool:
        """Whether runs that are left out are predicted with an error smaller by a third than without it."""
        before, after = self.left_out_rmse_w
        return after < FAR_BETTER * before

    @property
    def takes_over(self) -> bool:
        """Whether it takes a tenth off the squared error of left-out runs in the place of effects of the library."""
        before, after = self.left_out_rmse_w
        return bool(self.instead_of) and after**2 < AS_MUCH * before**2

    @property
    def open(self) -> bool:
        """Whether it is open which quantities the law reads; a clock that does as well as a logged one is no rival."""
        first = {*self.first.variables}
        return any(first != {*law.variables} and (first & CLOCKS or not CLOCKS & {*law.variables}) for law in self.laws)

    @property
    def first(self) -> Law:
        """The law that is shown first."""
        return self.laws[0]

    def to_json(self) -> Json:
        """All fields."""

        def pair(values: tuple[float, float] | None) -> dict[str, float | None] | None:
            if values is None:
                return None
            before, after = (v if math.isfinite(v) else None for v in values)
            return {"before": before, "after": after}

        names = "forms=laws depends_on=certain may_depend_on=possible energy_share energy_share_sd=share_sd"
        return {
            **fields_of(self, f"{names} rise_nats penalty_nats forms_tried=tried curve"),
            "left_out_rmse_w": pair(self.left_out_rmse_w),
            "left_out_energy_error_pct": pair(self.left_out_energy_pct),
            "left_out_better": [self.better, self.runs],
            "heldout_rmse_w": pair(self.heldout_rmse_w),
            "heldout_energy_error_pct": pair(self.heldout_energy_pct),
            **fields_of(self, "experiment instead_of goes_with like"),
        }

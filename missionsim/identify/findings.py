"""What is said of a battery, as one tree of plain frozen records with the contract's JSON."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from missionsim.files import Json, fields_of
from missionsim.identify.proposed import Proposal, Record
from missionsim.identify.settings import HIDES, WIDE
from missionsim.physics import Array

if TYPE_CHECKING:
    from missionsim.compare.where import Where
    from missionsim.identify.align import Clock


@dataclass(frozen=True)
class Structure:
    """Something that remains in the residual and depends on a covariate (or is periodic, or a level)."""

    covariate: str
    """Empty where it depends on nothing."""
    p_value: float
    gain_nats: float
    size_share: float
    """Its mean size as share of the mean power."""
    shape: str
    """In words."""
    times: str = ""
    """Covariate that its curve is multiplied by, if any."""
    effects: tuple[str, ...] = ()
    """Effects that it may be, which the runs, too few or in such an order, do not tell."""
    columns: tuple[str, ...] = ()
    """Logged columns that it goes with, or may, from run to run."""


@dataclass(frozen=True)
class Unexplained(Record):
    """All that remains."""

    share_of_residual: float
    depends_on: tuple[str, ...]
    shape: str
    structures: tuple[Structure, ...] = ()
    untold = ("structures",)


SCHEMA = "missionsim.diagnosis/1"


AT_BOUND = 1e-6
"""Distance of a parameter from a bound, in parts of its interval, within which it lies at it."""


@dataclass(frozen=True)
class Estimate(Record):
    """A coefficient or shape parameter with its 95 % interval, systematic allowance included."""

    value: float
    low: float
    high: float
    unit: str = "1"


@dataclass(frozen=True, kw_only=True)
class Finding:
    """One missing effect.

    Attributes
    ----------
    p_value, p_runs : float
        Of no effect, from blocks of time, and from whole runs (NaN with fewer than three).
    """

    effect: str
    parameters: Mapping[str, Estimate]
    """Coefficients first, then shape parameters."""
    energy_share: float
    """Part of the measured energy of the battery, before anything comes back."""
    p_value: float
    share_low: float = float("nan")
    share_high: float = float("nan")
    """Both: its 95 % interval."""
    p_runs: float = float("nan")
    gain_nats: float = float("nan")
    """Log-likelihood that is lost without it."""
    level: str = "identified"
    """``identified, repeated across runs`` or ``identified``."""
    heldout_rmse_before_w: float | None = None
    heldout_rmse_after_w: float | None = None
    """Both: power error on held-out runs without this effect and with it, base parameters recalibrated both times."""
    indistinguishable_from: tuple[str, ...] = ()
    """Effects that these data cannot tell from it."""
    other_forms: tuple[str, ...] = ()
    """Those of them that are the same thing, drawn in another way: a component that fades after switching on."""
    shared_with: tuple[str, ...] = ()
    """Effects that may have a part of it, since their causes go together from run to run."""
    separation_nats: float = float("nan")
    """Expected lead over the best imitation."""
    absorbed: float = float("nan")
    """Part of the effect that a recalibration of the base hides."""
    scheme: str = ""
    """For execution effects, the control scheme."""
    remark: str = ""
    leans: str = ""
    """What of the base falls below nothing beside it, in the fit that its numbers come from."""
    back: float = 0.0
    """Part of the energy that comes back (braking, descents), where it is known; ``energy_share`` counts it too, with
    what is taken."""

    @property
    def is_clear(self) -> bool:
        """Whether these data tell it from every other effect."""
        return not self.indistinguishable_from

    @property
    def alike(self) -> tuple[str, ...]:
        """All that these data cannot tell from it, other forms of the same component too."""
        return (*self.indistinguishable_from, *self.other_forms)

    @property
    def net(self) -> float:
        """Part of the measured energy that is taken and does not come back."""
        return self.taken - self.back

    @property
    def taken(self) -> float:
        """Part of the measured energy that is taken, whatever comes back."""
        return self.energy_share - self.back

    @property
    def may_be_nothing(self) -> bool:
        """Whether the interval of its share holds nought."""
        return self.share_low <= 0.0 <= self.share_high

    @property
    def doubt(self) -> str:
        """Why the name is not sure, in words; empty where it is."""
        every = list(self.parameters.values())
        # levels of a label may sum to nothing and differ all the same
        sizes = [(one.low, one.high) for one in every if one.unit == every[0].unit]
        nought = self.may_be_nothing and all(low <= 0.0 <= high for low, high in sizes)
        small = "with what its form may err by, its 95 % interval holds nought" if nought else ""
        wide = ""
        if not small and self.absorbed > HIDES and self.share_high > WIDE * max(self.share_low, 0.0):
            low, high = (f"{100 * share:.1f}" for share in (max(self.share_low, 0.0), self.share_high))
            wide = f"it may take {low} to {high} % of the energy: the base pays most of it already"
        return "; ".join(filter(None, (self.remark, self.leans, small, wide)))

    def to_json(self) -> Json:
        """The contract's fields, and ours beside them."""
        data = fields_of(self, "effect parameters energy_share")
        data["energy_share_interval"] = [self.share_low, self.share_high]
        data |= fields_of(self, "energy_share_given_back=back p_value p_value_runs=p_runs level heldout_rmse_before_w")
        data |= fields_of(self, "heldout_rmse_after_w indistinguishable_from other_forms shared_with separation_nats")
        data["absorbed_share"] = self.absorbed
        return data | {name: text for name, text in (("scheme", self.scheme), ("remark", self.doubt)) if text}


@dataclass(frozen=True)
class Judged(Record):
    """A candidate and why it was taken or not."""

    effect: str
    accepted: bool
    reason: str
    smallest_detectable_share: float | None
    """Energy share that would be found in four of five cases; None where these data show none."""
    open: bool = False
    """Not taken, but part of what was found or remains may be its work, so that nothing is excluded."""
    doubtful_share: float | None = None
    """Energy share of one that helps but is not named, because of its form or what else remains."""
    untold = ("open", "doubtful_share")


@dataclass(frozen=True, kw_only=True)
class Recalibrated:
    """Shift of a base parameter that these logs ask for."""

    parameter: str
    shift: float
    shift_sd: float
    """Both: relative to the parameter's value, and its standard error."""
    shift_in_prior_sd: float
    value: float = float("nan")
    sd: float = float("nan")
    """Both: the new value with its standard deviation, in ``unit``; NaN where the parameter is known by its gradient
    only."""
    unit: str = ""
    power_w: float = float("nan")
    """Mean power that it made before, where that is known."""

    @property
    def shift_pct(self) -> float:
        """The shift in per cent."""
        return 100.0 * self.shift

    def to_json(self) -> Json:
        """The contract's fields, and the new value with its standard deviation."""
        return fields_of(self, "parameter shift_pct shift_in_prior_sd value sd unit")


@dataclass(frozen=True)
class Experiment(Record):
    """What to drive next."""

    separates: tuple[str, ...]
    do: str
    """In words."""
    expected_power: float = float("nan")
    """Probability that it resolves the question, where that is foretold."""
    separation_now: float = float("nan")
    separation_after: float = float("nan")
    """Both: expected lead [nats] before and after."""
    minutes: float = 0.0
    manoeuvre: tuple[Mapping[str, Any], ...] = ()
    """The same for machines, part after part."""

    def to_json(self) -> Json:
        """The contract's fields, and ours beside them."""
        nats = {name: f"{name}_nats" for name in ("separation_now", "separation_after")}
        return {nats.get(name, name): value for name, value in super().to_json().items()}


@dataclass(frozen=True)
class HeldOut(Record):
    """Errors on runs that were not used to fit: as the robot file is, recalibrated, and with the effects found."""

    how: str
    """How the runs were chosen."""
    runs: tuple[str, ...]
    energy_error_pct: Mapping[str, float]
    power_rmse_w: Mapping[str, float]
    """Both: by ``nominal``, ``recalibrated`` and ``with_effects``: mean over runs of the absolute energy error, and the
    RMS of the power error at the analysis rate."""
    shifted: bool = False
    """Whether the runs differ in kind from the fitted ones."""
    beyond: tuple[str, ...] = ()
    """Columns in which they lie beyond them."""


@dataclass(frozen=True)
class RunSeries:
    """One run for the eye: powers in W at the analysis rate, clocks aligned; arrays of shape (n,)."""

    run: str
    time_s: Array
    measured_w: Array
    nominal_w: Array
    fitted_w: Array


@dataclass(frozen=True, kw_only=True)
class Findings:
    """What the numbers of one battery say."""

    verdict: str
    """See `missionsim.identify.verdict.decide`, which sets it."""
    effects: tuple[Finding, ...]
    """Most important first."""
    candidates: tuple[Judged, ...]
    recalibration: tuple[Recalibrated, ...]
    delay_s: float
    lag_s: float
    clock_at_edge: bool
    """All three: of the meter behind the motion, found and applied; whether they lie at the edge of what is
    searched."""
    noise: Mapping[str, float]
    """Standard deviation, correlation times and shares, differences between runs."""
    unexplained: Unexplained
    remarks: tuple[str, ...]
    mean_power_w: float
    confounding: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Correlation of each effect found with others, recalibration projected out."""


@dataclass(frozen=True, kw_only=True)
class BatteryDiagnosis(Findings):
    """Everything said about one battery."""

    battery: str
    untestable: Mapping[str, tuple[str, ...]]
    """Effects that these logs cannot test and what they lack."""
    next_experiments: tuple[Experiment, ...]
    heldout: HeldOut | None
    shifted: HeldOut | None
    execution: tuple[Finding, ...]
    """How the robot drove otherwise than planned."""
    runs: tuple[str, ...]
    """Fitted runs."""
    seconds: float
    """Their time together [s]."""
    where: tuple[Where, ...] = ()
    proposed_laws: tuple[Proposal, ...] = ()
    """A law that the library does not hold."""
    series: tuple[RunSeries, ...] = field(default=(), repr=False, compare=False)
    clock: Clock | None = field(default=None, repr=False, compare=False)
    """Clock of meter and motion that was found, for comparing other models at the same one."""
    aligned: bool = True
    """Whether the clocks were looked at; else they are as logged."""
    file_clock: tuple[float, float] = (0.0, 0.0)
    """Delay and lag of the meter that the robot file has [s]."""
    meter: str = ""
    """In words, that the meter lags otherwise than the file says, where that is all that is wrong."""

    @property
    def unnamed(self) -> str:
        """What names nothing for what remains: the library, or these data, where effects of it are in doubt."""
        doubted = [one.effect for one in self.candidates if one.doubtful_share is not None]
        if not doubted and "run" not in self.unexplained.depends_on:
            return "the library does not contain"
        return "these data do not name" + (f" (perhaps {' or '.join(doubted)})" if doubted else "")

    @property
    def clear(self) -> list[Finding]:
        """Effects that these data tell from every other."""
        return [effect for effect in self.effects if effect.is_clear]

    @property
    def unsure(self) -> list[Finding]:
        """Effects that these data cannot tell from others."""
        return [effect for effect in self.effects if not effect.is_clear]

    def either(self, effect: Finding) -> tuple[str, ...]:
        """An effect and what it cannot be told from, in words: of an effect that is named, another form."""
        named, rivals = {one.effect for one in self.clear}, effect.indistinguishable_from
        return (effect.effect, *(f"another form of {name}" if name in named else name for name in rivals))

    @property
    def parts(self) -> str:
        """What is left out one at a time, in words."""
        return "runs" if len(self.runs) > 1 else "parts of the run"

    def to_json(self) -> Json:
        """The contract's fields, and ours beside them."""
        return {
            "verdict": self.verdict,
            "effects": [effect.to_json() for effect in (*self.effects, *self.execution)],
            **fields_of(self, "candidates recalibration"),
            "clock": fields_of(self, "delay_s lag_s at_edge=clock_at_edge"),
            "meter": self.meter or None,
            "noise": dict(self.noise),
            "untestable": [{"effect": name, "needs": list(needs)} for name, needs in self.untestable.items()],
            **fields_of(self, "unexplained proposed_laws next_experiment=next_experiments heldout"),
            **fields_of(self, "heldout_shifted=shifted confounding mean_power_w runs seconds remarks"),
        }


@dataclass(frozen=True)
class Diagnosis:
    """The diagnosis of all batteries of a robot."""

    robot: str
    batteries: Mapping[str, BatteryDiagnosis]
    skipped: Mapping[str, str] = field(default_factory=dict)
    """Batteries that were measured but could not be diagnosed, and why."""
    left_out: tuple[str, ...] = ()
    """Runs that nothing was learnt from, and why."""
    remarks: tuple[str, ...] = ()
    """What no run can tell, and which switches only some of them log."""

    def to_json(self) -> Json:
        """The contract's ``missionsim.diagnosis/1``."""
        return {"schema": SCHEMA, **fields_of(self, "robot batteries skipped left_out remarks")}

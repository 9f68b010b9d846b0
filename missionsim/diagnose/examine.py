"""The robot under diagnosis, and what its logs say of one battery before anything is told."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from missionsim.diagnose.features import Features, at_size, beside_base, make_features
from missionsim.diagnose.heldout import Models
from missionsim.diagnose.manoeuvres import sharpest
from missionsim.diagnose.split import Split, lacking, stretches, with_same_causes
from missionsim.diagnose.steady import steady_speed, steady_temperatures
from missionsim.effects.base import Effect
from missionsim.effects.covariates import Covariates
from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.errors import Fault, InputError
from missionsim.fit.final import of_formula
from missionsim.fit.parameters import fitted_to, sd_on_other_logs
from missionsim.identify.align import Clock
from missionsim.identify.design import TooShortError
from missionsim.identify.identification import Identification, identify, refutes
from missionsim.identify.predictive import least_squares_clock
from missionsim.identify.proposed import Proposal
from missionsim.identify.settings import FEWEST_INTERVALS, LEAST_FREE_SD, MOST_PASSES, SAME_SIZE, Settings
from missionsim.inputs.power import build_effect, build_power_model
from missionsim.inputs.robot import RobotSpec
from missionsim.laws.experiment import CURVATURE
from missionsim.laws.proposal import propose
from missionsim.runs.run import Run

NO_PRIOR_SD = float("inf")
"""Prior of a parameter that was fitted to these very logs: they may not count twice."""
OWN_ROWS = 0.1
"""Part of the mean power that a parameter with rows of its own may make, however little the file gives it (assumed)."""


@dataclass(frozen=True)
class Subject:
    """A robot under diagnosis."""

    robot: RobotSpec
    model: PowerModel
    priors: Mapping[str, float] | None = None
    """Relative prior standard deviations by parameter, in place of the file's."""

    @classmethod
    def of(cls, robot: RobotSpec) -> Subject:
        """The subject of a robot file."""
        return cls(robot, build_power_model(robot))

    def own(self, battery: str) -> tuple[Effect, ...]:
        """Effects of the file that are candidates only."""
        specs = (spec for spec in self.robot.effects if spec.candidate and spec.battery == battery)
        return tuple(build_effect(spec, self.robot) for spec in specs)

    def switchable(self, battery: str) -> tuple[str, ...]:
        """Components that can be switched and that the battery feeds."""
        parts = ((name, one) for name, one in self.robot.components.items() if not one.always_on)
        return tuple(name for name, one in parts if any(load.battery == battery for load in one.loads))

    def most(self, covariates: Sequence[Covariates]) -> dict[str, float]:
        """What it can drive at most, by column; and the sharpest curve of these logs where it cannot turn otherwise."""
        body = self.robot.body
        given = {
            "speed_m_s": body.max_speed,
            "lateral_speed_m_s": body.max_lateral_speed,
            "yaw_rate_rad_s": body.max_yaw_rate,
            "accel_m_s2": body.max_acceleration,
            "payload_kg": body.max_payload,
        }
        most = {name: limit.value for name, limit in given.items() if limit is not None}
        return most | ({CURVATURE: sharpest(covariates)} if body.drive == "ackermann" else {})

    def unknown(self) -> Subject:
        """The robot as one of whose base nothing is known beside the logs."""
        priors = {t.name_of(n): NO_PRIOR_SD for t in self.model.terms if t.base for n in t.parameters}
        return replace(self, priors=priors)


def prior_before(subject: Subject, parameter: ModelParameter, logs: Sequence[Run]) -> float:
    """Relative standard deviation known beside these logs; `NO_PRIOR_SD` where it was fitted to these very logs.

    What was fitted to other logs is known less well here than there, see `missionsim.fit.parameters.sd_on_other_logs`.
    """
    source = subject.robot.sources.get(parameter.source, parameter.source)
    return NO_PRIOR_SD if fitted_to(source, logs) else sd_on_other_logs(parameter.prior_sd, source)


def _priors_of(subject: Subject, features: Features, logs: Sequence[Run]) -> dict[str, float]:
    """Priors of the base parameters; for those that were fitted to these very logs, so wide that they say nothing.

    Parameters of one formula of motion share its power among them as what is missing bends it, so that one may make all
    the power even where it now makes hardly any. Power at rest and of components has rows of its own, and may be a
    tenth of it where the file has hardly any.
    """
    priors = {}
    for name, parameter in features.parameters.items():
        given = (subject.priors or {}).get(name, prior_before(subject, parameter, logs))
        given = float(np.hypot(given, features.steady.get(name, 0.0)))
        priors[name] = max(given, 1e-6) if given < NO_PRIOR_SD else LEAST_FREE_SD  # 0 is as good as known
        if given < NO_PRIOR_SD:
            continue
        parts = [float(np.mean(np.abs(run.gradient[name]))) for run in features.runs if name in run.gradient]
        size = float(np.mean(parts)) if parts else 0.0
        if size > 0.0:
            power = float(np.mean([np.nanmean(np.abs(run.measured_w)) for run in features.runs]))
            priors[name] = max(LEAST_FREE_SD, (1.0 if of_formula(parameter) else OWN_ROWS) * power / size)
    return priors


@dataclass(frozen=True)
class Examined:
    """Features of the fitted runs, what the identification found in them, models to fit with it, held-out runs."""

    features: Features
    found: Identification
    models: Models
    held: tuple[Run, ...]
    priors: Mapping[str, float]
    """Of the base parameters, as the search began with them."""
    most: Mapping[str, float]
    """By column, what the robot can drive at most."""
    clock: Clock
    """Delay and lag that these runs show, the same in all."""
    _laws: list[Proposal | None] = field(default_factory=list, repr=False, compare=False)

    def law(self) -> Proposal | None:
        """The law that the identification lacks; it is looked for once."""
        if not self._laws:
            self._laws.append(propose(self.found, self.features.covariates, self.most))
        return self._laws[0]

    def known_as(self, subject: Subject, split: Split) -> Examined | None:
        """What `examine` would give for the same robot file on the same logs, at the clock that they show; None where
        other things are known of its base beside these logs."""
        if _priors_of(subject, self.features, split.train) != self.priors:
            return None
        return replace(self, models=replace(self.models, power=subject.model, clock=self.clock, _fits={}))


def examine(subject: Subject, split: Split, battery: str, settings: Settings, clock: Clock | None = None) -> Examined:
    """Features and identification of one battery, before anything is said about it."""
    own, batteries = subject.own(battery), subject.model.batteries
    measured = [log for log in split.train if battery in log.power_w]
    train, left_out = with_same_causes(measured, batteries, own)
    train, thinned = stretches(train)
    switchable = subject.switchable(battery)
    steady = [steady_speed(steady_temperatures(log)) for log in train]
    features = make_features(subject.model, steady, battery, own, switchable=switchable)
    if all(float(np.ptp(run.measured_w)) == 0.0 for run in features.runs):
        raise InputError.single(
            f"battery '{battery}': the measured power never changes in any run, so that nothing can be learned from it",
            got=f"{features.runs[0].measured_w[0]:g} W in every row",
            allowed="a meter that is not frozen",
        )

    def identified(robot: Subject, seen: Features) -> tuple[Features, Identification]:
        seen = replace(seen, prior_sd=_priors_of(robot, seen, split.train))
        seen = beside_base(seen, robot.model, train, settings)
        return seen, identify(seen.runs, seen.candidates, seen.prior_sd, settings)

    try:
        features, found = identified(subject, features)
        priors = features.prior_sd
        if found.base_doubtful(settings) and min(features.prior_sd.values(), default=np.inf) < LEAST_FREE_SD:
            free, other = identified(subject.unknown(), features)
            if refutes(other, found):  # held near the file, the base would leave its part to the effects
                subject, found = subject.unknown(), other
                features = replace(free, given_sd=features.prior_sd)
        if sum(features.steady.get(one.parameter, 0.0) * one.shift for one in found.recalibration) < 0.0:
            # a component that may be on draws something; where less is drawn than modelled, it is no reason
            features, found = identified(subject, replace(features, steady={}))
        used: dict[str, float] = {}
        for _ in range(MOST_PASSES):
            # sizes of the effects whose power is limited by what the drive can give back, where that limit is not
            # proportional to the size (see `missionsim.physics.motion.relieved_part`)
            model, sizes = found.choice.model, dict[str, float]()
            for k in model.chosen:
                candidate = features.candidates[model.design.layout.columns[k].candidate]
                size = found.choice.evidence[k].share * model.design.layout.unit(k)
                if features.effects[candidate.effect].recovers and not candidate.shape and size > 0.0:
                    sizes[candidate.effect] = max(size, 1.0)
            if all(abs(size / used.get(name, 1.0) - 1.0) < SAME_SIZE for name, size in sizes.items()):
                break
            features = at_size(features, sizes)  # what is known of the base stays
            found = identify(features.runs, features.candidates, features.prior_sd, settings)
            used = sizes
    except TooShortError as error:
        allowed = f"{FEWEST_INTERVALS} intervals of {settings.period_s:g} s or longer in a run"
        told = [(log.source, f"{log.rows} rows in {float(np.sum(log.dt_s)):.3g} s") for log in train]
        faults = [Fault(file, 0, 0, f"battery '{battery}': {error}", "", got, allowed) for file, got in told]
        raise InputError(faults) from error
    except ValueError as error:
        raise InputError.single(f"battery '{battery}': {error}") from error
    remarks = [told for told in (left_out, thinned) if told]
    names = {log.run for log in train}
    held = [log for log in split.heldout if battery in log.power_w]
    held = [replace(log, run=f"held-out {log.run}") if log.run in names else log for log in held]
    untested = lacking(held, [features.effects[effect.effect] for effect in found.effects], batteries, train)
    for run, columns in untested.items():
        remarks.append(f"{run}: no {', '.join(columns)}, which an effect found depends on; not tested on it")
    shown = _clock_of(found, min(-run.reading_s(battery) for run in train))
    models = Models(subject.model, battery, features, tuple(train), clock or shown, settings)
    features = replace(features, remarks=(*features.remarks, *remarks))
    tested = tuple(log for log in held if log.run not in untested)
    return Examined(features, found, models, tested, priors, subject.most(features.covariates), shown)


def _clock_of(found: Identification, earliest_s: float) -> Clock:
    """That of the likelihood, or the one near it at which left-out runs err less by least squares; where the base is
    far from right, that would stand for what is missing. `earliest_s`: delay below which it is not looked for."""
    model = found.choice.model
    if found.choice.forward is not None or not model.source.aligned:
        return model.clock.in_all(len(model.source.runs))
    return least_squares_clock(model.source, model.clock, model.chosen, earliest_s)

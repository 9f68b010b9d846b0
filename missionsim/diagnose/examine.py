"""What the logs say of one battery before anything is told: features, the identification, models to fit with it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from missionsim.diagnose.features import Features, at_size, make_features, steady_speed
from missionsim.diagnose.heldout import Models
from missionsim.diagnose.split import Split, lacking, stretches, with_same_causes
from missionsim.diagnose.subject import Subject, priors_of
from missionsim.errors import InputError
from missionsim.identify.align import Clock
from missionsim.identify.identification import Identification, identify, refutes
from missionsim.identify.settings import LEAST_FREE_SD, MOST_PASSES, SAME_SIZE, Settings
from missionsim.runs.run import Run


@dataclass(frozen=True)
class Examined:
    """Features of the fitted runs, what the identification found in them, models to fit with it, held-out runs."""

    features: Features
    found: Identification
    models: Models
    held: tuple[Run, ...]


def examine(subject: Subject, split: Split, battery: str, settings: Settings, clock: Clock | None = None) -> Examined:
    """Features and identification of one battery, before anything is said about it."""
    own, batteries = subject.own.get(battery, ()), subject.model.batteries
    measured = [log for log in split.train if battery in log.power_w]
    train, left_out = with_same_causes(measured, batteries, own)
    train, thinned = stretches(train)
    features = _features(subject, [steady_speed(log) for log in train], battery)
    features = replace(features, prior_sd=priors_of(subject, features, split.train))
    if all(float(np.ptp(run.measured_w)) == 0.0 for run in features.runs):
        raise InputError.single(
            f"battery '{battery}': the measured power never changes in any run, so that nothing can be learned from it",
            got=f"{features.runs[0].measured_w[0]:g} W in every row",
            allowed="a meter that is not frozen",
        )
    try:
        found = identify(features.runs, features.candidates, features.prior_sd, settings)
        if found.base_doubtful(settings) and min(features.prior_sd.values(), default=np.inf) < LEAST_FREE_SD:
            free = priors_of(subject.unknown(), features, split.train)
            other = identify(features.runs, features.candidates, free, settings)
            if refutes(other, found):  # held near the file, the base would leave its part to the effects
                subject, found = subject.unknown(), other
                features = replace(features, prior_sd=free, given_sd=features.prior_sd)
        if sum(features.steady.get(one.parameter, 0.0) * one.shift for one in found.recalibration) < 0.0:
            # a component that may be on draws something; where less is drawn than modelled, it is no reason
            features = replace(features, steady={})
            features = replace(features, prior_sd=priors_of(subject, features, split.train))
            found = identify(features.runs, features.candidates, features.prior_sd, settings)
        used: dict[str, float] = {}
        for _ in range(MOST_PASSES):
            sizes = _limited(found, features)
            if all(abs(size / used.get(name, 1.0) - 1.0) < SAME_SIZE for name, size in sizes.items()):
                break
            features, used = at_size(features, sizes), sizes
            found = identify(features.runs, features.candidates, features.prior_sd, settings)
    except ValueError as error:
        raise InputError.single(f"battery '{battery}': {error}") from error
    remarks = [told for told in (left_out, thinned) if told]
    needed = [features.effects[effect.effect] for effect in found.effects]
    held = [_renamed(log, {t.run for t in train}) for log in split.heldout if battery in log.power_w]
    untested = lacking(held, needed, batteries, train)
    held = [log for log in held if log.run not in untested]
    for run, columns in untested.items():
        remarks.append(f"{run}: no {', '.join(columns)}, which an effect found depends on; not tested on it")
    models = Models(subject.model, battery, features, tuple(train), clock or found.choice.model.clock, settings)
    return Examined(replace(features, remarks=(*features.remarks, *remarks)), found, models, tuple(held))


def _features(subject: Subject, runs: Sequence[Run], battery: str) -> Features:
    own, switchable = subject.own.get(battery, ()), subject.switchable.get(battery, ())
    return make_features(subject.model, runs, battery, own, switchable=switchable)


def _limited(found: Identification, features: Features) -> dict[str, float]:
    """Sizes in the model of the effects whose power is limited by what the drive can give back, where that limit is not
    proportional to the size (see `missionsim.physics.motion.relieved_part`)."""
    model = found.choice.model
    layout = model.design.layout
    sizes: dict[str, float] = {}
    for k in model.chosen:
        column = layout.columns[k]
        name = features.candidates[column.candidate].effect
        size = found.choice.evidence[k].share * layout.unit(k)
        if features.effects[name].recovers and not features.candidates[column.candidate].shape and size > 0.0:
            sizes[name] = max(size, 1.0)
    return sizes


def _renamed(log: Run, taken: set[str]) -> Run:
    return replace(log, run=f"held-out {log.run}") if log.run in taken else log

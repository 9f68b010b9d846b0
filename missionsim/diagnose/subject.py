"""The robot under diagnosis, and what is known of its base parameters beside these logs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from missionsim.effects.base import Effect
from missionsim.effects.model import PowerModel
from missionsim.fit.provenance import fitted_to, sd_on_other_logs
from missionsim.identify.settings import LEAST_FREE_SD

if TYPE_CHECKING:
    from missionsim.diagnose.features import Features
    from missionsim.effects.model import ModelParameter
    from missionsim.inputs.robot import RobotSpec
    from missionsim.runs.run import Run

NO_PRIOR_SD = float("inf")
"""Prior of a parameter that was fitted to these very logs: they may not count twice."""


@dataclass(frozen=True)
class Subject:
    """A robot under diagnosis: its file, power model, own candidate effects."""

    name: str
    model: PowerModel
    sources: Mapping[str, str]
    """Key of the robot file's ``sources`` → text."""
    own: Mapping[str, tuple[Effect, ...]]
    """Effects of the file that are candidates only. Mapping of battery to tuple of Effect."""
    switchable: Mapping[str, tuple[str, ...]]
    """Components that can be switched and that the battery feeds. Mapping of battery to tuple of str."""
    limits: Mapping[str, float]
    """``max_speed``, ``max_yaw_rate``, ``acceleration``."""
    priors: Mapping[str, float] | None = None
    """Relative prior standard deviations by parameter, in place of the file's."""

    @classmethod
    def of(
        cls, robot: RobotSpec, model: PowerModel | None = None, priors: Mapping[str, float] | None = None
    ) -> Subject:
        """The subject of a robot file."""
        from missionsim.inputs.power import build_effect, build_power_model

        own: dict[str, list[Effect]] = {}
        for spec in robot.effects:
            if spec.candidate:
                own.setdefault(spec.battery, []).append(build_effect(spec, robot))
        switchable = {
            battery: tuple(
                name
                for name, component in robot.components.items()
                if not component.always_on and any(load.battery == battery for load in component.loads)
            )
            for battery in robot.batteries
        }
        body = robot.body
        limits = {"max_speed": body.max_speed.value, "max_yaw_rate": body.max_yaw_rate.value}
        if body.max_acceleration is not None:
            limits["acceleration"] = body.max_acceleration.value
        return cls(
            robot.name,
            model or build_power_model(robot),
            dict(robot.sources),
            {battery: tuple(effects) for battery, effects in own.items()},
            switchable,
            limits,
            priors,
        )

    def unknown(self) -> Subject:
        """The robot as one of whose base nothing is known beside the logs."""
        priors = {t.name_of(n): NO_PRIOR_SD for t in self.model.terms if t.base for n in t.parameters}
        return replace(self, priors=priors)


def priors_of(subject: Subject, features: Features, logs: Sequence[Run]) -> dict[str, float]:
    """Priors of the base parameters; none for those that were fitted to these very logs."""
    priors = {}
    for name, parameter in features.parameters.items():
        given = (subject.priors or {}).get(name, prior_before(subject, parameter, logs))
        given = float(np.hypot(given, features.steady.get(name, 0.0)))
        priors[name] = max(given, 1e-6) if given < NO_PRIOR_SD else _no_prior(features, name)  # 0 is as good as known
    return priors


def prior_before(subject: Subject, parameter: ModelParameter, logs: Sequence[Run]) -> float:
    """Relative standard deviation known beside these logs; `NO_PRIOR_SD` where it was fitted to these very logs.

    What was fitted to other logs is known less well here than there, see `missionsim.fit.provenance.sd_on_other_logs`.
    """
    source = subject.sources.get(parameter.source, parameter.source)
    return NO_PRIOR_SD if fitted_to(source, logs) else sd_on_other_logs(parameter.prior_sd, source)


def of_formula(parameter: ModelParameter) -> bool:
    """Whether a parameter is one of several in the formula of motion, and no power of its own."""
    return parameter.path.startswith("motion.") and not parameter.path.endswith(".standing")


def _no_prior(features: Features, name: str) -> float:
    """So wide that it says nothing.

    Parameters of one formula of motion share its power among them as what is missing bends it, so that one may make all
    the power even where it now makes hardly any. Power at rest and of components has rows of its own.
    """
    parts = [float(np.mean(np.abs(run.gradient[name]))) for run in features.runs if name in run.gradient]
    size = float(np.mean(parts)) if parts else 0.0
    if not of_formula(features.parameters[name]) or size <= 0.0:
        return LEAST_FREE_SD
    power = float(np.mean([np.nanmean(np.abs(run.measured_w)) for run in features.runs]))
    return max(LEAST_FREE_SD, power / size)

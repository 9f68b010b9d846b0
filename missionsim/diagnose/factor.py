"""One factor on everything: wrong units, another robot's file, a meter of another kind; no missing effect."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from missionsim.diagnose.priors import LEAST_FREE_SD
from missionsim.identify.data import RunData
from missionsim.identify.gram import project
from missionsim.identify.heldout import heldout
from missionsim.identify.result import Identification

LEVEL_SHARE = 0.10
"""A difference of the energies in all runs, beyond recalibration and effects, that no good meter makes."""
AT_LEVEL = 0.05
"""Where the file as it stands gives the measured energy within this, no factor lies between meter and model."""
AS_MUCH = 0.9
"""A single factor that explains this part of what the effects explain is the simpler answer."""


def level_told(factor: float) -> str:
    """In words, that meter and model differ by a factor."""
    return (
        f"the meter reads {factor:.3g} times what the model gives in every run, whatever the robot does: check the "
        "units of the log and the robot file, or look for a load that is always on"
    )


def may_differ(runs: Sequence[RunData], prior_sd: Mapping[str, float]) -> bool:
    """Whether a factor between meter and model can be told at all.

    Not where the energies agree without any fit: a factor that shows only beside effects or a recalibration is the
    work of these. Nor where base parameters have no prior, as those fitted to these very logs: they follow the meter.
    """
    if any(sd >= LEAST_FREE_SD for sd in prior_sd.values()):
        return False
    return abs(plain_ratio(runs) - 1.0) > AT_LEVEL


def plain_ratio(runs: Sequence[RunData]) -> float:
    """Measured energy over that of the file's model as it stands, all runs together."""
    measured = modelled = 0.0
    for run in runs:
        seen = np.isfinite(run.measured_w)
        measured += float(run.dt_s[seen] @ run.measured_w[seen])
        modelled += float(run.dt_s[seen] @ run.base_w[seen])
    return measured / modelled if modelled > 0.0 else np.inf


def common_factor(found: Identification) -> tuple[float, float]:
    """The factor on the whole model that fits best, and the part of the effects' gain that it alone makes.

    Both are judged with the noise of the model that has the effects, base parameters and differences between runs
    integrated out, so that a factor within the priors counts for nothing.
    """
    model = found.choice.model
    design = model.design
    seen = project(design, model.noise, np.vstack([design.residual, design.base]), ())
    left, base = np.hstack([seen.rows, seen.pseudo])
    size = float(base @ base)
    if not model.chosen or size <= 0.0:
        return 1.0, 0.0
    product = float(left @ base)
    gain = model.gram.gain(model.chosen)
    return 1.0 + product / size, 0.5 * product**2 / size / gain if gain > 0.0 else 0.0


def without_factor(found: Identification, runs: Sequence[RunData], prior_sd: Mapping[str, float]) -> Identification:
    """The same findings; effects that only make up for one factor on the whole model are not named.

    Friction, a standing load and what components draw, each with its own size, imitate a meter that reads 1.5 times too
    much. A factor says the same with one number.
    """
    if not found.effects or not may_differ(runs, prior_sd):
        return found
    factor, part = common_factor(found)
    if abs(factor - 1.0) < LEVEL_SHARE or part < AS_MUCH:
        return found
    names = {e.effect for e in found.effects} | set(found.demoted)
    effects = " and ".join(e.effect for e in found.effects)
    told = (
        f"the meter reads {factor:.3g} times what the model gives, whatever the robot does, which explains as much "
        f"as {effects} would: check the units of the log, the meter and the robot file"
    )
    candidates = tuple(
        replace(c, accepted=False, reason=f"a factor of {factor:.3g} on the whole model explains as much")
        if c.effect in names
        else c
        for c in found.candidates
    )
    left = found.unexplained
    shape = "; ".join(text for text in (told, left.shape) if text)
    return replace(
        found,
        verdict="unexplained_structure",
        effects=(),
        candidates=candidates,
        demoted=tuple(sorted(names)),
        unexplained=replace(left, depends_on=(), shape=shape),
    )


def level_difference(found: Identification, runs: Sequence[RunData], prior_sd: Mapping[str, float]) -> str:
    """In words, that model and meter differ by much in all runs, whatever the robot does; empty where they do not.

    An unknown offset and gain of the meter in each run are part of the noise model. They are for per cents: wrong
    units, another robot's file or a large constant load must not hide in them.
    """
    if not may_differ(runs, prior_sd):
        return ""
    errors = np.array([run.energy_error[2] for run in heldout(found, runs).runs])
    if not (np.all(errors > LEVEL_SHARE) or np.all(errors < -LEVEL_SHARE)):
        return ""
    factor = 1.0 / (1.0 + float(np.median(errors)))
    return level_told(factor) if (factor - 1.0) * (plain_ratio(runs) - 1.0) > 0.0 else ""

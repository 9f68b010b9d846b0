"""Levels of a label that is constant in every run, such as the floor: all at once, with the runs as the sample.

One level at a time has to lead the differences between all other runs, which a random effect of the run takes as well.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify.evidence import cause_is_constant, evidence_of
from missionsim.identify.forward import Choice
from missionsim.identify.model import fit_model, log_likelihood, prediction
from missionsim.identify.rules import weigh, weighed
from missionsim.identify.settings import LABEL_LEVEL, UNUSUAL_GAIN


def with_levels(choice: Choice) -> Choice:
    """The choice with every level of a label by which the runs differ."""
    constraints = choice.model.constraints
    for number in constraints.numbers(np.flatnonzero(constraints.joint)):
        own = [int(k) for k in np.flatnonzero(constraints.effect == number)]
        model = choice.model
        rest = tuple(k for k in model.chosen if k not in own)
        p_value = _between(choice, own, rest)
        if not p_value < LABEL_LEVEL or set(own) <= set(model.chosen):
            continue
        # a noise that had taken the floors for runs that differ may keep them: the fit begins anew
        model = fit_model(model.source, (*rest, *own))
        common = 0.5 * constraints.settings.recalibration_limit**2
        every, asked, gone = tuple(own), 0, list[int]()
        while len(own) > 1:
            shares = model.gram.coefficients(model.chosen)[0][len(rest) :]
            # the floor that costs least is that of the base, where recalibration takes what all floors have in common
            least = min(own, key=lambda k: shares[own.index(k)] * model.design.layout.unit(k))
            lost = model.gram.gain(model.chosen) - model.gram.gain([k for k in model.chosen if k != least])
            if shares.min() > 0.0 and (gone or lost > common):
                break
            # beside the others another one may cost less than it
            gone, asked = [least] if asked == 1 else [*gone, least], asked + 1
            own = [k for k in every if k not in gone]
            model = fit_model(model.source, (*rest, *own), model, thorough=False)
        evidence = {k: replace(evidence_of(model, k), p_robust=p_value, p_runs=p_value) for k in own}
        evidence |= {k: weigh(model, k) for k in rest}
        choice = replace(choice, model=model, evidence=evidence)
    return choice


def with_what_runs_differ_by(choice: Choice) -> Choice:
    """The choice with the effect, such as a payload, whose cause is constant in runs and by which they differ, where a
    noise fitted beside something louder had taken that for runs that differ unusually."""
    model = choice.model
    options = []
    for k in np.flatnonzero(~model.constraints.joint) if model.noise.motion_gain > UNUSUAL_GAIN else ():
        if int(k) in model.chosen or not cause_is_constant(model, int(k)):
            continue
        fresh = fit_model(model.source, (*model.chosen, int(k)))
        evidence = weighed(fresh)
        if all(e.accepted for e in evidence.values()):
            options.append((log_likelihood(fresh), replace(choice, model=fresh, evidence=evidence)))
    return max(options, key=lambda option: option[0])[1] if options else choice


def _between(choice: Choice, own: Sequence[int], rest: Sequence[int]) -> float:
    """F test, runs being the sample: p-value of the differences between levels against those between their runs."""
    from scipy.special import fdtrc

    model, design = choice.model, choice.model.design
    left = design.y - prediction(model, rest, design)  # a base that is off differs from run to run by how they drive
    acts = np.array([[np.abs(design.phi[k, rows]).sum() for k in own] for rows in design.runs])
    if np.any(np.sum(acts > 0.0, axis=1) > 1):
        return 1.0  # a label that changes in runs is asked there
    levels = np.argmax(acts, axis=1)
    wants = np.empty(len(levels))  # what each run alone would have its level draw
    for j, (rows, i) in enumerate(zip(design.runs, levels, strict=True)):
        x = design.phi[own[i], rows] - design.phi[own[i], rows].mean()
        wants[j] = float(x @ left[rows]) / max(float(x @ x), 1e-300)
    groups = [wants[levels == i] for i in np.unique(levels)]
    within, freedom = sum(float(np.sum((g - g.mean()) ** 2)) for g in groups), len(wants) - len(groups)
    between = sum(len(g) * float(g.mean() - wants.mean()) ** 2 for g in groups)
    if len(groups) < 2 or freedom < 1:
        return 1.0
    return float(fdtrc(len(groups) - 1, freedom, between / (len(groups) - 1) / max(within / freedom, 1e-300)))

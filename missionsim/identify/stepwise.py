"""Stepwise search: add the best effect, refit clock and noise, ask the gates, swap, until nothing passes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache

import numpy as np

from missionsim.identify import settings as const
from missionsim.identify.design import Source
from missionsim.identify.evidence import Evidence, cause_is_constant, chance_of, evidence_of, nats_needed, tails
from missionsim.identify.forward import Choice, Forward, forward
from missionsim.identify.gram import best_set, make_gram, single_gains
from missionsim.identify.model import Model, fit_model, log_likelihood, prediction
from missionsim.identify.noise import bounded_noise, without_outliers
from missionsim.identify.profile import refit_shapes
from missionsim.identify.residual import low_frequency_noise
from missionsim.identify.rules import last_gates, weighed


def choose(source: Source) -> Choice:
    """Search for the missing effects."""
    selected = forward(source)
    if selected is not None:
        return _by_prediction(source, selected)
    empty = fit_model(source, ())
    found = Choice(empty, empty, {})
    # each effect in the model lets the noise shrink, which shows the next
    while len(found.model.chosen) < source.constraints.settings.max_effects and source.layout.columns:
        step = _next_step(source, found)
        if step is None:
            break
        found, source = step, step.model.source
    found = with_what_runs_differ_by(with_levels(found))
    noise = found.model.noise
    apart = noise.offset_w > const.USUAL_GAIN * source.layout.mean_power_w or noise.motion_gain > const.UNUSUAL_GAIN
    if len(source.runs) > const.SEVERAL_RUNS and (apart or low_frequency_noise(found.model) is not None):
        # of a column that is noisy or late, or constant in runs, what runs differ by and a noise as slow as it is take
        # what it says
        selected = forward(source, near=True)
        if selected is not None and selected.stands(confirmed(found).model):
            return _by_prediction(source, selected)
    return found


def _by_prediction(source: Source, selected: Forward) -> Choice:
    """The choice that the selection by prediction made, with a noise model that cannot take the signal."""
    design = source.design(selected.clock)
    noise = bounded_noise(design, selected.squares, selected.chosen)
    model = Model(source, selected.chosen, selected.clock, design, noise, selected.squares)
    empty = replace(model, chosen=(), noise=bounded_noise(design, selected.squares, ()))
    inside = {k: selected.evidence(k) for k in selected.chosen}
    outside = {k: selected.evidence(k) for t in selected.trials.values() for k in t.columns if k not in inside}
    return Choice(model, empty, inside, outside, selected)


def _next_step(source: Source, found: Choice) -> Choice | None:
    """The model with one effect more, or another set of that size; None where no set passes the gates."""
    model, owed = found.model, source.constraints.grid_nats
    # why a candidate was refused is told in the end, whichever step refused it
    refused = dict(found.refused)

    @cache
    def anew(chosen: tuple[int, ...]) -> Model:
        return fit_model(source, chosen)

    for trials in _trials(model, refused):
        options: list[tuple[float, Choice]] = []
        for trial in trials:
            fitted = fit_model(source, trial, model, thorough=False)
            evidence = weighed(fitted, fitted.chosen)
            if {gate for e in evidence.values() for gate, passed in e.passed.items() if not passed} == {"practical"}:
                # at the clock and noise of the model without it, most of it may have been taken for either
                fitted = anew(trial)
                evidence = weighed(fitted, fitted.chosen)
            if all(e.accepted for e in evidence.values()):
                value = log_likelihood(fitted) - float(np.sum(owed[list(trial)]))
                options.append((value, Choice(fitted, found.empty, evidence)))
            else:
                refused.update({c: e for c, e in evidence.items() if c not in model.chosen and not e.accepted})
        # of twins, which differ by rounding, the one that the library has first, on every machine
        for _, best in sorted(options, key=lambda one: (-round(one[0], 6), one[1].model.chosen)):
            # the noise without an effect had swallowed it, and a fit that begins there may stay there
            fresh = anew(best.model.chosen)
            if log_likelihood(fresh) > log_likelihood(best.model) + const.FRESH_NATS:
                best = replace(best, model=fresh, evidence=weighed(fresh, fresh.chosen))
            # what is left beside an effect is judged with that effect at its best: a reference temperature 5 K off
            # leaves a constant friction over; and the effect itself is asked again there
            new = set(best.model.chosen) - set(model.chosen)
            bent, _ = refit_shapes(best, new, limited=False)
            failed = {k: e for k, e in bent.evidence.items() if not e.accepted}
            if not failed:
                bent.refused.update(refused)
                return bent
            refused.update({k: e for k, e in failed.items() if k in new})
    found.refused.update(refused)
    return None


def confirmed(choice: Choice) -> Choice:
    """The choice without effects that fail a gate now that all are in: the weakest goes first, the others are asked
    again."""
    for e in choice.evidence.values():
        e.passed.update(last_gates(choice.model, e))
    while failed := [k for k, e in choice.evidence.items() if not e.accepted]:
        weakest = min(failed, key=lambda k: choice.evidence[k].gain)
        rest = tuple(k for k in choice.model.chosen if k != weakest)
        model = fit_model(choice.model.source, rest, choice.model, thorough=False)
        refused = {**choice.refused, weakest: choice.evidence[weakest]}
        choice = replace(choice, model=model, evidence=weighed(model, model.chosen), refused=refused)
    return choice


def _trials(model: Model, refused: dict[int, Evidence]) -> list[list[tuple[int, ...]]]:
    """Sets that are worth a fit with a noise of their own: the best single additions and the best set of that size, and
    the next additions, for the case that none of those passes."""
    constraints = model.constraints
    # what the model lacks looks like outliers to it, so that their weights would hide what is loudest
    gram = make_gram(model.design, without_outliers(model.design, model.noise))
    gains = single_gains(gram, constraints, model.chosen)
    needed = nats_needed(float(np.max(tails(constraints, bool(model.chosen)))))
    order = [int(k) for k in np.argsort(-gains) if np.isfinite(gains[k]) and gains[k] > const.PROMISING * needed]
    rest = gram.conditional(model.chosen)
    best: list[int] = []
    for k in order:
        # one column of a grid is enough: its shape is refitted anyway
        if any(constraints.effect[k] == constraints.effect[o] for o in best):
            continue
        if abs(rest[0, 1 + k]) / rest[1 + k, 1 + k] < const.GLANCE * constraints.settings.min_share:
            if k not in refused:  # too small to matter, without a refit of the noise
                own, gain = model.gram.conditional(model.chosen)[[0, 1 + k], 1 + k], float(gains[k])
                refused[k] = Evidence(
                    column=k,
                    gain=gain,
                    share=float(own[0] / own[1]),
                    share_sd=float(np.sqrt(1.0 / own[1])),
                    p_robust=chance_of(gain),
                    p_runs=float("nan"),
                    passed={"practical": False},
                )
            continue
        best.append(k)
    close = [k for k in best[: const.TRIED] if gains[k] >= const.CLOSE * gains[best[0]]]
    further = best[len(close) : len(close) + const.TRIED]
    trials = [(*model.chosen, k) for k in close]
    if trials and model.chosen:
        swapped = best_set(gram, constraints, len(model.chosen) + 1, trials[0])
        if set(swapped) not in [set(t) for t in trials]:
            trials.append(swapped)
    return [trials, [(*model.chosen, k) for k in further]]


def forced(source: Source, effects: Sequence[str]) -> Choice:
    """Fit given effects without a search: the best column of each grid, all levels of a label that act.

    Raises
    ------
    ValueError
        If an effect is unknown or has no column that acts in these runs.
    """
    selected = forward(source, effects)
    if selected is not None:
        return _by_prediction(source, selected)
    constraints = source.constraints
    model = empty = fit_model(source, ())
    for name in effects:
        own = [k for k in range(len(source.layout.columns)) if constraints.of_column(k).effect == name]
        if not own:
            raise ValueError(f"effect {name} has no column that acts in these runs")
        if constraints.joint[own[0]]:
            gains = single_gains(model.gram, constraints, model.chosen)
            new = [k for k in own if np.isfinite(gains[k]) and gains[k] > const.JOINT_NATS]
            new = new or [own[int(np.argmax(gains[own]))]]
        else:
            # asked for by name: a wrong sign is told, not hidden
            rest = model.gram.conditional(model.chosen)
            unsigned = [0.5 * rest[0, 1 + k] ** 2 / max(rest[1 + k, 1 + k], 1e-300) for k in own]
            new = [own[int(np.argmax(unsigned))]]
        model = fit_model(source, (*model.chosen, *new), model, thorough=False)
    return Choice(model, empty, weighed(model, model.chosen))


def with_levels(choice: Choice) -> Choice:
    """The choice with every level of a label, constant in every run as the floor is, by which the runs differ.

    All at once, with the runs as the sample: one level at a time has to lead the differences between all other runs,
    which a random effect of the run takes as well.
    """
    constraints = choice.model.constraints
    for number in constraints.numbers(np.flatnonzero(constraints.joint)):
        own = [int(k) for k in np.flatnonzero(constraints.effect == number)]
        model = choice.model
        rest = tuple(k for k in model.chosen if k not in own)
        p_value = _between(choice, own, rest)
        if not p_value < const.LABEL_LEVEL or set(own) <= set(model.chosen):
            continue
        # a noise that had taken the floors for runs that differ may keep them: the fit begins anew
        model = fit_model(model.source, (*rest, *own))
        common = 0.5 * constraints.settings.recalibration_limit**2
        every, asked, gone = tuple(own), 0, list[int]()
        while len(own) > 1:
            shares = model.gram.shares(model.chosen)[len(rest) :]
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
        evidence |= weighed(model, rest)
        choice = replace(choice, model=model, evidence=evidence)
    return choice


def with_what_runs_differ_by(choice: Choice) -> Choice:
    """The choice with the effect, such as a payload, whose cause is constant in runs and by which they differ, where a
    noise fitted without it had taken that for runs that differ by more than is usual."""
    model = choice.model
    options = []
    for k in np.flatnonzero(~model.constraints.joint) if model.noise.motion_gain > const.USUAL_GAIN else ():
        if int(k) in model.chosen or not cause_is_constant(model, int(k)):
            continue
        fresh = fit_model(model.source, (*model.chosen, int(k)))
        evidence = weighed(fresh, fresh.chosen)
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
    driven = np.flatnonzero(acts.any(axis=1))  # of the floor on which it stood a run says nothing
    levels = np.argmax(acts[driven], axis=1)
    groups = [np.flatnonzero(levels == i) for i in np.unique(levels)]
    freedom = len(driven) - len(groups)
    if len(groups) < 2 or freedom < 1:
        return 1.0
    usual = (model.noise.total_sd_w / (const.USUAL_GAIN * design.layout.mean_power_w)) ** 2
    least = 1.0
    # beside any offset of the run, as of a base that is off, or such as meters have: at one speed there is no other
    for offset in (1e-9, usual):
        wants = np.empty(len(driven))  # what each run alone would have its level draw
        for j, (n, i) in enumerate(zip(driven, levels, strict=True)):
            x = np.column_stack([design.phi[own[i], design.runs[n]], np.ones_like(left[design.runs[n]])])
            wants[j] = np.linalg.solve(x.T @ x + np.diag([1e-9, offset]), x.T @ left[design.runs[n]])[0]
        within = sum(float(np.sum((wants[g] - wants[g].mean()) ** 2)) for g in groups)
        between = sum(len(g) * float(wants[g].mean() - wants.mean()) ** 2 for g in groups)
        f = between / (len(groups) - 1) / max(within / freedom, 1e-300)
        least = min(least, float(fdtrc(len(groups) - 1, freedom, f)))
    return min(1.0, 2.0 * least)  # two questions

"""Coefficients of the effects found with 95 % intervals, and the effects that these data cannot tell from them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from missionsim.identify.data import Constraints
from missionsim.identify.evidence import cause_is_constant, constant_in_most, driven_for
from missionsim.identify.findings import Estimate, Finding, Structure
from missionsim.identify.forward import Choice
from missionsim.identify.gram import Gram, all_sets, set_gains, single_gains
from missionsim.identify.model import Model
from missionsim.identify.residual import ramps, stands_without
from missionsim.identify.settings import (
    ACTS_PART,
    APART,
    BESIDE_RUN_LEVEL,
    EXTRA_EFFECT_NATS,
    KEPT_PART,
    NOISY_SLOPE,
    ODDS_NATS,
    RAMP_SYSTEMATIC,
    RIVAL_PART,
    RUN_LEVEL,
    SAME_COLUMN,
    THERE_SD,
)
from missionsim.physics import Array

Z95 = 1.959963984540054


Alike = Mapping[str, Mapping[str, tuple[float, float]]]
"""Effect in the model → any other one → their correlation, and the expected log-likelihood lead over it [nats]."""


def rivals(model: Model, effect: int) -> tuple[str, ...]:
    """Effects that could stand in the place of `effect` (a candidate number) in the model.

    A rival replaces all columns of the effect, alone or (at a price) with one further effect. Forms are never
    exact, so a rival is kept also when it loses only a small part of the effect's own gain.

    So is an effect of the same covariate whose power is proportional to that of one of them away from ramps: at one
    cruise speed v, v2 and v3 are the same column, and what then prefers one of them is noise.
    """
    constraints, candidates = model.constraints, model.constraints.candidates
    close = _close_ones(model, effect)
    named = [effect, *sorted(close, key=lambda o: close[o])]
    covariates = {candidates[n].covariate for n in named if candidates[n].covariate}
    rows = model.design.phi[:, ~ramps(model)]
    size = np.linalg.norm(rows, axis=1)
    found: list[int] = []
    for a in (k for k in range(len(rows)) if constraints.effect[k] in named):
        for b in range(len(rows)):
            other = constraints.of_column(b)
            if constraints.effect[b] in (*named, *found) or other.covariate not in covariates:
                continue
            if other.covariate != constraints.of_column(a).covariate or constraints.joint[b]:
                continue
            if rows[a] @ rows[b] > SAME_COLUMN * size[a] * size[b] > 0:
                found.append(int(constraints.effect[b]))
    return tuple(candidates[o].effect for o in (*named[1:], *found))


def _close_ones(model: Model, effect: int) -> dict[int, float]:
    """Rivals and how many nats they are behind."""
    gram, constraints = model.gram, model.constraints
    own, rest = constraints.split(model.chosen, effect)
    base = gram.gain(rest)
    gain = gram.gain(model.chosen) - base
    gain -= float(constraints.grid_nats[own[0]])
    found: dict[int, float] = {}
    columns: dict[int, int] = {}

    def own_beside(others: Sequence[int]) -> bool:
        # what floors explain beside others is their own (Davidson and MacKinnon 1981); noisy covariates leave some over
        return bool(constraints.joint[own[0]]) and gram.gain([*others, *own]) - gram.gain(others) > RIVAL_PART * gain

    singles = single_gains(gram, constraints, rest) - constraints.grid_nats
    for k, value in enumerate(singles):
        other = int(constraints.effect[k])
        better = other != effect and np.isfinite(value) and value > found.get(other, 0.0)
        if better and not own_beside([*rest, k]):
            found[other], columns[other] = float(value), k
    # triples of columns are the most that are searched in full
    if len(own) == 1 and len(rest) <= 1:
        for other, value in _pairs_without(model, rest, effect, own_beside).items():
            found[other] = max(found.get(other, -np.inf), value - base - EXTRA_EFFECT_NATS)
    close: dict[int, float] = {}
    settings, covariate = constraints.settings, constraints.candidates[effect].covariate
    for other, value in found.items():
        same = constraints.candidates[other].covariate == covariate
        loss = (settings.rival_loss if same else settings.noisy_rival_loss) * gain
        if constraints.candidates[other].covariate == "slope_rad" and not same:
            loss *= NOISY_SLOPE
        if len(own) == 1 and other in columns and not same and _lead_where_apart(gram, rest, own[0], columns[other]):
            loss = 0.0
        if gain - value < max(ODDS_NATS, loss):
            close[other] = gain - value
    return close


def _lead_where_apart(gram: Gram, rest: Sequence[int], own: int, other: int) -> bool:
    """Whether an effect leads a rival in the runs in which their powers differ, each at its size in all runs. Noise of
    a cause takes from it everywhere, and where the two differ the cause leads nevertheless."""
    rows = np.r_[0, 1 + gram.q + np.array([own, other])]
    beside = np.r_[1 : 1 + gram.q, 1 + gram.q + np.asarray(rest, dtype=np.intp)]
    total = gram.per_run.sum(axis=0)
    inner = total[np.ix_(beside, beside)] + np.diag(np.r_[gram.prior_precision, np.zeros(len(rest))])
    left = np.zeros((total.shape[0], 3))
    left[rows, range(3)] = 1.0
    left[beside] -= np.linalg.solve(inner + 1e-12 * np.diag(np.diag(inner)), total[np.ix_(beside, rows)])
    runs = left.T @ gram.per_run @ left
    whole = runs.sum(axis=0)
    size = whole[0, 1:] / np.maximum(np.diag(whole)[1:], 1e-300)
    powers = size * size * np.diagonal(runs, axis1=1, axis2=2)[:, 1:]
    lead = (size * runs[:, 0, 1:] - 0.5 * powers) @ [1.0, -1.0]
    differ = powers.sum(axis=1) - 2.0 * size[0] * size[1] * runs[:, 1, 2] > APART * powers.max(axis=1)
    differ &= powers.max(axis=1) > ACTS_PART * powers.max()  # where neither acts, noise of a cause is all that differs
    return bool(lead[differ].sum() > ODDS_NATS)


def _pairs_without(
    model: Model, rest: Sequence[int], effect: int, own_beside: Callable[[Sequence[int]], bool]
) -> dict[int, float]:
    """Best total gain of rest plus two effects in place of `effect`, credited to those that are not negligible."""
    gram, constraints = model.gram, model.constraints
    sets = all_sets(constraints, 2 + len(rest))
    keep = np.all(constraints.effect[sets] != effect, axis=1)
    for k in rest:
        keep &= np.any(sets == k, axis=1)
    sets = sets[keep]
    if not len(sets):
        return {}
    gains = set_gains(gram, constraints, sets)
    out: dict[int, float] = {}
    singles = 0.5 * gram.full[0, 1:] ** 2 / np.maximum(np.diag(gram.full)[1:], 1e-300)
    for row in np.argsort(-gains)[:40]:
        if not np.isfinite(gains[row]):
            break
        some = [int(k) for k in sets[row]]
        if own_beside(some):
            continue
        share = dict(zip(some, np.abs(gram.shares(some)), strict=True))
        new = [k for k in share if k not in rest and share[k] > constraints.settings.min_share]
        for k in new:
            # the smaller of two that explain it together is an aid, not the explanation
            if singles[k] >= 0.5 * max(singles[j] for j in new):
                other = int(constraints.effect[k])
                out[other] = max(out.get(other, -np.inf), float(gains[row]))
    return out


def imitated(
    gram: Gram, constraints: Constraints, rest: Sequence[int], column: int, value: float
) -> tuple[Array, float]:
    """How well each column imitates one of coefficient `value`, once base parameters, run effects and the `rest` of the
    model are projected out: r, shape (p,), 0 where the sign of its coefficient forbids it, NaN where nothing is left of
    it; and the expected lead over no column at all [nats]."""
    left = gram.conditional(rest)[1:, 1:]
    size = np.diag(left)
    there = size > 1e-9 * np.diag(gram.full)[1:]
    r = left[column] / np.sqrt(size[column] * np.where(there, size, np.nan))
    return np.where(constraints.sign * r * value < 0.0, 0.0, r), 0.5 * value**2 * float(size[column])


def pairs(model: Model) -> Alike:
    """How well each effect in the model can be told from every other effect (see `imitated`)."""
    gram, constraints = model.gram, model.constraints
    out: dict[str, dict[str, tuple[float, float]]] = {}
    for value, a in zip(gram.shares(model.chosen), model.chosen, strict=True):
        rest = [k for k in model.chosen if k != a]
        r, lead = imitated(gram, constraints, rest, a, float(value))
        row = out.setdefault(constraints.of_column(a).effect, {})
        there = [b for b in np.flatnonzero(np.isfinite(r)).tolist() if b not in rest]
        others = [b for b in there if constraints.effect[b] != constraints.effect[a]]
        for b in sorted(others, key=lambda b: abs(r[b])):  # of an effect the likest column comes last and stays
            row[constraints.of_column(b).effect] = float(r[b]), lead * float(1.0 - min(1.0, r[b] ** 2))
    return out


def estimated(
    choice: Choice, shapes: Mapping[str, Mapping[str, float]], alike: Alike, remains: Sequence[Structure] = ()
) -> tuple[Finding, ...]:
    """Every effect in the model, the one with the largest gain first.

    Parameters
    ----------
    shapes : mapping
        Refitted shape parameters of each effect, with ``.low`` and ``.high`` for their limits.
    alike : Alike
        How well each effect is told from others.
    remains : sequence of Structure
        What they leave over.
    """
    model, constraints = choice.model, choice.model.constraints
    value, _ = model.estimate(model.chosen)
    sizes = dict(zip(model.chosen, value[len(model.design.layout.parameters) :].tolist(), strict=True))
    # part of each column that hides in the recalibration of the base model
    plain = np.maximum(np.diag(model.gram.per_run.sum(axis=0))[1 + model.gram.q :], 1e-300)
    absorbed = 1.0 - np.clip(np.diag(model.gram.full)[1:] / plain, 0.0, 1.0)
    out: list[Finding] = []
    for number in constraints.numbers(model.chosen):
        candidate = constraints.candidates[number]
        own, _ = constraints.split(model.chosen, number)
        evidence = [choice.evidence[k] for k in own]
        parameters, reach = _sized(choice, own, sizes)
        much = candidate.much(max(p.value for p in parameters.values()))
        shape = shapes.get(candidate.effect, {})
        for name in (n for n in shape if not n.endswith((".low", ".high"))):
            unit = "s" if name.startswith("tau") else ("degC" if name.lower().startswith("t0") else "1")
            low, high = (shape.get(f"{name}.{end}", shape[name]) for end in ("low", "high"))
            parameters[name] = Estimate(shape[name], low, high, unit)
        share = sum(sizes[k] for k in own)
        similar = _similar(choice, number, sizes) or _of_a_form(choice, number, remains)
        # what a component draws is the component's whether it fades after switching on or not: the plain form is named
        family, _, part = candidate.effect.partition(":")
        forms = tuple(name for name in similar if family == "component_power" and name == f"component_warmup:{part}")
        similar = tuple(name for name in similar if name not in forms)
        fades = f"it may fade after {part} is switched on ({forms[0]} fits alike)" if forms else ""
        shared = () if similar or forms else _shared(model, own)
        leads = {name: nats for name, (_, nats) in alike.get(candidate.effect, {}).items()}
        # where rivals are told, the lead over them is what is asked
        among = [leads[name] for name in similar if name in leads] or list(leads.values())
        # the selection by prediction asks no likelihood
        p_values = [e.p_value if choice.forward is None else e.p_robust for e in evidence]
        repeated = max(evidence, key=lambda e: e.gain).p_runs < RUN_LEVEL
        out.append(
            Finding(
                effect=candidate.effect,
                parameters=parameters,
                energy_share=share,
                share_low=share - reach,
                share_high=share + reach,
                p_value=min(p_values),
                p_runs=min((e.p_runs for e in evidence), default=float("nan")),
                gain_nats=max(e.gain for e in evidence),
                level="identified, repeated across runs" if repeated else "identified",
                indistinguishable_from=similar,
                other_forms=forms,
                shared_with=shared,
                separation_nats=min(among, default=float("nan")),
                absorbed=float(absorbed[own].min()),
                remark="; ".join(filter(None, (much, fades))),
            )
        )
    return tuple(sorted(out, key=lambda f: -f.gain_nats))


def _sized(choice: Choice, own: Sequence[int], sizes: Mapping[int, float]) -> tuple[dict[str, Estimate], float]:
    """Coefficients of an effect's columns with their intervals, and the half interval of its share of the energy.

    The systematic error of a coefficient is that of the form of the effect, of blurred ramps, and of the meter's gain.
    """
    model, candidate = choice.model, choice.model.constraints.of_column(own[0])
    layout, settings, gram = model.design.layout, model.constraints.settings, model.gram
    edge, base = ramps(model), model.design.base**2
    usual = float(base[edge].sum() / max(float(base.sum()), 1e-300))
    # each run has a meter gain of its own, the coefficient their mean
    gain = model.noise.gain / np.sqrt(len(model.design.runs))
    parameters: dict[str, Estimate] = {}
    share_sd: list[float] = []
    for k in own:
        # how much more of the column than of the base model's power lies beside ramps, from 0 to 1: where the whole
        # drive is one ramp, all columns are blurred alike and keep their relations
        square = model.design.phi[k] ** 2
        part = float(square[edge].sum() / max(float(square.sum()), 1e-300))
        on_ramps = max(0.0, part - usual) / max(1.0 - usual, 1e-9)
        # the more of an effect hides in recalibration, the smaller the part its coefficient rests on, and the larger
        # what an error of the form does to it; a twin that is wholly hidden has no finite error
        whole = float(gram.per_run[:, 1 + gram.q + k, 1 + gram.q + k].sum())
        left = max(float(gram.full[1 + k, 1 + k]), 1e-12 * whole)
        hidden = settings.form_error * np.sqrt(whole / left) if left > 0 else 0.0
        systematic = float(np.linalg.norm([settings.systematic, hidden, RAMP_SYSTEMATIC * on_ramps, gain]))
        e, unit = choice.evidence[k], layout.unit(k)
        form = abs(sizes[k]) * systematic
        share_sd.append(float(np.linalg.norm([e.share_sd, e.shape_sd, form])))
        half = Z95 * float(np.linalg.norm([e.share_sd, sizes[k] * e.unit_shape_sd, form])) * unit
        level = candidate.levels[layout.columns[k].position] if candidate.levels else ""
        size = sizes[k] * unit
        name = f"{candidate.coefficient}_{level}" if level else candidate.coefficient
        parameters[name] = Estimate(size, size - half, size + half, candidate.unit)
    return parameters, Z95 * float(np.linalg.norm(share_sd))


def _shared(model: Model, own: Sequence[int]) -> tuple[str, ...]:
    """Effects that may have much of one in the model: where such an effect has the most that its 95 % interval beside
    it allows, it keeps less than `KEPT_PART` of its size; or that are there by `THERE_SD`, whatever gate refused them.

    A load that goes with the cold from run to run explains what both cost, at twice its size. Each run is one
    observation of causes that are constant in runs, so that one being better than the other says little against both.
    """
    gram, constraints = model.gram, model.constraints
    rest = [k for k in model.chosen if k not in own]
    if len(own) > 1 or not constant_in_most(model, own[0]):
        return ()
    alone, found = float(gram.shares([*rest, *own])[-1]), list[str]()
    inside = constraints.effect[[*model.chosen]]
    for k in np.flatnonzero(~np.isin(constraints.effect, inside)).tolist():
        name = constraints.of_column(k).effect
        if name in found or not constant_in_most(model, k):
            continue
        (size, other), covariance = (part[-2:] for part in gram.coefficients([*rest, *own, k]))
        sd, sign = float(np.sqrt(covariance[1, -1])), constraints.sign[k]
        most = other + np.copysign(Z95 * sd, sign)
        kept = size + covariance[0, -1] / covariance[1, -1] * (most - other)
        if most * sign > 0.0 and (kept / alone < KEPT_PART or other * sign > THERE_SD * sd):
            found.append(name)
    return tuple(found)


def _of_a_form(choice: Choice, number: int, remains: Sequence[Structure]) -> tuple[str, ...]:
    """Effects of whose form one in the model may be no more than the fault: a load carried uphill alone had what the
    descents left over of the slope. In the finer search that puts it in doubt (`rules.demoted`)."""
    model, constraints = choice.model, choice.model.constraints
    own, rest = constraints.split(model.chosen, number)
    if choice.forward is None or constraints.joint[own[0]]:
        return ()
    others = [constraints.candidates[n] for n in constraints.numbers(rest)]
    cause = constraints.candidates[number].covariate
    wrong = {s.covariate for s in remains if s.covariate != cause and not stands_without(model, own[0], s)}
    return tuple(one.effect for one in others if one.covariate in wrong)


def _similar(choice: Choice, number: int, sizes: Mapping[int, float]) -> tuple[str, ...]:
    """Effects that these data cannot tell from one in the model."""
    model, constraints = choice.model, choice.model.constraints
    candidate, (own, _) = constraints.candidates[number], constraints.split(model.chosen, number)
    if choice.forward is None:
        similar = rivals(model, number)
    else:
        similar = tuple(constraints.candidates[o].effect for o in choice.forward.rivals.get(number, ()))
    loads, watts = candidate.unlogged
    size_w = sum(abs(sizes[k]) for k in own) * model.design.layout.mean_power_w
    if size_w <= watts:
        similar = (*similar, *(name for name in loads if name != candidate.effect))
    similar = (*similar, *(name for name in candidate.may_be(size_w) if name not in (*similar, candidate.effect)))
    hardly = choice.evidence[own[0]].p_runs > BESIDE_RUN_LEVEL and cause_is_constant(model, own[0])
    if not similar and hardly and not driven_for(model, own[0]).any():
        # the misfit of the largest effect in the model may differ from run to run
        total: dict[int, float] = {}
        for k in model.chosen:
            other = int(constraints.effect[k])
            total[other] = total.get(other, 0.0) + abs(sizes[k])
        most = max(total, key=lambda other: total[other])
        return () if most == number else (constraints.candidates[most].effect,)
    return similar

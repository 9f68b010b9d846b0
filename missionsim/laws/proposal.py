"""The answer of the search: forms that these data cannot tell apart, one curve with its band, or nothing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from missionsim.effects.covariates import Covariates, is_text
from missionsim.expressions import compile_expression
from missionsim.glossary import column_of
from missionsim.identify.estimates import Z95
from missionsim.identify.forward import LOGGED
from missionsim.identify.identification import Identification
from missionsim.identify.proposed import CLOCKS, FAR_BETTER, Curve, Law, Proposal
from missionsim.labels import Labels
from missionsim.laws.adapter import Ground, ground_of
from missionsim.laws.experiment import POINTS, experiment
from missionsim.laws.factors import evaluate, make_grammar
from missionsim.laws.gates import LEAST_SHARE, Gates, gates, left_out
from missionsim.laws.grammar import Grammar
from missionsim.laws.levels import by_levels
from missionsim.laws.search import Fitted, Scored, Search, Searched
from missionsim.physics import Array
from missionsim.runs.covariates import logged_name, repeated

ALIKE = 0.06
"""Part of the gain by which a form may lag behind and still be in the set: no form is exact, and rows blur them all."""
AS_GOOD = 0.03
"""Within this part the form with the fewest quantities, then the plainest, stands first."""
CLEARLY = 0.985
"""Left-out errors that lie closer than this do not put a less plain form first."""
LEAST_NATS = 4.0
SYSTEMATIC = 0.10
"""Relative standard deviation of a law's size beyond what the rows scatter: blur of rows and clock, base that gives way
(measured in the little world)."""
FLOOR = 0.03
"""Parts of the curve's height that rows do not resolve."""
MOST_LAWS = 6
MOST_BESIDE = 8
REPLACED = 0.35
"""An effect that keeps less than this part of its size beside a law was standing in for it."""
AKIN = 0.4
SHRUNK = 0.75
NO_WORSE = 1.01
"""An effect whose column is this like the law's, that keeps no more than this part of its size beside it and whose loss
raises the error of left-out runs no further than this, stood in for it as well."""
LEADS = 0.9
"""So did one in whose place a law alone leaves less than this part of that error."""
SWOLLEN = 2.0
"""An effect of more than this many times its size took what was another's (assumed)."""
TWIN = 0.985
SAME = 0.9999
"""Correlation with the column of an effect from which on a law has no other form than that effect."""
CHANGES = 0.9
"""Likeness to a constant below which a quantity changes in the logs."""
OWN_METER = 0.99
"""Correlation with the measured power from which on a column may be that power, or the current of it."""
AT_NOUGHT = 0.2
"""Part of its mean by which such a column may then be off nought at no power; a load that makes nearly all of what the
power changes by, beside a constant one, is further off (assumed)."""


def propose(
    found: Identification, covariates: Sequence[Covariates], most: Mapping[str, float] | None = None
) -> Proposal | None:
    """The law that an identification lacks, or None where nothing passes every gate.

    `covariates`: covariates of every run that was given to it, at the raw rate, with those derived from the log.
    `most`: by column, what the robot can drive at most.
    """
    ground = ground_of(found, covariates)
    # where the base is far from right, what wanders unexplained looks like a clock, and warming up is in the library;
    # what runs differ by looks like one where they last unlike
    apart = any(one.covariate == "run" for one in found.unexplained.structures)
    skip = {*repeated(ground.covariates), *_own_meter(ground)}
    grammar = make_grammar(ground.covariates, skip, clocks=ground.model.squares is None and not apart)
    plain, late = (_propose(ground, grammar, memory, found, most=most) for memory in (False, True))
    if late is None:
        return plain and plain[0]
    if plain is None:
        # the wider search may end with a form that remembers nothing, where what leads the narrower one fails
        made = late[0]
        at_once = "lag(" not in made.first.formula and not CLOCKS & {*made.first.variables}
        return made if at_once or made.far_better else None
    # whatever is slow looks like a lag, so that it must be far better; how left-out runs are predicted rests on the
    # noise that a fit ends with, so that both are compared at the same
    error, other = (
        left_out(own.at_noise(own.extended(fitted.watts), own.usual())).with_law for _, fitted, own in (late, plain)
    )
    return (late if error < FAR_BETTER * other else plain)[0]


def _own_meter(ground: Ground) -> set[str]:
    """Columns beyond the glossary that are the measured power once more, whatever they are called."""
    found, watts = set[str](), ground.design.y
    for name, value in ground.covariates[0].items():
        if column_of(name) is not None or is_text(value) or not np.shape(value):
            continue
        runs = [np.nan_to_num(np.asarray(run[name], dtype=float))[None, :] for run in ground.covariates if name in run]
        rows = ground.averaged(runs)[0] if len(runs) == len(ground.covariates) else np.zeros(1)
        if not np.ptp(rows) > 0.0 or not abs(r := np.corrcoef(rows, watts)[0, 1]) > OWN_METER:
            continue
        at_nought = np.mean(rows) - math.copysign(np.std(rows) / np.std(watts), r) * np.mean(watts)
        if abs(at_nought) < AT_NOUGHT * abs(np.mean(rows)):
            found.add(name)
    return found


def _finer(search: Search, done: Searched) -> tuple[Search, Searched]:
    """What is found with numbers between those of the grammar, and with levels of a label."""
    search, done = search.sharpened(done)
    return by_levels(search, done.best) or (search, done)


def _judged(search: Search, done: Searched) -> tuple[list[Scored], list[Scored], Fitted, Gates]:
    """The set of forms, those beside it, the fit of the first, and its gates.

    Left-out runs say which quantity leads and which others come near it.
    """
    near, beside = _set(done.near, search.grammar)
    # the best form is not near where its sign is wrong at the noise that all are compared at
    late = search.grammar.memory(done.best.form)
    best = [one for one in done.near if one.form == done.best.form and not late]
    each: dict[frozenset[str], Scored] = {}  # the first form of each choice of quantities
    for one in near:
        each.setdefault(frozenset(search.grammar.variables(one.form)), one)
    forms = {one.form: one for one in (*each.values(), *best)}
    # lags of like time constants are told apart at the noise that one of them leaves: without, it lasts as long as they
    start = (done.best.model.noise,) if late else ()
    fits = {form: done.best if form == done.best.form else search.fit(form, *start) for form in forms}
    read = {form: set(search.grammar.variables(form)) for form in fits}
    lead = near[0].form
    other = min(fits, key=lambda form: fits[form].errors.with_law)
    if fits[other].errors.with_law < CLEARLY * fits[lead].errors.with_law:
        lead = other  # the plainest predicts left-out runs less well
    limit = fits[lead].errors.with_law / CLEARLY
    logged = [f for f in fits if not read[f] & CLOCKS and fits[f].errors.with_law <= limit]
    if read[lead] & CLOCKS and logged:
        lead = min(logged, key=lambda form: fits[form].errors.with_law)  # time passes whatever drives the power
        limit = max(limit, fits[lead].errors.with_law / CLEARLY)
    as_good = [read[form] for form in fits if fits[form].errors.with_law <= limit]
    others = [one for one in near if one.form != lead and set(search.grammar.variables(one.form)) in as_good]
    fitted = search.settled(fits[lead])
    return [forms[lead], *others][:MOST_LAWS], beside, fitted, gates(fitted, clock=bool(read[lead] & CLOCKS))


def _propose(
    ground: Ground,
    grammar: Grammar,
    memory: bool,
    found: Identification,
    *,
    once_more: bool = True,
    most: Mapping[str, float] | None = None,
) -> tuple[Proposal, Fitted, Ground] | None:
    """A proposal, and the fit that it rests on."""
    search = Search(ground, grammar, memory)
    done = search.best()
    if done is None:
        return None
    on_time = search.on_time(done.best)
    if on_time is not search:
        search, done = on_time, on_time.best() or done
    search, done = _finer(search, done)
    near, beside, fitted, seen = _judged(search, done)
    was, told = fitted.errors, all(seen.passed.values())
    # an effect that stands in for the law leaves it too little to show over a few runs
    fails = [gate for gate, passed in seen.passed.items() if not passed]
    instead, done = _replaced(fitted, search) if fails in ([], ["blocks"]) else ((), None)
    if instead:
        # what stood in for the law goes, and the law is looked for once more without it
        search = Search(search.ground.without(instead), grammar, memory)
        done = done or search.best()
        if done is None:
            return None
        search, done = _finer(search, done)
        near, beside, fitted, seen = _judged(search, done)
        # a load carried uphill alone takes the slope's part, beside a law of descents
        shares = ground.sizes(ground.model)
        swells = any(now > SWOLLEN * shares[name] for name, now in search.ground.sizes(fitted.model).items())
        told = all(seen.passed.values()) and not swells
    if told:
        # what has the column of a refused effect is that effect; one whose form is in doubt, or that it has replaced,
        # may have this one, and watts of one of several like loads come with a factor that no converter has
        twin = _twin(fitted, search.ground, found)
        told = twin in ("", *found.demoted, *instead) or twin.startswith(f"{LOGGED}:")
        # a drift over the runs stands behind a law of what it may stand behind
        drifts = {name for one in found.unexplained.structures if not one.covariate for name in one.effects}
        doubted = {logged_name(one.covariate) for one in found.library if one.effect in drifts}
        told &= not doubted or not {*search.grammar.variables(near[0].form)} - {"speed_m_s"} <= doubted
    if not told:
        # what leads and fails may hide what holds
        lead = {*search.grammar.variables(near[0].form)} - {"speed_m_s"}
        rest = grammar.without(lead) if once_more and lead else None
        return None if rest is None else _propose(ground, rest, memory, found, once_more=False, most=most)
    ground, errors = search.ground, fitted.errors
    relative = float(np.hypot(seen.share_sd / max(abs(fitted.share), 1e-300), SYSTEMATIC))
    laws = tuple(_law(one, near[0], fitted, relative, search) for one in near)
    sets = [set(law.variables) for law in laws]
    certain = tuple(v for v in laws[0].variables if all(v in s for s in sets))
    possible = tuple(dict.fromkeys(v for law in laws for v in law.variables if v not in certain))
    more = [_law(one, near[0], fitted, relative, search) for one in beside]
    curve = None if any("lag(" in law.formula for law in (*laws, *more)) else _curve([*laws, *more], ground, relative)
    made = Proposal(
        laws,
        certain,
        possible,
        curve,
        fitted.share,
        float(np.hypot(seen.share_sd, SYSTEMATIC * fitted.share)),
        fitted.rise,
        fitted.penalty,
        tried=search.tried,
        left_out_rmse_w=(was.without, errors.with_law),
        left_out_energy_pct=(was.energy_without, errors.energy_with),
        better=errors.better,
        runs=errors.acting,
        experiment=experiment(laws, curve, possible, found.noise, most),
        instead_of=instead,
        effect=_twin(fitted, ground, found, SAME),
        like=_twin(fitted, ground, found, recalibrated=True),
        goes_with=_goes_with(fitted, search),
    )
    return made, fitted, ground


def _set(near: Sequence[Scored], grammar: Grammar) -> tuple[list[Scored], list[Scored]]:
    """Forms within the margin, the plainest of the best first, none of which adds a quantity to another; then those
    beside them that differ in a threshold or a time constant only, for the band."""
    top = near[0]
    close = [one for one in near if one.score > top.score - max(LEAST_NATS, ALIKE * top.gain)]
    as_good = [one for one in close if one.score > top.score - max(0.5 * LEAST_NATS, AS_GOOD * top.gain)]

    def variables(one: Scored) -> set[str]:
        return set(grammar.variables(one.form))

    def kinds(one: Scored) -> list[str]:
        return sorted(grammar.factors[i].kind or grammar.factors[i].text for i in one.form)

    # a plain quantity before one that is bent
    rank = {one.form: sum(grammar.factors[i].rank for i in one.form) for one in as_good}
    first = min(as_good, key=lambda one: (len(variables(one)), len(one.form), rank[one.form], -one.score))
    kept, beside = [first], []
    for one in close:
        if one is first or any(variables(k) < variables(one) for k in kept):
            continue
        if any(kinds(k) == kinds(one) for k in kept):
            beside.append(one)
        else:
            kept.append(one)
    return kept[:MOST_LAWS], beside[:MOST_BESIDE]


def _law(one: Scored, first: Scored, fitted: Fitted, relative: float, search: Search) -> Law:
    grammar, share = search.grammar, fitted.share if one is first else one.share
    mean = float(np.average(np.abs(search.watts(one.form)), weights=search.ground.design.duration_s))
    k = share * search.ground.mean_power_w / max(mean, 1e-300)
    half = Z95 * relative * abs(k)
    return Law(
        grammar.text(one.form),
        grammar.symbol(one.form),
        grammar.unit(one.form),
        k,
        k - half,
        k + half,
        share,
        # forms are ranked at one noise, which is not that of the fit whose rise is told
        max(0.0, first.score - one.score) * fitted.rise / first.gain,
        variables=grammar.variables(one.form),
    )


def _replaced(fitted: Fitted, search: Search) -> tuple[tuple[str, ...], Searched | None]:
    """Effects that stood in for the law: with it they hardly act any more, or look like it, shrink, and predict runs
    that are left out no better beside it, or look like it, and a law in the place of both predicts those better.

    With what is found without them all, where that had to be looked for.
    """
    ground, looked = search.ground, dict[tuple[str, ...], Searched | None]()
    if not ground.chosen:
        return (), None
    before, after = ground.sizes(ground.model), ground.sizes(fitted.model)
    out = []
    for name, columns in ground.held:
        was, now = before[name], after[name]
        if now < max(REPLACED * was, LEAST_SHARE):
            out.append(name)
            continue
        like = max(_likeness(ground.design.phi[k], fitted.watts) for k in columns)
        if like <= AKIN:
            continue
        alone = Search(ground.without((*out, name)), search.grammar, search.memory)
        if now < SHRUNK * was:
            same = alone.fit(fitted.form)
            # one law of one quantity: what bends an effect is another form alone
            bent = alone.fit(alone.near(same, alone.sized([fitted.form]))[0].form, same.model.noise)
            if min(same.errors.with_law, bent.errors.with_law) < NO_WORSE * fitted.errors.with_law:
                out.append(name)
                continue
        # of a wrong form beside what is left of it
        looked[(*out, name)] = other = alone.best()
        if other is not None and other.best.errors.with_law < LEADS * fitted.errors.with_law:
            out.append(name)
    return tuple(out), looked.get(tuple(out))


def _twin(
    fitted: Fitted, ground: Ground, found: Identification, alike: float = TWIN, recalibrated: bool = False
) -> str:
    """The effect of the library whose column is the law's own, or almost; or would be if the base were recalibrated."""
    design = ground.design
    known = design.gradient if recalibrated else np.ones((1, len(design.y)))
    basis = np.linalg.svd(known.T, full_matrices=False)[0]

    def beside(column: Array) -> Array:
        return np.asarray(column - basis @ (basis.T @ column))

    x = beside(fitted.watts)
    for phi, column in zip(design.phi, design.layout.columns, strict=True):
        if column.candidate >= 0 and _likeness(x, beside(phi)) > alike:
            return str(found.library[column.candidate].effect)
    return ""


def _goes_with(fitted: Fitted, search: Search) -> tuple[str, ...]:
    """Quantities that change in the logs and hardly where the law acts, so that it may follow them as well: a load that
    was carried uphill alone."""
    grammar, found = search.grammar, list[str]()
    read = {*grammar.variables(fitted.form), *CLOCKS}
    plain = [(i, f.variable) for i, f in enumerate(grammar.factors) if f.text == f.variable and f.variable not in read]
    ones = np.ones_like(fitted.watts)
    for i, name in plain:
        alone, both = search.columns([(i,), (*fitted.form, i)])
        if _likeness(alone, ones) < CHANGES and _likeness(both, fitted.watts) > TWIN:
            found.append(name)
    return tuple(found)


def _likeness(a: Array, b: Array) -> float:
    """Cosine of the angle between two columns."""
    return abs(float(a @ b)) / max(float(np.linalg.norm(a) * np.linalg.norm(b)), 1e-300)


def _curve(laws: Sequence[Law], ground: Ground, relative: float) -> Curve | None:
    first = laws[0]
    names = sorted({n for law in laws for n in compile_expression(law.formula).names} - {"k"})
    data: dict[str, Any] = {}  # covariates of all runs, one after the other
    for name in names:
        parts = [(run[name], np.shape(run["time_s"])) for run in ground.covariates]
        if isinstance(parts[0][0], Labels):
            data[name] = np.concatenate([part.texts() for part, _ in parts])
        else:
            data[name] = np.concatenate([np.broadcast_to(np.asarray(part, dtype=float), n) for part, n in parts])
    power = np.abs(evaluate(first.formula, data, len(next(iter(data.values())))))
    active = power > 0.1 * float(np.quantile(power[power > 0.0], 0.95)) if np.any(power > 0.0) else power > 0.0
    if not np.any(active):
        return None
    typical: dict[str, float | str] = {}
    ranges: dict[str, Array] = {}
    for name, values in data.items():
        if values.dtype.kind in "OUS":
            texts, count = np.unique(values[active].astype(str), return_counts=True)
            typical[name] = str(texts[int(np.argmax(count))])
            continue
        if not (name in ("accel_m_s2", "slope_rad") or name.startswith("temp")):
            values = np.abs(values)
        near = values[active]
        typical[name] = float(np.median(near))
        first_x, last_x = (float(q) for q in np.quantile(values, (0.02, 0.98)))
        last_x = max(last_x, float(np.quantile(near, 0.98)))
        ranges[name] = np.linspace(min(first_x, float(np.min(near))), last_x, POINTS)
    lead, highest = "", -np.inf
    for name in (n for n in compile_expression(first.formula).names if n in ranges):
        height = float(np.ptp(evaluate(first.formula, {**typical, name: ranges[name]}, POINTS)))
        # a switch has two values and a clock no end: neither leads where another quantity does
        height *= 0.2 if name.startswith("on_") or name.endswith("time_s") else 1.0
        if not lead or height > highest:
            lead, highest = name, height
    if not lead:
        return None
    x = ranges[lead]
    curves = np.vstack([law.k * evaluate(law.formula, {**typical, lead: x}, POINTS) for law in laws])
    spread = Z95 * relative * np.abs(curves) + FLOOR * float(np.max(np.abs(curves[0])))
    column = column_of(lead)
    others = {n: v for n, v in typical.items() if n != lead}
    band = ((curves - spread).min(axis=0), (curves + spread).max(axis=0))
    at, power_w, low, high = (tuple(float(v) for v in values) for values in (x, curves[0], *band))
    spans = {n: (float(ranges[n][0]), float(ranges[n][-1])) for n in others if n in ranges and not n.startswith("on_")}
    unit, usual = column[0].unit if column is not None else "", float(typical[lead])
    return Curve(lead, unit, at, power_w, low, high, others, usual, spans=spans)

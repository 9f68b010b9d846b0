"""Laws with a level of their own for each text of a label, such as a scrub that every floor has another of."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from missionsim.effects.covariates import is_text
from missionsim.laws.gates import LEAST_BETTER, left_out
from missionsim.laws.search import Fitted, Search, Searched
from missionsim.physics import Array

LEAST_LEVEL = 0.05
"""Less than this part of the highest level is none."""
ALIKE = 0.95
"""From this part of it on every level is the highest, and there are none."""
TRIED = 5
"""Quantities, best by least squares, whose levels are tried beside those of the best law."""


def by_levels(search: Search, fitted: Fitted) -> tuple[Search, Searched] | None:
    """A law with a level of its own for each text of a label, where runs that are left out are predicted clearly better
    with the levels that the others give.

    Where the base is far from right it need not be the best law of one level: what floors differ by hardly shows in
    what they have in common.
    """
    factors = search.grammar.factors
    labels = dict.fromkeys(f.variable for f in factors if is_text(search.ground.covariates[0].get(f.variable)))
    for name in labels:
        rest = tuple(i for i in fitted.form if factors[i].variable != name)
        levels = [i for i, factor in enumerate(factors) if factor.variable == name]
        forms = [rest] if rest else []
        if search.ground.model.squares is not None and not search.memory:
            # of the quantity of the best law every form: where one floor leads, it bends as that floor asks
            own = [(i,) for i, f in enumerate(factors) if len(rest) == 1 and f.variable == factors[rest[0]].variable]
            forms += [form for form in (*_differing(search, levels), *own) if form != rest]
        found = [_with_levels(search, fitted, form, levels) for form in forms if len(form) < len(search.by_size)]
        error, parts, form = min(
            (one for one in found if one is not None), key=lambda one: one[0], default=(math.inf, {}, ())
        )
        if error > fitted.errors.with_law:
            continue
        wider = Search(search.ground, search.grammar.with_levels(name, parts), search.memory)
        form = (*form, len(factors))
        law = wider.fit(form, fitted.model.noise)
        near = tuple(wider.near(law, wider.sized([form])))
        if near and law.errors.with_law <= LEAST_BETTER * fitted.errors.with_law:
            return wider, Searched(law, near)
    return None


def _with_levels(
    search: Search, fitted: Fitted, form: tuple[int, ...], levels: Sequence[int]
) -> tuple[float, dict[int, float], tuple[int, ...]] | None:
    """Error of left-out runs under the levels that the others give [W], and each level's part of the highest, by the
    number of the factor that is 1 there; with the form."""
    ground = search.ground
    rows = search.columns([(*form, i) for i in levels])
    seen = np.any(rows, axis=1)  # not every floor is turned on
    levels, rows = [i for i, there in zip(levels, seen, strict=True) if there], rows[seen]
    if len(levels) < 2:
        return None
    design = ground.extended(rows)
    model = ground.at_noise(design, fitted.model.noise)
    shares = model.gram.shares(model.chosen)
    every = range(len(ground.chosen), len(design.phi))
    size = {i: float(shares[k]) * design.layout.unit(k) for i, k in zip(levels, every, strict=True)}
    most = max(size.values())
    parts = {i: own / most if own > max(LEAST_LEVEL * most, 0.0) else 0.0 for i, own in size.items()}
    some = [part for part in parts.values() if part]
    several = len(some) > 1 and min(parts.values()) < ALIKE
    return (left_out(model, len(levels)).with_law, parts, form) if several else None


def _differing(search: Search, levels: Sequence[int]) -> list[tuple[int, ...]]:
    """Quantities whose levels explain most, by least squares."""
    design, factors = search.ground.design, search.grammar.factors
    root = np.sqrt(design.duration_s)
    known = np.vstack([design.gradient, design.phi[list(search.ground.chosen)]]) * root
    basis = np.linalg.svd(known.T, full_matrices=False)[0]

    def beside(rows: Array) -> Array:
        return np.asarray(rows - (rows @ basis) @ basis.T)

    left = beside(design.residual * root)
    gains: dict[tuple[int, ...], float] = {}
    for i, factor in enumerate(factors):
        if factor.fine or is_text(search.ground.covariates[0].get(factor.variable)):
            continue
        rows = beside(search.rows[i] * search.rows[levels] * root)
        gains[(i,)] = float(np.sum((np.linalg.lstsq(rows.T, left, rcond=1e-9)[0] @ rows) ** 2))
    return sorted(gains, key=lambda form: -gains[form])[:TRIED]

"""Identifiability: which effects these data cannot tell apart, and by how much the others are told (docs/method.md)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.identify.data import Candidate
from missionsim.identify.gram import Gram
from missionsim.identify.model import Model
from missionsim.identify.residual import ramps, steady
from missionsim.identify.search import Constraints, all_sets, set_gains, single_gains
from missionsim.identify.settings import EXTRA_EFFECT_NATS, NOISY_SLOPE, ODDS_NATS, SAME_COLUMN, Settings


@dataclass(frozen=True)
class Pair:
    """How well effect ``a`` can be told from effect ``b``: correlation and expected log-likelihood lead [nats]."""

    a: str
    b: str
    r: float
    separation_nats: float


def rivals(
    model: Model, effect: int, constraints: Constraints, candidates: Sequence[Candidate], settings: Settings
) -> tuple[str, ...]:
    """Effects that could stand in the place of `effect` (a candidate number) in the model.

    A rival replaces all columns of the effect, alone or (at a price) with one further effect. Forms are never
    exact, so a rival is kept also when it loses only a small part of the effect's own gain. What only rows beside
    ramps can tell apart is not told apart, unless the effect itself lives there.
    """
    full = _close_ones(model.gram, model, effect, constraints, candidates, settings)
    # averages over ramps bend forms, so that rows beside them prefer one form by accident
    flat = steady(model, free_base=False)
    rest = [k for k in model.chosen if constraints.effect[k] != effect]
    own = flat.gram.gain(model.chosen) - flat.gram.gain(rest)
    # an effect that lives on ramps (acceleration) is judged with them only
    if own > 0.5 * (model.gram.gain(model.chosen) - model.gram.gain(rest)):
        for other, behind in _close_ones(flat.gram, flat, effect, constraints, candidates, settings).items():
            full[other] = min(full.get(other, np.inf), behind)
    ordered = sorted(full, key=lambda o: full[o])
    ordered += [
        o for o in _proportional(model, [effect, *ordered], constraints, candidates) if o not in (effect, *ordered)
    ]
    return tuple(candidates[o].effect for o in ordered)


def _proportional(
    model: Model, named: Sequence[int], constraints: Constraints, candidates: Sequence[Candidate]
) -> list[int]:
    """Effects of the same covariate whose power is proportional to that of a named one away from ramps.

    At one cruise speed v, v2 and v3 are the same column; what then prefers one of them is noise.
    """
    covariates = {candidates[n].covariate for n in named if candidates[n].covariate}
    rows = model.design.phi[:, ~ramps(model)]
    size = np.linalg.norm(rows, axis=1)
    found: list[int] = []
    for a in (k for k in range(len(rows)) if constraints.effect[k] in named):
        for b in range(len(rows)):
            other = int(constraints.effect[b])
            if other in named or other in found or candidates[other].covariate not in covariates:
                continue
            if candidates[other].covariate != candidates[int(constraints.effect[a])].covariate or constraints.joint[b]:
                continue
            if rows[a] @ rows[b] > SAME_COLUMN * size[a] * size[b] > 0:
                found.append(other)
    return found


def _close_ones(
    gram: Gram, model: Model, effect: int, constraints: Constraints, candidates: Sequence[Candidate], settings: Settings
) -> dict[int, float]:
    """Rivals and how many nats they are behind."""
    own = [k for k in model.chosen if constraints.effect[k] == effect]
    rest = [k for k in model.chosen if constraints.effect[k] != effect]
    base = gram.gain(rest)
    gain = gram.gain(model.chosen) - base
    gain -= float(constraints.grid_nats[own[0]])
    found: dict[int, float] = {}
    singles = single_gains(gram, constraints, rest) - constraints.grid_nats
    for k, value in enumerate(singles):
        other = int(constraints.effect[k])
        if other != effect and np.isfinite(value) and value > found.get(other, 0.0):
            found[other] = float(value)
    # triples of columns are the most that are searched in full
    if len(own) == 1 and len(rest) <= 1:
        for other, value in _pairs_without(gram, constraints, rest, effect, settings).items():
            found[other] = max(found.get(other, -np.inf), value - base - EXTRA_EFFECT_NATS)
    close: dict[int, float] = {}
    for other, value in found.items():
        same = candidates[other].covariate == candidates[effect].covariate
        loss = (settings.rival_loss if same else settings.noisy_rival_loss) * gain
        if candidates[other].covariate == "slope_rad" and not same:
            loss *= NOISY_SLOPE
        if gain - value < max(ODDS_NATS, loss):
            close[other] = gain - value
    return close


def _pairs_without(
    gram: Gram, constraints: Constraints, rest: Sequence[int], effect: int, settings: Settings
) -> dict[int, float]:
    """Best total gain of rest plus two effects other than `effect`, credited to those that are not negligible."""
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
        values, _ = gram.coefficients([int(k) for k in sets[row]])
        share = dict(zip((int(k) for k in sets[row]), np.abs(values), strict=True))
        new = [k for k in share if k not in rest and share[k] > settings.min_share]
        for k in new:
            # the smaller of two that explain it together is an aid, not the explanation
            if singles[k] >= 0.5 * max(singles[j] for j in new):
                other = int(constraints.effect[k])
                out[other] = max(out.get(other, -np.inf), float(gains[row]))
    return out


def pairs(
    model: Model, constraints: Constraints, candidates: Sequence[Candidate], gram: Gram | None = None
) -> tuple[Pair, ...]:
    """Correlation and separation of each effect in the model from every other effect.

    Columns are whitened, with base parameters, run effects and the rest of the model projected out; r is 0 where
    the sign of the coefficient forbids the imitation.
    """
    gram = gram or model.gram
    out: list[Pair] = []
    for a in model.chosen:
        rest = [k for k in model.chosen if k != a]
        left = gram.conditional(rest)
        value = float(model.gram.coefficients(model.chosen)[0][list(model.chosen).index(a)])
        best: dict[int, float] = {}
        for b in range(gram.p):
            other = int(constraints.effect[b])
            if other == constraints.effect[a] or b in rest or left[1 + b, 1 + b] <= 1e-9 * gram.full[1 + b, 1 + b]:
                continue
            r = float(left[1 + a, 1 + b] / np.sqrt(left[1 + a, 1 + a] * left[1 + b, 1 + b]))
            # physics forbids the imitation
            if constraints.sign[b] * r * value < 0:
                r = 0.0
            if abs(r) > abs(best.get(other, -1e-9)) or other not in best:
                best[other] = r
        strength = 0.5 * value**2 * float(left[1 + a, 1 + a])
        name = candidates[int(constraints.effect[a])].effect
        out += [Pair(name, candidates[o].effect, r, strength * (1 - min(1.0, r * r))) for o, r in best.items()]
    return tuple(out)

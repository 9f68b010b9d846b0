"""Exact fit of shape parameters (time constants, reference temperatures) by profile likelihood (docs/method.md)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify.data import Candidate
from missionsim.identify.design import Source
from missionsim.identify.forward import Choice
from missionsim.identify.gram import reduced
from missionsim.identify.model import Model, score
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.rules import weighed
from missionsim.identify.settings import LIMIT_NATS, SHAPE_EVALUATIONS, SHAPE_SD
from missionsim.physics import Array


def refit_shapes(
    choice: Choice, columns: Iterable[int], limited: bool = True
) -> tuple[Choice, dict[str, dict[str, float]]]:
    """The choice with the shapes of some columns at their best, and these shapes, with 95 % limits if `limited`."""
    shapes: dict[str, dict[str, float]] = {}
    for column in columns:
        candidate = choice.model.constraints.of_column(column)
        if candidate.refit is not None:
            choice, shapes[candidate.effect] = _refit(choice, column, candidate, limited)
    return choice, shapes


def _refit(choice: Choice, column: int, candidate: Candidate, limited: bool) -> tuple[Choice, dict[str, float]]:
    from scipy.optimize import minimize

    model = choice.model
    here, every = model.source.layout.columns[column], range(len(model.chosen))
    start = dict(here.shape or candidate.shape[here.position])
    names = list(start)
    bounds = [
        candidate.shape_bounds.get(n, (min(s[n] for s in candidate.shape), max(s[n] for s in candidate.shape)))
        for n in names
    ]
    logarithmic = [low > 0 and high / low > 5 for low, high in bounds]

    def inner(values: Sequence[float]) -> Array:
        return np.array([np.log(v) if log else v for v, log in zip(values, logarithmic, strict=True)])

    def outer(x: Array) -> dict[str, float]:
        pairs = zip(names, x, logarithmic, bounds, strict=True)
        return {n: float(np.clip(np.exp(v) if log else v, *b)) for n, v, log, b in pairs}

    low, high = inner([b[0] for b in bounds]), inner([b[1] for b in bounds])
    usual = np.mean([inner([s[n] for n in names]) for s in candidate.shape], axis=0)

    def cost(x: Array) -> float:
        # where a free base leaves a shape open (a reference temperature beyond all that was met), it stays usual
        unusual = 0.5 * float(np.sum(((x - usual) / (SHAPE_SD * (high - low))) ** 2))
        source = _replaced(model.source, column, candidate, outer(x))
        if model.squares is None:
            return unusual - score(source, model.clock, model.noise, model.chosen)
        return unusual - LeastSquares.of(source.design(model.clock, model.chosen)).score(every)

    # start inside: at a bound the simplex would be flat
    x0 = np.clip(inner([start[n] for n in names]), low, high)
    step = 0.25 * (high - low)
    simplex = np.vstack([x0] + [np.clip(x0 + np.where(x0 + s > high, -s, s), low, high) for s in np.diag(step)])
    options = {"maxfev": SHAPE_EVALUATIONS * len(names), "initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05}
    found = minimize(cost, x0, method="Nelder-Mead", options=options)
    best = outer(found.x)
    source = _replaced(model.source, column, candidate, best)
    design = source.design(model.clock)
    squares = None if model.squares is None else LeastSquares.of(design)
    # clock and noise stay at those of the grid column, which lies near
    refitted = Model(source, model.chosen, model.clock, design, model.noise, squares)
    evidence = weighed(refitted, model.chosen) if squares is None else dict(choice.evidence)
    limits: dict[str, float] = {}
    if limited:
        limits = _limits(cost, found.x, float(found.fun), (low, high), outer, names)

        def size(shape: Mapping[str, float]) -> tuple[float, float]:
            trial = _replaced(model.source, column, candidate, shape)
            design, at = trial.design(model.clock, model.chosen), model.chosen.index(column)
            if model.squares is None:
                share = float(reduced(design, model.noise, every)[0].coefficients(every)[0][at])
            else:
                squares = LeastSquares.of(design)
                share = float(squares.fit(every)[squares.q + at])
            return share, share / trial.layout.columns[column].watts_per_unit

        ends = [[size(best | {n: limits.get(f"{n}.{end}", best[n])}) for end in ("low", "high")] for n in names]
        spans = np.array([[abs(b - a) / 3.92 for a, b in zip(*pair, strict=True)] for pair in ends])
        share_sd, unit_sd = np.sqrt((spans**2).sum(axis=0))
        unit = abs(size(best)[1])
        evidence[column] = replace(
            evidence[column], shape_sd=float(share_sd), unit_shape_sd=float(unit_sd / unit) if unit > 0 else 0.0
        )
    return replace(choice, model=refitted, evidence=evidence), best | limits


def _limits(
    cost: Callable[[Array], float],
    x: Array,
    least: float,
    bounds: tuple[Array, Array],
    outer: Callable[[Array], dict[str, float]],
    names: Sequence[str],
) -> dict[str, float]:
    """Profile-likelihood limits: where the likelihood is `LIMIT_NATS` below its best, the other parameters held."""
    out: dict[str, float] = {}
    for i, name in enumerate(names):
        for end, label in ((bounds[0][i], "low"), (bounds[1][i], "high")):
            inside, outside = x[i], end
            trial = x.copy()
            trial[i] = end
            if cost(trial) - least > LIMIT_NATS:
                for _ in range(6):
                    trial[i] = 0.5 * (inside + outside)
                    if cost(trial) - least > LIMIT_NATS:
                        outside = trial[i]
                    else:
                        inside = trial[i]
            # the outer end of the last bracket: limits err to the wide side
            trial[i] = outside
            out[f"{name}.{label}"] = outer(trial)[name]
    return out


def _replaced(source: Source, column: int, candidate: Candidate, shape: Mapping[str, float]) -> Source:
    """The same runs with one column evaluated at another shape."""
    assert candidate.refit is not None
    raw = candidate.refit(shape)
    rows = [np.asarray(raw[i]) for i in source.kept]
    energy = sum(float(np.sum(np.abs(values) * run.dt_s)) for run, values in zip(source.runs, rows, strict=True))
    mean = energy / sum(float(np.sum(run.dt_s)) for run in source.runs)
    if not mean > 0:
        return source
    columns = list(source.layout.columns)
    columns[column] = replace(columns[column], watts_per_unit=mean, shape=tuple(shape.items()))
    return source.with_column(column, replace(source.layout, columns=tuple(columns)), rows)

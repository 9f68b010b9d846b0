"""Exact fit of shape parameters (time constants, reference temperatures) by profile likelihood (docs/method.md)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify.data import Candidate, Column
from missionsim.identify.design import Source
from missionsim.identify.forward import Choice
from missionsim.identify.gram import Constraints
from missionsim.identify.model import Model, score, shares
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.rules import weigh
from missionsim.identify.settings import LIMIT_NATS, SHAPE_EVALUATIONS, SHAPE_SD, Settings
from missionsim.physics import Array


def refit_shapes(
    choice: Choice, candidates: Sequence[Candidate], constraints: Constraints, settings: Settings
) -> tuple[Choice, dict[str, dict[str, float]]]:
    """Refit the shape of every chosen effect that has one; returns the new choice and the shapes with 95 % limits.

    An effect whose shape cannot be evaluated elsewhere keeps its grid value.
    """
    shapes: dict[str, dict[str, float]] = {}
    for column in choice.model.chosen:
        here = choice.model.source.layout.columns[column]
        candidate = candidates[here.candidate]
        if _has_shape(candidate, here):
            choice, shapes[candidate.effect] = _refit(choice, column, candidate, candidates, constraints, settings)
        elif candidate.shape and not candidate.levels and candidate.shape[here.position]:
            shapes[candidate.effect] = dict(candidate.shape[here.position])
    return choice, shapes


def refit_shapes_of(
    choice: Choice,
    columns: Iterable[int],
    candidates: Sequence[Candidate],
    constraints: Constraints,
    settings: Settings,
) -> Choice:
    """The choice with the shapes of the given columns at their best, without limits."""
    for column in columns:
        here = choice.model.source.layout.columns[column]
        candidate = candidates[here.candidate]
        if _has_shape(candidate, here):
            choice, _ = _refit(choice, column, candidate, candidates, constraints, settings, limited=False)
    return choice


def _has_shape(candidate: Candidate, column: Column) -> bool:
    """Whether the column has shape parameters that can be evaluated away from the grid."""
    return candidate.refit is not None and not candidate.levels and bool(candidate.shape[column.position])


def _refit(
    choice: Choice,
    column: int,
    candidate: Candidate,
    candidates: Sequence[Candidate],
    constraints: Constraints,
    settings: Settings,
    limited: bool = True,
) -> tuple[Choice, dict[str, float]]:
    from scipy.optimize import minimize

    model = choice.model
    here = model.source.layout.columns[column]
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

    def with_shape(shape: Mapping[str, float]) -> Source:
        return _replaced(model.source, column, candidate, shape)

    low, high = inner([b[0] for b in bounds]), inner([b[1] for b in bounds])
    usual = np.mean([inner([s[n] for n in names]) for s in candidate.shape], axis=0)

    def cost(x: Array) -> float:
        # where a free base leaves a shape open (a reference temperature beyond all that was met), it stays usual
        unusual = 0.5 * float(np.sum(((x - usual) / (SHAPE_SD * (high - low))) ** 2))
        return unusual - _score(model, with_shape(outer(x)))

    # start inside: at a bound the simplex would be flat
    x0 = np.clip(inner([start[n] for n in names]), low, high)
    step = 0.25 * (high - low)
    simplex = np.vstack([x0] + [np.clip(x0 + np.where(x0 + s > high, -s, s), low, high) for s in np.diag(step)])
    found = minimize(
        cost,
        x0,
        method="Nelder-Mead",
        options={"maxfev": SHAPE_EVALUATIONS * len(names), "initial_simplex": simplex, "xatol": 0.02, "fatol": 0.05},
    )
    best = outer(found.x)
    source = with_shape(best)
    design = source.design(model.clock)
    squares = None if model.squares is None else LeastSquares.of(design)
    # clock and noise stay at those of the grid column, which lies near
    refitted = Model(source, model.chosen, model.clock, design, model.noise, squares)
    if squares is None:
        evidence = {c: weigh(refitted, c, constraints, candidates, settings) for c in model.chosen}
    else:
        evidence = dict(choice.evidence)
    limits: dict[str, float] = {}
    if limited:
        limits = _limits(cost, found.x, float(found.fun), LIMIT_NATS, (low, high), outer, names)

        def size(shape: Mapping[str, float]) -> tuple[float, float]:
            trial = with_shape(shape)
            share = float(_shares(model, trial)[model.chosen.index(column)])
            return share, share / trial.layout.columns[column].watts_per_unit

        ends = [[size(best | {n: limits.get(f"{n}.{end}", best[n])}) for end in ("low", "high")] for n in names]
        spans = np.array([[abs(b - a) / 3.92 for a, b in zip(*pair, strict=True)] for pair in ends])
        share_sd, unit_sd = np.sqrt((spans**2).sum(axis=0))
        unit = abs(size(best)[1])
        evidence[column] = replace(
            evidence[column], shape_sd=float(share_sd), unit_shape_sd=float(unit_sd / unit) if unit > 0 else 0.0
        )
    return replace(choice, model=refitted, evidence=evidence), best | limits


def _score(model: Model, source: Source) -> float:
    """Log-likelihood of the model's columns as another source has them, or that of the least squares it rests on."""
    if model.squares is None:
        return score(source, model.clock, model.noise, model.chosen)
    return LeastSquares.of(source.design(model.clock, model.chosen)).score(range(len(model.chosen)))


def _shares(model: Model, source: Source) -> Array:
    """Shares of the model's columns as another source has them, shape (chosen,)."""
    if model.squares is None:
        return shares(source, model.clock, model.noise, model.chosen)
    squares = LeastSquares.of(source.design(model.clock, model.chosen))
    return squares.fit(range(len(model.chosen)))[squares.q :]


def _limits(
    cost: Callable[[Array], float],
    x: Array,
    least: float,
    drop: float,
    bounds: tuple[Array, Array],
    outer: Callable[[Array], dict[str, float]],
    names: Sequence[str],
) -> dict[str, float]:
    """Profile-likelihood limits: where the likelihood is `drop` nats below its best, the other parameters held."""
    out: dict[str, float] = {}
    for i, name in enumerate(names):
        for end, label in ((bounds[0][i], "low"), (bounds[1][i], "high")):
            inside, outside = x[i], end
            trial = x.copy()
            trial[i] = end
            if cost(trial) - least > drop:
                for _ in range(6):
                    trial[i] = 0.5 * (inside + outside)
                    if cost(trial) - least > drop:
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
    rows = _matching(source, candidate.refit(shape))
    energy = sum(float(np.sum(np.abs(values) * run.dt_s)) for run, values in zip(source.runs, rows, strict=True))
    seconds = sum(float(np.sum(run.dt_s)) for run in source.runs)
    mean = energy / seconds
    if not mean > 0:
        return source
    numbered = list(source.layout.columns)
    numbered[column] = replace(
        numbered[column], watts_per_unit=mean, mix=_mix(candidate, shape), shape=tuple(shape.items())
    )
    layout = replace(source.layout, columns=tuple(numbered))
    return source.with_column(column, layout, rows)


def _mix(candidate: Candidate, shape: Mapping[str, float]) -> tuple[tuple[str, float], ...]:
    """The two grid columns between which the shape lies, with weights (inverse distance in the logarithm where
    positive); columns that differ in other shape parameters come from the nearest value."""

    def place(values: Mapping[str, float]) -> Array:
        return np.array([np.log(values[n]) if shape[n] > 0 and values[n] > 0 else values[n] for n in shape])

    here = place(shape)
    grid = np.array([place(s) for s in candidate.shape])
    span = np.maximum(np.ptp(grid, axis=0), 1e-12)
    distance = np.linalg.norm((grid - here) / span, axis=1)
    first = int(np.argmin(distance))
    across = [i for i in range(len(grid)) if float((grid[i] - here) @ (grid[first] - here)) < 0]
    if distance[first] < 1e-9 or not across:
        return ((candidate.columns[first], 1.0),)
    second = min(across, key=lambda i: distance[i])
    weight = distance[second] / (distance[first] + distance[second])
    return ((candidate.columns[first], float(weight)), (candidate.columns[second], float(1 - weight)))


def _matching(source: Source, raw: Sequence[Array]) -> list[Array]:
    """Arrays of the runs that were long enough to be used."""
    return [np.asarray(raw[i]) for i in source.kept]

"""What other tools make of the same data: PySINDy, LASSO by run, stepwise BIC, gradient-boosted trees.

All get the same 1 s table and the same library columns; none gets the clock aligned, since none offers it. Base columns
are candidates as well; they count as a name only where the shift exceeds four prior standard deviations.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from .features import Table, effect_of, nominal_base
from .motion import Array

PRIOR_SD = 0.03


@dataclass(frozen=True)
class Outcome:
    """What a method said about a case."""

    method: str
    names: tuple[str, ...]
    """Effects named, the most important first."""
    sets: dict[str, tuple[str, ...]] = field(default_factory=dict)
    """For a named effect, what it says it cannot tell from it."""
    verdict: str = ""
    energy_error_pct: float = float("nan")
    rmse_w: float = float("nan")
    seconds: float = float("nan")
    shares: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Share of energy: value, low, high."""
    limits: dict[str, float] = field(default_factory=dict)
    """Share of energy from which on an effect would have been seen, as the method itself says."""
    experiments: int = 0
    law: str = ""
    """A formula that it proposes beside the names."""
    names_outcome: bool = True


@dataclass(frozen=True)
class Design:
    """Stacked training table: X = base columns then library columns, y = measured − base model."""

    base: tuple[str, ...]
    library: tuple[str, ...]
    x: Array
    y: Array
    run: Array
    power_w: float
    robot: str

    @property
    def names(self) -> tuple[str, ...]:
        """Column names."""
        return self.base + self.library


def stack(tables: Sequence[Table], robot: str) -> Design:
    """Stack runs; columns that are missing in a run count as zero, columns that never act are left out."""
    base = tuple(nominal_base(robot))
    names = sorted({key for table in tables for key in table.library})
    columns = {key: np.concatenate([t.library.get(key, np.zeros_like(t.measured_w)) for t in tables]) for key in names}
    library = tuple(key for key in names if np.ptp(columns[key]) > 0.0)
    blocks = [np.concatenate([t.base[key] for t in tables]) for key in base]
    x = np.column_stack([*blocks, *(columns[key] for key in library)])
    y = np.concatenate([t.measured_w - t.base_w for t in tables])
    run = np.concatenate([np.full(len(t.measured_w), i) for i, t in enumerate(tables)])
    return Design(base, library, x, y, run, float(np.mean(np.concatenate([t.measured_w for t in tables]))), robot)


def heldout_error(tables: Sequence[Table], predictions_w: Sequence[Array]) -> tuple[float, float]:
    """Mean absolute energy error per run [%] and power RMSE over all runs [W]."""
    energy, square, seconds = [], 0.0, 0.0
    for table, model in zip(tables, predictions_w, strict=True):
        measured = float(np.sum(table.measured_w * table.seconds))
        energy.append(100.0 * abs(float(np.sum(model * table.seconds)) / measured - 1.0))
        square += float(np.sum((model - table.measured_w) ** 2 * table.seconds))
        seconds += float(np.sum(table.seconds))
    return float(np.mean(energy)), float(np.sqrt(square / seconds))


def nominal(heldout: Sequence[Table]) -> tuple[float, float]:
    """Held-out error of the base model as the user has it."""
    return heldout_error(heldout, [t.base_w for t in heldout])


def ridge(x: Array, y: Array, prior_sd: Array, independent: float = 0.1) -> Array:
    """Least squares with a normal prior on each coefficient; ``independent`` = share of rows that count as independent.

    Parameters
    ----------
    x, y
        Shapes (n, p) and (n,).
    prior_sd
        Shape (p,), infinite for none.
    """
    noise = float(np.var(y - x @ np.linalg.lstsq(x, y, rcond=None)[0])) + 1e-12
    precision = noise / independent / np.asarray(prior_sd) ** 2
    scale = np.sqrt(np.sum(x * x, axis=0)) + 1e-12
    gram = (x / scale).T @ (x / scale) + np.diag(precision / scale**2 + 1e-10)
    return np.asarray(np.linalg.solve(gram, (x / scale).T @ y) / scale)


def _finish(method: str, design: Design, chosen: Sequence[str], heldout: Sequence[Table], start: float) -> Outcome:
    """Refit the chosen library columns with the recalibrated base, name them, predict the held-out runs."""
    keep = [*range(len(design.base)), *(design.names.index(c) for c in chosen)]
    parameters = nominal_base(design.robot)
    prior = np.array([PRIOR_SD * parameters[key] for key in design.base] + [np.inf] * len(chosen))
    x = design.x[:, keep]
    fitted = ridge(x, design.y, prior)
    shift = {key: fitted[i] / prior[i] for i, key in enumerate(design.base)}
    strong = [abs(shift[key]) > 4.0 for key in design.base]
    coefficients = ridge(x, design.y, np.where(np.concatenate([strong, np.ones(len(chosen), bool)]), np.inf, prior))
    share: dict[str, float] = {}
    for i, column in enumerate([*design.base, *chosen]):
        if i >= len(design.base) or strong[i]:
            part = float(np.mean(np.abs(coefficients[i] * x[:, i]))) / design.power_w
            share[effect_of(column)] = share.get(effect_of(column), 0.0) + part
    names = tuple(sorted(share, key=lambda e: -share[e]))
    predictions = []
    for t in heldout:
        extra = [t.library.get(c, np.zeros_like(t.base_w)) for c in chosen]
        predictions.append(t.base_w + np.column_stack([*(t.base[key] for key in design.base), *extra]) @ coefficients)
    energy, rmse = heldout_error(heldout, predictions)
    return Outcome(method, names, energy_error_pct=energy, rmse_w=rmse, seconds=time.perf_counter() - start)


def sindy(design: Design, heldout: Sequence[Table], seed: int = 0) -> Outcome:
    """PySINDy's STLSQ with its defaults on the columns in SI units (threshold 0.1, ridge 0.05)."""
    import pysindy as ps

    start = time.perf_counter()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        optimizer = ps.STLSQ()
        optimizer.fit(design.x, design.y[:, None])
    hit = np.flatnonzero(np.ravel(optimizer.coef_))
    return _finish("PySINDy", design, [design.names[i] for i in hit if i >= len(design.base)], heldout, start)


def sindy_ensemble(design: Design, heldout: Sequence[Table], seed: int = 0, models: int = 20) -> Outcome:
    """PySINDy's bagging ensemble of STLSQ; columns scaled to shares of energy, threshold 0.5 %, kept if in 60 %."""
    import pysindy as ps

    start = time.perf_counter()
    scale = design.power_w / (np.mean(np.abs(design.x), axis=0) + 1e-12)
    state = np.random.get_state()  # noqa: NPY002 - PySINDy bags with the global generator
    np.random.seed(seed)  # noqa: NPY002
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            optimizer = ps.EnsembleOptimizer(ps.STLSQ(threshold=0.005), bagging=True, n_models=models)
            optimizer.fit(design.x * scale, design.y[:, None])
    finally:
        np.random.set_state(state)  # noqa: NPY002
    share = np.mean(np.abs(np.array([np.ravel(c) for c in optimizer.coef_list])) > 0.0, axis=0)
    chosen = [design.names[i] for i in np.flatnonzero(share > 0.6) if i >= len(design.base)]
    return _finish("PySINDy ensemble", design, chosen, heldout, start)


def lasso(design: Design, heldout: Sequence[Table], seed: int = 0) -> Outcome:
    """LASSO on the standardised library columns, base columns unpenalised, cross-validated by run, 1-SE rule."""
    from sklearn.linear_model import lasso_path
    from sklearn.model_selection import GroupKFold

    start = time.perf_counter()
    nuisance = design.x[:, : len(design.base)]

    def project(z: Array) -> Array:
        return np.asarray(z - nuisance @ np.linalg.lstsq(nuisance, z, rcond=None)[0])

    x, y = project(design.x[:, len(design.base) :]), project(design.y)
    x = x / (np.std(x, axis=0) + 1e-12)
    alphas = np.max(np.abs(x.T @ y)) / len(y) * np.logspace(0, -3, 40)
    folds = min(len(np.unique(design.run)), 5)
    if folds < 2:
        return _finish("LASSO, by run", design, [], heldout, start)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        errors = []
        for fit, test in GroupKFold(folds).split(x, y, design.run):
            _, path, _ = lasso_path(x[fit], y[fit], alphas=alphas)
            errors.append(np.mean((y[test][:, None] - x[test] @ path) ** 2, axis=0))
        score, spread = np.mean(errors, axis=0), np.std(errors, axis=0) / np.sqrt(folds)
        best = int(np.argmin(score))
        first = int(np.flatnonzero(score <= score[best] + spread[best])[0])
        _, path, _ = lasso_path(x, y, alphas=alphas[: first + 1])
    chosen = [design.library[i] for i in np.flatnonzero(np.abs(path[:, -1]) > 1e-9)]
    return _finish("LASSO, by run", design, chosen, heldout, start)


def stepwise_bic(design: Design, heldout: Sequence[Table], seed: int = 0) -> Outcome:
    """Forward and backward steps by BIC of ordinary least squares, independent samples, base columns always in."""
    start = time.perf_counter()
    size, first = len(design.y), len(design.base)
    scale = np.sqrt(np.mean(design.x**2, axis=0)) + 1e-12
    x = design.x / scale
    gram, moment, total = x.T @ x, x.T @ design.y, float(design.y @ design.y)

    def bic(columns: tuple[int, ...]) -> float:
        rows = [*range(first), *columns]
        a = gram[np.ix_(rows, rows)] + 1e-9 * size * np.eye(len(rows))
        rss = total - float(moment[rows] @ np.linalg.solve(a, moment[rows]))
        return size * float(np.log(max(rss, 1e-12) / size)) + len(rows) * float(np.log(size))

    chosen: tuple[int, ...] = ()
    score = bic(chosen)
    while True:
        moves = [(*chosen, j) for j in range(first, len(design.names)) if j not in chosen]
        moves += [tuple(i for i in chosen if i != j) for j in chosen]
        scores = [bic(m) for m in moves]
        best = int(np.argmin(scores))
        if scores[best] >= score - 1e-6:
            break
        chosen, score = moves[best], scores[best]
    return _finish("stepwise BIC", design, [design.names[i] for i in chosen], heldout, start)


def boosted_trees(train: Sequence[Table], heldout: Sequence[Table], seed: int = 0) -> Outcome:
    """Gradient-boosted trees on the raw covariates, target measured − base model: a held-out error and no name."""
    from sklearn.ensemble import HistGradientBoostingRegressor

    start = time.perf_counter()
    keys = sorted(set.intersection(*(set(t.covariates) for t in [*train, *heldout])))

    def raw(t: Table) -> Array:
        return np.column_stack([*(t.covariates[key] for key in keys), np.cumsum(t.seconds)])

    model = HistGradientBoostingRegressor(max_iter=150, learning_rate=0.06, max_leaf_nodes=15, random_state=seed)
    model.fit(np.concatenate([raw(t) for t in train]), np.concatenate([t.measured_w - t.base_w for t in train]))
    energy, rmse = heldout_error(heldout, [t.base_w + model.predict(raw(t)) for t in heldout])
    seconds = time.perf_counter() - start
    return Outcome("boosted trees", (), energy_error_pct=energy, rmse_w=rmse, seconds=seconds, names_outcome=False)


NAMING: tuple[Callable[..., Outcome], ...] = (sindy, sindy_ensemble, lasso, stepwise_bic)

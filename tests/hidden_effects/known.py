"""Names by an oracle: generalised least squares that knows the true form of every effect, the noise and the clock.

No method that gets the logs alone can be expected to name more. What it does not know are the coefficients, gain and
offset of the meter in each run (their spreads it knows), the ripple of the efficiency map and which effects act.
"""

from __future__ import annotations

import numpy as np
from scipy import linalg, stats

from .features import nominal_base
from .meter import FAST, SLOW, SLOW_S, WHITE, level_of
from .motion import ROBOTS, STEP_S, Array
from .peers import PRIOR_SD, Outcome
from .plant import OUTSIDE
from .world import Case, World

NAME = "oracle"
ALPHA = 0.002
"""Family-wise, as in the product."""
GAIN_SD = 0.008


def answers(case: Case) -> bool:
    """Whether it is asked: where all could be named, and the covariance of a run's rows fits in memory."""
    return case.design == "rich" and case.rate_hz <= 1.0 and not set(case.hidden) & set(OUTSIDE)


def _correlation(lag_s: Array, width_s: Array, tau_s: float) -> Array:
    """Correlation of means over windows of an AR(1) of unit variance, shape (n, n)."""
    part = width_s / tau_s
    apart = np.outer(np.sinh(part / 2.0) / (part / 2.0), np.sinh(part / 2.0) / (part / 2.0)) * np.exp(-lag_s / tau_s)
    np.fill_diagonal(apart, 2.0 * (part - 1.0 + np.exp(-part)) / part**2)
    return np.asarray(apart)


def factor_of(true: dict[str, Array], noise_level: int, offset_w: float) -> Array:
    """Lower Cholesky factor of the covariance of one run's measured powers [W], shape (n, n)."""
    seen, width = true["power"], true["seconds"]
    middle = np.cumsum(width) - width / 2.0
    lag = np.abs(middle[:, None] - middle[None, :])
    noise = FAST**2 * _correlation(lag, width, float(true["noise_s"][0]))
    if noise_level > 1:
        noise += SLOW**2 * _correlation(lag, width, SLOW_S)
    level = level_of(seen)
    both = noise * np.outer(level, level) + np.diag((WHITE * np.mean(seen)) ** 2 * STEP_S / width)
    both += GAIN_SD**2 * np.outer(seen, seen) + offset_w**2
    return np.asarray(linalg.cholesky(both, lower=True))


def named(world: World) -> Outcome:
    """The effects that it names, the most important first; `world` was made with its candidates."""
    robot = ROBOTS[world.case.robot]
    base = nominal_base(world.case.robot)
    runs = [world.truth[name] for name in world.train]
    names = sorted(set.intersection(*({k for k in run if k.startswith("candidate:")} for run in runs)))
    rows = []
    for run in runs:
        factor = factor_of(run, world.case.noise_level, robot.meter_offset_w)
        left = run["measured"] - sum(value * run[f"base:{key}"] for key, value in base.items())
        block = np.column_stack([left, *(run[f"base:{key}"] for key in base), *(run[name] for name in names)])
        rows.append(linalg.solve_triangular(factor, block, lower=True))
    prior = np.zeros((len(base), 1 + len(base) + len(names)))
    prior[:, 1 : 1 + len(base)] = np.diag([1.0 / (PRIOR_SD * value) for value in base.values()])
    table = np.vstack([*rows, prior])
    sums, first = table.T @ table, 1 + len(base)
    chosen: list[int] = []

    def loss(columns: list[int]) -> tuple[float, Array]:
        index = [*range(1, first), *columns]
        value = np.asarray(linalg.solve(sums[np.ix_(index, index)], sums[index, 0], assume_a="pos"))
        return float(sums[0, 0] - sums[index, 0] @ value), value[first - 1 :]

    now, _ = loss(chosen)
    while len(chosen) < len(names):
        trials = {i: loss([*chosen, i]) for i in range(first, first + len(names)) if i not in chosen}
        best = min((i for i in trials if np.all(trials[i][1] > 0.0)), key=lambda i: trials[i][0], default=None)
        if best is None or stats.norm.sf(np.sqrt(max(now - trials[best][0], 0.0))) * len(names) > ALPHA:
            break
        chosen, now = [*chosen, best], trials[best][0]
    found = tuple(names[i - first].removeprefix("candidate:") for i in chosen)
    return Outcome(NAME, found, verdict="explained" if found else "nothing_found")

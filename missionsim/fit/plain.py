"""Ordinary least squares on a model's gradient: start values, and what can be told apart."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.errors import InputError
from missionsim.fit.prepare import Prepared, prepare
from missionsim.runs.run import Run

FREE_SD = 100.0
"""Relative prior standard deviation that leaves a parameter to the data."""
LARGEST_W = 1e30
"""Powers from here on are no numbers to compute with: their squares must still be finite."""
LEAST_USABLE = 0.5
"""Part of the rows in which a model must have a value to be fitted."""
LARGEST_INFLATION = 1e8
SETTLING_ROUNDS = 30


def settled(model: PowerModel, ready: Prepared, logs: Sequence[Run]) -> tuple[PowerModel, Prepared]:
    """Ordinary least squares repeated until a formula that is not linear settles."""
    for _ in range(SETTLING_ROUNDS):
        again, new = _shortened(model, ready, _least_squares_start(model, ready), logs)
        change = max(
            (abs(new.parameters[n].value - p.value) / max(abs(p.value), 1e-300) for n, p in ready.parameters.items()),
            default=0.0,
        )
        model, ready = again, new
        if change < 1e-6:
            break
    return model, ready


def _shortened(model: PowerModel, ready: Prepared, aim: PowerModel, logs: Sequence[Run]) -> tuple[PowerModel, Prepared]:
    """The step towards `aim`, halved until the squared error does not rise; a linear formula takes the whole step."""
    before = _square(ready)
    battery = ready.battery
    start = {name: p.value for name, p in ready.parameters.items()}
    goal = {name: aim.parameters[f"{battery}/{name}"].value for name in start}
    for power in range(10):
        part = 0.5**power
        trial = model.with_values({f"{battery}/{n}": start[n] + part * (goal[n] - start[n]) for n in start})
        with np.errstate(all="ignore"):
            after = prepare(trial, logs, battery)
            if _square(after) <= before * (1.0 + 1e-9):
                return trial, after
    return model, ready


def _square(ready: Prepared) -> float:
    """Squared error over time; infinite where the model has no value."""
    total = 0.0
    for run, base in zip(ready.runs, ready.base_w, strict=True):
        measured = run.run.power_w[ready.battery]
        usable = np.isfinite(measured)
        total += float(np.sum((measured - base)[usable] ** 2 * run.dt_s[usable]))
    return total if np.isfinite(total) else float("inf")


def free_priors(ready: Prepared, known: Mapping[str, ModelParameter]) -> dict[str, float]:
    """Priors so wide that they say nothing: many times the value, and many times what would make all the power."""
    power = float(np.nanmean(np.abs(ready.measured_w())))
    wide = {}
    for name in known:
        size = float(np.mean([float(np.mean(np.abs(g[name]))) for g in ready.gradients if name in g] or [0.0]))
        wide[name] = max(FREE_SD, 10.0 * power / size) if size > 0.0 else FREE_SD
    return wide


def told_apart(ready: Prepared) -> frozenset[str]:
    """Parameters whose influence no combination of the others can imitate."""
    names = [name for name in ready.gradients[0] if any(np.any(g[name]) for g in ready.gradients)]
    if not names:
        return frozenset()
    x = np.column_stack([np.concatenate([g[name] for g in ready.gradients]) for name in names])
    x = x / np.linalg.norm(x, axis=0)
    # the variance inflation of a column is the diagonal of the inverse of the correlations
    values, vectors = np.linalg.eigh(x.T @ x)
    inflation = np.sum(vectors**2 / np.maximum(values, 1e-14), axis=1)
    return frozenset(name for name, size in zip(names, inflation, strict=True) if size < LARGEST_INFLATION)


def _least_squares_start(model: PowerModel, ready: Prepared) -> PowerModel:
    """Ordinary least squares on the gradient, from the start values; rows count by the time that they stand for."""
    names = [name for name in ready.gradients[0] if any(np.any(g[name]) for g in ready.gradients)]
    weight = np.concatenate([np.sqrt(run.dt_s) for run in ready.runs])
    y = ready.measured_w() - np.concatenate(ready.base_w)
    x = np.array([np.concatenate([g[name] for g in ready.gradients]) for name in names]).reshape(len(names), len(y)).T
    usable = (np.abs(y) < LARGEST_W) & np.all(np.abs(x) < LARGEST_W, axis=1)
    if np.mean(usable) < LEAST_USABLE:
        raise InputError.single(
            f"the model of battery '{ready.battery}' gives no number in "
            + (f"{np.mean(~usable):.0%} of the rows" if usable.any() else "any row of these logs"),
            got="nothing that can be fitted",
            allowed="a formula with a finite value (no division by nought?)",
        )
    if not names:
        return model
    size = np.linalg.norm(x[usable], axis=0)
    shift, *_ = np.linalg.lstsq(x[usable] / size * weight[usable, None], y[usable] * weight[usable], rcond=1e-9)
    shift = shift / size
    values = {}
    for name, move in zip(names, shift, strict=True):
        start = ready.parameters[name].value
        value = start * (1.0 + float(move))
        # a parameter at nought has no logarithm; a small one can still grow
        values[f"{ready.battery}/{name}"] = value if abs(value) > 1e-6 * abs(start) else 1e-3 * start
    return model.with_values(values)

"""Error on runs that were not used to fit: nominal, recalibrated, with the effects found."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from missionsim.identify.data import Array, RunData
from missionsim.identify.design import Design, Source, make_source
from missionsim.identify.model import Model
from missionsim.identify.result import Identification


@dataclass(frozen=True)
class RunError:
    """Errors of one run: root mean square at the analysis rate [W] and relative error of the energy."""

    run: str
    rmse_w: tuple[float, float, float]
    energy_error: tuple[float, float, float]


@dataclass(frozen=True)
class HeldOut:
    """Errors of held-out runs; each triple is (nominal, recalibrated, with effects).

    ``rmse_w`` pools all rows; ``energy_error`` is the mean of the runs' |relative energy error|; ``steps`` gives
    both after each effect, in order of importance.
    """

    runs: tuple[RunError, ...]
    rmse_w: tuple[float, float, float]
    energy_error: tuple[float, float, float]
    steps: tuple[tuple[str, float, float], ...]


def heldout(identification: Identification, runs: Sequence[RunData]) -> HeldOut:
    """Predict other runs with what was found; nothing is fitted to them but nothing of theirs is used either.

    The clock is the common one; levels of single runs (meter offset and gain) are unknown and taken as zero. A
    refitted shape is interpolated between the grid columns beside it.
    """
    model = identification.choice.model
    source = _prepared(identification, runs)
    design = source.design(source.clock)
    nominal = design.base
    recalibrated = _predict(identification.choice.empty, design, ())
    full = _predict(model, design, model.chosen)
    per_run = []
    for name, rows in zip(design.names, design.runs, strict=True):
        errors = [p[rows] - design.y[rows] for p in (nominal, recalibrated, full)]
        weight = design.duration_s[rows]
        energy = float(np.sum(design.y[rows] * weight))
        a, b, c = (float(np.sqrt(np.average(e * e, weights=weight))) for e in errors)
        u, v, w = (float(np.sum(e * weight)) / energy for e in errors)
        per_run.append(RunError(name, (a, b, c), (u, v, w)))
    pooled = [_rmse(design, p) for p in (nominal, recalibrated, full)]
    energy_error = np.mean(np.abs([r.energy_error for r in per_run]), axis=0)
    return HeldOut(
        tuple(per_run),
        (pooled[0], pooled[1], pooled[2]),
        (float(energy_error[0]), float(energy_error[1]), float(energy_error[2])),
        _steps(identification, design),
    )


def _prepared(identification: Identification, runs: Sequence[RunData]) -> Source:
    fitted = identification.choice.model.source
    source = make_source(runs, identification.library, {}, identification.settings, like=fitted)
    source.clock = replace(identification.choice.model.clock, run_delay_s=tuple(0.0 for _ in source.runs))
    return source


def _predict(model: Model, design: Design, chosen: Sequence[int]) -> Array:
    shifts, _ = model.gram.shifts(chosen)
    out = design.base + shifts @ design.gradient
    if len(chosen):
        values, _ = model.gram.coefficients(chosen)
        out = out + values @ design.phi[list(chosen)]
    return np.asarray(out)


def _rmse(design: Design, predicted: Array) -> float:
    return float(np.sqrt(np.average((predicted - design.y) ** 2, weights=design.duration_s)))


def _steps(identification: Identification, design: Design) -> tuple[tuple[str, float, float], ...]:
    """Errors as the effects enter one by one, refitted each time with the final noise model."""
    model = identification.choice.model
    columns = model.design.layout.columns
    out: list[tuple[str, float, float]] = []
    inside: list[int] = []
    for effect in identification.effects:
        inside += [k for k in model.chosen if identification.library[columns[k].candidate].effect == effect.effect]
        predicted = _predict(model, design, inside)
        errors = []
        for rows in design.runs:
            weight = design.duration_s[rows]
            errors.append(abs(float(np.sum((predicted - design.y)[rows] * weight) / np.sum(design.y[rows] * weight))))
        out.append((effect.effect, _rmse(design, predicted), float(np.mean(errors))))
    return tuple(out)

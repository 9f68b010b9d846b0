"""Errors on runs that were not used to fit: robot file as it is, recalibrated, and with the effects found.

One definition for the diagnosis and for the waterfall of `improve`: rows averaged to the analysis rate, gaps left
out, one clock for all models, and nothing in a prediction that a robot file cannot hold (what is fitted
beside the base for clock, curvature within a row and switching stays out).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.align import Clock
from missionsim.identify.data import Candidate, RunData
from missionsim.identify.design import Design, make_source
from missionsim.identify.evidence import Choice
from missionsim.identify.findings import HeldOut
from missionsim.identify.model import Model, prediction
from missionsim.identify.settings import Settings

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Tested:
    """Errors of a fitted model on other runs.

    Attributes
    ----------
    summary : HeldOut
    rmse_without_w : mapping of str to float
        Power RMSE with every effect found but this one, the rest refitted.
    """

    summary: HeldOut
    rmse_without_w: Mapping[str, float]


def on_heldout(
    choice: Choice,
    runs: Sequence[RunData],
    candidates: Sequence[Candidate],
    prior_sd: Mapping[str, float],
    settings: Settings,
    how: str,
    shifted: bool,
    effects: Sequence[str],
    clock: Clock | None = None,
) -> Tested:
    """Predict held-out runs with what was fitted on the others; nothing of them is fitted, their meters included.

    Parameters
    ----------
    choice : Choice
        Models with and without the effects found.
    runs : sequence of RunData
        Held-out runs.
    candidates, prior_sd, settings
        As for the fit.
    how : str
        How the runs were chosen.
    shifted : bool
        Whether by a condition.
    effects : sequence of str
        Effects that are reported; others in the model stay out of the prediction.
    clock : Clock, optional
        Delay and lag of the meter; those of the model with the effects where not given.
    """
    model, empty = choice.model, choice.empty
    source = make_source(runs, candidates, prior_sd, settings, like=model.source)
    design = source.design(replace(clock or model.clock, run_delay_s=tuple(0.0 for _ in source.runs)))
    columns = model.design.layout.columns
    chosen = tuple(k for k in model.chosen if candidates[columns[k].candidate].effect in effects)
    predictions = {
        "nominal": design.base,
        "recalibrated": prediction(empty, (), design),
        "with_effects": prediction(model, chosen, design),
    }
    if not chosen:
        # nothing is reported, so nothing beyond recalibration may help
        predictions["with_effects"] = predictions["recalibrated"]
    energy = {name: energy_error_pct(design, power) for name, power in predictions.items()}
    rmse = {name: power_rmse_w(design, power) for name, power in predictions.items()}
    summary = HeldOut(how, tuple(run.run for run in source.runs), energy, rmse, shifted)
    return Tested(summary, _leaving_out(model, chosen, candidates, design))


def on_left_out(
    choice: Choice, held: Sequence[str], candidates: Sequence[Candidate], how: str, effects: Sequence[str]
) -> HeldOut | None:
    """Leave some of the fitted runs out, fit sizes of effects and base to the others, predict those.

    Names of effects, clock and noise stay those of all runs; nothing else of the left-out runs is used.

    Parameters
    ----------
    choice : Choice
    held : sequence of str
        Names of the runs to leave out.
    candidates, how, effects
        As for `on_heldout`.
    """
    model, empty = choice.model, choice.empty
    design = model.design
    out = np.array([name in set(held) for name in design.names])
    if not out.any() or out.all():
        return None
    columns = design.layout.columns
    chosen = tuple(k for k in model.chosen if candidates[columns[k].candidate].effect in effects)
    powers = {
        "nominal": design.base,
        "recalibrated": prediction(empty, (), design, ~out),
        "with_effects": prediction(model, chosen, design, ~out),
    }
    rows = [part for part, left in zip(design.runs, out, strict=True) if left]
    energy = {name: energy_error_pct(design, power, rows) for name, power in powers.items()}
    rmse = {name: power_rmse_w(design, power, rows) for name, power in powers.items()}
    return HeldOut(how, tuple(held), energy, rmse, True)


def _leaving_out(
    model: Model, chosen: Sequence[int], candidates: Sequence[Candidate], design: Design
) -> dict[str, float]:
    columns = model.design.layout.columns
    found: dict[str, float] = {}
    for effect in dict.fromkeys(candidates[columns[k].candidate].effect for k in chosen):
        rest = tuple(k for k in chosen if candidates[columns[k].candidate].effect != effect)
        found[effect] = power_rmse_w(design, prediction(model, rest, design))
    return found


def energy_error_pct(design: Design, power_w: Array, runs: Sequence[slice] | None = None) -> float:
    """Mean over runs of the absolute energy error, relative to measured [%]."""
    errors = []
    for rows in design.runs if runs is None else runs:
        seconds = design.duration_s[rows]
        measured = float(np.sum(design.y[rows] * seconds))
        errors.append(100.0 * abs(float(np.sum((power_w[rows] - design.y[rows]) * seconds)) / measured))
    return float(np.mean(errors))


def power_rmse_w(design: Design, power_w: Array, runs: Sequence[slice] | None = None) -> float:
    """Root mean square of the power error over time [W], at the analysis rate."""
    rows = np.concatenate([np.arange(len(design.y))[part] for part in (design.runs if runs is None else runs)])
    return float(np.sqrt(np.average((power_w - design.y)[rows] ** 2, weights=design.duration_s[rows])))

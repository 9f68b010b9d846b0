"""Coefficients of the effects found, in their own units and as shares of energy, with 95 % intervals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from missionsim.identify.data import Array, Candidate
from missionsim.identify.evidence import Evidence, cause_is_constant
from missionsim.identify.findings import Estimate, Finding
from missionsim.identify.forward import Choice
from missionsim.identify.identifiability import Pair, rivals
from missionsim.identify.model import Model
from missionsim.identify.residual import ramps
from missionsim.identify.search import Constraints
from missionsim.identify.settings import BESIDE_RUN_LEVEL, RAMP_SYSTEMATIC, RUN_LEVEL, Settings

Z95 = 1.959963984540054


def estimated(
    choice: Choice,
    candidates: Sequence[Candidate],
    constraints: Constraints,
    settings: Settings,
    shapes: Mapping[str, Mapping[str, float]],
    alike: Sequence[Pair],
    unnamed: set[str],
) -> tuple[Finding, ...]:
    """Every effect in the model but the `unnamed` ones, the one with the largest gain first.

    Parameters
    ----------
    shapes : mapping
        Refitted shape parameters of each effect, with ``.low`` and ``.high`` for their limits.
    alike : sequence of Pair
        How well each effect is told from others.
    """
    model = choice.model
    on_ramps = _on_ramps(model)
    value, _ = model.estimate(model.chosen)
    sizes = dict(zip(model.chosen, value[len(model.design.layout.parameters) :].tolist(), strict=True))
    absorbed = absorption(model)
    out: list[Finding] = []
    for number in dict.fromkeys(int(constraints.effect[k]) for k in model.chosen):
        candidate = candidates[number]
        if candidate.effect in unnamed:
            continue
        own = [k for k in model.chosen if constraints.effect[k] == number]
        parameters: dict[str, Estimate] = {}
        share_sd: list[float] = []
        for k in own:
            e = choice.evidence[k]
            column = model.design.layout.columns[k]
            unit = model.design.layout.mean_power_w / column.watts_per_unit
            form = abs(sizes[k]) * _form_error(model, k, on_ramps[k], settings)
            share_sd.append(float(np.linalg.norm([e.share_sd, e.shape_sd, form])))
            half = Z95 * float(np.linalg.norm([e.share_sd, sizes[k] * e.unit_shape_sd, form])) * unit
            level = candidate.levels[column.position] if candidate.levels else ""
            name = f"{candidate.coefficient}_{level}" if level else candidate.coefficient
            size = sizes[k] * unit
            parameters[name] = Estimate(size, size - half, size + half, candidate.unit)
        parameters |= _shape_estimates(shapes.get(candidate.effect, {}))
        evidence = [choice.evidence[k] for k in own]
        share, reach = sum(sizes[k] for k in own), Z95 * float(np.linalg.norm(share_sd))
        if choice.forward is None:
            similar = rivals(model, number, constraints, candidates, settings)
        else:
            similar = tuple(candidates[o].effect for o in choice.forward.rivals.get(number, ()))
        loads, watts = candidate.unlogged
        if sum(abs(sizes[k]) for k in own) * model.design.layout.mean_power_w <= watts:
            similar = (*similar, *(name for name in loads if name != candidate.effect))
        if not similar and evidence[0].p_runs > BESIDE_RUN_LEVEL and cause_is_constant(model, own[0], candidates):
            similar = _larger(number, model, constraints, candidates, sizes)
        leads = {p.b: p.separation_nats for p in alike if p.a == candidate.effect}
        # where rivals are told, the lead over them is what is asked
        among = [leads[name] for name in similar if name in leads] or list(leads.values())
        out.append(
            Finding(
                effect=candidate.effect,
                parameters=parameters,
                energy_share=share,
                share_low=share - reach,
                share_high=share + reach,
                p_value=min(e.p_value for e in evidence),
                p_runs=min((e.p_runs for e in evidence), default=float("nan")),
                gain_nats=max(e.gain for e in evidence),
                level=_level(evidence),
                indistinguishable_from=similar,
                separation_nats=min(among, default=float("nan")),
                absorbed=float(absorbed[own].min()),
            )
        )
    return tuple(sorted(out, key=lambda f: -f.gain_nats))


def _larger(
    number: int, model: Model, constraints: Constraints, candidates: Sequence[Candidate], sizes: Mapping[int, float]
) -> tuple[str, ...]:
    """The largest effect in the model where it is larger than one: its misfit may differ from run to run."""
    total: dict[int, float] = {}
    for k in model.chosen:
        other = int(constraints.effect[k])
        total[other] = total.get(other, 0.0) + abs(sizes[k])
    most = max(total, key=lambda other: total[other])
    return () if most == number else (candidates[most].effect,)


def _form_error(model: Model, column: int, on_ramps: float, settings: Settings) -> float:
    """Relative systematic standard error of a coefficient: form of the effect, blurred ramps, gain of the meter.

    The more of an effect hides in recalibration, the smaller the part its coefficient rests on, and the larger what
    an error of the form does to it.
    """
    q = model.gram.q
    whole = float(model.gram.per_run[:, 1 + q + column, 1 + q + column].sum())
    # a twin that is wholly hidden has no finite error
    left = max(float(model.gram.full[1 + column, 1 + column]), 1e-12 * whole)
    hidden = settings.form_error * np.sqrt(whole / left) if left > 0 else 0.0
    # each run has a meter gain of its own, the coefficient their mean
    gain = model.noise.gain / np.sqrt(len(model.design.runs))
    return float(np.linalg.norm([settings.systematic, hidden, RAMP_SYSTEMATIC * on_ramps, gain]))


def _on_ramps(model: Model) -> dict[int, float]:
    """How much more of each chosen column than of the base model's power lies beside ramps, from 0 to 1.

    Where the whole drive is one ramp, all columns are blurred alike and keep their relations.
    """
    edge = ramps(model)
    base = model.design.base**2
    usual = float(base[edge].sum() / max(float(base.sum()), 1e-300))
    out = {}
    for k in model.chosen:
        square = model.design.phi[k] ** 2
        part = float(square[edge].sum() / max(float(square.sum()), 1e-300))
        out[k] = max(0.0, part - usual) / max(1.0 - usual, 1e-9)
    return out


def absorption(model: Model) -> Array:
    """Part of each column that hides in the recalibration of the base model, shape (p,)."""
    plain = np.maximum(np.diag(model.gram.per_run.sum(axis=0))[1 + model.gram.q :], 1e-300)
    return np.asarray(1.0 - np.clip(np.diag(model.gram.full)[1:] / plain, 0.0, 1.0))


def _shape_estimates(shape: Mapping[str, float]) -> dict[str, Estimate]:
    out = {}
    for name, value in shape.items():
        if name.endswith((".low", ".high")):
            continue
        unit = "s" if name.startswith("tau") else ("degC" if name.lower().startswith("t0") else "1")
        out[name] = Estimate(value, shape.get(f"{name}.low", value), shape.get(f"{name}.high", value), unit)
    return out


def _level(evidence: Sequence[Evidence]) -> str:
    best = max(evidence, key=lambda e: e.gain)
    if np.isfinite(best.p_runs) and best.p_runs < RUN_LEVEL:
        return "identified, repeated across runs"
    return "identified"

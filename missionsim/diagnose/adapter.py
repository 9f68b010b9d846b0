"""What the identification found, in the words and units of the diagnosis."""

from __future__ import annotations

import math

from missionsim.diagnose.features import Features
from missionsim.diagnose.findings import Estimate, Finding, Judged, Recalibrated
from missionsim.diagnose.heldout import Tested
from missionsim.identify.result import FoundEffect, Identification

Z95 = 1.959963984540054


def effects_of(found: Identification, features: Features, tested: Tested | None) -> tuple[Finding, ...]:
    """The missing effects in order of importance, with held-out errors where runs were held out."""
    return tuple(_finding(one, found, features, tested) for one in found.effects)


def _finding(one: FoundEffect, found: Identification, features: Features, tested: Tested | None) -> Finding:
    reach = Z95 * one.energy_share_sd
    low, high = one.energy_share - reach, one.energy_share + reach
    rivals = [pair for pair in found.pairs if pair.a == one.effect and pair.b in one.indistinguishable_from]
    closest = [pair for pair in found.pairs if pair.a == one.effect]
    lead = min((pair.separation_nats for pair in rivals or closest), default=float("nan"))
    before = after = None
    if tested is not None:
        before = tested.rmse_without_w.get(one.effect)
        after = tested.summary.power_rmse_w["with_effects"]
    absorbed = next((c.absorption for c in found.candidates if c.effect == one.effect), float("nan"))
    return Finding(
        one.effect,
        {p.name: Estimate(p.value, p.low, p.high, p.unit) for p in one.parameters},
        one.energy_share,
        one.p_value,
        low,
        high,
        one.p_runs,
        one.confidence,
        before,
        after,
        one.indistinguishable_from,
        {},
        lead,
        absorbed,
    )


def judged(found: Identification) -> tuple[Judged, ...]:
    """Every candidate with its reason and its detection limit."""
    rival_of = {rival: one.effect for one in found.effects for rival in one.indistinguishable_from}
    doubtful = _doubtful(found)
    return tuple(
        Judged(
            c.effect,
            c.accepted,
            f"these data cannot tell it from {rival_of[c.effect]}" if c.effect in rival_of else c.reason,
            c.smallest_detectable_share if math.isfinite(c.smallest_detectable_share) else None,
            c.effect in rival_of or c.effect in found.demoted,
            doubtful.get(c.effect),
        )
        for c in found.candidates
    )


def _doubtful(found: Identification) -> dict[str, float]:
    """Energy shares of the effects that the identification has in its model but does not name."""
    model = found.choice.model
    shares: dict[str, float] = {}
    for k in model.chosen:
        effect = found.library[model.design.layout.columns[k].candidate].effect
        if effect in found.demoted:
            shares[effect] = shares.get(effect, 0.0) + found.choice.evidence[k].share
    return shares


def recalibrated(found: Identification, features: Features) -> tuple[Recalibrated, ...]:
    """Shifts of the base parameters, largest first in prior standard deviations."""
    rows = []
    for shift in found.recalibration:
        parameter = features.parameters[shift.parameter]
        rows.append(
            Recalibrated(
                shift.parameter,
                100.0 * shift.shift,
                shift.shift_in_prior_sd,
                parameter.value * (1.0 + shift.shift),
                abs(parameter.value) * shift.sd,
                parameter.unit,
            )
        )
    return tuple(sorted(rows, key=lambda row: -abs(row.shift_in_prior_sd)))


def confounding(found: Identification) -> dict[str, dict[str, float]]:
    """How alike each effect found is to others, as correlations."""
    names = [effect.effect for effect in found.effects]
    rows: dict[str, dict[str, float]] = {}
    for pair in found.pairs:
        if pair.a in names and math.isfinite(pair.r):
            rows.setdefault(pair.a, {})[pair.b] = pair.r
    return rows


def noise_of(found: Identification) -> dict[str, float]:
    """Noise and differences between runs."""
    noise, shape = found.noise, found.choice.model.noise
    return {
        "sd_w": noise.sd_share * found.mean_power_w,
        "sd_share": noise.sd_share,
        "fast_s": noise.fast_s,
        "slow_s": noise.slow_s,
        "fast_share": shape.fast_share,
        "slow_share": shape.slow_share,
        "offset_w": noise.meter_offset_w,
        "gain": noise.meter_gain,
        "motion_gain": noise.motion_gain,
        "overdispersion": noise.overdispersion,
    }


__all__ = ["confounding", "effects_of", "judged", "noise_of", "recalibrated"]

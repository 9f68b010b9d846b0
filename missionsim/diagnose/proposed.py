"""The law that a diagnosis proposes where no effect of the library fits, and its errors on held-out runs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from missionsim.diagnose.heldout import energy_error_pct, power_rmse_w
from missionsim.effects.base_terms import aliased
from missionsim.identify.align import Clock
from missionsim.identify.data import RunData
from missionsim.identify.design import make_source
from missionsim.identify.findings import Finding, Judged, Unexplained
from missionsim.identify.identification import Identification
from missionsim.identify.model import prediction
from missionsim.identify.proposed import Proposal
from missionsim.laws.proposal import Proposed, evaluate, propose

STANDS_IN = "stood in for a law that the library does not hold"


def proposed_laws(
    found: Identification,
    covariates: Sequence[Mapping[str, Any]],
    heldout: Sequence[RunData] = (),
    heldout_covariates: Sequence[Mapping[str, Any]] = (),
    clock: Clock | None = None,
) -> tuple[Proposal, ...]:
    """The proposal, if any form passes every gate, with its errors on held-out runs.

    Parameters
    ----------
    found : Identification
    covariates : sequence of mapping
        Of the fitted runs, at the raw rate.
    heldout, heldout_covariates
        Runs that nothing was fitted to, with columns at the shapes found.
    clock : Clock, optional
        At which held-out errors are told; the one that was found by default.
    """
    made = propose(found, covariates)
    if made is None:
        return ()
    if not heldout or not made.proposal.first.simulated:
        return (made.proposal,)
    return (_tested(made, found, heldout, heldout_covariates, clock),)


def _tested(
    made: Proposed,
    found: Identification,
    runs: Sequence[RunData],
    covariates: Sequence[Mapping[str, Any]],
    clock: Clock | None,
) -> Proposal:
    base, law = found.choice.model, made.fitted.model
    source = make_source(runs, found.library, {}, found.settings, like=base.source)
    clock = replace(clock or law.clock, run_delay_s=tuple(0.0 for _ in source.runs))
    design = source.design(clock)
    first = made.proposal.first
    raw = [evaluate(first.formula, aliased(covariates[i]), len(covariates[i]["time_s"]))[None, :] for i in source.kept]
    layout = law.design.layout
    watts = source.averaged(raw, clock)[0] * (layout.mean_power_w / layout.columns[-1].watts_per_unit)
    held = list(made.ground.chosen)
    extended = replace(design, layout=layout, phi=np.vstack([design.phi[held], watts]))
    named = [e.effect for e in found.effects]
    columns = base.design.layout.columns
    chosen = [k for k in base.chosen if found.library[columns[k].candidate].effect in named]
    without = prediction(base if chosen else found.choice.empty, chosen, design)
    with_law = prediction(law, law.chosen, extended)
    return replace(
        made.proposal,
        heldout_rmse_w=(power_rmse_w(design, without), power_rmse_w(design, with_law)),
        heldout_energy_pct=(energy_error_pct(design, without), energy_error_pct(design, with_law)),
    )


def without_stand_ins(
    laws: Sequence[Proposal], effects: Sequence[Finding], candidates: Sequence[Judged]
) -> tuple[tuple[Finding, ...], tuple[Judged, ...]]:
    """Effects and candidates once those that stood in for a law are no longer named."""
    gone = {name for law in laws for name in law.instead_of}
    judged = tuple(
        replace(c, accepted=False, reason=STANDS_IN, open=True) if c.effect in gone else c for c in candidates
    )
    return tuple(e for e in effects if e.effect not in gone), judged


def depends_on(laws: Sequence[Proposal], left: Unexplained) -> Unexplained:
    """What remains, with the quantities of the law before those that one curve at a time showed."""
    certain = [name for law in laws for name in law.certain]
    return replace(left, depends_on=tuple(dict.fromkeys((*certain, *left.depends_on))))

"""Runs as the identification reads them, and the law that they show."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.data import Candidate, RunData
from missionsim.identify.identification import Identification, identify
from missionsim.identify.proposed import Proposal
from missionsim.laws.proposal import propose

Array = NDArray[np.float64]


def run_of(
    name: object,
    gradient: Mapping[str, Array],
    more_w: Array,
    columns: Mapping[str, Array] | None = None,
    step_s: float = 1.0,
    **covariates: Array,
) -> RunData:
    """A run whose base is the sum of its gradient, and that measures `more_w` beside it; its one effect never acts
    unless `columns` are given."""
    rows, base = len(more_w), np.sum(list(gradient.values()), axis=0)
    time_s = (np.arange(rows) + 0.5) * step_s
    columns = columns or {"grade": np.zeros(rows)}
    covariates |= {"time_s": time_s}
    return RunData(f"{name}", time_s, np.full(rows, step_s), base + more_w, base, gradient, columns, covariates)


def identified(runs: Sequence[RunData], **prior_sd: float) -> Identification:
    """What is found with no effect that could be it."""
    return identify(runs, [Candidate("grade", ("grade",))], prior_sd)


def law_of(runs: Sequence[RunData], **prior_sd: float) -> Proposal:
    """The law in whose place no effect can stand."""
    made = propose(identified(runs, **prior_sd), [run.covariates for run in runs])
    assert made is not None
    return made

"""What an imagined run would add: separation of two effects after it (step 6). No measurement is needed."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.identify.credible import pairs
from missionsim.identify.data import RunData
from missionsim.identify.design import make_source
from missionsim.identify.gram import Gram, make_gram
from missionsim.identify.noise import for_rows
from missionsim.identify.result import Identification
from missionsim.identify.search import Rules


def gram_with(identification: Identification, extra: Sequence[RunData]) -> Gram:
    """Gram matrices of the runs at hand and of imagined ones, whitened with the noise found.

    The imagined runs' ``measured_w`` may be anything finite (their base model, say).
    """
    model = identification.choice.model
    source = make_source(extra, identification.library, {}, identification.settings, like=model.source)
    design = source.design(replace(model.clock, run_delay_s=tuple(0.0 for _ in source.runs)))
    noise = for_rows(design, model.noise)
    own = make_gram(design, noise)
    return Gram(np.concatenate([model.gram.per_run, own.per_run]), model.gram.prior_precision)


def separation_after(identification: Identification, extra: Sequence[RunData], a: str, b: str) -> float:
    """Expected log-likelihood lead [nats] of effect `a`, which is in the model, over its best imitation by `b`.

    Parameters
    ----------
    identification : what was found so far; its coefficient of `a` is taken as true
    extra : imagined runs (manoeuvres) with base model and candidate columns; empty for the data at hand
    a, b : effects

    Raises
    ------
    KeyError
        If `a` is not in the model or `b` not in the library.
    """
    model = identification.choice.model
    rules = Rules.of(model.design.layout, identification.library)
    gram = gram_with(identification, extra) if extra else model.gram
    for pair in pairs(model, rules, identification.library, gram):
        if (pair.a, pair.b) == (a, b):
            return pair.separation_nats
    raise KeyError(f"no pair {a} and {b}")

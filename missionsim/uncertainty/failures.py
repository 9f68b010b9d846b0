"""Where, when and why runs of a batch fail."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.uncertainty.store import BlockStore

KEPT_TIMES = 100_000
"""Of so many failures at a place, the first ones, the time is known."""
KEPT_REASONS = 1000
_OTHER = "other reasons"


def failures(store: BlockStore, firsts: list[int], total: int) -> dict[str, Any]:
    """Places where batteries run empty, and why runs fail, in bounded memory.

    Parameters
    ----------
    store : BlockStore
    firsts : list of int
        First runs of the blocks that count.
    total : int
        Number of runs.

    Returns
    -------
    dict
        ``empty``: battery, segment, share of all runs, median of the time; ``reasons``: message and share. The most
        frequent first.
    """
    counts: Counter[tuple[str, str]] = Counter()
    times: dict[tuple[str, str], list[NDArray[np.float64]]] = {}
    reasons: Counter[str] = Counter()
    for part in store.tables(("failed_segment", "failed_battery", "failed_at_s", "message"), firsts):
        failed = np.flatnonzero(part["failed_battery"] != "")
        places = list(zip(part["failed_battery"][failed], part["failed_segment"][failed], strict=True))
        for place, many in Counter(places).items():
            if counts[place] < KEPT_TIMES:
                here = [i for i, at in zip(failed, places, strict=True) if at == place]
                times.setdefault(place, []).append(part["failed_at_s"][here[: KEPT_TIMES - counts[place]]])
            counts[place] += many
        for message, many in Counter(part["message"][part["message"] != ""].tolist()).items():
            reasons[message if message in reasons or len(reasons) < KEPT_REASONS else _OTHER] += many
    return {
        "empty": [
            {
                "battery": battery,
                "segment": segment,
                "share": many / total,
                "median_time_s": float(np.median(np.concatenate(times[battery, segment]))),
            }
            for (battery, segment), many in counts.most_common()
        ],
        "reasons": [{"reason": reason, "share": many / total} for reason, many in reasons.most_common(20)],
    }

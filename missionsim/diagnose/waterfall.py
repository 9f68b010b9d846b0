"""What the steps of an improvement mean, in words."""

from __future__ import annotations

import math
from itertools import pairwise
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from missionsim.diagnose.improve import Improved


SEEN = 0.1
"""A rise by less than this part of the noise floor is not worth a line."""


def energy_note(done: Improved) -> str:
    """In words, why the energy error grew with an effect although the power error fell; empty where it did not.

    Errors of a model without the effect cancel out over a run. The noise floor, the mean error that a true model would
    have, says whether what is left with the effect may be chance.

    Parameters
    ----------
    done : Improved
        Its last step is the noise floor.
    """
    *steps, floor = done.steps
    worse = [
        (old, new) for old, new in pairwise(steps[1:])
        if new.energy_error_pct > old.energy_error_pct + SEEN * floor.energy_error_pct
        and new.power_rmse_w < old.power_rmse_w
    ]
    if not worse:
        return ""
    old, new = worse[0]
    held = done.first.heldout
    count = len(held.runs) if held is not None else len(done.first.runs)
    runs = f"{count} run{'s' * (count != 1)}"
    # the mean m of n absolute normal errors has the standard deviation m sqrt(pi/2 - 1) / sqrt(n)
    chance = floor.energy_error_pct * (1.0 + 2.0 * math.sqrt((math.pi / 2.0 - 1.0) / count))
    told = "may be chance" if new.energy_error_pct <= chance else "is more than noise and meters make"
    return (f"With '{new.name}' the energy error rises from {old.energy_error_pct:.2f} to {new.energy_error_pct:.2f} % "
            "while the power error falls: base and effect are fitted together, and errors of power that cancelled out "
            f"over a run no longer do. On {runs} a true model shows up to {chance:.1f} %; what is left {told}.")

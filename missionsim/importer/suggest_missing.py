"""What a suggested map says where there is no power: what was seen in its place, and what is wanted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from missionsim.importer.roles import Guess, size_of, words_of
from missionsim.importer.suggest_energy import goes_back

if TYPE_CHECKING:
    from missionsim.importer.suggest import Draft

_GAUGE = r"\b(soc|charge|percentage|battery level|capacity)\b"


def current_alone(draft: Draft, volts: Sequence[Guess], amps: Sequence[Guess]) -> list[str]:
    """A power of a current and a voltage that has to be written, where a draft has no voltage; the field of it."""
    if volts or not amps:
        return []
    guess = amps[0]
    sign = "-" if np.nanmean(draft.values(guess.field)) < 0 else ""
    factor = f" * {size_of(guess.unit):g}" if size_of(guess.unit) != 1.0 else ""
    message = f"'{guess.field}' is a current, and no voltage was found: put the battery's in the place of VOLTS"
    draft.missing.append(message)
    formula = f"VOLTS * {sign}{draft.ref(guess.field, 'amps')}{factor}"
    draft.columns["power_robot_w"] = (formula, Guess("power", guess.field, "", 0.0, message, "not found"))
    return [guess.field]


def no_power(draft: Draft, volts: Sequence[Guess]) -> None:
    """Say that there is no power, and what there is."""
    message = "no column looks like power, or voltage and current: write one in the place of POWER"
    back = [guess.field for role in ("power", "energy") for guess in draft.best(role) if goes_back(guess)]
    if back:
        message += f" ('{back[0]}' is what goes back into the battery)"
    elif charge := draft.best("charge"):
        why = ", no energy" if volts else ": without a voltage there is no energy in it"
        message += f" ('{charge[0].field}' is a charge{why})"
    elif name := next((name for name in draft.fields if re.search(_GAUGE, words_of(name)[0])), ""):
        message += f" ('{name}' is a gauge: there are no watts in it)"
    elif bare := next((name for name in draft.fields if re.search(r"\.col_\d+\Z", name)), ""):
        alias = bare.partition(".")[0]
        message += f" (a file without a header: its third column is called '{alias}.#3' in signals)"
    draft.missing.append(message)
    draft.columns["power_robot_w"] = ("POWER", Guess("power", "", "", 0.0, message, "not found"))

"""What a suggested map says where there is no power: what was seen in its place, and what is wanted."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from missionsim.importer.roles import ROLES, UNITS, Guess, folded, size_of, words_of
from missionsim.importer.suggest_energy import goes_back
from missionsim.labels import Labels

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


_EATS = r"\b(motors?|drives?|wheels?|traction|actuators?|servo\w*|heat\w*|air ?con\w*|electronics?|computer\w*)\b"
_NO_MEAN = r"\b(max|min|peak|rated|nominal|requested|target|limit|mech\w*|shaft)\b"


def with_larger_parts(draft: Draft, power: list[Guess]) -> list[Guess]:
    """Powers, the first of which is the sum with those of other parts, with a question, where one of a part is larger
    on average: so it is not all that the battery gives."""
    if not power or not draft.direct or re.search(ROLES["power"].prefer, words_of(power[0].field)[0]):
        return power
    first, parts = power[0], list[tuple[str, float]]()
    for name, one in draft.fields.items():
        words, unit = words_of(name)
        if name == first.field or isinstance(one.values, Labels) or folded(one) is not None:
            continue
        called = re.search(ROLES["power"].words, words) and re.search(_EATS, words) and not re.search(_NO_MEAN, words)
        if called and (not unit or UNITS[unit][0] == "power"):
            parts.append((name, size_of(unit) / size_of(first.unit)))
    means = {name: factor * float(np.nanmean(draft.values(name))) for name, factor in parts}
    larger = max(means, key=means.__getitem__, default="")
    if not larger or means[larger] <= 1.02 * float(np.nanmean(draft.values(first.field))):
        return power
    told = f"'{first.field}' is less than '{larger}', so it is not all that the battery gives: all were added up"
    draft.missing.append(f"{told}; is anything fed beside them?")
    terms = {first.field: 1.0} | dict(parts)
    total = draft.total("parts_w", "part", list(terms), list(terms.values()))
    return [replace(first, field=total, sure="a guess", score=1.0, why=f"the sum of {', '.join(terms)}"), *power]


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

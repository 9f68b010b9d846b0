"""Suggestions for a power of several meters, of motor drivers and of parts; and what a map says where there is none."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from missionsim.importer.draft import Draft
from missionsim.importer.roles import ROLES, UNITS, Guess, folded, says, size_of, words_of
from missionsim.importer.suggest_energy import goes_back
from missionsim.labels import Labels

_PAIRS = (("left", "right"), ("front", "rear"), ("_l", "_r"), ("1", "2"))
_LETTERS = {"voltage": r"volt(age|s)?", "current": r"current|amps?"}


def _named(draft: Draft) -> dict[str, list[str]]:
    """Every voltage and every current, whatever of."""
    named: dict[str, list[str]] = {"voltage": [], "current": []}
    for name, one in draft.fields.items():
        words, unit = words_of(name)
        if isinstance(one.values, Labels):
            continue
        for kind, letters in _LETTERS.items():
            if re.search(rf"\b({letters})\b", words) or (unit and UNITS[unit][0] == kind):
                named[kind].append(name)
    return named


def _stem(name: str, kind: str) -> str:
    """What a meter is called, without what it measures."""
    letter = "[uv]" if kind == "voltage" else "i"
    return " ".join(re.sub(rf"{_LETTERS[kind]}|\b{letter}\b", "", words_of(name)[0]).split())


def _pairs(draft: Draft) -> list[tuple[str, str]]:
    """Voltages and currents whose names differ in what they measure alone; of channels nobody knows what they feed."""
    named = {kind: [(name, _stem(name, kind)) for name in names] for kind, names in _named(draft).items()}
    pairs = ((volts, amps, stem) for volts, stem in named["voltage"] for amps, same in named["current"] if stem == same)
    return [(volts, amps) for volts, amps, stem in pairs if not re.search(r"\bch(annel)? ?\d", stem)]


def _sum(draft: Draft, pairs: list[tuple[str, str]]) -> str:
    """The formula of their power together."""
    terms = []
    for index, (volts, amps) in enumerate(pairs):
        size = size_of(words_of(volts)[1]) * size_of(words_of(amps)[1])
        term = f"{draft.ref(volts, f'volts_{index}')} * {draft.ref(amps, f'amps_{index}')}"
        terms.append(term + (f" * {size:g}" if size != 1.0 else ""))
    return " + ".join(terms)


def from_meters(draft: Draft, pair: tuple[Guess, Guess]) -> list[str]:
    """Power of all meters of a table where `pair`, the best voltage and current, is one of a part by its name, as
    `logic_voltage` beside `motor_voltage`; with a question."""
    chosen, pairs = (pair[0].field, pair[1].field), _pairs(draft)
    words = [f"{words_of(volts)[0]} {words_of(amps)[0]}" for volts, amps in pairs]
    more = [one for one, called in zip(pairs, words, strict=True) if not says("no_meter", called)]
    whole = not _stem(chosen[0], "voltage") or any(says("all_fed", one) or says("converter", one) for one in words)
    if not draft.direct or chosen not in more or len(more) < 2 or whole:
        return []
    told = ", ".join(f"'{_stem(volts, 'voltage')}'" for volts, _ in more)
    draft.missing.append(f"the powers of {told} were added up: is each another part of what the battery feeds?")
    guess = Guess("power", more[0][0], "", 1.0, f"the sum of {len(more)} meters", "a guess")
    draft.column("power_robot_w", _sum(draft, more), guess)
    return [name for one in more for name in one]


def sides(draft: Draft) -> list[tuple[str, str]]:
    """Voltage and current of each of several motor drivers; their names differ in the side alone."""
    pairs = _pairs(draft)
    sided = [
        [pair for pair in pairs if side in pair[0].lower()]
        for both in _PAIRS
        for side in both
        if all(any(s in pair[0].lower() for pair in pairs) for s in both)
    ]
    return list(dict.fromkeys(pair for group in sided[:2] for pair in group))


def _rest(draft: Draft, drivers: list[tuple[str, str]]) -> list[tuple[str, str]]:
    """The battery's voltage and each further current of the drivers' message, that of a computer or of ports."""
    topic = drivers[0][0].rpartition(".")[0]
    inside = {kind: [n for n in names if n.rpartition(".")[0] == topic] for kind, names in _named(draft).items()}
    volts = next((name for name in inside["voltage"] if says("all_fed", words_of(name)[0])), "")
    taken = {current for _, current in drivers}
    more = [i for i in inside["current"] if i not in taken and not says("no_meter", words_of(i)[0])]
    return [(volts, i) for i in more if volts and np.nanmean(draft.values(i)) > 0]


def from_sides(draft: Draft) -> list[str]:
    """Power of several motor drivers, and of what else their message has a current of."""
    drivers = sides(draft)
    if not drivers:
        return []
    rest = _rest(draft, drivers)
    others = "".join(f" and {amps.rpartition('.')[2]}" for _, amps in rest)
    why = f"the sum of the drivers{others}; what the battery feeds beside them is not in it"
    guess = Guess("power", drivers[0][0], "", 1.0, why, "likely")
    draft.column("power_robot_w", _sum(draft, [*drivers, *rest]), guess)
    # zero for a while: the topic was not up yet
    levels = [(volts, draft.values(volts)) for volts, _ in drivers]
    late = [draft.ref(name, "volts") for name, v in levels if (v == 0).any() and float(np.nanmedian(v)) > 3.0]
    if late and draft.direct:
        draft.head["keep"] = " and ".join(f"{name} > 0" for name in late)
    return [name for pair in drivers for name in pair]


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
        called = re.search(ROLES["power"].words, words) and says("eats", words) and not says("no_mean", words)
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
    elif name := next((name for name in draft.fields if says("gauge", words_of(name)[0])), ""):
        message += f" ('{name}' is a gauge: there are no watts in it)"
    elif bare := next((name for name in draft.fields if re.search(r"\.col_\d+\Z", name)), ""):
        alias = bare.partition(".")[0]
        message += f" (a file without a header: its third column is called '{alias}.#3' in signals)"
    draft.missing.append(message)
    draft.columns["power_robot_w"] = ("POWER", Guess("power", "", "", 0.0, message, "not found"))

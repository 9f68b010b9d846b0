"""Suggestions where there is more than a meter: counters of energy, what goes out and what goes back, single cells."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from missionsim.importer.draft import Draft
from missionsim.importer.roles import Field, Guess, says, size_of, words_of
from missionsim.labels import Labels
from missionsim.logs.clean import without_resets
from missionsim.physics import Array

_TREMBLES = 20.0
"""Of the energy of each row: values that go up and down by so many times their range in all (assumed)."""

_FEWEST = 20
"""Rows in which two meters must be known to say that they never run at once (assumed)."""
_GROWS = 0.8
"""Part of the steps of a charge that is drawn which are upwards, at least (assumed): braking gives some back."""


def goes_back(guess: Guess) -> bool:
    """Whether a name says that its energy goes back into the battery."""
    words = words_of(guess.field)[0]
    return says("back", words) and not says("out", words)


def net(draft: Draft, guess: Guess, alias: str, told: bool = False) -> tuple[Guess, str]:
    """What a meter delivers less what another one says goes back, as a guess and a formula: the meter alone where there
    is no other. `told`: whether further columns of the same kind are told, as those of counters are."""
    alike = [one for one in draft.best(guess.role) if one.field != guess.field]
    ref, mine = draft.ref(guess.field, alias), words_of(guess.field)[0]
    back = [one for one in alike if goes_back(one) or re.search(r"\bin\b", words_of(one.field)[0])]
    back = [one for one in back if _by_turns(draft, guess, one)]
    if back and says("out", mine):
        other = draft.values(back[0].field)
        known = other[np.isfinite(other)]
        flow = float(known[-1] - known[0]) if guess.role == "energy" else float(known.sum())
        sign, ratio = "+" if flow < 0 else "-", size_of(back[0].unit) / size_of(guess.unit)
        formula = f"{ref} {sign} {draft.ref(back[0].field, f'{alias}_back')}" + f" * {ratio:g}" * (ratio != 1.0)
        why = f"{guess.why}; what goes back, '{back[0].field}', is subtracted"
        return replace(guess, sure="likely", why=why), formula
    if told and alike:
        others = ", ".join(f"'{one.field}'" for one in alike)
        draft.remarks.append(f"there is another counter, which was neither added nor subtracted: {others}")
        guess = replace(guess, sure="a guess")
    return guess, ref


def _by_turns(draft: Draft, one: Guess, other: Guess) -> bool:
    """Whether two meters hardly ever run at once: of both directions, and not the two sides of a converter."""
    both = [draft.values(guess.field) for guess in (one, other)]
    if len(both[0]) != len(both[1]) or (known := np.isfinite(both).all(axis=0)).sum() < _FEWEST:
        return False
    flows = [np.abs(np.diff(values[known]) if one.role == "energy" else values[known]) for values in both]
    runs = [flow > 0.02 * float(flow.max()) for flow in flows]
    return float(np.mean(runs[0] & runs[1])) < 0.1


def negated(formula: str) -> str:
    """A formula of the other sign."""
    return f"-({formula})" if " " in formula else f"-{formula}"


_USUAL_W = (0.5, 5000.0)
"""Mean powers between which a counter without a unit is perhaps in Wh (assumed)."""


def _ask_for_unit(draft: Draft, guess: Guess) -> None:
    time_s = draft.time_s if draft.direct else draft.fields[guess.field].time_s
    if guess.unit or "unit" in guess.why or guess.score >= 3.0 or time_s is None or len(time_s) < 2:
        return
    counted = float(np.nansum(np.abs(np.diff(without_resets(draft.values(guess.field))[0]))))
    hours = float(np.nanmax(time_s) - np.nanmin(time_s)) / 3600.0
    if hours > 0.0 and not _USUAL_W[0] <= counted / hours <= _USUAL_W[1]:
        told = f"'{guess.field}' in Wh would be {counted / hours:.3g} W on average"
        draft.missing.append(f"{told}: write what it counts in (`{{value: …, unit: J}}`)")


def from_counter(draft: Draft) -> list[str]:
    """The energy so far of a counter, or the power by the energy of each row."""
    found = [guess for guess in draft.best("energy", 0.7) if not goes_back(guess)]
    words = {guess.field: words_of(guess.field)[0] for guess in found}
    if any(re.search(r"\bin\b", one) for one in words.values()):  # of what goes in and what goes out the latter
        found.sort(key=lambda guess: not says("out", words[guess.field]))
    for guess in found[:1]:
        values = draft.values(guess.field)
        step = np.diff(values[np.isfinite(values)])
        travelled = float(np.abs(np.diff(without_resets(values)[0][np.isfinite(values)])).sum())
        if says("each_row", words[guess.field]) or (len(step) > 50 and travelled > _TREMBLES * float(np.ptp(values))):
            return _per_row(draft, guess)
        falls = int((step < 0).sum()) > int((step > 0).sum())
        _ask_for_unit(draft, guess)
        guess, ref = net(draft, guess, "energy", told=True)
        why = guess.why + ("; it falls: what is left, so its sign was changed" if falls else "; it grows")
        draft.column("energy_robot_wh", negated(ref) if falls else ref, replace(guess, why=why))
        return [guess.field]
    return []


def from_charge(draft: Draft, volts: list[Guess]) -> list[str]:
    """The energy so far by a charge that is drawn, times the mean voltage at which it was."""
    for guess in [one for one in draft.best("charge") if not goes_back(one)][:1]:
        level = next((one for one in volts if not re.search(r"\bcells?\b", words_of(one.field)[0])), None)
        charge = draft.values(guess.field, guess.unit)
        if level is None or not draft.direct:
            return []
        at = draft.values(level.field, level.unit)
        known = np.isfinite(charge) & np.isfinite(at)
        drawn = np.diff(charge[known])
        if drawn.sum() <= 0 or float(np.mean(drawn[drawn != 0] > 0)) < _GROWS:
            return []
        mean = float((drawn * at[known][1:]).sum() / drawn.sum())
        formula = f"{draft.ref(guess.field, 'charge')} * {size_of(guess.unit) * mean:.5g}"
        why = f"the charge times the mean voltage, {mean:.4g} V; this is of other runs another one"
        draft.column("energy_robot_wh", formula, replace(guess, unit="", sure="a guess", why=why))
        draft.column("voltage_robot_v", draft.ref(level.field, "volts"), level)
        return [guess.field]
    return []


def _per_row(draft: Draft, guess: Guess) -> list[str]:
    steps = np.diff(draft.time_s) if draft.time_s is not None else np.empty(0)
    usual = float(np.median(steps)) if len(steps) else 0.0
    if usual <= 0 or float(np.mean(np.abs(steps - usual) > 0.2 * usual)) > 0.05:
        draft.missing.append(f"'{guess.field}' is the energy of each row, and rows last differently long")
        return []
    formula = f"{draft.ref(guess.field, 'energy')} * {size_of(guess.unit) * 3600.0 / usual:.6g}"
    why = f"{guess.why}; it goes up and down, so it is no counter but the energy of each row, of {usual:.4g} s"
    draft.column("power_robot_w", formula, replace(guess, unit="", sure="a guess", why=why))
    return [guess.field]


_CELL_V = (1.5, 4.5)
"""Volts of a cell at least and at most (assumed): so it is told where its name says no unit."""


def sum_of_cells(draft: Draft, volts: list[Guess], needed: bool) -> list[Guess]:
    """Voltages, none of them that of one cell: where one is needed and only cells are logged that of all together, with
    a question."""
    packs = [guess for guess in volts if not says("cell", words_of(guess.field)[0])]
    if packs or not needed:
        return packs
    groups: dict[str, list[Guess]] = {}
    for one in draft.fields.values():
        if unit := _unit_of_cell(one):
            guess = Guess("voltage", one.name, unit, 0.6, "the name", "a guess")
            groups.setdefault(re.sub(r"\d+", "#", one.name), []).append(guess)
    alike = max(groups.values(), key=len, default=[])
    if len(alike) > 1:
        told = f"{len(alike)} voltages of cells were added up: are these all cells of the battery, in series?"
        draft.missing.append(told)
        total = draft.total("cells_v", "cell", [one.field for one in alike])
        return [replace(alike[0], field=total, why=f"the sum of {len(alike)} cells")]
    for first in volts[:1]:
        draft.missing.append(
            f"'{first.field}' is the voltage of one cell: multiply it by the number of cells in series"
        )
    return volts


def _unit_of_cell(one: Field) -> str:
    """V or mV for a field that is the voltage of a cell by its name, and its unit or size; else nothing."""
    words, unit = words_of(one.name)
    if not says("cell", words) or not re.search(r"\d", one.name) or isinstance(one.values, Labels):
        return ""
    level = float(np.nanmedian(one.values)) if np.isfinite(one.values).any() else 0.0
    units = [unit] if unit else ["V", "mV"]
    return next((one for one in units if one in ("V", "mV") and _CELL_V[0] < level * size_of(one) < _CELL_V[1]), "")


def sum_of_currents(draft: Draft, volts: Guess, amps: Guess) -> Guess:
    """All currents whose names differ in a number alone, with a question, where they have one voltage together; else
    the others are asked for, or told where they are of other devices."""
    numbers = [name for name, one in draft.fields.items() if not isinstance(one.values, Labels)]
    alike, levels = (
        [name for name in numbers if re.sub(r"\d", "#", name) == re.sub(r"\d", "#", one.field)] for one in (amps, volts)
    )
    if len(alike) < 2:
        return amps
    if not draft.direct or len(levels) > 1:
        others = ", ".join(name for name in alike if name != amps.field)
        told = f"there are more currents, which were not added: {others}"
        if len({name.rpartition(".")[0] for name in alike}) > 1:  # of several devices
            draft.remarks.append(told)
        else:
            draft.missing.append(
                f"{told}: is '{amps.field}' all that the battery gives? else add each times its voltage"
            )
        return amps
    draft.missing.append(
        f"{len(alike)} currents were added up: is each that of another part of what the battery feeds?"
    )
    return replace(
        amps, field=draft.total("currents", "amps", alike), sure="a guess", why=f"the sum of {', '.join(alike)}"
    )


def delivered(draft: Draft) -> Array | None:
    """What the battery delivers by the columns that were chosen; None where these are of several sources."""
    guesses = {name: draft.columns[name][1] for name in ("power_robot_w", *_PAIR) if name in draft.columns}
    values = [draft.values(one.field, one.unit) for one in guesses.values() if one.field in draft.fields]
    if "power_robot_w" in guesses:
        return values[0] if len(values) == len(guesses) else None
    return values[0] * values[1] if len(values) == 2 and len(values[0]) == len(values[1]) else None


_PAIR = ("voltage_robot_v", "current_robot_a")
_FOLLOWS = 0.9
"""Correlation from which on a motor's power is that of the battery again (assumed)."""


def follows(part: Array, total: Array | None) -> bool:
    """Whether a power goes with another one, so that it is no consumer of its own."""
    if total is None or len(total) != len(part):
        return False
    both = np.isfinite(total) & np.isfinite(part)
    if both.sum() < 20 or not np.ptp(part[both]) or not np.ptp(total[both]):
        return False
    return float(np.corrcoef(part[both], total[both])[0, 1]) > _FOLLOWS

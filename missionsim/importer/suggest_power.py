"""Suggestions for what a battery delivers: power, voltage times current, several drivers, signs, slow meters."""

from __future__ import annotations

import itertools
import re
from dataclasses import replace

import numpy as np

from missionsim.importer import suggest_energy as energy
from missionsim.importer import suggest_meters as meter
from missionsim.importer.draft import Draft
from missionsim.importer.roles import ROLES, Guess, folded, says, words_of
from missionsim.labels import Labels
from missionsim.logs.codes import refreshes
from missionsim.physics import Array

_SIDE = r"\b(left|right|front|rear|fl|fr|rl|rr|l|r|links|rechts|gauche|droite)\b"
_BY_GLOSSARY, _OF_A_PART = 3.0, 1.3
"""Score of a name of the glossary, and how much less it is where it names no battery or total: another one may."""


def suggest(draft: Draft) -> None:
    """Add the columns of the battery to a draft, or say that there are none."""
    power = [guess for guess in draft.best("power", 0.7) if not says("no_battery", words_of(guess.field)[0])]
    power = [guess for guess in power if np.isfinite(draft.values(guess.field)).any() and not _counts(draft, guess)]
    power = [guess for guess in power if not energy.goes_back(guess) and not _of_a_quaternion(draft, guess.field)]
    power.sort(key=lambda guess: (folded(draft.fields[guess.field]) == "constant", -_as_a_whole(guess)))
    power = _all_sides(draft, power)
    volts, amps = draft.best("voltage", 0.7), draft.best("current", 0.7)
    volts = [guess for guess in volts if guess.sure != "a guess"] or volts
    volts.sort(key=lambda guess: folded(draft.fields[guess.field]) == "constant")
    volts = energy.sum_of_cells(draft, volts, not power and bool(amps))
    amps = [_in_milli(draft, guess, volts[0]) if volts else guess for guess in amps]
    pair = next(((v, i) for v, i in itertools.product(volts[:3], amps[:3]) if _beside(draft, v, i)), None)
    power = power if pair is not None else meter.with_larger_parts(draft, power)
    if power and (power[0].score >= 0.9 or pair is None):
        sources = _from_power(draft, power[0], pair)
    elif pair is not None and (says("all_fed", _called(draft, pair[1].field)) or not meter.sides(draft)):
        sources = meter.from_meters(draft, pair) or _from_pair(draft, *pair)
    else:
        sources = (
            meter.from_sides(draft)
            or _from_array(draft)
            or energy.from_counter(draft)
            or energy.from_charge(draft, volts)
        )
        sources = sources or _from_two_files(draft, volts, amps) or meter.current_alone(draft, volts, amps)
    if "sides_w" in draft.let and not any(guess.field == "sides_w" for _, guess in draft.columns.values()):
        del draft.let["sides_w"], draft.fields["sides_w"]
    if not sources:
        meter.no_power(draft, volts)
        return
    _rows(draft, sources)
    other = [
        v.field for v in draft.best("voltage", 0.7) if any(_beside(draft, v, i) for i in draft.best("current", 0.7))
    ]
    if other and pair is not None and not draft.direct:
        told = ", ".join(dict.fromkeys(name.rpartition(".")[0] for name in other))
        draft.remarks.append(
            f"a battery too, perhaps: {told}; voltage_<its name>_v and current_<its name>_a would take it"
        )


def _called(draft: Draft, name: str) -> str:
    """The words of a field, without those of its file."""
    return words_of(name.partition(".")[2] if draft.fields[name].joined else name)[0]


def _of_a_quaternion(draft: Draft, name: str) -> bool:
    """Whether a field is the W beside X, Y and Z, and never above one."""
    beside = {re.sub(r" #\d+\Z", "", other) for other in draft.fields}
    parts = {f"{name[:-1]}{axis}" for axis in ("XYZ" if name.endswith("W") else "xyz")}
    return name[-1:] in "wW" and parts <= beside and float(np.nanmax(np.abs(draft.values(name)))) < 1.001


def _as_a_whole(guess: Guess) -> float:
    """The score of a power, less for one that only the glossary's pattern makes sure: ``power_left_w`` is a part."""
    part = guess.score >= _BY_GLOSSARY and not re.search(ROLES["power"].prefer, words_of(guess.field)[0])
    return guess.score - _OF_A_PART * part


def _all_sides(draft: Draft, power: list[Guess]) -> list[Guess]:
    """Powers, the first of which is the sum of the sides where only sides are logged; one of several that have a name
    of the glossary, and name no battery or total, is a guess."""
    if not power or re.search(ROLES["power"].prefer, words_of(power[0].field)[0]):
        return power
    first, pattern = power[0], re.sub(_SIDE, "#", words_of(power[0].field)[0])
    alike = [one for one in power if re.sub(_SIDE, "#", words_of(one.field)[0]) == pattern and one.unit == first.unit]
    if draft.direct and "#" in pattern and len(alike) > 1:
        alike.sort(key=lambda one: list(draft.fields).index(one.field))
        total = draft.total("sides_w", "side", [one.field for one in alike])
        why = f"the sum of {', '.join(one.field for one in alike)}; what the battery feeds beside them is not in it"
        return [replace(first, field=total, sure="a guess", score=1.0, why=why), *power]
    others = [one.field for one in power[1:] if one.score >= _BY_GLOSSARY]
    if first.score >= _BY_GLOSSARY and others:
        why = f"{first.why}; there are others: {', '.join(others)}"
        return [replace(first, sure="a guess", why=why), *power[1:]]
    return power


_AMPERES_A_VOLT = 4.0
"""No battery delivers more for each volt that it has (assumed)."""


def _too_much(draft: Draft, watts: Array) -> str:
    """Why a power without a unit is in milliwatts: by the voltage of the battery, wherever it stands."""
    volts = next((v for v in draft.best("voltage", 0.7) if np.isfinite(draft.values(v.field)).any()), None)
    if volts is None or not np.isfinite(watts).any():
        return ""
    level = float(np.nanmedian(draft.values(volts.field, volts.unit)))
    amperes = float(np.nanquantile(np.abs(watts), 0.95)) / max(level, 1e-9)
    much = amperes > max(60.0, _AMPERES_A_VOLT * level)
    return f"mW, as {amperes:.4g} A at {level:.3g} V would be too much" if much else ""


def _in_milli(draft: Draft, amps: Guess, volts: Guess) -> Guess:
    """A current without a unit that no battery of its voltage delivers is in milliamperes."""
    values = draft.values(amps.field)
    values, level = values[np.isfinite(values)], float(np.nanmedian(draft.values(volts.field, volts.unit)))
    large = float(np.quantile(np.abs(values), 0.95)) if len(values) else 0.0
    if re.fullmatch(r"(.*\.)?current_battery", amps.field) and (values == np.round(values)).mean() > 0.99:
        return replace(amps, unit="cA", sure="likely", why=f"{amps.why}; 10 mA, as MAVLink counts it")
    if amps.unit or "unit" in amps.why or amps.score >= 3.0 or not large > max(60.0, _AMPERES_A_VOLT * level):
        return amps
    return replace(
        amps, unit="mA", sure="likely", why=f"{amps.why}; mA, as {large:.4g} A at {level:.3g} V would be too much"
    )


def _counts(draft: Draft, guess: Guess) -> bool:
    """Whether what is called a power only grows, as the energy used so far does; told."""
    values = draft.values(guess.field)
    step = np.diff(values[np.isfinite(values)])
    counts = len(step) > 50 and bool((step >= 0).all()) and float((step > 0).mean()) > 0.1
    if counts:
        draft.remarks.append(f"'{guess.field}' only grows: an energy, not a power, so it was not taken")
    return counts


def _beside(draft: Draft, one: Guess, other: Guess) -> bool:
    """Whether two fields are of one meter: columns of a table, fields of a topic or file, or topics of one number each
    beneath the same name (``/ina219/current``, ``/ina219/bus_voltage``)."""
    both = [guess.field.rpartition(".") for guess in (one, other)]
    if draft.direct or both[0][0] == both[1][0]:
        return True
    alone = [one for one in both if one[2] == "data" or one[2] in re.split(r"[/.]", one[0])]
    parents = [topic.rpartition("/")[0] if "/" in topic else topic.replace(field, "*", 1) for topic, _, field in alone]
    return len(parents) == 2 and parents[0] == parents[1] != ""


def _at(draft: Draft, guess: Guess, other: Guess) -> Array:
    """Values of a field at the times of another one, NaN where it has none."""
    values, field, at = draft.values(guess.field, guess.unit), draft.fields[guess.field], draft.fields[other.field]
    if field.time_s is None or at.time_s is None or np.array_equal(field.time_s, at.time_s):
        return values
    known = np.isfinite(values)
    if not known.any():
        return np.full(len(at.time_s), np.nan)
    return np.asarray(np.interp(at.time_s, field.time_s[known], values[known], left=np.nan, right=np.nan))


def _from_power(draft: Draft, guess: Guess, pair: tuple[Guess, Guess] | None) -> list[str]:
    watts = draft.values(guess.field, guess.unit)
    if pair is not None and _beside(draft, guess, pair[0]):
        product = _at(draft, pair[0], guess) * _at(draft, pair[1], guess)
        known = np.isfinite(watts) & np.isfinite(product) & (np.abs(product) > 0.02 * np.nanmax(np.abs(product)))
        ratio = float(np.median(watts[known] / product[known])) if known.any() else np.nan
        if 0.85 < abs(ratio) < 1.18:
            guess = replace(guess, sure="sure", why=f"{guess.why}; voltage × current agrees")
        elif 0.2 < abs(ratio) < 1 and any(says("alternating", words_of(name)[0]) for name in draft.fields):
            told = f"{guess.why}; {abs(ratio):.2g} times voltage × current, which are alternating"
            guess = replace(guess, sure="likely", why=told)
        elif 0.85 < abs(ratio) * 1e-3 < 1.18:
            guess = replace(guess, unit="mW", sure="likely", why="voltage × current says that it is in mW")
            watts = watts * 1e-3
        elif np.isfinite(ratio):
            sources = _from_pair(draft, *pair)
            draft.remarks.append(f"'{guess.field}' is {ratio:.3g} times voltage × current, so it was not taken")
            return sources
    elif not guess.unit and "unit" not in guess.why and (told := _too_much(draft, watts)):
        guess = replace(guess, unit="mW", sure="likely", why=f"{guess.why}; {told}")
        watts = watts * 1e-3
    if pair is None and any(re.search(r"\b(cadence|heart)\b", words_of(name)[0]) for name in draft.fields):
        guess = replace(guess, sure="a guess", why=f"{guess.why}; perhaps a rider's, who has a cadence")
    guess, formula = energy.net(draft, guess, "watts")
    if np.nanmean(watts) < 0:
        guess = replace(guess, why=f"{guess.why}; negative on average, a log counts what is delivered as positive")
        formula = energy.negated(formula)
    draft.column("power_robot_w", formula, guess)
    if pair is not None and _beside(draft, guess, pair[0]):
        draft.column("voltage_robot_v", draft.ref(pair[0].field, "volts"), pair[0])
    return [guess.field]


def _from_pair(draft: Draft, volts: Guess, amps: Guess) -> list[str]:
    amps = energy.sum_of_currents(draft, volts, amps)
    sign, why = _sign(draft, volts, amps)
    v = draft.ref(volts.field, "volts")
    amps, i = energy.net(draft, amps, "amps")
    i = f"({i})" if sign and " " in i else i
    draft.column("voltage_robot_v", v, volts)
    sure = amps.sure if not why.startswith("?") else "a guess"
    draft.column("current_robot_a", f"{sign}{i}", replace(amps, sure=sure, why=f"{amps.why}; {why.lstrip('?')}"))
    return [volts.field, amps.field]


def _from_two_files(draft: Draft, volts: list[Guess], amps: list[Guess]) -> list[str]:
    """The only voltage and the only current of several files, as meters write them that have a file for each."""
    if draft.direct or "files" not in draft.head or (len(volts), len(amps)) != (1, 1):
        return []
    told = [replace(one, sure="likely", why=f"{one.why}; in a file of its own") for one in (volts[0], amps[0])]
    return _from_pair(draft, *told)


def _sign(draft: Draft, volts: Guess, amps: Guess) -> tuple[str, str]:
    """Sign of a current: what discharges is positive in a log; a battery's voltage falls while it delivers."""
    v, i = _at(draft, volts, amps), draft.values(amps.field, amps.unit)
    known = np.isfinite(v) & np.isfinite(i)
    mean = float(np.mean(i[known])) if known.any() else 0.0
    with np.errstate(invalid="ignore"):
        drop = np.corrcoef(np.diff(v[known]), np.diff(i[known]))[0, 1] if known.sum() > 20 else np.nan
    rises = np.isfinite(drop) and drop > 0.2
    falls = np.isfinite(drop) and drop < -0.2
    if mean < 0 and not falls:
        return "-", "negative while discharging" + (": the voltage falls with it" if rises else " (on average)")
    if mean >= 0 and not rises:
        return "", "positive while discharging" + (": the voltage falls as it rises" if falls else " (on average)")
    if mean < 0:
        return "", "?its mean is negative, but the voltage falls as it rises: charged on average?"
    return "-", "?its mean is positive, but the voltage rises with it: charged on average?"


def _rows(draft: Draft, sources: list[str]) -> None:
    """Which rows: those of the power in a recording; means of a fast logger."""
    if not draft.direct:
        alias = next(alias for alias, name in draft.signals.items() if name == sources[-1])
        draft.head["timeline"] = f"{alias}  # rows where the power is measured, so that it is never made up"
        return
    time = draft.time_s
    if time is None or len(time) < 20:
        return
    known = np.isfinite(time)
    rising = np.flatnonzero(np.diff(time[known]) < 0)
    first = slice(0, int(rising[0]) + 1 if len(rising) else None)
    times = time[known][first]
    read = {name: draft.values(name)[known][first] for name in sources}
    slow = [name for name, v in read.items() if np.isfinite(v).all() and refreshes(v, times) is not None]
    # a voltage in rough steps repeats as well; the current tells
    meters = sources[1::2] or sources
    step = float(np.median(np.diff(times))) if known.sum() > 2 else 1.0
    # a held meter stays in its rows, where each refresh counts once: `refresh:` is for one that averages in between
    if not set(meters) <= set(slow) and 0 < step < 0.04 and "rate" not in draft.head.get("constants", ""):
        draft.head["step"] = "0.1 s  # means: more rows say nothing more of a mission"


def _product(numbers: dict[str, Array]) -> tuple[float, str, str, str] | None:
    """Columns of which one is the product of two others: by how much it misses, volts, amperes and watts."""
    moving = [name for name, one in numbers.items() if np.ptp(one) > 0 and not (np.diff(one) == 1).all()]
    best: tuple[float, str, str, str] | None = None
    for p, (v, i) in itertools.product(moving, itertools.permutations(moving, 2)):
        if p in (v, i):
            continue
        volts, amps, watts = numbers[v], numbers[i], numbers[p]
        level = float(np.median(volts))
        if not 3.0 <= level <= 1000.0 or np.std(volts) > 0.2 * level or np.median(np.abs(amps)) == 0:
            continue
        product = volts * amps
        scale = float(np.median(watts[product != 0] / product[product != 0])) if (product != 0).any() else 0.0
        factor = min((1.0, 1e-3, 1e3), key=lambda f: abs(np.log10(abs(scale) / f)) if scale else np.inf)
        miss = float(np.median(np.abs(watts - factor * product)) / max(np.median(np.abs(watts)), 1e-12))
        if miss < 0.05 and (best is None or miss < best[0]):
            best = (miss, v, i, p)
    return best


def _from_array(draft: Draft) -> list[str]:
    """Volts, amperes and watts among the numbers of a topic that have no names (``/power.data[2]``)."""
    arrays: dict[str, dict[str, Array]] = {}
    for name, one in draft.fields.items():
        if (match := re.fullmatch(r"(.+\.data)\[\d+\]", name)) and not isinstance(one.values, Labels):
            arrays.setdefault(match[1], {})[name] = draft.values(name)
    for numbers in arrays.values():
        if len(numbers) < 3 or (best := _product(numbers)) is None:
            continue
        names = best[1:]
        short = [name.rpartition(".")[2] for name in names]
        why = f"{short[0]} × {short[1]} gives {short[2]}"
        roles = ("voltage", "current", "power")
        v, i, p = (Guess(role, name, "", 1.0, why, "likely") for role, name in zip(roles, names, strict=True))
        i = _in_milli(draft, i, v)
        watts = np.abs(draft.values(v.field) * draft.values(i.field, i.unit))
        milli = float(np.median(np.abs(draft.values(p.field)))) > 30.0 * float(np.median(watts))
        return _from_power(draft, replace(p, unit="mW" if milli else ""), (v, i))
    return []


def name_headless(draft: Draft) -> None:
    """Name the columns of a file without header: where one is the product of two others they are P, V and I."""
    names = [name for name, one in draft.fields.items() if not isinstance(one.values, Labels)]
    numbers = {name: np.asarray(draft.fields[name].values, dtype=np.float64) for name in names}
    if (best := _product(numbers)) is None:
        return
    miss, v, i, p = best
    milli = float(np.median(np.abs(numbers[p]))) > 500.0
    parts = {v: "bus_V", i: "current_mA" if milli else "current_A", p: "power_mW" if milli else "power_W"}
    index = next((name for name in names if (np.diff(numbers[name]) == 1).all()), None)
    parts |= {index: "index"} if index else {}
    draft.remarks.append(f"{v} × {i} gives {p} within {100 * miss:.2g} %: taken for volts, amperes and watts")
    named = [replace(one, name=parts.get(name, name)) for name, one in draft.fields.items()]
    draft.fields = {one.name: one for one in named}
    draft.head["table"] = f"{{header: [{', '.join(draft.fields)}]}}"

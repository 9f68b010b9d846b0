"""What is missing, how sure that is, what it does to the error, what to type next: sentences for the top of a page."""

from __future__ import annotations

import math
import re
import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from missionsim.diagnose.waterfall import Step, bars_of, best_before, by_chance, clearly_better, worse_note
from missionsim.identify.findings import BatteryDiagnosis, Finding
from missionsim.identify.proposed import Proposal, plain, state
from missionsim.identify.settings import ODDS_NATS
from missionsim.numerals import rounded, watts

if TYPE_CHECKING:
    from missionsim.diagnose.improve import Improved

_SUBJECT = {
    "grade": "Climbing",
    "payload": "Carrying payload while driving",
    "acceleration": "Changing speed",
    "lost_recuperation": "What braking or a descent does not give back",
    "copper_loss": "Pulling hard (copper loss)",
    "turning_scrub": "Turning",
    "surface_turning_scrub": "Turning on some floors",
    "rolling_friction": "Driving",
    "viscous_friction": "Driving, more the faster,",
    "aerodynamic_drag": "Driving fast",
    "cold_friction": "Driving before the drive is warm",
    "temperature_friction": "Driving in the cold",
    "surface_rolling_resistance": "Driving on some floors",
    "start_surge": "Each start from rest",
    "conversion_loss": "A high load (loss of conversion)",
    "battery_resistance": "A high load (resistance of the battery)",
    "standby_load": "Something that is always on",
    "cpu_load": "Processor load",
    "cpu_frequency": "A high processor clock",
    "radio_range": "Distance from the access point",
}
_PER = {
    "W": "W",
    "N": "W per m/s",
    "W s/rad": "W per rad/s",
    "N s/m": "W per (m/s)²",
    "kg/m": "W per (m/s)³",
    "J": "J",
    "W/m^2": "W per m²",
    "W/K": "W per K",
    "m/s^2": "W per kg and m/s",
    "N/K": "W per m/s and K",
}

HARDLY = 0.1
"""Part by which levels of a label have to differ to be told as different (assumed)."""


def named(effect: Finding) -> str:
    """The library's name of what `missing` told, and whether that is sure; empty where it was told by its name."""
    kind = effect.effect.partition(":")[0]
    known = kind in _SUBJECT or kind.startswith(("component_", "logged_"))
    part = f", {shared(effect)}" if effect.shared_with else ""
    return f"; that {'may be' if effect.doubt else 'is'} {effect.effect}{part}" if known or effect.doubt or part else ""


def shared(effect: Finding) -> str:
    """What may have a part of an effect."""
    return f"a part of it perhaps {' or '.join(effect.shared_with)}, which goes along with it from run to run"


def missing(effect: Finding) -> str:
    """``Turning costs 3.3 kW per rad/s that the model does not know (5.1 % of the energy).``"""
    kind, _, part = effect.effect.partition(":")
    subject = _SUBJECT.get(kind, f"the effect {effect.effect}")
    if kind == "component_power":
        subject = f"{part}, while it is on,"
    elif kind == "component_warmup":
        subject = f"{part}, until it is warm,"
    elif kind == "logged_power":
        subject = f"What the log has as {part}"
    elif part:
        subject = f"{subject.replace(' on some floors', '')} on {part}"
    subject = subject[:1].upper() + subject[1:]
    share = f"{100 * abs(effect.net):.1f} % of the energy"
    if effect.back:
        share += f" ({100 * effect.taken:.1f} % taken, {100 * effect.back:.1f} % given back)"
    first = next(iter(effect.parameters.values()), None)
    if first is None or first.unit not in _PER or len(effect.parameters) > 1 or kind == "acceleration":
        return f"{subject} costs {share} that the model does not know"
    less = first.value < 0.0
    size = watts(abs(first.value)) if first.unit != "J" else f"{rounded(abs(first.value))} J"
    return (
        f"{subject} {'takes' if less else 'costs'} {size}{_PER[first.unit].removeprefix('W').removeprefix('J')} "
        f"{'less than the model says' if less else 'that the model does not know'} ({share})"
    )


def law(proposal: Proposal) -> str:
    """``Turning while driving with payload costs about 4.1 W (turn rate …) that the model does not know: 5 % …``."""
    first, curve = proposal.first, proposal.curve
    share = f"{100 * abs(proposal.energy_share):.1f} % of the energy"
    subject = _law_subject(first.formula, first.variables)
    if curve is None:
        return f"{subject} costs {share} that the model does not know"
    size = min(range(len(curve.x)), key=lambda i: abs(curve.x[i] - curve.usual))
    held = {name: value for name, value in curve.at.items() if not name.startswith("on_")}
    at = [state(name, value) for name, value in [(curve.variable, curve.x[size]), *held.items()]]
    verb = "gives back" if curve.watts[size] < 0.0 else "costs"
    amount = f"{watts(abs(curve.watts[size]))} ({', '.join(at)})"
    return f"{subject} {verb} about {amount} that the model does not know: {share}"


def _law_subject(formula: str, variables: Sequence[str]) -> str:
    """A law in plain words, from the quantities in it and the sides of them that it names."""
    parts: list[str] = []
    beside: list[str] = []
    standing = "(1 - (abs(speed_m_s)" in formula
    slow = "(abs(speed_m_s) <=" in formula
    ramp = "braking" if "max(-accel" in formula else "speeding up" if "max(accel" in formula else "changing speed"
    if "yaw_rate_rad_s" in variables and not standing:
        parts.append("turning on the spot" if slow else "turning")
    if "accel_m_s2" in variables:
        parts.append(ramp)
    if "slope_rad" in variables:
        up = "climbing" if "max(slope" in formula else "driving on slopes"
        word = "descending" if "max(-slope" in formula else up
        (beside if parts else parts).append(f"while {word}" if parts else word)
    for name in variables:
        if name not in ("yaw_rate_rad_s", "accel_m_s2", "slope_rad", "speed_m_s", "heading_rad"):
            # what costs something at every level is no matter of being at one
            aside = bool(parts) or min(_levels(name, formula).values()) > 0.0
            (beside if aside else parts).append(_aspect(name, formula, aside))
    if "speed_m_s" in variables and not slow:
        word = "standing still" if standing else "driving"
        if not parts:
            parts.append(word)
        elif ramp not in parts:
            beside.insert(0, f"while {word}")
    if most := re.search(r"cos\(heading_rad - ([\d.]+)\)", formula):
        beside.append(f"at headings about {math.degrees(float(most.group(1))):.0f}°")
    text = " ".join([*(parts or ["something"]), *beside])
    return text[:1].upper() + text[1:]


def _quantity(name: str, formula: str) -> str:
    """A quantity of a law in words: itself, or its rate."""
    return f"how fast {plain(name)} changes" if f"{name} - lag({name}, " in formula else plain(name)


def _aspect(name: str, formula: str, beside: bool) -> str:
    sizes = _levels(name, formula)
    levels = [level for level in sizes if level]
    if name.startswith("temp"):
        word = "heat"
        if bound := re.search(rf"max\(([\d.]+) - {name}", formula):
            word = f"cold (below {bound.group(1)} °C)"
        elif bound := re.search(rf"max\({name} - ([\d.]+)", formula):
            word = f"warmth (above {bound.group(1)} °C)"
        return f"in the {word}" if beside else word
    if name.startswith("on_"):
        part = name[3:].replace("_", " ")
        return f"while the {part} is on" if beside else f"the {part}"
    on = "on" if name == "surface" else "with"
    if levels and max(sizes.values()) - min(sizes.values()) < HARDLY * max(sizes.values()):
        return f"({on} {_listed(levels)} hardly otherwise)"
    if len(levels) == 1 and min(sizes.values()) > 0.0:
        return f"({on} {levels[0]} {'most' if sizes[levels[0]] > sizes[''] else 'least'})"
    if len(levels) > 1:
        return f"on {_listed(levels)}, each its own measure," if name == "surface" else f"by {name}"
    if levels:
        word = f"on {levels[0]}" if name == "surface" else f"in {plain(name)} {levels[0]}"
        return word if beside else f"being {word}"
    if (rate := _quantity(name, formula)) != plain(name):
        return rate
    if name in ("time_s", "moving_time_s"):
        fades = "exp(-moving_time_s" in formula
        return ("at first" if fades else "the longer the run lasts") if beside else "the time since the start"
    return f"with {plain(name)}" if beside else plain(name)


def _levels(name: str, formula: str) -> dict[str, float]:
    """Sizes of the levels of a label, ``(0.94 + 0.06 * (surface == 'asphalt'))``; of every other one without a name."""
    one = rf"([\d.]+) \* \({name} == '([^']*)'\)"
    if found := re.search(rf"\(([\d.]+)((?: [+-] {one})+)\)", formula):
        base = float(found.group(1))
        parts = re.findall(rf"([+-]) {one}", found.group(2))
        return {"": base} | {level: base + float(sign + size) for sign, size, level in parts}
    return {"": 0.0} | dict.fromkeys(re.findall(rf"\({name} == '([^']*)'\)", formula), 1.0)


def sure(battery: BatteryDiagnosis) -> str:
    """How sure the first answer is, and what speaks for it."""
    first = next(iter(battery.effects), None)
    if first is not None and not first.is_clear:
        return "Not sure which: these data cannot tell these effects apart."
    if first is not None:
        clear = battery.clear
        least = max(clear, key=lambda effect: effect.p_value)
        p = least.p_value
        odds = "less than one case in a million"
        if p >= 1e-6:  # two digits, rounded down: nothing is surer than it is
            unit = 10 ** max(0, math.floor(math.log10(1.0 / p)) - 1)
            odds = f"one case in {math.floor(1.0 / p / unit) * unit:,}"
        odds = f"chance would do this in {odds if p < 0.1 else 'many cases'}"
        held = battery.heldout
        bars = [] if held is None else bars_of(held)
        less = bool(bars) and bars[-1].power_rmse_w > bars[1].power_rmse_w
        if doubt := "see the runs not used" if less else first.doubt:
            return f"That something is missing is sure ({odds}); that it is {first.effect} is not: {doubt}."
        seen, alone = ([e.effect for e in clear if ("repeated" in e.level) is is_in] for is_in in (True, False))
        runs = "runs alone are too few to show it"
        if seen:
            runs = f"with whole runs as the sample {_listed(seen) + ' shows' if alone else 'it is there'} too"
            runs += f", {_listed(alone)} does not" if alone else ""
        of = f" ({least.effect}, the least sure)" if len(clear) > 1 else ""
        return f"Sure: {odds}{of}; {runs}."
    if not battery.proposed_laws:
        return ""
    one = battery.proposed_laws[0]
    read = ([_quantity(name, one.first.formula) for name in names] for names in (one.certain, one.possible))
    certain, possible = map(_listed, read)
    told = f"It depends on {certain}" if certain else "On what it depends is open"
    told += f", perhaps on {possible}" if possible else ""
    if one.goes_with:
        beside = _listed([*map(plain, one.goes_with)])
        told += f", or as well on {beside}, which hardly changes where it acts: drive one without the other"
    form = "its form is an approximation" + " within the band" * (one.curve is not None)
    if len(one.laws) > 1:
        behind = max(law.behind_nats for law in one.laws)
        part = math.ceil(100.0 * behind / max(one.rise_nats, 1e-300))
        alike = "fit alike" if behind < ODDS_NATS else f"come within {part} % of the best"
        form = f"{len(one.laws)} forms {alike}, so trust the curve and its band, not one formula"
    return (
        f"{told}; {form}. {one.better} of {one.runs} left-out {battery.parts} in which it acts are predicted better; "
        f"{one.tried:,} forms were tried, and chance is charged for all."
    )


def worse(battery: BatteryDiagnosis) -> str:
    """In words, that held-out runs are predicted worse with what was found; else empty."""
    if battery.heldout is None or not (battery.effects or battery.proposed_laws):
        return ""
    bars = bars_of(battery.heldout, battery.proposed_laws)
    return worse_note(bars, ("the effects", "the law"), what="what was found")


def base_note(before: Step, recalibrated: Step) -> str:
    """In words, that the base of a file is clearly off, and what fitting it anew does; else empty."""
    if not clearly_better(recalibrated, before):
        return ""
    return (
        f"The base of the robot file is off: fitted anew, the energy error falls from {before.energy_error_pct:.2f} to "
        f"{recalibrated.energy_error_pct:.2f} %, the power error from {rounded(before.power_rmse_w)} to "
        f"{watts(recalibrated.power_rmse_w)}."
    )


def errors(battery: BatteryDiagnosis) -> str:
    """What the error on runs that were not used was and is."""
    law = next(iter(battery.proposed_laws), None)
    if battery.meter:
        return battery.meter
    if battery.heldout is None:
        if law is None or not math.isfinite(law.left_out_rmse_w[1]):
            return ""
        before, after = map(watts, law.left_out_rmse_w)
        return f"On {battery.parts} left out one at a time, the power error falls from {before} to {after}."
    given, base, with_it, *_ = bars = bars_of(battery.heldout, battery.proposed_laws)
    if law is None and not battery.effects:
        return base_note(given, base)
    rmse_w = bars[-1].power_rmse_w
    # what the next command does not add, since these data cannot tell which it is, is in that number too
    named = _listed([*(e.effect for e in battery.clear), *(" or ".join(battery.either(e)) for e in battery.unsure)])
    now = f"{watts(rmse_w)} with {named if battery.unsure else 'it'}"
    was, alone = watts(given.power_rmse_w), watts(base.power_rmse_w)
    energies = [given.energy_error_pct, bars[-1].energy_error_pct]
    if rmse_w != with_it.power_rmse_w and battery.effects:
        now = f"{watts(with_it.power_rmse_w)} with {named}, {watts(rmse_w)} with the law as well"
        energies.insert(1, with_it.energy_error_pct)
    told = f"On runs not used the power error was {was} ({alone} recalibrated) and is {now}"
    if rmse_w > given.power_rmse_w:
        told = f"On runs not used the power error WAS ONLY {was} ({alone} recalibrated) and is {now}"
    elif rmse_w > base.power_rmse_w:
        told = f"On runs not used the power error was {was}, is {alone} with the base alone fitted anew, and NO LESS, "
        told += now.replace(" with", ", with", 1)
    return f"{told} (energy {' → '.join(f'{pct:.2f}' for pct in energies)} %)."


class Asked(NamedTuple):
    """What a diagnosis was asked with, for the command to type next."""

    robot: str
    logs: Sequence[str | Path]
    options: str = ""
    """Those that are not as by default, such as ``--holdout later``."""

    def typed(self, command: str, *words: str) -> str:
        """The line of a command for the same robot and logs; it writes another robot file."""
        files, out = (shlex.quote(str(log)) for log in self.logs), shlex.quote(f"{Path(self.robot).stem}_better.yaml")
        return " ".join(
            filter(None, ("missionsim", command, "--robot", shlex.quote(self.robot), *words, *files, "--out", out))
        )

    def refit(self, battery: str, several: bool) -> str:
        """The line that fits the base of one battery anew, of `several` or where it was asked for alone."""
        return self.typed("calibrate", f"--battery {battery}" * (several or "--battery" in self.options))


def next_step(battery: BatteryDiagnosis, asked: Asked, several: bool = False) -> str:
    """The command to type next; empty where there is nothing to add or to fit anew."""
    told = battery.clear
    law = next(iter(battery.proposed_laws), None)
    options = f"--battery {battery.battery}" * (several and "--battery" not in asked.options), asked.options
    if worse(battery):
        return ""
    bars = bars_of(battery.heldout, battery.proposed_laws) if battery.heldout is not None and (told or law) else ()
    if bars and bars[-1].power_rmse_w > bars[1].power_rmse_w:  # the base alone, fitted anew, does better
        return asked.refit(battery.battery, several)
    if told and len(told) + (law is not None and not law.open) > 1:  # one alone leaves the others' power to the base
        return asked.typed("improve", *options)
    if told:
        return asked.typed("add-effect", "--effect", shlex.quote(told[0].effect), *options)
    if law is not None and not law.open:
        if battery.effects:  # that these data cannot tell apart: the law goes in beside them
            return asked.typed("improve", *options)
        return asked.typed("add-effect", f'--formula "{law.first.formula}"', *options)
    if battery.effects or law is not None:
        bars = bars_of(battery.heldout) if battery.heldout is not None else []
        return asked.refit(battery.battery, several) if bars and clearly_better(bars[1], bars[0]) else ""
    if not errors(battery):
        return ""
    if battery.meter:
        return asked.typed("improve", *options)
    return asked.refit(battery.battery, several)


def advice(done: Improved, asked: Asked, several: bool = False) -> tuple[str, str]:
    """What of an improvement is to be told first, in words, and the command for it; see `Improved.advice`."""
    before, recalibrated = done.steps[0], done.steps[-2 if done.base_alone else 1]
    # on the runs that it is fitted to, a base fitted anew is always better; with the meter, held-out runs have spoken
    _, most_pct = by_chance(done.steps[-1].energy_error_pct, len(done.first.runs))
    off = done.late is None if done.heldout else before.energy_error_pct > most_pct
    far = base_note(before, recalibrated) if off and not done.added else ""
    meter = ""
    if done.late is not None:
        meter = f"{done.late.told(before, 'runs not used' if done.heldout else 'these runs')} The file that is written "
        meter += "has that meter, and nothing else is changed."
    if not (done.worse or far):
        return meter, ""
    *bars, last = done.steps[:-1]
    best = best_before([*bars, last]) if done.worse else 1
    if done.worse and last.power_rmse_w < bars[best].power_rmse_w:
        was = before.energy_error_pct <= recalibrated.energy_error_pct
        less = "as it was" if was else "with its base fitted anew"
        return f"For the power at each moment the new file is better, for the energy of a run the file {less}.", ""
    if best == 0:
        return "The robot file as it was predicts these runs best: leave it as it is.", ""
    if done.base_alone and far:
        return f"No effect was added. {far} The file that is written has that base.", ""
    if far:
        return f"{meter or 'Nothing was added; the file is as it was.'} {far}", asked.refit(done.battery, several)
    if best == 1:
        told = "The same file with its base fitted anew and nothing added predicts these runs better."
        return told, asked.refit(done.battery, several)
    late = done.added[best - 1 :]
    without = (f"--without {shlex.quote(name)}" for name in late)
    told = f"The file without {' and '.join(late)} predicts these runs better."
    return told, asked.typed("improve", asked.options, "--yes", *without)


def _listed(parts: Sequence[str]) -> str:
    return parts[0] if len(parts) == 1 else ", ".join(parts[:-1]) + " and " + parts[-1] if parts else ""

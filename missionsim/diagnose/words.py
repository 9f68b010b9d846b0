"""The verdict in words that a robot engineer understands: where, clock, noise, found, unsure, next, not seen …"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection, Sequence
from contextlib import suppress

from missionsim.diagnose import sentences
from missionsim.diagnose.execution import TOLD
from missionsim.diagnose.waterfall import bars_of, unseen_note
from missionsim.effects.library import get_effect
from missionsim.errors import InputError
from missionsim.identify.findings import AT_BOUND, BatteryDiagnosis, Estimate, Experiment, Finding, HeldOut
from missionsim.identify.proposed import Proposal, plain
from missionsim.identify.settings import Settings
from missionsim.numerals import bare, counted, meter_clock, p_told, rounded, watts

NOTHING_LEFT = "nothing is left above the detection limits"
AS_WELL = "which at first these data could not tell from what went in; it is not added"
MOST_NOT_SEEN = 8
INF = math.inf
BLIND_SHARE = 0.5
"""Detection limits from here on mean that the data say nothing of an effect."""


def headline(battery: BatteryDiagnosis, several: bool = False) -> str:
    """The verdict in one or two sentences; the battery is named where `several` are diagnosed."""
    left = battery.unexplained
    said = list(filter(None, [sentences.worse(battery)]))
    said += [f"{sentences.missing(f)}{sentences.named(f)}." for f in battery.clear]
    for effect in battery.unsure:
        names, named = " or ".join(battery.either(effect)), {one.effect for one in battery.clear}
        other = "else " if battery.clear else ""
        told = f"{other}is missing, {100 * effect.energy_share:.1f} % of the energy: {names}"
        or_both = ", or whether it is both" if len(effect.alike) == 1 and not named & {*effect.alike} else ""
        said.append(f"Something {told}. These data cannot tell which{or_both}.")
    if driven := [_execution(f) for f in battery.execution]:
        said.append(f"The robot drove otherwise than planned: {'; '.join(driven)}.")
    for law in battery.proposed_laws:
        fits = f"{law.like} acts so, and is not sure by itself" if law.like else "no effect of the library fits"
        if law.instead_of:
            fits += f"; {' and '.join(law.instead_of)} would only stand in for it"
        if law.open:
            fits += f"; whether it is {' or '.join(map(plain, law.possible))} that it follows, these data cannot tell"
        said.append(f"{sentences.law(law)}; {fits}.")
    if battery.proposed_laws:
        if left.shape:
            said.append(f"What shows it: {left.shape}.")
    elif battery.verdict == "unexplained_structure" and not left.depends_on:
        said.append(f"{left.shape[:1].upper()}{left.shape[1:]}.")
    elif battery.verdict == "unexplained_structure":
        said.append(
            f"Something is {'also ' if battery.effects else ''}missing that {battery.unnamed}; it "
            f"varies with {', '.join(map(plain, left.depends_on))} ({left.shape})."
        )
    elif left.shape:
        said.append(f"{'Beyond that, something' if said else 'Something'} remains: {left.shape}.")
    if unseen := unseen_note(battery):
        beyond = "Beyond that, " if said and not left.shape else ""
        said.append(f"{beyond}{unseen if beyond else unseen[:1].upper() + unseen[1:]}.")
    if not said:
        known = [c.smallest_detectable_share for c in battery.candidates if c.smallest_detectable_share is not None]
        limits = [100 * limit for limit in known if limit < BLIND_SHARE]
        least = f" ({min(limits):.1f} to {max(limits):.1f} % of energy, by effect)" if limits else ""
        said.append(f"No evidence of anything missing above the detection limits{least}.")
    if battery.clock_at_edge:
        said.append("The clocks of meter and motion lie further apart than what is searched: check them first.")
    return " ".join([*([f"Battery {battery.battery}:"] if several else []), *said])


def report(battery: BatteryDiagnosis) -> list[tuple[str, str]]:
    """The report as (heading, line) pairs, in the order of the skeleton; headings may repeat."""
    lines = [
        (
            "WHERE",
            f"{where.title} {f'{where.value} {where.unit}'.strip()}: {100 * where.share_of_squared_error:.0f} % of the "
            f"squared error, model {watts(where.bias_w, 2, sign=True)} against the meter",
        )
        for where in battery.where
    ]
    edge = "; at the edge of what is searched: check the clocks" if battery.clock_at_edge else ""
    had = f"; the file has it {meter_clock(*battery.file_clock)}" if any(battery.file_clock) else ""
    clock = f"meter {meter_clock(battery.delay_s, battery.lag_s)} (applied{had}{edge})"
    lines.append(("CLOCK", clock if battery.aligned else "taken as logged"))
    lines.append(("NOISE", _noise(battery)))
    lines += [("FOUND", found_line(effect)) for effect in battery.clear]
    lines += [("DRIVEN", f"{_execution(e)}; {100 * e.energy_share:+.1f} % of the energy") for e in battery.execution]
    for effect in battery.unsure:
        nats = effect.separation_nats
        more = ""
        if nats < 0.05:
            more = "; more of the same data will not help"
        elif nats < 5.0:
            more = f"; expected lead {nats:.1f} nats, about {5.0 / nats:.1f} times these data would settle it"
        share = f"{_percent(effect.energy_share)} % of energy"
        lines.append(("UNSURE", f"{' OR '.join(battery.either(effect))}, {share}: these data cannot tell{more}"))
    lines += [
        ("DOUBTFUL", f"{one.effect}: {_percent(one.doubtful_share)} % of energy; not named: {one.reason}")
        for one in battery.candidates
        if one.doubtful_share is not None
    ]
    for law in battery.proposed_laws:
        lines += [("LAW", line) for line in _law_lines(law, battery.parts)]
        lines += [("NEXT", law.experiment)] if law.experiment else []
    lines += [("NEXT", next_line(experiment)) for experiment in battery.next_experiments]
    if battery.unsure and not battery.next_experiments:
        lines.append(("NEXT", "no manoeuvre that we know, driven for twelve minutes, tells any of these apart"))
    lines.append(("NOT SEEN", _not_seen(battery)))
    without = "without the law: " * bool(battery.proposed_laws)
    lines.append(("REMAINS", f"{without}{left}" if (left := battery.unexplained.shape) else "nothing beyond the noise"))
    shifts = [s for s in battery.recalibration if abs(s.shift_in_prior_sd) >= 1.0][:6]
    for beyond, said in (
        (False, "recalibrated, no discovery"),
        (True, "further off than its sd allows, and no effect takes its place; check file and logs"),
    ):
        own = [s for s in shifts if (abs(s.shift_in_prior_sd) > Settings.recalibration_limit) == beyond]
        shifted = [(s.parameter, f"{s.shift_pct:+.1f} % ({s.shift_in_prior_sd:+.1f} sd)") for s in own]
        told = [f"{name} {by.replace('-', '−')}" for name, by in shifted]
        lines += [("BASE", f"{said}: {', '.join(told)}")] if told else []
    tested = [held for held in (battery.heldout, battery.shifted) if held is not None]
    laws = battery.proposed_laws
    lines += [
        ("HELD-OUT", heldout_line(held, bool(battery.effects), laws if held is battery.heldout else ()))
        for held in tested
    ]
    if battery.heldout is None:
        count = counted(len(battery.runs), "run")
        told_not = f"nothing held out ({count}): how the model does on runs that were not used is not shown"
        lines.append(("HELD-OUT", told_not))
    lines += [("NOTE", remark) for remark in battery.remarks]
    lines += [("UNTESTABLE", f"without {column}: {names}") for column, names in untestable(battery)]
    return lines


def untestable(battery: BatteryDiagnosis) -> list[tuple[str, str]]:
    """What the logs lack, and the effects that they cannot test for it; each under what most of them lack."""
    lacking = Counter(column for needs in battery.untestable.values() for column in needs)
    without: dict[str, list[str]] = {}
    for name, needs in battery.untestable.items():
        column, *more = sorted(needs, key=lambda one: -lacking[one])
        without.setdefault(column, []).append(f"{name} (and {', '.join(more)})" if more else name)
    return [(column, ", ".join(names)) for column, names in without.items()]


def parameters_told(effect: Finding) -> str:
    """The parameters of an effect with their intervals, within the bounds of the library."""
    floors = tuple(name.removeprefix("k_") for name in effect.parameters)
    with suppress(InputError):  # a formula of the user or a law has none
        own = get_effect(effect.effect, floors)
        bounds = {spec.name: (spec.low, spec.high) for spec in own.parameters}
        return ", ".join(_estimate(name, e, *bounds.get(name, (-INF, INF))) for name, e in effect.parameters.items())
    return ", ".join(_estimate(name, e) for name, e in effect.parameters.items())


def _estimate(name: str, e: Estimate, least: float = -INF, most: float = INF) -> str:
    if e.low == e.high:
        return f"{name} = {bare(e.value)}{_unit(e.unit)} (chosen, not fitted)"
    near = AT_BOUND * (e.high - e.low)
    for bound, side, reach, other in ((least, "least", "up", e.high), (most, "most", "down", e.low)):
        if abs(e.value - bound) <= near:
            end = min(max(other, least), most)
            return f"{name} = {bare(bound)}{_unit(e.unit)}, its {side} (95 % {reach} to {bare(end)})"
    # an interval of a coefficient that reaches below nothing says so; a part is no less than none and no more than all
    low, high = (max(e.low, least), min(e.high, most)) if least < e.value < most < INF else (e.low, e.high)
    return f"{name} = {bare(e.value)}{_unit(e.unit)} (95 % {bare(low)} to {bare(high)})"


def share_told(effect: Finding) -> str:
    """Share of the energy with its interval, net of what comes back."""
    taken, part = f"{_percent(effect.taken)} %", effect.taken / effect.energy_share if effect.back else 1.0
    interval = ""
    if math.isfinite(effect.share_low):
        interval = f" (95 % {_percent(part * effect.share_low)} to {_percent(part * effect.share_high)})"
    if not effect.back:
        return f"{taken} of energy{interval}"
    return f"{_percent(effect.net)} % of energy: {taken}{interval} taken, {_percent(effect.back)} % given back"


def found_line(effect: Finding) -> str:
    """An effect that was found: share of energy with interval, parameters, level; one in doubt is seen and no more."""
    level = effect.level.replace("identified", "seen") if effect.doubt else effect.level
    runs = f", {p_told(effect.p_runs, what='p over runs')}" if math.isfinite(effect.p_runs) else ""
    return (
        f"{effect.effect}: {share_told(effect)}; {parameters_told(effect)}; "
        f"{level}, {p_told(effect.p_value)}{runs}{'; ' * bool(effect.doubt)}{effect.doubt}"
        + (f"; {sentences.shared(effect)}" if effect.shared_with else "")
    )


def _law_lines(law: Proposal, parts: str) -> list[str]:
    """The forms of a proposed law, the plainest first, and the `parts` left out that they rest on."""
    lines = []
    for number, one in enumerate(law.laws, 1):
        behind = "" if one.behind_nats < 0.05 else f"; {one.behind_nats:.0f} nats behind"
        k = f"k = {bare(one.k)}{_unit(one.unit)} (95 % {bare(one.low)} to {bare(one.high)})"
        lines.append(f"{number}: {one.formula}, {k}{behind}")
    before, after = law.left_out_rmse_w
    rests = f"rise of {law.rise_nats:.0f} nats where {law.penalty_nats + 6:.0f} are asked, of {law.tried:,} forms"
    if math.isfinite(after):
        rests += f"; {parts} left out one at a time: power RMSE {rounded(before)} → {watts(after)}"
    return [*lines, rests]


def next_line(experiment: Experiment) -> str:
    """A proposed manoeuvre."""
    minutes = f"{experiment.minutes:.0f} min"
    long = "" if minutes in experiment.do or not experiment.minutes else f" ({minutes})"
    if not math.isfinite(experiment.separation_after):
        return experiment.do + long
    return (
        f"{experiment.do}{long}: to tell {' from '.join(experiment.separates)}, predicted "
        f"separation {experiment.separation_now:.1f} → {experiment.separation_after:.0f} nats, resolves with "
        f"probability {experiment.expected_power:.2f}"
    )


def heldout_line(heldout: HeldOut, found: bool = True, laws: Sequence[Proposal] = ()) -> str:
    """Errors on held-out runs; with `found`, those with the effects as well, and those with a law that is proposed."""
    kind = "other conditions" if heldout.shifted else "same kind"
    of = {"nominal": "", "recalibrated": " (recalibrated)", "with_effects": " (with the effects)"}
    of["with_law"] = " (with the law as well)" if found else " (with the law)"
    *bars, last = [bar for bar in bars_of(heldout, laws) if found or bar.name != "with_effects"]
    energies = [f"{bar.energy_error_pct:.2f}{of[bar.name]}" for bar in bars]
    energy = " → ".join([*energies, f"{last.energy_error_pct:.2f} %{of[last.name]}"])
    power = " → ".join(rounded(bar.power_rmse_w) for bar in (*bars, last))
    return f"{heldout.how} ({kind}): energy error {energy}; power RMSE {power} W"


def _execution(effect: Finding) -> str:
    estimate = next(iter(effect.parameters.values()))
    scheme = f" in {effect.scheme}" if effect.scheme else ""
    interval = f" (95 % {bare(estimate.low, 3)} to {bare(estimate.high, 3)})" if math.isfinite(estimate.low) else ""
    return f"{effect.effect}{scheme}: {bare(estimate.value, 3)} {TOLD[effect.effect]}{interval}"


def _noise(battery: BatteryDiagnosis) -> str:
    n = battery.noise
    told = f"{watts(n['sd_w'], 2)} ({100 * n['sd_w'] / battery.mean_power_w:.1f} % of the mean power)"
    if n["fast_share"] + n["slow_share"] > 0.5:
        told += f", lasting {n['fast_s']:.0f} to {n['slow_s']:.0f} s"
    if len(battery.runs) > 1:
        told += f"; runs differ by ±{watts(n['offset_w'], 2)} and ±{100 * n['gain']:.1f} % (meter), "
        told += f"±{100 * n['motion_gain']:.1f} % of the power (drive)"
    return told


def _not_seen(battery: BatteryDiagnosis) -> str:
    limits = [
        (c.smallest_detectable_share, c.effect)
        for c in battery.candidates
        if not (c.accepted or c.open or c.smallest_detectable_share is None)
        and math.isfinite(c.smallest_detectable_share)
    ]
    blind = [name for share, name in limits if share >= BLIND_SHARE]
    limits = sorted((share, name) for share, name in limits if share < BLIND_SHARE)
    shown = [f"{name} < {100 * share:.1f} %" for share, name in limits[:MOST_NOT_SEEN]]
    more = f" and {len(limits) - MOST_NOT_SEEN} more with higher limits" if len(limits) > MOST_NOT_SEEN else ""
    text = f"{', '.join(shown)}{more} of energy" if shown else "no limit below half of the energy"
    return text + (f"; these data say nothing of {', '.join(blind)}" if blind else "")


def _unit(unit: str) -> str:
    return "" if unit in ("1", "") else f" {unit}"


def _percent(share: float) -> str:
    return f"{100 * share:.1f}".replace("-", "−")


def stopped(
    last: BatteryDiagnosis,
    declined: Sequence[str],
    nothing: Sequence[str] = (),
    as_well: Collection[str] = (),
    *,
    tested: bool = True,
) -> str:
    """Why `improve` goes no further: what was seen and not added, or that nothing is left.

    `nothing`: what came to nothing beside the others; `as_well`: what could not be told at first from what went in;
    `tested`: whether held-out runs can test what went in.
    """
    unseen = unseen_note(last) if tested else ""
    if last.unsure:
        first = last.unsure[0]
        names = " or ".join(last.either(first))
        drive = f" Drive next: {last.next_experiments[0].do}." if last.next_experiments else ""
        none = "neither" if len(first.indistinguishable_from) == 1 else "none of them"
        return f"these data cannot tell {names}, so {none} is added.{drive}"
    undecided = next((law for law in last.proposed_laws if law.open), None)
    if undecided is not None:
        names = " or ".join(map(plain, undecided.possible))
        return f"these data cannot tell whether a law reads {names}, so it is not added. Next: {undecided.experiment}."
    if last.verdict == "unexplained_structure" and last.unexplained.shape:
        told = f"something remains that {last.unnamed}: {last.unexplained.shape}."
        return told + (f" Beside that, {unseen}." if unseen else "")
    if named := [e.effect for e in last.effects if e.effect not in (*declined, *nothing)]:
        told = f"diagnose of the file names {' and '.join(named)} beside it"
        return f"{told}: improve that file once more." if {*named} - {*as_well} else f"{told}, {AS_WELL}."
    if declined:
        return f"declined: {', '.join(declined)}."
    if unseen:
        return f"{unseen}."
    if nothing:
        return f"{', '.join(nothing)}: seen, but of a size that cannot be told from none beside the rest; not added."
    if last.unexplained.depends_on:
        on = ", ".join(map(plain, last.unexplained.depends_on))
        return f"no further effect is above the detection limits; what remains still varies with {on}."
    if last.unexplained.shape:
        return f"no further effect is above the detection limits; what remains: {last.unexplained.shape}."
    return f"{NOTHING_LEFT}."

"""The verdict in words that a robot engineer understands: where, clock, noise, found, unsure, next, not seen …"""

from __future__ import annotations

import math

from missionsim.diagnose import sentences
from missionsim.diagnose.execution import TOLD
from missionsim.diagnose.leftover import watts
from missionsim.diagnose.waterfall import unseen_note
from missionsim.identify.findings import BatteryDiagnosis, Experiment, Finding, HeldOut, Judged
from missionsim.identify.proposed import Proposal

MOST_NOT_SEEN = 8
RECALIBRATION_SD = 4.0
"""Prior standard deviations up to which a shift of a base parameter is recalibration (`Settings`)."""
BLIND_SHARE = 0.5
"""Detection limits from here on mean that the data say nothing of an effect."""


def headline(battery: BatteryDiagnosis) -> str:
    """The verdict in one or two sentences."""
    name = battery.battery
    found = [f for f in battery.effects if not f.indistinguishable_from]
    unsure = [f for f in battery.effects if f.indistinguishable_from]
    driven = [f for f in battery.execution if f.effect]
    said = list(filter(None, [sentences.worse(battery)]))
    said += [f"Battery {name}: {sentences.missing(f)}; that is {f.effect}." for f in found]
    for effect in unsure:
        names = (effect.effect, *effect.indistinguishable_from)
        said.append(
            f"Battery {name}: something is missing, {_share(effect)}: {' or '.join(names)}. These data cannot "
            "tell which."
        )
    if driven:
        said.append("The robot drove otherwise than planned: " + "; ".join(_execution(f) for f in driven) + ".")
    for law in battery.proposed_laws:
        fits = f"it looks like {law.looks_like}" if law.looks_like else "no effect of the library fits"
        if law.instead_of:
            fits += f"; {' and '.join(law.instead_of)} would only stand in for it"
        if law.open:
            fits += f"; whether it is {' or '.join(law.possible)} that it follows, these data cannot tell"
        said.append(f"Battery {name}: {sentences.law(law)}; {fits}.")
    if battery.proposed_laws:
        if battery.unexplained.shape:
            said.append(f"What shows it: {battery.unexplained.shape}.")
    elif battery.verdict == "unexplained_structure" and not battery.unexplained.depends_on:
        said.append(f"Battery {name}: {battery.unexplained.shape}.")
    elif battery.verdict == "unexplained_structure":
        on = ", ".join(battery.unexplained.depends_on)
        also = "also " if battery.effects else ""
        said.append(
            f"Battery {name}: something is {also}missing that the library does not contain; it varies with "
            f"{on} ({battery.unexplained.shape})."
        )
    elif battery.unexplained.shape:
        said.append(f"Battery {name}: {'beyond that, ' if said else ''}something remains: {battery.unexplained.shape}.")
    if unseen := unseen_note(battery):
        said.append(f"Battery {name}: {'beyond that, ' if said else ''}{unseen}.")
    if not said:
        least = _smallest_limits(battery)
        said.append(f"Battery {name}: no evidence of anything missing above the detection limits{least}.")
    if battery.clock_at_edge:
        said.append("The clocks of meter and motion lie further apart than what is searched: check them first.")
    return " ".join(said)


def report(battery: BatteryDiagnosis) -> list[tuple[str, str]]:
    """The report as (heading, line) pairs, in the order of the skeleton; headings may repeat."""
    lines: list[tuple[str, str]] = []
    for where in battery.where:
        lines.append(
            (
                "WHERE",
                f"{where.by} {where.value}: {100 * where.share:.0f} % of the squared error, model "
                f"{watts(where.bias_w)} W against the meter",
            )
        )
    edge = "; at the edge of what is searched: check the clocks" if battery.clock_at_edge else ""
    clock = f"meter {battery.delay_s:+.2f} s behind the motion, lag {battery.lag_s:.2f} s (applied{edge})"
    if not battery.aligned:
        clock = "taken as logged, as asked"
    lines.append(("CLOCK", clock))
    lines.append(("NOISE", _noise(battery)))
    for effect in battery.effects:
        if not effect.indistinguishable_from:
            lines.append(("FOUND", found_line(effect)))
    for effect in battery.execution:
        lines.append(("DRIVEN", _execution(effect) + f"; {100 * effect.energy_share:+.1f} % of the energy"))
    for effect in battery.effects:
        if effect.indistinguishable_from:
            lines.append(("UNSURE", unsure_line(effect)))
    lines += [("DOUBTFUL", doubtful_line(c)) for c in battery.candidates if c.doubtful_share is not None]
    for law in battery.proposed_laws:
        lines += [("LAW", line) for line in law_lines(law)]
        if law.experiment:
            lines.append(("NEXT", law.experiment))
    for experiment in battery.next_experiments:
        lines.append(("NEXT", next_line(experiment)))
    if not battery.next_experiments and any(e.indistinguishable_from for e in battery.effects):
        lines.append(("NEXT", "no manoeuvre that we know, driven for three minutes, tells these apart"))
    lines.append(("NOT SEEN", _not_seen(battery)))
    lines.append(("REMAINS", _remains(battery)))
    lines += [("BASE", line) for line in _base(battery)]
    for heldout in (battery.heldout, battery.shifted):
        if heldout is not None:
            lines.append(("HELD-OUT", heldout_line(heldout, bool(battery.effects))))
    if battery.heldout is None:
        count = len(battery.runs)
        lines.append(
            (
                "HELD-OUT",
                f"nothing held out ({count} run{'s' * (count != 1)}): how the model does on runs "
                "that were not used is not shown",
            )
        )
    lines += [("NOTE", remark) for remark in battery.remarks]
    if battery.untestable:
        lines.append(("UNTESTABLE", _untestable(battery)))
    return lines


def found_line(effect: Finding) -> str:
    """An effect that was found: share of energy with interval, parameters, level."""
    numbers = ", ".join(
        f"{name} = {e.value:.4g}{_unit(e.unit)} (95 % {e.low:.4g} to {e.high:.4g})"
        for name, e in effect.parameters.items()
    )
    interval = ""
    if math.isfinite(effect.share_low):
        interval = f" (95 % {100 * effect.share_low:.1f} to {100 * effect.share_high:.1f})"
    runs = f", p over runs {effect.p_runs:.1g}" if math.isfinite(effect.p_runs) else ""
    return (
        f"{effect.effect}: {100 * effect.energy_share:.1f} % of energy{interval}; {numbers}; {effect.level}, "
        f"p = {effect.p_value:.1g}{runs}"
    )


def law_lines(law: Proposal) -> list[str]:
    """The forms of a proposed law, the plainest first, and what they rest on."""
    lines = []
    for number, one in enumerate(law.laws, 1):
        behind = "" if one.behind_nats < 0.05 else f"; {one.behind_nats:.0f} nats behind"
        unit = _unit(one.unit)
        lines.append(f"{number}: {one.formula}, k = {one.k:.3g}{unit} (95 % {one.low:.3g} to {one.high:.3g}){behind}")
    before, after = law.left_out_rmse_w
    rests = f"rise of {law.rise_nats:.0f} nats where {law.penalty_nats + 6:.0f} are asked, of {law.tried:,} forms"
    if math.isfinite(after):
        rests += f"; runs left out one at a time: power RMSE {before:.3g} -> {after:.3g} W"
    return [*lines, rests]


def doubtful_line(candidate: Judged) -> str:
    """An effect that helps, but whose name is not vouched for."""
    share = 0.0 if candidate.doubtful_share is None else candidate.doubtful_share
    return f"{candidate.effect}: {100 * share:.1f} % of energy; not named: {candidate.reason}"


def _base(battery: BatteryDiagnosis) -> list[str]:
    """Shifts of base parameters: those within what is known of them, and those beyond."""
    shifts = [s for s in battery.recalibration if abs(s.shift_in_prior_sd) >= 1.0][:6]
    lines = []
    for beyond, said in (
        (False, "recalibrated, no discovery"),
        (True, "further off than its sd allows, and no effect takes its place; check file and logs"),
    ):
        told = [
            f"{s.parameter} {s.shift_pct:+.1f} % ({s.shift_in_prior_sd:+.1f} sd)"
            for s in shifts
            if (abs(s.shift_in_prior_sd) > RECALIBRATION_SD) == beyond
        ]
        if told:
            lines.append(f"{said}: {', '.join(told)}")
    return lines


def unsure_line(effect: Finding) -> str:
    """A set of effects that the data cannot tell apart."""
    names = (effect.effect, *effect.indistinguishable_from)
    more = ""
    if math.isfinite(effect.separation_nats):
        d = effect.separation_nats
        more = (
            "; more of the same data will not help"
            if d < 0.05
            else (
                f"; expected lead {d:.1f} nats, about {5.0 / d:.1f} times these data would settle it" if d < 5.0 else ""
            )
        )
    return f"{' OR '.join(names)}, {100 * effect.energy_share:.1f} % of energy: these data cannot tell{more}"


def next_line(experiment: Experiment) -> str:
    """A proposed manoeuvre."""
    minutes = f"{experiment.minutes:.0f} min"
    long = "" if minutes in experiment.do or not experiment.minutes else f" ({minutes})"
    if not math.isfinite(experiment.separation_after):
        return experiment.do + long
    return (
        f"{experiment.do}{long}: to tell {' from '.join(experiment.separates)}, predicted "
        f"separation {experiment.separation_now:.1f} -> {experiment.separation_after:.0f} nats, resolves with "
        f"probability {experiment.expected_power:.2f}"
    )


def heldout_line(heldout: HeldOut, found: bool = True) -> str:
    """Errors on held-out runs; with `found`, those with the effects as well."""
    e, p = heldout.energy_error_pct, heldout.power_rmse_w
    kind = "other conditions" if heldout.shifted else "same kind"
    if not found:
        return (
            f"{heldout.how} ({kind}): energy error {e['nominal']:.2f} -> {e['recalibrated']:.2f} % (recalibrated); "
            f"power RMSE {p['nominal']:.3g} -> {p['recalibrated']:.3g} W"
        )
    return (
        f"{heldout.how} ({kind}): energy error {e['nominal']:.2f} -> {e['recalibrated']:.2f} (recalibrated) -> "
        f"{e['with_effects']:.2f} % (with the effects); power RMSE {p['nominal']:.3g} -> "
        f"{p['recalibrated']:.3g} -> {p['with_effects']:.3g} W"
    )


def _execution(effect: Finding) -> str:
    estimate = next(iter(effect.parameters.values()))
    scheme = f" in {effect.scheme}" if effect.scheme else ""
    told = TOLD[effect.effect]
    interval = f" (95 % {estimate.low:.3g} to {estimate.high:.3g})" if math.isfinite(estimate.low) else ""
    return f"{effect.effect}{scheme}: {estimate.value:.3g} {told}{interval}"


def _noise(battery: BatteryDiagnosis) -> str:
    n = battery.noise
    told = f"{watts(n['sd_w']).lstrip('+')} W ({100 * n['sd_w'] / battery.mean_power_w:.1f} % of the mean power)"
    if n["fast_share"] + n["slow_share"] > 0.5:
        told += f", lasting {n['fast_s']:.0f} to {n['slow_s']:.0f} s"
    if len(battery.runs) < 2:
        return told
    return (
        f"{told}; runs differ by ±{watts(n['offset_w']).lstrip('+')} W and ±{100 * n['gain']:.1f} % (meter), "
        f"±{100 * n['motion_gain']:.1f} % of the power (drive)"
    )


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
    rest = len(limits) - len(shown)
    text = ", ".join(shown) + (f" and {rest} more with higher limits" if rest > 0 else "")
    text = f"{text} of energy" if text else "no limit below half of the energy"
    return text + (f"; these data say nothing of {', '.join(blind)}" if blind else "")


def _smallest_limits(battery: BatteryDiagnosis) -> str:
    limits = sorted(
        c.smallest_detectable_share
        for c in battery.candidates
        if c.smallest_detectable_share is not None and c.smallest_detectable_share < BLIND_SHARE
    )
    if not limits:
        return ""
    return f" ({100 * limits[0]:.1f} to {100 * limits[-1]:.1f} % of energy, by effect)"


def _remains(battery: BatteryDiagnosis) -> str:
    if not battery.unexplained.shape:
        return "nothing beyond the noise"
    return battery.unexplained.shape


def _untestable(battery: BatteryDiagnosis) -> str:
    return "; ".join(f"{name} (needs {', '.join(needs)})" for name, needs in battery.untestable.items())


def _share(effect: Finding) -> str:
    return f"{100 * effect.energy_share:.1f} % of the energy"


def _unit(unit: str) -> str:
    return "" if unit in ("1", "") else f" {unit}"

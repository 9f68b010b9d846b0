"""The interactive pages of a diagnosis (verdict, shares, power over time, experiments) and of an improvement."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from missionsim.diagnose import sentences, words
from missionsim.diagnose.improve import Improved
from missionsim.diagnose.sentences import Asked
from missionsim.diagnose.waterfall import bars_of, energy_note, measured_note, power_of_floor, unseen_note
from missionsim.identify.findings import BatteryDiagnosis, Diagnosis, RunSeries
from missionsim.identify.proposed import plain, state, unit_of
from missionsim.numerals import counted, rounded, watts
from missionsim.report import page as web

TONES: dict[str, web.Tone] = {"effects_found": "warn", "nothing_missing": "good", "ambiguous": "warn"}
TONES["unexplained_structure"] = "bad"
TOTAL_POINTS = 60_000
MOST_RUNS = 30
MOST_ALIKE = 14


def diagnosis_page(diagnosis: Diagnosis, *, footer: str = "", asked: Asked | None = None) -> str:
    """The page as HTML. `footer`: how it was made (version, command)."""
    runs = max((len(b.runs) for b in diagnosis.batteries.values()), default=0)
    told, subtitle = f"{diagnosis.robot}: which effect is missing", f"{counted(runs, 'run')} fitted"
    return web.page(told, diagnosis_sections(diagnosis, asked), subtitle=subtitle, footer=footer)


def diagnosis_sections(diagnosis: Diagnosis, asked: Asked | None = None) -> list[web.Section]:
    """The sections of the page, for pages that show a diagnosis among other things."""
    sections = []
    several = len(diagnosis.batteries) > 1
    for battery in diagnosis.batteries.values():
        prefix = f"Battery {battery.battery}: " if several else ""
        parts = {
            "Result": _result(battery, asked, several),
            "A law that the library does not hold": _law(battery),
            "What was found and what was not": _candidates(battery),
            "Power over time": _series(battery, several),
            "What to drive next": _next(battery),
            "Details": _details(battery),
        }
        sections += [web.Section(prefix + title, blocks) for title, blocks in parts.items() if blocks]
    if diagnosis.skipped:
        told = [f"{name}: {why}" for name, why in diagnosis.skipped.items()]
        sections.append(web.Section("Batteries that were not diagnosed", [web.Bullets(told)]))
    return sections


def _result(battery: BatteryDiagnosis, asked: Asked | None, several: bool) -> list[web.Block]:
    cards = []
    command = "" if asked is None else sentences.next_step(battery, asked, several)
    if battery.effects:
        size, _, more = words.share_told(battery.effects[0]).partition(" of energy")
        cards.append(("How much", f"{size} of the energy", more.strip(" :()")))
    elif battery.proposed_laws:
        share, half = 100 * battery.proposed_laws[0].energy_share, 196 * battery.proposed_laws[0].share_sd
        cards.append(("How much", f"{share:.1f} % of the energy", f"95 %: {share - half:.1f} to {share + half:.1f} %"))
    if battery.heldout is not None:
        first, base, *_, last = bars_of(battery.heldout, battery.proposed_laws)
        energy = f"energy {first.energy_error_pct:.2f} → {last.energy_error_pct:.2f} %"
        told = f"{energy}; recalibrated only {base.energy_error_pct:.2f} %"
        told = f"with the law; {energy}" if last.name == "with_law" else told
        power = f"{rounded(first.power_rmse_w)} → {watts(last.power_rmse_w)}"
        cards.append(("Power error, runs not used", power, told))
    drives = f"{counted(len(battery.runs), 'run')}, {battery.seconds / 60:.0f} min"
    cards.append(("Mean power", f"{watts(battery.mean_power_w)}", drives))
    said = [told for told in (sentences.sure(battery), sentences.errors(battery)) if told]
    tone = "bad" if unseen_note(battery) else TONES[battery.verdict]
    blocks: list[web.Block] = [web.Verdict(words.headline(battery, several), tone), web.Tiles(cards)]
    blocks += [web.Paragraph(told) for told in said]
    if command:
        blocks.append(web.Command(command))
    elif battery.next_experiments:
        blocks.append(web.Paragraph(f"Drive next: {battery.next_experiments[0].do}."))
    lines = [[heading, text] for heading, text in words.report(battery) if heading != "NOTE"]
    table = web.Table(["", "what the data say"], lines)
    return [*blocks, web.Details("Everything the data say, with numbers", [table])]


def _law(battery: BatteryDiagnosis) -> list[web.Block]:
    """The curve of a proposed law with its band, its forms, what would tell them apart."""
    blocks: list[web.Block] = []
    for law in battery.proposed_laws:
        curve = law.curve
        if curve is not None:
            word, unit = plain(curve.variable), unit_of(curve.variable)
            fixed = ", ".join(state(n, v) for n, v in curve.at.items())
            hover = "%{x:.3g}: %{y:.3g} W<extra></extra>"
            traces = [
                *web.band(curve.x, curve.low, curve.high, "band of all forms, about 95 %"),
                web.line(curve.x, curve.watts, "the plainest form", web.MEASURED, 2, hovertemplate=hover),
            ]
            layout = {
                "xaxis": web.axis(f"{web.label(word)}{', ' if unit else ''}{web.label(unit)}"),
                "yaxis": web.axis("power that the model lacks, W"),
            }
            held = f", {fixed} held" if fixed else ""
            blocks.append(web.Chart(traces, layout, f"Power of the law over {word}{held}. Trust the band.", 360))
        rows = [[i, of.formula, of.k, of.low, of.high, of.unit, of.behind_nats] for i, of in enumerate(law.laws, 1)]
        columns = ["form", "formula", "k", "from", "to", "unit of k", "nats behind"]
        caption = "Forms that these data cannot tell apart; their numbers serve add-effect --formula"
        blocks.append(web.Table(columns, rows, caption, 3))
    return blocks


def _candidates(battery: BatteryDiagnosis) -> list[web.Block]:
    found = {effect.effect: effect for effect in battery.effects}
    known = [c for c in battery.candidates if c.effect in found or c.smallest_detectable_share is not None]
    rows = [c for c in known if c.effect in found or (c.smallest_detectable_share or 0.0) < words.BLIND_SHARE]
    rows.sort(key=lambda c: (c.effect not in found, c.smallest_detectable_share or 0.0))
    blocks: list[web.Block] = []
    if rows:
        names = [web.label(c.effect) for c in rows][::-1]
        limits = [_percent(c.smallest_detectable_share) for c in rows][::-1]
        effects = [found[c.effect] for c in rows if c.effect in found][::-1]
        hover = "%{y}: %{x:.2f} %<extra></extra>"
        traces = [web.bars(names, limits, web.PALE, name="smallest share that would be found", hovertemplate=hover)]
        if effects:
            up = [100 * (e.share_high - e.energy_share) if math.isfinite(e.share_high) else 0.0 for e in effects]
            down = [100 * (e.energy_share - e.share_low) if math.isfinite(e.share_low) else 0.0 for e in effects]
            points: web.Trace = {
                "type": "scatter",
                "mode": "markers",
                "x": [100 * e.energy_share for e in effects],
                "y": [web.label(e.effect) for e in effects],
                "name": "found, with 95 % interval",
                "marker": {"color": web.MEASURED, "size": 10},
                "error_x": {"type": "data", "symmetric": False, "array": up, "arrayminus": down, "color": web.MEASURED},
                "hovertemplate": "%{y}: %{x:.2f} % of the energy<extra></extra>",
            }
            traces.append(points)
        layout = {
            "xaxis": web.axis("share of the battery's energy, before anything comes back, %", rangemode="tozero"),
            "margin": {"l": 220, **web.MARGIN},
        }
        caption = (
            "Effects that were found, and how large the others could be without being seen (80 % power); those of "
            "which these data say nothing are left out."
        )
        blocks.append(web.Chart(traces, layout, caption, 90 + 24 * len(names)))
    columns = ["effect", "taken", "reason", "smallest detectable share, %"]
    told = [
        [c.effect, "yes" if c.accepted else "no", c.reason, _percent(c.smallest_detectable_share)]
        for c in battery.candidates
    ]
    blocks.append(web.Details("Every candidate and the reason", [web.Table(columns, told, digits=3)]))
    if battery.untestable:
        needs = web.Table(["without", "these cannot be tested"], words.untestable(battery))
        blocks.append(web.Details("Effects that these logs cannot test", [needs]))
    return blocks


def _series(battery: BatteryDiagnosis, several: bool) -> list[web.Block]:
    shown = battery.series[:MOST_RUNS]
    if not shown:
        return [web.Paragraph("No run to show.")]
    points = TOTAL_POINTS // (len(shown) * (2 if several else 1))
    more = len(battery.series) > len(shown)
    note = f"The first {len(shown)} of {len(battery.series)} runs." if more else ""
    return web.one_of("Run", [(run.run, [_run_chart(run, points)]) for run in shown], note)


def _run_chart(run: RunSeries, points: int) -> web.Chart:
    left = run.measured_w - run.fitted_w
    pick = web.shared_indices([run.measured_w, left], max(points // 4, 200))
    time_s = run.time_s[pick]
    lines = [
        ("measured", run.measured_w, web.MEASURED),
        ("model of the robot file", run.nominal_w, web.MODEL),
        ("with what was found", run.fitted_w, web.FITTED),
    ]
    traces = [web.line(time_s, values[pick], name, colour, 1.3) for name, values, colour in lines]
    before = web.line(time_s, (run.measured_w - run.nominal_w)[pick], "left: robot file", web.MODEL, 1, yaxis="y2")
    traces.append({**before, "visible": "legendonly"})
    traces.append(web.line(time_s, left[pick], "left: with what was found", web.RESIDUAL, 1, yaxis="y2"))
    caption = f"{run.run}: measured and modelled power, and what is left (measured minus model), clocks aligned."
    return web.over_time(traces, "left, W", caption, 520)


def _next(battery: BatteryDiagnosis) -> list[web.Block]:
    blocks: list[web.Block] = []
    if battery.next_experiments:
        rows = [
            [e.do, " / ".join(e.separates), e.separation_now, e.separation_after, e.expected_power, e.minutes]
            for e in battery.next_experiments
        ]
        columns = ["drive this", "to tell apart", "separation now, nats", "after, nats"]
        blocks.append(web.Table([*columns, "probability that it resolves", "minutes"], rows, digits=3))
    elif any(law.experiment for law in battery.proposed_laws):
        blocks += [web.Paragraph(f"{law.experiment[:1].upper()}{law.experiment[1:]}.") for law in battery.proposed_laws]
    else:
        varies = "No drive of ours varies what remains; log what may cause it."
        left = "Nothing is left that an experiment would have to separate."
        blocks.append(web.Paragraph(varies if battery.unexplained.shape else left))
    return blocks


def _details(battery: BatteryDiagnosis) -> list[web.Block]:
    heads = ["base parameter", "shift, %", "in prior standard deviations", "new value", "standard deviation", "unit"]
    shifts = [[s.parameter, s.shift_pct, s.shift_in_prior_sd, s.value, s.sd, s.unit] for s in battery.recalibration]
    caption = "Recalibration of the base model: shifts within 4 prior standard deviations are no discovery"
    blocks: list[web.Block] = [web.Table(heads, shifts, caption, 3)]
    if battery.confounding:
        blocks.append(_alike(battery))
    if battery.heldout is not None:
        models = {"nominal": "robot file", "recalibrated": "recalibrated", "with_effects": "with what was found"}
        models["with_law"] = "with the law as well"
        rows = [
            [held.how, models[bar.name], f"{bar.energy_error_pct:.2f}", rounded(bar.power_rmse_w)]
            for held, laws in ((battery.heldout, battery.proposed_laws), (battery.shifted, ()))
            if held is not None
            for bar in bars_of(held, laws)
        ]
        columns = ["held-out runs", "model", "energy error, %", "power error (RMS), W"]
        blocks.append(web.Table(columns, rows, "Errors on runs that were not used to fit", 3))
    if battery.remarks:
        blocks.append(web.Bullets(list(battery.remarks)))
    return blocks


def _alike(battery: BatteryDiagnosis) -> web.Chart:
    """Each effect found against the effects that look most like it."""
    found = list(battery.confounding)
    most: dict[str, float] = {}
    for row in battery.confounding.values():
        for name, r in row.items():
            most[name] = max(most.get(name, 0.0), abs(r))
    others = sorted(most, key=lambda name: -most[name])[:MOST_ALIKE]
    known = battery.confounding
    alike = [
        (x, y, 1.0 if a == b else known[a][b])
        for y, a in enumerate(found)
        for x, b in enumerate(others)
        if a == b or known[a].get(b) is not None
    ]
    x, y, r = np.array(alike).T
    within: dict[str, Any] = {"textposition": "inside", "insidetextanchor": "middle", "textangle": 0}
    within |= {"text": [f"{value:.2f}" for value in r], "hovertemplate": "%{hovertext}<extra></extra>"}
    within["hovertext"] = [f"{found[int(j)]} and {others[int(i)]}: r = {value:.2f}" for i, j, value in alike]
    heat = web.tiles(x, y, r, size=1.0, limit=1.0, colours=("#d55e00", "#f4f6f8", "#0072b2"), **within)

    def named(names: list[str]) -> web.Trace:
        return web.axis("", tickvals=list(range(len(names))), ticktext=list(map(web.label, names)), showgrid=False)

    layout = {"xaxis": named(others), "yaxis": named(found), "margin": {"l": 200, "r": 16, "t": 56, "b": 160}}
    caption = (
        "How alike the effects found and others look in these data once recalibration is allowed for: at 1 they look "
        "the same, at 0 they have nothing in common."
    )
    return web.Chart([heat], layout, caption, 240 + 30 * len(found))


def _percent(value: float | None) -> float | None:
    return 100.0 * value if value is not None and math.isfinite(value) else None


def improve_page(robot: str, done: Sequence[Improved], *, advice: Mapping[str, tuple[str, str]] | None = None) -> str:
    """The page as HTML. `done`: one a battery; `advice`: by battery what predicts better, and its command."""
    sections: list[web.Section] = []
    for one in done:
        prefix = f"Battery {one.battery}: " if len(done) > 1 else ""
        better = (advice or {}).get(one.battery, ("", ""))
        sections.append(web.Section(f"{prefix}Result", _improvement(one, *better)))
        for title, diagnosis in (("Before", one.first), ("After", one.last)):
            inner = diagnosis_sections(Diagnosis(robot, {one.battery: diagnosis}))
            sections += [web.Section(f"{prefix}{title}: {part.title}", part.blocks) for part in inner]
    return web.page(f"{robot}: model improved", sections, subtitle="compare, diagnose, add, compare again")


def _improvement(one: Improved, better: str, command: str) -> list[web.Block]:
    which = "held-out runs" if one.heldout else "the fitted runs; none were held out"
    first, last = one.steps[0], one.steps[-2]
    text = "".join(f"{told} " for told in (one.worse, better) if told)
    what = f"Added: {one.told}" if one.added or one.late is not None else "Nothing was added"
    text += (
        f"{what}. The power error on {which} went from "
        f"{rounded(first.power_rmse_w)} to {watts(last.power_rmse_w)}, the energy error from "
        f"{first.energy_error_pct:.2f} to {last.energy_error_pct:.2f} %."
    )
    told = [f"{one.stopped[:1].upper()}{one.stopped[1:]}", energy_note(one)]
    names = [web.label(step.name) for step in one.steps]
    floor = one.steps[-1]
    charts: list[web.Block] = []
    powers = [*(rounded(s.power_rmse_w) for s in one.steps[:-1]), power_of_floor(one.steps)]
    energies = [s.energy_error_pct for s in one.steps]
    for title, values, texts, level in (
        ("power error (RMS), W", [s.power_rmse_w for s in one.steps], powers, floor.power_rmse_w),
        ("energy error, mean over runs, %", energies, list(map(rounded, energies)), floor.energy_error_pct),
    ):
        fitted, added, later = web.COLOURS[1], web.COLOURS[4], web.COLOURS[2]
        colours = [fitted, *([added] * (len(values) > 2)), *([later] * (len(values) - 3)), "#aab2bd"]
        steps: web.Trace = {"type": "bar", "x": names, "y": values, "marker": {"color": colours}, "showlegend": False}
        steps |= {"text": texts, "textposition": "outside"}
        steps["hovertemplate"] = "%{x}: %{text}<extra></extra>"
        noise = web.line(names, [level] * len(names), "noise floor", hoverinfo="skip")
        noise["line"] = {"color": web.RESIDUAL, "dash": "dot"}
        layout = {"yaxis": web.axis(title, rangemode="tozero")}
        floors = "the noise floor is what a true model would still show"
        caption = f"The {title.split(',')[0]} on {which}, step by step; {floors}."
        charts.append(web.Chart([steps, noise], layout, caption, 360))
    better_w = bool(one.added) and last.power_rmse_w < first.power_rmse_w
    tone: web.Tone = "bad" if one.worse else "warn" if not one.complete else "good" if better_w else "neutral"
    rows = [[s.name, f"{s.energy_error_pct:.2f}", told] for s, told in zip(one.steps, powers, strict=True)]
    caption = f"Errors on {which}, step by step"
    table = web.Table(["model", "energy error, %", "power error (RMS), W"], rows, caption)
    cards = [("Added", str(len(one.added)), ", ".join(one.added))]
    cards.append(("Power error", f"{rounded(first.power_rmse_w)} → {watts(last.power_rmse_w)}", which))
    cards.append(("Noise floor", f"{power_of_floor(one.steps)} W", "noise, and runs whose meters and drives differ"))
    tiles = web.Tiles(cards)
    typed = [web.Command(command)] if command else []
    said = [web.Paragraph(line) for line in told if line]
    measured = web.Paragraph(measured_note(one), small=True)
    return [web.Verdict(text, tone), *typed, tiles, *said, *charts, table, measured]

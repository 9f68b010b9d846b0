"""The interactive page of a comparison: verdict, where it fails, power over time, progress, map, behaviour, runs."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from missionsim.compare import BatteryComparison, Comparison, Dependence, RunComparison
from missionsim.compare.behaviour import PARTS
from missionsim.compare.where import in_words
from missionsim.numerals import counted, in_wh, rounded, watts
from missionsim.report import page as web
from missionsim.report.page import label
from missionsim.report.terminal import signed

TOTAL_POINTS = 120_000
"""Points of all power charts together; more would make a page of many megabytes."""
MOST_RUNS = 40
TABLE_ROWS = 15
PART_TITLES = {"path_stretch": "longer or shorter way", "speed_tracking": "slower or faster", "dwell": "standing"}
PART_TITLES["other"] = "the rest (turns, ramps, switching)"


def compare_page(comparison: Comparison, *, tolerance_pct: float | None = None, footer: str = "") -> str:
    """The page as HTML.

    `tolerance_pct`: the tolerance asked for, for the verdict; `footer`: how it was made (version, command).
    """
    title = f"{comparison.robot or 'Model'}: model against measurements"
    subtitle = f"{counted(len(comparison.runs), 'run')}, {comparison.rows:,} rows"
    if comparison.mission:
        subtitle += f", mission {comparison.mission}"
    batteries = list(comparison.batteries.values())
    result = [block for one in batteries for block in _result(one, tolerance_pct)]
    if comparison.left_out:
        result += [web.Paragraph("Left out, and in none of these numbers:"), web.Bullets(comparison.left_out)]
    sections = [web.Section("Result", result)]
    parts: dict[str, Callable[[BatteryComparison], list[web.Block]]] = {
        "Where it fails": _where,
        "Power over time": lambda one: _power(one, len(batteries)),
        "Error over the progress of the run": _progress,
        "Where on the map": lambda one: [places(one)] if one.places else [],
        "Behaviour and power model": _behaviour,
        "Runs and components": _runs,
    }
    for heading, make in parts.items():
        if made := [(one.battery, blocks) for one in batteries if (blocks := make(one))]:
            sections.append(web.Section(heading, web.one_of("Battery", made)))
    assumed = web.Bullets(comparison.notes) if comparison.notes else web.Paragraph("Nothing had to be assumed.")
    notes: list[web.Block] = [assumed]
    if files := [[run, source] for run, source in comparison.logs if source]:
        notes.append(web.Details("Files", [web.Table(["run", "file"], files)]))
    sections.append(web.Section("What was assumed", notes))
    return web.page(title, sections, subtitle=subtitle, footer=footer)


def _result(one: BatteryComparison, tolerance_pct: float | None) -> list[web.Block]:
    error = one.energy_error_pct
    said = in_words(one.dependences)
    text = "\n".join([*one.words[: -len(said)], said[0]])
    verdict = web.Verdict(text)
    if tolerance_pct is not None:
        inside = abs(error) <= tolerance_pct
        side = "within" if inside else "outside"
        text = f"The energy error is {side} the tolerance of ± {tolerance_pct:g} %.\n{text}"
        verdict = web.Verdict(text, "good" if inside else "bad")
    gap = one.gap_wh
    tiles = [
        ("Energy measured", f"{in_wh(one.energy_measured_wh)} Wh", f"battery {one.battery}"),
        ("Energy of the model", f"{in_wh(one.energy_model_wh)} Wh", "driven by the logs"),
        ("Energy error", f"{signed(error, 2)} %", "model minus measured, all runs as one"),
        ("Energy error by run", f"{one.run_energy_error_pct:.2f} %", "mean over runs of its magnitude"),
        ("Power error", watts(one.power_rmse_w), "root mean square"),
        ("Bias", f"{signed(one.shown_bias_w)} W", "mean of model minus measured"),
    ]
    if gap["behaviour"] is not None:
        tiles.append(("Behaviour's part", f"{signed(gap['behaviour'], 4)} Wh", "replayed minus simulated"))
    return [verdict, web.Tiles(tiles)]


def _where(one: BatteryComparison) -> list[web.Block]:
    blocks: list[web.Block] = [web.Bullets(in_words(one.dependences))]
    shown = [dependence for dependence in one.dependences if dependence.explained > 0.0][:12][::-1]
    if shown:
        parts = [100.0 * d.explained for d in shown]
        hover = "%{y}: %{x:.1f} %<extra></extra>"
        part, margin = web.axis("part of the error's variance, %", rangemode="tozero"), {"l": 180, **web.MARGIN}
        bars = web.bars([label(d.title) for d in shown], parts, web.MEASURED, hovertemplate=hover)
        caption = "What the power error varies with, each quantity taken alone. Quantities that vary together share "
        caption += "the same part, so this shows where to look, not the cause."
        blocks.append(web.Chart([bars], {"xaxis": part, "margin": margin}, caption, 60 + 30 * max(3, len(shown))))
    rows: list[list[object]] = []
    for w in [w for w in one.where[:TABLE_ROWS] if w.explains > 0.0]:
        row = [w.title, f"{w.value} {w.unit}".strip(), w.explains, signed(w.bias_w), w.seconds]
        rows.append([*row, w.share_of_squared_error, signed(w.gap_wh, 3)])
    if rows:
        columns = ["quantity", "value", "explains", "bias, W", "time, s", "share of squared error", "energy gap, Wh"]
        caption = "Values that explain most of the error (bias: model minus measured; energy gap: measured minus model)"
        blocks.append(web.Table(columns, rows, caption, 3, 2))
    charts = [(d.title, [residual(d)]) for d in sorted(one.dependences, key=lambda d: -d.explained) if d.by != "place"]
    if charts:
        blocks.append(web.Choice("Error against", charts))
    return blocks


def residual(found: Dependence) -> web.Chart:
    """Power error against a covariate."""
    bins = found.fine
    numeric = bins[0].low is not None
    x: web.Values = [label(b.value) if b.low is None or b.high is None else 0.5 * (b.low + b.high) for b in bins]
    seconds = sum(b.seconds for b in bins)
    time: web.Trace = {
        "type": "bar",
        "x": x,
        "y": [100.0 * b.seconds / seconds for b in bins],
        "yaxis": "y2",
        "name": "share of time",
        "marker": {"color": web.PALE},
        "hovertemplate": "%{y:.1f} % of the time<extra></extra>",
    }
    told = (f"{watts(b.bias_w, sign=True)} ± {watts(b.spread_w)}, {b.seconds:.0f} s" for b in bins)
    mode, size = ("lines+markers", 7) if numeric else ("markers", 11)
    more: dict[str, Any] = {"mode": mode, "marker": {"size": size, "color": web.MODEL}}
    more["text"] = [f"{label(b.value)} {found.unit}: {line}" for b, line in zip(bins, told, strict=True)]
    more["hovertemplate"], spread = "%{text}<extra></extra>", [b.spread_w for b in bins]
    more["error_y"] = {"type": "data", "array": spread, "color": "#aab2bd", "thickness": 1, "width": 3}
    error = web.line(x, [b.bias_w for b in bins], "mean error (model minus measured)", web.MODEL, 2, **more)
    title = label(found.title) + (f", {found.unit}" if found.unit else "")
    layout = {
        "xaxis": web.axis(title, **({} if numeric else {"type": "category"})),
        "yaxis": web.axis("power error, W", overlaying="y2", tickmode="auto", zeroline=True, zerolinewidth=2),
        "yaxis2": web.axis("share of time, %", side="right", showgrid=False, tickmode="auto", rangemode="tozero"),
        "margin": {**web.MARGIN, "l": 64, "r": 64},
    }
    caption = f"Power error against {found.title}: mean and standard deviation within each range; bars: share of time."
    return web.Chart([time, error], layout, caption)


def _power(one: BatteryComparison, batteries: int) -> list[web.Block]:
    worst = sorted(one.runs, key=lambda run: -run.power_rmse_w)[:MOST_RUNS]
    shown = [run for run in one.runs if run in worst]
    points = max(200, TOTAL_POINTS // (6 * batteries * len(shown)))
    more = len(shown) < len(one.runs)
    note = f"The {MOST_RUNS} runs with the largest power error of {len(one.runs)}." if more else ""
    return web.one_of("Run", [(run.run, [power(run, points)]) for run in shown], note)


def power(run: RunComparison, points: int) -> web.Chart:
    """Measured and modelled power over time, the error under it, in so many points."""
    series = run.series
    measured, model = series.power_w("measured"), series.power_w("model")
    kept = web.shared_indices([measured, model, model - measured], points)
    time_s = series.middle_s[kept]
    traces: list[web.Trace] = []
    if series.rows > 1:
        low, high = (series.columns[f"measured_{end}_w"][kept] for end in ("low", "high"))
        traces += web.band(time_s, low, high, "range of the measured power", 0.15)
    for name, values, colour, on in (
        ("measured", measured, web.MEASURED, "y"),
        ("model", model, web.MODEL, "y"),
        ("model minus measured", model - measured, web.RESIDUAL, "y2"),
    ):
        traces.append(web.line(time_s, values[kept], name, colour, xaxis="x", yaxis=on, hovertemplate="%{y:.4g} W"))
    joined = f" Each point is the mean of {series.rows} rows." if series.rows > 1 else ""
    caption = f"{run.run}, battery {run.battery}: measured and modelled power, the error under it.{joined}"
    return web.over_time(traces, "error, W", caption)


def _progress(one: BatteryComparison) -> list[web.Block]:
    told = [("all runs", "measured", one.error_statistics), ("all runs", "model", one.error_statistics_predicted)]
    if (plan := one.mission) is not None:
        told.append(("simulated plan", "measured", plan.error_statistics))
        told.append(("simulated plan", "plan", plan.error_statistics_predicted))
    rows = [[of, to, found.peak_pct, found.final_pct, found.mean_pct, found.std_pct] for of, to, found in told]
    columns = ["of", "relative to", "peak, %", "final, %", "mean, %", "standard deviation, %"]
    return [progress(one), web.Table(columns, rows, "Statistics of the magnitude of the error over progress", 3)]


def progress(one: BatteryComparison) -> web.Chart:
    """Error of the energy so far over the progress of the runs."""
    hover = "%{y:+.2f} %"
    traces = [web.line(100.0 * one.progress, one.error_curve_pct, "all runs", "#1f2933", 2.5, hovertemplate=hover)]
    for run in one.runs[:MOST_RUNS] if len(one.runs) > 1 else ():
        curve = web.line(100.0 * run.progress, run.error_curve_pct, label(run.run), width=1, hovertemplate=hover)
        traces.append({**curve, "opacity": 0.7})
    layout = {
        "xaxis": web.axis("progress, % of the run's time"),
        "yaxis": web.axis("error of the energy so far, %", zeroline=True, zerolinewidth=2),
        "hovermode": "x unified",
    }
    caption = "Error of the energy spent so far, model minus measured, relative to measured."
    return web.Chart(traces, layout, caption, 400)


DIVERGING = ("#0b4f8a", "#7fb2d9", "#f7f7f7", "#f2a477", "#a63603")
"""Blue where the model is too low, orange where it is too high; told apart with any colour vision."""


def places(one: BatteryComparison) -> web.Chart:
    """Mean power error by place."""
    cells, width = one.places, one.places[0].width_m
    x, y, errors = np.array([(c.x_m, c.y_m, -c.gap_j / c.seconds) for c in cells]).T
    heat = web.tiles(
        *(x, y, errors),
        size=width,
        limit=float(np.quantile(np.abs(errors), 0.98)) or 1.0,
        colours=DIVERGING,
        bar=web.axis("error, W"),
        hovertext=[f"{c.value}: {watts(w)}, {c.seconds:.0f} s" for c, w in zip(cells, errors.tolist(), strict=True)],
        hovertemplate="%{hovertext}<extra></extra>",
    )
    layout = {
        "xaxis": web.axis("x, m", constrain="domain"),
        "yaxis": web.axis("y, m", scaleanchor="x", constrain="domain"),
    }
    caption = (
        "Mean power error by place: orange where the model is too high, blue where it is too low; colours end at the "
        "98th percentile."
    )
    height = 900.0 * (np.ptp(y) + width) / (np.ptp(x) + width)
    return web.Chart([heat], layout, caption, int(np.clip(height, 320, 760)))


def _behaviour(one: BatteryComparison) -> list[web.Block]:
    if (mission := one.mission) is None:
        return []
    gap = one.gap_wh
    steps = [gap["power_model"] or 0.0, *(mission.part_wh(part) for part in PARTS)]
    waterfall: web.Trace = {
        "type": "bar",
        "x": ["power model", *(PART_TITLES[part] for part in PARTS), "measured minus simulated"],
        "y": [*steps, gap["total"]],
        "base": [*np.cumsum([0.0, *steps[:-1]]), 0.0],
        "marker": {"color": [*(web.MODEL if step > 0.0 else web.MEASURED for step in steps), web.RESIDUAL]},
        "hovertemplate": "%{x}: %{customdata:+.4g} Wh<extra></extra>",
        "customdata": [*steps, gap["total"]],
    }
    layout = {"yaxis": web.axis("energy, Wh", zeroline=True)}
    caption = (
        "The gap between measured and simulated energy: what the power model misses and what the robot did otherwise."
    )
    columns = [
        *("scheme", "path stretch", "speed tracking", "dwell, s", "planned, m", "driven, m"),
        *("way, Wh", "speed, Wh", "standing, Wh", "rest, Wh"),
    ]
    rows = [
        [
            *(s.scheme or "–", s.path_stretch, s.speed_tracking, s.dwell_s, s.planned_m, s.driven_m),
            *(signed(s.wh[part], 4) for part in PARTS),
        ]
        for s in mission.schemes
    ]
    table = web.Table(columns, rows, "Plan and run by control scheme, all runs", 3)
    return [web.Bullets(mission.words), web.Chart([waterfall], layout, caption), table]


def _runs(one: BatteryComparison) -> list[web.Block]:
    rows = []
    for run in one.worst_first:
        row = [run.run, run.seconds, in_wh(run.energy_measured_wh), in_wh(run.energy_model_wh)]
        rows.append([*row, signed(run.energy_error_pct, 2), rounded(run.power_rmse_w), signed(run.shown_bias_w)])
    total = sum(one.by_component_wh.values()) or 1.0
    parts = [[name, energy, max(0.0, energy / total)] for name, energy in one.by_component_wh.items()]
    terms = [[name, energy] for name, energy in one.by_term_wh.items()]
    columns = ["run", "time, s", "measured, Wh", "model, Wh", "error, %", "RMSE, W", "bias, W"]
    return [
        web.Table(columns, rows, "Runs, the worst first", 4),
        web.Table(["component", "energy, Wh", "share"], parts, "Energy of the model by component", 4, 2),
        web.Details("Energy of the model by physical term", [web.Table(["term", "energy, Wh"], terms)]),
    ]

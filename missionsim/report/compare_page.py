"""The interactive page of a comparison: verdict, where it fails, power over time, progress, map, behaviour, runs."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from missionsim.compare import BatteryComparison, Comparison, Dependence, RunComparison
from missionsim.compare.behaviour import PARTS
from missionsim.compare.where import in_words
from missionsim.report.blocks import Block, Bullets, Chart, Choice, Details, Paragraph, Section, Table, Tiles, Verdict
from missionsim.report.downsample import shared_indices
from missionsim.report.page import COLOURS, format_cell, label, page

TOTAL_POINTS = 120_000
"""Points of all power charts together; more would make a page of many megabytes."""
MOST_RUNS = 40
TABLE_ROWS = 15
MEASURED, MODEL, RESIDUAL = COLOURS[0], COLOURS[1], "#52606d"
DIVERGING = [[0.0, "#0b4f8a"], [0.25, "#7fb2d9"], [0.5, "#f7f7f7"], [0.75, "#f2a477"], [1.0, "#a63603"]]
"""Blue where the model is too low, orange where it is too high; told apart with any colour vision."""
PART_TITLES = {
    "path_stretch": "longer or shorter way",
    "speed_tracking": "slower or faster",
    "dwell": "standing",
    "other": "the rest (turns, ramps, switching)",
}


def compare_page(comparison: Comparison, *, tolerance_pct: float | None = None, footer: str = "") -> str:
    """The page as HTML.

    Parameters
    ----------
    comparison : Comparison
    tolerance_pct : float, optional
        The tolerance asked for, for the verdict.
    footer : str
        How it was made (version, command).
    """
    title = f"{comparison.robot or 'Model'}: model against measurements"
    count = len(comparison.runs)
    subtitle = f"{count} {'runs' if count != 1 else 'run'}, {comparison.rows:,} rows"
    if comparison.mission:
        subtitle += f", mission {comparison.mission}"
    return page(title, compare_sections(comparison, tolerance_pct=tolerance_pct), subtitle=subtitle, footer=footer)


def compare_sections(comparison: Comparison, *, tolerance_pct: float | None = None) -> list[Section]:
    """The sections of the page, for pages that show a comparison among other things."""
    batteries = list(comparison.batteries.values())
    sections = [
        Section("Result", [block for one in batteries for block in _result(one, tolerance_pct)]),
        Section("Where it fails", _by_battery(batteries, _where)),
        Section("Power over time", _by_battery(batteries, lambda one: _power(one, len(batteries)))),
        Section("Error over the progress of the run", _by_battery(batteries, _progress)),
    ]
    mapped = [one for one in batteries if one.places]
    if mapped:
        sections.append(Section("Where on the map", _by_battery(mapped, _map)))
    planned = [one for one in batteries if one.mission is not None]
    if planned:
        sections.append(Section("Behaviour and power model", _by_battery(planned, _behaviour)))
    sections.append(Section("Runs and components", _by_battery(batteries, _runs)))
    sections.append(Section("What was assumed", _notes(comparison)))
    return sections


def _by_battery(batteries: Sequence[BatteryComparison], draw: Any) -> list[Block]:
    if len(batteries) == 1:
        return list(draw(batteries[0]))
    return [Choice("Battery", [(one.battery, draw(one)) for one in batteries])]


def _result(one: BatteryComparison, tolerance_pct: float | None) -> list[Block]:
    error = one.energy_error_pct
    tone: Any = "neutral"
    said = in_words(one.dependences)
    text = "\n".join([*one.words[: -len(said)], said[0]])
    if tolerance_pct is not None:
        inside = abs(error) <= tolerance_pct
        tone = "good" if inside else "bad"
        side = "within" if inside else "outside"
        text = f"The energy error is {side} the tolerance of ± {tolerance_pct:g} %.\n{text}"
    gap = one.gap_wh
    tiles = [
        ("Energy measured", f"{format_cell(one.energy_measured_wh)} Wh", f"battery {one.battery}"),
        ("Energy of the model", f"{format_cell(one.energy_model_wh)} Wh", "driven by the logs"),
        ("Energy error", f"{_signed(error)} %", "model minus measured"),
        ("Power error", f"{format_cell(one.power_rmse_w, 3)} W", "root mean square"),
        ("Bias", f"{_signed(one.power_bias_w, 3)} W", "mean of model minus measured"),
    ]
    if gap["behaviour"] is not None:
        tiles.append(("Behaviour's part", f"{_signed(gap['behaviour'], 3)} Wh", "replayed minus simulated"))
    return [Verdict(text, tone), Tiles(tiles)]


def _where(one: BatteryComparison) -> list[Block]:
    found = [dependence for dependence in one.dependences if dependence.explained > 0.0]
    blocks: list[Block] = [Bullets(in_words(one.dependences))]
    if found:
        shown = found[:12][::-1]
        blocks.append(
            Chart(
                [
                    {
                        "type": "bar",
                        "orientation": "h",
                        "x": [100.0 * d.explained for d in shown],
                        "y": [label(d.title) for d in shown],
                        "marker": {"color": MEASURED},
                        "hovertemplate": "%{y}: %{x:.1f} %<extra></extra>",
                    }
                ],
                {
                    "xaxis": {
                        "title": {"text": "part of the error's variance that goes with it, %"},
                        "rangemode": "tozero",
                    },
                    "hovermode": "closest",
                    "margin": {"l": 180, "r": 16, "t": 30, "b": 48},
                },
                "What the power error varies with, each quantity taken alone. Quantities that vary together share the "
                "same part, so this shows where to look, not the cause.",
                60 + 30 * max(3, len(shown)),
            )
        )
    rows = [
        [
            w.title,
            f"{w.value} {w.unit}".strip(),
            w.explains,
            _signed(w.bias_w, 3),
            w.seconds,
            w.share_of_squared_error,
            _signed(w.gap_wh, 3),
        ]
        for w in one.where[:TABLE_ROWS]
        if w.explains > 0.0
    ]
    if rows:
        blocks.append(
            Table(
                ["quantity", "value", "explains", "bias, W", "time, s", "share of squared error", "energy gap, Wh"],
                rows,
                "Values that explain most of the error (bias: model minus measured; energy gap: measured minus model)",
                3,
                2,
            )
        )
    charts = [(d.title, [_residual(d)]) for d in sorted(one.dependences, key=lambda d: -d.explained) if d.by != "place"]
    if charts:
        blocks.append(Choice("Error against", charts))
    return blocks


def _residual(found: Dependence) -> Chart:
    bins = found.fine
    numeric = bins[0].low is not None
    x: list[Any] = [label(b.value) if b.low is None or b.high is None else 0.5 * (b.low + b.high) for b in bins]
    bias, spread = [b.bias_w for b in bins], [b.spread_w for b in bins]
    seconds = sum(b.seconds for b in bins)
    hover = [f"{label(b.value)} {found.unit}: {b.bias_w:+.3g} W ± {b.spread_w:.3g} W, {b.seconds:.0f} s" for b in bins]
    if numeric:
        points: dict[str, Any] = {"mode": "lines+markers", "line": {"color": MODEL}, "marker": {"size": 7}}
    else:
        points = {"mode": "markers", "marker": {"size": 11, "color": MODEL}}
    traces = [
        {
            "type": "bar",
            "x": x,
            "y": [100.0 * b.seconds / seconds for b in bins],
            "yaxis": "y2",
            "name": "share of time",
            "marker": {"color": "#d9dee4"},
            "hovertemplate": "%{y:.1f} % of the time<extra></extra>",
        },
        {
            "type": "scatter",
            "x": x,
            "y": bias,
            "name": "mean error (model minus measured)",
            "text": hover,
            "hovertemplate": "%{text}<extra></extra>",
            "error_y": {"type": "data", "array": spread, "color": "#aab2bd", "thickness": 1, "width": 3},
            **points,
        },
    ]
    unit = f", {found.unit}" if found.unit else ""
    return Chart(
        traces,
        {
            "xaxis": {"title": {"text": label(found.title) + unit}, **({} if numeric else {"type": "category"})},
            "yaxis": {
                "title": {"text": "power error, W"},
                "overlaying": "y2",
                "tickmode": "auto",
                "zeroline": True,
                "zerolinewidth": 2,
            },
            "yaxis2": {
                "title": {"text": "share of time, %"},
                "side": "right",
                "showgrid": False,
                "tickmode": "auto",
                "rangemode": "tozero",
            },
            "margin": {"l": 64, "r": 64, "t": 30, "b": 48},
            "hovermode": "closest",
        },
        f"Power error against {found.title}: mean and standard deviation within each range; bars: share of the time.",
    )


def _power(one: BatteryComparison, batteries: int) -> list[Block]:
    worst = sorted(one.runs, key=lambda run: -run.power_rmse_w)[:MOST_RUNS]
    shown = [run for run in one.runs if run in worst]
    points = max(200, TOTAL_POINTS // (6 * batteries * len(shown)))
    blocks: list[Block] = []
    if len(shown) < len(one.runs):
        blocks.append(Paragraph(f"The {MOST_RUNS} runs with the largest power error of {len(one.runs)}.", small=True))
    if len(shown) == 1:
        return [*blocks, _power_chart(shown[0], points)]
    return [*blocks, Choice("Run", [(run.run, [_power_chart(run, points)]) for run in shown])]


def _power_chart(run: RunComparison, points: int) -> Chart:
    series = run.series
    measured, model = series.power_w("measured"), series.power_w("model")
    columns = series.columns
    kept = shared_indices([measured, model, model - measured], points)
    time_s = series.middle_s[kept]
    traces: list[dict[str, Any]] = []
    if series.rows > 1:
        low, high = columns["measured_low_w"][kept], columns["measured_high_w"][kept]
        traces.append(
            {
                "x": np.concatenate([time_s, time_s[::-1]]),
                "y": np.concatenate([high, low[::-1]]),
                "type": "scatter",
                "mode": "lines",
                "fill": "toself",
                "fillcolor": "rgba(0,114,178,0.15)",
                "line": {"width": 0},
                "name": "range of the measured power",
                "hoverinfo": "skip",
            }
        )
    for name, values, colour, axis in (
        ("measured", measured, MEASURED, "y"),
        ("model", model, MODEL, "y"),
        ("model minus measured", model - measured, RESIDUAL, "y2"),
    ):
        traces.append(
            {
                "type": "scatter",
                "mode": "lines",
                "x": time_s,
                "y": values[kept],
                "name": name,
                "xaxis": "x",
                "yaxis": axis,
                "line": {"color": colour, "width": 1.4},
                "hovertemplate": "%{y:.4g} W",
            }
        )
    joined = f" Each point is the mean of {series.rows} rows." if series.rows > 1 else ""
    return Chart(
        traces,
        {
            "xaxis": {"title": {"text": "time since the start, s"}, "anchor": "y2"},
            "yaxis": {"title": {"text": "power, W"}, "domain": [0.36, 1.0]},
            "yaxis2": {"title": {"text": "error, W"}, "domain": [0.0, 0.28], "zeroline": True, "zerolinewidth": 2},
        },
        f"Run {run.run}, battery {run.battery}: measured and modelled power, the error under it.{joined}",
        480,
    )


def _progress(one: BatteryComparison) -> list[Block]:
    stats = one.error_statistics
    rows = [["all runs", "measured", stats.peak_pct, stats.final_pct, stats.mean_pct, stats.std_pct]]
    predicted = one.error_statistics_predicted
    rows.append(["all runs", "model", predicted.peak_pct, predicted.final_pct, predicted.mean_pct, predicted.std_pct])
    if one.mission is not None:
        plan = one.mission
        for name, found in (("measured", plan.error_statistics), ("plan", plan.error_statistics_predicted)):
            rows.append(["simulated plan", name, found.peak_pct, found.final_pct, found.mean_pct, found.std_pct])
    traces: list[dict[str, Any]] = [
        {
            "type": "scatter",
            "mode": "lines",
            "x": 100.0 * one.progress,
            "y": one.error_curve_pct,
            "name": "all runs",
            "line": {"color": "#1f2933", "width": 2.5},
            "hovertemplate": "%{y:+.2f} %",
        }
    ]
    if len(one.runs) > 1:
        traces += [
            {
                "type": "scatter",
                "mode": "lines",
                "x": 100.0 * run.progress,
                "y": run.error_curve_pct,
                "name": label(run.run),
                "line": {"width": 1},
                "opacity": 0.7,
                "hovertemplate": "%{y:+.2f} %",
            }
            for run in one.runs[:MOST_RUNS]
        ]
    return [
        Chart(
            traces,
            {
                "xaxis": {"title": {"text": "progress, % of the run's time"}},
                "yaxis": {"title": {"text": "error of the energy so far, %"}, "zeroline": True, "zerolinewidth": 2},
            },
            "Error of the energy spent so far, model minus measured, relative to measured.",
            400,
        ),
        Table(
            ["of", "relative to", "peak, %", "final, %", "mean, %", "standard deviation, %"],
            rows,
            "Statistics of the magnitude of the error over progress",
            3,
        ),
    ]


def _map(one: BatteryComparison) -> list[Block]:
    cells = one.places
    width = cells[0].width_m
    xs, ys = sorted({c.x_m for c in cells}), sorted({c.y_m for c in cells})
    x = np.arange(xs[0], xs[-1] + 0.5 * width, width)
    y = np.arange(ys[0], ys[-1] + 0.5 * width, width)
    error = np.full((len(y), len(x)), np.nan)
    seconds = np.full((len(y), len(x)), np.nan)
    for cell in cells:
        i, j = round((cell.y_m - y[0]) / width), round((cell.x_m - x[0]) / width)
        error[i, j], seconds[i, j] = -cell.gap_j / cell.seconds, cell.seconds
    limit = float(np.nanquantile(np.abs(error), 0.98)) or 1.0
    ratio = (ys[-1] - ys[0] + width) / (xs[-1] - xs[0] + width)
    return [
        Chart(
            [
                {
                    "type": "heatmap",
                    "x": x,
                    "y": y,
                    "z": error,
                    "customdata": seconds,
                    "colorscale": DIVERGING,
                    "zmin": -limit,
                    "zmax": limit,
                    "hoverongaps": False,
                    "colorbar": {"title": {"text": "error, W"}},
                    "hovertemplate": "x %{x:.2f} m, y %{y:.2f} m: %{z:.3g} W, %{customdata:.0f} s<extra></extra>",
                }
            ],
            {
                "xaxis": {"title": {"text": "x, m"}, "constrain": "domain"},
                "yaxis": {"title": {"text": "y, m"}, "scaleanchor": "x", "constrain": "domain"},
                "hovermode": "closest",
            },
            "Mean power error by place: orange where the model is too high, blue where it is too low; colours end at "
            "the 98th percentile.",
            int(np.clip(900 * ratio, 320, 760)),
        )
    ]


def _behaviour(one: BatteryComparison) -> list[Block]:
    mission = one.mission
    assert mission is not None
    gap = one.gap_wh
    x = ["power model", *(PART_TITLES[part] for part in PARTS), "measured minus simulated"]
    y = [gap["power_model"], *(mission.part_wh(part) for part in PARTS), gap["total"]]
    waterfall = Chart(
        [
            {
                "type": "waterfall",
                "x": x,
                "y": y,
                "measure": ["relative"] * (1 + len(PARTS)) + ["total"],
                "increasing": {"marker": {"color": MODEL}},
                "decreasing": {"marker": {"color": MEASURED}},
                "totals": {"marker": {"color": RESIDUAL}},
                "hovertemplate": "%{x}: %{delta:+.4g} Wh<extra></extra>",
            }
        ],
        {"yaxis": {"title": {"text": "energy, Wh"}, "zeroline": True}, "hovermode": "closest"},
        "The gap between measured and simulated energy: what the power model misses and what the robot did otherwise.",
    )
    rows = [
        [
            s.scheme or "–",
            s.path_stretch,
            s.speed_tracking,
            s.dwell_s,
            s.planned_m,
            s.driven_m,
            *(_signed(s.wh[one.battery][part], 3) for part in PARTS),
        ]
        for s in mission.schemes
    ]
    columns = [
        "scheme",
        "path stretch",
        "speed tracking",
        "dwell, s",
        "planned, m",
        "driven, m",
        "way, Wh",
        "speed, Wh",
        "standing, Wh",
        "rest, Wh",
    ]
    return [Bullets(mission.words), waterfall, Table(columns, rows, "Plan and run by control scheme, all runs", 3)]


def _runs(one: BatteryComparison) -> list[Block]:
    rows = [
        [
            run.run,
            run.seconds,
            run.energy_measured_wh,
            run.energy_model_wh,
            _signed(run.energy_error_pct, 3),
            run.power_rmse_w,
            _signed(run.power_bias_w, 3),
        ]
        for run in one.runs
    ]
    total = sum(one.by_component_wh.values()) or 1.0
    parts = [[name, energy, max(0.0, energy / total)] for name, energy in one.by_component_wh.items()]
    terms = [[name, energy] for name, energy in one.by_term_wh.items()]
    return [
        Table(["run", "time, s", "measured, Wh", "model, Wh", "error, %", "RMSE, W", "bias, W"], rows, "Runs", 4),
        Table(["component", "energy, Wh", "share"], parts, "Energy of the model by component", 4, 2),
        Details("Energy of the model by physical term", [Table(["term", "energy, Wh"], terms)]),
    ]


def _notes(comparison: Comparison) -> list[Block]:
    notes: Block = Bullets(comparison.notes) if comparison.notes else Paragraph("Nothing had to be assumed.")
    files = [[run, source] for run, source in comparison.logs if source]
    logs: list[Block] = [Details("Files", [Table(["run", "file"], files)])] if files else []
    return [notes, *logs]


def _signed(value: float | None, digits: int = 3) -> str:
    if value is None or not np.isfinite(value):
        return "–"
    rounded = round(float(value), 4) + 0.0
    text = format_cell(rounded, digits)
    return text if rounded <= 0.0 else f"+{text}"

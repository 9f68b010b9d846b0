"""A comparison as tables (on the terminal, at most 100 columns wide, and as CSV files) and as pictures (PNG files)."""

from __future__ import annotations

import html
import math
import re
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.compare import BatteryComparison, Comparison
from missionsim.compare.behaviour import OF_SCHEME, PARTS
from missionsim.numerals import counted, in_wh, rounded
from missionsim.report.compare_page import places, power, progress, residual
from missionsim.report.page import MEASURED, Chart, literal, new_figure, save_figure
from missionsim.report.terminal import signed, simple_table
from missionsim.results.write import write_table
from missionsim.runs.error import Errors, RunError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from rich.console import Console


WHERE_ROWS = 10
RUN_ROWS = 12


def print_comparison(comparison: Comparison, console: Console) -> None:
    """Print the verdict, the numbers by battery and run, where it fails, and what was assumed."""
    title = f"{comparison.robot or 'model'}: model against measurements, {counted(len(comparison.runs), 'run')}"
    columns = ["battery", ">measured Wh", ">model Wh", ">error %", ">by run %", ">RMSE W", ">bias W"]
    rows: list[list[str]] = []
    for one in comparison.batteries.values():
        found = one.error_statistics
        row = [one.battery, in_wh(one.energy_measured_wh), in_wh(one.energy_model_wh)]
        row += [signed(one.energy_error_pct, 2), _plain(one.run_energy_error_pct), rounded(one.power_rmse_w)]
        over = map(_plain, (found.peak_pct, found.mean_pct))
        rows.append([*row, rounded(one.shown_bias_w, sign=True), *over])
    console.print(simple_table(title, [*columns, ">peak %", ">mean %"], rows))
    notes = [
        "error: model minus measured, of all runs as one; by run: mean over runs of its magnitude, as diagnose and "
        "improve print it; peak, mean: its magnitude over the progress of the runs"
    ]
    untold = [name for name, one in comparison.batteries.items() if not math.isfinite(one.error_statistics.final_pct)]
    if untold:
        notes.append(f"no relative error over progress for {', '.join(untold)}: the energy measured is not above zero")
    for note in notes:
        console.print(note, style="dim")
    for one in comparison.batteries.values():
        _print_battery(one, console)
    if comparison.notes:
        console.print("\nAssumed and remarked", style="bold")
        for note in comparison.notes:
            console.print(f"- {note}")


def _print_battery(one: BatteryComparison, console: Console) -> None:
    console.print()
    for sentence in one.words:
        console.print(sentence)
    rows = []
    for where in [where for where in one.where if where.explains > 0.0][:WHERE_ROWS]:
        row = [where.title, f"{where.value} {where.unit}".strip(), f"{100.0 * where.explains:.1f}"]
        row += [rounded(where.bias_w, sign=True), f"{where.seconds:.0f}", f"{100.0 * where.share_of_squared_error:.0f}"]
        rows.append([*row, in_wh(where.gap_wh, sign=True)])
    if rows:
        columns = ["quantity", "value", ">explains %", ">bias W", ">time s", ">sq. error %", ">gap Wh"]
        console.print(simple_table(f"Where it fails, battery {one.battery}", columns, rows))
        note = "explains: part of the error's variance that goes with the value; what varies together shares it"
        console.print(note, style="dim")
    if one.mission is not None:
        gap = one.gap_wh
        console.print(
            f"measured − simulated {signed(gap['total'], 4)} Wh = power model {signed(gap['power_model'], 4)} Wh "
            f"+ behaviour {signed(gap['behaviour'], 4)} Wh"
        )
        rows = []
        for scheme in one.mission.schemes:
            ratios = (scheme.path_stretch, scheme.speed_tracking)
            row = [scheme.scheme or "–", *("–" if ratio is None else f"{ratio:.3f}" for ratio in ratios)]
            rows.append([*row, f"{scheme.dwell_s:+.0f}", *(signed(scheme.wh[part], 4) for part in PARTS)])
        columns = ["scheme", ">way ×", ">speed ×", ">dwell s", ">way Wh", ">speed Wh", ">stand Wh", ">rest Wh"]
        console.print(simple_table("Behaviour against the plan", columns, rows))
    if len(one.runs) > 1:
        shown, rest = one.worst_first[:RUN_ROWS], one.worst_first[RUN_ROWS:]
        rows = [_run_row(run.run, run, signed(run.energy_error_pct, 2)) for run in shown]
        if rest:
            most = _plain(abs(rest[0].energy_error_pct))
            rows.append(_run_row(f"the other {len(rest)}", Errors(tuple(rest)).total, f"≤ {most}"))
        columns = ["run", ">time s", ">measured Wh", ">model Wh", ">error %", ">RMSE W"]
        console.print(simple_table(f"Runs, the worst first, battery {one.battery}", columns, rows))


def _run_row(name: str, run: RunError, error_pct: str) -> list[str]:
    energies = [in_wh(run.energy_measured_wh), in_wh(run.energy_model_wh)]
    return [name, f"{run.seconds:.0f}", *energies, error_pct, rounded(run.power_rmse_w)]


def _plain(value: float) -> str:
    return f"{value:.2f}" if math.isfinite(value) else "–"


RUNS = (
    *("run", "seconds", "energy_measured_wh", "energy_model_wh", "energy_error_pct", "power_rmse_w", "power_bias_w"),
    *(f"error_statistics.{name}_pct" for name in ("peak", "final", "mean", "std")),
)
WHERE = (
    *("by", "value", "low", "high", "unit", "explains", "share_of_squared_error", "share_of_gap", "gap_wh", "bias_w"),
    "seconds",
)
"""Columns of a table: attributes of what its rows tell."""


def write_tables(comparison: Comparison, folder: Path) -> list[Path]:
    """Write ``runs.csv``, ``where.csv``, ``terms.csv`` and, with a mission, ``behaviour.csv``. `folder`: made where it
    is not there. Gives the files written."""
    batteries = list(comparison.batteries.values())
    tables: dict[str, tuple[Sequence[str], list[Sequence[object]]]] = {
        "runs": (RUNS, [(b.battery, *attrgetter(*RUNS)(run)) for b in batteries for run in b.runs]),
        "where": (WHERE, [(b.battery, *attrgetter(*WHERE)(where)) for b in batteries for where in b.where]),
        "terms": (
            ("run", "component", "term", "energy_wh"),
            [
                (b.battery, run.run, key.component, key.name, energy)
                for b in batteries
                for run in b.runs
                for key, energy in run.by_term_wh.items()
            ],
        ),
    }
    if comparison.mission:
        rows: list[Sequence[object]] = [
            (b.battery, *attrgetter(*OF_SCHEME)(scheme), *(scheme.wh[part] for part in PARTS))
            for b in batteries
            for scheme in (b.mission.schemes if b.mission is not None else ())
        ]
        tables["behaviour"] = ((*OF_SCHEME, *(f"{part}_wh" for part in PARTS)), rows)
    return [
        write_table(
            {key.rpartition(".")[2]: [row[i] for row in found] for i, key in enumerate(("battery", *columns))},
            folder / f"{name}.csv",
        )
        for name, (columns, found) in tables.items()
    ]


def picture(charts: Mapping[str, Chart]) -> Figure:
    """Charts of a page, by their titles, as one figure of Matplotlib."""
    columns = min(3, len(charts))
    size = (4.2 * columns, 3.4 * -(-len(charts) // columns))
    figure = new_figure(*(size if len(charts) > 1 else (9.0, next(iter(charts.values())).height / 90.0)))
    parts = figure.subfigures(-(-len(charts) // columns), columns, squeeze=False).flat
    for part, (title, chart) in zip(parts, charts.items(), strict=False):
        layout: Any = chart.layout
        if stacked := "domain" in layout.get("yaxis2", {}):
            axes, other = part.subplots(2, 1, sharex=True, height_ratios=[2, 1])
        else:
            axes = part.subplots()
            other = axes.twinx() if "yaxis2" in layout else axes
            axes.set(zorder=2, facecolor="none")
        for name, of in {"yaxis": axes, "yaxis2": other}.items():
            if name in layout:
                of.set_ylabel(layout[name]["title"]["text"], fontsize=9)
            if layout.get(name, {}).get("zeroline"):
                of.axhline(0.0, color="black", linewidth=0.8)
        before: Any = ()
        for trace in chart.traces:
            before = _paint(other if trace.get("yaxis") == "y2" else axes, trace, before)
        label = literal(html.unescape(layout["xaxis"]["title"]["text"]))
        (other if stacked else axes).set_xlabel(label, fontsize=9)
        axes.set_title(literal(title), fontsize=9, loc="right")
        if 1 < len(axes.get_legend_handles_labels()[1]) <= MOST_NAMES:
            axes.legend(fontsize=8, frameon=False)
    return figure


def _paint(axes: Axes, trace: Mapping[str, Any], before: Any) -> Any:
    """Draw one trace of a chart; gives its values, which a band above it begins with."""
    x, y, marker, line = trace["x"], trace["y"], trace.get("marker", {}), trace.get("line", {})
    if isinstance(x[0], str):
        x = [literal(html.unescape(word)) for word in x]
        axes.tick_params("x", rotation=35, labelsize=8)
    if "colorscale" in marker:
        from matplotlib.cm import ScalarMappable
        from matplotlib.colors import LinearSegmentedColormap, Normalize

        colours = LinearSegmentedColormap.from_list("", [colour for _, colour in marker["colorscale"]])
        shades = ScalarMappable(Normalize(marker["cmin"], marker["cmax"]), colours)
        axes.bar(x, y, trace["width"], bottom=trace["base"], color=shades.to_rgba(marker["color"]))
        axes.set_aspect("equal")
        axes.figure.colorbar(shades, ax=axes, label=marker["colorbar"]["title"]["text"])
    elif trace["type"] == "bar":
        width = 0.8 if isinstance(x[0], str) or len(x) < 2 else 0.8 * float(np.min(np.diff(x)))
        axes.bar(x, y, width, color=marker["color"])
    elif "fill" in trace:
        axes.fill_between(x, before, y, color=MEASURED, alpha=0.15, linewidth=0, label=trace["name"])
    elif "error_y" in trace:
        ends = {"yerr": trace["error_y"]["array"], "ecolor": trace["error_y"]["color"], "elinewidth": 1.0}
        width = 1.2 if "lines" in trace["mode"] else 0.0
        axes.errorbar(x, y, **ends, color=marker["color"], marker="o", markersize=4, linewidth=width)
    elif line["width"]:
        axes.plot(x, y, color=line.get("color"), linewidth=line["width"], label=literal(html.unescape(trace["name"])))
    return y


MOST_RUNS = 12
MOST_COVARIATES, MOST_NAMES = 9, 14
POINTS = 4000


def write_figures(comparison: Comparison, folder: Path) -> list[Path]:
    """Draw the charts of the page into `folder`.

    Gives ``power_<battery>_<run>.png`` (the `MOST_RUNS` worst runs), ``error_by_covariate_<battery>.png``,
    ``error_over_progress_<battery>.png`` and ``error_map_<battery>.png`` where the logs hold a pose.
    """
    written = []
    for one in comparison.batteries.values():
        figures = {}
        for run in sorted(one.runs, key=lambda run: -run.power_rmse_w)[:MOST_RUNS]:
            name = re.sub(r"[^A-Za-z0-9._-]+", "_", run.run)[:80]
            figures[f"power_{one.battery}_{name}"] = picture({f"{run.run}, battery {run.battery}": power(run, POINTS)})
        if found := [d for d in one.dependences if d.by != "place"][:MOST_COVARIATES]:
            parts = {f"{d.title}: {100.0 * d.explained:.0f} % of the variance": residual(d) for d in found}
            figures[f"error_by_covariate_{one.battery}"] = picture(parts)
        of = one.error_statistics
        told = f"battery {one.battery}: peak {of.peak_pct:.2f}, final {of.final_pct:.2f}, mean {of.mean_pct:.2f}"
        told += f", standard deviation {of.std_pct:.2f} %"
        figures[f"error_over_progress_{one.battery}"] = picture({told: progress(one)})
        if one.places:
            figures[f"error_map_{one.battery}"] = picture({f"battery {one.battery}": places(one)})
        written += [save_figure(figure, folder / f"{name}.png") for name, figure in figures.items()]
    return written

"""A comparison as tables (on the terminal, at most 100 columns wide, and as CSV files) and as pictures (PNG files)."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.compare import BatteryComparison, Comparison, RunComparison
from missionsim.compare.axes import PlaceCell
from missionsim.compare.behaviour import OF_SCHEME, PARTS
from missionsim.numerals import in_wh, rounded
from missionsim.physics import Array
from missionsim.report.page import MEASURED, MODEL, RESIDUAL, literal, new_figure, save_figure, shared_indices
from missionsim.report.terminal import signed, simple_table
from missionsim.results.write import write_table
from missionsim.runs.error import Errors, RunError

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from rich.console import Console


WHERE_ROWS = 10
RUN_ROWS = 12


def print_comparison(comparison: Comparison, console: Console) -> None:
    """Print the verdict, the numbers by battery and run, where it fails, and what was assumed."""
    count = len(comparison.runs)
    title = f"{comparison.robot or 'model'}: model against measurements, {count} {'runs' if count != 1 else 'run'}"
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
            wh = scheme.wh[one.battery]
            rows.append([*row, f"{scheme.dwell_s:+.0f}", *(signed(wh[part], 4) for part in PARTS)])
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
            (b.battery, *attrgetter(*OF_SCHEME)(scheme), *(scheme.wh[b.battery][part] for part in PARTS))
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


DIVERGING = ("#0b4f8a", "#7fb2d9", "#f7f7f7", "#f2a477", "#a63603")
"""Blue where the model is too low, orange where it is too high; told apart with any colour vision."""
MOST_RUNS = 12
MOST_COVARIATES = 9
POINTS = 4000


def write_figures(comparison: Comparison, folder: Path) -> list[Path]:
    """Draw every figure of a comparison into `folder`.

    Gives ``power_<battery>_<run>.png`` (the `MOST_RUNS` worst runs), ``error_by_covariate_<battery>.png``,
    ``error_over_progress_<battery>.png`` and ``error_map_<battery>.png`` where the logs hold a pose.
    """
    written = []
    for one in comparison.batteries.values():
        for run in sorted(one.runs, key=lambda run: -run.power_rmse_w)[:MOST_RUNS]:
            name = re.sub(r"[^A-Za-z0-9._-]+", "_", run.run)[:80]
            written.append(save_figure(power_figure(run), folder / f"power_{one.battery}_{name}.png"))
        if one.dependences:
            written.append(save_figure(covariate_figure(one), folder / f"error_by_covariate_{one.battery}.png"))
        written.append(save_figure(progress_figure(one), folder / f"error_over_progress_{one.battery}.png"))
        if one.places:
            written.append(save_figure(map_figure(one), folder / f"error_map_{one.battery}.png"))
    return written


def power_figure(run: RunComparison) -> Figure:
    """Measured and modelled power over time with the error under it."""
    figure = new_figure(9.0, 5.0)
    top, bottom = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    measured, model = run.series.power_w("measured"), run.series.power_w("model")
    kept = shared_indices([measured, model, model - measured], POINTS)
    time_s = run.series.middle_s[kept]
    top.plot(time_s, measured[kept], color=MEASURED, linewidth=1.0, label="measured")
    top.plot(time_s, model[kept], color=MODEL, linewidth=1.0, label="model")
    top.set_ylabel("power, W")
    top.legend(loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=2, frameon=False)
    top.set_title(literal(f"{run.run}, battery {run.battery}"), loc="right", fontsize=10)
    bottom.axhline(0.0, color="black", linewidth=0.8)
    bottom.plot(time_s, (model - measured)[kept], color=RESIDUAL, linewidth=0.8)
    bottom.set_ylabel("model − measured, W")
    bottom.set_xlabel("time since the start, s")
    return figure


def covariate_figure(one: BatteryComparison) -> Figure:
    """Mean and spread of the power error against the covariates that explain most of it."""
    found = [d for d in one.dependences if d.by != "place"][:MOST_COVARIATES]
    columns = min(3, len(found))
    rows = -(-len(found) // columns)
    figure = new_figure(4.0 * columns, 3.2 * rows)
    for axes, dependence in zip(figure.subplots(rows, columns, squeeze=False).flat, found, strict=False):
        bins = dependence.fine
        numeric = bins[0].low is not None
        x: Any = [0.5 * ((b.low or 0.0) + (b.high or 0.0)) for b in bins] if numeric else np.arange(len(bins))
        axes.axhline(0.0, color="black", linewidth=0.8)
        style: dict[str, Any] = {"color": MODEL, "ecolor": "#c3cad3", "marker": "o", "markersize": 4, "elinewidth": 1.0}
        bias, spread = [b.bias_w for b in bins], [b.spread_w for b in bins]
        axes.errorbar(x, bias, spread, linewidth=1.2 if numeric else 0.0, **style)
        if not numeric:
            step = max(1, -(-len(bins) // 12))
            axes.set_xticks(x[::step], [literal(b.value) for b in bins][::step], rotation=35, ha="right", fontsize=8)
        axes.set_xlabel(literal(f"{dependence.title}, {dependence.unit}" if dependence.unit else dependence.title))
        axes.set_ylabel("error, W")
        axes.set_title(f"goes with {100.0 * dependence.explained:.0f} % of the variance", fontsize=9, loc="right")
    for axes in figure.axes[len(found) :]:
        axes.set_visible(False)
    figure.suptitle(
        f"Power error (model − measured) by covariate, battery {one.battery}: mean and standard deviation", fontsize=11
    )
    return figure


def progress_figure(one: BatteryComparison) -> Figure:
    """Error of the energy so far over the progress of the runs."""
    figure = new_figure(8.0, 4.0)
    axes = figure.subplots()
    axes.axhline(0.0, color="black", linewidth=0.8)
    if len(one.runs) > 1:
        for i, run in enumerate(one.runs):
            label = "single runs" if i == 0 else None
            axes.plot(100.0 * run.progress, run.error_curve_pct, linewidth=0.8, color="#aab2bd", label=label)
    axes.plot(100.0 * one.progress, one.error_curve_pct, color=MODEL, linewidth=2.0, label="all runs")
    axes.set_xlabel("progress, % of the run's time")
    axes.set_ylabel("error of the energy so far, %")
    found = one.error_statistics
    told = f"peak {found.peak_pct:.2f}, final {found.final_pct:.2f}, mean {found.mean_pct:.2f}"
    told += f", standard deviation {found.std_pct:.2f} %"
    axes.set_title(f"battery {one.battery}: {told}", fontsize=10, loc="right")
    axes.legend(frameon=False)
    return figure


def error_grid(cells: Sequence[PlaceCell]) -> tuple[Array, float]:
    """Mean power error by place, shape (rows, columns), NaN where the robot never was; and its 98th percentile."""
    places = np.array([(c.y_m, c.x_m) for c in cells])
    row, column = np.rint((places - places.min(axis=0)) / cells[0].width_m).astype(int).T
    grid = np.full((row.max() + 1, column.max() + 1), np.nan)
    grid[row, column] = [-c.gap_j / c.seconds for c in cells]
    return grid, float(np.nanquantile(np.abs(grid), 0.98)) or 1.0


def map_figure(one: BatteryComparison) -> Figure:
    """Mean power error by place."""
    from matplotlib.colors import LinearSegmentedColormap

    grid, limit = error_grid(one.places)
    rows, columns = grid.shape
    figure = new_figure(7.0, float(np.clip(7.0 * rows / columns, 3.0, 8.0)))
    axes = figure.subplots()
    edge, x, y = 0.5 * one.places[0].width_m, [c.x_m for c in one.places], [c.y_m for c in one.places]
    extent = (min(x) - edge, max(x) + edge, min(y) - edge, max(y) + edge)
    colours: dict[str, Any] = {"cmap": LinearSegmentedColormap.from_list("error", DIVERGING), "vmin": -limit}
    image = axes.imshow(grid, origin="lower", vmax=limit, interpolation="nearest", extent=extent, **colours)
    axes.set_facecolor("#e5e8ec")
    figure.colorbar(image, ax=axes, label="mean error (model − measured), W")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_title(f"battery {one.battery}", loc="right", fontsize=10)
    return figure

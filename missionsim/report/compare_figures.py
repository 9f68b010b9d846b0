"""Pictures of a comparison as PNG files: power over time, error by covariate, over progress and on the map."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.compare import BatteryComparison, Comparison, Dependence, RunComparison
from missionsim.compare.axes import PlaceCell
from missionsim.files import atomic_write
from missionsim.physics import Array
from missionsim.report.traces import MEASURED, MODEL, RESIDUAL, literal, shared_indices

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
            written.append(_save(power_figure(run), folder / f"power_{one.battery}_{_file_name(run.run)}.png"))
        if one.dependences:
            written.append(_save(covariate_figure(one), folder / f"error_by_covariate_{one.battery}.png"))
        written.append(_save(progress_figure(one), folder / f"error_over_progress_{one.battery}.png"))
        if one.places:
            written.append(_save(map_figure(one), folder / f"error_map_{one.battery}.png"))
    return written


def power_figure(run: RunComparison) -> Figure:
    """Measured and modelled power over time with the error under it."""
    figure = _figure(9.0, 5.0)
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
    figure = _figure(4.0 * columns, 3.2 * rows)
    for axes, dependence in zip(figure.subplots(rows, columns, squeeze=False).flat, found, strict=False):
        _draw_covariate(axes, dependence)
    for axes in figure.axes[len(found) :]:
        axes.set_visible(False)
    figure.suptitle(
        f"Power error (model − measured) by covariate, battery {one.battery}: mean and standard deviation", fontsize=11
    )
    return figure


def _draw_covariate(axes: Axes, found: Dependence) -> None:
    bins = found.fine
    numeric = bins[0].low is not None
    x: Any = np.arange(len(bins))
    if numeric:
        x = np.array([0.5 * ((b.low or 0.0) + (b.high or 0.0)) for b in bins])
    axes.axhline(0.0, color="black", linewidth=0.8)
    style: dict[str, Any] = {"color": MODEL, "ecolor": "#c3cad3", "marker": "o", "markersize": 4, "elinewidth": 1.0}
    bias, spread = [b.bias_w for b in bins], [b.spread_w for b in bins]
    axes.errorbar(x, bias, spread, linewidth=1.2 if numeric else 0.0, **style)
    if not numeric:
        step = max(1, -(-len(bins) // 12))
        axes.set_xticks(x[::step], [literal(b.value) for b in bins][::step], rotation=35, ha="right", fontsize=8)
    axes.set_xlabel(literal(f"{found.title}, {found.unit}" if found.unit else found.title))
    axes.set_ylabel("error, W")
    axes.set_title(f"goes with {100.0 * found.explained:.0f} % of the variance", fontsize=9, loc="right")


def progress_figure(one: BatteryComparison) -> Figure:
    """Error of the energy so far over the progress of the runs."""
    figure = _figure(8.0, 4.0)
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


@dataclass(frozen=True)
class ErrorMap:
    """Mean power error on a grid of places."""

    x_m: Array
    y_m: Array
    """Both: middles of the cells. Shape (columns,) and (rows,)."""
    error_w: Array
    seconds: Array
    """Both: model minus measured, and the time spent there; NaN where the robot never was. Shape (rows, columns)."""
    limit_w: float
    """98th percentile of the magnitude of the error, where colours end."""


def error_map(cells: Sequence[PlaceCell]) -> ErrorMap:
    """The cells of a battery's map as a grid."""
    width = cells[0].width_m
    x, y = (np.arange(min(v), max(v) + 0.5 * width, width) for v in ([c.x_m for c in cells], [c.y_m for c in cells]))
    error, seconds = np.full((2, len(y), len(x)), np.nan)
    for cell in cells:
        at = round((cell.y_m - y[0]) / width), round((cell.x_m - x[0]) / width)
        error[at], seconds[at] = -cell.gap_j / cell.seconds, cell.seconds
    return ErrorMap(x, y, error, seconds, float(np.nanquantile(np.abs(error), 0.98)) or 1.0)


def map_figure(one: BatteryComparison) -> Figure:
    """Mean power error by place."""
    from matplotlib.colors import LinearSegmentedColormap

    found = error_map(one.places)
    rows, columns = found.error_w.shape
    figure = _figure(7.0, float(np.clip(7.0 * rows / columns, 3.0, 8.0)))
    axes = figure.subplots()
    edge = 0.5 * one.places[0].width_m
    extent = (found.x_m[0] - edge, found.x_m[-1] + edge, found.y_m[0] - edge, found.y_m[-1] + edge)
    colours: dict[str, Any] = {"cmap": LinearSegmentedColormap.from_list("error", DIVERGING), "vmax": found.limit_w}
    image = axes.imshow(
        found.error_w, origin="lower", vmin=-found.limit_w, interpolation="nearest", extent=extent, **colours
    )
    axes.set_facecolor("#e5e8ec")
    figure.colorbar(image, ax=axes, label="mean error (model − measured), W")
    axes.set_xlabel("x, m")
    axes.set_ylabel("y, m")
    axes.set_title(f"battery {one.battery}", loc="right", fontsize=10)
    return figure


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def _save(figure: Figure, path: Path) -> Path:
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    with atomic_write(path) as temporary:
        figure.savefig(temporary, dpi=130)
    return path


def _file_name(text: str) -> str:
    return re.sub(r"[^A-Za-z0-9._-]+", "_", text)[:80]

"""Pictures: of the map of a site, with text on it where there is room, of one run, and of many."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from missionsim.engine.outcome import J_PER_WH, RunResult
from missionsim.physics import Array
from missionsim.report.page import literal, new_figure, save_figure
from missionsim.report.site_map import DOCK, OUT, SCALE, SiteMap, layout, shifted, shut_ways, surface_of, surfaces_of
from missionsim.uncertainty.store import BlockStore

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from missionsim.inputs.environment import EnvironmentSpec


Points = Array
BOX = {"facecolor": "white", "alpha": 0.75, "edgecolor": "none", "pad": 0.6}


class Paper:
    """Where on a map there is room for text: beside what is drawn, and beside other text."""

    def __init__(self, axes: Axes, lines: Sequence[Points], places: Sequence[tuple[float, float]]) -> None:
        self.axes, self.scale = axes, axes.figure.dpi / 72.0
        fine = [
            line[0] + (line[-1] - line[0]) * np.linspace(0, 1, 81)[:, None] if len(line) < 81 else line
            for line in lines
        ]
        self.drawn = axes.transData.transform(np.concatenate([*lines, *fine]))
        spots = axes.transData.transform(np.array(places))
        around = 8.0 * self.scale * np.array([[math.cos(a), math.sin(a)] for a in np.linspace(0.0, 2 * math.pi, 12)])
        self.spots = (spots[:, None] + around).reshape(-1, 2)
        self.text = np.empty((0, 2))
        self.frame = axes.get_window_extent().get_points()

    def _crossed(self, centre: Points, size: Points, angle: float = 0.0) -> float:
        """What a box would cover; other text and places most."""
        turn = np.array([[math.cos(angle), -math.sin(angle)], [math.sin(angle), math.cos(angle)]])

        def inside(points: Points) -> int:
            return int((np.abs((points - centre) @ turn) <= 0.5 * size).all(axis=1).sum())

        half = 0.5 * np.abs(turn) @ size
        out = float(np.maximum([self.frame[0] - (centre - half), centre + half - self.frame[1]], 0.0).sum())
        return inside(self.drawn) + 4.0 * inside(self.spots) + 6.0 * inside(self.text) + out

    def _best(self, options: list[tuple[float, tuple[float, ...]]], size: Points, angle: float = 0.0) -> Any:
        """The centre of least cost, in the units of the map; the box there is taken."""
        centre = np.array(min(options)[1])
        turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
        grid = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 25), np.linspace(-0.5, 0.5, 7)), axis=-1).reshape(-1, 2)
        self.text = np.concatenate([self.text, centre + (grid * size) @ turn])
        return tuple(self.axes.transData.inverted().transform(centre))

    def write(self, at: Points, text: str, size: float, colour: str) -> None:
        """Write beside a point, where least is covered."""
        rows = text.split("\n")
        box = np.array([0.56 * size * max(map(len, rows)) + 3.0, 1.25 * size * len(rows) + 2.0]) * self.scale
        spot, options = self.axes.transData.transform(at), []
        for k, (x, y) in enumerate([(1, 1), (1, -1), (-1, 1), (-1, -1), (0, 1), (0, -1), (1, 0), (-1, 0)]):
            for far in (9.0, 16.0):
                gap = far * self.scale * (0.75 if x and y else 1.0)
                centre = spot + np.array([x, y]) * (gap + 0.5 * box)
                options.append((self._crossed(centre, box) + 0.2 * k + 0.15 * far, tuple(centre)))
        self.axes.annotate(text, self._best(options, box), fontsize=size, color=colour,
                           ha="center", va="center", zorder=7, bbox=BOX, in_layout=False)  # fmt: skip

    def along(self, line: Points, text: str) -> None:
        """Write along an edge, on the side and at the part of it where least is covered; not where there is no room."""
        size, on_paper = 6.0, self.axes.transData.transform(line)
        ahead = on_paper[-1] - on_paper[0]
        angle = math.atan2(ahead[1], ahead[0])
        angle -= math.copysign(math.pi, angle) if abs(angle) > 0.5 * math.pi + 1e-9 else 0.0
        up = np.array([-math.sin(angle), math.cos(angle)])
        box = np.array([0.56 * size * len(text) + 2.0, 1.15 * size]) * self.scale
        options = []
        for share in (0.5, 0.4, 0.6, 0.3, 0.7, 0.2, 0.8):
            point = on_paper[int(share * (len(line) - 1))]
            for side in (6.0, -6.0, 10.0, -10.0, 14.0, -14.0):
                centre = point + side * self.scale * up
                worse = 0.1 * abs(side) + 4.0 * abs(share - 0.5)
                options.append((self._crossed(centre, box, angle) + worse, tuple(centre)))
        self.axes.annotate(text, self._best(options, box, angle), fontsize=size, color="#555555", ha="center",
                           va="center", rotation=math.degrees(angle), rotation_mode="anchor", zorder=5,
                           in_layout=False)  # fmt: skip


def site_figure(site: SiteMap) -> Figure:
    """The map as a Matplotlib figure."""
    from matplotlib import colormaps
    from matplotlib.cm import ScalarMappable
    from matplotlib.colors import Normalize

    where, curves = layout(site.environment)
    span = np.maximum(np.ptp(np.array(list(where.values())), axis=0), 1e-9)
    figure_width, height = 11.0, float(np.clip(9.0 * span[1] / max(span[0], 1e-9), 4.0, 9.5)) + 1.4
    figure = new_figure(figure_width, height)
    axes = figure.subplots()
    axes.set_aspect("equal")
    axes.spines[["top", "right"]].set_visible(False)
    axes.set_xlabel("x [m] (wider edge: steeper; slope in the direction of its arrow)")
    axes.set_ylabel("y [m]")
    axes.margins(0.12)
    axes.set_title(site.title, fontsize=10, loc="left")
    size = float(max(span))
    surfaces = surfaces_of(site.environment)
    shut = shut_ways(site.environment)
    for index, edge in enumerate(site.environment.edges):
        line, surface = curves[index], surface_of(site.environment, edge)
        if index in shut:
            axes.plot(*line.T, color="#b0b0b0", linestyle=":", linewidth=1.6, label="closed", zorder=1)
            axes.plot(*line[len(line) // 2], marker="x", color="#555555", markersize=8, zorder=2)
            continue
        width = 1.4 + 40.0 * min(abs(math.tan(edge.slope.value)), 0.15)
        axes.plot(*line.T, color=surfaces[surface], linewidth=width, alpha=0.75, zorder=1, label=surface or "edge")
    lines: list[Points] = []
    if site.driven:
        values = np.array([wh for *_, wh in site.driven])
        low, high = float(values.min()), float(values.max())
        norm = Normalize(low, high if high > low else low + 1e-9)
        for number, begin, wh in site.driven:
            line = shifted(curves[number], begin == site.environment.edges[number].from_, 0.009 * size)
            colour = colormaps[SCALE](norm(wh))
            axes.plot(*line.T, color=colour, linewidth=3.2, solid_capstyle="butt", zorder=3)
            middle, ahead = line[int(0.62 * len(line)) - 1], line[int(0.62 * len(line))]
            axes.annotate("", ahead, middle, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2}, zorder=4)
            lines.append(line)
        bar = figure.colorbar(ScalarMappable(norm, SCALE), ax=axes, shrink=0.7, pad=0.01)
        bar.set_label("energy of all batteries on the edge [Wh/m]", fontsize=8)
    marks = []
    for number, begin, share, text in site.turns:
        line = curves[number] if begin == site.environment.edges[number].from_ else curves[number][::-1]
        at = line[min(int(share * (len(line) - 1) + 0.5), len(line) - 1)]
        axes.plot(*at, marker="X", color=OUT, markersize=8, zorder=6, linestyle="none", label="turn back")
        marks.append((at, text))
    _draw_places(axes, site, where)
    handles, labels = axes.get_legend_handles_labels()
    known = dict(zip(labels, handles, strict=True))
    figure.legend(known.values(), known.keys(), fontsize=7.5, loc="outside lower center", ncols=7, frameon=False)
    figure.draw_without_rendering()  # so that it is known where on the paper everything lies
    paper = Paper(axes, [*lines, *curves.values()], list(where.values()))
    for name, at in where.items():
        paper.write(np.array(at), name + (f"\n{site.charges[name]}" if name in site.charges else ""), 7.5, "black")
    for at, text in marks:
        paper.write(at, text, 7.0, OUT)
    for index, edge in enumerate(site.environment.edges):
        line, slope, text = curves[index], math.tan(edge.slope.value), edge.name or ""
        if abs(slope) > 5e-4:
            text += f" {100 * slope:+.1f} %".replace("-", "−") + (" →" if line[-1][0] >= line[0][0] else " ←")
        paper.along(line, text + " one way" * (not edge.both_ways) + " closed" * (index in shut))
    return figure


def _draw_places(axes: Axes, site: SiteMap, where: Mapping[str, tuple[float, float]]) -> None:
    for name, at in where.items():
        spec = site.environment.places[name]
        colour, word = site.colours.get(name, ("#444444", "place"))
        number = site.order.get(name, "")
        axes.plot(*at, marker="o", markersize=10 if number else 7, color=colour, label=word, zorder=5, linestyle="none")
        if number:
            axes.annotate(number, at, fontsize=7 if len(number) < 2 else 6, color="white", weight="bold", ha="center",
                          va="center_baseline", zorder=8, in_layout=False)  # fmt: skip
        if spec.charger is not None:
            axes.plot(*at, marker="s", markersize=15, markerfacecolor="none", markeredgecolor=DOCK, label="dock",
                      markeredgewidth=1.8, zorder=5, linestyle="none")  # fmt: skip
        if spec.closed:
            axes.plot(*at, marker="x", markersize=13, color="#222222", zorder=6, linestyle="none")


COLOURS: tuple[str, ...] = ("#4477aa", "#ee6677", "#228833", "#ccbb44", "#66ccee", "#aa3377")
COLOURS += ("#ee8866", "#77aadd", "#999933", "#882255", "#44aa99", "#332288")
"""Distinguishable without colour vision (P. Tol's bright, light and muted schemes)."""
OTHERS = "#bbbbbb"
BESIDE: dict[str, Any] = {"loc": "center left", "bbox_to_anchor": (1.01, 0.5), "frameon": False, "fontsize": 8}
MOST_COMPONENTS = 8
MOST_LABELS = 26
MOST_BARS = 40


def write_figures(
    result: RunResult,
    folder: str | Path,
    format: Literal["png", "svg"] = "png",
    environment: EnvironmentSpec | None = None,
) -> list[Path]:
    """Draw all figures of a run into a folder.

    `result`: with its intervals (``trace=True``); `format`: ``png`` or ``svg``; `environment`: the mission's, for the
    map. Gives ``power``, ``charge`` and ``energy`` with the suffix of the format, and ``site`` where a map was driven.
    """
    figures = {"power": power_figure(result), "charge": charge_figure(result), "energy": energy_figure(result)}
    if environment is not None and result.edges_driven():
        from missionsim.report.figures_run import site_figure
        from missionsim.report.site_map import map_of_run

        figures["site"] = site_figure(map_of_run(result, environment))
    return [save_figure(figure, Path(folder) / f"{name}.{format}") for name, figure in figures.items()]


def power_figure(result: RunResult) -> Figure:
    """Power of each battery over time, stacked by component (mean of each interval), segments marked."""
    figure, axes, scale = _figure(result, 3.0)
    line = result.timeline
    edges = line.edges_s / scale
    colours = _colours(result)
    for axis, name in zip(axes, result.batteries, strict=True):
        parts = _by_component(result, name)
        base = np.zeros(len(line))
        for component, joules in parts.items():
            top = base + joules / line.duration_s
            low, high = (np.append(line, line[-1:]) for line in (base, top))
            axis.fill_between(edges, low, high, step="post", color=colours[component], label=component, linewidth=0)
            base = top
        axis.step(edges, np.append(base, base[-1:]), where="post", color="#222222", linewidth=0.7)
        axis.set_ylabel(f"{name} battery [W]")
        axis.set_ylim(min(0.0, float(base.min(initial=0.0)) * 1.05), max(1e-9, float(base.max(initial=0.0))) * 1.06)
        handles, labels = axis.get_legend_handles_labels()
        axis.legend(handles[::-1], labels[::-1], **BESIDE)
    return figure


def charge_figure(result: RunResult) -> Figure:
    """Charge of each battery over time, with its required reserve, the energy home, and where it is empty."""
    figure, axes, scale = _figure(result, 2.4)
    line = result.timeline
    time = np.append(line.start_s[:1], line.start_s + line.duration_s) / scale
    home = result.home_energy()
    for i, (axis, name) in enumerate(zip(axes, result.batteries, strict=True)):
        battery = result.batteries[name]
        charge = np.append(battery.initial_wh, result.charge_wh[name])
        axis.plot(time, charge, color=COLOURS[i % len(COLOURS)], linewidth=1.6, label="charge")
        reserve = battery.reserve_required_wh
        axis.axhline(reserve, color="#777777", linestyle="--", linewidth=1.0, label="reserve to keep")
        ways = [
            (result.segment_end_s[j] / scale, entry[name])
            for j, entry in enumerate(home)
            if j in result.segment_end_s and entry.get(name) is not None
        ]
        if any(energy for _, energy in ways):
            axis.plot(*zip(*ways, strict=True), color="#aa3377", marker=".", linewidth=1.0, label="needed to come home")
        if battery.empty_at_s is not None:
            axis.axvline(battery.empty_at_s / scale, color="#cc3311", linewidth=1.2, label="empty")
        low = min(0.0, float(charge.min()))
        axis.set_ylim(low * 1.05, max(float(charge.max()), reserve) * 1.08)
        axis.set_ylabel(f"{name} battery [Wh]")
        axis.legend(**BESIDE)
    return figure


def energy_figure(result: RunResult) -> Figure:
    """Energy of each segment by component, one panel a battery; repetitions of a segment are added up."""
    groups = result.repeats()
    names = list(result.batteries)
    totals = {label: sum(float(result.by_segment_wh(n)[of].sum()) for n in names) for label, of in groups.items()}
    kept = set(sorted(totals, key=lambda label: -totals[label])[:MOST_BARS])
    labels = [label for label in groups if label in kept]
    height = max(2.4, 0.26 * len(labels) + 1.2)
    figure = new_figure(4.6 * len(names) + 1.4, height)
    axes = figure.subplots(1, len(names), sharey=True, squeeze=False)[0]
    count = len(result.segments)
    colours = _colours(result)
    for axis, name in zip(axes, names, strict=True):
        base = np.zeros(len(labels))
        for component, joules in _by_component(result, name).items():
            by_segment = np.bincount(result.timeline.segment, weights=joules, minlength=count) / J_PER_WH
            energy = np.array([by_segment[groups[label]].sum() for label in labels])
            axis.barh(range(len(labels)), energy, left=base, color=colours[component], label=component, height=0.78)
            base = base + energy
        axis.set_xlabel(f"{name} battery [Wh]")
        axis.set_yticks(range(len(labels)), [literal(label) for label in labels], fontsize=8)
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.9 / height), ncols=3, frameon=False, fontsize=7)
    axes[0].invert_yaxis()
    figure.suptitle(_title(result), fontsize=10)
    return figure


def _by_component(result: RunResult, battery: str) -> dict[str, Any]:
    """Energy by component [J], shape (n,), in the order of the robot file; small ones together as ``others``."""
    parts: dict[str, Any] = {}
    for key, joules in result.energies[battery].items():
        parts[key.component] = parts.get(key.component, 0.0) + np.asarray(joules)
    used = {name: joules for name, joules in parts.items() if np.any(joules)}
    if len(used) <= MOST_COMPONENTS:
        return used
    largest = sorted(used, key=lambda name: -abs(float(used[name].sum())))[: MOST_COMPONENTS - 1]
    kept = {name: joules for name, joules in used.items() if name in largest}
    kept["others"] = np.sum([joules for name, joules in used.items() if name not in largest], axis=0)
    return kept


def _colours(result: RunResult) -> dict[str, str]:
    """One colour for a component, whatever the battery."""
    shown = dict.fromkeys(name for battery in result.batteries for name in _by_component(result, battery))
    shown.pop("others", None)
    return {name: COLOURS[i % len(COLOURS)] for i, name in enumerate(shown)} | {"others": OTHERS}


def _figure(result: RunResult, height: float) -> tuple[Figure, list[Axes], float]:
    """A panel for each battery over time; seconds in the unit of its axis. Thin lines stand where segments begin, their
    names over the first panel, unless there are too many or too short."""
    figure = new_figure(10.0, height * len(result.batteries) + 1.0)
    axes = list(figure.subplots(len(result.batteries), 1, sharex=True, squeeze=False)[:, 0])
    for axis in axes:
        axis.margins(x=0)
    scale, unit = (60.0, "min") if result.duration_s > 300.0 else (1.0, "s")
    if result.duration_s > 3 * 3600.0:
        scale, unit = 3600.0, "h"
    axes[-1].set_xlabel(f"time [{unit}]")
    figure.suptitle(_title(result), fontsize=10)
    line = result.timeline
    first = np.flatnonzero(np.append(True, line.segment[1:] != line.segment[:-1])) if len(line) else np.zeros(0, int)
    if not 0 < len(first) <= 4 * MOST_LABELS:
        return figure, axes, scale
    for axis in axes:
        for i in first:
            axis.axvline(line.start_s[i] / scale, color="#000000", alpha=0.18, linewidth=0.7)
    ends = line.edges_s[[*first[1:], -1]]
    for i, end in zip(first, ends, strict=True):
        if end - line.start_s[i] < result.duration_s / MOST_LABELS / 1.5:
            continue
        middle = 0.5 * (line.start_s[i] + end) / scale
        name = result.segments[int(line.segment[i])].name
        text = literal(name if len(name) < 22 else name[:20] + "…")
        above: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "textcoords": "offset points", "xytext": (0, 3)}
        axes[0].annotate(text, (middle, 1.0), **above, rotation=35, ha="left", va="bottom", fontsize=7)
    return figure, axes, scale


def _title(result: RunResult) -> str:
    verdict = "feasible" if result.feasible else f"not feasible: {result.reason}"
    return literal(f"{result.mission}, {result.robot}: {verdict}")


FAN_RUNS, HISTOGRAM_RUNS = 20_000, 1_000_000
"""So many runs, the first ones, make the fan and the histogram."""
_BANDS = ((0.01, 0.99, 0.15), (0.05, 0.95, 0.25), (0.25, 0.75, 0.40))


def write_batch_figures(store: BlockStore, firsts: list[int], batteries: tuple[str, ...], folder: Path) -> list[Path]:
    """Draw ``energy_histogram.png`` and ``charge_fan.png``. `firsts`: blocks that count. Gives the files written."""
    histogram, fan = (new_figure(4.6 * len(batteries), 3.4) for _ in range(2))
    axes = np.atleast_1d(histogram.subplots(1, len(batteries)))
    for axis, name in zip(axes, batteries, strict=True):
        energy = store.beginning([f"energy_{name}_wh"], firsts, HISTOGRAM_RUNS)[f"energy_{name}_wh"]
        energy = energy[np.isfinite(energy)]
        if not len(energy) or np.ptp(energy) <= 1e-12 * np.abs(energy).max():
            text = f"{energy[0]:.4g} Wh in all runs" if len(energy) else "all runs failed"
            axis.text(0.5, 0.5, text, transform=axis.transAxes, ha="center", va="center")
            axis.set(xlabel=f"energy of battery {name} [Wh]", xticks=[], yticks=[])
            continue
        axis.hist(energy, bins="auto" if len(energy) < 50_000 else 120, color="#4477aa")
        for q, style in ((0.05, ":"), (0.5, "-"), (0.95, ":")):
            at = float(np.quantile(energy, q))
            axis.axvline(at, color="#222222", linestyle=style, linewidth=1)
            where: dict[str, Any] = {"xycoords": ("data", "axes fraction"), "ha": "center", "va": "bottom"}
            axis.annotate(f"{100 * q:g} %", (at, 1.0), fontsize=7, **where)
        axis.set(xlabel=f"energy of battery {name} [Wh]", ylabel="runs")
    axes = np.atleast_1d(fan.subplots(1, len(batteries)))
    for axis, name in zip(axes, batteries, strict=True):
        charge = store.beginning([f"charge_{name}_wh"], firsts, FAN_RUNS)[f"charge_{name}_wh"]
        charge = charge[np.isfinite(charge).all(axis=1)]
        if not len(charge):
            continue
        progress = np.linspace(0.0, 100.0, charge.shape[1])
        for low, high, alpha in _BANDS:
            edges = np.quantile(charge, [low, high], axis=0)
            label = f"{100 * low:g}–{100 * high:g} %"
            axis.fill_between(progress, edges[0], edges[1], color="#4477aa", alpha=alpha, linewidth=0, label=label)
        axis.plot(progress, np.median(charge, axis=0), color="#222222", linewidth=1, label="median")
        axis.set(xlabel="progress of the mission [% of its time]", ylabel=f"charge of battery {name} [Wh]")
        axis.legend(fontsize=7, frameon=False)
    files = {"energy_histogram.png": histogram, "charge_fan.png": fan}
    return [save_figure(figure, folder / name) for name, figure in files.items()]

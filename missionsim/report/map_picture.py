"""The map of a site as a picture, with text on it where there is room."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.physics import Array
from missionsim.report.page import new_figure
from missionsim.report.site_map import DOCK, OUT, SCALE, SiteMap, layout, shifted, shut_ways, surface_of, surfaces_of

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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

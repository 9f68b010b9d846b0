"""Text on a map where there is room for it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from missionsim.physics import Array

if TYPE_CHECKING:
    from matplotlib.axes import Axes

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

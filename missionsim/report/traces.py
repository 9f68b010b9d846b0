"""Pieces of charts that the pages share, and long series made short enough to draw without losing a peak."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import visible
from missionsim.files import atomic_write
from missionsim.physics import Array
from missionsim.report.page import COLOURS, Block, Chart, Choice, Paragraph

if TYPE_CHECKING:
    from matplotlib.figure import Figure

MEASURED, MODEL, FITTED = COLOURS[:3]
RESIDUAL = "#52606d"
PALE = "#d9dee4"
MARGIN = {"r": 16, "t": 30, "b": 48}
Values: TypeAlias = Sequence[object] | Array
Trace: TypeAlias = dict[str, object]


def line(x: Values, y: Values, name: str, colour: str = "", width: float = 1.4, **more: object) -> Trace:
    """A curve."""
    style: Trace = {"width": width, "color": colour} if colour else {"width": width}
    return {"type": "scatter", "mode": "lines", "x": x, "y": y, "name": name, "line": style, **more}


def bars(names: Sequence[str], values: Values, colour: str, **more: object) -> Trace:
    """Bars from left to right, the last name on top."""
    return {"type": "bar", "orientation": "h", "x": values, "y": names, "marker": {"color": colour}, **more}


def band(x: Values, low: Values, high: Values, name: str, strength: float = 0.2) -> list[Trace]:
    """The range between two curves."""
    hidden = line(x, low, "", width=0, hoverinfo="skip", showlegend=False)
    fill = {"fill": "tonexty", "fillcolor": f"rgba(0,114,178,{strength})"}
    return [hidden, line(x, high, name, width=0, hoverinfo="skip", **fill)]


def tiles(
    x: Array,
    y: Array,
    values: Array,
    *,
    size: float,
    limit: float,
    colours: Sequence[str],
    bar: Mapping[str, object] | None = None,
    **more: object,
) -> Trace:
    """Coloured squares around places, as bars that stand on their lower edges.

    `x`, `y`, `values` (shape (n,)): middles, and what the colours stand for. `size`: width and height in units of the
    axes. `limit`: magnitude of the values at which the colours end. `colours`: from −limit to +limit, equally far
    apart. `bar`: the scale of the colours beside the chart, as Plotly's ``colorbar``; none without it.
    """
    scale = [[i / (len(colours) - 1), colour] for i, colour in enumerate(colours)]
    ends = {"colorscale": scale, "cmin": -limit, "cmax": limit, "showscale": bar is not None, "colorbar": bar}
    where: Trace = {"type": "bar", "x": x, "base": y - 0.5 * size, "y": np.full(len(y), size), "width": size}
    return {**where, "customdata": values, "marker": {"color": values, "line": {"width": 0}, **ends}, **more}


def axis(title: str, **more: object) -> Trace:
    """An axis with its title."""
    return {"title": {"text": title}, **more}


def over_time(traces: Sequence[Mapping[str, object]], below: str, caption: str, height: int = 480) -> Chart:
    """Power over time, and under it on the axis ``y2`` what the caption says."""
    layout = {
        "xaxis": axis("time since the start, s", anchor="y2"),
        "yaxis": axis("power, W", domain=[0.36, 1.0]),
        "yaxis2": axis(below, domain=[0.0, 0.28], zeroline=True, zerolinewidth=2),
    }
    return Chart(traces, layout, caption, height)


def one_of(label: str, options: Sequence[tuple[str, Sequence[Block]]], note: str = "") -> list[Block]:
    """One of several, chosen from a list where there is a choice; a note on what is left out."""
    shown = list(options[0][1]) if len(options) == 1 else [Choice(label, options)]
    return [*([Paragraph(note, small=True)] if note else []), *shown]


def min_max_indices(values: Array, points: int) -> NDArray[np.int64]:
    """Indices of a series to draw: the lowest and highest value of each of ``points/2`` equal stretches, and both ends.

    `values` (shape (n,)): the series; NaN are kept only where a stretch has nothing else. `points`: upper limit of the
    number of indices, at least 4. Gives an array of shape (m,): increasing, m ≤ max(points, 4).
    """
    size = len(values)
    limit = max(points, 4)
    if size <= limit:
        return np.arange(size)
    buckets = (limit - 2) // 2
    edges = np.linspace(0, size, buckets + 1).astype(np.int64)
    chosen = np.empty(2 * buckets + 2, dtype=np.int64)
    chosen[0], chosen[-1] = 0, size - 1
    low = np.where(np.isnan(values), np.inf, values)
    high = np.where(np.isnan(values), -np.inf, values)
    for k in range(buckets):
        first, last = edges[k], edges[k + 1]
        chosen[1 + 2 * k] = first + int(np.argmin(low[first:last]))
        chosen[2 + 2 * k] = first + int(np.argmax(high[first:last]))
    return np.unique(chosen)


def shared_indices(series: list[Array], points: int) -> NDArray[np.int64]:
    """Indices that keep the peaks of several series on one axis; `points` is the limit for all of them together."""
    if not series:
        return np.zeros(0, dtype=np.int64)
    each = max(4, points // len(series))
    return np.unique(np.concatenate([min_max_indices(values, each) for values in series]))


def literal(text: str) -> str:
    """A name for Matplotlib, which takes what stands between dollar signs for mathematics; no control signs."""
    return visible(text).replace("$", r"\$")


def new_figure(width: float, height: float) -> Figure:
    """An empty figure of Matplotlib, in inches."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def save_figure(figure: Figure, path: Path) -> Path:
    """Write a figure as PNG or SVG by its suffix, whole or not at all, without lines at the top and the right."""
    for axes in figure.axes:
        axes.spines[["top", "right"]].set_visible(False)
    form = path.suffix[1:].lower()
    metadata = {"Date": None} if form == "svg" else {"Software": "missionsim"}
    with atomic_write(path) as temporary:
        figure.savefig(temporary, format=form, dpi=130, metadata=metadata)
    return path

"""The page: the blocks that a report is made of, the pieces of its charts, and the HTML that draws them; figures.

Long series are made short enough to draw without losing a peak.
"""

from __future__ import annotations

import base64
import gzip
import html as html_lib
import itertools
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeGuard

import numpy as np

from missionsim.errors import visible
from missionsim.files import atomic_write, plain
from missionsim.numerals import rounded
from missionsim.physics import Array, Int64s

if TYPE_CHECKING:
    from matplotlib.figure import Figure

Tone = Literal["good", "warn", "bad", "neutral"]


@dataclass(frozen=True)
class Verdict:
    """The headline: one or two sentences in a coloured box."""

    text: str
    """Plain text; escaped when drawn."""
    tone: Tone = "neutral"
    """``good``, ``warn``, ``bad`` or ``neutral``; said by a word and a mark too, not by colour alone."""


@dataclass(frozen=True)
class Paragraph:
    """Running text; `small` for notes."""

    text: str
    small: bool = False


@dataclass(frozen=True)
class Bullets:
    """A list of sentences."""

    items: Sequence[str]


@dataclass(frozen=True)
class Tiles:
    """Headline numbers side by side: (label, value as text, note)."""

    items: Sequence[tuple[str, str, str]]


@dataclass(frozen=True)
class Table:
    """A table of texts and numbers."""

    columns: Sequence[str]
    """Headings."""
    rows: Sequence[Sequence[Any]]
    """Cells; numbers are right-aligned and written with `digits` significant digits, None as an en dash."""
    caption: str = ""
    """What the table shows."""
    digits: int = 4
    """Significant digits of the numbers."""
    bar: int | None = None
    """Index of a column of shares (0 to 1) that is drawn as a bar behind the number."""


@dataclass(frozen=True)
class Chart:
    """A Plotly figure as plain data."""

    traces: Sequence[Mapping[str, Any]]
    """Plotly traces; arrays may be NumPy arrays."""
    layout: Mapping[str, Any] = field(default_factory=dict)
    """Plotly layout, laid over the house style."""
    caption: str = ""
    """What one sees; also the text for readers who do not see the picture."""
    height: int = 380
    """Pixels."""


@dataclass(frozen=True)
class Details:
    """Blocks folded away under a line; opened on paper."""

    summary: str
    blocks: Sequence[Block]


@dataclass(frozen=True)
class Command:
    """The line to type next."""

    text: str


@dataclass(frozen=True)
class Choice:
    """Alternatives of which one is shown, chosen from a list (one run of many, one battery of two)."""

    label: str
    options: Sequence[tuple[str, Sequence[Block]]]


Block: TypeAlias = Verdict | Paragraph | Bullets | Tiles | Table | Chart | Details | Command | Choice


@dataclass(frozen=True)
class Section:
    """A part of the page under a heading; the page's contents list the headings."""

    title: str
    blocks: Sequence[Block]


MARKS = {"good": ("✓", "Good"), "warn": ("!", "Attention"), "bad": ("✗", "Wrong"), "neutral": ("i", "Result")}
_NUMBER = re.compile(r"(≤ )?[-+−]?[0-9][0-9.,]*(e[-−+]?[0-9]+)?")
STYLE: dict[str, dict[str, Any]] = json.loads(
    Path(__file__).with_name("templates").joinpath("charts.json").read_text("utf-8")
)
"""Plotly layout of every chart, and of every axis."""
DIGITS = 6
"""Significant digits of the numbers of charts."""
COLOURS: tuple[str, ...] = tuple(STYLE["layout"]["colorway"])
"""Okabe and Ito's colours, told apart with any colour vision, and two more."""


def page(title: str, sections: Sequence[Section], *, subtitle: str = "", footer: str = "") -> str:
    """The whole page as text, UTF-8.

    `title`, `subtitle`, `footer`: plain text; escaped. `sections`: what the page shows, in order. Gives HTML with
    scripts, styles and data inside it; a content policy in its head forbids any request.
    """
    import jinja2

    charts: list[dict[str, Any]] = []
    numbers = itertools.count(1)

    def chart_id(block: Chart) -> str:
        layout: dict[str, Any] = {**STYLE["layout"], "height": block.height, **block.layout}
        for key in [*layout, "xaxis", "yaxis"]:
            if key.startswith(("xaxis", "yaxis")):
                layout[key] = {**STYLE["axis"], **layout.get(key, {})}
        charts.append({"data": plain(block.traces, DIGITS), "layout": plain(layout, DIGITS)})
        return f"chart-{len(charts) - 1}"

    def packed() -> str:
        """Data of the charts: gzip in base64, which holds no sign of markup; the same for the same charts."""
        data = json.dumps(charts, separators=(",", ":"), allow_nan=False).encode()
        return base64.b64encode(gzip.compress(data, mtime=0)).decode("ascii") if charts else ""

    def plotly() -> str:
        """Plotly's basic bundle as its makers published it on npm (plotly.js-basic-dist-min 4.1.1), MIT licence."""
        script = resources.files("missionsim.report").joinpath("plotly", "plotly-basic.min.js.gz").read_bytes()
        return base64.b64encode(script).decode("ascii")

    loader = jinja2.PackageLoader("missionsim.report")
    environment = jinja2.Environment(
        loader=loader, autoescape=True, trim_blocks=True, lstrip_blocks=True, undefined=jinja2.StrictUndefined
    )
    environment.globals["kind"] = lambda block: type(block).__name__
    environment.globals["mark"] = lambda tone: MARKS[tone]
    # the template draws the blocks first and asks for the charts' data at its end
    return environment.get_template("page.html.j2").render(
        title=title,
        subtitle=subtitle,
        footer=footer,
        sections=sections,
        chart_id=chart_id,
        choice_id=lambda: f"choice-{next(numbers)}",
        cell=format_cell,
        is_number=_is_number,
        charts=packed,
        plotly=plotly,
    )


def format_cell(value: object, digits: int = 4) -> str:
    """A cell as text: numbers with `digits` significant digits, without exponent where readable; None as a dash."""
    if value is None:
        return "–"
    if isinstance(value, (bool, np.bool_)):
        return "yes" if value else "no"
    if _is_number(value) and not isinstance(value, str):
        return f"{value:,}" if isinstance(value, (int, np.integer)) else rounded(float(value), digits)
    return str(value)


def label(text: object) -> str:
    """Text of the user for a place in a chart where Plotly reads tags: escaped."""
    return html_lib.escape(str(text), quote=False)


def _is_number(value: object) -> TypeGuard[int | float | str]:
    """Whether a cell stands at the right: a number, or the text of one."""
    if isinstance(value, str):
        return _NUMBER.fullmatch(value) is not None
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)


MEASURED, MODEL, FITTED = COLOURS[:3]
RESIDUAL = "#52606d"
PALE = "#d9dee4"
MARGIN = {"r": 16, "t": 56, "b": 48}
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
        "hovermode": "x unified",
    }
    return Chart(traces, layout, caption, height)


def one_of(label: str, options: Sequence[tuple[str, Sequence[Block]]], note: str = "") -> list[Block]:
    """One of several, chosen from a list where there is a choice; a note on what is left out."""
    shown = list(options[0][1]) if len(options) == 1 else [Choice(label, options)]
    return [*([Paragraph(note, small=True)] if note else []), *shown]


def min_max_indices(values: Array, points: int) -> Int64s:
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


def shared_indices(series: list[Array], points: int) -> Int64s:
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

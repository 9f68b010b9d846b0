"""The page: the blocks that a report is made of, and the HTML that draws them."""

from __future__ import annotations

import base64
import gzip
import html as html_lib
import itertools
import json
import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import resources
from pathlib import Path
from typing import Any, Literal, TypeAlias, TypeGuard

import numpy as np

from missionsim.files import plain

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
    """A line to type, under its heading."""

    label: str
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
_NUMBER = re.compile(r"[-+−]?[0-9][0-9.,]*(e[-−+]?[0-9]+)?")
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

    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("missionsim.report"),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
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
        number = float(value)
        if not math.isfinite(number):
            return "–"
        if isinstance(value, (int, np.integer)):
            return f"{value:,}"
        if number == 0:
            return "0"
        magnitude = math.floor(math.log10(abs(number)))
        if magnitude < -4 or magnitude > 8:
            return f"{number:.{digits - 1}e}"
        return f"{number:,.{max(0, digits - 1 - magnitude)}f}".replace("-", "−")
    return str(value)


def label(text: object) -> str:
    """Text of the user for a place in a chart where Plotly reads tags: escaped."""
    return html_lib.escape(str(text), quote=False)


def _is_number(value: object) -> TypeGuard[int | float | str]:
    """Whether a cell stands at the right: a number, or the text of one."""
    if isinstance(value, str):
        return _NUMBER.fullmatch(value) is not None
    return isinstance(value, (int, float, np.integer, np.floating)) and not isinstance(value, bool)

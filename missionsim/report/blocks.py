"""The building blocks of a report page: what stands in it, free of how it is drawn."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, TypeAlias

Tone = Literal["good", "warn", "bad", "neutral"]


@dataclass(frozen=True)
class Verdict:
    """The headline: one or two sentences in a coloured box.

    Attributes
    ----------
    text : str
        Plain text; escaped when drawn.
    tone : str
        ``good``, ``warn``, ``bad`` or ``neutral``; said by a word and a mark too, not by colour alone.
    """

    text: str
    tone: Tone = "neutral"


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
    """A table of texts and numbers.

    Attributes
    ----------
    columns : sequence of str
        Headings.
    rows : sequence of sequences
        Cells; numbers are right-aligned and written with `digits` significant digits, None as an en dash.
    caption : str
        What the table shows.
    digits : int
        Significant digits of the numbers.
    bar : int or None
        Index of a column of shares (0 to 1) that is drawn as a bar behind the number.
    """

    columns: Sequence[str]
    rows: Sequence[Sequence[Any]]
    caption: str = ""
    digits: int = 4
    bar: int | None = None


@dataclass(frozen=True)
class Chart:
    """A Plotly figure as plain data.

    Attributes
    ----------
    traces : sequence of mappings
        Plotly traces; arrays may be NumPy arrays.
    layout : mapping
        Plotly layout, laid over the house style.
    caption : str
        What one sees; also the text for readers who do not see the picture.
    height : int
        Pixels.
    """

    traces: Sequence[Mapping[str, Any]]
    layout: Mapping[str, Any] = field(default_factory=dict)
    caption: str = ""
    height: int = 380


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

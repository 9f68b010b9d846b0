"""What stands on the terminal: tables of at most 100 columns."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from missionsim.errors import visible
from missionsim.numerals import rounded

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text


def console(stderr: bool = False) -> Console:
    """A terminal for tables and text; at most 100 columns, and 100 where the output is not a terminal. Text is shown as
    it is: brackets of a name are no markup, colons no emoji, escape sequences no commands."""
    from rich.console import Console

    class Plain(Console):
        def render_str(self, text: str, **options: Any) -> Text:
            return super().render_str(visible(text), **options)

    plain: dict[str, Any] = {"stderr": stderr, "highlight": False, "markup": False, "emoji": False}
    terminal = Plain(**plain)
    return Plain(**plain, width=100) if not terminal.is_terminal or terminal.width > 100 else terminal


def titled(name: str, rest: str) -> Text:
    """A line that begins with a bold name."""
    from rich.text import Text

    return Text.assemble((visible(name), "bold"), visible(rest))


def simple_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A rich table; the headings of columns of numbers begin with ``>``, and these stand to the right."""
    from rich.table import Table

    table = Table(title=title, title_justify="left", title_style="bold", pad_edge=False)
    for column in columns:
        # a name that is cut off could be any of several
        table.add_column(column.removeprefix(">"), justify="right" if column[:1] == ">" else "left", overflow="fold")
    for row in rows:
        table.add_row(*(str(cell) for cell in row))
    return table


def show_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> None:
    """Print a `simple_table` on the terminal."""
    console().print(simple_table(title, columns, rows))


def signed(value: float | None, decimals: int | None = None, *, none: bool = False) -> str:
    """A number with its sign, so many decimals or else three significant digits; a dash where there is none, and with
    `none` where it rounds to nothing."""
    if value is None or not math.isfinite(value) or (none and round(value, decimals) == 0.0):
        return "–"
    value = round(value, 4 if decimals is None else decimals) + 0.0  # zero added makes a negative zero positive
    return rounded(value, sign=True) if decimals is None else f"{value:+.{decimals}f}".replace("-", "−")

"""What stands on the terminal: tables of at most 100 columns."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table


def console(stderr: bool = False) -> Console:
    """A terminal for tables and text; at most 100 columns, and 100 where the output is not a terminal."""
    from rich.console import Console

    terminal = Console(stderr=stderr, highlight=False)
    if not terminal.is_terminal or terminal.width > 100:
        terminal = Console(stderr=stderr, highlight=False, width=100)
    return terminal


def simple_table(title: str, columns: Iterable[str], rows: Iterable[Iterable[object]]) -> Table:
    """A rich table; the headings of columns of numbers begin with ``>``, and these stand to the right."""
    from rich.markup import escape
    from rich.table import Table

    table = Table(title=escape(title), title_justify="left", title_style="bold", pad_edge=False)
    for column in columns:
        # a name that is cut off could be any of several
        table.add_column(column.removeprefix(">"), justify="right" if column[:1] == ">" else "left", overflow="fold")
    for row in rows:
        table.add_row(*(escape(str(cell)) for cell in row))
    return table

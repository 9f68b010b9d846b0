"""`missionsim reproduce`: every published figure of the four robots beside ours."""

from __future__ import annotations

from typing import TYPE_CHECKING

from missionsim.cli.options import TERMINAL, OutFolder, Output
from missionsim.report.terminal import console

if TYPE_CHECKING:
    from typing import Any

    from missionsim.published.figures import Item

MOST_COLUMNS, MOST_ROWS = 7, 16


def reproduce(*robots: str, out: OutFolder | None = None, no_pictures: bool = False, to: Output = TERMINAL) -> int:
    """Print every published figure of the four robots beside ours, with what agrees and what does not.

    Parameters
    ----------
    robots
        Shipped robots (pioneer3dx, khepera3, mecanum4, rover_tx2); all of them if none is named.
    out
        Write the tables as CSV, one Markdown page and the pictures into this folder.
    no_pictures
        Draw no pictures.
    """
    from missionsim.published.figures import ABOUT
    from missionsim.published.reproduce import papers_of, reproduce_paper, side_tables, to_json, write

    papers = papers_of(robots)
    items: dict[str, list[Item]] = {}
    with to.progress() as bar:
        task = bar.add_task("papers", total=len(papers))
        for paper in papers:
            items[paper] = reproduce_paper(paper)
            bar.advance(task)
        tables = {paper: side_tables(paper) for paper in papers}
    to.emit(to_json([item for found in items.values() for item in found], tables))
    if to.text:
        for paper, found in items.items():
            _print(paper, found)
            for name, rows in tables[paper].items():
                _print_side(ABOUT[paper].tables[name], rows)
    if out is not None:
        written = write(out, items, tables, not no_pictures)
        if to.text:
            console().print(f"{len(written)} files in {out}")
    return 0


def _print(paper: str, items: list[Item]) -> None:
    """One table of a paper, notes numbered under it."""
    from rich.table import Table
    from rich.text import Text

    from missionsim.published.figures import ABOUT
    from missionsim.published.reproduce import counts, footnotes, number

    table = Table(title=ABOUT[paper].title, title_justify="left", title_style="bold", pad_edge=False)
    table.box, table.padding = None, (0, 1, 0, 0)
    widths = {"item": 27, "where": 9, ">published": 9, ">ours": 8, "unit": 6, ">differ.": 8, "status": 24, ">note": 4}
    for heading, width in widths.items():
        table.add_column(heading.strip(">"), justify="right" if heading[0] == ">" else "left", max_width=width)
    colours = {"agrees": "green", "calibrated": "blue", "differs": "red", "paper contradicts itself": "yellow"}
    references, notes = footnotes(items)
    for item, reference in zip(items, references, strict=True):
        f, status = item.figure, Text(item.status, colours.get(item.status, "dim"))
        apart = "" if item.difference is None else f"{item.difference:+.2g}"
        table.add_row(f.item, f.where, f.printed, number(item.ours), f.unit, apart, status, reference)
    terminal = console()
    terminal.print(table)
    for index, note in enumerate(notes, start=1):
        terminal.print(f"  {index:3d} {note}", style="dim")
    terminal.print(f"{counts(items)}.\n", style="bold")


def _print_side(words: str, rows: list[dict[str, Any]]) -> None:
    """A table beside the figures; wide ones stand on their side, long ones are in the CSV file only."""
    from rich.table import Table

    wide = len(rows[0]) > MOST_COLUMNS
    if len(rows) > (MOST_COLUMNS - 1 if wide else MOST_ROWS):
        return
    columns = list(rows[0])
    shown = [[row[column] for column in columns] for row in rows]
    body = [[f"{cell:.4g}" if isinstance(cell, float) else str(cell) for cell in line] for line in shown]
    if wide:
        body = [[column, *(line[i] for line in body)] for i, column in enumerate(columns)]
        columns = ["", *(str(i + 1) for i in range(len(rows)))]
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    for index, column in enumerate(columns):
        table.add_column(column, justify="left" if index == 0 else "right", overflow="fold")
    for line in body:
        table.add_row(*line)
    terminal = console()
    terminal.print(words, style="bold")
    terminal.print(table)
    terminal.print()

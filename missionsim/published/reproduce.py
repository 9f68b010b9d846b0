"""Reproduce the papers: items, CSV files, one Markdown page, pictures."""

from __future__ import annotations

import csv
import importlib
import io
from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from missionsim.errors import InputError
from missionsim.files import write_text
from missionsim.published.figures import ABOUT, HEAD, PAPERS, STATUSES, Item, judge_all, numbers_of_robot

SCHEMA = "missionsim.reproduction/1"
Tables = dict[str, list[dict[str, Any]]]
"""Name → rows."""
COLUMNS = ("item", "where", "published", "ours", "unit", "difference", "tolerance", "rule", "status", "note", "key")


def papers_of(robots: Sequence[str]) -> list[str]:
    """Papers of the named robots (all if none); a paper's own name counts too.

    Raises InputError: for a name without a paper.
    """
    known = {**PAPERS, **{paper: paper for paper in PAPERS.values()}}
    for name in robots:
        if name not in known:
            raise InputError.unknown(f"no published robot '{name}'", name, known, allowed=", ".join(PAPERS))
    return list(dict.fromkeys(known[name] for name in robots)) or list(PAPERS.values())


def reproduce_paper(paper: str) -> list[Item]:
    """Every figure of a paper beside ours."""
    module: Any = importlib.import_module(f"missionsim.published.{paper}")
    return judge_all(paper, {**numbers_of_robot(paper), **module.ours()})


def side_tables(paper: str) -> Tables:
    """Tables beside the figures of a paper, by name."""
    from missionsim.published.tables import TABLES

    return {name: TABLES[name]() for name in ABOUT[paper].tables}


def to_json(items: Iterable[Item], tables: dict[str, Tables] | None = None) -> dict[str, object]:
    """The contract's JSON, and beside the items the other tables by paper."""
    return {"schema": SCHEMA, "items": [item.to_json() for item in items], "tables": tables or {}}


def number(value: float | None) -> str:
    """A number as the tables show it: six significant digits, so that it is the same on every machine."""
    if value is None:
        return ""
    text = f"{value:.6g}"
    return "0" if float(text) == 0.0 or abs(value) < 1e-12 else text


def items_csv(items: Iterable[Item]) -> str:
    """The reproduction table as CSV text."""
    rows = []
    for item in items:
        row = item.to_json()
        row["published"] = row["printed"]
        close = item.difference is not None and abs(item.difference) < 1e-9 * max(1.0, abs(item.figure.value))
        row["difference"] = 0.0 if close else item.difference
        rows.append([_cell(row[name]) for name in COLUMNS])
    return _csv(COLUMNS, rows)


def _cell(value: Any) -> str:
    if isinstance(value, float) or value is None:
        return number(value)
    return str(value)


def _csv(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(header)
    writer.writerows(rows)
    return text.getvalue()


def counts(items: Sequence[Item]) -> str:
    """How many items have which status, in words."""
    found = Counter(item.status for item in items)
    return f"{len(items)} figures: " + ", ".join(f"{found[status]} {status}" for status in STATUSES if found[status])


def footnotes(items: Sequence[Item]) -> tuple[list[str], list[str]]:
    """Notes of the items as references ([1], [2] …) and the list of distinct notes."""
    notes: dict[str, int] = {}
    references = []
    for item in items:
        references.append(str(notes.setdefault(item.note, len(notes) + 1)) if item.note else "")
    return references, list(notes)


def files(items: dict[str, list[Item]], tables: dict[str, Tables]) -> dict[str, str]:
    """Every text file of ``results/published``, by name: CSV tables and the Markdown page."""
    result: dict[str, str] = {}
    for paper, found in items.items():
        result[f"{paper}.csv"] = items_csv(found)
        for name, rows in tables[paper].items():
            result[f"{paper}_{name}.csv"] = _csv(list(rows[0]), [[_cell(v) for v in row.values()] for row in rows])
    result["README.md"] = page(items, tables)
    return result


def write(out: Path, items: dict[str, list[Item]], tables: dict[str, Tables], pictures: bool = True) -> list[Path]:
    """Write tables, page and pictures into a folder; each file whole or not at all.

    Gives what was written.
    """
    written = []
    for name, text in files(items, tables).items():
        write_text(out / name, text)
        written.append(out / name)
    if pictures:
        from missionsim.published.pictures import draw

        for paper in items:
            written.extend(draw(paper, out))
    return written


def page(items: dict[str, list[Item]], tables: dict[str, Tables]) -> str:
    """The page for some papers."""
    parts = [HEAD]
    for paper, found in items.items():
        about = ABOUT[paper]
        parts.append(f"## {about.robot}: {about.title}\n\n{about.reading}\n\n{counts(found)}.\n")
        parts += [f"![{title}]({paper}_{name}.png)\n*{title}*\n" for name, title in about.pictures.items()]
        for name, rows in tables[paper].items():
            parts.append(f"**{about.tables[name]}** ([CSV]({paper}_{name}.csv))\n")
            parts.append(_table(list(rows[0]), [[_short(v) for v in row.values()] for row in rows[:26]]))
            if len(rows) > 26:
                parts.append(f"… and {len(rows) - 26} more rows in the CSV file.\n")
        references, notes = footnotes(found)
        body = [
            [f.item, f.where, f.printed, number(item.ours), f.unit, item.status, reference]
            for item, reference in zip(found, references, strict=True)
            for f in (item.figure,)
        ]
        parts.append(f"### Every figure of {paper} ([CSV]({paper}.csv))\n")
        parts.append(_table(["item", "where", "published", "ours", "unit", "status", "note"], body))
        parts.append("Notes\n")
        parts.append("\n".join(f"{i}. {note}" for i, note in enumerate(notes, start=1)) + "\n")
    return "\n".join(parts)


def _short(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def _table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    lines += ["| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows]
    return "\n".join(lines) + "\n"

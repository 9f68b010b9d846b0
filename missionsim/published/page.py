"""The Markdown page of ``results/published``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from missionsim.published.figures import ABOUT, HEAD, Item


def page(items: dict[str, list[Item]], tables: dict[str, dict[str, list[dict[str, Any]]]]) -> str:
    """The page for some papers."""
    from missionsim.published.reproduce import counts, footnotes, number

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

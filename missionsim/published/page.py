"""The Markdown page of ``results/published``."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from missionsim.published.figures import PAPERS, TITLES, Item

HEAD = """# Published figures beside ours

Written by `missionsim reproduce --out results/published`; a test fails when it is stale. Every figure that the four
papers print stands here, none is left out. The status says:

* **agrees**: computed from the robot and mission files, equal within the rounding of print (`tolerance` in the CSV);
* **calibrated**: taken over as an input, or a file was fitted to it – never a prediction;
* **paper contradicts itself**: our value does not meet it, and the note says which other statement excludes it;
* **cannot be checked**: nothing is printed from which it could be computed;
* **differs**: computed, and not equal within the rounding of print.

Tolerance, rule of rounding and key of each figure are in the CSV file of its paper.
"""
WORDS: dict[str, str] = {
    "optimal_velocities": "Optimal velocities by sensor set (Eq. 11). All lie above the 0.75 m/s that the robot "
    "reaches.",
    "stretch_test": "Table 5, honest test: the stretch of each run is fitted to the other two velocities of its "
    "scheme.",
    "stretch_summary": "What the stretch gains on runs that its fit has not seen.",
    "patrol_errors": "The patrol's error statistics by both definitions. The patrol as driven is calibrated to these "
    "very statistics (relative to predicted), it predicts nothing.",
    "patrol_uncertainty": "The same statistics when path stretch and speed come from their causes (relocalisation by "
    "QR codes with drift between, headings that settle, irregular walls), with assumed spreads: 5 %, 50 %, 95 % of "
    "2000 draws.",
    "static_powers": "The one solution of the four printed percentages (fitted).",
    "components": "The sequence of operations on a simulated record with 0.05 W of noise.",
    "model_errors": "Model errors over the 13 moving samples of each table. The robot file has five parameters for "
    "both tables; the duration of the start is a sixth choice.",
    "identifiability": "The mass is not identified: starts of different shape fit as well with masses from 2 to 10 kg.",
    "directions": "Power by direction. Below the middle friction ratio 45° is the least, above it straight ahead: the "
    "paper's two statements need different ratios.",
    "optima": "Joint optimum of speed and clock with quality of service, for both readings of the printed speeds.",
    "fidelity": "Error of each fidelity level against direct evaluation.",
}
READING: dict[str, str] = {
    "jaiem2021": "The power tables are reproduced to the last digit but for row 9 of Table 4, which contradicts "
    "itself. The paper cuts digits in Eq. 10, Eq. 12 and Table 5. In Table 5 predicted and experiment are interchanged "
    "at 0.3 m/s (forward motion); the errors of the QR-code runs follow from cut predictions, those of the centring "
    "runs from uncut ones, and with that every printed error but two is met.",
    "parasuraman2012": "Only Eq. 15 and four percentages are printed; the static powers are fitted to the percentages. "
    "Without time spent standing they contradict each other.",
    "hou2019": "No equation of the motion model can be evaluated as printed. Five parameters fitted to the measured "
    "columns of Tables 3 and 4 give smaller errors than the paper's own model in both tables.",
    "rover2025": "With Table 1 in SI units the drive takes 73 W at 7.5 m/s and the joint optimum lies near 2.75 m/s. "
    "Constant power of 81 W would be needed for the printed optimum. Were the printed speeds km/h, the optimum would "
    "come out as printed; the text gives no hint of that. Computing powers and loop times are not printed and are "
    "fitted or assumed.",
}


def page(items: dict[str, list[Item]], tables: dict[str, dict[str, list[dict[str, Any]]]]) -> str:
    """The page for some papers."""
    from missionsim.published.pictures import PICTURES
    from missionsim.published.reproduce import counts, footnotes, number

    parts = [HEAD]
    robots = {paper: robot for robot, paper in PAPERS.items()}
    for paper, found in items.items():
        parts.append(f"## {robots[paper]}: {TITLES[paper]}\n\n{READING[paper]}\n\n{counts(found)}.\n")
        parts += [f"![{title}]({paper}_{name}.png)\n*{title}*\n" for name, title, _ in PICTURES[paper]]
        for name, rows in tables[paper].items():
            parts.append(f"**{WORDS[name]}** ([CSV]({paper}_{name}.csv))\n")
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

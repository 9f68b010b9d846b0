"""Tables of a comparison as files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from operator import attrgetter
from pathlib import Path

from missionsim.compare import Comparison
from missionsim.compare.behaviour import PARTS
from missionsim.files import atomic_write, csv_cell

RUNS = (
    *("run", "seconds", "energy_measured_wh", "energy_model_wh", "energy_error_pct", "power_rmse_w", "power_bias_w"),
    *(f"error_statistics.{name}_pct" for name in ("peak", "final", "mean", "std")),
)
WHERE = (
    *("by", "value", "low", "high", "unit", "explains", "share_of_squared_error", "share_of_gap", "gap_wh", "bias_w"),
    "seconds",
)
BEHAVIOUR = ("scheme", "path_stretch", "speed_tracking", "dwell_s", "planned_m", "driven_m", "planned_s", "driven_s")
"""Columns of a table: attributes of what its rows tell."""


def write_tables(comparison: Comparison, folder: Path) -> list[Path]:
    """Write ``runs.csv``, ``where.csv``, ``terms.csv`` and, with a mission, ``behaviour.csv``.

    Parameters
    ----------
    comparison : Comparison
    folder : Path
        Made where it is not there.

    Returns
    -------
    list of Path
        The files written.
    """
    batteries = list(comparison.batteries.values())
    tables: dict[str, tuple[Sequence[str], list[Sequence[object]]]] = {
        "runs": (RUNS, [(b.battery, *attrgetter(*RUNS)(run)) for b in batteries for run in b.runs]),
        "where": (WHERE, [(b.battery, *attrgetter(*WHERE)(where)) for b in batteries for where in b.where]),
        "terms": (
            ("run", "component", "term", "energy_wh"),
            [
                (b.battery, run.run, key.component, key.name, energy)
                for b in batteries
                for run in b.runs
                for key, energy in run.by_term_wh.items()
            ],
        ),
    }
    if comparison.mission:
        rows: list[Sequence[object]] = [
            (b.battery, *attrgetter(*BEHAVIOUR)(scheme), *(scheme.wh[b.battery][part] for part in PARTS))
            for b in batteries
            for scheme in (b.mission.schemes if b.mission is not None else ())
        ]
        tables["behaviour"] = ((*BEHAVIOUR, *(f"{part}_wh" for part in PARTS)), rows)
    return [_write(folder / f"{name}.csv", columns, found) for name, (columns, found) in tables.items()]


def _write(path: Path, columns: Sequence[str], rows: Iterable[Sequence[object]]) -> Path:
    with atomic_write(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(["battery", *(column.rpartition(".")[2] for column in columns)])
        writer.writerows(["" if cell is None or cell != cell else csv_cell(cell) for cell in row] for row in rows)
    return path

"""A comparison as tables: on the terminal, at most 100 columns wide, and as CSV files."""

from __future__ import annotations

import csv
import math
from collections.abc import Iterable, Sequence
from operator import attrgetter
from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.compare import BatteryComparison, Comparison
from missionsim.compare.behaviour import PARTS
from missionsim.files import atomic_write, csv_cell
from missionsim.report.terminal import signed, simple_table

if TYPE_CHECKING:
    from rich.console import Console

WHERE_ROWS = 10
RUN_ROWS = 24


def print_comparison(comparison: Comparison, console: Console) -> None:
    """Print the verdict, the numbers by battery and run, where it fails, and what was assumed."""
    _summary(comparison, console)
    for one in comparison.batteries.values():
        console.print()
        for sentence in one.words:
            console.print(sentence)
        _where(one, console)
        _behaviour(one, console)
        _runs(one, console)
    if comparison.notes:
        console.print("\nAssumed and remarked", style="bold")
        for note in comparison.notes:
            console.print(f"- {note}")


def _summary(comparison: Comparison, console: Console) -> None:
    count = len(comparison.runs)
    title = f"{comparison.robot or 'model'}: model against measurements, {count} {'runs' if count != 1 else 'run'}"
    columns = [
        *("battery", ">measured Wh", ">model Wh", ">error %", ">RMSE W", ">bias W"),
        *(">peak %", ">final %", ">mean %", ">std %"),
    ]
    rows = []
    for one in comparison.batteries.values():
        found = one.error_statistics
        row = [one.battery, f"{one.energy_measured_wh:.3f}", f"{one.energy_model_wh:.3f}"]
        row += [_plain(one.energy_error_pct, "+.2f"), f"{one.power_rmse_w:.3g}", f"{one.power_bias_w:+.3g}"]
        row += map(_plain, (found.peak_pct, found.final_pct, found.mean_pct, found.std_pct))
        rows.append(row)
    console.print(simple_table(title, columns, rows))
    notes = ["error: model minus measured; peak, final, mean, std: its magnitude over the progress of the runs"]
    untold = [name for name, one in comparison.batteries.items() if not math.isfinite(one.error_statistics.final_pct)]
    if untold:
        notes.append(f"no relative error over progress for {', '.join(untold)}: the energy measured is not above zero")
    for note in notes:
        console.print(note, style="dim")


def _where(one: BatteryComparison, console: Console) -> None:
    rows = [
        (
            where.title,
            f"{where.value} {where.unit}".strip(),
            f"{100.0 * where.explains:.1f}",
            f"{where.bias_w:+.3g}",
            f"{where.seconds:.0f}",
            f"{100.0 * where.share_of_squared_error:.0f}",
            f"{where.gap_wh:+.3f}",
        )
        for where in one.where
        if where.explains > 0.0
    ][:WHERE_ROWS]
    if rows:
        columns = ["quantity", "value", ">explains %", ">bias W", ">time s", ">sq. error %", ">gap Wh"]
        console.print(simple_table(f"Where it fails, battery {one.battery}", columns, rows))
        note = "explains: part of the error's variance that goes with the value; what varies together shares it"
        console.print(note, style="dim")


def _behaviour(one: BatteryComparison, console: Console) -> None:
    if one.mission is None:
        return
    gap = one.gap_wh
    console.print(
        f"measured − simulated {signed(gap['total'], 4)} Wh = power model {signed(gap['power_model'], 4)} Wh "
        f"+ behaviour {signed(gap['behaviour'], 4)} Wh"
    )
    rows = [
        (
            scheme.scheme or "–",
            *("–" if ratio is None else f"{ratio:.3f}" for ratio in (scheme.path_stretch, scheme.speed_tracking)),
            f"{scheme.dwell_s:+.0f}",
            *(signed(scheme.wh[one.battery][part], 4) for part in PARTS),
        )
        for scheme in one.mission.schemes
    ]
    columns = ["scheme", ">way ×", ">speed ×", ">dwell s", ">way Wh", ">speed Wh", ">stand Wh", ">rest Wh"]
    console.print(simple_table("Behaviour against the plan", columns, rows))


def _runs(one: BatteryComparison, console: Console) -> None:
    if len(one.runs) < 2:
        return
    shown = sorted(one.runs, key=lambda run: -abs(run.energy_error_pct))[:RUN_ROWS]
    more = f", the {RUN_ROWS} worst of {len(one.runs)}" if len(one.runs) > RUN_ROWS else ""
    rows = [
        (
            run.run,
            f"{run.seconds:.0f}",
            f"{run.energy_measured_wh:.3f}",
            f"{run.energy_model_wh:.3f}",
            _plain(run.energy_error_pct, "+.2f"),
            f"{run.power_rmse_w:.3g}",
        )
        for run in one.runs
        if run in shown
    ]
    columns = ["run", ">time s", ">measured Wh", ">model Wh", ">error %", ">RMSE W"]
    console.print(simple_table(f"Runs, battery {one.battery}{more}", columns, rows))


def _plain(value: float, form: str = ".2f") -> str:
    return format(value, form) if math.isfinite(value) else "–"


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

    `folder`: made where it is not there. Gives the files written.
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

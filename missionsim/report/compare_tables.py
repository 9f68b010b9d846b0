"""Tables and pictures of a comparison as files."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from missionsim.compare import BatteryComparison, Comparison
from missionsim.compare.behaviour import PARTS
from missionsim.files import atomic_write


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
    written = [
        _write(
            folder / "runs.csv",
            (
                "battery",
                "run",
                "seconds",
                "energy_measured_wh",
                "energy_model_wh",
                "energy_error_pct",
                "power_rmse_w",
                "power_bias_w",
                "peak_pct",
                "final_pct",
                "mean_pct",
                "std_pct",
            ),
            (row for b in batteries for row in _runs(b)),
        ),
        _write(
            folder / "where.csv",
            (
                "battery",
                "by",
                "value",
                "low",
                "high",
                "unit",
                "explains",
                "share_of_squared_error",
                "share_of_gap",
                "gap_wh",
                "bias_w",
                "seconds",
            ),
            (row for b in batteries for row in _where(b)),
        ),
        _write(
            folder / "terms.csv",
            ("battery", "run", "component", "term", "energy_wh"),
            (
                (b.battery, run.run, key.component, key.name, energy)
                for b in batteries
                for run in b.runs
                for key, energy in run.by_term_wh.items()
            ),
        ),
    ]
    if comparison.mission:
        written.append(
            _write(
                folder / "behaviour.csv",
                (
                    "battery",
                    "scheme",
                    "path_stretch",
                    "speed_tracking",
                    "dwell_s",
                    "planned_m",
                    "driven_m",
                    "planned_s",
                    "driven_s",
                    *(f"{part}_wh" for part in PARTS),
                ),
                (row for b in batteries for row in _behaviour(b)),
            )
        )
    return written


def _runs(one: BatteryComparison) -> Iterable[Sequence[Any]]:
    for run in one.runs:
        found = run.error_statistics
        yield (
            one.battery,
            run.run,
            run.seconds,
            run.energy_measured_wh,
            run.energy_model_wh,
            run.energy_error_pct,
            run.power_rmse_w,
            run.power_bias_w,
            found.peak_pct,
            found.final_pct,
            found.mean_pct,
            found.std_pct,
        )


def _where(one: BatteryComparison) -> Iterable[Sequence[Any]]:
    for where in one.where:
        yield (
            one.battery,
            where.by,
            where.value,
            where.low,
            where.high,
            where.unit,
            where.explains,
            where.share_of_squared_error,
            where.share_of_gap,
            where.gap_wh,
            where.bias_w,
            where.seconds,
        )


def _behaviour(one: BatteryComparison) -> Iterable[Sequence[Any]]:
    for scheme in one.mission.schemes if one.mission is not None else ():
        yield (
            one.battery,
            scheme.scheme,
            scheme.path_stretch,
            scheme.speed_tracking,
            scheme.dwell_s,
            scheme.planned_m,
            scheme.driven_m,
            scheme.planned_s,
            scheme.driven_s,
            *(scheme.wh[one.battery][part] for part in PARTS),
        )


def _write(path: Path, columns: Sequence[str], rows: Iterable[Sequence[Any]]) -> Path:
    with atomic_write(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows(["" if cell is None or cell != cell else cell for cell in row] for row in rows)
    return path

"""A comparison on the terminal: tables that fit 100 columns."""

from __future__ import annotations

import math
from typing import Any

from missionsim.compare import BatteryComparison, Comparison
from missionsim.compare.behaviour import PARTS

WHERE_ROWS = 10
RUN_ROWS = 24


def print_comparison(comparison: Comparison, console: Any) -> None:
    """Print the verdict, the numbers by battery and run, where it fails, and what was assumed.

    Parameters
    ----------
    comparison : Comparison
    console : rich.console.Console
    """
    _summary(comparison, console)
    for one in comparison.batteries.values():
        console.print()
        for sentence in one.words:
            console.print(sentence, markup=False)
        _where(one, console)
        _behaviour(one, console)
        _runs(one, console)
    if comparison.notes:
        console.print("\n[bold]Assumed and remarked[/bold]")
        for note in comparison.notes:
            console.print(f"- {note}", markup=False)


def _summary(comparison: Comparison, console: Any) -> None:
    table = _table(
        f"{comparison.robot or 'model'}: model against measurements, {len(comparison.runs)} "
        f"{'runs' if len(comparison.runs) != 1 else 'run'}"
    )
    for heading in (
        "battery",
        "measured Wh",
        "model Wh",
        "error %",
        "RMSE W",
        "bias W",
        "peak %",
        "final %",
        "mean %",
        "std %",
    ):
        table.add_column(heading, justify="left" if heading == "battery" else "right")
    for one in comparison.batteries.values():
        found = one.error_statistics
        table.add_row(
            one.battery,
            f"{one.energy_measured_wh:.3f}",
            f"{one.energy_model_wh:.3f}",
            _plain(one.energy_error_pct, "+.2f"),
            f"{one.power_rmse_w:.3f}",
            f"{one.power_bias_w:+.3f}",
            _plain(found.peak_pct),
            _plain(found.final_pct),
            _plain(found.mean_pct),
            _plain(found.std_pct),
        )
    console.print(table)
    console.print(
        "error: model minus measured; peak, final, mean, std: its magnitude over the progress of the runs", style="dim"
    )
    untold = [name for name, one in comparison.batteries.items() if not math.isfinite(one.error_statistics.final_pct)]
    if untold:
        console.print(
            f"no relative error over progress for {', '.join(untold)}: the energy measured is not above zero",
            style="dim",
        )


def _where(one: BatteryComparison, console: Any) -> None:
    rows = [where for where in one.where if where.explains > 0.0][:WHERE_ROWS]
    if not rows:
        return
    table = _table(f"Where it fails, battery {one.battery}")
    table.add_column("quantity", max_width=26, overflow="fold")
    table.add_column("value", max_width=24, overflow="fold")
    for heading in ("explains %", "bias W", "time s", "sq. error %", "gap Wh"):
        table.add_column(heading, justify="right")
    for where in rows:
        table.add_row(
            where.title,
            f"{where.value} {where.unit}".strip(),
            f"{100.0 * where.explains:.1f}",
            f"{where.bias_w:+.2f}",
            f"{where.seconds:.0f}",
            f"{100.0 * where.share_of_squared_error:.0f}",
            f"{where.gap_wh:+.3f}",
        )
    console.print(table)
    console.print(
        "explains: part of the error's variance that goes with the value; what varies together shares it", style="dim"
    )


def _behaviour(one: BatteryComparison, console: Any) -> None:
    if one.mission is None:
        return
    gap = one.gap_wh
    console.print(
        f"measured − simulated {_signed(gap['total'])} Wh = power model {_signed(gap['power_model'])} Wh "
        f"+ behaviour {_signed(gap['behaviour'])} Wh",
        markup=False,
    )
    table = _table("Behaviour against the plan")
    table.add_column("scheme", max_width=26, overflow="fold")
    for heading in ("way ×", "speed ×", "dwell s", *(f"{name} Wh" for name in ("way", "speed", "stand", "rest"))):
        table.add_column(heading, justify="right")
    for scheme in one.mission.schemes:
        table.add_row(
            scheme.scheme or "–",
            _ratio(scheme.path_stretch),
            _ratio(scheme.speed_tracking),
            f"{scheme.dwell_s:+.0f}",
            *(_signed(scheme.wh[one.battery][part]) for part in PARTS),
        )
    console.print(table)


def _runs(one: BatteryComparison, console: Any) -> None:
    if len(one.runs) < 2:
        return
    shown = sorted(one.runs, key=lambda run: -abs(run.energy_error_pct))[:RUN_ROWS]
    more = f", the {RUN_ROWS} worst of {len(one.runs)}" if len(one.runs) > RUN_ROWS else ""
    table = _table(f"Runs, battery {one.battery}{more}")
    table.add_column("run", max_width=40, overflow="fold")
    for heading in ("time s", "measured Wh", "model Wh", "error %", "RMSE W"):
        table.add_column(heading, justify="right")
    for run in [run for run in one.runs if run in shown]:
        table.add_row(
            run.run,
            f"{run.seconds:.0f}",
            f"{run.energy_measured_wh:.3f}",
            f"{run.energy_model_wh:.3f}",
            _plain(run.energy_error_pct, "+.2f"),
            f"{run.power_rmse_w:.3f}",
        )
    console.print(table)


def _table(title: str) -> Any:
    from rich.table import Table

    return Table(title=title, title_justify="left", title_style="bold", pad_edge=False)


def _plain(value: float, form: str = ".2f") -> str:
    return format(value, form) if math.isfinite(value) else "–"


def _signed(value: float | None) -> str:
    if value is None or not math.isfinite(value):
        return "–"
    # adding zero makes a negative zero positive
    return f"{round(value, 4) + 0.0:+.4f}".replace("-", "−")


def _ratio(value: float | None) -> str:
    return "–" if value is None else f"{value:.3f}"

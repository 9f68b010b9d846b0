"""`missionsim improve`: compare, diagnose, add, compare again, until nothing is left to find."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from missionsim.cli.options import TERMINAL, OutFile, Output, RobotFile, Search
from missionsim.report.terminal import console, simple_table

if TYPE_CHECKING:
    from missionsim.diagnose.improve import Improved
    from missionsim.identify.findings import BatteryDiagnosis, Finding


def improve(
    *logs: Path, search: Search, out: RobotFile, yes: bool = False, report: OutFile | None = None, to: Output = TERMINAL
) -> int:
    """Compare, diagnose, add what is missing and compare again, until nothing is left to find.

    Asks before each step on a terminal. Never adds one of several effects that the logs cannot tell apart. Exits with
    code 1 where the file predicts the held-out runs worse.

    Parameters
    ----------
    logs
        Log files or folders of them.
    out
        Robot file to write.
    yes
        Add every effect that was identified, without asking.
    report
        Write an interactive page to this HTML file.
    """
    from missionsim.diagnose.improve import improve as run_improve
    from missionsim.errors import InputError
    from missionsim.files import write_text
    from missionsim.inputs.edit import for_folder, robot_text

    search.check(logs)
    if not yes and not sys.stdin.isatty():
        raise InputError.single(
            "improve asks before it adds an effect, and this is no terminal",
            allowed="--yes to add every effect that was identified",
        )
    spec, split, tables, left_out = search.read(logs, to)
    text = robot_text(search.robot)
    wanted = [search.battery] if search.battery is not None else _batteries(spec, tables)
    done: list[Improved] = []
    skipped: dict[str, InputError] = {}
    for name in wanted:
        try:
            result = run_improve(text, split, name, search.settings, _always if yes else _ask)
        except InputError as error:
            skipped[name] = error
            continue
        done.append(result)
        text = result.text
    if not done:
        raise next(iter(skipped.values()))
    write_text(out, for_folder(text, out.parent))
    to.emit(_as_json(done, skipped, out, split.how) | {"left_out": left_out})
    if report is not None:
        from missionsim.report.improve_page import improve_page

        write_text(report, improve_page(spec.name, done))
    if to.text:
        _print(done, skipped, out, report)
    return 1 if left_out or any(one.worse for one in done) else 0


def _batteries(spec: Any, tables: list[Any]) -> list[str]:
    measured = list(dict.fromkeys(name for log in tables for name in log.power_w))
    return [name for name in measured if name in spec.batteries] or measured


def _always(finding: Finding, diagnosis: BatteryDiagnosis) -> bool:
    return True


def _ask(finding: Finding, diagnosis: BatteryDiagnosis) -> bool:
    from rich.prompt import Confirm

    from missionsim.diagnose import words

    terminal = console(stderr=True)
    terminal.print(words.found_line(finding))
    if finding.heldout_rmse_before_w is not None and finding.heldout_rmse_after_w is not None:
        terminal.print(
            f"power error on held-out runs {finding.heldout_rmse_before_w:.3g} -> {finding.heldout_rmse_after_w:.3g} W"
        )
    return Confirm.ask(f"add {finding.effect} to battery {diagnosis.battery}?", default=True, console=terminal)


def _as_json(done: list[Improved], skipped: dict[str, Any], out: Path, how: str) -> dict[str, Any]:
    return {
        "schema": "missionsim.improvement/1",
        "robot_file": str(out),
        "holdout": how,
        "batteries": {
            one.battery: {
                "added": list(one.added),
                "declined": list(one.declined),
                "stopped": one.stopped,
                "on_heldout_runs": one.heldout,
                "steps": [
                    {"name": s.name, "energy_error_pct": s.energy_error_pct, "power_rmse_w": s.power_rmse_w}
                    for s in one.steps
                ],
                "worse": one.worse or None,
                "first": one.first.to_json(),
                "last": one.last.to_json(),
            }
            for one in done
        },
        "skipped": {name: " ".join(str(error).split()) for name, error in skipped.items()},
    }


def _print(done: list[Improved], skipped: dict[str, Any], out: Path, report: Path | None) -> None:
    from missionsim.diagnose.waterfall import energy_note, measured_note

    terminal = console()
    for one in done:
        which = "held-out runs" if one.heldout else "fitted runs (none held out)"
        most = max(step.power_rmse_w for step in one.steps) or 1.0
        rows = [
            (
                step.name,
                f"{step.energy_error_pct:.2f}",
                f"{step.power_rmse_w:.3g}",
                "█" * max(1, round(18 * step.power_rmse_w / most)),
            )
            for step in one.steps
        ]
        if one.worse:
            terminal.print(one.worse, style="bold red")
        terminal.print(
            simple_table(
                f"Battery {one.battery}: error on {which}", ["model", ">energy error, %", ">power RMSE, W", ""], rows
            )
        )
        terminal.print(f"added: {', '.join(one.added) or 'nothing'}; {one.stopped}")
        for note in (energy_note(one) if not one.worse else "", measured_note(one)):
            if note:
                terminal.print(note)
    for name, error in skipped.items():
        terminal.print(f"battery {name} was left as it is: {' '.join(str(error).split())}")
    terminal.print(f"written: {out}")
    if report is not None:
        terminal.print(f"report written: {report}")

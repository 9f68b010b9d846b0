"""`missionsim diagnose`: which physical effect is missing, or what to drive to find out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.cli.options import TERMINAL, OutFile, Output, Search, tell_left_out
from missionsim.report.terminal import console

if TYPE_CHECKING:
    from missionsim.identify.findings import Diagnosis


def diagnose(
    *logs: Path, search: Search, mission: Path | None = None, report: OutFile | None = None, to: Output = TERMINAL
) -> int:
    """Find which physical effect the robot's model lacks, or say that these data cannot tell and what to drive next.

    Parameters
    ----------
    logs
        Log files or folders of them.
    mission
        The mission that was driven; with it the robot's behaviour (longer, slower, waiting) is examined as well.
    report
        Write an interactive page to this HTML file.
    """
    from missionsim.diagnose import diagnose_files

    search.check(logs)
    left_out: list[str] = []
    remarks: list[str] = []
    result = diagnose_files(
        search.robot,
        list(logs),
        holdout=search.holdout,
        mission=mission,
        battery=search.battery,
        alpha=search.alpha,
        align=not search.no_align,
        on_left_out=left_out.extend,
        on_remark=remarks.extend,
    )
    tell_left_out(left_out)
    to.emit(result.to_json() | {"left_out": left_out})
    if report is not None:
        from missionsim.files import write_text
        from missionsim.report.diagnosis_page import diagnosis_page

        write_text(report, diagnosis_page(result, footer=_footer(), robot=search.robot, logs=logs))
    if to.text:
        show(result, search.robot, logs)
        for line in remarks:
            console().print(line)
        if report is not None:
            console().print(f"report written: {report}")
    return 1 if left_out else 0


def show(result: Diagnosis, robot: str, logs: Sequence[Path]) -> None:
    """Print a diagnosis: what is missing, how sure, the error, what to type; then the report lines."""
    from rich.table import Table

    from missionsim.diagnose import sentences, words

    terminal = console()
    for battery in result.batteries.values():
        terminal.print(words.headline(battery), style="bold")
        for line in (sentences.sure(battery), sentences.errors(battery)):
            if line:
                terminal.print(line)
        command = sentences.next_step(battery, robot, logs, len(result.batteries) > 1)
        if command:
            terminal.print("Next, type:")
            terminal.print(f"    {command}", style="cyan", soft_wrap=True)
        grid = Table.grid(padding=(0, 2))
        grid.add_column(no_wrap=True)
        grid.add_column()
        last = ""
        for heading, line in words.report(battery):
            grid.add_row("" if heading == last else heading, line)
            last = heading
        terminal.print(grid)
        terminal.print()
    for name, why in result.skipped.items():
        terminal.print(f"Battery {name} was not diagnosed: {why}")


def _footer() -> str:
    from missionsim import __version__

    return f"missionsim {__version__}, missionsim diagnose"

"""`missionsim diagnose`: which physical effect is missing, or what to drive to find out."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from missionsim.cli.common import check_search, emit_json, shows_text, tell_left_out
from missionsim.cli.options import FALSE_ALARM_RATE, JsonOption, QuietOption
from missionsim.report.terminal import console

if TYPE_CHECKING:
    from missionsim.identify.findings import Diagnosis

RobotOption = Annotated[str, Parameter(name="--robot")]
HoldoutOption = Annotated[list[str] | None, Parameter(name="--holdout")]
MissionOption = Annotated[Path | None, Parameter(name="--mission")]
ReportOption = Annotated[Path | None, Parameter(name="--report")]


def diagnose(
    *logs: Path,
    robot: RobotOption,
    mission: MissionOption = None,
    holdout: HoldoutOption = None,
    battery: Annotated[str | None, Parameter(name="--battery")] = None,
    alpha: Annotated[float, Parameter(name="--alpha")] = FALSE_ALARM_RATE,
    no_align: Annotated[bool, Parameter(name="--no-align", negative="")] = False,
    report: ReportOption = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
) -> int:
    """Find which physical effect the robot's model lacks, or say that these data cannot tell and what to drive next.

    Parameters
    ----------
    logs
        Log files or folders of them.
    robot
        Shipped robot's name or a robot file.
    mission
        The mission that was driven; with it the robot's behaviour (longer, slower, waiting) is examined as well.
    holdout
        Runs that are not fitted but tested on: a fraction, run names with commas between, a condition such as
        "surface == 'carpet'", or files and folders of other logs; none for no hold-out. By default the last quarter of
        four or more runs.
    battery
        Only this battery.
    alpha
        Family-wise rate of false alarms; 0.01 names more small effects, and more wrong ones.
    no_align
        Take the clocks of meter and motion as they are, for logs that were aligned already.
    report
        Write an interactive page to this HTML file.
    json
        Write the diagnosis as JSON to this file, or - for standard output.
    quiet
        Print nothing.
    """
    from missionsim.diagnose import diagnose_files

    check_search(logs, alpha)
    left_out: list[str] = []
    result = diagnose_files(
        robot,
        list(logs),
        holdout=holdout,
        mission=mission,
        battery=battery,
        alpha=alpha,
        align=not no_align,
        on_left_out=left_out.extend,
    )
    tell_left_out(left_out)
    emit_json(result.to_json() | {"left_out": left_out}, json)
    if report is not None:
        from missionsim.files import write_text
        from missionsim.report.diagnosis_page import diagnosis_page

        write_text(report, diagnosis_page(result, footer=_footer(), robot=robot, logs=logs))
    if shows_text(json, quiet):
        show(result, robot, logs)
        if report is not None:
            console().print(f"report written: {report}", markup=False)
    return 1 if left_out else 0


def show(result: Diagnosis, robot: str, logs: Sequence[Path]) -> None:
    """Print a diagnosis: what is missing, how sure, the error, what to type; then the report lines."""
    from rich.table import Table
    from rich.text import Text

    from missionsim.diagnose import sentences, words

    terminal = console()
    for battery in result.batteries.values():
        terminal.print(Text(words.headline(battery), style="bold"))
        for line in (sentences.sure(battery), sentences.errors(battery)):
            if line:
                terminal.print(Text(line))
        command = sentences.next_step(battery, robot, logs, len(result.batteries) > 1)
        if command:
            terminal.print(Text("Next, type:"))
            terminal.print(Text(f"    {command}", style="cyan"), soft_wrap=True)
        grid = Table.grid(padding=(0, 2))
        grid.add_column(no_wrap=True)
        grid.add_column()
        last = ""
        for heading, line in words.report(battery):
            grid.add_row("" if heading == last else heading, Text(line))
            last = heading
        terminal.print(grid)
        terminal.print()
    for name, why in result.skipped.items():
        terminal.print(Text(f"Battery {name} was not diagnosed: {why}"))


def _footer() -> str:
    from missionsim import __version__

    return f"missionsim {__version__}, missionsim diagnose"

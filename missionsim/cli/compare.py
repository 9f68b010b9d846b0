"""``missionsim compare``: model against measurements; where it fails."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from missionsim.cli.options import TERMINAL, OutFile, OutFolder, Output, tell_left_out
from missionsim.errors import InputError
from missionsim.files import write_text
from missionsim.report.terminal import console


def compare(
    *logs: Path,
    robot: str,
    mission: Path | None = None,
    by: Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=False)] = (),
    tolerance: float | None = None,
    report: OutFile | None = None,
    out: OutFolder | None = None,
    mcap: OutFile | None = None,
    to: Output = TERMINAL,
) -> int:
    """Compare a robot's model with measured logs: energy, power, and where it fails.

    The logs drive the model directly; with a mission, the gap between the measured runs and the simulated mission is
    split into what the power model misses and what the robot did otherwise than planned. Runs that `validate` refuses,
    copies, and runs with a fault that the others show (another unit, a column that hangs) are left out and named; the
    exit code is 1 then, and where measured energy is a thousand times that of the model or the other way round.

    Parameters
    ----------
    logs
        Logs (CSV or Parquet), or folders of them; one file is one run.
    robot
        Shipped robot's name, or its YAML file.
    mission
        Mission of which every log is a run.
    by
        Another column of the logs along which to look at the error; may be given several times.
    tolerance
        Largest energy error of any battery in percent; beyond it the exit code is 1.
    report
        Write an interactive page that needs no network, FILE.html.
    out
        Write tables (CSV) and pictures (PNG) into this folder.
    mcap
        Write measured and modelled power, residual, watts by term and all columns over time into this MCAP file, with a
        layout for Foxglove and a map for import beside it.
    """
    from missionsim.compare import compare_files
    from missionsim.compare.comparison import thousandfold

    if tolerance is not None and not tolerance >= 0.0:
        raise InputError.single("the tolerance is a percentage", got=tolerance, allowed="zero or more")
    if report is not None and report.suffix.lower() not in (".html", ".htm"):
        raise InputError.single("the report is a page", got=report, allowed="a file name that ends in .html")
    text = to.text
    with to.progress() as bar:
        task = bar.add_task("runs", total=None)
        result = compare_files(robot, logs, mission=mission, by=by, on_run=lambda _: bar.advance(task))
    tell_left_out(result.left_out, to)
    if report is not None:
        from missionsim import __version__
        from missionsim.report.compare_page import compare_page

        footer = f"Made by missionsim {__version__}. "
        footer += "Error is model minus measured throughout; a gap is measured minus model."
        write_text(report, compare_page(result, tolerance_pct=tolerance, footer=footer))
    if out is not None:
        from missionsim.report.compare_figures import write_figures
        from missionsim.report.compare_terminal import write_tables

        write_tables(result, out)
        write_figures(result, out)
    if mcap is not None:
        from missionsim.exchange.mcap import write_comparison
        from missionsim.inputs import load_robot

        write_comparison(load_robot(robot), logs, mcap)
    to.emit(result.to_json())
    inside = tolerance is None or result.within(tolerance)
    if text:
        from missionsim.report.compare_terminal import print_comparison

        terminal = console()
        print_comparison(result, terminal)
        if tolerance is not None:
            terminal.print(f"\n{'within' if inside else 'OUTSIDE'} the tolerance of ± {tolerance:g} %")
        for path in (report, out, mcap):
            if path is not None:
                terminal.print(f"written: {path}")
    doubtful = any(thousandfold(one.energy_measured_wh, one.energy_model_wh) for one in result.batteries.values())
    return 0 if inside and not doubtful and not result.left_out else 1

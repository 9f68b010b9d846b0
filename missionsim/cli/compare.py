"""`missionsim compare` (model against measurements: where it fails) and `calibrate` (a model fitted to them)."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from operator import attrgetter
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from missionsim import __version__
from missionsim.cli.options import TERMINAL, OutFolder, OutPage, Output, OutRecording, RobotFile, tell_left_out
from missionsim.compare import compare_files
from missionsim.compare.comparison import thousandfold
from missionsim.errors import Fault, InputError
from missionsim.exchange.mcap import write_comparison
from missionsim.files import write_text
from missionsim.fit.calibrate import NewRobot
from missionsim.fit.files import calibrate_files, calibration_json, refit_files
from missionsim.fit.parameters import ModelFit
from missionsim.inputs.loading import load_robot
from missionsim.numerals import counted, meter_clock, rounded, watts
from missionsim.report.compare_files import print_comparison, write_figures, write_tables
from missionsim.report.compare_page import compare_page
from missionsim.report.terminal import console, show_table


def compare(
    *logs: Path,
    robot: str,
    mission: Path | None = None,
    by: Annotated[tuple[str, ...], Parameter(negative="", consume_multiple=False)] = (),
    tolerance: float | None = None,
    report: OutPage | None = None,
    out: OutFolder | None = None,
    mcap: OutRecording | None = None,
    to: Output = TERMINAL,
) -> int:
    """Compare a robot's model with measured logs: energy, power, and where it fails.

    The logs drive the model directly; with a mission, the gap between the measured runs and the simulated mission is
    split into what the power model misses and what the robot did otherwise than planned. Runs that `validate` refuses,
    copies, and runs in another unit than the others are left out and named, whatever the model; the exit code is 1
    then, and where measured energy is a thousand times that of the model or the other way round.

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
    if tolerance is not None and not tolerance >= 0.0:
        raise InputError.single("the tolerance is a percentage", got=tolerance, allowed="zero or more")
    text = to.text
    with to.progress() as bar:
        task = bar.add_task("runs", total=None)
        result = compare_files(robot, logs, mission=mission, by=by, on_run=lambda _: bar.advance(task))
    tell_left_out(result.left_out, to)
    if report is not None:
        footer = f"Made by missionsim {__version__}. "
        footer += "Error is model minus measured throughout; a gap is measured minus model."
        write_text(report, compare_page(result, tolerance_pct=tolerance, footer=footer))
    if out is not None:
        write_tables(result, out)
        write_figures(result, out)
    if mcap is not None:
        write_comparison(load_robot(robot), logs, mcap)
    to.emit(result.to_json())
    inside = tolerance is None or result.within(tolerance)
    if text:
        terminal = console()
        print_comparison(result, terminal)
        if tolerance is not None:
            terminal.print(f"\n{'within' if inside else 'OUTSIDE'} the tolerance of ± {tolerance:g} %")
    to.written(report, out, mcap)
    doubtful = any(thousandfold(one.energy_measured_wh, one.energy_model_wh) for one in result.batteries.values())
    return 0 if inside and not doubtful and not result.left_out else 1


def calibrate(
    *logs: Path,
    out: RobotFile,
    new: str | None = None,
    base: str | None = None,
    robot: str | None = None,
    battery: str | None = None,
    mass: str = "",
    capacity: str = "",
    max_speed: str = "",
    drive: str = "differential",
    to: Output = TERMINAL,
) -> int:
    """Fit a base model for a new robot to logs, or refit the parameters of a robot.

    Parameters
    ----------
    logs
        Log files or folders of them.
    out
        Robot file to write.
    new
        Name of a new robot; needs --base.
    base
        Power while moving as a formula over v (magnitude of the speed), a (its rate), w (yaw rate) and u (sideways
        speed) with their signs (what both turns cost is abs(w)), theta (slope), m (mass with payload_kg) or log
        columns, with parameters of your own naming: "c2*v**2 + c3*v + c4".
    robot
        A robot (shipped name or file) whose parameters are refitted, each with its own prior.
    battery
        Battery that is fitted; by default every measured one for --robot, and for a new robot the only one that the
        logs measure, or "robot".
    mass
        Mass of a new robot, such as "25 kg"; without it, effects of mass come out per robot instead of per kg.
    capacity
        Battery capacity of a new robot, such as "100 Wh".
    max_speed
        Top speed of a new robot; by default the fastest in the logs.
    drive
        differential, skid_steer, mecanum, omni or ackermann.
    """
    if (new is None) == (robot is None):
        raise InputError.single("give either --new NAME with --base, or --robot R", got="both" if new else "neither")
    if new is not None and base is None:
        raise InputError.single("--new needs --base", allowed='--base "c2*v**2 + c3*v + c4"')
    drive_given = "" if drive == "differential" else drive
    of_new = {"--base": base, "--mass": mass, "--capacity": capacity, "--max-speed": max_speed, "--drive": drive_given}
    if robot is not None and (other := {name: value for name, value in of_new.items() if value}):
        raise InputError([Fault("", 0, 0, f"{name} belongs to --new", "", str(value)) for name, value in other.items()])
    if not logs:
        raise InputError.single("give at least one log", allowed="files or folders")
    tell = partial(tell_left_out, to=to)
    if new is not None and base is not None:
        made = calibrate_files(NewRobot(new, base, battery or "", mass, capacity, max_speed, drive), logs, tell=tell)
    else:
        made = refit_files(str(robot), logs, battery, tell=tell)
    write_text(out, made.text)
    to.emit(calibration_json(made, robot_file=str(out)))
    if to.text:
        _print(made.fits, made.remarks)
    to.written(out)
    return 1 if made.left_out else 0


def _print(fits: Sequence[ModelFit], remarks: Sequence[str]) -> None:
    terminal = console()
    for fit in fits:
        rows = []
        for p in filter(attrgetter("seen"), fit.parameters.values()):
            value, low, high = (rounded(number, 4) for number in (p.value, p.low, p.high))
            known = f"{low} … {high}" if p.high - p.low > 1e-9 * abs(p.value) else "exact"
            rows.append((p.name, value, known, "" if p.unit == "1" else p.unit))
        show_table(f"Battery {fit.battery}", ["parameter", ">value", ">95 % interval", "unit"], rows)
        clock = "clocks as logged"
        if fit.delay_s or fit.lag_s:
            clock = f"meter {meter_clock(fit.delay_s, fit.lag_s)}"
        terminal.print(
            f"{counted(len(fit.runs), 'run')}, {fit.seconds / 60:.0f} min; explains {100 * fit.explained:.1f} % of the "
            f"variance of the power; error {watts(fit.after.power_rmse_w)} (RMS), "
            f"{fit.after.run_energy_error_pct:.2f} % of the energy of a run; {clock}"
        )
    for remark in remarks:
        terminal.print(remark if remark.startswith(("note: ", "warning: ")) else f"note: {remark}")

"""`missionsim diagnose`, `add-effect` and `improve`: which effect is missing, and the robot file that has it."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from missionsim import __version__
from missionsim.cli.options import TERMINAL, OutPage, Output, RobotFile, Search, tell_left_out
from missionsim.diagnose import diagnose_files, sentences, words
from missionsim.diagnose.adopt import NotSignificant, adopt, check_name
from missionsim.diagnose.improve import Improved
from missionsim.diagnose.improve import improve as run_improve
from missionsim.diagnose.proposed import called, check_formula
from missionsim.diagnose.sentences import worse
from missionsim.diagnose.split import Split, read_split
from missionsim.diagnose.waterfall import energy_note, measured_note, power_of_floor
from missionsim.diagnose.words import heldout_line
from missionsim.errors import InputError, visible
from missionsim.files import write_text
from missionsim.identify.findings import BatteryDiagnosis, Diagnosis, Finding
from missionsim.inputs.edit import for_folder, robot_text
from missionsim.inputs.loading import load_robot
from missionsim.inputs.robot import RobotSpec
from missionsim.logs import describe
from missionsim.numerals import bare, meter_clock, p_told, rounded, watts
from missionsim.report.terminal import console, show_table


def diagnose(
    *logs: Path, search: Search, mission: Path | None = None, report: OutPage | None = None, to: Output = TERMINAL
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
    search.check(logs)
    result = diagnose_files(
        search.robot, logs, holdout=search.holdout, mission=mission, battery=search.battery, settings=search.settings
    )
    tell_left_out(result.left_out, to)
    to.emit(result.to_json())
    asked = sentences.Asked(search.robot, logs, search.given)
    if report is not None:
        from missionsim.report.diagnosis_page import diagnosis_page

        footer = f"missionsim {__version__}, missionsim diagnose"
        write_text(report, diagnosis_page(result, footer=footer, asked=asked))
    if to.text:
        show(result, asked)
        for line in result.remarks:
            console().print(line)
    to.written(report)
    return 1 if result.left_out or any(worse(one) for one in result.batteries.values()) else 0


def show(result: Diagnosis, asked: sentences.Asked) -> None:
    """Print a diagnosis: what is missing, how sure, the error, what to type; then the report lines."""
    from rich.table import Table

    terminal = console()
    for battery in result.batteries.values():
        terminal.print(words.headline(battery, len(result.batteries) > 1), style="bold")
        for line in (sentences.sure(battery), sentences.errors(battery)):
            if line:
                terminal.print(line)
        _tell_next(sentences.next_step(battery, asked, len(result.batteries) > 1))
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


def _tell_next(command: str) -> None:
    if command:
        console().print("Next, type:")
        console().print(f"    {command}", style="cyan", soft_wrap=True)


def improve(
    *logs: Path,
    search: Search,
    out: RobotFile,
    yes: bool = False,
    without: list[str] | None = None,
    report: OutPage | None = None,
    to: Output = TERMINAL,
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
    without
        An effect or a law, by the name that it would have in the file, that is not to be added; may be given several
        times.
    report
        Write an interactive page to this HTML file.
    """
    search.check(logs)
    if not yes and not sys.stdin.isatty():
        allowed = "--yes to add every effect that was identified"
        raise InputError.single("improve asks before it adds an effect, and this is no terminal", allowed=allowed)
    for name in without or ():
        if not name.startswith("law_"):  # laws are not known before they are found
            check_name(load_robot(search.robot), name)
    spec, split = _read(search, logs, to)
    text = robot_text(search.robot)
    measured = list(dict.fromkeys(name for log in split.given for name in log.power_w))
    known = [name for name in measured if name in spec.batteries] or measured
    wanted = [search.battery] if search.battery is not None else known
    done: list[Improved] = []
    skipped: dict[str, InputError] = {}
    refused: set[str] = set()

    def ask(finding: Finding, diagnosis: BatteryDiagnosis) -> bool:
        name = called(finding)
        if name in (without or ()):
            refused.add(name)
            return False
        if yes:
            return True
        from rich.prompt import Confirm

        terminal = console(stderr=True)
        terminal.print(words.found_line(finding))
        before_w, after_w = finding.heldout_rmse_before_w, finding.heldout_rmse_after_w
        if before_w is not None and after_w is not None:
            told = f"with all that was found {watts(after_w)}, without this {watts(before_w)}"
            terminal.print(f"power error on held-out runs: {told}")
        asked = f"add {finding.effect} to battery {diagnosis.battery}?"
        return Confirm.ask(asked, default=True, console=terminal)

    for name in wanted:
        try:
            result = run_improve(text, split, name, search.settings, ask)
        except InputError as error:
            skipped[name] = error
            continue
        done.append(result)
        text = result.text
    if not done:
        raise next(iter(skipped.values()))
    write_text(out, for_folder(text, out.parent))
    asked = sentences.Asked(search.robot, logs, search.given)
    advice = {one.battery: one.advice(asked, len(done) > 1) for one in done}
    found = {"schema": "missionsim.improvement/1", "robot_file": str(out), "holdout": split.how}
    left = {name: " ".join(str(error).split()) for name, error in skipped.items()}
    to.emit({**found, "batteries": {d.battery: d.to_json() for d in done}, "skipped": left, "left_out": split.left_out})
    if report is not None:
        from missionsim.report.diagnosis_page import improve_page

        write_text(report, improve_page(spec.name, done, advice=advice))
    for name in [] if to.quiet else [name for name in without or () if name not in refused]:
        print(visible(f"warning: --without {name}: nothing of that name was about to be added"), file=sys.stderr)
    if to.text:
        _print(done, advice, skipped)
    to.written(out, report)
    return 1 if split.left_out or any(one.worse for one in done) else 0


def _read(search: Search, logs: Sequence[Path], to: Output, effect: str | None = None) -> tuple[RobotSpec, Split]:
    """Robot, and runs to fit and to test on; says what the checks found. Refuses an `effect` that none knows."""
    spec = load_robot(search.robot)
    split = read_split(spec, logs, search.holdout)
    if effect is not None:
        check_name(spec, effect, split)
    tell_left_out(split.left_out, to)
    runs = [*split.given, *(run for run in split.heldout if all(run is not one for one in split.given))]
    for line in [] if to.quiet else [*describe(runs), *split.remarks]:
        print(visible(line), file=sys.stderr)
    return spec, split


def _print(done: list[Improved], advice: dict[str, tuple[str, str]], skipped: dict[str, Any]) -> None:
    terminal = console()
    for one in done:
        better, command = advice[one.battery]
        which = "held-out runs" if one.heldout else "fitted runs (none held out)"
        most = max(step.power_rmse_w for step in one.steps) or 1.0
        rows = []
        for step in one.steps:
            bar = "█" * max(1, round(18 * step.power_rmse_w / most))
            told = power_of_floor(one.steps) if step is one.steps[-1] else rounded(step.power_rmse_w)
            rows.append((step.name, f"{step.energy_error_pct:.2f}", told, bar))
        if one.worse:
            terminal.print(one.worse, style="bold red")
        if better:
            terminal.print(better)
        _tell_next(command)
        heads = ["model", ">energy error, %", ">power RMSE, W", ""]
        show_table(f"Battery {one.battery}: error on {which}", heads, rows)
        terminal.print(f"added: {one.told}; {one.stopped}")
        for note in (energy_note(one), measured_note(one)):
            if note:
                terminal.print(note)
    for name, error in skipped.items():
        terminal.print(f"battery {name} was left as it is: {' '.join(str(error).split())}")


def add_effect(
    *logs: Path,
    search: Search,
    out: RobotFile,
    effect: str | None = None,
    formula: str | None = None,
    force: bool = False,
    keep_base: bool = False,
    to: Output = TERMINAL,
) -> int:
    """Fit an effect to logs and write the robot file that has it, with its uncertainty and where it comes from.

    Refuses with exit code 1 what the logs do not support; exit code 1 too where the file predicts the held-out runs
    worse.

    Parameters
    ----------
    logs
        Log files or folders of them.
    out
        Robot file to write.
    effect
        Id in the library (missionsim effects), or the name of one of the robot file's candidates.
    formula
        In place of --effect, a law of your own over columns of the log, such as "k * abs(yaw_rate_rad_s) * payload_kg",
        or the number of a form that diagnose proposes (1 is the first). Its k is fitted; the unit of k follows.
    force
        Write it even if the logs do not support it.
    keep_base
        Leave the base parameters as they are instead of writing the values that were fitted with the effect.
    """
    search.check(logs)
    if (effect is None) == (formula is None):
        message = "add-effect needs either --effect or --formula"
        allowed = '--effect turning_scrub, or --formula 1, or --formula "k * abs(yaw_rate_rad_s) * payload_kg"'
        raise InputError.single(message, got="both" if effect else "neither", allowed=allowed)
    if effect is not None:
        check_name(load_robot(search.robot), effect)  # a name that is wrong for any log is told at once
    elif formula is not None and not formula.strip().isdigit():
        check_formula(formula)
    spec, split = _read(search, logs, to, effect)
    measured = list(dict.fromkeys(name for log in split.given for name in log.power_w))
    motors = spec.motion.battery if spec.motion is not None else ""
    chosen = search.battery or (motors if motors in measured else measured[0])
    options = {"formula": formula is not None, "force": force, "recalibrate": not keep_base}
    asked = formula if effect is None else effect
    assert asked is not None
    try:
        made = adopt(robot_text(search.robot), split, asked, chosen, search.settings, **options)
    except InputError as error:
        if formula is None:
            raise
        at_option = [
            replace(f, file="--formula", line=0, column=0, path="") if f.got == formula else f for f in error.faults
        ]
        raise InputError(at_option) from None
    except NotSignificant as error:
        refused = {"schema": "missionsim.add_effect/1", "effect": asked, "battery": chosen, "added": False}
        to.emit(refused | {"reason": str(error)})
        print(f"{error}\n    nothing was written; --force writes it all the same", file=sys.stderr)
        return 1
    write_text(out, for_folder(made.text, out.parent))
    to.emit(made.to_json() | {"battery": chosen, "left_out": split.left_out, "robot_file": str(out)})
    if made.worse:
        print(made.worse, file=sys.stderr)
    if rivals := made.effect.indistinguishable_from:
        told = f"these logs cannot tell {made.effect.effect} from {', '.join(rivals)}"
        print(f"warning: {told}; missionsim diagnose says what to drive to find out", file=sys.stderr)
    if made.effect.doubt:
        print(f"warning: {made.effect.doubt}", file=sys.stderr)
    if to.text:
        terminal = console()
        one, told = made.effect, words.parameters_told(made.effect)
        terminal.print(f"{one.effect} on battery {chosen}: {words.share_told(one)}; {told}; {p_told(one.p_value)}")
        if made.reason:
            terminal.print(f"forced: {made.reason}")
        if made.base:
            terminal.print("base: " + ", ".join(f"{n} = {bare(v)}" for n, (v, _) in made.base.items()))
        if any(made.meter):
            delay_s, lag_s = made.meter
            terminal.print(f"meter: {meter_clock(delay_s, lag_s)}; compare shows the model so")
        if made.heldout is not None:
            terminal.print("held out: " + heldout_line(made.heldout))
    to.written(out)
    return 1 if made.worse or split.left_out else 0

"""`missionsim plan` and `missionsim reach`: the best mission for a task, and which places a robot gets to and back."""

from __future__ import annotations

import contextlib
import signal
import threading
import time
from pathlib import Path
from typing import Any

from missionsim.cli.options import AS_FILED, TERMINAL, Changes, OutFile, OutPage, OutPicture, Output
from missionsim.cli.run import clock
from missionsim.engine.outcome import RunResult
from missionsim.errors import InputError
from missionsim.files import write_text
from missionsim.inputs.loading import load_environment, load_task
from missionsim.inputs.task import TaskSpec
from missionsim.numerals import in_wh
from missionsim.planner import reach as planner
from missionsim.planner import why
from missionsim.planner.answer import Answer, mission_text
from missionsim.planner.chance import plan_task
from missionsim.report.figures_run import site_figure
from missionsim.report.page import save_figure
from missionsim.report.site_map import legs_table, map_of_plan, map_of_reach, plan_page
from missionsim.report.terminal import console, show_table, titled


def plan(
    task: Path,
    *,
    out: OutFile | None = None,
    changes: Changes = AS_FILED,
    pareto: bool = False,
    alternatives: bool = False,
    seconds: float | None = None,
    plot: OutPicture | None = None,
    report: OutPage | None = None,
    to: Output = TERMINAL,
) -> int:
    """Plan a task: which order, which way, which speed, which control scheme, where to charge.

    Exit code 1 where there is no plan; then it says what is short.

    Parameters
    ----------
    task
        Task file.
    out
        Mission file to write, for `missionsim run`.
    pareto
        Also the front of energy against time.
    alternatives
        Also the next best plans that differ in kind, and how much worse they are.
    seconds
        Stop the search after so long, with the best plan so far and how far it may be from the best; so does Ctrl-C.
    plot
        Draw the map with the route into this PNG or SVG file.
    report
        Write an interactive page, which opens from disk, to this HTML file.
    """
    if seconds is not None and not seconds > 0.0:
        raise InputError.single("--seconds must be more than nothing", got=f"{seconds:g}", allowed="such as 60")
    spec = load_task(task, changes.pairs, changes.robot)
    to.warn(spec.warnings)
    answer, run = _solved(spec, seconds, to)
    to.warn(() if run is None else run.warnings)
    if not answer.feasible:
        if answer.extra.pop("explained", True) and answer.notes:
            would_do = answer.extra.pop("would_do", [])
            reasons = {"short": [], "would_do": would_do, "text": [f"this would do: {c['text']}" for c in would_do]}
        else:
            reasons = why.explain(answer.site)
        answer.extra["why"] = reasons | {"text": [*answer.notes, *reasons["text"]]}
    with contextlib.suppress(KeyboardInterrupt):  # a plan there is
        if answer.feasible and pareto:
            answer.extra["pareto"] = [
                {"duration_s": made.duration_s, "energy_wh": made.energy_wh, "gap": made.gap, "order": made.order()}
                for made in why.pareto(answer.site)
            ]
        if answer.feasible and alternatives:
            answer.extra["alternatives"] = why.alternatives(answer)
    answer.extra["warnings"] = [] if run is None else [fault.message for fault in run.warnings]
    written = []
    if out is not None and answer.feasible:
        write_text(out, mission_text(answer, out))
        written.append(out)
    if plot is not None:
        written.append(save_figure(site_figure(map_of_plan(answer)), plot))
    if report is not None:
        write_text(report, plan_page(answer, footer=f"missionsim plan {task.name}"))
        written.append(report)
    to.emit(answer.summary())
    if to.text:
        show(answer)
    to.written(*written)
    return 0 if answer.feasible else 1


def _solved(task: TaskSpec, seconds: float | None, to: Output) -> tuple[Answer, RunResult | None]:
    """Search with progress on standard error, and an end to it: after some time, or at Ctrl-C (at once at a second)."""
    began = time.monotonic()
    stop = False

    def on_interrupt(*_: object) -> None:
        nonlocal stop
        if stop:
            raise KeyboardInterrupt
        stop = True

    with to.progress() as bar:
        told = bar.add_task("planning", total=None)

        def watch(what: str, objective: float, bound: float) -> bool:
            bar.update(told, description=f"{what}: best {objective:.6g}, none below {bound:.6g}")
            return stop or (seconds is not None and time.monotonic() - began > seconds)

        if threading.current_thread() is not threading.main_thread():
            return plan_task(task, watch)
        before = signal.signal(signal.SIGINT, on_interrupt)
        try:
            return plan_task(task, watch)
        finally:
            signal.signal(signal.SIGINT, before)


def show(answer: Answer) -> None:
    """Print a plan, at most 100 columns wide."""
    terminal = console()
    task = answer.site.task
    if not answer.feasible:
        terminal.print(titled(task.name, f" with {task.robot.name}: no plan"))
        for line in answer.extra["why"]["text"]:
            terminal.print(f"  {line}")
        return
    terminal.print(titled(task.name, f" with {task.robot.name}: {answer.course()}, {answer.claim}"))
    if sure := answer.extra.get("probability"):
        terminal.print(
            f"holds in {100 * sure['value']:.2f} % of {sure['runs']} fresh draws "
            f"({100 * sure['low']:.2f} to {100 * sure['high']:.2f} %)"
        )
    energy = ", ".join(f"{name} {in_wh(value)} Wh" for name, value in answer.energy_wh.items())
    terminal.print(f"{clock(answer.duration_s)}, {energy}")
    columns, rows = legs_table(answer)
    show_table("Legs", [*columns[:4], *(f">{column}" for column in columns[4:])], rows)
    for item in answer.extra.get("alternatives", ()):
        told = f"{100 * item['worse']:.2f} % worse, {clock(item['duration_s'])}" if item["feasible"] else "no plan"
        terminal.print(f"  {item['kind']}: {told}")
    front = answer.extra.get("pareto")
    if front:
        heads = [">s", *(f">{name} Wh" for name in answer.energy_wh)]
        table = [[f"{p['duration_s']:.1f}", *(in_wh(p["energy_wh"][n]) for n in answer.energy_wh)] for p in front]
        show_table("Energy against time", heads, table)


def reach(
    environment: Path,
    *,
    from_: str,
    back_to: str | None = None,
    probability: float = 0.95,
    changes: Changes = AS_FILED,
    plot: OutPicture | None = None,
    to: Output = TERMINAL,
) -> int:
    """Which places a robot can go to and come back from with its reserve, and where it must turn back.

    Exit code 1 where some place is out of reach. ``--set`` changes what a task has (within.reserve="30 %",
    choose.schemes=[mapped], choose.speeds=["0.5 m/s"], initial_charge.drive="80 %") or the robot.

    Parameters
    ----------
    environment
        Environment file.
    from_
        Place where the robot starts.
    back_to
        Place to which it comes back; by default where it starts.
    probability
        Share of draws of the uncertain values in which the charge must suffice.
    plot
        Draw the map into this PNG or SVG file.
    """
    if changes.robot is None:
        raise InputError.single("reach needs a robot", allowed="--robot ROBOT.yaml, or a shipped robot's name")
    if not 0.0 < probability < 1.0:
        raise InputError.single("--probability lies between 0 and 1", got=f"{probability:g}", allowed="such as 0.95")
    spec = load_environment(environment)
    for option, name in (("--from", from_), ("--back-to", back_to)):
        if name is not None and name not in spec.places:
            told, shown = f"{option}: no place '{name}' in {environment}", ", ".join(list(spec.places)[:24])
            raise InputError.unknown(told, name, spec.places, allowed=shown)
    task = planner.reach_task(environment, changes.robot, from_, changes.pairs, back_to)
    to.warn(task.warnings)
    with to.progress() as bar:
        row = bar.add_task("places", total=len(task.environment.places))
        found = planner.reach(task, probability, lambda: bar.advance(row))
    warnings = {(fault.file, fault.line, fault.got): fault for item in found for fault in item.warnings}
    to.warn(warnings.values())
    answer = planner.summary(task, found, probability)
    answer["warnings"] = [fault.message for fault in warnings.values()]
    if plot is not None:
        save_figure(site_figure(map_of_reach(task.environment, task.start, found, probability)), plot)
    to.emit(answer)
    if to.text:
        _show(answer)
    to.written(plot)
    return 0 if all(item.sure for item in found) and not answer["unreachable"] else 1


def _show(answer: dict[str, Any]) -> None:
    """Print what can be reached, at most 100 columns wide."""
    terminal = console()
    percent = f"{100 * answer['probability']:g} %"
    how = f" with {answer['robot']} from {answer['from']}, back to {answer['to']}"
    terminal.print(titled(answer["environment"], how))
    names = list(next(iter(answer["places"].values()))["energy_wh"]) if answer["places"] else []
    columns = ["place", "there and back", ">holds", ">time"]
    columns += [f">{name} Wh" for name in names] + [f">{name} margin" for name in names]
    rows = []
    for place, item in answer["places"].items():
        holds = item["holds"]
        word = "yes" if item["sure"] else f"fewer than {percent}" if item["reachable"] else "NO"
        cells = [place, word, "–" if holds is None else f"{100 * holds['value']:.1f} %", clock(item["duration_s"])]
        cells += [in_wh(item["energy_wh"][name]) for name in names]
        cells += [in_wh(item["margin_wh"][name]) for name in names]
        rows.append(cells)
    show_table("Places", columns, rows)
    for place, item in answer["places"].items():
        if turn := item["point_of_no_return"]:
            sure = f"{turn['sure_metres']:.1f} m" if turn["sure_edge"] == turn["edge"] else f"on '{turn['sure_edge']}'"
            if turn["sure_edge"] is None:
                sure = "at the start"
            after = f"after {turn['metres']:.1f} m on"
            if turn["one_way"]:
                after = f"at {turn['from']}, before one-way"
                sure = "too" if turn["sure_edge"] == turn["edge"] else sure
            terminal.print(
                f"  towards {place}: turn back {after} '{turn['edge']}' ({turn['from']} to "
                f"{turn['to']}), in {percent} of draws {sure}: {turn['battery']} decides"
            )
    if answer["unreachable"]:
        terminal.print(f"  no open way there and back: {', '.join(answer['unreachable'])}")

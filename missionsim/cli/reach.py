"""`missionsim reach`: how far a robot gets on a site."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from missionsim.cli.options import AS_FILED, TERMINAL, Changes, OutFile, Output
from missionsim.report.terminal import console, simple_table, titled


def reach(
    environment: Path,
    *,
    from_: str,
    back_to: str | None = None,
    probability: float = 0.95,
    changes: Changes = AS_FILED,
    plot: OutFile | None = None,
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
    from missionsim.cli.targets import check_picture
    from missionsim.errors import InputError, did_you_mean
    from missionsim.inputs.loading import load_environment
    from missionsim.planner import reach as planner

    check_picture(plot)
    if changes.robot is None:
        raise InputError.single("reach needs a robot", allowed="--robot ROBOT.yaml, or a shipped robot's name")
    if not 0.0 < probability < 1.0:
        raise InputError.single("--probability lies between 0 and 1", got=f"{probability:g}", allowed="such as 0.95")
    spec = load_environment(environment)
    for option, name in (("--from", from_), ("--back-to", back_to)):
        if name is not None and name not in spec.places:
            raise InputError.single(
                f"{option}: no place '{name}' in {environment}",
                got=name,
                allowed=", ".join(list(spec.places)[:24]),
                hint=did_you_mean(name, spec.places),
            )
    task = planner.reach_task(environment, changes.robot, from_, changes.pairs, back_to)
    to.warn(task.warnings)
    with to.progress() as bar:
        told = bar.add_task("places", total=len(task.environment.places))
        found = planner.reach(task, probability, lambda: bar.advance(told))
    answer = planner.summary(task, found, probability)
    if plot is not None:
        from missionsim.report.site_map import map_of_reach, write_map

        write_map(map_of_reach(task.environment, task.start, found, probability), plot)
    to.emit(answer)
    if to.text:
        _show(answer)
        if plot is not None:
            console().print(f"Written: {plot}", soft_wrap=True)
    return 0 if all(item.sure for item in found) and not answer["unreachable"] else 1


def _show(answer: dict[str, Any]) -> None:
    """Print what can be reached, at most 100 columns wide."""
    from missionsim.cli.run import clock

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
        cells += [f"{item['energy_wh'][name]:.3f}" for name in names]
        cells += [f"{item['margin_wh'][name]:.2f}" for name in names]
        rows.append(cells)
    terminal.print(simple_table("Places", columns, rows))
    for place, item in answer["places"].items():
        if turn := item["point_of_no_return"]:
            sure = f"{turn['sure_metres']:.1f} m" if turn["sure_edge"] == turn["edge"] else f"on '{turn['sure_edge']}'"
            if turn["sure_edge"] is None:
                sure = "at the start"
            terminal.print(
                f"  towards {place}: turn back after {turn['metres']:.1f} m on '{turn['edge']}' ({turn['from']} to "
                f"{turn['to']}), in {percent} of draws {sure}: {turn['battery']} decides"
            )
    if answer["unreachable"]:
        terminal.print(f"  no open way there and back: {', '.join(answer['unreachable'])}")

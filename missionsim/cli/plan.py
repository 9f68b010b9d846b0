"""`missionsim plan`: the best mission for a task."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from missionsim.cli.common import console, emit_json, shows_text, simple_table, tell_warnings
from missionsim.cli.options import JsonOption, QuietOption

if TYPE_CHECKING:
    from missionsim.planner.answer import Answer


def plan(
    task: Path,
    *,
    out: Path | None = None,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    robot: str | None = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
) -> int:
    """Plan a task: which order, which way, which speed, which control scheme, where to charge.

    Exit code 1 where there is no plan; then it says what is short.

    Parameters
    ----------
    task
        Task file.
    out
        Mission file to write, for `missionsim run`.
    set_
        path=value, such as within.deadline="20 min" or robot.batteries.robot.capacity="100 Wh"; may be given several
        times.
    robot
        Shipped robot or robot file in place of the task's own.
    json
        Write the plan as JSON to this file, or - for standard output.
    quiet
        Print no tables.
    """
    from missionsim.files import write_text
    from missionsim.inputs.loading import load_task
    from missionsim.inputs.overrides import split_assignment
    from missionsim.planner.solve import solve
    from missionsim.planner.write import mission_text

    spec = load_task(task, [split_assignment(text) for text in set_ or ()], robot)
    tell_warnings(spec.warnings, quiet)
    answer = solve(spec)
    if out is not None and answer.feasible:
        write_text(out, mission_text(answer, out))
    emit_json(answer.summary(), json)
    if shows_text(json, quiet):
        show(answer)
        if out is not None and answer.feasible:
            console().print(f"Written: {out}", soft_wrap=True)
    return 0 if answer.feasible else 1


def show(answer: Answer) -> None:
    """Print a plan, at most 100 columns wide."""
    from missionsim.cli.run_mission import clock

    terminal = console()
    task = answer.site.task
    if not answer.feasible:
        terminal.print(f"[bold]{task.name}[/bold] with {task.robot.name}: no plan")
        return
    proved = "proved best" if answer.gap == 0.0 else f"at most {100 * answer.gap:.2g} % from the best"
    terminal.print(f"[bold]{task.name}[/bold] with {task.robot.name}: {' → '.join(answer.order())}, {proved}")
    energy = ", ".join(f"{name} {value:.3f} Wh" for name, value in answer.energy_wh.items())
    terminal.print(f"{clock(answer.duration_s)}, {energy}")
    batteries = list(answer.energy_wh)
    right = "right"
    rows = []
    for leg in answer.legs:
        piece = leg.piece
        scheme = piece.legs[0].settings.scheme if piece is not None else ""
        speed = f"{piece.limit_m_s:.2f}" if piece is not None else ""
        edge = piece.name if piece is not None else ""
        cells = [leg.kind, leg.place, edge, scheme, speed, f"{leg.duration_s:.1f}"]
        cells += [f"{leg.energy_wh[name]:.3f}" for name in batteries]
        cells += [f"{leg.charge_wh[name]:.1f}" for name in batteries]
        rows.append(cells)
    columns: list[str | tuple[str, str]] = ["leg", "to", "along", "scheme", ("m/s", right), ("s", right)]
    columns += [(f"{name} Wh", right) for name in batteries] + [(f"{name} left", right) for name in batteries]
    terminal.print(simple_table("Legs", columns, rows))

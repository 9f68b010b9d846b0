"""`missionsim run`: simulate one mission."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from missionsim.cli.options import JsonOption, QuietOption
from missionsim.cli.run_mission import run_mission


def run(
    mission: Path,
    *,
    set_: Annotated[list[str] | None, Parameter(name="--set", negative="")] = None,
    robot: str | None = None,
    out: Path | None = None,
    format: Literal["csv", "parquet"] = "csv",
    plot: Annotated[list[Literal["png", "svg"]] | None, Parameter(consume_multiple=True, negative="")] = None,
    mcap: Path | None = None,
    json: JsonOption = None,
    quiet: QuietOption = False,
) -> int:
    """Simulate one mission with SimPy and tell what each battery gave to what.

    A mission is feasible when every segment is done, no battery is ever empty, and at the end every battery holds its
    reserve and enough to come home to the dock. Exit code 1 when it is not.

    Parameters
    ----------
    mission
        Mission file.
    set_
        path=value, such as defaults.speed=0.5 or robot.batteries.robot.capacity="100 Wh"; may be given several times.
    robot
        Shipped robot or robot file in place of the mission's own.
    out
        Folder for the tables (per interval, per segment, segment x component x term, summary), run.json and
        provenance.json.
    format
        Of the tables.
    plot
        Also draw power over time, charge over time and energy by segment, as png (or svg, or both), into the folder
        of --out (else the present one).
    mcap
        Also write power, watts by term, charge, scheme, components and pose over time into this MCAP file, with a
        layout for Foxglove and a map for import beside it.
    json
        Write the summary as JSON to this file, or - for standard output.
    quiet
        Print no tables.
    """
    return run_mission(mission, set_, robot, out, format, plot, json, quiet, mcap)

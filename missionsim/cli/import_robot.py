"""``missionsim import-robot``: fleet configs of other tools into robot files."""

from __future__ import annotations

from pathlib import Path

from missionsim.cli.options import JsonOption, QuietOption


def import_robot(
    config: Path,
    /,
    *,
    out: Path | None = None,
    battery: str = "main",
    json: JsonOption = None,
    quiet: QuietOption = False,
) -> int:
    """Turn a fleet config of Open-RMF into a robot file.

    Its power is the one that Open-RMF plans with: friction, acceleration, ambient and tool watts.

    Parameters
    ----------
    config
        Fleet config (config.yaml of a fleet adapter).
    out
        Robot file to write; without it, it is told what would be written.
    battery
        Name of the robot's battery, as logs call it.
    json
        Write what was read and what was left out as JSON to this file, or - for standard output.
    quiet
        Print nothing but what was asked for.
    """
    from missionsim.cli.common import emit_json, shows_text
    from missionsim.exchange.rmf_fleet import read_fleet
    from missionsim.files import write_text
    from missionsim.inputs.loading import robot_from_text
    from missionsim.report.terminal import console

    fleet = read_fleet(config)
    text = fleet.robot_text(battery)
    name = robot_from_text(text, str(out or config)).name
    if out is not None:
        write_text(out, text)
    told = [{"message": r.message, "line": r.line, "count": r.count} for r in fleet.remarks.values()]
    emit_json(
        {
            "schema": "missionsim.fleet/1",
            "source": str(config),
            "robot": name,
            "numbers": fleet.numbers,
            "limits": fleet.limits,
            "robots": fleet.robots,
            "told": told,
            "out": out,
        },
        json,
    )
    if shows_text(json, quiet):
        terminal = console()
        n = fleet.numbers
        terminal.print(
            f"{config}: Open-RMF fleet {fleet.name}, {n['mass']:g} kg, {n['capacity'] * n['voltage']:g} Wh, friction "
            f"{n['friction']:g}, ambient {n['ambient']:g} W, tool {n['tool']:g} W",
            markup=False,
            soft_wrap=True,
        )
        for remark in fleet.remarks.values():
            terminal.print(f"  {remark}", markup=False, soft_wrap=True)
        if out is not None:
            terminal.print(f"written: {out}", markup=False, soft_wrap=True)
    return 0

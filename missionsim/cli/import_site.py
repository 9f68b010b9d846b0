"""``missionsim import-site``: maps, route graphs, tracks and orders of other tools into environments and missions."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.cli.options import TERMINAL, OutFile, Output

if TYPE_CHECKING:
    from missionsim.exchange.site import Site


def import_site(
    file: Path,
    /,
    *,
    out: OutFile | None = None,
    mission: OutFile | None = None,
    robot: str | None = None,
    vehicle: str = "",
    graph: int | None = None,
    scale: float | None = None,
    smooth: float = 50.0,
    to: Output = TERMINAL,
) -> int:
    """Turn a site map, route graph, track or order of another tool into an environment, and perhaps a mission.

    Read are Nav2 route graphs (GeoJSON), Open-RMF building.yaml, LIF, GPX, QGroundControl .plan, VDA 5050 orders,
    GraphML and node-link JSON; which one it is, the content tells. Without --out, it is told what would be written.

    Parameters
    ----------
    file
        File of another tool.
    out
        Environment file to write (SITE.yaml).
    mission
        Mission file to write as well: of a plan, an order, or a track.
    robot
        Shipped robot or robot file: who drives the mission (pioneer3dx unless given), how fast a share of its top speed
        is, and how much a charger gives it.
    vehicle
        Type of vehicle whose edges and limits hold (LIF).
    graph
        Number of the lane graph to read (Open-RMF); all of them unless given.
    scale
        m per pixel of a drawing without measurements (Open-RMF).
    smooth
        m to each side over which elevations of a track are smoothed (GPX).
    """
    from missionsim.errors import InputError
    from missionsim.exchange.formats import import_site as read
    from missionsim.exchange.site import SiteOptions, write_site
    from missionsim.inputs.loading import load_robot

    if mission is not None and out is None:
        raise InputError.single("--mission needs --out", allowed="--out SITE.yaml --mission MISSION.yaml")
    if not 0.0 <= smooth <= 1e5 or (scale is not None and not 0.0 < scale <= 1e3):
        raise InputError.single("--smooth and --scale are lengths in m", got=f"{smooth:g}, {scale}", allowed="above 0")
    driver = robot or ("pioneer3dx" if mission is not None else None)
    spec = None if driver is None else load_robot(driver)
    site = read(file, SiteOptions(spec, vehicle, graph, scale, smooth))
    if driver is not None and robot is None:
        site.tell("robot of the mission: pioneer3dx, since --robot names none")
    if out is not None:
        write_site(site, out, mission, driver or "")
    result = {**site.summary(), "out": out, "mission": mission}
    to.emit(result)
    if to.text:
        _print(site, out, mission)
    return 0


def _print(site: Site, out: Path | None, mission: Path | None) -> None:
    from missionsim.report.terminal import console

    terminal = console()
    one_way = sum(not edge.get("both_ways", True) for edge in site.edges)
    parts = [f"{len(site.places)} places", f"{len(site.edges)} ways ({one_way} one-way, {site.length_m:.1f} m)"]
    if site.chargers:
        parts.append(
            f"{len(site.chargers)} chargers ({', '.join(site.chargers[:6])}{', …' * (len(site.chargers) > 6)})"
        )
    if site.segments:
        parts.append(f"a mission of {len(site.segments)} segments")
    terminal.print(f"{site.file}: {site.format}, {', '.join(parts)}", soft_wrap=True)
    for remark in site.remarks.values():
        terminal.print(f"  {remark}", soft_wrap=True)
    for path in filter(None, (out, mission)):
        terminal.print(f"written: {path}", soft_wrap=True)


def import_robot(config: Path, /, *, out: Path | None = None, battery: str = "main", to: Output = TERMINAL) -> int:
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
    """
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
    to.emit(
        {
            "schema": "missionsim.fleet/1",
            "source": str(config),
            "robot": name,
            "numbers": fleet.numbers,
            "limits": fleet.limits,
            "robots": fleet.robots,
            "told": told,
            "out": out,
        }
    )
    if to.text:
        terminal = console()
        n = fleet.numbers
        terminal.print(
            f"{config}: Open-RMF fleet {fleet.name}, {n['mass']:g} kg, {n['capacity'] * n['voltage']:g} Wh, friction "
            f"{n['friction']:g}, ambient {n['ambient']:g} W, tool {n['tool']:g} W",
            soft_wrap=True,
        )
        for remark in fleet.remarks.values():
            terminal.print(f"  {remark}", soft_wrap=True)
        if out is not None:
            terminal.print(f"written: {out}", soft_wrap=True)
    return 0

"""`missionsim import-site`, `import-robot` and `export`: sites, fleets, plans and orders of other tools in and out."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from cyclopts import App

from missionsim.cli.options import TERMINAL, OutFile, Output, RobotFile
from missionsim.errors import Fault, InputError
from missionsim.exchange.formats import import_site as read
from missionsim.exchange.nav2 import export_costs
from missionsim.exchange.qgc import plan_of
from missionsim.exchange.rmf_fleet import NUMBERS, export_fleet, read_fleet
from missionsim.exchange.site import SiteOptions, write_site
from missionsim.exchange.vda5050 import order_of
from missionsim.files import atomic_write, to_json, write_text
from missionsim.inputs.loading import load_mission, load_robot, robot_from_text
from missionsim.numerals import counted, rounded
from missionsim.report.terminal import console, show_table

app = App(name="export", help="Write our numbers and missions into the files of other tools.")


@app.command
def nav2(
    graph: Path,
    /,
    *,
    robot: str,
    out: OutFile,
    battery: str = "",
    time_weight: float = 0.0,
    speed: float | None = None,
    best_speed: bool = False,
    payload: float = 0.0,
    to: Output = TERMINAL,
) -> int:
    """Write energy costs and speed limits into a Nav2 route graph; all else stays as it is, byte for byte.

    Parameters
    ----------
    graph
        Nav2 route graph (GeoJSON).
    robot
        Shipped robot or robot file.
    out
        Graph to write.
    battery
        Battery whose energy counts; all of them unless given.
    time_weight
        Wh that a second is worth: the cost is energy + weight x time.
    speed
        Wanted speed in m/s; the robot's top speed unless given.
    best_speed
        On each edge the speed of the lowest cost, up to its limit.
    payload
        Carried, kg.
    """
    spec = load_robot(robot)
    if battery and battery not in spec.batteries:
        raise InputError.unknown(f"the robot has no battery '{battery}'", battery, spec.batteries)
    _within(("--time-weight", time_weight, 0.0, 1e6), ("--payload", payload, 0.0, 1e6), ("--speed", speed, 1e-3, 60.0))
    found = export_costs(
        graph, spec, battery=battery, wh_per_s=time_weight, speed=speed, best_speed=best_speed, payload_kg=payload
    )
    with atomic_write(out) as temporary:
        temporary.write_bytes(found.raw)
    to.emit({"schema": "missionsim.graph_costs/1", "graph": str(graph), "robot": spec.name, "edges": found.edges})
    costs = [edge["cost"] for edge in found.edges]
    spread = f", cost {min(costs):.4g} to {max(costs):.4g}" if costs else ""
    unit = f"Wh + {time_weight:g} Wh/s" if time_weight else "Wh"
    _tell(to, f"{graph}: {counted(len(costs), 'edge')}{spread} ({unit})", found.remarks, out)
    return 0


@app.command
def rmf(config: Path, /, *logs: Path, robot: str, out: OutFile, battery: str = "", to: Output = TERMINAL) -> int:
    """Write friction, ambient and tool watts and capacity into a fleet config of Open-RMF, and say how far it follows.

    Parameters
    ----------
    config
        Fleet config; all but the numbers stays as it is.
    logs
        Logs or folders of them: friction and watts are those with which RMF's formula follows them best, and the errors
        of both models are told. Without logs, it is laid through our model's power at steady speeds.
    robot
        Shipped robot or robot file.
    out
        Config to write.
    battery
        The robot's battery; that of its motion unless given.
    """
    spec = load_robot(robot)
    found = export_fleet(config, spec, logs, battery)
    with atomic_write(out) as temporary:
        temporary.write_bytes(found.raw)
    changed = {key: {"before": before, "after": after} for key, (before, after) in found.changed.items()}
    result = {"schema": "missionsim.fleet_export/1", "config": str(config), "robot": spec.name, "changed": changed}
    to.emit({**result, "errors": found.errors, "remarks": found.remarks})
    if to.text:
        rows: list[tuple[Any, ...]] = [
            (".".join(NUMBERS[key].path), f"{before:.6g}", f"{after:.6g}")
            for key, (before, after) in found.changed.items()
        ]
        show_table("Numbers", ["key", ">before", ">after"], rows)
        if found.errors:
            rows = [(e["formula"], f"{e['energy_error_pct']:+.2f} %", rounded(e["power_rmse_w"])) for e in found.errors]
            show_table("On the logs", ["formula", ">energy error", ">power RMSE W"], rows)
    _tell(to, "", found.remarks, out)
    return 0


@app.command
def vda5050(
    mission: Path,
    /,
    *,
    out: OutFile,
    robot: str | None = None,
    version: str = "3.0.0",
    timestamp: str = "",
    serial: str = "1",
    to: Output = TERMINAL,
) -> int:
    """Write a mission as an order of VDA 5050.

    Parameters
    ----------
    mission
        Mission file with an environment.
    out
        Order to write (JSON).
    robot
        Shipped robot or robot file in place of the mission's own.
    version
        2.0.0, 2.1.0 or 3.0.0.
    timestamp
        Of the order, such as 2026-01-01T00:00:00.000Z; now unless given.
    serial
        Serial number of the robot.
    """
    spec = load_mission(mission, robot=robot)
    order, remarks = order_of(spec, version=version, timestamp=timestamp, robot_id=serial)
    title = f"order {order['orderId']}: {len(order['nodes'])} nodes, VDA 5050 {version}"
    return _mission(order, title, remarks, out, to)


@app.command
def qgc(
    mission: Path, /, *, out: OutFile, robot: str | None = None, origin: str | None = None, to: Output = TERMINAL
) -> int:
    """Write a mission as a plan of QGroundControl for a rover.

    Parameters
    ----------
    mission
        Mission file with an environment.
    out
        Plan to write (NAME.plan).
    robot
        Shipped robot or robot file in place of the mission's own.
    origin
        LATITUDE,LONGITUDE of the map's point 0, 0 in degrees; what the map's notes say unless given.
    """
    where = None
    if origin is not None:
        try:
            latitude, longitude = (float(word) for word in origin.split(","))
        except ValueError:
            latitude = longitude = 1e9
        if not (abs(latitude) <= 90.0 and abs(longitude) <= 360.0):
            raise InputError.single("--origin is a latitude and a longitude", got=origin, allowed="47.05,8.3")
        where = (latitude, longitude)
    plan, remarks = plan_of(load_mission(mission, robot=robot), where)
    return _mission(plan, f"plan of {len(plan['mission']['items'])} items", remarks, out, to)


def _mission(data: dict[str, Any], title: str, remarks: Sequence[str], out: Path, to: Output) -> int:
    write_text(out, to_json(data))
    to.emit({"schema": "missionsim.export/1", "out": str(out), "told": list(remarks)})
    _tell(to, title, remarks, out)
    return 0


def _within(*options: tuple[str, float | None, float, float]) -> None:
    """Refuse numbers outside what they may be, all of them at once."""
    if faults := [
        Fault("", 0, 0, f"{name} cannot be used so", "", f"{value:g}", f"{low:g} to {high:g}")
        for name, value, low, high in options
        if value is not None and not low <= value <= high
    ]:
        raise InputError(faults)


def _tell(to: Output, title: str, remarks: Iterable[object], *written: Path | None) -> None:
    for line in filter(None, (title, *(f"  {remark}" for remark in remarks))) if to.text else ():
        console().print(line, soft_wrap=True)
    to.written(*written)


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
    if mission is not None and out is None:
        raise InputError.single("--mission needs --out", allowed="--out SITE.yaml --mission MISSION.yaml")
    _within(("--smooth", smooth, 0.0, 1e5), ("--scale", scale, 1e-9, 1e3))
    driver = robot or ("pioneer3dx" if mission is not None else None)
    spec = None if driver is None else load_robot(driver)
    site = read(file, SiteOptions(spec, vehicle, graph, scale, smooth))
    ours = {
        "--vehicle": (bool(vehicle), "layout"),
        "--graph": (graph is not None, "Open-RMF"),
        "--scale": (scale is not None, "Open-RMF"),
        "--smooth": (smooth != 50.0, "GPX"),
    }
    if other := [f"{name} is for {of} files" for name, (given, of) in ours.items() if given and of not in site.format]:
        raise InputError(Fault(site.file, 0, 0, told, "", site.format) for told in other)
    if driver is not None and robot is None:
        site.tell("robot of the mission: pioneer3dx, since --robot names none")
    if out is not None:
        write_site(site, out, mission, driver or "")
    to.emit({**site.summary(), "out": out, "mission": mission})
    one_way = sum(not edge.get("both_ways", True) for edge in site.edges)
    ways = f"{counted(len(site.edges), 'way')} ({one_way} one-way, {site.length_m:.1f} m)"
    parts = [counted(len(site.places), "place"), ways]
    if site.chargers:
        named = f"{', '.join(site.chargers[:6])}{', …' * (len(site.chargers) > 6)}"
        parts.append(f"{counted(len(site.chargers), 'charger')} ({named})")
    if site.segments:
        parts.append(f"a mission of {counted(len(site.segments), 'segment')}")
    _tell(to, f"{site.file}: {site.format}, {', '.join(parts)}", site.remarks.values(), out, mission)
    return 0


def import_robot(
    config: Path, /, *, out: RobotFile | None = None, battery: str = "robot", to: Output = TERMINAL
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
    """
    if not re.fullmatch("[a-z][a-z0-9_]{0,59}", battery):
        allowed = "lower-case letters, digits and _, beginning with a letter"
        raise InputError.single("--battery is not a name that can be used here", got=battery, allowed=allowed)
    fleet = read_fleet(config)
    text = fleet.robot_text(battery)
    name = robot_from_text(text, str(out or config)).name
    if out is not None:
        write_text(out, text)
    found = {"numbers": fleet.numbers, "limits": fleet.limits, "robots": fleet.robots}
    told = list(map(vars, fleet.remarks.values()))
    to.emit({"schema": "missionsim.fleet/1", "source": str(config), "robot": name, **found, "told": told, "out": out})
    n = fleet.numbers
    line = f"{n['mass']:g} kg, {n['capacity'] * n['voltage']:g} Wh, friction {n['friction']:g}"
    line += f", ambient {n['ambient']:g} W, tool {n['tool']:g} W"
    _tell(to, f"{config}: Open-RMF fleet {fleet.name}, {line}", fleet.remarks.values(), out)
    return 0

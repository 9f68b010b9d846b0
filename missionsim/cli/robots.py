"""`missionsim robots`: the shipped robots."""

from __future__ import annotations

from typing import Any

from missionsim.cli.options import TERMINAL, Output
from missionsim.report.terminal import console, simple_table


def robots(*, to: Output = TERMINAL) -> int:
    """List the shipped robots with their batteries, components and control schemes.

    Parameters
    ----------
    """
    from missionsim.inputs import load_robot, shipped_robots

    described: list[dict[str, Any]] = []
    for name, path in shipped_robots().items():
        robot = load_robot(name)
        described.append(
            {
                "name": robot.name,
                "title": robot.title,
                "path": str(path),
                "sha256": robot.sha256,
                "drive": robot.body.drive,
                "max_speed_m_s": robot.body.max_speed.value,
                "batteries": {key: {"capacity_wh": battery.capacity_wh} for key, battery in robot.batteries.items()},
                "components": {
                    key: {"units": item.units, "always_on": item.always_on} for key, item in robot.components.items()
                },
                "schemes": {key: list(item.navigation) for key, item in robot.schemes.items()},
                "motion_model": robot.motion.model if robot.motion is not None else None,
                "sources": robot.sources,
            }
        )
    to.emit({"schema": "missionsim.robots/1", "robots": described})
    if to.text:
        rows = []
        for item in described:
            batteries = "\n".join(f"{key} {value['capacity_wh']:.4g} Wh" for key, value in item["batteries"].items())
            switched = [
                key + (f" ×{value['units']}" if value["units"] > 1 else "")
                for key, value in item["components"].items()
                if not value["always_on"]
            ]
            rows.append(
                (item["name"], item["title"], batteries, ", ".join(switched) or "–", "\n".join(item["schemes"]) or "–")
            )
        columns = ["robot", "what it is", "batteries", "components that switch", "control schemes"]
        console().print(simple_table("Shipped robots", columns, rows))
    return 0

"""Power of a robot at steady speeds, as the engine books it: what an edge of a map costs, whoever plans the route."""

from __future__ import annotations

import tempfile
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from missionsim.exchange.site import flow, scalar
from missionsim.inputs.loading import load_mission

if TYPE_CHECKING:
    from missionsim.inputs.robot import RobotSpec

_LENGTH_M = 100.0


def steady_power(
    robot: RobotSpec, drives: Sequence[tuple[float, float]], *, scheme: str = "", payload_kg: float = 0.0
) -> dict[str, NDArray[np.float64]]:
    """Power of each battery while driving straight on.

    Parameters
    ----------
    robot : RobotSpec
    drives : sequence of (float, float)
        Slope [rad] and speed [m/s] of each.
    scheme : str
        Control scheme; by default the robot's first that moves.
    payload_kg : float

    Returns
    -------
    dict of str to ndarray, shape (len(drives),)
        W. Starts, stops and turns are not in it; batteries are as full as they like.

    Raises
    ------
    missionsim.errors.InputError
        What the robot cannot do.
    """
    from missionsim.engine.simulate import simulate

    scheme = scheme or next((name for name, spec in robot.schemes.items() if spec.motion), "")
    defaults = {"scheme": scheme, "profile": "constant_speed", "payload": f"{payload_kg:.9g} kg" if payload_kg else ""}
    # one run of 100 m for each pair: the engine books it like any other mission
    segments = [
        {"drive": {"distance": f"{_LENGTH_M:g} m", "slope": f"{slope:.12g} rad", "speed": f"{speed:.12g} m/s"}}
        for slope, speed in drives
    ]
    lines = ["kind: mission", "name: steady", f"robot: {scalar(robot.name)}"]
    lines.append(f"defaults: {flow({key: value for key, value in defaults.items() if value})}")
    lines += ["policy: {on_empty: stop}", "segments:", *(f"  - {flow(segment)}" for segment in segments)]
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "steady.yaml"
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        endless = robot.model_copy(
            update={"batteries": {name: _endless(battery) for name, battery in robot.batteries.items()}}
        )
        result = simulate(load_mission(path, robot=endless))
    seconds = np.array([_LENGTH_M / speed for _, speed in drives])
    return {name: result.by_segment_wh(name) * 3600.0 / seconds for name in robot.batteries}


def _endless(battery: object) -> object:
    from missionsim.inputs.battery import BatterySpec, ConstantEnergy
    from missionsim.inputs.parameter import Parameter

    assert isinstance(battery, BatterySpec)
    update = {"capacity": Parameter(1e12, unit="J"), "model": ConstantEnergy.model_construct()}
    return battery.model_copy(update=update)

"""The patrol of the benchmarks: 40 segments, 10 components, two batteries; and a script that polls it at 10 Hz."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import simpy

COMPONENTS = 10
SPEEDS = (0.5, 0.8)
LENGTHS = (80.0, 60.0)
INSPECTION_S = 180.0
STEP_S = 0.1


def component_power(index: int) -> float:
    """Power of a component [W]."""
    return 0.5 + 0.1 * index


def sensors(block: int) -> list[int]:
    """Components that are on in a block of four segments."""
    return [j for j in range(COMPONENTS) if (block + j) % 3]


def write(folder: Path, scale: float = 1.0) -> Path:
    """Robot and mission as files; `scale` stretches the distances and inspections, not the number of events."""
    loads = "".join(
        f"\n  c{i}: {{loads: [{{battery: {'main' if i % 2 else 'aux'}, power: {component_power(i)} W}}]}}"
        for i in range(COMPONENTS)
    )
    (folder / "robot.yaml").write_text(
        "kind: robot\nname: bench\n"
        "body: {mass: 20 kg, drive: differential, max_speed: 1 m/s, max_acceleration: 0.5 m/s^2,\n"
        "       max_yaw_rate: 1 rad/s, max_yaw_acceleration: 2 rad/s^2}\n"
        "batteries: {main: {capacity: 100 kWh}, aux: {capacity: 100 kWh}}\n"
        "motion: {battery: main, model: polynomial, parameters: {c2: 6, c3: 9, c4: 3.6, standing: 2.6}}\n"
        f"components:{loads}\n"
    )
    segments = []
    for block in range(10):
        on = "{" + ", ".join(f"c{j}: 1" for j in sensors(block)) + "}"
        segments += [
            f"  - drive: {{distance: {LENGTHS[0] * scale} m, speed: {SPEEDS[0]} m/s, sensors: {on}}}",
            f"  - turn: {{angle: 90 deg, sensors: {on}}}",
            f"  - drive: {{distance: {LENGTHS[1] * scale} m, speed: {SPEEDS[1]} m/s, sensors: {on}}}",
            f"  - inspect: {{duration: {INSPECTION_S * scale} s, sensors: {on}}}",
        ]
    path = folder / "mission.yaml"
    path.write_text("kind: mission\nname: bench\nrobot: robot.yaml\nsegments:\n" + "\n".join(segments) + "\n")
    return path


@dataclass
class Polled:
    """State of the polled robot."""

    speed_m_s: float = 0.0
    moving: bool = False
    on: set[int] = field(default_factory=set)
    energy_j: list[float] = field(default_factory=lambda: [0.0] * (COMPONENTS + 1))
    finished: bool = False


def polling_script() -> Polled:
    """The same patrol as people write it in plain SimPy: every component looks at the robot ten times a second."""
    env = simpy.Environment()
    robot = Polled()

    def component(index: int):  # type: ignore[no-untyped-def]
        power = component_power(index)
        while not robot.finished:
            if index in robot.on:
                robot.energy_j[index] += power * STEP_S
            yield env.timeout(STEP_S)

    def motors():  # type: ignore[no-untyped-def]
        while not robot.finished:
            v = robot.speed_m_s
            power = 6.0 * v * v + 9.0 * v + 3.6 if robot.moving else 2.6
            robot.energy_j[COMPONENTS] += power * STEP_S
            yield env.timeout(STEP_S)

    def ramp(distance: float, limit: float, rate: float, drives: bool):  # type: ignore[no-untyped-def]
        robot.moving = True
        done = speed = 0.0
        while done < distance and speed >= 0.0:
            left = distance - done
            speed = min(limit, speed + rate * STEP_S, (2.0 * rate * left) ** 0.5)
            done += max(speed, 0.01) * STEP_S
            robot.speed_m_s = speed if drives else 0.0
            yield env.timeout(STEP_S)
        robot.moving = False
        robot.speed_m_s = 0.0

    def driver():  # type: ignore[no-untyped-def]
        for block in range(10):
            robot.on = set(sensors(block))
            yield from ramp(LENGTHS[0], SPEEDS[0], 0.5, True)
            yield from ramp(1.5708, 1.0, 2.0, False)
            yield from ramp(LENGTHS[1], SPEEDS[1], 0.5, True)
            yield env.timeout(INSPECTION_S)
        robot.finished = True

    for index in range(COMPONENTS):
        env.process(component(index))
    env.process(motors())
    env.process(driver())
    env.run()
    return robot

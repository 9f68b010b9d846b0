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


def write(folder: Path, scale: float = 1.0, times: int = 1) -> Path:
    """Robot and mission as files; `scale` stretches distances and inspections, `times` repeats all 40 segments."""
    loads = "".join(
        f"\n  c{i}: {{loads: [{{battery: {'main' if i % 2 else 'aux'}, power: {component_power(i)} W}}]}}"
        for i in range(COMPONENTS)
    )
    (folder / "robot.yaml").write_text(
        "kind: robot\nname: bench\n"
        "body: {mass: 20 kg, drive: differential, max_speed: 1 m/s, max_acceleration: 0.5 m/s^2,\n"
        "       max_yaw_rate: 1 rad/s, max_yaw_acceleration: 2 rad/s^2}\n"
        "batteries: {main: {capacity: 1 MWh}, aux: {capacity: 1 MWh}}\n"
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
    if times > 1:
        head = ["  - repeat:", f"      times: {times}", "      segments:"]
        segments = [*head, *(line.replace("  - ", "        - ", 1) for line in segments)]
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


def polling_script(scale: float = 1.0) -> Polled:
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
            yield from ramp(LENGTHS[0] * scale, SPEEDS[0], 0.5, True)
            yield from ramp(1.5708, 1.0, 2.0, False)
            yield from ramp(LENGTHS[1] * scale, SPEEDS[1], 0.5, True)
            yield env.timeout(INSPECTION_S * scale)
        robot.finished = True

    for index in range(COMPONENTS):
        env.process(component(index))
    env.process(motors())
    env.process(driver())
    env.run()
    return robot


def by_hand(scale: float = 1.0, times: int = 1) -> list[float]:
    """The same patrol as an expert writes it in SimPy for this one mission: events only, energies in closed form.

    No trace, no batteries, no messages, no second mission: the least that gives each component's energy in J, motors
    last.
    """
    env = simpy.Environment()
    energy = [0.0] * (COMPONENTS + 1)
    since: dict[int, float] = {}

    def switch(wanted: list[int]) -> None:
        for index in [i for i in since if i not in wanted]:
            energy[index] += component_power(index) * (env.now - since.pop(index))
        for index in wanted:
            since.setdefault(index, env.now)

    def drive(length: float, top: float, rate: float, turning: bool):  # type: ignore[no-untyped-def]
        top = min(top, (rate * length) ** 0.5)
        ramp, cruise = top / rate, max(0.0, length - top * top / rate) / top
        for seconds, begin, slope in ((ramp, 0.0, rate), (cruise, top, 0.0), (ramp, top, -rate)):
            if seconds > 0.0:
                yield env.timeout(seconds)
                v, a, t = (0.0, 0.0, seconds) if turning else (begin, slope, seconds)
                way, squares = v * t + a * t * t / 2.0, v * v * t + v * a * t * t + a * a * t**3 / 3.0
                energy[COMPONENTS] += 6.0 * squares + 9.0 * way + 3.6 * t

    def driver():  # type: ignore[no-untyped-def]
        for block in range(10 * times):
            switch(sensors(block % 10))
            yield from drive(LENGTHS[0] * scale, SPEEDS[0], 0.5, False)
            yield from drive(1.5707963267948966, 1.0, 2.0, True)
            yield from drive(LENGTHS[1] * scale, SPEEDS[1], 0.5, False)
            yield env.timeout(INSPECTION_S * scale)
            energy[COMPONENTS] += 2.6 * INSPECTION_S * scale
        switch([])

    env.process(driver())
    env.run()
    return energy

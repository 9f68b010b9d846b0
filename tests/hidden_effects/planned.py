"""Runs that follow a mission, and how the robot behaves otherwise than planned: longer, slower, waiting."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .motion import STEP_S, Motion, Robot, RunDesign
from .track import Track, realise

EXECUTION = ("path_stretch", "speed_tracking", "dwell")
SCHEME = "drive"


@dataclass(frozen=True)
class Leg:
    """One segment of the mission: a drive (distance and speed), a turn on the spot (angle) or a wait (seconds)."""

    name: str
    distance_m: float = 0.0
    speed_m_s: float = 0.0
    angle_rad: float = 0.0
    seconds: float = 0.0


@dataclass(frozen=True)
class Behaviour:
    """Distance driven over planned, speed reached over asked, unplanned standing as a part of the planned time."""

    path_stretch: float = 1.0
    speed_tracking: float = 1.0
    dwell: float = 0.0


YAW_RATE_RAD_S = 0.6


def plan_mission(robot: Robot, duration_s: float, rng: np.random.Generator) -> tuple[Leg, ...]:
    """A mission of about ``duration_s``: drives at several speeds, turns between them, some waits."""
    legs: list[Leg] = []
    total, i = 0.0, 0
    lo, hi = robot.speed_m_s
    while total < duration_s:
        speed = float(np.round(rng.uniform(max(lo, 0.4 * hi), 0.9 * hi), 2))
        distance = float(np.round(speed * rng.uniform(20.0, 50.0), 1))
        legs.append(Leg(f"leg_{i:02d}", distance_m=distance, speed_m_s=speed))
        legs.append(Leg(f"turn_{i:02d}", angle_rad=float(rng.choice([-1.0, 1.0])) * np.pi / 2.0))
        total += distance / speed + np.pi / 2.0 / YAW_RATE_RAD_S
        if rng.random() < 0.35:
            seconds = float(np.round(rng.uniform(5.0, 15.0)))
            legs.append(Leg(f"wait_{i:02d}", seconds=seconds))
            total += seconds
        i += 1
    return tuple(legs)


def mission_yaml(legs: tuple[Leg, ...], robot_reference: str, components: tuple[str, ...]) -> str:
    """The mission as the user has it."""
    on = ", ".join(f"{name}: 1" for name in components)
    lines = ["kind: mission", "name: planned", f"robot: {robot_reference}"]
    lines += [f"defaults: {{scheme: {SCHEME}, sensors: {{{on}}}}}", "segments:"]
    for leg in legs:
        if leg.distance_m:
            lines.append(f"  - drive: {{name: {leg.name}, distance: {leg.distance_m} m, speed: {leg.speed_m_s} m/s}}")
        elif leg.angle_rad:
            angle, rate = np.degrees(leg.angle_rad), YAW_RATE_RAD_S
            lines.append(f"  - turn: {{name: {leg.name}, angle: {angle:.1f} deg, yaw_rate: {rate} rad/s}}")
        else:
            lines.append(f"  - wait: {{name: {leg.name}, duration: {leg.seconds} s}}")
    return "\n".join(lines) + "\n"


def behaviour_of(hidden: tuple[str, ...], share: float) -> Behaviour:
    """The behaviour that a case plants: ``share`` more distance, less speed, or waiting."""
    return Behaviour(
        1.0 + share if "path_stretch" in hidden else 1.0,
        1.0 - share if "speed_tracking" in hidden else 1.0,
        share if "dwell" in hidden else 0.0,
    )


def follow(robot: Robot, legs: tuple[Leg, ...], how: Behaviour, rng: np.random.Generator) -> tuple[Motion, list[str]]:
    """Drive the mission with 1 % of natural scatter; returns the motion and the segment of every fine step."""
    track = Track(robot.accel_m_s2, rng)
    track.edges.append((0.0, 0.0, 0))
    starts, names = [], []
    planned_s = sum(leg.seconds + (leg.distance_m / leg.speed_m_s if leg.speed_m_s else 0.0) for leg in legs)
    drives = [leg for leg in legs if leg.distance_m]
    stops = dict.fromkeys((leg.name for leg in drives), 0.0)
    if how.dwell:  # every unplanned halt lasts about 6 s, somewhere on a drive
        for _ in range(max(1, round(how.dwell * planned_s / 6.0))):
            stops[drives[int(rng.integers(len(drives)))].name] += 6.0 * rng.uniform(0.7, 1.3)
    for leg in legs:
        starts.append(track.now)
        names.append(leg.name)
        if leg.distance_m:
            _drive(track, leg, how, stops[leg.name], rng)
        elif leg.angle_rad:
            rate = float(np.sign(leg.angle_rad)) * YAW_RATE_RAD_S
            track.turn(rate, max(abs(leg.angle_rad) / YAW_RATE_RAD_S - abs(rate) / 2.0, 0.0))
        else:
            track.now += leg.seconds
    motion = realise(track, robot, RunDesign(round(track.now, 1), surface="tile", mostly_on="on", switching="on"), rng)
    index = np.clip(np.searchsorted(starts, motion.time_s, side="right") - 1, 0, None)
    return replace(motion, segment=index), [names[i] for i in index]


def _drive(track: Track, leg: Leg, how: Behaviour, stop_s: float, rng: np.random.Generator) -> None:
    distance = leg.distance_m * how.path_stretch * (1.0 + 0.01 * rng.standard_normal())
    speed = leg.speed_m_s * how.speed_tracking * (1.0 + 0.01 * rng.standard_normal())
    begin = track.now
    parts = [0.4, 0.6] if stop_s else [1.0]
    for i, part in enumerate(parts):
        track.go(speed)
        ramp_s = track.now - begin
        track.now += max(part * distance / speed - ramp_s, STEP_S)
        track.go(0.0)
        if stop_s and i == 0:
            track.now += stop_s
        begin = track.now
    if how.path_stretch > 1.0:  # weave so that the way is longer than the straight line
        swing, period = 2.0 * np.sqrt(how.path_stretch - 1.0), 8.0
        for now in np.arange(track.yaw_points[-1][0] + 0.1, track.now, period / 8.0):
            track.yaw_points.append((float(now), float(swing * 2 * np.pi / period * np.cos(2 * np.pi * now / period))))
        track.yaw_points += [(track.now + 0.05, 0.0)]

"""From legs to wheels: what the driver asks for, and the motion that comes of it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from .motion import STEP_S, SURFACES, Array, Motion, Robot, RunDesign, blocks, levels, smooth, wander


@dataclass
class Track:
    """Set points as break points of speed [m/s] and yaw rate [rad/s] over time [s]."""

    accel_m_s2: float
    rng: np.random.Generator
    speed_points: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0)])
    yaw_points: list[tuple[float, float]] = field(default_factory=lambda: [(0.0, 0.0)])
    edges: list[tuple[float, float, int]] = field(default_factory=list)  # start, slope, surface
    now: float = 0.0
    speed: float = 0.0

    def go(self, target: float) -> None:
        """Change speed with most of the acceleration that the robot has."""
        rate = self.accel_m_s2 * self.rng.uniform(0.6, 1.05)
        ramp = max(abs(target - self.speed) / rate, STEP_S)
        self.speed_points += [(self.now, self.speed), (self.now + ramp, target)]
        self.now, self.speed = self.now + ramp, target

    def turn(self, rate: float, seconds: float) -> None:
        """Turn at ``rate``, with ramps of 2 rad/s²."""
        rise = max(abs(rate) / 2.0, STEP_S)
        start = self.now
        ends = (start, start + rise, start + rise + seconds, start + 2.0 * rise + seconds)
        self.yaw_points += list(zip(ends, (0.0, rate, rate, 0.0), strict=True))
        self.now = ends[-1]


def drive(robot: Robot, plan: RunDesign, rng: np.random.Generator) -> Motion:
    """Drive one run: legs of cruising, turning and waiting, then the wheels with lag and noise."""
    track = Track(robot.accel_m_s2, rng)
    lo, hi = robot.speed_m_s
    surface = 1 if plan.surface == "carpet" else int(plan.surface == "mixed" and rng.random() < 0.5)
    while track.now < plan.duration_s:
        kind = rng.random()
        if kind < 0.70:
            slope = 0.0
            if plan.hills == "ramps" and rng.random() < 0.6:
                slope = float(rng.choice([-1.0, 1.0]) * rng.uniform(0.02, 0.1))
            elif plan.hills == "climb":
                slope = 0.05
            if plan.surface == "mixed" and rng.random() < 0.4:
                surface = 1 - surface
            track.edges.append((track.now, slope, surface))
            track.go(plan.one_speed if plan.one_speed is not None else float(rng.uniform(lo, hi)))
            for _ in range(int(rng.integers(1, 4))):
                track.now += float(rng.uniform(3.0, 14.0))
                if rng.random() < 0.45:
                    track.turn(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.08, 0.45)), float(rng.uniform(1.5, 6.0)))
            track.now += float(rng.uniform(2.0, 8.0))
        elif kind < 0.86:
            track.go(0.0)
            track.now += float(rng.uniform(0.5, 2.0))
            track.turn(float(rng.choice([-1.0, 1.0]) * rng.uniform(0.35, 1.2)), float(rng.uniform(2.0, 9.0)))
        else:
            track.go(0.0)
            track.now += float(rng.uniform(4.0, 18.0))
    track.edges = track.edges or [(0.0, 0.0, surface)]
    return realise(track, robot, plan, rng)


def realise(track: Track, robot: Robot, plan: RunDesign, rng: np.random.Generator) -> Motion:
    """The motion of a robot whose two wheels follow the track with lag and noise, in its surroundings."""
    n = round(plan.duration_s / STEP_S)
    t = (np.arange(n) + 0.5) * STEP_S
    tv, vv = zip(*track.speed_points, (track.now + 1.0, track.speed), strict=True)
    tw, ww = zip(*track.yaw_points, (track.now + 1.0, 0.0), strict=True)
    v_set, w_set = np.interp(t, tv, vv), np.interp(t, tw, ww)
    lag = float(rng.uniform(0.06, 0.15))
    half = 0.5 * robot.track_m

    def wheel(set_point: Array) -> Array:
        real = smooth(set_point, lag)
        return real * (1.0 + 0.006 * wander(n, 0.5, rng))

    left, right = wheel(v_set - w_set * half), wheel(v_set + w_set * half)
    v, w = 0.5 * (left + right), (right - left) / robot.track_m
    v = np.where(np.abs(v) < 1e-4, 0.0, v)
    index = np.clip(np.searchsorted([e[0] for e in track.edges], t, side="right") - 1, 0, None)
    payload = np.full(n, plan.payload_kg)
    if plan.pick_up:
        payload[t < plan.duration_s * rng.uniform(0.3, 0.7)] = 0.0
    heading = np.cumsum(w) * STEP_S + rng.uniform(-np.pi, np.pi)
    x, y = np.cumsum(v * np.cos(heading)) * STEP_S, np.cumsum(v * np.sin(heading)) * STEP_S
    ap = rng.uniform(-25.0, 25.0, 2) * robot.speed_m_s[1]
    return Motion(
        time_s=t,
        speed=v,
        accel=np.gradient(smooth(v, 0.1), STEP_S),
        yaw=w,
        wheel_left=left,
        wheel_right=right,
        slope=smooth(np.array([e[1] for e in track.edges])[index], 0.4),
        payload=payload,
        surface=np.array([e[2] for e in track.edges], dtype=np.int64)[index],
        temp=plan.temp_c + 0.3 * wander(n, 200.0, rng),
        cpu=np.clip(rng.uniform(0.4, 0.65) + 0.12 * wander(n, 15.0, rng) + 0.15 * blocks(t, 20.0, 60.0, rng), 0, 1),
        freq_hz=1e9 * np.array([0.8, 1.2, 1.6, 2.0])[levels(t, 15.0, 60.0, 4, rng)],
        distance_ap_m=np.hypot(x - ap[0], y - ap[1]) + 1.0,
        x=x,
        y=y,
        heading=heading,
        on=_components(robot, plan, t, rng),
        segment=index,
    )


def _components(robot: Robot, plan: RunDesign, t: Array, rng: np.random.Generator) -> dict[str, Array]:
    main = levels(t, 20.0, 80.0, 2, rng).astype(float)
    if plan.switching != "toggle":
        main = np.full(len(t), 1.0 if plan.switching == "on" else 0.0)
    second = np.ones(len(t))
    if plan.mostly_on == "mostly" and rng.random() < 0.6:
        start = rng.uniform(0.0, 0.8) * t[-1]
        second[(t >= start) & (t < start + rng.uniform(25.0, 70.0))] = 0.0
    return {robot.mostly_on: second, robot.switching: main}


def manoeuvre(robot: Robot, parts: Sequence[Mapping[str, Any]], rng: np.random.Generator) -> Motion:
    """Drive a scripted experiment.

    Parameters
    ----------
    parts
        Parts driven one after the other. Keys, all optional: seconds, speeds_m_s (driven in turn; empty = stand),
        yaw_rates_rad_s or yaw_rate_rad_s (in turn; on the spot while standing, else circles), stops, slope_rad (up and
        down in turn, 15 s each), payload_kg, surface, temp_ambient_c, cpu_load, cpu_freq_hz, access_point_distance_m,
        on (component to units). What is missing keeps the robot's usual value.
    """
    track = Track(robot.accel_m_s2, rng)
    starts: list[float] = []
    for part in parts:
        starts.append(track.now)
        _drive_part(track, part, robot)
    motion = realise(track, robot, RunDesign(round(track.now, 1), surface="tile"), rng)
    index = np.clip(np.searchsorted(starts, motion.time_s, side="right") - 1, 0, None)

    def each(values: list[Any], usual: Array) -> Array:
        chosen = np.array([np.nan if value is None else float(value) for value in values])[index]
        return np.where(np.isnan(chosen), usual, chosen)

    def column(key: str, usual: Array) -> Array:
        return each([part.get(key) for part in parts], usual)

    on = {name: each([(part.get("on") or {}).get(name) for part in parts], usual) for name, usual in motion.on.items()}
    return replace(
        motion,
        payload=column("payload_kg", motion.payload),
        temp=column("temp_ambient_c", motion.temp),
        cpu=column("cpu_load", motion.cpu),
        freq_hz=column("cpu_freq_hz", motion.freq_hz),
        distance_ap_m=column("access_point_distance_m", motion.distance_ap_m),
        on=on,
    )


def _drive_part(track: Track, part: Mapping[str, Any], robot: Robot) -> None:
    begin, seconds = track.now, float(part.get("seconds", 180.0))
    surface = SURFACES.index(part["surface"]) if part.get("surface") in SURFACES else 0
    slope = float(part.get("slope_rad") or 0.0)
    for k in range(int(np.ceil(seconds / 15.0)) if slope else 1):
        track.edges.append((begin + 15.0 * k, slope * (-1.0) ** k, surface))
    speeds = [min(float(v), robot.speed_m_s[1]) for v in part.get("speeds_m_s", [0.6 * robot.speed_m_s[1]])] or [0.0]
    rates = [float(w) for w in part.get("yaw_rates_rad_s", [part.get("yaw_rate_rad_s") or 0.0])]
    stops = int(part.get("stops", 0))
    for k, rate in enumerate(rates):
        if rate:
            first, last = begin + seconds * k / len(rates), begin + seconds * (k + 1) / len(rates)
            rise = abs(rate) / 2.0
            times = (first, first + rise, last - rise, last)
            track.yaw_points += list(zip(times, (0.0, rate, rate, 0.0), strict=True))
    legs = max(len(speeds), stops + 1)
    for leg in range(legs):
        end = begin + seconds * (leg + 1) / legs
        track.go(speeds[leg * len(speeds) // legs])
        if leg < stops or leg == legs - 1:  # at rest in good time, so that the part is as long as was asked
            track.now = max(track.now, end - 2.0 - track.speed / (0.6 * track.accel_m_s2))
            track.go(0.0)
        track.now = max(track.now, end)

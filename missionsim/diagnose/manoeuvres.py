"""Scripted manoeuvres of three minutes that vary one condition each (step 6): what to drive to learn more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import Any

import numpy as np

from missionsim.effects.covariates import Covariates
from missionsim.files import Json
from missionsim.labels import Labels
from missionsim.laws.experiment import CURVATURE
from missionsim.runs.covariates import is_switch
from missionsim.runs.motion import approach

STEP_S = 0.5
TOTAL_S = 180.0
DEFAULT_ACCELERATION_M_S2 = 0.3
"""Of a robot whose file and logs tell none."""
USUAL_RAMP, RAMPS, SHORTEST_STOP_S = 0.7, 4.0, 12.0
"""Acceleration of a manoeuvre in parts of the hardest that the logs hold both ways; time from stop to stop in times
that to reach the speed, so that half of it is driven at that speed; the shortest such time (assumed)."""
FAST, STRAIGHT_1_M = 1.0 / 3.0, 0.01
"""Part of a run's top speed from which on its curves are looked at; a curve that is none, of 100 m (assumed)."""
FOLLOWS = frozenset({"moving", "moving_time_s", "starts", "starts_per_s", "mass_kg", "load_w", "drive_w"})
"""What follows from the motion and load of a manoeuvre, however it usually was in the logs."""


@dataclass(frozen=True)
class Part:
    """One piece of a manoeuvre in which the conditions stay the same."""

    seconds: float
    speeds_m_s: tuple[float, ...] = ()
    """Speeds that are driven in turn, each for the same time; empty for standing still."""
    yaw_rates_rad_s: tuple[float, ...] = ()
    """Turn rates in turn, on the spot where `speeds_m_s` is empty."""
    stops: int = 0
    """Stops to rest on the way, evenly spread."""
    slope_rad: float | None = None
    """Up and down in turn."""
    set: Mapping[str, Any] = field(default_factory=dict)
    """Further columns that are set: ``payload_kg``, ``surface``, ``on_<component>``, ``cpu_load`` …"""

    def to_json(self) -> Json:
        """The part as plain data; what is missing stays as it usually is in the logs."""
        yaw = self.yaw_rates_rad_s
        data: dict[str, Any] = {"seconds": self.seconds, "speeds_m_s": list(self.speeds_m_s)}
        data |= {"yaw_rate_rad_s": max(yaw), "yaw_rates_rad_s": list(yaw)} if yaw else {"yaw_rate_rad_s": 0.0}
        data |= {"stops": self.stops} | ({} if self.slope_rad is None else {"slope_rad": self.slope_rad})
        data |= {name: value for name, value in self.set.items() if not is_switch(name)}
        on = {name[3:]: value for name, value in self.set.items() if is_switch(name)}
        return data | ({"on": on} if on else {})


@dataclass(frozen=True)
class Manoeuvre:
    """A named manoeuvre: its parts one after the other, and what to tell the driver."""

    name: str
    do: str
    parts: tuple[Part, ...]

    @property
    def varies(self) -> frozenset[str]:
        """Columns that it sets to more than one value, motion aside."""
        names = {name for part in self.parts for name in part.set}
        varied = {name for name in names if len({part.set.get(name) for part in self.parts}) > 1}
        varied |= {"slope_rad" for part in self.parts if part.slope_rad is not None}
        return frozenset(varied | {"yaw_rate_rad_s" for part in self.parts if part.yaw_rates_rad_s})

    @property
    def duration_s(self) -> float:
        """Length of all parts."""
        return sum(part.seconds for part in self.parts)


@dataclass(frozen=True)
class Site:
    """What the robot and the place of the logs allow, and how it usually was."""

    usual: Mapping[str, Any]
    """Typical value of each column: medians, and the most common text."""
    low: Mapping[str, float]
    high: Mapping[str, float]
    """Both: range of each numeric column in the logs."""
    choices: Mapping[str, tuple[str, ...]]
    """Texts seen in each text column."""
    max_speed_m_s: float
    """What it may try: half as fast again as it drove, which v² and v³ are told apart by."""
    max_yaw_rate_rad_s: float
    acceleration_m_s2: float
    components: Mapping[str, int]
    """Most units of each component that was logged."""
    _: KW_ONLY
    driven_m_s: float
    """The fastest that it drove here."""
    curvature_1_m: float = np.inf
    """The sharpest curve that it can drive; without a limit it turns on the spot."""

    @property
    def cruise_m_s(self) -> float:
        """An ordinary speed: two thirds of the fastest, at most 0.5 m/s where the robot is faster than that."""
        return round(min(0.67 * self.driven_m_s, max(0.5, 0.5 * self.driven_m_s)), 2)


def sharpest(covariates: Sequence[Covariates]) -> float:
    """The sharpest curve of some runs [1/m]; what a meter of turns says of a robot that creeps is none."""
    found = [0.0]
    for cov in covariates:
        speed, yaw = (np.abs(np.asarray(cov.get(name, 0.0), dtype=float)) for name in ("speed_m_s", "yaw_rate_rad_s"))
        fast = speed > FAST * np.percentile(speed, 99.5)
        if np.any(fast):
            found.append(float(np.percentile((np.broadcast_to(yaw, speed.shape)[fast]) / speed[fast], 99.5)))
    return max(found)


def site_of(covariates: Sequence[Covariates], most: Mapping[str, float]) -> Site:
    """What the logs show of the place, within what the robot can drive at `most`, by column."""
    names = set.intersection(*(set(cov) for cov in covariates))
    usual: dict[str, Any] = {}
    low: dict[str, float] = {}
    high: dict[str, float] = {}
    choices: dict[str, tuple[str, ...]] = {}
    for name in sorted(names):
        values = [cov[name] for cov in covariates]
        if all(isinstance(value, Labels) for value in values):
            texts = np.concatenate([value.texts() for value in values]).astype(str)
            found, counts = np.unique(texts[texts != ""], return_counts=True)
            if len(found):
                usual[name], choices[name] = str(found[int(np.argmax(counts))]), tuple(str(t) for t in found)
        elif not any(isinstance(value, Labels) for value in values) and any(np.ndim(value) == 1 for value in values):
            # a run without the column has one number for all its rows
            joined = np.concatenate([np.atleast_1d(np.asarray(value, dtype=float)) for value in values])
            usual[name] = float(np.median(joined))
            low[name], high[name] = (float(x) for x in np.percentile(joined, [0.5, 99.5]))
    driven, fastest = (min(most.get("speed_m_s", np.inf), f * high.get("speed_m_s", np.inf)) for f in (1.1, 1.5))
    spin = min(most.get("yaw_rate_rad_s", 1.0), max(1.2 * high.get("yaw_rate_rad_s", 1.0), 0.2))
    ramp = USUAL_RAMP * min(high.get("accel_m_s2", 0.0), -low.get("accel_m_s2", 0.0))
    components = {name[3:]: max(1, round(high[name])) for name in filter(is_switch, high)}
    return Site(
        usual,
        low,
        high,
        choices,
        fastest if np.isfinite(fastest) else 0.5,
        spin,
        most.get("accel_m_s2", ramp if ramp > 0.0 else DEFAULT_ACCELERATION_M_S2),
        components,
        driven_m_s=driven if np.isfinite(driven) else 0.5,
        curvature_1_m=most.get(CURVATURE, np.inf),
    )


def library(site: Site) -> list[Manoeuvre]:
    """Every manoeuvre that the place and the columns of the logs allow."""
    v, top, usual, low, high = site.cruise_m_s, site.max_speed_m_s, site.usual, site.low, site.high
    plain: dict[str, Any] = {"payload_kg": 0.0} if "payload_kg" in usual else {}
    unloaded = " without payload" if plain else ""
    where = f" on {usual['surface']}" if "surface" in usual else ""
    without = unloaded + where
    if where:
        plain["surface"] = usual["surface"]
    found: list[Manoeuvre] = []

    def add(name: str, do: str, *parts: Part) -> None:
        found.append(Manoeuvre(name, do, parts))

    def pair(name: str, do: str, column: str, *values: Any, still: bool = False, **more: Any) -> None:
        speeds = () if still else (v,)
        add(name, do, *(Part(TOTAL_S / 2, speeds, set={**plain, column: value, **more}) for value in values))

    def span(name: str) -> float:
        return high.get(name, 0.0) - low.get(name, 0.0)

    shares = (0.2, 0.45, 0.7, 0.95)
    told = ", ".join(f"{round(f * top, 2):g}" for f in shares)
    sweep = Part(TOTAL_S, tuple(round(f * top, 3) for f in shares), set=plain)
    add("speed sweep", f"drive straight and level{without} at {told} m/s, 45 s each", sweep)
    pieces = max(2, int(TOTAL_S // max(SHORTEST_STOP_S, RAMPS * v / site.acceleration_m_s2)))
    every_s, stops = TOTAL_S / pieces, Part(TOTAL_S, (v,), stops=pieces - 1, set=plain)
    do = f"drive straight and level{without} at {v:g} m/s with a full stop every {every_s:.0f} s, 3 min"
    add("stop and go", do, stops)
    half_and_half = Part(90.0, set=plain), Part(90.0, (v,), set=plain)
    add("stand and drive", f"stand still for 90 s, then drive straight{without} at {v:g} m/s for 90 s", *half_and_half)
    if "yaw_rate_rad_s" in usual:
        rates = tuple(round(f * site.max_yaw_rate_rad_s, 3) for f in (0.3, 0.6, 0.95))
        if np.isinf(site.curvature_1_m):
            told = ", ".join(f"{r:g}" for r in rates)
            add("spin", f"turn on the spot{without} at {told} rad/s, 1 min each", Part(TOTAL_S, (), rates, set=plain))
        if site.curvature_1_m > STRAIGHT_1_M:
            rate = min(rates[1], float(np.floor(1e3 * v * site.curvature_1_m) / 1e3))
            curve = f"drive{without} at {v:g} m/s, 90 s straight and 90 s in circles at {rate:g} rad/s"
            add("straight and curved", curve, *(Part(90.0, (v,), turn, set=plain) for turn in ((), (rate,))))
    if high.get("payload_kg", 0.0) > 0.0:
        load = round(high["payload_kg"], 1)
        do = f"drive straight and level{where} at {v:g} m/s, 90 s without payload and 90 s with {load:g} kg"
        pair("payload on and off", do, "payload_kg", 0.0, load)
    here = usual.get("surface", "")
    for other in site.choices.get("surface", ()):
        if other != here:
            do = f"drive {here} then {other} at {v:g} m/s{unloaded}, level, 90 s each"
            pair(f"{here} and {other}", do, "surface", here, other)
    steep = max(abs(low.get("slope_rad", 0.0)), abs(high.get("slope_rad", 0.0)))
    if steep > 0.01:
        steep = round(steep, 3)
        do = f"drive up and down a ramp of {np.degrees(steep):.1f} degrees{without} at {v:g} m/s, 3 min"
        add("ramp", do, Part(TOTAL_S, (v,), slope_rad=steep, set=plain))
    if span("temp_ambient_c") > 3.0:
        cold, warm = (float(round(end["temp_ambient_c"])) for end in (low, high))
        do = f"drive straight and level{without} at {v:g} m/s, 90 s at {cold:g} °C and 90 s at {warm:g} °C"
        pair("cold and warm", do, "temp_ambient_c", cold, warm)
    if span("cpu_load") > 0.05:
        do = "stand still, 90 s with the processor idle and 90 s under full load"
        pair("processor stress", do, "cpu_load", low["cpu_load"], high["cpu_load"], still=True)
    if high.get("cpu_freq_hz", 0.0) > 1.05 * low.get("cpu_freq_hz", 0.0) and "cpu_load" in usual:
        slow, fast = low["cpu_freq_hz"], high["cpu_freq_hz"]
        do = f"stand still under full load, 90 s at {slow / 1e9:.2f} GHz and 90 s at {fast / 1e9:.2f} GHz"
        pair("processor clock", do, "cpu_freq_hz", slow, fast, still=True, cpu_load=high["cpu_load"])
    if high.get("access_point_distance_m", 0.0) > 1.0:
        near, far = low["access_point_distance_m"], high["access_point_distance_m"]
        do = f"stand still, 90 s at {near:.0f} m from the access point and 90 s at {far:.0f} m"
        pair("near and far from the access point", do, "access_point_distance_m", near, far, still=True)
    off = {f"on_{name}": 0.0 for name in site.components}
    for name, units in site.components.items():
        do = f"stand still with everything else off and switch {name} off and on every 30 s, 3 min"
        switched = ({**off, f"on_{name}": float(units * (i % 2))} for i in range(6))
        add(f"{name} on and off", do, *(Part(30.0, set=own) for own in switched))
    if off:
        do = f"stand still with {', '.join(site.components)} switched off, 3 min"
        add("everything off", do, Part(TOTAL_S, set=off))
    return found


def script(manoeuvre: Manoeuvre, site: Site) -> Json:
    """Columns of a manoeuvre as a robot would log them, at `STEP_S`; shapes (n,)."""
    pieces = []
    for part in manoeuvre.parts:
        # trapezoidal speeds between rest, the speeds in turn, and rest
        count = max(4, round(part.seconds / STEP_S))
        rows = np.arange(count)
        target, yaw, slope = np.zeros(count), np.zeros(count), np.zeros(count)
        if part.speeds_m_s:
            for wanted, leg in zip(part.speeds_m_s, np.array_split(rows, len(part.speeds_m_s)), strict=True):
                target[leg] = wanted
            target[-2:] = 0.0
            braking = int(np.ceil(max(part.speeds_m_s) / site.acceleration_m_s2 / STEP_S))
            for rest in np.array_split(rows, part.stops + 1)[:-1]:
                target[rest[-max(6, braking + 2) :]] = 0.0
        if part.yaw_rates_rad_s:
            for rate, leg in zip(part.yaw_rates_rad_s, np.array_split(rows, len(part.yaw_rates_rad_s)), strict=True):
                yaw[leg] = rate
        if part.slope_rad is not None:
            # up and down in turn, 15 s each
            slope = np.where((rows * STEP_S // 15.0) % 2 == 0, part.slope_rad, -part.slope_rad)
        speed = approach(target, STEP_S, site.acceleration_m_s2)
        pieces.append((speed, np.gradient(speed, STEP_S), yaw, slope))
    lengths = [len(piece[0]) for piece in pieces]
    columns: dict[str, Any] = {"time_s": STEP_S * (0.5 + np.arange(sum(lengths)))}
    for i, name in enumerate(("speed_m_s", "accel_m_s2", "yaw_rate_rad_s", "slope_rad")):
        columns[name] = np.concatenate([piece[i] for piece in pieces])
    for name, usual in site.usual.items():
        if name in columns or name in FOLLOWS or name.startswith("on_time_"):
            continue
        values = [part.set.get(name, usual) for part in manoeuvre.parts]
        if isinstance(usual, str):
            known = tuple(dict.fromkeys([*site.choices.get(name, ()), *values]))
            codes = np.repeat([known.index(value) for value in values], lengths)
            columns[name] = Labels(codes.astype(np.int64), known)
        else:
            columns[name] = np.repeat(np.asarray(values, dtype=float), lengths)
    return columns


def shortened(manoeuvre: Manoeuvre, factor: float) -> Manoeuvre:
    """The same manoeuvre with every part `factor` times as long."""
    return replace(manoeuvre, parts=tuple(replace(part, seconds=part.seconds * factor) for part in manoeuvre.parts))

"""Scripted manoeuvres of three minutes that vary one condition each (step 6): what to drive to learn more."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from missionsim.effects.covariates import Covariates
from missionsim.files import Json
from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.motion import approach

STEP_S = 0.5
TOTAL_S = 180.0
DEFAULT_ACCELERATION_M_S2 = 0.3
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
        data: dict[str, Any] = {"seconds": self.seconds, "speeds_m_s": list(self.speeds_m_s)}
        if self.yaw_rates_rad_s:
            data["yaw_rate_rad_s"] = max(self.yaw_rates_rad_s)
            data["yaw_rates_rad_s"] = list(self.yaw_rates_rad_s)
        else:
            data["yaw_rate_rad_s"] = 0.0
        data["stops"] = self.stops
        if self.slope_rad is not None:
            data["slope_rad"] = self.slope_rad
        on = {name[3:]: value for name, value in self.set.items() if name.startswith("on_")}
        data |= {name: value for name, value in self.set.items() if not name.startswith("on_")}
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
        if any(part.slope_rad is not None for part in self.parts):
            varied.add("slope_rad")
        if any(len(part.yaw_rates_rad_s) > 0 for part in self.parts):
            varied.add("yaw_rate_rad_s")
        return frozenset(varied)

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
    max_yaw_rate_rad_s: float
    acceleration_m_s2: float
    components: Mapping[str, int]
    """Most units of each component that was logged."""

    @property
    def cruise_m_s(self) -> float:
        """An ordinary speed: two thirds of the fastest, at most 0.5 m/s where the robot is faster than that."""
        return round(min(0.67 * self.max_speed_m_s, max(0.5, 0.5 * self.max_speed_m_s)), 2)


def site_of(covariates: Sequence[Covariates], limits: Mapping[str, float]) -> Site:
    """What the logs show of the place, within the robot's ``max_speed``, ``max_yaw_rate`` and ``acceleration``."""
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
    fastest = min(limits.get("max_speed", np.inf), 1.1 * high.get("speed_m_s", np.inf))
    spin = min(limits.get("max_yaw_rate", 1.0), max(1.2 * high.get("yaw_rate_rad_s", 1.0), 0.2))
    switched = [name for name in high if name.startswith("on_") and not name.startswith("on_time")]
    components = {name[3:]: max(1, round(high[name])) for name in switched}
    return Site(
        usual,
        low,
        high,
        choices,
        fastest if np.isfinite(fastest) else 0.5,
        spin,
        limits.get("acceleration", DEFAULT_ACCELERATION_M_S2),
        components,
    )


def library(site: Site) -> list[Manoeuvre]:
    """Every manoeuvre that the place and the columns of the logs allow."""
    v, top, spin = site.cruise_m_s, site.max_speed_m_s, site.max_yaw_rate_rad_s
    plain: dict[str, Any] = {"payload_kg": 0.0} if "payload_kg" in site.usual else {}
    without = " without payload" if plain else ""
    if "surface" in site.usual:
        plain["surface"] = site.usual["surface"]
        without += f" on {site.usual['surface']}"
    found = [
        Manoeuvre(
            "speed sweep",
            f"drive straight and level{without} at {_speeds(top)} m/s, 45 s each",
            (Part(TOTAL_S, tuple(round(f * top, 3) for f in (0.2, 0.45, 0.7, 0.95)), set=plain),),
        ),
        Manoeuvre(
            "stop and go",
            f"drive straight and level{without} at {v:g} m/s with a full stop every 12 s, 3 min",
            (Part(TOTAL_S, (v,), stops=15, set=plain),),
        ),
        Manoeuvre(
            "stand and drive",
            f"stand still for 90 s, then drive straight{without} at {v:g} m/s for 90 s",
            (Part(90.0, set=plain), Part(90.0, (v,), set=plain)),
        ),
    ]
    if "yaw_rate_rad_s" in site.usual:
        rates = tuple(round(f * spin, 3) for f in (0.3, 0.6, 0.95))
        told = ", ".join(f"{r:g}" for r in rates)
        found.append(
            Manoeuvre(
                "spin", f"turn on the spot{without} at {told} rad/s, 1 min each", (Part(TOTAL_S, (), rates, set=plain),)
            )
        )
        found.append(
            Manoeuvre(
                "straight and curved",
                f"drive{without} at {v:g} m/s, 90 s straight and 90 s in circles at {rates[1]:g} rad/s",
                (Part(90.0, (v,), set=plain), Part(90.0, (v,), (rates[1],), set=plain)),
            )
        )
    found += _varied(site, v, plain, without)
    found += _components(site)
    return found


def _speeds(top: float) -> str:
    return ", ".join(f"{round(f * top, 2):g}" for f in (0.2, 0.45, 0.7, 0.95))


def _varied(site: Site, v: float, plain: Mapping[str, Any], without: str) -> list[Manoeuvre]:
    found: list[Manoeuvre] = []
    half = TOTAL_S / 2

    def pair(name: str, do: str, one: Mapping[str, Any], other: Mapping[str, Any], still: bool = False) -> None:
        speeds = () if still else (v,)
        parts = (Part(half, speeds, set={**plain, **one}), Part(half, speeds, set={**plain, **other}))
        found.append(Manoeuvre(name, do, parts))

    if site.high.get("payload_kg", 0.0) > 0.0:
        load = round(site.high["payload_kg"], 1)
        where = f" on {site.usual['surface']}" if "surface" in site.usual else ""
        pair(
            "payload on and off",
            f"drive straight and level{where} at {v:g} m/s, 90 s without payload and 90 s with {load:g} kg",
            {"payload_kg": 0.0},
            {"payload_kg": load},
        )
    surfaces = site.choices.get("surface", ())
    usual = site.usual.get("surface", "")
    for other in (name for name in surfaces if name != usual):
        unloaded = " without payload" if "payload_kg" in site.usual else ""
        pair(
            f"{usual} and {other}",
            f"drive {usual} then {other} at {v:g} m/s{unloaded}, level, 90 s each",
            {"surface": usual},
            {"surface": other},
        )
    slope = max(abs(site.low.get("slope_rad", 0.0)), abs(site.high.get("slope_rad", 0.0)))
    if slope > 0.01:
        steep = round(slope, 3)
        found.append(
            Manoeuvre(
                "ramp",
                f"drive up and down a ramp of {np.degrees(steep):.1f} degrees{without} at {v:g} m/s, 3 min",
                (Part(TOTAL_S, (v,), slope_rad=steep, set=plain),),
            )
        )
    if site.high.get("temp_ambient_c", 0.0) - site.low.get("temp_ambient_c", 0.0) > 3.0:
        cold, warm = round(site.low["temp_ambient_c"]), round(site.high["temp_ambient_c"])
        pair(
            "cold and warm",
            f"drive straight and level{without} at {v:g} m/s, 90 s at {cold:g} °C and 90 s at {warm:g} °C",
            {"temp_ambient_c": float(cold)},
            {"temp_ambient_c": float(warm)},
        )
    if site.high.get("cpu_load", 0.0) - site.low.get("cpu_load", 0.0) > 0.05:
        pair(
            "processor stress",
            "stand still, 90 s with the processor idle and 90 s under full load",
            {"cpu_load": site.low["cpu_load"]},
            {"cpu_load": site.high["cpu_load"]},
            still=True,
        )
    if site.high.get("cpu_freq_hz", 0.0) > 1.05 * site.low.get("cpu_freq_hz", 0.0) and "cpu_load" in site.usual:
        slow, fast = (f"{value / 1e9:.2f} GHz" for value in (site.low["cpu_freq_hz"], site.high["cpu_freq_hz"]))
        pair(
            "processor clock",
            f"stand still under full load, 90 s at {slow} and 90 s at {fast}",
            {"cpu_freq_hz": site.low["cpu_freq_hz"], "cpu_load": site.high["cpu_load"]},
            {"cpu_freq_hz": site.high["cpu_freq_hz"], "cpu_load": site.high["cpu_load"]},
            still=True,
        )
    if site.high.get("access_point_distance_m", 0.0) > 1.0:
        near, far = site.low["access_point_distance_m"], site.high["access_point_distance_m"]
        pair(
            "near and far from the access point",
            f"stand still, 90 s at {near:.0f} m from the access point and 90 s at {far:.0f} m",
            {"access_point_distance_m": near},
            {"access_point_distance_m": far},
            still=True,
        )
    return found


def _components(site: Site) -> list[Manoeuvre]:
    """Each component on and off while everything else stands still; and all of them off."""
    found = []
    off = {f"on_{name}": 0.0 for name in site.components}
    for name, units in site.components.items():
        parts = tuple(Part(30.0, set={**off, f"on_{name}": float(units * (i % 2))}) for i in range(6))
        found.append(
            Manoeuvre(
                f"{name} on and off",
                f"stand still with everything else off and switch {name} off and on every 30 s, 3 min",
                parts,
            )
        )
    if site.components:
        found.append(
            Manoeuvre(
                "everything off",
                f"stand still with {', '.join(site.components)} switched off, 3 min",
                (Part(TOTAL_S, set=off),),
            )
        )
    return found


def script(manoeuvre: Manoeuvre, site: Site) -> Json:
    """Columns of a manoeuvre as a robot would log them, at `STEP_S`; shapes (n,)."""
    pieces = [_drive(part, site) for part in manoeuvre.parts]
    count = sum(len(piece["speed_m_s"]) for piece in pieces)
    columns: dict[str, Any] = {"time_s": STEP_S * (0.5 + np.arange(count))}
    for name in ("speed_m_s", "accel_m_s2", "yaw_rate_rad_s", "slope_rad"):
        columns[name] = np.concatenate([piece[name] for piece in pieces])
    for name, usual in site.usual.items():
        if name in columns or name in FOLLOWS or name.startswith("on_time_"):
            continue
        values = [part.set.get(name, usual) for part in manoeuvre.parts]
        lengths = [len(piece["speed_m_s"]) for piece in pieces]
        if isinstance(usual, str):
            known = tuple(dict.fromkeys([*site.choices.get(name, ()), *values]))
            codes = np.repeat([known.index(value) for value in values], lengths)
            columns[name] = Labels(codes.astype(np.int64), known)
        else:
            columns[name] = np.repeat(np.asarray(values, dtype=float), lengths)
    return columns


def _drive(part: Part, site: Site) -> dict[str, Array]:
    """Motion of one part: trapezoidal speeds between rest, the speeds in turn, and rest."""
    count = max(4, round(part.seconds / STEP_S))
    target: Array = np.zeros(count)
    if part.speeds_m_s:
        legs = np.array_split(np.arange(count), max(len(part.speeds_m_s), 1))
        for wanted, rows in zip(part.speeds_m_s, legs, strict=True):
            target[rows] = wanted
        target[-2:] = 0.0
        for rest in np.array_split(np.arange(count), part.stops + 1)[:-1] if part.stops else ():
            target[rest[-6:]] = 0.0
    speed = approach(target, STEP_S, site.acceleration_m_s2)
    yaw: Array = np.zeros(count)
    if part.yaw_rates_rad_s:
        for rate, rows in zip(
            part.yaw_rates_rad_s, np.array_split(np.arange(count), len(part.yaw_rates_rad_s)), strict=True
        ):
            yaw[rows] = rate
    slope: Array = np.zeros(count)
    if part.slope_rad is not None:
        # up and down in turn, 15 s each
        slope = np.where((np.arange(count) * STEP_S // 15.0) % 2 == 0, part.slope_rad, -part.slope_rad)
    accel = np.gradient(speed, STEP_S)
    return {"speed_m_s": speed, "accel_m_s2": accel, "yaw_rate_rad_s": yaw, "slope_rad": slope}


def shortened(manoeuvre: Manoeuvre, factor: float) -> Manoeuvre:
    """The same manoeuvre with every part `factor` times as long."""
    return replace(manoeuvre, parts=tuple(replace(part, seconds=part.seconds * factor) for part in manoeuvre.parts))

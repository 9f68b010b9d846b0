"""Open-RMF fleet configs: a robot file of one, and measured numbers back into it.

Format: the fleet adapter's ``config.yaml``. The power it plans with is that of rmf_battery (SimpleMotionPowerSink,
SimpleDevicePowerSink): friction · m · g · v + m · |a| · v + ambient (+ tool while a tool works), with g = 9.81 m/s².
The rotational energy, moment of inertia · yaw acceleration · yaw rate, comes back in full when a turn ends.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.effects.covariates import acceleration
from missionsim.errors import InputError
from missionsim.exchange.site import Remark, clean, flow
from missionsim.exchange.source import Faults, Value, read_document, read_text, rewritten
from missionsim.inputs.loading import robot_from_text
from missionsim.inputs.robot import RobotSpec
from missionsim.logs import read_logs

FORMULA = "friction*m*9.81*abs(v) + m*abs(a)*abs(v)"
GUESS_SD = "30 %"
"""Spread of a config's friction and watts: guesses of whoever wrote it."""
_TAKEN = {"name", "limits", "reversible", "battery_system", "mechanical_system", "ambient_system", "tool_system"}
_TAKEN |= {"recharge_threshold"}


@dataclass(frozen=True)
class Number:
    """A number of the config: its keys below ``rmf_fleet``, limits, and whether it may be left out."""

    path: tuple[str, ...]
    low: float
    high: float
    default: float | None = None


NUMBERS = {
    "voltage": Number(("battery_system", "voltage"), 1e-3, 2000.0),
    "capacity": Number(("battery_system", "capacity"), 1e-6, 1e6),
    "charging_current": Number(("battery_system", "charging_current"), 1e-6, 1e5),
    "mass": Number(("mechanical_system", "mass"), 1e-3, 1e6),
    "inertia": Number(("mechanical_system", "moment_of_inertia"), 0.0, 1e6, 0.0),
    "friction": Number(("mechanical_system", "friction_coefficient"), 0.0, 100.0),
    "ambient": Number(("ambient_system", "power"), 0.0, 1e6, 0.0),
    "tool": Number(("tool_system", "power"), 0.0, 1e6, 0.0),
    "threshold": Number(("recharge_threshold",), 0.0, 1.0, 0.0),
}


@dataclass
class Fleet:
    """A fleet config."""

    file: str
    name: str
    numbers: dict[str, float]
    """By the names of `NUMBERS`; what the file leaves out has its default."""
    limits: dict[str, float]
    """``max_speed``, ``max_acceleration``, ``max_yaw_rate``, ``max_yaw_acceleration``, SI."""
    robots: tuple[str, ...]
    remarks: dict[str, Remark] = field(default_factory=dict)

    def robot_text(self, battery: str = "robot") -> str:
        """The robot file; its battery gets that name."""
        n = self.numbers
        body = {"drive": "differential", "mass": f"{n['mass']:g} kg"}
        units = {"max_speed": "m/s", "max_acceleration": "m/s^2", "max_yaw_rate": "rad/s"}
        body |= {key: f"{value:g} {units.get(key, 'rad/s^2')}" for key, value in self.limits.items()}
        store = {"capacity": f"{n['capacity']:g} Ah", "nominal_voltage": f"{n['voltage']:g} V"}
        store |= {
            "reserve": f"{100 * n['threshold']:g} %",
            "max_charge_power": f"{n['charging_current'] * n['voltage']:g} W",
        }
        friction = {"value": n["friction"], "unit": "1", "sd": GUESS_SD, "status": "assumed"}
        components: dict[str, Any] = {"ambient": {"always_on": True, "loads": [_load(battery, n["ambient"])]}}
        components["tool"] = {"loads": [_load(battery, n["tool"])]}
        word = re.sub(r"[^a-z0-9]+", "_", re.sub(r"(?<=[a-z])(?=[A-Z])", "_", self.name).lower()).strip("_")[:50]
        identifier = word if word[:1].isalpha() else f"robot_{word}".rstrip("_")
        lines = [f"# from {Path(self.file).name} (Open-RMF fleet) by missionsim import-robot"]
        lines += ["kind: robot", f"name: {identifier}", f"title: {flow(self.name)}"]
        lines.append(
            'notes: "power as rmf_battery plans it: friction, acceleration, ambient, tool; the numbers of the config"'
        )
        lines += [f"body: {flow(body)}", "batteries:", f"  {battery}: {flow(store)}"]
        lines += ["motion:", f"  battery: {battery}", "  model: expression", f'  power: "{FORMULA}"', '  standing: "0"']
        lines += ["  parameters:", f"    friction: {flow(friction)}", "components:"]
        lines += [f"  {name}: {flow(component)}" for name, component in components.items()]
        return "\n".join(lines) + "\n"


def _load(battery: str, watts: float) -> dict[str, Any]:
    spread = {"sd": GUESS_SD} if watts > 0 else {}
    return {"battery": battery, "power": {"value": f"{watts:g} W", **spread, "status": "assumed"}}


def read_fleet(path: str | Path) -> Fleet:
    """Read a fleet config. Raises InputError: all its faults, with lines."""
    document = read_document(path, read_text(path))
    faults = Faults(str(path))
    root = Value(document, faults, document.root)
    fleet = root.need("rmf_fleet")
    faults.stop()
    if fleet is None or not isinstance(fleet.data, dict):
        root.fault("no fleet config of Open-RMF", "rmf_fleet: {name: …, battery_system: …}")
        faults.stop()
        raise AssertionError
    result = Fleet(str(path), clean(fleet.word("name")) or Path(path).stem, {}, {}, ())
    for name, wanted in NUMBERS.items():
        found: Value | None = fleet
        for key in wanted.path:
            above, found = found, found and found.get(key)
            if found is None and above is not None and wanted.default is None:
                above.fault(f"'{key}' is missing", f"{'.'.join(wanted.path)}: a number")
        number = found and found.number(wanted.low, wanted.high)
        result.numbers[name] = number or wanted.default or 0.0
    limits = fleet.get("limits")
    for key, names in (
        ("linear", ("max_speed", "max_acceleration")),
        ("angular", ("max_yaw_rate", "max_yaw_acceleration")),
    ):
        for name, entry in zip(names, limits.entries(key) if limits else [], strict=False):
            number = entry.number(1e-6, 60.0 if name == "max_speed" else 1000.0)
            if number is not None:
                result.limits[name] = number
    if "max_speed" not in result.limits and not faults.found:
        (limits or fleet).fault("the top speed is missing", "limits: {linear: [0.5, 0.75]}")
    faults.stop()
    result.robots = tuple(name for part in (fleet, root) for name, _ in part.items("robots"))
    for key, value in [*fleet.items(), *((key, value) for key, value in root.items() if key != "rmf_fleet")]:
        if key not in _TAKEN:
            result.remarks[key] = Remark(f"left out: {clean(key)[:60]}", value.line)
    result.remarks["drive"] = Remark("drive: differential is assumed", 0)
    result.remarks["slope"] = Remark("rmf_battery's formula knows no slope; the effect grade adds it", 0)
    if result.numbers["inertia"]:
        remark = "moment_of_inertia: what a turn takes comes back when it ends, in rmf_battery's formula; left out"
        result.remarks["inertia"] = Remark(remark, 0)
    robot_from_text(result.robot_text(), str(path))
    return result


@dataclass(frozen=True)
class FleetExport:
    """A config with measured numbers, and how far its formula follows."""

    raw: bytes
    """The new config; all but the numbers is as it was, byte for byte."""
    changed: dict[str, tuple[float, float]]
    """Name → (before, after)."""
    errors: list[dict[str, Any]]
    """On the logs: ``formula``, ``energy_error_pct``, ``power_rmse_w`` of our model, of theirs as it is, and of theirs
    with the new numbers."""
    remarks: tuple[str, ...]


def export_fleet(path: str | Path, robot: RobotSpec, logs: Sequence[Path] = (), battery: str = "") -> FleetExport:
    """Put what was measured of a robot into a fleet config.

    Friction and ambient power are those that let rmf_battery's formula follow the logs best (least squares of power);
    without logs, those that follow our model at steady speeds up to the top speed. `path`: fleet config. `battery`: the
    robot's; that of its motion by default.
    """
    fleet = read_fleet(path)
    battery = battery or (robot.motion.battery if robot.motion else next(iter(robot.batteries)))
    if battery not in robot.batteries:
        raise InputError.unknown(f"the robot has no battery '{battery}'", battery, robot.batteries)
    remarks: list[str] = []
    new = dict(fleet.numbers)
    store = robot.batteries[battery]
    if store.nominal_voltage is not None:
        new["voltage"] = store.nominal_voltage.value
    new["capacity"] = store.capacity_j / 3600.0 / new["voltage"]
    if robot.body.mass is not None:
        new["mass"] = robot.body.mass.value
    tool = robot.components.get("tool")
    if tool is not None and tool.loads and tool.loads[0].power is not None:
        new["tool"] = tool.loads[0].power.value
    if others := [name for name in robot.batteries if name != battery]:
        remarks.append(f"a fleet config knows one battery: {battery}; left out: {', '.join(others)}")
    after = replace(fleet, numbers=new)
    errors: list[dict[str, Any]] = []
    if logs:
        _fit_to_logs(after, logs, battery, remarks)
        from missionsim.compare import compare_files

        models = {
            "our model": robot,
            "rmf_battery, config as it was": robot_from_text(fleet.robot_text(battery)),
            "rmf_battery, measured numbers": robot_from_text(after.robot_text(battery)),
        }
        for name, model in models.items():
            said = compare_files(model, list(logs)).batteries[battery]
            error = {"energy_error_pct": said.energy_error_pct, "power_rmse_w": said.power_rmse_w}
            errors.append({"formula": name, **error})
    else:
        from missionsim.exchange.nav2 import steady_power

        speeds = np.linspace(0.1, 1.0, 10) * robot.body.max_speed.value
        watts = steady_power(robot, [(0.0, speed) for speed in speeds])[battery]
        slope, level = np.polyfit(speeds, watts, 1)
        new |= {"friction": max(0.0, float(slope) / (new["mass"] * 9.81)), "ambient": max(0.0, float(level))}
        miss = np.abs(watts - slope * speeds - level).max()
        remarks.append(
            f"no logs: a straight line through our model's power at steady {speeds[0]:g} to {speeds[-1]:g} m/s; "
            f"it misses by up to {miss:.3g} W"
        )
    changed = {
        key: (fleet.numbers[key], value) for key, value in new.items() if f"{fleet.numbers[key]:.6g}" != f"{value:.6g}"
    }
    raw = _edited(path, changed, remarks)
    return FleetExport(raw, changed, errors, tuple(remarks))


def _fit_to_logs(fleet: Fleet, logs: Sequence[Path], battery: str, remarks: list[str]) -> None:
    """Least squares of power over all rows, none below zero; the tool's watts only where logs say when it was on."""
    from scipy.optimize import nnls

    blocks, targets = [], []
    tables = read_logs(list(logs))
    for log in tables:
        if battery not in log.power_w or "speed_m_s" not in log.columns:
            told = f"the log has no speed, or no power of battery '{battery}'"
            raise InputError.single(told, file=log.source, got=", ".join(log.columns))
        speed = np.abs(log.number("speed_m_s"))
        rate = log.number("accel_m_s2") if "accel_m_s2" in log.columns else acceleration(speed, log.time_s)
        mass = fleet.numbers["mass"] + (log.number("payload_kg") if "payload_kg" in log.columns else 0.0)
        tool = log.number("on_tool") if "on_tool" in log.columns else np.zeros(len(speed))
        weight = np.sqrt(log.dt_s)
        blocks.append(np.stack([mass * 9.81 * speed, np.ones(len(speed)), tool], axis=1) * weight[:, None])
        targets.append((log.power_w[battery] - mass * np.abs(rate) * speed) * weight)
    matrix, target = np.concatenate(blocks), np.concatenate(targets)
    seen = np.any(matrix != 0.0, axis=0)
    best, _ = nnls(matrix[:, seen], target)
    for name, value in zip(np.array(["friction", "ambient", "tool"])[seen], best, strict=True):
        fleet.numbers[str(name)] = float(value)
    remarks.append(f"friction and watts: least squares of the power over {len(tables)} runs, {len(target)} rows")


def _edited(path: str | Path, changed: dict[str, tuple[float, float]], remarks: list[str]) -> bytes:
    """The config with other numbers in place of the old ones, and nothing else changed."""
    text = read_text(path)
    body = text.removeprefix("\ufeff")
    document = read_document(path, text)
    edits = []
    for name, (_, value) in changed.items():
        keys = ("rmf_fleet", *NUMBERS[name].path)
        node = document.node(keys)
        if document.node(keys[:-1]) is node or not node.text or body[node.start : node.end] != node.text:
            told = f"{'.'.join(keys[1:])} does not stand in the file as a plain number: {value:.6g} is not written"
            remarks.append(told)
        else:
            edits.append((node.start, node.end, repr(float(f"{value:.6g}"))))
    return rewritten(path, text, edits)

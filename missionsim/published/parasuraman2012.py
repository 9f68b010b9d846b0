"""Parasuraman et al. 2012, Khepera III: every figure from the robot file and the shipped missions."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from missionsim.inputs.power import build_power_model
from missionsim.physics import Array, f64
from missionsim.published.figures import Figure, Ours, Overrides, load_figures, mission, run, shipped_robot

PAPER = "parasuraman2012"
TASK_A = {"wifi": "khepera3/task_a_wifi", "bluetooth": "khepera3/task_a_bluetooth"}
CROSSING = "khepera3/crossing"
IDENTIFY = "khepera3/identify_components"
SENSING = "korebot: 1, infrared: 11, ultrasonic: 5"


def ours() -> dict[str, Ours]:
    """What we compute for each figure, by key."""
    figures, robot = load_figures(PAPER), shipped_robot("khepera3")
    f = {name: figure.value for name, figure in figures.items()}
    found: dict[str, Ours] = {}
    found["capacity"] = Ours((robot.batteries["robot"].capacity_c or 0.0) / 3.6, "charge of the robot file")
    note = "found by the sequence of operations on the simulated robot"
    found["comp"] = Ours(identified_components()["korebot"], note)
    found["sampling.rate"] = Ours(f["sampling.rate"], "rate of the simulated records")
    found["sampling.step"] = Ours(1000.0 / f["sampling.rate"])
    laps: Any = mission("khepera3/task_b").segments
    slowest, top = min(1000.0 * float(lap.speed) for lap in laps), float(robot.body.max_speed)
    for suffix in ("", ".va"):
        found[f"speed.max{suffix}"] = Ours(1000.0 * top)
        found[f"speed.min{suffix}"] = Ours(slowest, "slowest lap of task B")
    named, wifi_w = f["table1.khepera.power"], static_power("wifi")
    found["table1.khepera.power"] = Ours(motion_power(top))
    found["table1.khepera.share"] = Ours(100.0 * named / (named + wifi_w), f"static power with WiFi {wifi_w:.3f} W")

    task, speed = run(TASK_A["wifi"]), float(mission(TASK_A["wifi"]).defaults.speed or 0.0)
    found["taskA.tn"] = Ours(task.duration_s)
    found["taskA.tp"] = Ours(task.distance_m / speed)
    found["taskA.speed"] = Ours(1000.0 * speed)

    slow, fast = f["speed.min"] / 1000.0, f["speed.max"] / 1000.0
    slow_wh = crossing_energy(slow, "wifi")
    found["saving.speed"] = Ours(saving(slow_wh, crossing_energy(fast, "wifi")))
    wifi, bluetooth = (run(TASK_A[name]).batteries["robot"].energy_wh for name in ("wifi", "bluetooth"))
    note = f"task A simulated: {3600 * wifi:.1f} J against {3600 * bluetooth:.1f} J"
    found["saving.bluetooth"] = Ours(saving(wifi, bluetooth), note)
    found["saving.no_radio"] = Ours(saving(slow_wh, crossing_energy(fast, None)))
    static = named * (100.0 / f["table1.khepera.share"] - 1.0)

    def moving_only(speed: float, static_w: float) -> float:
        return energy_needed(1.0, speed, static_w=static_w, motion_w=motion_power(speed))

    slow_j = moving_only(slow, static)
    note = f"static power {static:.3f} W, no standing time"
    found["saving.speed.table1"] = Ours(saving(slow_j, moving_only(fast, static)), note)
    # the 33 % give the difference of the radios; Bluetooth's own power is at least nought
    total_j = static * task.duration_s + motion_power(f["taskA.speed"] / 1000.0) * f["taskA.tp"]
    difference = f["saving.bluetooth"] / 100.0 * total_j / task.duration_s
    without = moving_only(fast, static - difference)
    note = f"least saving, with Bluetooth at 0 W and WiFi at {difference:.3f} W"
    found["saving.no_radio.from33"] = Ours(saving(slow_j, without), note)

    worst = max(abs(f["error.min"]), abs(f["error.max"]))
    found["margin.prediction"] = Ours(float(np.ceil(worst)))
    parts = [f[f"margin.{name}"] for name in ("prediction", "transducer", "std")]
    note = f"root of the squares' sum {float(np.sqrt(np.sum(np.square(parts)))):.1f} %"
    found["margin.total"] = Ours(sum(parts), note)
    found["accuracy"] = Ours(100.0 - worst)
    return found


def energy_needed(
    distance_m: float, speed_m_s: float, *, static_w: float, motion_w: float, standing_s: float = 0.0
) -> float:
    """Energy of a drive, J (Eq. 12: P_static t_n + P_motion t_p, t_p = d / v, t_n = t_p + standing time)."""
    moving_s = distance_m / speed_m_s
    return static_w * (moving_s + standing_s) + motion_w * moving_s


def saving(before: float, after: float) -> float:
    """Share of energy saved, %: 100 (before − after) / before."""
    return 100.0 * (before - after) / before


def component_powers(power_w: ArrayLike, switched_on: ArrayLike) -> Array:
    """Power of each component from a switching sequence (section III.B, Fig. 2), by least squares over all samples.

    Components are switched on one after the other; each one's power is the step. Least squares over the whole record
    does the same subtraction, also where components go off again, and with every sample counted. `power_w` (shape
    (samples,)): measured [W]; `switched_on` (shape (samples, components)): units on. Gives W per unit, shape
    (components,). Raises ValueError: two components are never switched apart, so the record cannot tell their powers.
    """
    design = f64(switched_on)
    values, _, rank, _ = np.linalg.lstsq(design, f64(power_w), rcond=None)
    if rank < design.shape[1]:
        raise ValueError("some components are always on or off together: switch them one by one")
    return f64(values)


def motion_power(speed_m_s: float, payload_kg: float = 0.0) -> float:
    """Motion power (W) of the robot at a steady speed."""
    robot = shipped_robot("khepera3")
    powers = build_power_model(robot).evaluate({"speed_m_s": speed_m_s, "payload_kg": payload_kg}, battery="robot")
    return float(sum(watts for key, watts in powers["robot"].items() if key.component == "motors"))


def static_power(radio: str | None) -> float:
    """Static power (W) of the robot with all sensors on, with a radio or without."""
    robot = shipped_robot("khepera3")
    on = {
        "on_korebot": 1.0,
        "on_infrared": float(robot.components["infrared"].units),
        "on_ultrasonic": float(robot.components["ultrasonic"].units),
    }
    if radio:
        on[f"on_{radio}"] = 1.0
    return float(build_power_model(robot).total({"speed_m_s": 0.0, **on}, "robot"))


def crossing_energy(speed_m_s: float, radio: str | None) -> float:
    """Energy (Wh) of the crossing from A to B, simulated at a speed and with a radio."""
    sensors = "{" + SENSING + (f", {radio}: 1" if radio else "") + "}"
    overrides: Overrides = (
        ("defaults.speed", f"{speed_m_s} m/s"),
        ("defaults.sensors", sensors),
        ("segments.1.wait.sensors", sensors),
    )
    return run(CROSSING, overrides).batteries["robot"].energy_wh


def identified_components(noise_w: float = 0.0, seed: int = 0) -> dict[str, float]:
    """Component powers (W per unit) found by the sequence of operations from a record of the simulated robot. The
    record has the paper's 20 Hz; with `noise_w` it is measured with white noise of that standard deviation."""
    result = run(IDENTIFY)
    robot = shipped_robot("khepera3")
    rate = load_figures(PAPER)["sampling.rate"].value
    line = result.timeline
    time = np.arange(0.5 / rate, line.edges_s[-1], 1.0 / rate)
    index = np.clip(np.searchsorted(line.edges_s, time, side="right") - 1, 0, len(line) - 1)
    still = np.asarray(line.columns["speed_m_s"])[index] == 0.0
    power = result.power_w("robot")[index] + np.random.default_rng(seed).normal(0.0, noise_w, len(time))
    names = [name for name, spec in robot.components.items() if not spec.always_on]
    always = next(name for name, spec in robot.components.items() if spec.always_on)
    on = np.column_stack([np.asarray(line.columns[f"on_{name}"])[index] for name in names] + [np.ones(len(time))])
    found = component_powers(power[still], on[still])
    return dict(zip([*names, always], (float(v) for v in found), strict=True))


class StaticPowers(NamedTuple):
    """Khepera III: powers that the paper shows only in figures, and the standing time that its savings need."""

    without_radio_w: float
    bluetooth_w: float
    wifi_w: float
    standing_s_m: float


def static_powers(figures: Mapping[str, Figure]) -> StaticPowers:
    """The one solution of four unknowns in four printed figures (savings of 73, 33, 83 % and the share of 28 %).

    Unknown are the static power without radio, Bluetooth, WiFi, and the standing time per metre of the crossing.
    Eqs. 12 and 15 link them; task A's times are printed.
    """
    from scipy.optimize import fsolve

    f = {name: figure.value for name, figure in figures.items()}
    slow, fast, task = f["speed.min"] / 1e3, f["speed.max"] / 1e3, f["taskA.speed"] / 1e3
    motion = {speed: motion_power(speed) for speed in (slow, fast, task)}

    def crossing(speed: float, static: float, standing: float) -> float:
        return energy_needed(1.0, speed, static_w=static, motion_w=motion[speed], standing_s=standing)

    def residuals(x: Array) -> list[float]:
        plain, bluetooth, wifi, standing = (float(v) for v in x)
        moving = motion[task] * f["taskA.tp"]
        with_wifi, with_bluetooth = ((plain + radio) * f["taskA.tn"] + moving for radio in (wifi, bluetooth))
        slow_j = crossing(slow, plain + wifi, standing)
        greatest = f["table1.khepera.power"]
        return [
            saving(slow_j, crossing(fast, plain + wifi, standing)) - f["saving.speed"],
            saving(with_wifi, with_bluetooth) - f["saving.bluetooth"],
            saving(slow_j, crossing(fast, plain, standing)) - f["saving.no_radio"],
            100.0 * greatest / (greatest + plain + wifi) - f["table1.khepera.share"],
        ]

    x, _, ok, message = fsolve(residuals, [1.0, 0.1, 1.0, 2.0], full_output=True)
    if ok != 1:
        raise RuntimeError(f"the four figures have no solution: {message}")
    return StaticPowers(*(float(v) for v in x))

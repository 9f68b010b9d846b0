"""The rover with a Jetson TX2: Table 1, optima of speed and clock, quality of service, two readings of its speeds."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from missionsim.control import PowerPredictor
from missionsim.physics import Array, motion
from missionsim.published.figures import Figure, Ours, load_figures, mission

PAPER = "rover2025"
SPEED_STEP_M_S = 0.25
KMH = 1.0 / 3.6
COMPLEXITIES = ("field", "orchard", "slalom")
"""Tracks of low, moderate and high complexity in the shipped environment."""


def ours() -> dict[str, Ours]:
    """What we compute for each figure, by key."""
    figures, robot, tracks = load_figures(PAPER), predictor(), complexity_of_tracks()
    top, clocks = float(robot.spec.body.max_speed), robot.clocks()
    found: dict[str, Ours] = {}
    cpu = robot._cpu()
    found["batches"] = Ours(cpu["batch_rate"])
    found["freq.max"] = Ours(cpu["high_freq"] / 1e9)
    nearest = int(np.argmin(np.abs(clocks / 1e9 - figures["freq.min"].value)))
    found["freq.min"] = Ours(float(clocks[nearest] / 1e9))
    found["environments"] = Ours(float(len(tracks)))
    found["fig6.speed.min"] = Ours(figures["fig6.speed.min"].value)
    grid = speeds(2.0 * top)
    best = robot.best(grid, clocks, tracks["slalom"])
    printed = figures["joint.speed"].value
    needed = drive_constant(printed)
    note = f"optimum {best.energy_j_m:.2f} J/m; the printed speed would need {needed:.1f} W of constant power"
    found["joint.speed"] = Ours(best.speed_m_s, note)
    found["joint.freq"] = Ours(best.freq_hz / 1e9, note)
    kmh = predictor(kmh_values(figures)).best(speeds(16.0) * KMH, clocks, tracks["slalom"])
    note = (
        f"{kmh.energy_j_m:.2f} J/m; drive constant {drive_constant(figures['mech.speed'].value * KMH):.2f} W; "
        "a hypothesis that the text does not support"
    )
    found["joint.speed.kmh"] = Ours(kmh.speed_m_s / KMH, note)
    found["joint.freq.kmh"] = Ours(kmh.freq_hz / 1e9, note)
    found["qos.speed"] = Ours(service_limit(robot, float(clocks[-1]), tracks["slalom"], 2.0 * top))
    found["saturation"] = Ours(float(robot.throughput(printed, clocks[-1], tracks["slalom"])))
    low = robot.best(grid, clocks, tracks["field"])
    found["qos.low"] = Ours(float(robot.throughput(2.0 * low.speed_m_s, clocks[-1], tracks["field"])))
    fine = speeds(top, 0.01)
    found["mech.speed"] = Ours(motion.speed_of_least_energy(0.0, fine, mechanical_power(fine)))
    alone = motion.speed_of_least_energy(0.0, fine, mechanical_power(fine, with_constant=False))
    found["mech.alone"] = Ours(alone, "the lowest speed of the grid: no optimum")
    part = float(mechanical_power(np.array([printed]))[0])
    whole = float(robot.power(printed, clocks[-1], tracks["slalom"]))
    found["comp_share"] = Ours(part / whole, f"{part:.1f} W of {whole:.1f} W")
    return found


def predictor(values: Mapping[str, float] | None = None) -> PowerPredictor:
    """The shipped rover with camera and computer on."""
    return PowerPredictor("rover_tx2", values=values or {})


def complexity_of_tracks() -> dict[str, float]:
    """Complexity of each track of the shipped environment."""
    spec = mission("rover_tx2/high_complexity").environment
    assert spec is not None
    return {str(edge.name): float(edge.conditions["complexity"]) for edge in spec.edges if edge.name in COMPLEXITIES}


def speeds(top_m_s: float, step_m_s: float = SPEED_STEP_M_S) -> Array:
    """Grid of speeds from one step to the top."""
    return np.arange(1.0, round(top_m_s / step_m_s) + 1.0) * step_m_s


def mechanical_power(speed_m_s: Array, *, with_constant: bool = True) -> Array:
    """Power of driving alone (W): the robot file's, or from Table 1 alone without the drive's constant power."""
    robot = PowerPredictor("rover_tx2", on={})
    watts = robot.power(speed_m_s)
    return watts if with_constant else watts - float(robot.model.parameters["robot/drive_constant"].value)


def drive_constant(speed_m_s: float) -> float:
    """Constant power (W) with which Table 1 has its least energy per metre at a speed: v² dF/dv."""
    around = speed_m_s * np.array([1.0 + 1e-4, 1.0 - 1e-4])
    force = mechanical_power(around, with_constant=False) / around
    return float(speed_m_s**2 * (force[0] - force[1]) / (around[0] - around[1]))


def processing_work(
    figures: Mapping[str, Figure], *, fixed_s: float, share_at_rest: float, reading: float = 1.0
) -> tuple[float, float]:
    """Cycles per batch at rest, and more per m/s, with which the quality of service just holds at the printed limit.

    `fixed_s`, `share_at_rest`: time that no clock shortens, and share of the work that no speed adds (assumed; not
    printed). `reading`: 1 for m/s, `KMH` for km/h.
    """
    period_s = 1.0 / figures["batches"].value
    work = (period_s - fixed_s) * figures["freq.max"].value * 1e9
    limit = figures["qos.speed"].value * reading
    return share_at_rest * work, (1.0 - share_at_rest) * work / limit


def kmh_values(figures: Mapping[str, Figure]) -> dict[str, float]:
    """Parameters of the robot under the reading that the printed speeds are km/h."""
    cpu = predictor()._cpu()
    share = cpu["cycles"] / (cpu["cycles"] + cpu["cycles_per_speed"] * figures["qos.speed"].value)
    rest, more = processing_work(figures, fixed_s=cpu["fixed_time"], share_at_rest=share, reading=KMH)
    return {
        "robot/drive_constant": drive_constant(figures["mech.speed"].value * KMH),
        "robot/cpu.cycles": rest,
        "robot/cpu.cycles_per_speed": more,
    }


def service_limit(robot: PowerPredictor, freq_hz: float, complexity: float, top_m_s: float) -> float:
    """Greatest speed (m/s, in steps of a hundredth) at which every batch is processed in time."""
    grid = speeds(top_m_s, 0.01)
    good = grid[robot.meets_service(grid, freq_hz, complexity)]
    return float(good[-1]) if len(good) else 0.0


def optima() -> list[dict[str, object]]:
    """Joint optimum for each complexity under both readings."""
    figures = load_figures(PAPER)
    rows = []
    for reading, scale, unit in (("SI", 1.0, "m/s"), ("km/h", KMH, "km/h")):
        robot = predictor() if scale == 1.0 else predictor(kmh_values(figures))
        clocks = robot.clocks()
        grid = speeds(16.0) * scale
        for name, complexity in complexity_of_tracks().items():
            best = robot.best(grid, clocks, complexity)
            limit = service_limit(robot, float(clocks[-1]), complexity, 16.0 * scale) / scale
            row = {"reading": reading, "track": name, "complexity": complexity, "speed": best.speed_m_s / scale}
            row |= {"unit": unit, "clock_ghz": best.freq_hz / 1e9, "energy_j_m": best.energy_j_m}
            rows.append({**row, "service_limit": limit})
    return rows

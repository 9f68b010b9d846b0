"""The valve patrol of Jaiem et al. 2021, section 3.4.2: the plan against the robot as it drove."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from missionsim.physics import Array, f64, motion
from missionsim.published.figures import Ours, load_figures, mission, run

PLAN, DRIVEN = "pioneer3dx/valve_patrol", "pioneer3dx/valve_patrol_as_driven"
SAMPLE_S = 1.0


@dataclass(frozen=True)
class ErrorCurve:
    """Error of the planned energy over the mission as driven, at equal progress."""

    time_s: Array
    """Time of the run as driven, one sample a second. Shape (n,)."""
    predicted_wh: Array
    measured_wh: Array
    """Both: cumulative energy of the plan at the same place, and of the run as driven. Shape (n,)."""

    def percent(self, relative_to: str = "predicted") -> Array:
        """Error in %, of the ``predicted`` or the ``measured`` energy."""
        base = self.predicted_wh if relative_to == "predicted" else self.measured_wh
        return 100.0 * (self.measured_wh - self.predicted_wh) / base

    def statistics(self, relative_to: str = "predicted") -> dict[str, float]:
        """Peak, final value, mean and standard deviation over the samples, %."""
        error = self.percent(relative_to)
        return {
            "peak": float(np.max(error)),
            "final": float(error[-1]),
            "mean": float(np.mean(error)),
            "std": float(np.std(error)),
        }


def error_curve(battery: str) -> ErrorCurve:
    """The curve of one battery from two simulations. Both runs have the same segments and hold their speed within one,
    so equal progress is an equal share of a segment."""
    return curve(_durations(DRIVEN), *(run(name).by_segment_wh(battery) for name in (PLAN, DRIVEN)))


def curve(driven_s: Array, plan_wh: Array, driven_wh: Array) -> ErrorCurve:
    """Error curve from durations as driven and energies of each segment, planned and as driven."""
    ends = np.concatenate([[0.0], np.cumsum(driven_s)])
    time = np.append(np.arange(SAMPLE_S, ends[-1], SAMPLE_S), ends[-1])
    predicted, measured = (
        np.interp(time, ends, np.concatenate([[0.0], np.cumsum(energy)])) for energy in (plan_wh, driven_wh)
    )
    return ErrorCurve(time, predicted, measured)


def _durations(name: str) -> Array:
    result = run(name)
    ends = np.array([result.segment_end_s[index] for index in range(len(result.segments))])
    return np.diff(ends, prepend=0.0)


def _ways_m(name: str) -> Array:
    """Way of each segment by its speed at the beginning of intervals."""
    line = run(name).timeline
    way = np.asarray(line.columns["speed_m_s"]) * line.duration_s
    return f64(np.bincount(line.segment, way, len(run(name).segments)))


def velocity_gaps() -> dict[str, float]:
    """Velocity gap of each segment that moves, %: 1 − mean speed as driven / planned, from the simulated runs."""
    planned, driven = (_ways_m(name) / _durations(name) for name in (PLAN, DRIVEN))
    return {
        segment.name: float(100.0 * (1.0 - driven[index] / planned[index]))
        for index, segment in enumerate(run(PLAN).segments)
        if planned[index] > 0.0
    }


def figures() -> Iterator[tuple[str, Ours]]:
    """Our values for the figures of section 3.4.2."""
    plan, driven = run(PLAN), run(DRIVEN)
    yield "sec24.length", Ours(plan.distance_m)
    yield "sec342.length", Ours(plan.distance_m, f"as driven {driven.distance_m:.1f} m")
    note = f"as driven; the plan takes {plan.duration_s / 60.0:.2f} min"
    yield "sec342.duration", Ours(driven.duration_s / 60.0, note)
    stops = [segment for segment in plan.segments if segment.kind == "inspect"]
    yield "valves", Ours(float(len(stops)))
    segments: Any = mission(PLAN).segments
    speeds = {float(s.speed) for s in segments if s.speed is not None}
    for speed in sorted(speeds):
        yield f"sec342.speed{speed:g}", Ours(speed)
    gaps = velocity_gaps()
    yield "sec342.gap.v1", Ours(gaps["V1_area"])
    yield "sec342.gap.turns", Ours(gaps["V2_area"])
    yield "sec342.gap.h2", Ours(gaps["H2_out"])
    for battery in ("robot", "laptop"):
        found = error_curve(battery)
        for suffix, relative in (("", "predicted"), (".measured", "measured")):
            for name, value in found.statistics(relative).items():
                yield f"sec342.{battery}.{name}{suffix}", Ours(value)


# what makes a robot's path longer and slower than planned, each with its spread (assumed)
DRIFT, DRIFT_SD = 0.15, 0.03
"""Sideways, per metre."""
SETTLE_M, SETTLE_SD_M = 1.0, 0.2
"""Length on which an offset or a heading settles."""
AMPLITUDE_M, AMPLITUDE_SD_M, WAVELENGTH_M = 0.12, 0.04, 3.0
"""Irregular walls that centring follows."""
HEADING_ERROR_RAD = 0.5
"""After a turn."""
TURNS = {"ER_out": 4, "V1_area": 5, "V2_area": 2, "ER_in": 4}
"""By segment of the patrol."""
GAP_SD = 0.02
"""Spread of the speed reached over the speed asked."""


def behaviour_draws(draws: int, rng: np.random.Generator) -> tuple[Array, Array]:
    """Path stretch and speed ratio of each segment of the patrol, drawn from their causes. Gives an array of shape
    (draws, segments): stretch (≥ 1) and speed over speed asked; 1 in the stops."""
    spec, names = mission(DRIVEN), [segment.name for segment in run(DRIVEN).segments]
    stretch = np.ones((draws, len(spec.segments)))
    ratio = np.ones_like(stretch)
    drift = np.abs(rng.normal(DRIFT, DRIFT_SD, draws))
    settle = np.clip(rng.normal(SETTLE_M, SETTLE_SD_M, draws), 0.2, None)
    amplitude = np.abs(rng.normal(AMPLITUDE_M, AMPLITUDE_SD_M, draws))
    lengths = _ways_m(PLAN)
    printed = load_figures("jaiem2021")
    spacing = printed["sec341.d2"].value / printed["sec341.qr_markers2"].value
    for index, segment in enumerate(spec.segments):
        if segment.kind != "drive":
            continue
        if spec.navigation_of(segment) == "qr_code":
            stretch[:, index] *= motion.relocalisation_stretch(spacing, drift=drift, settle_m=settle)
        if spec.scheme_of(segment) == "centring_motion":
            stretch[:, index] *= motion.centring_stretch(amplitude, WAVELENGTH_M)
        if turns := TURNS.get(names[index]):
            stretch[:, index] *= motion.settling_stretch(
                turns, lengths[index], heading_error_rad=HEADING_ERROR_RAD, settle_m=settle
            )
        asked = float((segment.behaviour and segment.behaviour.speed_tracking) or 1.0)
        ratio[:, index] = np.clip(rng.normal(asked, GAP_SD, draws), 0.3, 1.0)
    return stretch, ratio


def uncertain_statistics(draws: int, seed: int) -> dict[str, dict[str, Array]]:
    """The four error statistics of each battery for drawn behaviours, shape (draws,) each. Every draw is the patrol of
    the plan with other stretches and speeds; powers come from the robot's power model."""
    from missionsim.inputs.power import build_power_model

    stretch, ratio = behaviour_draws(draws, np.random.default_rng(seed))
    plan = run(PLAN)
    model = build_power_model(mission(PLAN).robot)
    first = np.array([int(np.flatnonzero(plan.timeline.segment == i)[0]) for i in range(len(plan.segments))])
    cov = {name: column[first] for name, column in plan.timeline.columns.items()} | dict(plan.timeline.constants)
    driven = {**cov, "speed_m_s": np.asarray(cov["speed_m_s"]) * ratio}
    driven_s = _durations(PLAN) * stretch / ratio
    result: dict[str, dict[str, Array]] = {}
    for battery in plan.batteries:
        power = np.broadcast_to(np.asarray(model.total(driven, battery)), driven_s.shape)
        energy = power * driven_s / 3600.0
        rows = [curve(driven_s[i], plan.by_segment_wh(battery), energy[i]).statistics() for i in range(draws)]
        result[battery] = {name: np.array([row[name] for row in rows]) for name in rows[0]}
    return result

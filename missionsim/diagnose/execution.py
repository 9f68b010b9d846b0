"""Execution effects: how the robot drove otherwise than its mission plans (longer, slower, waiting), per scheme.

Per run and control scheme the log's way, speed and standing time are held against the plan's. Over the runs these
numbers scatter; a Student interval over runs says which differ from the plan (ratios on a log scale).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.diagnose.findings import Judged
from missionsim.effects.timeline import Timeline
from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S
from missionsim.labels import Labels

ODOMETRY_SCALE = 0.01
"""Ratios closer to 1 than this may be the odometry's scale, and are not called an effect (assumed)."""
SHORTEST_DWELL_S = 2.0
FEWEST_RUNS = 2
WORTH_SAYING = 0.01
"""Part of the energy from which a difference in a single run is told."""
TOLD = {
    "path_stretch": "times the planned way",
    "speed_tracking": "times the planned speed",
    "dwell": "s at rest a run that nothing plans",
}


@dataclass(frozen=True)
class Motion:
    """Way and times of one scheme in one run (or in the plan)."""

    distance_m: float
    driving_s: float
    standing_s: float
    driving_w: float = 0.0
    standing_w: float = 0.0
    speed_m_s: float = float("nan")
    """Mean over the way, not over time, so that ramps from and to rest hardly count; NaN where nothing was driven."""


@dataclass(frozen=True)
class ExecutionEffect:
    """One execution effect on one scheme.

    Attributes
    ----------
    effect : str
        ``path_stretch``, ``speed_tracking`` or ``dwell``.
    scheme : str
        Empty where the logs or the plan have no schemes.
    value, low, high : float
        Ratio to the plan, or seconds a run for ``dwell``; 95 % interval over runs, NaN with one run.
    p_value : float
        Of "as planned"; NaN with one run.
    unit : str
    energy_share : float
        Part of the measured energy that the difference takes (negative where it saves energy).
    found : bool
        Whether it differs from the plan beyond chance and beyond what an odometer's scale could do.
    reason : str
    """

    effect: str
    scheme: str
    value: float
    low: float
    high: float
    p_value: float
    unit: str
    energy_share: float
    found: bool
    reason: str


def execution_effects(
    timeline: Timeline, logs: Sequence[Any], battery: str, alpha: float = 0.01, segments: Sequence[str] = ()
) -> list[ExecutionEffect]:
    """Path stretch, speed tracking and dwell of every scheme, from the plan's intervals and the motion in the logs.

    Parameters
    ----------
    timeline : Timeline
        The simulated mission; each log is one drive of it.
    logs : sequence of LogTable
        With ``speed_m_s``; with ``scheme`` where the mission has more than one.
    battery : str
    alpha : float
        Family-wise rate of false alarms over all effects and schemes.
    segments : sequence of str
        Names of the mission's segments by their number; where the logs name them too, speeds are compared segment by
        segment.
    """
    planned = _planned(timeline, True)
    still = _thresholds(timeline)
    known = {name for name, motion in planned.items() if motion.distance_m > 0.0}
    logged = [set(log.columns["scheme"].texts().tolist()) if "scheme" in log.columns else set() for log in logs]
    # schemes are compared one by one only where the logs name every scheme that the plan drives
    if len(known) < 2 or not all(known <= own for own in logged):
        planned = _planned(timeline, False)
        schemes = False
    else:
        schemes = True
    driven = [_driven(log, battery, schemes, still) for log in logs]
    cruises = _cruises(timeline, segments)
    ratios = [_tracking(log, cruises, still[0]) for log in logs]
    whole = [_driven(log, battery, False, still)[""] for log in logs]
    measured_j = sum(float(np.nansum(log.power_w[battery] * log.dt_s)) for log in logs)
    names = [name for name, motion in planned.items() if motion.distance_m > 0.0]
    count = max(1, 3 * len(names))
    found: list[ExecutionEffect] = []
    for name in names:
        plan = planned[name]
        runs = [run[name] for run in driven if name in run and run[name].distance_m > 0.0]
        if runs:
            by_segment = [r for r in ratios if r is not None] if not schemes else []
            found += _of_scheme(name, plan, runs, measured_j, alpha / count, by_segment)
    # a log says its scheme while it waits, a plan need not: standing still is compared over the whole mission
    found.append(_dwell(_planned(timeline, False)[""], whole, measured_j, alpha / count))
    return found


def told_of(effects: Sequence[ExecutionEffect]) -> list[Judged]:
    """The execution effects as candidates that were looked at, all schemes of one together."""
    return [
        Judged(
            name,
            any(one.found for one in own),
            "; ".join(f"{one.scheme}: {one.reason}" if one.scheme else one.reason for one in own),
            None,
        )
        for name, own in by_effect(effects).items()
    ]


def seen_once(effects: Sequence[ExecutionEffect]) -> list[str]:
    """In words, how the only run differs from the plan, where it takes energy worth saying."""
    told = []
    for one in effects:
        away = abs(one.value) > SHORTEST_DWELL_S if one.unit == "s" else abs(one.value - 1.0) > ODOMETRY_SCALE
        if np.isfinite(one.p_value) or not away or abs(one.energy_share) < WORTH_SAYING:
            continue
        scheme = f" in {one.scheme}" if one.scheme else ""
        told.append(
            f"{one.effect}{scheme}: {one.value:.3g} {TOLD[one.effect]} ({100 * one.energy_share:+.1f} % of the energy)"
        )
    if not told:
        return []
    return [f"driven otherwise than planned in this run: {'; '.join(told)}; one run cannot show whether it repeats"]


def _of_scheme(
    name: str, plan: Motion, runs: Sequence[Motion], measured_j: float, level: float, by_segment: Sequence[float]
) -> list[ExecutionEffect]:
    power = float(np.mean([run.driving_w for run in runs]))
    stretch = np.array([run.distance_m / plan.distance_m for run in runs])
    tracking = np.array([run.speed_m_s / plan.speed_m_s for run in runs])
    if len(by_segment) == len(runs):
        tracking = np.asarray(by_segment)
    extra_m = float(np.sum(stretch - 1.0)) * plan.distance_m
    way_j = power * extra_m / plan.speed_m_s
    # the slower way takes longer at the power that was drawn while driving
    longer_s = sum(run.driving_s * (1.0 - float(r)) for run, r in zip(runs, tracking, strict=True))
    return [
        _ratio("path_stretch", name, stretch, way_j / measured_j, level),
        _ratio("speed_tracking", name, tracking, power * longer_s / measured_j, level),
    ]


def _dwell(plan: Motion, runs: Sequence[Motion], measured_j: float, level: float) -> ExecutionEffect:
    seconds = np.array([run.standing_s - plan.standing_s for run in runs])
    drawn = [run.standing_w for run in runs if run.standing_s > 0.0]
    still_w = float(np.mean(drawn)) if drawn else 0.5 * float(np.mean([run.driving_w for run in runs]))
    return _seconds("", seconds, still_w * float(seconds.sum()) / measured_j, level)


def _ratio(effect: str, scheme: str, ratios: NDArray[np.float64], share: float, level: float) -> ExecutionEffect:
    logs_of = np.log(ratios)
    middle, low, high, p = _student(logs_of)
    value = float(np.exp(middle))
    away = abs(value - 1.0) > ODOMETRY_SCALE
    found = bool(p < level and away)
    reason = _reason(found, p, level, len(ratios), "closer to the plan than an odometer's scale" if not away else "")
    return ExecutionEffect(effect, scheme, value, float(np.exp(low)), float(np.exp(high)), p, "1", share, found, reason)


def _seconds(scheme: str, seconds: NDArray[np.float64], share: float, level: float) -> ExecutionEffect:
    middle, low, high, p = _student(seconds)
    away = abs(middle) > SHORTEST_DWELL_S
    found = bool(p < level and away and middle > 0.0)
    why = "" if away else f"less than {SHORTEST_DWELL_S:g} s a run"
    if middle < -SHORTEST_DWELL_S:
        why = "stood still for less time than planned"
    return ExecutionEffect(
        "dwell", scheme, middle, low, high, p, "s", share, found, _reason(found, p, level, len(seconds), why)
    )


def _reason(found: bool, p: float, level: float, runs: int, why: str) -> str:
    if found:
        return f"differs from the plan in {runs} runs, p = {p:.1g}"
    if runs < FEWEST_RUNS:
        return "one run cannot show how it scatters"
    return why or f"as planned within its scatter over {runs} runs (p = {p:.2g}, needed {level:.1g})"


def _student(values: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Mean, 95 % interval and two-sided p-value of mean nought."""
    from scipy.stats import t

    count = len(values)
    middle = float(np.mean(values))
    if count < FEWEST_RUNS:
        return middle, float("nan"), float("nan"), float("nan")
    # runs that agree to the last digit (a simulated log) still have an odometer
    error = max(float(np.std(values, ddof=1)) / np.sqrt(count), 1e-4 * max(abs(middle), 1e-3))
    reach = float(t.ppf(0.975, count - 1)) * error
    return middle, middle - reach, middle + reach, float(2.0 * t.sf(abs(middle) / error, count - 1))


def _planned(timeline: Timeline, by_scheme: bool) -> dict[str, Motion]:
    length = np.asarray(timeline.duration_s, dtype=float)
    speed = np.abs(_mean_of(timeline, "speed_m_s"))
    if "lateral_speed_m_s" in timeline.columns:
        speed = np.hypot(speed, _mean_of(timeline, "lateral_speed_m_s"))
    turning = np.abs(_mean_of(timeline, "yaw_rate_rad_s")) > 0.0
    driving = speed > 0.0
    standing = ~driving & ~turning
    names = _names(timeline.columns.get("scheme"), len(length)) if by_scheme else np.full(len(length), "", dtype=object)
    return {
        str(name): Motion(
            float(np.sum((speed * length)[names == name])),
            float(np.sum(length[driving & (names == name)])),
            float(np.sum(length[standing & (names == name)])),
            speed_m_s=_over_way(speed[names == name], length[names == name]),
        )
        for name in dict.fromkeys(names.tolist())
    }


def _over_way(speed: NDArray[np.float64], seconds: NDArray[np.float64]) -> float:
    way = float(np.sum(speed * seconds))
    return float(np.sum(speed**2 * seconds)) / way if way > 0.0 else float("nan")


def _cruises(timeline: Timeline, segments: Sequence[str]) -> dict[str, float]:
    """Highest planned speed of each named segment that drives; names that come twice are left out."""
    top = np.abs(_mean_of(timeline, "speed_m_s"))
    steady = np.abs(np.asarray(timeline.rates.get("speed_m_s", np.zeros_like(top)))) == 0.0
    found: dict[str, float] = {}
    for number, name in enumerate(segments):
        own = (np.asarray(timeline.segment) == number) & steady
        if name and list(segments).count(name) == 1 and own.any() and top[own].max() > 0.0:
            found[name] = float(top[own].max())
    return found


def _tracking(log: Any, cruises: Mapping[str, float], still_m_s: float) -> float | None:
    """Speed reached over speed planned, mean over the way of the segments that log and plan both name."""
    segment = log.columns.get("segment")
    if not isinstance(segment, Labels) or not cruises:
        return None
    speed = np.abs(np.asarray(log.columns["speed_m_s"], dtype=float))
    weights, ratios = [], []
    for name, planned in cruises.items():
        rows = segment.equals(name) & (speed > max(still_m_s, 0.3 * planned))
        if int(rows.sum()) >= 5:
            weights.append(float(np.sum(speed[rows] * log.dt_s[rows])))
            ratios.append(float(np.median(speed[rows])) / planned)
    return float(np.average(ratios, weights=weights)) if ratios else None


def _mean_of(timeline: Timeline, name: str) -> NDArray[np.float64]:
    """Mean of a covariate over each interval; linear in time inside it."""
    length = np.asarray(timeline.duration_s, dtype=float)
    if name not in timeline.columns:
        return np.zeros_like(length)
    start = np.asarray(timeline.columns[name], dtype=float)
    return np.asarray(start + 0.5 * np.asarray(timeline.rates.get(name, 0.0)) * length)


def _thresholds(timeline: Timeline) -> tuple[float, float]:
    """Speed and yaw rate below which a noisy log counts as standing: a tenth of the slowest that the plan drives."""
    slowest = []
    for name, floor in (("speed_m_s", STILL_SPEED_M_S), ("yaw_rate_rad_s", STILL_YAW_RATE_RAD_S)):
        level = np.abs(_mean_of(timeline, name))
        steady = level[(level > 0.0) & (np.abs(np.asarray(timeline.rates.get(name, np.zeros_like(level)))) == 0.0)]
        slowest.append(max(floor, 0.1 * float(steady.min())) if len(steady) else floor)
    return slowest[0], slowest[1]


def _driven(log: Any, battery: str, by_scheme: bool, still: tuple[float, float]) -> dict[str, Motion]:
    seconds = np.asarray(log.dt_s, dtype=float)
    speed = np.abs(np.asarray(log.columns["speed_m_s"], dtype=float))
    if "lateral_speed_m_s" in log.columns:
        speed = np.hypot(speed, log.columns["lateral_speed_m_s"])
    power = np.asarray(log.power_w[battery], dtype=float)
    turn = np.abs(np.asarray(log.columns["yaw_rate_rad_s"], dtype=float)) if "yaw_rate_rad_s" in log.columns else 0.0
    driving = speed >= still[0]
    standing = ~driving & (turn < still[1])
    names = _names(log.columns["scheme"], len(seconds)) if by_scheme else np.full(len(seconds), "", dtype=object)
    found = {}
    for name in dict.fromkeys(names.tolist()):
        own = names == name
        found[str(name)] = Motion(
            float(np.sum((speed * seconds)[own & driving])),
            float(np.sum(seconds[own & driving])),
            float(np.sum(seconds[own & standing])),
            _mean(power, seconds, own & driving),
            _mean(power, seconds, own & standing),
            _over_way(speed[own & driving], seconds[own & driving]),
        )
    return found


def _mean(power: NDArray[np.float64], seconds: NDArray[np.float64], rows: NDArray[np.bool_]) -> float:
    total = float(np.sum(seconds[rows]))
    return float(np.nansum(power[rows] * seconds[rows]) / total) if total > 0.0 else 0.0


def _names(value: Any, count: int) -> NDArray[np.object_]:
    if value is None:
        return np.full(count, "", dtype=object)
    if isinstance(value, Labels):
        return np.asarray(value.texts(), dtype=object)
    return np.asarray(value, dtype=object)


def by_effect(effects: Sequence[ExecutionEffect]) -> Mapping[str, list[ExecutionEffect]]:
    """The execution effects grouped by their id, those found first."""
    grouped: dict[str, list[ExecutionEffect]] = {}
    for one in sorted(effects, key=lambda e: (not e.found, -abs(e.energy_share))):
        grouped.setdefault(one.effect, []).append(one)
    return grouped

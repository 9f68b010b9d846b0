"""Execution effects: how the robot drove otherwise than its mission plans (longer, slower, waiting), per scheme.

Per run and control scheme the log's way, speed and standing time are held against the plan's. Over the runs these
numbers scatter; a Student interval over runs says which differ from the plan (ratios on a log scale).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass

import numpy as np

from missionsim.effects.timeline import Timeline
from missionsim.identify.findings import Estimate, Finding, Judged
from missionsim.physics import Array
from missionsim.runs.motion import Motion, Still, motions, planned, speed_of, still_of, stretch, told_apart, tracking
from missionsim.runs.run import Run

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
class ExecutionEffect:
    """One execution effect on one scheme."""

    effect: str
    """``path_stretch``, ``speed_tracking`` or ``dwell``."""
    scheme: str
    """Empty where the logs or the plan have no schemes."""
    value: float
    low: float
    high: float
    """All three: ratio to the plan, or seconds a run for ``dwell``; 95 % interval over runs, NaN with one run."""
    p_value: float
    """Of "as planned"; NaN with one run."""
    unit: str
    energy_share: float
    """Part of the measured energy that the difference takes (negative where it saves energy)."""
    _: KW_ONLY
    found: bool
    """Whether it differs from the plan beyond chance and beyond what an odometer's scale could do."""
    reason: str


def execution_effects(
    timeline: Timeline, logs: Sequence[Run], battery: str, alpha: float = 0.01
) -> list[ExecutionEffect]:
    """Path stretch, speed tracking and dwell of every scheme, from the plan's intervals and the motion in the logs.

    `timeline`: the simulated mission; each log is one drive of it. `logs`: with ``speed_m_s``; with ``scheme`` where
    the mission has more than one. `alpha`: family-wise rate of false alarms over all effects and schemes.
    """
    still = still_of(timeline)
    plan = planned(timeline)
    driven = [_motions(log, battery, still, by_scheme=True) for log in logs]
    whole = [_motions(log, battery, still, by_scheme=False)[""] for log in logs]
    if not told_apart(plan, driven):
        plan, driven = planned(timeline, by_scheme=False), [{"": run} for run in whole]
    measured_j = sum(run.energy_j["all"] for run in whole)
    names = [name for name, motion in plan.items() if motion.distance_m > 0.0]
    level = alpha / max(1, 3 * len(names))
    found: list[ExecutionEffect] = []
    for name in names:
        runs = [run[name] for run in driven if name in run and run[name].distance_m > 0.0]
        if runs:
            found += _of_scheme(name, plan[name], runs, measured_j, level)
    # a log says its scheme while it waits, a plan need not: standing still is compared over the whole mission
    found.append(_dwell(planned(timeline, by_scheme=False)[""], whole, measured_j, level))
    return found


def _motions(log: Run, battery: str, still: Still, *, by_scheme: bool) -> dict[str, Motion]:
    """Sums of one run, with the measured energy of all rows, of those driven and of those at rest."""
    power = np.nan_to_num(log.power_w[battery])
    speed = speed_of(log.columns)
    driving = speed >= still[0]
    turn = np.abs(log.number("yaw_rate_rad_s")) if "yaw_rate_rad_s" in log.columns else np.zeros(log.rows)
    turning = turn >= still[1]
    parts = {
        "all": power,
        "driving": np.where(driving, power, 0.0),
        "standing": np.where(driving | turning, 0.0, power),
    }
    return motions(log.columns, log.dt_s, parts, still, by_scheme=by_scheme)


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
    name: str, plan: Motion, runs: Sequence[Motion], measured_j: float, level: float
) -> list[ExecutionEffect]:
    power = float(np.mean([run.energy_j["driving"] / run.driving_s for run in runs]))
    ways, speeds = stretch(plan, runs), tracking(plan, runs)
    way_j = power * float(np.sum(ways - 1.0)) * plan.distance_m / plan.speed_m_s
    # the slower way takes longer at the power that was drawn while driving
    longer_s = sum(run.driving_s * (1.0 - float(r)) for run, r in zip(runs, speeds, strict=True))
    return [
        _ratio("path_stretch", name, ways, way_j / measured_j, level),
        _ratio("speed_tracking", name, speeds, power * longer_s / measured_j, level),
    ]


def _dwell(plan: Motion, runs: Sequence[Motion], measured_j: float, level: float) -> ExecutionEffect:
    seconds = np.array([run.standing_s - plan.standing_s for run in runs])
    drawn = [run.energy_j["standing"] / run.standing_s for run in runs if run.standing_s > 0.0]
    driving = [run.energy_j["driving"] / run.driving_s for run in runs if run.driving_s > 0.0]
    still_w = float(np.mean(drawn)) if drawn else 0.5 * float(np.mean(driving or [0.0]))
    return _seconds("", seconds, still_w * float(seconds.sum()) / measured_j, level)


def _ratio(effect: str, scheme: str, ratios: Array, share: float, level: float) -> ExecutionEffect:
    logs_of = np.log(ratios)
    middle, low, high, p = _student(logs_of)
    value = float(np.exp(middle))
    away = abs(value - 1.0) > ODOMETRY_SCALE
    found = bool(p < level and away)
    reason = _reason(found, p, level, len(ratios), "closer to the plan than an odometer's scale" if not away else "")
    return ExecutionEffect(
        effect, scheme, value, float(np.exp(low)), float(np.exp(high)), p, "1", share, found=found, reason=reason
    )


def _seconds(scheme: str, seconds: Array, share: float, level: float) -> ExecutionEffect:
    middle, low, high, p = _student(seconds)
    away = abs(middle) > SHORTEST_DWELL_S
    found = bool(p < level and away and middle > 0.0)
    why = "" if away else f"less than {SHORTEST_DWELL_S:g} s a run"
    if middle < -SHORTEST_DWELL_S:
        why = "stood still for less time than planned"
    return ExecutionEffect(
        "dwell",
        scheme,
        middle,
        low,
        high,
        p,
        "s",
        share,
        found=found,
        reason=_reason(found, p, level, len(seconds), why),
    )


def _reason(found: bool, p: float, level: float, runs: int, why: str) -> str:
    if found:
        return f"differs from the plan in {runs} runs, p = {p:.1g}"
    if runs < FEWEST_RUNS:
        return "one run cannot show how it scatters"
    return why or f"as planned within its scatter over {runs} runs (p = {p:.2g}, needed {level:.1g})"


def _student(values: Array) -> tuple[float, float, float, float]:
    """Mean, 95 % interval and two-sided p-value of mean nought."""
    from scipy.special import stdtr, stdtrit

    count = len(values)
    middle = float(np.mean(values))
    if count < FEWEST_RUNS:
        return middle, float("nan"), float("nan"), float("nan")
    # runs that agree to the last digit (a simulated log) still have an odometer
    error = max(float(np.std(values, ddof=1)) / np.sqrt(count), 1e-4 * max(abs(middle), 1e-3))
    reach = float(stdtrit(count - 1, 0.975)) * error
    return middle, middle - reach, middle + reach, float(2.0 * stdtr(count - 1, -abs(middle) / error))


def by_effect(effects: Sequence[ExecutionEffect]) -> Mapping[str, list[ExecutionEffect]]:
    """The execution effects grouped by their id, those found first."""
    grouped: dict[str, list[ExecutionEffect]] = {}
    for one in sorted(effects, key=lambda e: (not e.found, -abs(e.energy_share))):
        grouped.setdefault(one.effect, []).append(one)
    return grouped


def as_finding(one: ExecutionEffect) -> Finding:
    """An execution effect among the findings."""
    return Finding(
        effect=one.effect,
        parameters={"k": Estimate(one.value, one.low, one.high, one.unit)},
        energy_share=one.energy_share,
        p_value=one.p_value,
        scheme=one.scheme,
        level="identified",
        remark=one.reason,
    )

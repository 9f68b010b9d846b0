"""Execution effects: how the robot drove otherwise than its mission plans (longer, slower, waiting), per scheme.

Per run and control scheme the log's way, speed and standing time are held against the plan's. Over the runs these
numbers scatter; a Student interval over runs says which differ from the plan (ratios on a log scale).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from missionsim.effects.timeline import Timeline
from missionsim.identify.findings import Estimate, Finding, Judged
from missionsim.numerals import p_told
from missionsim.physics import Array
from missionsim.runs.motion import Motion, motions, planned, speed_of, still_of, stretch, told_apart, tracking
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


def execution_effects(timeline: Timeline, logs: Sequence[Run], battery: str, alpha: float = 0.01) -> list[Finding]:
    """Path stretch, speed tracking and dwell of every scheme, from the plan's intervals and the motion in the logs.

    ``k`` of each is its ratio to the plan, or seconds a run for ``dwell``; its interval over runs and p-value are NaN
    with one run. Its level is empty where it differs from the plan by no more than chance or an odometer's scale, and
    its remark says why. `timeline`: the simulated mission; each log is one drive of it. `logs`: with ``speed_m_s``;
    with ``scheme`` where the mission has more than one. `alpha`: family-wise rate of false alarms over all effects and
    schemes.
    """
    still = still_of(timeline)
    plan, whole_plan = planned(timeline), planned(timeline, by_scheme=False)[""]
    driven: list[dict[str, Motion]] = []
    whole: list[Motion] = []
    for log in logs:
        power = np.nan_to_num(log.power_w[battery])
        driving = speed_of(log.columns) >= still[0]
        turn = np.abs(log.number("yaw_rate_rad_s")) if "yaw_rate_rad_s" in log.columns else np.zeros(log.rows)
        standing_w = np.where(driving | (turn >= still[1]), 0.0, power)
        parts = {"all": power, "driving": np.where(driving, power, 0.0), "standing": standing_w}
        driven.append(motions(log.columns, log.dt_s, parts, still))
        whole.append(motions(log.columns, log.dt_s, parts, still, by_scheme=False)[""])
    if not told_apart(plan, driven):
        plan, driven = {"": whole_plan}, [{"": run} for run in whole]
    measured_j = sum(run.energy_j["all"] for run in whole)
    names = [name for name, motion in plan.items() if motion.distance_m > 0.0]
    level = alpha / max(1, 3 * len(names))
    found: list[Finding] = []
    for name in names:
        runs = [run[name] for run in driven if name in run and run[name].distance_m > 0.0]
        if not runs:
            continue
        power_w = float(np.mean([run.energy_j["driving"] / run.driving_s for run in runs]))
        ways, speeds = stretch(plan[name], runs), tracking(plan[name], runs)
        way_j = power_w * float(np.sum(ways - 1.0)) * plan[name].distance_m / plan[name].speed_m_s
        # the slower way takes longer at the power that was drawn while driving
        longer_s = sum(run.driving_s * (1.0 - float(r)) for run, r in zip(runs, speeds, strict=True))
        found.append(_judged("path_stretch", name, ways, way_j / measured_j, level))
        found.append(_judged("speed_tracking", name, speeds, power_w * longer_s / measured_j, level))
    # a log says its scheme while it waits, a plan need not: standing still is compared over the whole mission
    seconds = np.array([run.standing_s - whole_plan.standing_s for run in whole])
    drawn = [run.energy_j["standing"] / run.standing_s for run in whole if run.standing_s > 0.0]
    moving = [run.energy_j["driving"] / run.driving_s for run in whole if run.driving_s > 0.0]
    still_w = float(np.mean(drawn)) if drawn else 0.5 * float(np.mean(moving or [0.0]))
    found.append(_judged("dwell", "", seconds, still_w * float(seconds.sum()) / measured_j, level))
    return found


def _judged(effect: str, scheme: str, values: Array, share: float, level: float) -> Finding:
    """An effect from its ratio to the plan (seconds for ``dwell``) in each run, with a Student interval over runs."""
    from scipy.special import stdtr, stdtrit

    ratios, count = effect != "dwell", len(values)
    scale = np.log(values) if ratios else values
    value, low, high, p = float(np.mean(scale)), float("nan"), float("nan"), float("nan")
    if count >= FEWEST_RUNS:
        # runs that agree to the last digit (a simulated log) still have an odometer
        error = max(float(np.std(scale, ddof=1)) / np.sqrt(count), 1e-4 * max(abs(value), 1e-3))
        reach = float(stdtrit(count - 1, 0.975)) * error
        low, high, p = value - reach, value + reach, float(2.0 * stdtr(count - 1, -abs(value) / error))
    if ratios:
        value, low, high = (float(np.exp(one)) for one in (value, low, high))
        away = abs(value - 1.0) > ODOMETRY_SCALE
        why = "" if away else "closer to the plan than an odometer's scale"
    else:
        away = value > SHORTEST_DWELL_S
        why = "stood still for less time than planned" if value < -SHORTEST_DWELL_S else ""
        why = why or ("" if away else f"less than {SHORTEST_DWELL_S:g} s a run")
    found = bool(p < level and away)
    if found:
        reason = f"differs from the plan in {count} runs, {p_told(p)}"
    elif count < FEWEST_RUNS:
        reason = "one run cannot show how it scatters"
    else:
        reason = why or f"as planned within its scatter over {count} runs ({p_told(p, 2)}, needed {level:.1g})"
    return Finding(
        effect=effect,
        parameters={"k": Estimate(value, low, high, "1" if ratios else "s")},
        energy_share=share,
        p_value=p,
        scheme=scheme,
        level="identified" if found else "",
        remark=reason,
    )


def told_of(effects: Sequence[Finding]) -> list[Judged]:
    """The execution effects as candidates that were looked at, all schemes of one together, those found first."""
    order = sorted(effects, key=lambda one: (not one.level, -abs(one.energy_share)))
    told = []
    for name in dict.fromkeys(one.effect for one in order):
        own = [one for one in order if one.effect == name]
        why = "; ".join(f"{one.scheme}: {one.remark}" if one.scheme else one.remark for one in own)
        told.append(Judged(name, any(one.level for one in own), why, None))
    return told


def seen_once(effects: Sequence[Finding]) -> list[str]:
    """In words, how the only run differs from the plan, where it takes energy worth saying."""
    told = []
    for one in effects:
        k = one.parameters["k"]
        away = abs(k.value) > SHORTEST_DWELL_S if k.unit == "s" else abs(k.value - 1.0) > ODOMETRY_SCALE
        if np.isfinite(one.p_value) or not away or abs(one.energy_share) < WORTH_SAYING:
            continue
        scheme = f" in {one.scheme}" if one.scheme else ""
        told.append(
            f"{one.effect}{scheme}: {k.value:.3g} {TOLD[one.effect]} ({100 * one.energy_share:+.1f} % of the energy)"
        )
    if not told:
        return []
    return [f"driven otherwise than planned in this run: {'; '.join(told)}; one run cannot show whether it repeats"]

"""What the motion of the runs tells: how the robot drove otherwise than its mission plans (longer, slower, waiting),
and a systematic error in one kind of motion, which tests of curves away from ramps and averages over runs pass over;
and watts that are logged beside, of which the fitted runs hold too little.

Per run and control scheme the log's way, speed and standing time are held against the plan's. Over the runs these
numbers scatter; a Student interval over runs says which differ from the plan (ratios on a log scale).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Covariates
from missionsim.effects.model import PowerModel
from missionsim.effects.timeline import Timeline
from missionsim.identify.findings import BatteryDiagnosis, Estimate, Finding, Judged, Structure
from missionsim.identify.identification import Identification
from missionsim.identify.model import prediction
from missionsim.identify.settings import CLEAR_OF_NOISE, CLEAR_T, MOST_OF_SQUARE, SEVERAL_RUNS, SMALL_TIME
from missionsim.numerals import rounded, watts
from missionsim.physics import Array
from missionsim.runs.error import errors_of
from missionsim.runs.motion import (
    MOTIONS,
    Motion,
    kinds_of_motion,
    motions,
    planned,
    speed_of,
    still_of,
    stretch,
    told_apart,
    tracking,
)
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
        reason = f"differs from the plan in {count} runs, p = {p:.1g}"
    elif count < FEWEST_RUNS:
        reason = "one run cannot show how it scatters"
    else:
        reason = why or f"as planned within its scatter over {count} runs (p = {p:.2g}, needed {level:.1g})"
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


RAMPS = (MOTIONS.index("speeding up"), MOTIONS.index("slowing down"))
VARIES: Mapping[str, str] = {
    "driving straight": "speed_m_s",
    "turning on the spot": "yaw_rate_rad_s",
    "driving a curve": "yaw_rate_rad_s",
    "speeding up": "accel_m_s2",
    "slowing down": "accel_m_s2",
}


def leftover(found: Identification, covariates: Sequence[Covariates]) -> Structure | None:
    """What recalibration and the effects found leave over in one kind of motion; None where nothing stands out.

    `covariates`: covariates of each fitted run at its raw rate, as in `missionsim.diagnose.features.Features`.
    """
    model = found.choice.model
    source, design = model.source, model.design
    known = [covariates[i] for i in source.kept]
    if not all({"speed_m_s", "accel_m_s2"} <= cov.keys() for cov in known):
        return None
    kinds = []
    for cov, run in zip(known, source.runs, strict=True):
        kind = kinds_of_motion(cov)
        ahead = kinds_of_motion({name: column for name, column in cov.items() if name != "yaw_rate_rad_s"})
        kind = np.where(np.isin(ahead, RAMPS), ahead, kind)  # ramps count as such in curves as well
        if len(kind) != len(run.time_s):
            return None
        kinds.append((kind[None, :] == np.arange(len(MOTIONS))[:, None]).astype(float))
    names = {effect.effect for effect in found.effects}
    chosen = [k for k in model.chosen if found.library[design.layout.columns[k].candidate].effect in names]
    error_w = prediction(model, chosen, design) - design.y
    rows = source.averaged(kinds, model.clock) > 0.5  # rows that lie in this kind of motion for the most part
    run_index, sd_w = design.run_index(), found.noise["sd_w"]
    return standing_out(error_w, design.duration_s, run_index, rows, noise_w=sd_w, mean_power_w=found.mean_power_w)


def standing_out(
    error_w: Array,
    seconds: Array,
    run: NDArray[np.intp],
    rows: NDArray[np.bool_],
    *,
    noise_w: float,
    mean_power_w: float,
) -> Structure | None:
    """The kind of motion with most of the squared error in a small part of the time, if its mean is clear of noise.

    `error_w`, `seconds` (shape (n,)): model minus measured power [W]; time that a row stands for [s]. `run` (shape
    (n,)): number of the run. `rows` (shape (kinds, n)): whether a row lies in each of `MOTIONS`. `noise_w`: standard
    deviation of the noise of a row [W]. The structure depends on what tells this kind of motion from others.
    """
    square = error_w**2 * seconds
    if square.sum() <= 0.0:
        return None
    shares = (rows @ square) / square.sum()
    kind = int(np.argmax(shares))
    here = rows[kind]
    time_share = float(seconds[here].sum() / seconds.sum())
    if shares[kind] < MOST_OF_SQUARE or time_share > SMALL_TIME:
        return None
    each = [here & (run == j) for j in np.unique(run)]
    means = np.array([np.average(error_w[m], weights=seconds[m]) for m in each if m.any()])
    if len(means) < SEVERAL_RUNS or abs(float(np.sum(np.sign(means)))) < len(means):
        return None
    mean = float(means.mean())
    if abs(mean) < CLEAR_OF_NOISE * noise_w or abs(mean) < CLEAR_T * float(means.std(ddof=1)) / math.sqrt(len(means)):
        return None
    bias_w = float(np.average(error_w[here], weights=seconds[here]))
    told = (
        f"a systematic error while {MOTIONS[kind]}, model {watts(abs(bias_w), 2)} too "
        f"{'high' if bias_w > 0.0 else 'low'}: {100 * float(shares[kind]):.0f} % of the squared error in "
        f"{100 * time_share:.0f} % of the time; no effect of the library describes it"
    )
    return Structure(VARIES.get(MOTIONS[kind], ""), 0.0, 0.0, abs(bias_w) * time_share / mean_power_w, told)


MUCH = 0.03
"""Part of the energy from which on watts that may be drawn are worth a sentence (assumed)."""


def fed_note(last: BatteryDiagnosis, battery: str, fitted: Sequence[Run], others: Sequence[Run]) -> str:
    """In words, what is logged in watts beside a battery and would be much of its energy in other runs, where the
    fitted ones hold too little of it to show whether the battery feeds it; else empty."""
    for one in last.candidates:
        kind, _, column = one.effect.partition(":")
        least = one.smallest_detectable_share
        if kind != "logged_power" or one.accepted or least is None:
            continue
        parts = []
        for runs in (fitted, others):
            own = [run for run in runs if column in run.columns]
            fed = sum(float(np.nansum(run.number(column) * run.dt_s)) for run in own)
            fed *= 1e3 if column.endswith("_kw") else 1.0
            parts.append(fed / max(sum(3600.0 * run.energy_wh(battery) for run in own), 1e-9))
        here, there = parts
        if here < least and there > MUCH:
            return (
                f" Whether this battery feeds {column} cannot be seen: it would be {100 * here:.1f} % of the energy of "
                f"the fitted runs, where {100 * least:.1f} % could be seen, and {100 * there:.0f} % in the others. Fit "
                f"runs with more of it; where it is known to be fed, add-effect --effect {one.effect} --force adds it."
            )
    return ""


HARDLY_TURNING = 0.1
"""Turn rates below this part of a fast turn's (the 99th percentile) are what a robot that drives straight shows."""
LOST = 0.05
"""Part of the energy that makes a sentence worth it (assumed)."""


def straight_note(model: PowerModel, runs: Sequence[Run], battery: str) -> str:
    """In words, that a file draws much of its power from turn rates as small as a straight drive's, which are exactly
    nought in a simulated mission; else empty."""
    name = "yaw_rate_rad_s"
    if not all(name in run.columns for run in runs):
        return ""
    least = HARDLY_TURNING * float(np.nanquantile(np.abs(np.concatenate([run.number(name) for run in runs])), 0.99))
    rates = [run.number(name) for run in runs]
    small = [np.where(np.abs(rate) < least, 0.0, rate) for rate in rates]
    straight = [replace(run, columns={**run.columns, name: rate}) for run, rate in zip(runs, small, strict=True)]
    driven, simulated = (errors_of(model, some, battery).total.model_j for some in (runs, straight))
    lost = 1.0 - simulated / driven if driven else 0.0
    if abs(lost) < LOST:
        return ""
    return (
        f" {100 * abs(lost):.0f} % {'less' if lost > 0.0 else 'more'} energy comes out where turn rates below "
        f"{rounded(least, 2)} rad/s are none, as in a simulated mission: what was found reads the noise of straight "
        "drives. Set it to zero in the map, or do not trust `run` on straight ways."
    )

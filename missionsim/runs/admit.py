"""Which runs may be learnt from: none that `validate` refuses, none twice, none that is off by a factor."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from missionsim.effects.covariates import is_moving
from missionsim.effects.model import PowerModel
from missionsim.errors import Fault, InputError
from missionsim.physics import Array, Ints
from missionsim.runs.alike import FEWEST, as_near, beyond, copies
from missionsim.runs.beside import FEWEST_LEVELS, LOADS, Others, Usual, correlation, offsets, runs_beside
from missionsim.runs.covariates import is_switch
from missionsim.runs.drive import Driven, drive
from missionsim.runs.run import SPEEDS, Run, divided, larger

LEVEL = 6.0
"""Measured over modelled energy, against the median of all runs, from which on a run has another unit (assumed)."""
SUSPECT, EXPLAINED = 1.5, 1.25
"""The same from which on another unit of the speed is tried, and within which it explains the difference (assumed)."""
ALIKE, ALONE = 4.0, 12.0
"""Levels of runs differ among themselves, by floors or loads: one is looked at beyond so many times that, and odd
without any known factor beyond so many (assumed)."""
ROWS_TO_TELL, VARIES = 100, 0.15
"""Rows, and variation of the modelled power relative to its mean, from which power is held against the motion."""
NEAR_S, CLEARLY_BETTER, UNRELATED_AT_ALL = 10.0, 0.3, 0.02
"""Delay that a meter may have; rise of the correlation beyond it, and its square in all runs, that no robot shows."""
DOWNWARDS, MOST_RUNS, PART_OF_POWER = -6.0, 0.75, 0.05
"""Robust t below which going up costs less than going down, the part of the runs that must show it by themselves, and
the part of the variance of the power that must go with it (assumed)."""
FALLS, LEAVES, SWITCHED = 0.2, 0.5, 0.05
"""Of what a component draws, within which the power must fall by it where it is on, to call its switch inverted; the
part of the variance that this may leave; the part of the time in which it must be on, and off (assumed)."""
MOTION_COLUMNS = ("speed_m_s", "yaw_rate_rad_s", "slope_rad")
APART_S, UNDER_WAY_M_S = 20.0, 0.05
"""Length of the blocks of time that count as independent; speed that is none of a robot that stands (assumed)."""
STEEP_RAD, STEEPER = 0.3, 12.0
"""Slope that no robot climbs for long, and how many times that of the other runs it must be to be another unit."""


def unfit_runs(runs: Sequence[Run]) -> dict[str, str]:
    """Runs that are not logged as the others, and why, in words; none where most are. No model has a say in it, so that
    any two are compared on the same runs; a slope whose sign is turned is told of any number of runs."""
    found, apart = _units(runs), dict[str, str]()
    for battery in dict.fromkeys(name for run in runs for name in run.power_w):
        own = [run for run in runs if battery in run.power_w and run.run not in found]
        apart |= dict.fromkeys((run.run for run in own), why) if (why := _downwards(own, battery)) else {}
        moved = [run for run in own if "speed_m_s" in run.columns and run.rows]
        if len(moved) >= FEWEST:
            usual = Usual(moved, battery)
            found |= _factors(moved, [usual.ratio(run) for run in moved], usual.ratio, battery)[0]
    return apart | (found if len(found) < 0.5 * len(runs) else {})


def odd_runs(runs: Sequence[Run], model: PowerModel) -> dict[str, str]:
    """Runs that are not as the others against a model, and why, in words; none where most are, for then it is the model
    that is odd. Power that has nothing to do with the motion, or does long after it, is told of any number of runs.
    Raises InputError: a model that gives no number."""
    found, apart = dict[str, str](), dict[str, str]()
    for battery in model.batteries:
        own = [run for run in runs if battery in run.power_w]
        try:
            driven = [drive(model, run, battery) for run in own]
        except InputError:
            continue  # told where the battery is looked at
        for one in driven:
            one.check()
        apart |= _of_another_time(driven, battery) | _inverted(driven, battery)
        if len(own) < FEWEST:
            continue

        def level(run: Run, of: str = battery) -> float:
            return _ratio(drive(model, run, of), of)

        other_units, doubtful = _factors(own, [_ratio(one, battery) for one in driven], level, battery)
        found |= other_units
        if doubtful:  # a straight run is odd only for a model that lacks what turning costs
            draws = Usual.drawn([run for run in own if run.run not in found], doubtful, battery, EXPLAINED)
            doubtful = {name: why for name, why in doubtful.items() if name not in draws}
        left = [one for one in driven if one.run.run not in {*found, *doubtful, *apart}]
        if len(left) >= FEWEST_LEVELS:
            told, beside = _beside(Others(left, battery), model)
            if told or beside:  # what a load costs in other runs excuses a run, and accuses none
                odd = {name for one in _beside(Others(left, battery, carried=True), model) for name in one}
                told, beside = ({n: why for n, why in one.items() if n in odd} for one in (told, beside))
            doubtful |= beside
            found |= told
        usual = [run for run in own if run.run not in {*found, *doubtful}]
        asked = [run for run in own if run.run in doubtful and not beyond(run, usual)]
        apart_by = {one.run.run: np.log(max(_ratio(one, battery), 1e-12)) for one in driven}
        known = [run for run in own if run not in asked and run.run not in found]
        found |= {run.run: doubtful[run.run] for run in asked if not as_near(run, known, apart_by)}
    return apart | (found if len(found) < 0.5 * len(runs) else {})


def _beside(others: Others, model: PowerModel) -> tuple[dict[str, str], dict[str, str]]:
    """Runs that do not follow the others by a fault that explains it; those that lie beside them by an offset."""
    told = runs_beside(others, model)
    return told, {name: why for name, why in offsets(others).items() if name not in told}


def _of_another_time(runs: Sequence[Driven], battery: str) -> dict[str, str]:
    """Runs whose power follows the model only long before or after it; and all of them where none follows it at all."""
    found: dict[str, str] = {}
    follows = []
    for one in runs:
        measured, model = one.measured_w[battery], one.model_w[battery]
        step_s = float(np.median(one.dt_s))
        if len(measured) < ROWS_TO_TELL or np.std(model) < VARIES * abs(float(np.mean(model))) or not np.ptp(measured):
            return {}
        lags, along = correlation(measured, model)
        near = float(np.max(along[np.abs(lags) * step_s <= NEAR_S]))
        best = int(np.argmax(along))
        follows.append(near**2)
        if along[best] > max(0.5, near + CLEARLY_BETTER):
            told = f"power_{battery}_w lies {lags[best] * step_s:+.3g} s beside what the robot does"
            found[one.run.run] = told
    if len(runs) >= FEWEST and max(follows) < UNRELATED_AT_ALL:
        why = "rows in another order, another robot's power?"
        return {one.run.run: f"power_{battery}_w has nothing to do with what the robot does: {why}" for one in runs}
    return found if len(found) > 0.5 * len(runs) else {}


def _inverted(runs: Sequence[Driven], battery: str) -> dict[str, str]:
    """All runs, where in each that switches a component the power falls by about what it draws while it is on."""
    switches = sorted(filter(is_switch, set.intersection(*(set(one.run.columns) for one in runs)))) if runs else []
    for name in (switch[3:] for switch in switches):
        found: list[tuple[float, float, float]] = []  # what it draws by the logs and by the model, variance left
        for one in runs:
            on, run = one.run.number(f"on_{name}"), one.run
            terms = [power for key, power in one.terms[battery].items() if key.component == name]
            own = sum(terms, start=np.zeros_like(on))
            error = run.power_w[battery] - one.row_w(battery)
            v, w, slope = (run.number(column) if column in run.columns else 0.0 * on for column in MOTION_COLUMNS)
            beside = [np.ones_like(on), np.abs(v), v**2, 0.0 * on + is_moving(one.covariates), np.abs(w), v * slope]
            beside += [run.number(switch) for switch in switches if switch != f"on_{name}"]
            rest, both = np.stack(beside, axis=1).astype(float), np.stack([on, error], axis=1)
            if not np.isfinite(both).all() or not np.isfinite(rest).all():
                continue
            alone, left = (both - rest @ np.linalg.lstsq(rest, both, rcond=None)[0]).T
            if min(np.mean(on > 0.0), np.mean(on <= 0.0)) < SWITCHED or np.std(alone) < SWITCHED or not left.any():
                continue
            off, takes = float(alone @ left / (alone @ alone)), float(np.mean(own[on > 0.0] / on[on > 0.0]))
            found.append((off + takes, takes, 1.0 - off * float(alone @ left / (left @ left))))
        logged, draws, part = np.array(found).reshape(-1, 3).T
        if len(found) < FEWEST or not (np.abs(logged + draws) < FALLS * draws).all() or np.median(part) > LEAVES:
            continue
        told = (
            f"on_{name}: the power falls by {-np.median(logged):.3g} W where it is 1, and '{name}' draws "
            f"{np.median(draws):.3g} W: is it inverted? A map turns it (1 - on_{name})"
        )
        return dict.fromkeys((one.run.run for one in runs), told)
    return {}


def _downwards(runs: Sequence[Run], battery: str) -> str:
    """What is wrong with a slope on which going up costs less than going down, in most runs; empty where nothing is."""
    if len(runs) < FEWEST or not all({"slope_rad", "speed_m_s"} <= set(run.columns) for run in runs):
        return ""
    for sign, why in (
        (1.0, "going up costs less than going down: is downhill positive, as in the pitch of ROS? A map turns it"),
        (-1.0, "going up backwards costs less than going down: the pitch of the body? A map takes pitch * sign(speed)"),
    ):
        # of the rows of one direction of travel: speed times slope and power, both without what goes with speed and
        # yaw rate, and the number of the block of time
        parts: list[tuple[Array, Array, Ints]] = []
        for run in runs:
            speed, slope, watts = run.number("speed_m_s"), run.number("slope_rad"), run.power_w[battery]
            yaw = np.abs(run.number("yaw_rate_rad_s")) if "yaw_rate_rad_s" in run.columns else 0.0 * speed
            keep = (sign * speed > UNDER_WAY_M_S) & np.isfinite(slope + watts + yaw)
            if np.count_nonzero(keep) < ROWS_TO_TELL or not np.ptp(slope[keep]):
                continue  # no slope to tell by
            v = np.abs(speed[keep])
            rest = np.stack([np.ones_like(v), v, v**2, yaw[keep]], axis=1)
            both = np.stack([v * slope[keep], watts[keep]], axis=1)
            own_lift, own_power = (both - rest @ np.linalg.lstsq(rest, both, rcond=None)[0]).T
            number = ((run.time_s[keep] - run.time_s[0]) // APART_S).astype(np.intp)
            parts.append((own_lift, own_power, np.unique(number, return_inverse=True)[1]))
        if len(parts) < FEWEST:
            continue
        lift = np.concatenate([lift for lift, _, _ in parts])
        power = np.concatenate([power for _, power, _ in parts])
        size = float(lift @ lift)
        cost = float(lift @ power) / size
        blocks = np.cumsum([0, *(number[-1] + 1 for _, _, number in parts)])
        block = np.concatenate([number + first for (_, _, number), first in zip(parts, blocks[:-1], strict=True)])
        error = float(np.linalg.norm(np.bincount(block, lift * (power - cost * lift)))) / size
        shown = sum(float(one @ watts) < 0.0 for one, watts, _ in parts)
        clear = cost * float(lift @ power) > PART_OF_POWER * float(power @ power)
        if clear and cost < DOWNWARDS * error and shown >= MOST_RUNS * len(parts):
            return f"slope_rad: {why}"
    return ""


def _units(runs: Sequence[Run]) -> dict[str, str]:
    """Runs whose slope, temperature or load is not logged as in the others, whatever the power says."""
    found: dict[str, str] = {}
    for run in runs:
        for name in ("slope_rad", "temp_ambient_c"):
            others = [np.abs(one.number(name)) for one in runs if one is not run and name in one.columns]
            if name not in run.columns or len(others) < FEWEST - 1:
                continue
            usual = float(np.nanmedian([np.nanquantile(one, 0.95) for one in others]))
            high = float(np.nanquantile(np.abs(run.number(name)), 0.95))
            if name == "slope_rad" and high > max(STEEP_RAD, STEEPER * usual):
                found[run.run] = f"slope_rad reaches {high:.3g}, in the other runs {usual:.2g}: degrees or per cent?"
            fahrenheit = usual * 1.8 + 32.0
            if name == "temp_ambient_c" and usual < 45.0 and high > 50.0 and abs(high - fahrenheit) < 20.0:
                found[run.run] = (
                    f"temp_ambient_c reaches {high:.3g}, in the other runs {usual:.3g}: degrees Fahrenheit?"
                )
        for name in LOADS:
            moves = [np.ptp(one.number(name)) > 0.0 for one in runs if one is not run and name in one.columns]
            if name in run.columns and len(moves) >= FEWEST_LEVELS - 1 and all(moves) and not np.ptp(run.number(name)):
                found[run.run] = f"{name} is {run.number(name)[0]:g} in every row, as in no other run: was it logged?"
    return found


def _factors(
    runs: Sequence[Run], levels: Sequence[float], level: Callable[[Run], float], battery: str
) -> tuple[dict[str, str], dict[str, str]]:
    """Runs whose level (measured over expected energy) differs from that of the others by a factor: in another unit;
    and by less. `level`: that of a run whose speed is divided."""
    found: dict[str, str] = {}
    doubtful: dict[str, str] = {}
    ratios = np.array(levels)
    usual = float(np.median(ratios))
    if not usual > 0.0:
        return found, doubtful
    apart = np.abs(np.log(np.maximum(ratios / usual, 1e-12)))
    middle = float(np.nanmedian(apart))
    least = max(np.log(SUSPECT), ALIKE * middle)
    speeds = [np.abs(one.number("speed_m_s")) for one in runs if "speed_m_s" in one.columns]
    usual_m_s = float(np.median([np.quantile(speed, 0.95) for speed in speeds])) if speeds else 0.0
    for run, off, far in zip(runs, ratios / usual, apart, strict=True):
        if not np.isfinite(off) or far < least:
            continue
        told = ""
        if "speed_m_s" in run.columns and larger("speed_m_s", run, [one for one in runs if one is not run]):
            # factors that make its speeds more like those of the others, the likeliest first
            times = float(np.quantile(np.abs(run.number("speed_m_s")), 0.95)) / usual_m_s if usual_m_s > 0.0 else 0.0
            gaps = {factor: abs(np.log(times / factor)) for factor in SPEEDS} if times > 0.0 else {}
            for factor in sorted((f for f, gap in gaps.items() if gap < abs(np.log(times))), key=gaps.__getitem__):
                mended = level(divided(run, "speed_m_s", factor)) / usual
                if np.isfinite(mended) and 1.0 / EXPLAINED < mended < EXPLAINED:
                    told = f"speed_m_s is {factor:.3g} times too large ({SPEEDS[factor]}?)"
                    break
        if told:
            found[run.run] = told
        elif off < 0.0 or far > np.log(LEVEL):
            found[run.run] = f"power_{battery}_w is {off:.3g} times what the other runs draw so: another unit?"
        elif far > ALONE * middle:
            doubtful[run.run] = (
                f"power_{battery}_w is {off:.3g} times the other runs against the model, which agree: "
                "another robot, unit or load?"
            )
    return found, doubtful


def _ratio(driven: Driven, battery: str) -> float:
    model_j = float(driven.model_w[battery] @ driven.dt_s)
    return float(driven.measured_w[battery] @ driven.dt_s) / model_j if model_j else float("nan")


def admit(runs: Sequence[Run], model: PowerModel | None = None) -> tuple[list[Run], list[str]]:
    """Runs to learn from, and what was left out and why, one line a run; without a model runs to compare any with.
    Raises InputError: where no run is left."""
    kept, told = _sound(runs)
    for odd_of in (unfit_runs, *(() if model is None else (partial(odd_runs, model=model),))):
        odd = odd_of(kept)
        told = [*(f"{name}: {why}" for name, why in odd.items()), *told]
        faults = [Fault(run.source, 0, 0, odd[run.run]) for run in kept if run.run in odd]
        kept = [run for run in kept if run.run not in odd]
        if faults and not kept:
            one = len({fault.message for fault in faults}) == 1 < len(faults)
            raise InputError(
                replace(faults[0], message=f"{faults[0].message} (all {len(faults)} runs)") if one else faults
            )
    return kept, told


def _sound(runs: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """Runs that `validate` takes, each once, and what was left out. Raises InputError: with what it tells of all."""
    errors = [[remark for remark in run.remarks if remark.severity == "error"] for run in runs]
    refused = [remark.column for own in errors for remark in own if remark.kind in ("range", "unit")]
    # a unit that is wrong in most runs is wrong in those too whose values happen to be small
    wrong = {name for name in refused if len(runs) > 2 and refused.count(name) >= 0.5 * len(runs)}
    told: list[str] = []
    good: list[Run] = []
    for run, own in zip(runs, errors, strict=True):
        if own:
            told.append(f"{run.run}: {'; '.join(map(str, own))}")
        elif columns := wrong & {*run.columns}:
            told.append(f"{run.run}: {', '.join(sorted(columns))} is in another unit in most of these runs: here too?")
        else:
            good.append(run)
    still = [run for run in good if "speed_m_s" not in run.columns]
    if still and len(still) < 0.5 * len(good):
        why = "it has no speed_m_s, which most runs have: it cannot be driven"
        told = [*(f"{run.run}: {why}" for run in still), *told]
        good = [run for run in good if "speed_m_s" in run.columns]
    twins = copies(good)
    once = "one measurement counts once, and so does a simulation that is run again with nothing changed"
    told += [f"{good[i].run}: a copy of {good[of].run} but for noise; {once}" for i, of in sorted(twins.items())]
    kept = [run for i, run in enumerate(good) if i not in twins]
    if runs and not kept:
        raise InputError([remark.fault(run.source) for run, own in zip(runs, errors, strict=True) for remark in own])
    return kept, told


def admit_to_test(held: Sequence[Run], fitted: Sequence[Run]) -> tuple[list[Run], list[str]]:
    """Held-out runs to test on, and what was left out and why: what `validate` refuses, copies, wrong units.

    One that the model predicts badly stays, since that is what it is there for. Raises InputError: where none is left.
    """
    named, told = _sound([replace(run, run=f"held-out {run.run}") for run in held])
    twins = copies([*fitted, *named])
    wrong = {
        named[i - len(fitted)].run: f"a copy of {fitted[j].run} but for noise, which is fitted: it tests nothing"
        for i, j in twins.items()
        if i >= len(fitted) > j
    }
    size = max(1, len(fitted) - 1)  # fewer than those that they are held against
    for at in range(0, len(named), size):
        wrong = unfit_runs([*fitted, *named[at : at + size]]) | wrong
    odd = [run for run in named if run.run in wrong]
    if odd and len(odd) == len(named):
        raise InputError(Fault(run.source, 0, 0, wrong[run.run]) for run in odd)
    kept = [replace(run, run=run.run.removeprefix("held-out ")) for run in named if run.run not in wrong]
    return kept, [*(f"{run.run}: {wrong[run.run]}" for run in odd), *told]


def unchanging(runs: Sequence[Run]) -> list[str]:
    """Switches and loads that have one value in every row of all runs, which cannot tell then what they draw."""
    names = [name for name in runs[0].columns if is_switch(name) or name == "cpu_load"] if runs else []
    found = {
        name: {value for run in runs for value in (run.number(name).min(), run.number(name).max())}
        for name in names
        if all(name in run.columns and run.rows for run in runs)
    }
    return [
        f"{name} is {next(iter(values)):g} in every row of all runs: what it draws cannot be told by them"
        for name, values in found.items()
        if len(values) == 1 and len(runs) > 1
    ]

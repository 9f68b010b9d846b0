"""Runs that are not as the others: in other units, off by a factor, beside what the others say of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.labels import Labels
from missionsim.runs.beside import FEWEST, FEWEST_LEVELS, LOADS, Others, correlation, offsets, runs_beside
from missionsim.runs.covariates import is_switch, may_be_cause
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
BEYOND = 0.25
"""Distance of a run's usual value from all of the others, in parts of their range, from which they cannot say what is
usual there (assumed)."""
_MOTION = ("speed_m_s", "lateral_speed_m_s", "yaw_rate_rad_s", "accel_m_s2", "slope_rad", "heading_rad", "time_s")
STEEP_RAD, STEEPER = 0.3, 12.0
"""Slope that no robot climbs for long, and how many times that of the other runs it must be to be another unit."""


def odd_runs(runs: Sequence[Run], model: PowerModel) -> dict[str, str]:
    """Runs that are not as the others, and why, in words; none where most are, for then it is the model that is odd.
    Power that has nothing to do with the motion, or does long after it, is told of any number of runs."""
    found, apart = _units(runs), dict[str, str]()
    for battery in model.batteries:
        own = [run for run in runs if battery in run.power_w and run.run not in found]
        try:
            driven = [drive(model, run, battery) for run in own]
        except InputError:
            continue  # told where the battery is looked at
        apart |= _of_another_time(driven, battery)
        if len(own) < FEWEST:
            continue
        other_units, doubtful = _factors(own, driven, model, battery)
        found |= other_units
        left = [one for one in driven if one.run.run not in {*found, *doubtful, *apart}]
        if len(left) >= FEWEST_LEVELS:
            others = Others(left, battery)
            told = runs_beside(others, model)
            doubtful |= {name: why for name, why in offsets(others).items() if name not in told}
            found |= told
        usual = [run for run in own if run.run not in {*found, *doubtful}]
        found |= {run.run: doubtful[run.run] for run in own if run.run in doubtful and not beyond(run, usual)}
    return apart | (found if len(found) < 0.5 * len(runs) else {})


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


def beyond(run: Run, others: Sequence[Run]) -> list[str]:
    """Columns, but those of motion, in which a run is where no other run is: what it costs more is not odd then."""
    found: list[str] = []
    for name, data in run.columns.items():
        have = [one.columns[name] for one in others if name in one.columns]
        if name in _MOTION or is_switch(name) or not may_be_cause(name) or len(have) < FEWEST or not run.rows:
            continue
        if isinstance(data, Labels):
            seen = {text for one in have if isinstance(one, Labels) for text in one.names}
            if name == "surface" and not {*data.names} & seen:
                found.append(name)
            continue
        values = np.concatenate([one[np.isfinite(one)] for one in have if not isinstance(one, Labels)])
        own = data[np.isfinite(data)]
        if not len(own) or not len(values) or (np.ptp(own) > 0.0 and np.all(np.diff(own) >= 0.0)):
            continue  # a clock is elsewhere in every run
        low, high = np.quantile(values, [0.02, 0.98])
        most = max(BEYOND * float(high - low), 1e-9 * abs(float(high)))
        if not low - most <= float(np.median(own)) <= high + most:
            found.append(name)
    return found


def _factors(
    runs: Sequence[Run], driven: Sequence[Driven], model: PowerModel, battery: str
) -> tuple[dict[str, str], dict[str, str]]:
    """Runs whose level against the model differs from that of the others by a factor: in another unit; and by less."""
    found: dict[str, str] = {}
    doubtful: dict[str, str] = {}
    ratios = np.array([_ratio(one, battery) for one in driven])
    usual = float(np.median(ratios))
    if not usual > 0.0:
        return found, doubtful
    apart = np.abs(np.log(np.maximum(ratios / usual, 1e-12)))
    middle = float(np.nanmedian(apart))
    least = max(np.log(SUSPECT), ALIKE * middle)
    for run, off, far in zip(runs, ratios / usual, apart, strict=True):
        if not np.isfinite(off) or far < least:
            continue
        speeds = [
            factor
            for factor in _other_speeds(run, runs)
            if _near(_ratio(drive(model, divided(run, "speed_m_s", factor), battery), battery) / usual)
        ]
        if speeds:
            found[run.run] = f"speed_m_s is {speeds[0]:.3g} times too large ({SPEEDS[speeds[0]]}?)"
        elif off < 0.0 or far > np.log(LEVEL):
            found[run.run] = f"power_{battery}_w is {off:.3g} times the other runs against the model: another unit?"
        elif far > ALONE * middle:
            doubtful[run.run] = (
                f"power_{battery}_w is {off:.3g} times the other runs against the model, which agree: "
                "another robot, unit or load?"
            )
    return found, doubtful


def _ratio(driven: Driven, battery: str) -> float:
    model_j = float(driven.model_w[battery] @ driven.dt_s)
    return float(driven.measured_w[battery] @ driven.dt_s) / model_j if model_j else float("nan")


def _other_speeds(run: Run, runs: Sequence[Run]) -> list[float]:
    """Factors that make a run's speeds more like those of the others, the likeliest first; none unless it is faster or
    slower than any of them."""
    if "speed_m_s" not in run.columns or not larger("speed_m_s", run, [one for one in runs if one is not run]):
        return []
    fast = [float(np.quantile(np.abs(one.number("speed_m_s")), 0.95)) for one in runs if "speed_m_s" in one.columns]
    usual = float(np.median(fast))
    off = float(np.quantile(np.abs(run.number("speed_m_s")), 0.95)) / usual if usual > 0.0 else 0.0
    if not off > 0.0:
        return []
    apart = {factor: abs(np.log(off / factor)) for factor in SPEEDS}
    return sorted((factor for factor in SPEEDS if apart[factor] < abs(np.log(off))), key=apart.__getitem__)


def _near(off: float) -> bool:
    return bool(np.isfinite(off) and 1.0 / EXPLAINED < off < EXPLAINED)

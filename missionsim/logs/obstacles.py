"""What stands in the way of a diagnosis although nothing is wrong with the file: gauges, wraps, slow speeds, docks."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.glossary import column_of
from missionsim.labels import Labels
from missionsim.logs.clean import Rows
from missionsim.logs.codes import refreshes
from missionsim.logs.suspect import SAMPLE, STRETCH, hardly_moves, stretches
from missionsim.physics import Array, Bools
from missionsim.physics.lag import Meter, metered


def check_obstacles(rows: Rows, components: Sequence[str] = ()) -> None:
    """Tell what stands in the way of a diagnosis although nothing is wrong with the file."""
    missing = [name for name in components if f"on_{name}" not in rows.columns]
    if missing:
        told = f"no column says when {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} on"
        action = f"what a component draws can be told apart only where it is switched and logged (on_{missing[0]})"
        rows.remark("obstacle", "", told, action, "note")
    time = rows.time
    for name, data in rows.columns.items():
        found = column_of(name)
        if found is None or isinstance(data, Labels) or len(data) < 50:
            continue
        if found[0].name == "current_<battery>_a" and (span := _wraps(data)):
            told = f"the current jumps by {span:.6g} A and back: its number wraps (a sign or an overflow of the logger)"
            action = "left as it is; a map can undo it: where(I > LIMIT, I - SPAN, I)"
            rows.remark("obstacle", name, told, action, "error")
        elif found[0].name == "energy_<battery>_wh":
            moved = np.flatnonzero(np.diff(data)) + 1
            steps = np.abs(data[moved] - data[moved - 1])
            even = len(moved) > 2 and float(np.ptp(steps)) < 0.02 * float(steps.max())
            usual = float(np.median(np.diff(time[moved]))) if len(moved) > 2 else time[-1] - time[0]
            if (even or len(moved) <= 2) and usual > _GAUGE_S:
                told = f"a gauge in steps ({len(moved)} in all, one every {usual:.3g} s)"
                action = "left as it is; it holds the energy of a mission, but no watts that a diagnosis could use"
                rows.remark("obstacle", name, told, action)
        elif name == "speed_m_s" and (slow := refreshes(data[:SAMPLE], time[:SAMPLE])) is not None:
            step = float(np.median(np.diff(time[:SAMPLE])))
            if slow.period_s >= 0.8 and slow.period_s > 3.5 * step:
                told = f"the speed changes every {slow.period_s:.2g} s only (from GNSS?)"
                action = "kept; starts, stops and what speeding up takes cannot be seen in it: log the wheels' speed"
                rows.remark("obstacle", name, told, action)


_GAUGE_S = 20.0
"""Steps of a counter that are this far apart are those of a gauge and not of a meter."""
_MODULI = tuple(base * 10.0**-digits for base in (65536.0, 4096.0, 32768.0) for digits in range(5))


def _wraps(data: Array) -> float:
    """Span of a number that wraps, such as 65.536; 0 where the values do not."""
    sample = data[:SAMPLE]
    step = np.diff(sample)
    span = float(np.ptp(sample))
    if span <= 0:
        return 0.0
    jumps = np.abs(step) > 0.8 * span
    if jumps.sum() < 2 or float(np.median(np.abs(step))) > 0.05 * span:
        return 0.0
    for modulus in _MODULI:
        if 0.9 * span < modulus < 1.3 * span:
            whole = np.unwrap(sample, period=modulus)
            smooth = np.abs(np.diff(whole))
            # a load that is switched jumps as well, but not to where the values would go on from
            if smooth[jumps].max() <= 1.5 * smooth[~jumps].max(initial=0.0) and float(np.ptp(whole)) < 0.5 * modulus:
                return modulus
    return 0.0


_LONGEST_S = 3.0
_MOST_SAMPLES = 40_000
_LEAST_SAMPLES = 60
_SMOOTHINGS_S = (0.25, 0.5, 1.0, 2.0, 4.0)
"""Time constants tried for a meter that smooths [s]."""
_CHARGE_S, _BRIEF_S, _CHARGE, _NOISY = 10.0, 1.0, 0.1, 3.0
"""Shorter than this a battery may take back what the drive gives up in stopping, filters included, unless the robot has
stood for `_LONGEST_S` before; shorter than the second no charger is told from that; less, as a part of the usual power
under way or as a multiple of the median change from row to row, may be an offset or noise of a meter (all assumed)."""
_SUN = re.compile(r"(?<![a-z])(solar|sun|pv|irradianc\w*|photovolt\w*)(?![a-z])", re.IGNORECASE)
"""What feeds a battery on the way as well is in the log where a column is called so, and may be learnt."""


def charged_at_rest(rows: Rows, power_w: Mapping[str, Array]) -> Bools:
    """Rows in which a robot stands at a charger, which is told: from where a battery that delivers while the robot
    drives is charged, until it drives again (with what it feeds, the charger then feeds the robot as well)."""
    result = np.zeros(len(rows.row), dtype=bool)
    speed, yaw = rows.columns.get("speed_m_s"), rows.columns.get("yaw_rate_rad_s")
    if speed is None or isinstance(speed, Labels) or isinstance(yaw, Labels) or any(map(_SUN.search, rows.columns)):
        return result
    slow = hardly_moves(np.abs(speed), np.zeros_like(speed) if yaw is None else np.abs(yaw))
    for battery, power in power_w.items():
        usual, taken, count = 0.0 if slow.all() else float(np.median(power[~slow])), 0.0, 0
        noise = float(np.median(np.abs(np.diff(power[slow])))) if slow.sum() > 1 else 0.0
        for first, last in stretches(slow & (power < 0.0)):
            stopped = first - int(np.argmin(np.r_[slow[:first][::-1], False]))
            stood = rows.time[first] - rows.time[stopped] >= _LONGEST_S
            long = rows.time[last - 1] - rows.time[first] >= (_BRIEF_S if stood else _CHARGE_S)
            least = max(_CHARGE * usual, _NOISY * noise)
            if usual > 0.0 and long and last - first >= STRETCH and -power[first:last].mean() > least:
                end = last + int(np.argmin(np.r_[slow[last:], False]))
                # the row at the contact holds a part of both
                chosen = slice(max(first - int(first > 0 and slow[first - 1]), 0), end)
                taken, count = taken - float(power[first:last].sum()), count + last - first
                result[chosen] = True
        if count:
            told = f"charged with {taken / count:.4g} W on average while the robot stands, {count} rows"
            action = "left out until it drives again: they say nothing of what it needs"
            rows.remark("charging", f"power_{battery}_w", told, action, "warning", int(np.argmax(result)), count)
    return result


_MOTION = ("speed_m_s", "yaw_rate_rad_s", "slope_rad")


def check_clock(rows: Rows, power: dict[str, Array]) -> None:
    """Tell where power follows the motion late, or smoothed."""
    part = slice(0, 200_000)
    motion = {n: np.asarray(data)[part] for n in _MOTION if (data := rows.columns.get(n)) is not None}
    for battery, watt in power.items():
        found = clock_delay(rows.time[part], watt[part], **motion)
        if found is None:
            continue
        gain = found.correlation**2 - found.correlation_at_zero**2
        smoother = found.correlation_smoothed**2 - found.correlation**2
        if found.smoothing_s >= max(1.0, 2.0 * found.resolution_s) and smoother > _SMOOTHED:
            told = f"power follows the motion as if it were smoothed over about {found.smoothing_s:g} s "
            told += f"(correlation {found.correlation_smoothed:.2f}, {found.correlation:.2f} without)"
            action = "left as it is; short effects such as starts cannot be seen in it: log the meter's raw values"
            rows.remark("obstacle", f"power_{battery}_w", told, action)
        elif found.correlation > _CLEAR and gain > _GAIN and abs(found.delay_s) >= max(0.15, 0.5 * found.resolution_s):
            later = "later" if found.delay_s > 0 else "earlier"
            told = f"power changes about {abs(found.delay_s):.2g} s {later} than the motion "
            told += f"(correlation {found.correlation:.2f}, at no shift {found.correlation_at_zero:.2f})"
            action = "left as it is; the diagnosis aligns the clocks, a map can shift them (lag)"
            rows.remark("clock", f"power_{battery}_w", told, action, "note")


_CLEAR, _FOLLOWS, _GAIN, _SMOOTHED = 0.5, 0.4, 0.08, 0.08
"""Least correlation to tell a shift, and to look for a smoothing; least further share of the variance each explains.
Chosen on the measured logs of a car, two robots and a simulated one: no shift is told where the clocks agree."""


@dataclass(frozen=True)
class ClockEstimate:
    """Delay of power behind motion."""

    delay_s: float
    """Positive: power comes later than the motion that causes it [s]."""
    correlation: float
    """Multiple correlation between changes of power and changes of motion, at that delay."""
    correlation_at_zero: float
    resolution_s: float
    """Step of the log that limits the estimate [s]."""
    smoothing_s: float = 0.0
    """Time constant of a first-order low pass of the motion that explains power better than any delay; 0 where none
    does [s], or where power hardly follows the motion."""
    correlation_smoothed: float = 0.0
    """At that time constant."""


def clock_delay(
    time_s: Array, power_w: Array, speed_m_s: Array, yaw_rate_rad_s: Array | None = None, slope_rad: Array | None = None
) -> ClockEstimate | None:
    """Delay between power and motion: the lag at which their changes agree best.

    `time_s`, `power_w`, `speed_m_s`, `yaw_rate_rad_s`, `slope_rad` (shape (n,)): one run, in SI units. Gives None where
    the log is too short, hardly moves, or the two do not go together (correlation under 0.2).

    A simple check: all series on an even grid, differenced (so that slow drifts do not matter); changes of power are
    regressed on those of speed, its square, what speeding up takes (v·a), turning and climbing, at every lag within
    ±3 s. Without v·a the power of a heavy vehicle, which leads its speed, looks like a clock that is wrong, and without
    the slope that of a robot among hills as if it were smoothed. The diagnosis aligns the clocks by likelihood.
    """
    step = max(float(np.median(np.diff(time_s))), 0.05)
    grid = np.arange(time_s[0], time_s[-1], step)[:_MOST_SAMPLES]
    if len(grid) < _LEAST_SAMPLES:
        return None
    power = np.diff(np.interp(grid, time_s, power_w))
    speed = np.interp(grid, time_s, speed_m_s)
    # averaged over half a second: the rate of a noisy speed is noise
    width = max(1, round(0.5 / step))
    rate = np.gradient(np.convolve(speed, np.ones(width) / width, mode="same"), step)
    followed = [np.abs(speed), speed**2, speed * rate]
    if yaw_rate_rad_s is not None:
        followed.append(np.abs(np.interp(grid, time_s, yaw_rate_rad_s)))
    if slope_rad is not None:
        followed.append(np.abs(speed) * np.sin(np.interp(grid, time_s, slope_rad)))
    causes = np.array(followed)
    most = round(_LONGEST_S / step)
    explained = _explained(power, np.diff(causes, axis=1), most)
    if explained is None:
        return None
    top = int(np.argmax(explained))
    best, offset = float(explained[top]), 0.0
    if best <= 0.2:
        return None
    if 0 < top < 2 * most:
        left, middle, right = explained[top - 1 : top + 2]
        bend = left - 2 * middle + right
        offset = 0.5 * (left - right) / bend if bend < 0 else 0.0
    smoothed = 0.0, 0.0
    for tau in _SMOOTHINGS_S if best > _FOLLOWS else ():
        shown = metered(causes, grid, Meter(-0.5 * step, tau))
        if (one := _explained(power, np.diff(shown, axis=1), 0)) is not None and one[0] > smoothed[1]:
            smoothed = tau, float(one[0])
    smoothing_s, correlation = smoothed if smoothed[1] > best else (0.0, smoothed[1])
    return ClockEstimate(
        float((top - most + offset) * step), best, float(explained[most]), step, smoothing_s, correlation
    )


def _explained(power: Array, causes: Array, most: int) -> Array | None:
    """Multiple correlation of power with causes at each lag from -most to most, shape (2 most + 1,)."""
    power = power - power.mean()
    causes = causes[np.ptp(causes, axis=1) > 0]
    causes = causes - causes.mean(axis=1, keepdims=True)
    total = float(power @ power)
    n = len(power)
    if total <= 0 or not len(causes) or n <= 4 * most:
        return None
    gram = causes @ causes.T
    scale = np.sqrt(np.diag(gram))
    gram = gram / np.outer(scale, scale) + 1e-3 * np.eye(len(causes))
    lags = range(-most, most + 1)
    cross = np.stack([causes[:, max(0, -k) : n - max(0, k)] @ power[max(0, k) : n + min(0, k)] for k in lags], axis=1)
    cross /= scale[:, None]
    squared = np.einsum("kl,kl->l", cross, np.linalg.solve(gram, cross)) / total
    return np.asarray(np.sqrt(np.clip(squared, 0.0, 1.0)))

"""What drives the power, without the noise of its sensors, which goes into base and effects but not into the power.

It pulls coefficients down (errors in variables, Carroll et al. 2006), and of a cause that is constant in a run it says
that what changes by it changes nothing.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from missionsim.glossary import column_of
from missionsim.identify import settings as const
from missionsim.labels import Labels
from missionsim.runs.run import Run


def steady_temperatures(run: Run) -> Run:
    """A run whose temperatures are medians over `TEMPERATURE_S`: what is cold or warm stays so for minutes, and the way
    from a hall into the cold keeps its instant."""
    from scipy.ndimage import median_filter

    row_s = float(np.median(np.diff(run.time_s))) if run.rows > 1 else 0.0
    if row_s <= 0.0:
        return run
    steady = {}
    for name, column in run.columns.items():
        known = column_of(name)
        if known is None or known[0].unit != "degC" or isinstance(column, Labels) or not np.isfinite(column).all():
            continue
        # of the means of a fast log, whose every row would take long
        firsts = np.arange(0, len(column), max(1, int(const.TEMPERATURE_S / const.TEMPERATURE_ROWS / row_s)))
        counts = np.diff(firsts, append=len(column))
        rows = round(const.TEMPERATURE_S / row_s / counts[0]) | 1
        if rows > 1:
            means = np.add.reduceat(column, firsts) / counts
            steady[name] = np.repeat(median_filter(means, rows, mode="mirror"), counts)
    return replace(run, columns={**run.columns, **steady})


def steady_speed(run: Run) -> Run:
    """A run whose speed, logged in slow rows, has its noise averaged out over neighbours that agree within it.

    That noise goes into base and effects but not into the power, and pulls coefficients down, those of steep curves
    most (errors in variables, Carroll et al. 2006). Ramps and steps stay as they are (sigma filter in two passes), and
    so does a speed that moves on as it moved before, as in traffic: that is no noise.
    """
    row_s = float(np.median(np.diff(run.time_s)))
    if "speed_m_s" not in run.columns or row_s < const.SLOW_ROWS_S:
        return run
    speed = run.number("speed_m_s")
    moving = speed != 0
    step = np.diff(speed)[moving[1:] | moving[:-1]]
    turn = np.diff(speed, 2)[moving[1:-1] | (moving[2:] & moving[:-2])]
    if not len(turn):
        return run
    typical, level = float(np.median(np.abs(step))), float(np.median(np.abs(speed[moving])))
    if not (0.0 < typical < const.SPEED_NOISY * level and np.median(np.abs(turn)) > const.SPEED_JUMPS_BACK * typical):
        return run
    near = const.SPEED_AGREE * typical
    going = np.abs(speed) > near  # what starts or stops keeps its instant, and noise near rest moves no steep curve
    for rows in (const.SPEED_ROWS, round(const.SPEED_AVERAGED_S / row_s)):
        total, count = speed.copy(), np.ones_like(speed)
        for shift in range(1, min(rows, len(speed) - 1) + 1):
            alike = (np.abs(speed[shift:] - speed[:-shift]) <= near) & going[shift:] & going[:-shift]
            total[shift:] += alike * speed[:-shift]
            count[shift:] += alike
            total[:-shift] += alike * speed[shift:]
            count[:-shift] += alike
        speed = total / count
        # what the first pass leaves of the noise: ends of ramps stand out now
        near /= np.sqrt(2 * const.SPEED_ROWS + 1)
    return replace(run, columns={**run.columns, "speed_m_s": speed})

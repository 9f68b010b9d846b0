"""What stands in the way of a diagnosis although nothing is wrong with the file: gauges, wraps, slow speeds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from missionsim.glossary import column_of
from missionsim.labels import Labels
from missionsim.logs.clean import Rows
from missionsim.logs.power import refreshes

Floats = NDArray[np.float64]

_SAMPLE = 100_000


def check_obstacles(rows: Rows, components: Sequence[str] = ()) -> None:
    """Tell what stands in the way of a diagnosis although nothing is wrong with the file."""
    missing = [name for name in components if f"on_{name}" not in rows.columns]
    if missing:
        rows.remark(
            "obstacle",
            "",
            f"no column says when {', '.join(missing)} {'is' if len(missing) == 1 else 'are'} on",
            f"what a component draws can be told apart only where it is switched and logged (on_{missing[0]})",
            "note",
        )
    time = rows.time
    for name, data in rows.columns.items():
        found = column_of(name)
        if found is None or isinstance(data, Labels) or len(data) < 50:
            continue
        if found[0].name == "current_<battery>_a" and (span := _wraps(data)):
            rows.remark(
                "obstacle",
                name,
                f"the current jumps by {span:.6g} A and back: its number wraps (a sign or an overflow of the logger)",
                "left as it is; a map can undo it: where(I > LIMIT, I - SPAN, I)",
                "error",
            )
        elif found[0].name == "energy_<battery>_wh":
            moved = np.flatnonzero(np.diff(data)) + 1
            steps = np.abs(data[moved] - data[moved - 1])
            even = len(moved) > 2 and float(np.ptp(steps)) < 0.02 * float(steps.max())
            usual = float(np.median(np.diff(time[moved]))) if len(moved) > 2 else time[-1] - time[0]
            if (even or len(moved) <= 2) and usual > _GAUGE_S:
                rows.remark(
                    "obstacle",
                    name,
                    f"a gauge in steps ({len(moved)} in all, one every {usual:.3g} s)",
                    "left as it is; it holds the energy of a mission, but no watts that a diagnosis could use",
                )
        elif name == "speed_m_s" and (slow := refreshes(data[:_SAMPLE], time[:_SAMPLE])) is not None:
            step = float(np.median(np.diff(time[:_SAMPLE])))
            if slow.period_s >= 0.8 and slow.period_s > 3.5 * step:
                rows.remark(
                    "obstacle",
                    name,
                    f"the speed changes every {slow.period_s:.2g} s only (from GNSS?)",
                    "kept; starts, stops and what speeding up takes cannot be seen in it: log the wheels' speed",
                )


_GAUGE_S = 20.0
"""Steps of a counter that are this far apart are those of a gauge and not of a meter."""
_MODULI = tuple(base * 10.0**-digits for base in (65536.0, 4096.0, 32768.0) for digits in range(5))


def _wraps(data: Floats) -> float:
    """Span of a number that wraps, such as 65.536; 0 where the values do not."""
    sample = data[:_SAMPLE]
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

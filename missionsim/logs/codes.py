"""Numbers that loggers write where they have none."""

from __future__ import annotations

import numpy as np

from missionsim.physics import Array

_NINES = (999.0, 9999.0, 99999.0, 999999.0)
_CODES = np.unique([
    -1.0, *_NINES, *(-code for code in _NINES),
    *(code * scale for code in (32767.0, -32768.0, 65535.0) for scale in (1.0, 0.1, 0.01, 0.001)),
    2.0**31 - 1, -(2.0**31), 2.0**32 - 1,
])  # fmt: skip
"""Nines, and the ends of whole numbers, also scaled."""
_FEW, _FAR, _LONE = 8, 0.5, 10.0
"""Values that a column has beside its codes, else it may be a count; times their range that a code lies beside them,
and one that stands there once (all assumed)."""
_LASTS, _JUMPS = 2, 5.0
"""Rows that a code of -1, which lies near what is measured, lasts at most, and times the usual step of the others that
it jumps by (both assumed)."""


def without_codes(data: Array) -> tuple[Array, list[tuple[float, int, int]]]:
    """A column with its codes for no value as NaN; and each code, its number of rows, its first row.

    A code is one of a list, exactly, again and again, and far from all other values, by half of their range; or -1 in
    single rows, with a jump before and after. A reading at a limit has others near it.
    """
    ends = np.array([np.fmin.reduce(data), np.fmax.reduce(data)]) if len(data) else np.empty(0)
    met = _CODES[np.isclose(ends[:, None], _CODES, rtol=1e-9).any(axis=0)]
    if np.count_nonzero(data == -1.0) > 2:
        met = np.union1d(met, -1.0)
    if not len(met):
        return data, []
    others = data[np.isfinite(data) & ~np.isin(data, _CODES) & ~np.isclose(data[:, None], met, rtol=1e-9).any(axis=1)]
    if len(others) < _FEW or len(np.unique(others[:10_000])) < _FEW:
        return data, []
    low, high = float(others.min()), float(others.max())
    found: list[tuple[float, int, int]] = []
    for code in met:
        rows = np.isclose(data, code, rtol=1e-9)
        far, count = max(low - code, code - high), int(rows.sum())
        if code == -1.0:
            times = int(np.count_nonzero(np.diff(np.r_[False, rows]) & rows))
            jump = float(np.nanmedian(np.abs(np.diff(data, prepend=np.nan)[rows & ~np.r_[False, rows[:-1]]])))
            gone = 2 < count <= _LASTS * times and jump > _JUMPS * float(np.quantile(np.abs(np.diff(others)), 0.95))
        else:
            gone = far > (high - low) * (_FAR if count > 1 else _LONE) and count < 0.5 * len(data)
        if gone:
            found.append((float(code), count, int(np.argmax(rows))))
            data = np.where(rows, np.nan, data)
    return data, found

"""Bare functions of scalars or arrays; numbers or arrays in, float64 arrays out."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Ints = NDArray[np.intp]
Int64s = NDArray[np.int64]
Value = float | Array
"""A number or an array of numbers; arrays broadcast (scalar, ``(intervals,)``, ``(draws, intervals)``)."""


def f64(values: ArrayLike) -> Array:
    """`values` as a float64 array (a 0-d array for a number), not copied where it is one already."""
    return np.asarray(values, dtype=np.float64)

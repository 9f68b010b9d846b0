"""Chains of points: what may be had between one charge and another, straight from point to point; their fronts."""

from __future__ import annotations

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from missionsim.physics import Array

EPSILON = 1e-10
"""Resources that differ by less (relative to 1 or their size) are taken as equal."""
FIRST = 4
"""Chains that are compared with first: most that is dominated, is so by one of least bound."""
T = TypeVar("T", bound=np.generic)


def _shares(first: Array, step: Array, limit: Array) -> tuple[Array, Array]:
    """From and up to which share each piece of chains keeps to limits; none of it where the first is greater. `first`,
    `step`, `limit`: resources in the first axis."""
    room = limit - first
    with np.errstate(divide="ignore", invalid="ignore"):
        share = room / step
    never = (step == 0.0) & (room < 0.0)
    high = np.where(step > 0.0, share, np.where(never, -1.0, 1.0)).min(axis=0)
    return np.where(step < 0.0, share, 0.0).max(axis=0, initial=0.0), np.minimum(high, 1.0)


def most_of_least(first: Array, last: Array) -> Array:
    """At most what `least_of_most` gives, sooner."""
    return np.asarray(np.minimum(first, last).max(axis=-1))


def least_of_most(first: Array, last: Array) -> Array:
    """The least between two points of the greatest of values that go straight from one to the other, shape (...).
    `first`, `last` (shape (..., values)). It is that of two of the values (Helly), at an end or where they cross."""
    found = most_of_least(first, last)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = last - first
        if not (step < 0.0).any():
            return found
        share = (first[..., :, None] - first[..., None, :]) / (step[..., None, :] - step[..., :, None])
        there = first[..., :, None] + share * step[..., :, None]
    cross = (step[..., :, None] < 0.0) & (step[..., None, :] > 0.0) & (share > 0.0) & (share < 1.0)
    return np.asarray(np.maximum(found, np.where(cross, there, -math.inf).max(axis=(-2, -1))))


def within(points: Array, limit: Array) -> Array:
    """The part of a chain of points that keeps to limits, shape (m, resources); empty where none does."""
    if len(points) == 1:
        return points if bool((points[0] <= limit).all()) else points[:0]
    if bool((points <= limit).all()):
        return points
    low, high = _shares(points[:-1].T, np.diff(points, axis=0).T, limit[:, None])
    kept: list[Array] = []
    for i in np.flatnonzero(low <= high).tolist():
        for share in (low[i], high[i]):
            point = np.minimum(points[i] + share * (points[i + 1] - points[i]), np.maximum(limit, points[i]))
            if not kept or np.abs(point - kept[-1]).max() > 1e-12:
                kept.append(point)
    return np.array(kept).reshape(len(kept), points.shape[1])


class Front:
    """Labels of one node that are followed; taken in the order of their bounds, no later one dominates an earlier."""

    __slots__ = ("begins", "chains", "count", "lows", "pieces", "values")

    def __init__(self, resources: int) -> None:
        self.values, self.lows = np.empty((resources, 8)), np.empty((resources, 8))
        self.begins = np.zeros(9, dtype=np.intp)
        """Of the pieces of each chain; its lowest values are in `lows`."""
        self.pieces = np.empty((2, resources, 8))
        self.count = self.chains = 0

    def add(self, points: Array) -> bool:
        """Add the points of a label, unless it is dominated."""
        limits = (points + EPSILON * (1.0 + np.abs(points))).T
        known, chains = self.values[:, : self.count], self.chains
        if self.count and all((known <= limit[:, None]).all(axis=0).any() for limit in limits.T):
            return False
        if chains:
            near = np.flatnonzero((self.lows[:, :chains] <= limits.min(axis=1)[:, None]).all(axis=0))
            for some in (near[:FIRST], near[FIRST:]):
                if some.size:
                    # whether each limit is kept by a point on one of the chains: what a chain dominates is convex, so
                    # that these suffice
                    sizes = self.begins[some + 1] - self.begins[some]
                    starts = np.cumsum(sizes) - sizes
                    which = np.arange(int(sizes.sum())) + np.repeat(self.begins[some] - starts, sizes)
                    first, step = self.pieces[:, :, which]
                    low, high = _shares(first[:, None], step[:, None], limits[:, :, None])
                    if np.logical_or.reduceat(low <= high, starts, axis=1).all(axis=0).any():
                        return False
        if len(points) > 1:
            begin = int(self.begins[chains])
            end = begin + len(points) - 1
            self.lows = _with_room(self.lows, chains + 1)
            self.begins = _with_room(self.begins, chains + 2)
            self.pieces = _with_room(self.pieces, end)
            self.lows[:, chains] = points.min(axis=0)
            self.pieces[0, :, begin:end] = points[:-1].T
            self.pieces[1, :, begin:end] = np.diff(points, axis=0).T
            self.begins[chains + 1] = end
            self.chains += 1
            return True
        self.values = _with_room(self.values, self.count + 1)
        self.values[:, self.count] = points[0]
        self.count += 1
        return True


def _with_room(columns: NDArray[T], count: int) -> NDArray[T]:
    """Columns, doubled as often as it takes to hold so many."""
    while columns.shape[-1] < count:
        columns = np.concatenate([columns, np.empty_like(columns)], axis=-1)
    return columns

"""Chains of points: what may be had between one charge and another, straight from point to point."""

from __future__ import annotations

import math

import numpy as np

from missionsim.physics import Array


def _shares(points: Array, limit: Array) -> tuple[Array, Array]:
    """From and up to which share each piece of chains keeps to limits; none of it where the first is greater."""
    first, step = points[:-1], points[1:] - points[:-1]
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (limit - first) / step
    never = (step == 0.0) & (first > limit)
    high = np.where(step > 0.0, share, np.where(never, -1.0, 1.0)).min(axis=-1)
    return np.where(step < 0.0, share, 0.0).max(axis=-1, initial=0.0), np.minimum(high, 1.0)


def most_of_least(first: Array, last: Array) -> Array:
    """At most what `least_of_most` gives, sooner."""
    return np.asarray(np.minimum(first, last).max(axis=-1))


def least_of_most(first: Array, last: Array) -> Array:
    """The least between two points of the greatest of values that go straight from one to the other, shape (...).

    `first`, `last` (shape (..., values)). It is that of two of the values (Helly), at an end or where they cross.
    """
    found = most_of_least(first, last)
    with np.errstate(divide="ignore", invalid="ignore"):
        step = last - first
        if not (step < 0.0).any():
            return found
        share = (first[..., :, None] - first[..., None, :]) / (step[..., None, :] - step[..., :, None])
        there = first[..., :, None] + share * step[..., :, None]
    cross = (step[..., :, None] < 0.0) & (step[..., None, :] > 0.0) & (share > 0.0) & (share < 1.0)
    return np.asarray(np.maximum(found, np.where(cross, there, -math.inf).max(axis=(-2, -1))))


def dominates(chain: Array, limits: Array) -> bool:
    """Whether each limit is kept by a point on the chain: what a chain dominates is convex, so these suffice."""
    for limit in limits:
        low, high = _shares(chain, limit)
        if not (low <= high).any():
            return False
    return True


def within(points: Array, limit: Array) -> Array:
    """The part of a chain of points that keeps to limits, shape (m, resources); empty where none does."""
    if len(points) == 1:
        return points if bool((points[0] <= limit).all()) else points[:0]
    if bool((points <= limit).all()):
        return points
    low, high = _shares(points, limit)
    kept: list[Array] = []
    for i in np.flatnonzero(low <= high).tolist():
        for share in (low[i], high[i]):
            point = np.minimum(points[i] + share * (points[i + 1] - points[i]), np.maximum(limit, points[i]))
            if not kept or np.abs(point - kept[-1]).max() > 1e-12:
                kept.append(point)
    return np.array(kept).reshape(len(kept), points.shape[1])

"""Geometry of site files: WGS 84 to metres, length of a NURBS, slope of a track from noisy elevations."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from missionsim.physics import Array

_A, _E2 = 6_378_137.0, 6.694379990141e-3
"""Semi-major axis, m, and squared eccentricity of the WGS 84 ellipsoid."""


@dataclass(frozen=True)
class LocalPlane:
    """Metres east and north of a point on the WGS 84 ellipsoid.

    The Gauss–Krüger series to second order: distances within 10 km of the origin are right to 1e-5.
    """

    latitude: float
    longitude: float
    """Both: origin, degrees."""

    @classmethod
    def around(cls, points: Sequence[tuple[float, float]]) -> LocalPlane:
        """The plane in the middle of (latitude, longitude) points, degrees, rounded to 1e-6."""
        middle = [(min(values) + max(values)) / 2 for values in zip(*points, strict=True)]
        return cls(round(middle[0], 6), round(middle[1], 6))

    def to_metres(self, latitude: float, longitude: float) -> tuple[float, float]:
        """x (east) and y (north) of a point, m."""
        phi, phi0 = math.radians(latitude), math.radians(self.latitude)
        delta = math.radians((longitude - self.longitude + 180.0) % 360.0 - 180.0)
        normal = _A / math.sqrt(1 - _E2 * math.sin(phi) ** 2)
        meridian = _A * (1 - _E2) / (1 - _E2 * math.sin((phi + phi0) / 2) ** 2) ** 1.5
        east = normal * math.cos(phi) * delta
        return east, meridian * (phi - phi0) + normal * math.sin(phi) * math.cos(phi) * delta**2 / 2

    def to_degrees(self, x: float, y: float) -> tuple[float, float]:
        """Latitude and longitude of a point given in metres: `to_metres` inverted by Newton's method."""
        latitude = self.latitude + math.degrees(y / _A)
        longitude = self.longitude + math.degrees(x / (_A * math.cos(math.radians(self.latitude))))
        for _ in range(5):
            east, north = self.to_metres(latitude, longitude)
            latitude += math.degrees((y - north) / _A)
            longitude += math.degrees((x - east) / (_A * math.cos(math.radians(latitude))))
        return latitude, longitude


def mercator_to_degrees(x: float, y: float) -> tuple[float, float]:
    """Latitude and longitude of web Mercator metres (EPSG:3857)."""
    return math.degrees(2 * math.atan(math.exp(y / _A)) - math.pi / 2), math.degrees(x / _A)


def nurbs_length(
    points: Sequence[tuple[float, float]], weights: Sequence[float], knots: Sequence[float], degree: int
) -> float | None:
    """Length of a planar NURBS curve, m; None where degree, points and knots do not fit together.

    `points`: length n; `weights`: length n; `knots`: length n + degree + 1.
    """
    count = len(points)
    if not 1 <= degree < count or len(knots) != count + degree + 1 or not all(w > 0 for w in weights):
        return None
    t = np.asarray(knots, float)
    if np.any(np.diff(t) < 0) or t[count] <= t[degree]:
        return None
    from scipy.interpolate import BSpline

    weight = np.asarray(weights, float)[:, None]
    homogeneous = np.hstack([np.asarray(points, float) * weight, weight])
    curve = BSpline(t, homogeneous, degree)(np.linspace(t[degree], t[count], 64 * count))
    steps = np.diff(curve[:, :2] / curve[:, 2:], axis=0)
    return float(np.hypot(steps[:, 0], steps[:, 1]).sum())


def smooth_slopes(distance_m: Array, elevation_m: Array, ends_m: Array, width_m: float) -> Array:
    """Slope of each section between neighbouring ends, from elevations with noise.

    The height of an end is that of a straight line fitted to the elevations around it, weighted by a triangle that is
    zero `width_m` away (local linear regression: a steady climb stays what it is, up to the ends of the track).
    `distance_m`, `elevation_m` (shape (n,)): along the track; `ends_m`: shape (k,). Gives an array of shape (k - 1,):
    rad, uphill positive.
    """
    height = np.empty(len(ends_m))
    for index, end in enumerate(ends_m):
        away = distance_m - end
        reach = max(width_m, 1.001 * float(np.sort(np.abs(away))[min(2, len(away) - 1)]))
        weight = np.maximum(0.0, 1.0 - np.abs(away) / reach)
        total, first, second = weight.sum(), (weight * away).sum(), (weight * away**2).sum()
        spread = total * second - first**2
        level, moment = (weight * elevation_m).sum(), (weight * away * elevation_m).sum()
        straight = spread > 1e-9 * max(total * second, 1e-12)
        height[index] = (second * level - first * moment) / spread if straight else level / total
    return np.arctan2(np.diff(height), np.maximum(np.diff(ends_m), 1e-9))

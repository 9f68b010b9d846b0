"""What a mission leaves to chance: obstacles on the way, failed relocalisations, inspections done again."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from missionsim.plan.legs import Leg

if TYPE_CHECKING:
    import numpy as np

MOST_ATTEMPTS = 1000
MOST_OBSTACLES = 10_000
"""On one leg."""


def failures(probability: float, rng: np.random.Generator) -> int:
    """How often something fails before it succeeds (geometric), at most `MOST_ATTEMPTS` − 1.

    Parameters
    ----------
    probability : float
        Of failing, each time, independently.
    rng : numpy.random.Generator
    """
    count = 0
    while count + 1 < MOST_ATTEMPTS and rng.random() < probability:
        count += 1
    return count


def stopped_by_obstacles(
    legs: Iterable[Leg], spacing_m: float, stop_s: float, rng: np.random.Generator
) -> tuple[list[Leg], int]:
    """Legs cut where an obstacle makes the robot stop and wait.

    Obstacles arrive as a Poisson process over the distance driven; the robot brakes, stands for an exponentially
    distributed time (the wait does not depend on how long the obstacle has been there) and sets off again.

    Parameters
    ----------
    legs : iterable of Leg
    spacing_m : float
        Mean distance between obstacles, above 0.
    stop_s : float
        Mean time stood at one.
    rng : numpy.random.Generator

    Returns
    -------
    tuple
        The legs with the stops among them, and the number of stops.
    """
    made: list[Leg] = []
    stops = 0
    for leg in legs:
        if leg.kind not in ("roll", "slide") or leg.distance_m <= 0.0:
            made.append(leg)
            continue
        done, here = 0.0, 0
        while here < MOST_OBSTACLES:
            at = done + rng.exponential(spacing_m)
            if at >= leg.distance_m:
                break
            made.append(_piece(leg, done, at)._replace(place=""))
            made.append(Leg("stand", leg.settings, duration_s=rng.exponential(stop_s)))
            done, here = at, here + 1
        made.append(_piece(leg, done, leg.distance_m) if here else leg)
        stops += here
    return made, stops


def _piece(leg: Leg, from_m: float, to_m: float) -> Leg:
    edge = leg.edge
    if edge is not None:
        begin, end, low, high = edge
        scale = (high - low) / leg.distance_m
        edge = (begin, end, low + from_m * scale, low + to_m * scale)
    return leg._replace(distance_m=to_m - from_m, edge=edge)

"""What a mission leaves to chance: obstacles on the way, failed relocalisations, inspections done again."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Iterable, Iterator
from typing import TYPE_CHECKING

from missionsim.errors import Fault, InputError, MissionsimError
from missionsim.inputs.parameter import Parameter
from missionsim.plan.legs import Leg

if TYPE_CHECKING:
    import numpy as np

MOST_OBSTACLES = 10_000
"""On one leg; where half as many are to be expected, the mission is refused: more than that will never be drawn."""


def failures(probability: float, rng: np.random.Generator) -> int:
    """How often something fails before it succeeds (geometric, by inversion of one uniform number).

    `probability`: of failing, each time, independently; 0 or more, below 1. Raises MissionsimError: where a drawn
    probability is none, or 1: it would never succeed.
    """
    if not 0.0 <= probability < 1.0:
        raise MissionsimError(f"a probability of {probability:g} was drawn; allowed: from 0 to less than 1")
    lot = 1.0 - rng.random()
    return int(math.log(lot) / math.log(probability)) if probability > 0.0 else 0


@contextlib.contextmanager
def told_at(file: str, parameter: Parameter) -> Iterator[None]:
    """Tell what is wrong with a number where it stands."""
    try:
        yield
    except MissionsimError as error:
        raise InputError(Fault(file, parameter.line, 0, str(error), parameter.path)) from error


def stopped_by_obstacles(
    legs: Iterable[Leg], spacing_m: float, stop_s: float, rng: np.random.Generator
) -> tuple[list[Leg], int]:
    """Legs cut where an obstacle makes the robot stop and wait.

    Obstacles arrive as a Poisson process over the distance driven; the robot brakes, stands for an exponentially
    distributed time (the wait does not depend on how long the obstacle has been there) and sets off again. `spacing_m`:
    mean distance between obstacles, above 0; `stop_s`: mean time stood at one. Gives the legs with the stops among
    them, and the number of stops. Raises MissionsimError: where more than half of `MOST_OBSTACLES` are to be expected
    on a leg.
    """
    made: list[Leg] = []
    stops = 0
    for leg in legs:
        if leg.kind not in ("roll", "slide") or leg.distance_m <= 0.0:
            made.append(leg)
            continue
        expected = leg.distance_m / spacing_m if spacing_m > 0.0 else math.inf
        if not expected <= 0.5 * MOST_OBSTACLES:
            raise MissionsimError(
                f"an obstacle every {spacing_m:g} m makes {expected:.3g} of them on a leg of {leg.distance_m:g} m; "
                f"allowed: at most {MOST_OBSTACLES // 2}"
            )
        done, here = 0.0, 0
        while True:
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
        scale = (edge.to_m - edge.from_m) / leg.distance_m
        edge = edge._replace(from_m=edge.from_m + from_m * scale, to_m=edge.from_m + to_m * scale)
    return leg._replace(distance_m=to_m - from_m, edge=edge)

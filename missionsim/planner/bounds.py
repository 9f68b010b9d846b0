"""Bounds on the rest of a tour: shortest drives between stops, and dynamic programming over the visits left."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from missionsim.planner.core import Bounds
from missionsim.planner.tour import Site, Tour

Array = NDArray[np.float64]
LONGEST_S = 1e6
HAIR = 2e-9


def matrix(site: Site, payload_kg: float, weights: Array) -> Array:
    """Least weighted seconds and Wh of driving from each stop to each, without what is done there."""
    road = site.road(payload_kg)
    out, into = site.nodes[payload_kg]
    found = road.distances(weights, out)[:, into]
    places = np.array([stop.place for stop in site.stops])
    return np.where(places[:, None] == places[None, :], 0.0, found)


def rest_of(site: Site, weights: Array) -> Array:
    """Least weighted seconds and Wh from each state and stop to the end, shape (states, stops).

    Charging is left out. Held and Karp (1962), backwards over the visits that are left.
    """
    order, size = site.order, len(site.stops)
    table = np.full((order.count, size), math.inf)
    known: dict[float, Array] = {}
    stands: dict[tuple[int, float], float] = {}
    for state in order.states():
        payload = order.payload_kg(state)
        if payload < 0.0:
            continue
        if payload not in known:
            known[payload] = matrix(site, payload, weights)
        apart = known[payload]
        best = np.full(size, math.inf)
        for visit, after in order.after(state):
            key = (visit, order.payload_kg(after))
            if key not in stands:
                stands[key] = float(site.standing(1 + visit, key[1]) @ weights)
            there = stands[key]
            np.minimum(best, apart[:, 1 + visit] + there + table[after, 1 + visit], out=best)
        if order.may_end(state):
            np.minimum(best, apart[:, site.goal], out=best)
            best[site.goal] = 0.0
        else:
            best[site.goal] = math.inf
        table[state] = best
    return table


def to_docks(site: Site, weights: Array, served: NDArray[np.bool_]) -> Array:
    """Least weighted use from each state and stop to a dock that serves a battery, shape (states, stops)."""
    order, size = site.order, len(site.stops)
    found = np.full((order.count, size), math.inf)
    docks = [i for i, stop in enumerate(site.stops) if stop.charger is not None and served[i]]
    if not docks:
        return found
    known: dict[float, Array] = {}
    for state in order.states():
        payload = order.payload_kg(state)
        if payload < 0.0:
            continue
        if payload not in known:
            known[payload] = matrix(site, payload, weights)[:, docks].min(axis=1)
        found[state] = known[payload]
    found[:, site.goal] = math.inf  # the mission ends there
    return found


def bounds_of(tour: Tour, multipliers: list[Array], *, objective: Array | None = None) -> Bounds:
    """What the search may know of the rest of each way.

    Parameters
    ----------
    tour : Tour
    multipliers : list of ndarray, shape (1 + batteries,)
        For the time and for each battery; the row of zeros is added.
    objective : ndarray, optional
        Weights of seconds and Wh in place of the task's.
    """
    site = tour.site
    physics, task = site.physics, site.task
    count = len(physics.names)
    base = site.weights if objective is None else objective
    reserve = np.maximum(physics.reserve_wh, 0.0)
    most = np.array([math.inf, _horizon(site), *physics.capacity_wh])
    if any(stop.charger is not None and stop.charger.levels is None for stop in site.stops):
        # charged just as much as will do, a battery must not come out empty by rounding
        most[2:] -= HAIR * physics.capacity_wh
    if task.within.reserve_throughout:
        most[2:] -= reserve
        reserve = np.zeros(count)
    extra = tour.start().shape[1] - len(most)
    most = np.concatenate([most, np.full(extra, math.inf)])
    least = np.zeros((tour.nodes, len(most)))
    unit = np.eye(1 + count)
    least[:, 1] = rest_of(site, unit[0]).ravel()
    for b in range(count):
        to_end = rest_of(site, unit[1 + b]) + reserve[b]
        served = np.array([stop.charger is not None and bool(stop.charger.served[b]) for stop in site.stops])
        least[:, 2 + b] = np.minimum(to_end, to_docks(site, unit[1 + b], served)).ravel()
    least[~np.isfinite(least[:, 1]), 0] = math.inf
    for i, visit in enumerate(task.visits):
        if visit.window is not None and visit.window.until is not None:
            for state in range(site.order.count):
                node = state * tour.size + 1 + i
                stand = float(site.standing(1 + i, max(0.0, site.order.payload_kg(state)))[0])
                least[node, 1] = max(least[node, 1], most[1] - visit.window.until.value - stand)
    rows, rests, offsets = [], [], []
    left = np.concatenate([[most[1]], most[2 : 2 + count] - reserve])  # limits of the vector itself
    for multiplier in [np.zeros(1 + count), *multipliers]:
        rows.append(np.concatenate([[1.0], multiplier, np.zeros(extra)]))
        rests.append(rest_of(site, base + multiplier).ravel())
        offsets.append(
            float(np.sum(np.where(multiplier > 0.0, multiplier * np.where(multiplier > 0.0, left, 0.0), 0.0)))
        )
    rest = np.stack(rests, axis=1)
    shear = None
    if site.windowed:
        shear = tour.waiting()
        shear[1] = 0.0
    return Bounds(most, least, np.array(rows), rest, np.array(offsets), shear)


def _horizon(site: Site) -> float:
    """The deadline; where there is none but windows end, a time that is long enough."""
    return min(site.deadline_s, LONGEST_S) if site.windowed else site.deadline_s


def limits_left(site: Site) -> Array:
    """Seconds and Wh of each battery that a plan without charging may use, shape (1 + batteries,)."""
    physics = site.physics
    return np.concatenate([[site.deadline_s], physics.initial_wh - physics.reserve_wh])

"""GPX 1.0 and 1.1: tracks and routes become chains of places; slopes come from the elevations, smoothed.

Format: the GPX schema of Topografix. Tracks are cut into sections of about half the smoothing distance; the length of a
section is that of the track in it, its slope that of a line fitted to the elevations around its ends (`smooth_slopes`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from missionsim.exchange.site import LocalPlane, Site, clean, says_charger
from missionsim.exchange.source import Element, Faults, finite
from missionsim.physics import Array

_USED = {"gpx": {"trk", "rte", "wpt"}, "trk": {"name", "trkseg"}, "trkseg": {"trkpt"}, "rte": {"name", "rtept"}}
_POINT_USED = {"ele", "name"}
_NEAR_M = 30.0
"""A waypoint this near a track is a place of it."""
Point = tuple[float, float, float, str, int]
"""Latitude, longitude, elevation (nan where none), name, line."""


def read(root: Element, site: Site, faults: Faults) -> None:
    """Fill the site; a mission drives the tracks and routes one after the other."""
    ways: list[tuple[str, list[Point], bool]] = []
    for index, track in enumerate(root.all("trk"), 1):
        for segment in track.all("trkseg"):
            if points := _points(segment, "trkpt", faults):
                ways.append((track.first("name") or f"track_{index}", points, True))
            else:
                site.tell("left out: track segment without points", segment.line)
    for index, route in enumerate(root.all("rte"), 1):
        if points := _points(route, "rtept", faults):
            ways.append((route.first("name") or f"route_{index}", points, False))
    marks = _points(root, "wpt", faults)
    every = [point for _, points, _ in ways for point in points] + marks
    if not every and not faults.found:
        faults.add(root.line, "a GPX file without tracks, routes and waypoints")
    if faults.found:
        return
    _left(root, site)
    plane = site.plane([point[:2] for point in every])
    chains = [chain for name, points, is_track in ways if len(chain := _chain(name, points, is_track, plane, site)) > 1]
    for latitude, longitude, _, name, line in marks:
        # the nearest place of a track, where one is near, is called by it; else a place by itself
        x, y = plane.to_metres(latitude, longitude)
        away = {k: math.hypot(p["x"] - x, p["y"] - y) for k, p in site.places.items() if "title" not in p}
        near = min(away, key=lambda key: away[key], default="")
        if not near or away[near] >= _NEAR_M:
            site.place(name or "waypoint", (x, y), charger=says_charger(name))
            if chains:
                site.tell(f"waypoint further than {_NEAR_M:g} m from each track: a place without a way", line)
            continue
        site.places[near]["title"] = name
        site.tell(f"waypoint within {_NEAR_M:g} m of a track's place is that place's title", line)
        if says_charger(name):
            site.places[near]["charger"] = site.options.charger
    if chains:
        site.tell("ways lead both ways: a track has no direction that would forbid the other")
        site.start = chains[0][0]
        for before, chain in zip([None, *chains], chains, strict=False):
            if before is not None and before[-1] != chain[0]:
                site.edge(before[-1], chain[0], both_ways=True)
                gap = site.straight(before[-1], chain[0]) or 0.0
                if gap >= 0.5:  # segments that touch
                    told = f"a straight way of {gap:.0f} m from the end of a track to the start of the next is assumed"
                    site.tell(told)
            site.segments.append({"drive": {"along": chain[1:] if before is None or before[-1] == chain[0] else chain}})


def _left(element: Element, site: Site) -> None:
    """Tell what of an element and of those in it has no place in ours."""
    for child in element.children:
        if child.tag in _USED.get(element.tag, _POINT_USED):
            _left(child, site)
        else:
            site.tell(f"left out: {clean(child.tag)[:40]} of a {element.tag}", child.line)


def _points(parent: Element, tag: str, faults: Faults) -> list[Point]:
    result = []
    for point in parent.all(tag):
        numbers = []
        for text, low, high in ((point.attributes.get("lat"), -90, 90), (point.attributes.get("lon"), -360, 360)):
            number = finite(text)
            if number is None or not low <= number <= high:
                faults.add(point.line, f"a {tag} needs lat and lon in degrees", str(text), f"{low} to {high}")
            else:
                numbers.append(number)
        height = finite(point.first("ele"))
        if len(numbers) == 2:
            name = clean(point.first("name"))
            result.append((numbers[0], numbers[1], math.nan if height is None else height, name, point.line))
    return result


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


def _chain(name: str, points: Sequence[Point], is_track: bool, plane: LocalPlane, site: Site) -> list[str]:
    """Places and ways of one track segment or route; the names of its places in order."""
    where = np.array([plane.to_metres(*point[:2]) for point in points])
    steps = np.hypot(*np.diff(where, axis=0).T) if len(where) > 1 else np.zeros(0)
    along = np.concatenate([[0.0], np.cumsum(steps)])
    if along[-1] <= 0.0:
        site.tell("left out: track that goes nowhere", points[0][4])
        return []
    chosen = [0, *(int(i) + 1 for i in np.flatnonzero(steps > 0.0))]
    if is_track:  # points nearest to equal distances along the track, the first and the last among them
        wanted = np.linspace(0.0, along[-1], max(1, round(along[-1] / max(site.options.smooth_m / 2, 1.0))) + 1)
        nearest = np.unique(np.searchsorted(along, wanted).clip(0, len(along) - 1))
        nearest[0], nearest[-1] = 0, len(along) - 1
        chosen = [int(i) for i in nearest[np.concatenate([[True], np.diff(along[nearest]) > 0.0])]]
    height = np.array([point[2] for point in points])
    known = np.isfinite(height)
    slopes = np.zeros(len(chosen) - 1)
    if known.sum() >= 2:
        slopes = smooth_slopes(along[known], height[known], along[chosen], site.options.smooth_m)
        site.tell(
            f"slopes: elevations of the points smoothed by local lines over {site.options.smooth_m:g} m to each side, "
            f"sections of about {site.options.smooth_m / 2:g} m"
        )
    if not known.all():
        site.tell("point without elevation" if known.any() else "no elevations: all ways are level", points[0][4])
    if is_track and len(chosen) < len(points):
        site.tell(f"{len(points)} points of '{clean(name)[:40]}' become {len(chosen)} places", points[0][4])
    names = []
    for count, index in enumerate(chosen):
        word = points[index][3] or f"{clean(name)[:80]} {count}"
        names.append(site.place(word, (where[index, 0], where[index, 1]), charger=says_charger(points[index][3])))
    lengths = np.diff(along[chosen])
    for count, (length, slope) in enumerate(zip(lengths, np.clip(slopes, -1.2, 1.2), strict=True)):
        line, rise = points[chosen[count]][4], float(slope) or None
        site.edge(names[count], names[count + 1], line, both_ways=True, length=float(length), slope=rise)
    return names

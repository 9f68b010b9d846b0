"""The network of stops that the core searches, and the drives between them."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any

import numpy as np

from missionsim.physics import Array
from missionsim.planner.core import Leaving
from missionsim.planner.drives import Drive
from missionsim.planner.pieces import undominated
from missionsim.planner.site import Charger, Site

VARIED = (0.3, 1.5)
"""By so much of what the mean arc costs the price of each resource is raised for the first drives."""
PATIENCE = 6_000
"""Labels after which the search for more drives on one road ends."""


class Fronts:
    """The drives between stops, found when first asked for: all that none is better than, or those cheapest for prices.

    `weights` (shape (1 + batteries,)): with `gap`, see `missionsim.planner.drives.Drives.between`; `gap`: None for
    those that are the cheapest for prices about `weights`; `slack` (shape (loads, stops, stops)): by how much any tour
    that drives between two stops is above the cheapest, with the same weights.
    """

    def __init__(
        self, site: Site, weights: Array | None = None, gap: float | None = math.inf, slack: Array | None = None
    ) -> None:
        self.site, self.weights, self.gap, self.slack = site, weights, gap, slack
        self._found: dict[tuple[float, int], dict[int, list[Drive]]] = {}
        self._cheap: dict[float, dict[int, dict[int, list[Drive]]]] = {}
        self._patience = dict.fromkeys(site.order.loads[0].tolist(), PATIENCE)

    @property
    def complete(self) -> bool:
        """Whether no search for drives had to end before it had all."""
        return min(self._patience.values()) >= 0

    def __call__(self, payload_kg: float, stop: int, head: int) -> list[Drive]:
        site = self.site
        if site.stops[stop].place == site.stops[head].place:
            return [Drive(np.zeros(1 + len(site.physics.names)), np.zeros(len(site.physics.names)))]
        road, out, into = site.road(payload_kg)
        key = (payload_kg, int(out[stop]))
        if key not in self._found and self.gap is None:
            self._found[key] = self._few(payload_kg)[key[1]]
        elif key not in self._found and self.gap is not None:
            targets, more = np.unique(into), None
            if self.slack is not None:
                rows = self.slack[np.searchsorted(site.order.loads[0], payload_kg)][out == key[1]].min(axis=0)
                more = np.array([rows[into == target].min() for target in targets])
            patience = self._patience[payload_kg]
            self._found[key], taken = road.between(
                key[1],
                targets,
                more,
                weights=self.weights,
                gap=self.gap,
                latest_s=site.deadline_s,
                timeless=site.timeless,
                waiting=site.shear,
                until=site.waits_until,
                patience=max(patience, 1),
            )
            self._patience[payload_kg] = patience - taken
            if taken > patience:
                for target, drives in self._few(payload_kg)[key[1]].items():
                    self._found[key].setdefault(target, []).extend(drives)
        return self._found[key].get(int(into[head]), [])

    def _few(self, payload_kg: float) -> dict[int, dict[int, list[Drive]]]:
        """The drives that are cheapest with each resource's price raised in steps by what all of the mean arc costs."""
        if payload_kg not in self._cheap:
            road, out, into = self.site.road(payload_kg)
            mean = np.maximum(np.abs(road.road.use).mean(axis=0), 1e-9)
            some = self.weights is not None and self.weights.any()
            weights = self.weights if self.weights is not None and some else 1.0 / mean
            unit = np.diag(max(float(weights @ mean), 1e-9) / mean)
            varied = [weights, *(weights + share * row for row in unit for share in VARIED)]
            found: dict[int, dict[int, list[Drive]]] = {int(source): {} for source in out}
            for (source, target), drives in road.supported(varied, np.unique(out), np.unique(into)).items():
                found[source][target] = drives
            self._cheap[payload_kg] = found
        return self._cheap[payload_kg]


class Tour:
    """Network of the core: a node is a state of the order and a stop; resources are objective, time, Wh missing.

    `values`: value of each visit, where some may be left out: then one more resource is the value that is not made yet;
    `most_missed`: limit of that resource; `by_value`: the value that is not made is the objective, in place of that
    resource.
    """

    def __init__(
        self,
        site: Site,
        drives: Fronts,
        values: Array | None = None,
        most_missed: float = math.inf,
        *,
        by_value: bool = False,
    ) -> None:
        self.site, self.drives, self.values, self.by_value = site, drives, values, by_value
        physics = site.physics
        self.none = Drive(np.zeros(len(site.weights)), np.zeros(len(physics.names)))
        self.size = len(site.stops)
        self.nodes = site.order.count * self.size
        self.counted = values is not None and not by_value
        self.latest = site.waits_until
        self.chargers: list[Charger | None] = []
        for stop in site.stops:
            rate = 0.0 if stop.charger is None else float(np.append(1.0, stop.charger.draw_w / 3600.0) @ site.weights)
            self.chargers.append(stop.charger and replace(stop.charger, rate=rate))
        total = 0.0 if values is None else float(values.sum())
        more = [total] if self.counted else []
        self.first = np.array([total if by_value else 0.0, 0.0, *(physics.capacity_wh - physics.initial_wh), *more])
        kept = physics.capacity_wh - physics.reserve_wh
        self.limits = np.array([math.inf, site.deadline_s, *kept, *([most_missed] if self.counted else [])])
        self.left = (self.limits - self.first)[1:]
        """Of each resource but the objective what a plan without charging may use."""
        self.unit = max(1e-6, float(site.weights.max()), 0.0 if values is None else float(values.max()))
        """The order of size of a price."""
        self._known: dict[int, Leaving] = {}

    def at(self, node: int) -> tuple[int, int]:
        """State of the order and stop of a node."""
        return divmod(node, self.size)

    def over(self, table: Array, whole: bool = True) -> Array:
        """A table by state and stop, for all nodes."""
        return table.ravel()

    def is_goal(self, node: int) -> bool:
        """Whether the mission ends here."""
        return node % self.size == self.site.goal

    def leaving(self, node: int) -> Leaving:
        """Arcs to all stops that may come next."""
        known = self._known.get(node)
        if known is None:
            known = self._known[node] = self._make(node)
        return known

    def _make(self, node: int) -> Leaving:
        state, stop = divmod(node, self.size)
        order, goal = self.site.order, self.site.goal
        nexts: list[tuple[int, int]] = []
        if stop != goal:
            nexts = [(1 + visit, after) for visit, after in order.after(state)]
            nexts += [(goal, state)] if order.may_end(state) else []
            nexts += [(dock, state) for dock in range(goal + 1, self.size) if dock != stop]
        payload = order.payload_kg(state)
        return self.arcs(
            (after * self.size + head, drive, whole, choice)
            for head, after in nexts
            for drive in self.drives(payload, stop, head)
            for choice, whole in self.arc_uses(drive, head, after)
        )

    def arcs(self, listed: Iterable[tuple[int, Any, Array, int]]) -> Leaving:
        """Arcs out of a node. `listed`: head, drive, what the whole takes, number of the scheme at the visit."""
        some = list(listed)
        count = len(self.site.physics.names)
        use = np.array([whole for _, _, whole, _ in some]).reshape(len(some), len(self.first))
        peak = np.zeros_like(use)
        peak[:, 2 : 2 + count] = np.array([drive.peak for _, drive, _, _ in some]).reshape(len(some), count)
        dips = bool((peak > np.maximum(use, 0.0) + 1e-12)[:, 2 : 2 + count].any())
        moves = [(self.at(head)[1], *rest) for head, *rest in some]
        return Leaving(np.array([head for head, *_ in some], dtype=np.intp), use, moves, peak if dips else None)

    def arc_uses(self, drive: Drive, head: int, after: int) -> list[tuple[int, Array]]:
        """What driving to a stop and what is done there add to the vector, for each scheme that none is better than."""
        visit = self.site.stops[head].visit
        made = 0.0 if self.values is None or visit is None else float(self.values[visit])
        stands = self.site.standing(head, self.site.order.payload_kg(after))
        kept = undominated(stands, self.site.shear, np.zeros((len(stands), 0))).tolist()
        return [(i, self.vector(drive.use + stands[i], made)) for i in kept]

    def vector(self, use: Array, made: float = 0.0) -> Array:
        """What seconds and Wh, and value made, add to the vector."""
        objective = -made if self.by_value else float(use @ self.site.weights)
        return np.array([objective, *use, *([-made] if self.counted else [])])

    def refill(self, node: int) -> Charger | None:
        """The charger of a dock."""
        return self.chargers[self.at(node)[1]]

    def opens(self, node: int) -> Callable[..., Array] | None:
        """Waiting at a visit until its window opens."""
        if not self.site.windowed:
            return None
        state, stop = divmod(node, self.size)
        visit = self.site.stops[stop].visit
        window = None if visit is None else self.site.task.visits[visit].window
        if window is None or window.from_.value <= 0.0:
            return None
        return self.until(window.from_.value + float(self.site.standing(stop, self.site.order.payload_kg(state))[0, 0]))

    def until(self, begin: float) -> Callable[..., Array]:
        """What waiting until some time does to the points of a chain, or to points apart."""
        waiting = self.vector(self.site.waiting)

        def wait(points: Array, *, apart: bool = False) -> Array:
            kept = list(points) if apart else [points[0]]
            for first, second in itertools.pairwise(() if apart else points):
                if first[1] < begin < second[1]:
                    kept.append(first + (begin - first[1]) / (second[1] - first[1]) * (second - first))
                kept.append(second)
            made = np.array(kept)
            return np.asarray(made + np.maximum(begin - made[:, 1:2], 0.0) * waiting)

        return wait

    def priced(self, prices: Array) -> tuple[Array, Array | None]:
        """Weights of seconds and Wh, and what each visit is worth, with prices on all resources but the objective."""
        count = len(self.site.weights)
        worth = None if self.values is None else self.values * (1.0 if self.by_value else float(prices[count]))
        return self.site.weights + prices[:count], worth

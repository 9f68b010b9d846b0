"""An edge driven in one of the ways that may be chosen, and the graph of places and speeds that these make.

Where the robot drives on from one edge to the next, the speed at the place between them depends on both (and, where
edges are shorter than it takes to brake, on more of them). A state is a place with the speed there, and whether the
next edge still has to be the reason for that speed: then what an edge costs depends on its two states alone, and the
profile of the whole run is the one that the simulation drives.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from missionsim.errors import InputError
from missionsim.files import grouped
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.segments import DriveSegment
from missionsim.inputs.task import SchemeChoice, TaskSpec, VisitSpec, speeds_of
from missionsim.physics import Array, Bools, Ints
from missionsim.plan.build import legs_of
from missionsim.plan.kinematics import Phases, ramp_phases
from missionsim.plan.legs import Leg
from missionsim.plan.routes import Routes, Way
from missionsim.planner.physics import Physics

MOST_SPEEDS = 60
"""Speeds at a place; beyond it the speeds that come from braking over several short edges are left out."""
FREE, OWED, ROLLED, STOPPED = 0, 1, 2, 3
"""A state's speed is explained already; must be explained by the next edge; is 0 without having stood; or the drive
ends here, at rest."""


_DRIVE = DriveSegment.model_construct(kind="drive")


def equipment(given: SchemeChoice | VisitSpec | None) -> dict[str, Any]:
    """Scheme, navigation and sensors that are asked for, as a segment has them."""
    return {} if given is None else {key: getattr(given, key) for key in ("scheme", "navigation", "sensors")}


@dataclass(frozen=True, eq=False)
class Piece:
    """An edge in one direction under one scheme at one speed."""

    way: Way
    name: str
    """What `along` calls it."""
    scheme: SchemeChoice | None
    """None for the task's default."""
    speed: float | None
    """Asked [m/s]; None for the default."""
    legs: tuple[Leg, ...]
    """That roll; an edge under an access point has several."""
    dwell: Leg | None = None
    """Standing at the end."""

    @property
    def limit_m_s(self) -> float:
        """Speed limit of its legs."""
        return self.legs[0].speed_m_s

    @property
    def instant(self) -> bool:
        """Whether its speed is there at once."""
        return self.legs[0].instant

    @property
    def distance_m(self) -> float:
        """Length driven."""
        return math.fsum(leg.distance_m for leg in self.legs)


def pieces_of(task: TaskSpec, physics: Physics, payload_kg: float) -> dict[str, list[Piece]]:
    """All pieces of a task's open edges, by the place where they begin; made once for all stops of the same task."""
    if payload_kg not in physics.pieces:
        physics.pieces[payload_kg] = _pieces(task, physics, payload_kg)
    return physics.pieces[payload_kg]


def _pieces(task: TaskSpec, physics: Physics, payload_kg: float) -> dict[str, list[Piece]]:
    routes = Routes(task.environment, lambda parameter: parameter.value)
    top = task.robot.body.max_speed.value
    asked: list[tuple[str, DriveSegment]] = []
    about: list[tuple[Way, str, SchemeChoice | None, float | None]] = []
    for place, ways in routes.ways.items():
        for way in ways:
            own = task.edges.get(task.environment.edges[way.edge].name or "")
            names = (task.environment.edges[way.edge].name, way.end)  # of which one may mean another edge
            meant = (n for n in names if n and task.environment.next_along(place, n) == (way.edge, way.end))
            if (name := next(meant, None)) is None or (own is not None and own.closed):
                continue
            schemes = (own.schemes if own is not None else None) or task.drives_with
            speeds = speeds_of(own.speeds if own is not None else None) or speeds_of(task.choose.speeds) or (None,)
            for scheme in schemes:
                of_scheme = task.robot.schemes.get(scheme.scheme if scheme else task.defaults.scheme or "")
                most = top if of_scheme is None or of_scheme.max_speed is None else of_scheme.max_speed.value
                done: set[float] = set()
                for speed in speeds:
                    given = None if speed is None else min(speed, most, top)
                    effective = min(given or math.inf, way.max_speed_m_s)
                    if given is not None and effective in done:
                        continue
                    done.add(effective)
                    chosen = {"along": (name,), "payload": Parameter(payload_kg, unit="kg")} | equipment(scheme)
                    chosen |= {} if given is None else {"speed": Parameter(given, unit="m/s")}
                    asked.append((place, _DRIVE.model_copy(update=chosen)))
                    about.append((way, name, scheme, given))
    pieces: dict[str, list[Piece]] = {place: [] for place in routes.ways}
    for legs, (way, name, scheme, given) in zip(legs_of(physics.mission, asked), about, strict=True):
        rolls = tuple(leg for leg in legs if leg.kind == "roll")
        dwell = next((leg for leg in legs if leg.kind == "stand"), None)
        pieces[way.begin].append(Piece(way, name, scheme, given, rolls, dwell))
    return pieces


class State(NamedTuple):
    """A place, the speed there and what explains it."""

    place: str
    speed: float = 0.0
    kind: int = FREE


@dataclass
class Road:
    """The graph of states, its arcs with what they cost."""

    states: list[State]
    tails: Ints
    heads: Ints
    """Both: shape (arcs,)."""
    use: Array
    """Seconds, and Wh of each battery. Shape (arcs, 1 + batteries)."""
    peak: Array
    """The most that has been drawn on the way, before braking or a slope gives back. Shape (arcs, batteries)."""
    driven: Sequence[Any]
    """By arc the piece, or what else it stands for."""
    index: dict[State, int] = field(default_factory=dict)


def make_road(physics: Physics, pieces: dict[str, list[Piece]], stops: Sequence[State], shear: Array) -> Road:
    """The graph of a site: from the stops, every state that can be reached, and what each arc costs.

    `pieces`: by the place where they begin; `stops`: where the robot may stand: it starts there and may end its drive
    there; `shear` (shape (1 + batteries,)): what a second until a later end may take of an earlier one.
    """
    accel = physics.limits.accel_m_s2 or 0.0
    decel = physics.limits.decel_m_s2 or accel
    places = {stop.place for stop in stops}
    binding = _binding(pieces, places, decel)
    stops = [*stops, *(State(place, 0.0, STOPPED) for place in sorted(places))]
    index: dict[State, int] = {state: i for i, state in enumerate(dict.fromkeys(stops))}
    waiting = deque(state for state in index if state.kind != STOPPED)
    tails: list[int] = []
    heads: list[int] = []
    driven: list[Piece] = []
    speeds: list[tuple[float, float]] = []
    while waiting:
        state = waiting.popleft()
        here = index[state]
        for piece in pieces[state.place]:
            for end, final in _ends(state, piece, binding[piece.way.end], places, accel, decel):
                if end.kind == ROLLED and not physics.impulsive:
                    end = State(end.place)
                if end not in index:
                    index[end] = len(index)
                    waiting.append(end)
                tails.append(here)
                heads.append(index[end])
                driven.append(piece)
                speeds.append((state.speed, final))
    states = list(index)
    rest = np.array([states[tail].speed == 0.0 and states[tail].kind != ROLLED for tail in tails], dtype=bool)
    use, peak = cost_of(physics, driven, np.array(speeds).reshape(-1, 2), rest)
    ends = np.array([tails, heads], dtype=np.intp)
    keep = undominated(use, shear, peak, ends[0] * len(states) + ends[1])
    return Road(states, ends[0][keep], ends[1][keep], use[keep], peak[keep], [driven[i] for i in keep.tolist()], index)


def _binding(pieces: dict[str, list[Piece]], places: set[str], decel: float) -> dict[str, set[float]]:
    """Speeds at each place that an edge leaving it can be the reason for: its limit, or having to brake on it."""
    found = {
        place: {piece.limit_m_s for piece in leaving if not piece.instant} | ({0.0} if place in places else set())
        for place, leaving in pieces.items()
    }
    if decel <= 0.0:
        return found
    changed = True
    while changed:
        changed = False
        for place, leaving in pieces.items():
            for piece in leaving:
                if piece.instant:
                    continue
                further = {0.0} if piece.dwell is not None else found[piece.way.end]
                for speed in list(further):
                    before = math.sqrt(speed * speed + 2.0 * decel * piece.distance_m)
                    if before < piece.limit_m_s and before not in found[place] and len(found[place]) < MOST_SPEEDS:
                        found[place].add(before)
                        changed = True
    return found


def _ends(
    state: State, piece: Piece, binding: set[float], places: set[str], accel: float, decel: float
) -> Iterator[tuple[State, float]]:
    """States at the end of a piece that begins in a state, and the speeds there."""
    end = piece.way.end
    if piece.instant:
        yield State(end, 0.0, FREE if piece.dwell is not None else ROLLED), 0.0
        if end in places:
            yield State(end, 0.0, STOPPED), 0.0
        return
    begin, limit, length = state.speed, piece.limit_m_s, piece.distance_m
    if begin > limit:
        return
    top = math.sqrt(begin * begin + 2.0 * accel * length)
    # braking on this piece must be what asks for no more than this speed, where nothing else does
    owed = state.kind == OWED and begin != limit

    def possible(speed: float) -> bool:
        fastest = math.sqrt(speed * speed + 2.0 * decel * length)
        return speed <= top and (begin == fastest if owed else begin <= fastest)

    if possible(0.0):
        if piece.dwell is not None:
            yield State(end), 0.0
        if end in places:
            yield State(end, 0.0, STOPPED), 0.0
    if piece.dwell is not None:
        return
    highest = min(top, limit)
    if possible(highest):
        yield State(end, highest), highest
    for speed in binding:
        if 0.0 < speed < highest and possible(speed):
            yield State(end, speed, OWED), speed


def cost_of(physics: Physics, driven: Sequence[Piece], speeds: Array, rest: Bools) -> tuple[Array, Array]:
    """Time and energies of pieces between speeds, evaluated as arrays.

    `speeds` (shape (n, 2)): at begin and end of each [m/s]; `rest` (shape (n,)): whether the robot stood before. Gives
    seconds and Wh, shape (n, 1 + batteries), and the most Wh drawn at the end of any phase, shape (n, batteries).
    """
    use = np.zeros((len(driven), 1 + len(physics.names)))
    number: dict[Piece, int] = {}
    which = np.array([number.setdefault(piece, len(number)) for piece in driven], dtype=np.intp)
    groups = grouped(number, lambda piece: (len(piece.legs), piece.instant))
    parts: list[tuple[NDArray[Any], ...]] = []
    for (_, instant), members in groups.items():
        place = np.full(len(number), -1)
        place[[number[piece] for piece in members]] = np.arange(len(members))
        rows = np.flatnonzero(place[which] >= 0)
        mine = place[which[rows]]
        distance = np.array([[leg.distance_m for leg in piece.legs] for piece in members])[mine]
        limit = np.array([[leg.speed_m_s for leg in piece.legs] for piece in members])[mine]
        settings = np.array([[physics.settings_index(leg.settings) for leg in piece.legs] for piece in members])[mine]
        if instant:  # only its cruising phase lasts
            made = Phases((distance / limit)[..., None], limit[..., None], np.zeros((*limit.shape, 1)))
        else:
            accel = np.full(len(rows), physics.limits.accel_m_s2)
            decel = np.full(len(rows), physics.limits.decel_m_s2)
            made = ramp_phases(distance, limit, accel, decel, speeds[rows, 0], speeds[rows, 1])
        shape = made.duration_s.shape
        first = np.cumsum(made.duration_s.reshape(len(rows), -1) > 0.0, axis=1).reshape(shape) == 1
        starts = first & (made.duration_s > 0.0) & rest[rows][:, None, None]
        owner = np.broadcast_to(rows[:, None, None], shape)
        kept = made.duration_s > 0.0
        wide = np.broadcast_to(settings[:, :, None], shape)
        parts.append(
            (owner[kept], wide[kept], made.duration_s[kept], made.speed_m_s[kept], made.accel_m_s2[kept], starts[kept])
        )
    standing = [(i, piece.dwell) for i, piece in enumerate(driven) if piece.dwell is not None]
    if standing:
        owner = np.array([i for i, _ in standing])
        settings = np.array([physics.settings_index(leg.settings) for _, leg in standing])
        lasting = np.array([leg.duration_s for _, leg in standing])
        zero = np.zeros(len(standing))
        parts.append((owner, settings, lasting, zero, zero, zero))
    peak = np.zeros((len(driven), len(physics.names)))
    if not parts:
        return use, peak
    owner, settings, duration, speed, rate, starts = (np.concatenate(column) for column in zip(*parts, strict=True))
    np.add.at(use[:, 0], owner, duration)
    energy = physics.energy_wh(settings, duration, speed, rate, starts)
    for b in range(len(physics.names)):
        np.add.at(use[:, 1 + b], owner, energy[:, b])
    if not np.isfinite(use).all():
        bad = driven[int(np.flatnonzero(~np.isfinite(use).all(axis=1))[0])]
        told = f"the power on edge '{bad.name}' from '{bad.way.begin}' is not a number"
        allowed = "every covariate that the robot's effects read, in defaults or on the edge"
        raise InputError.single(told, file=str(physics.task.path), allowed=allowed)
    turn = np.argsort(owner, kind="stable")  # the phases of each piece one after the other
    begins = np.flatnonzero(np.diff(owner[turn], prepend=-1))
    drawn = np.cumsum(energy[turn], axis=0)
    before = np.repeat(drawn[begins] - energy[turn][begins], np.diff(np.append(begins, len(turn))), axis=0)
    peak[owner[turn][begins]] = np.maximum.reduceat(drawn - before, begins, axis=0)
    return use, np.maximum(peak, np.maximum(use[:, 1:], 0.0))


def undominated(use: Array, shear: Array, peak: Array, group: Ints | None = None) -> Ints:
    """Rows that no other of their group is better than: in time, even where it then has to wait, energies and peaks."""
    compared = np.concatenate([use - use[:, :1] * shear, peak], axis=1)
    group = np.zeros(len(use), dtype=np.intp) if group is None else group
    order = np.lexsort((*compared.T[::-1], group))  # whatever is no better in anything comes later
    compared, group = compared[order], group[order]
    worse = np.zeros(len(use), dtype=bool)
    rows, apart = np.arange(1, len(use)), 1
    while (rows := rows[group[rows] == group[rows - apart]]).size:
        worse[rows] |= (compared[rows - apart] <= compared[rows]).all(axis=1)
        apart += 1
        rows = rows[rows >= apart]
    return np.asarray(order[~worse])

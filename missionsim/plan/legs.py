"""What a plan is made of: legs with numbers, the settings that hold on them (and the covariates, components and steady
power that follow from these), and the phases of their motion.

A number is a float, or an array with one number a run where many runs are planned at once. The planner is written for
floats and typed so: arrays take the same arithmetic, and the functions here are all that differs.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from typing import Any, Literal, NamedTuple, Protocol, TypeVar, cast

import numpy as np

from missionsim.effects.covariates import Columns, Labels
from missionsim.effects.model import PowerModel
from missionsim.expressions import Place
from missionsim.inputs.robot import RobotSpec
from missionsim.physics import Array, Bools

T = TypeVar("T")


def least(first: float, second: float) -> float:
    """The smaller of two numbers, run by run."""
    if isinstance(second, float):
        if isinstance(first, float):
            return min(first, second)
        return first if second == math.inf or first.max() <= second else np.minimum(first, second)
    return second if isinstance(first, float) and first == math.inf else np.minimum(first, second)


def remainder(angle: float) -> float:
    """An angle [rad] brought between -π and π, halves to even turns (IEEE 754)."""
    if isinstance(angle, float):
        return math.remainder(angle, 2.0 * math.pi)
    return angle - 2.0 * math.pi * np.round(angle / (2.0 * math.pi))


def sign(number: float) -> float:
    """1 or -1."""
    return math.copysign(1.0, number) if isinstance(number, float) else np.copysign(1.0, number)


def spread(value: T, count: int) -> list[T] | None:
    """What a part of a plan of `count` runs is in each of them; None where it is the same in all."""
    if isinstance(value, np.ndarray):
        return value.tolist() if value.shape == (count,) else None
    if isinstance(value, dict):
        inside = spread(tuple(value.values()), count)
        return None if inside is None else cast("list[T]", [dict(zip(value, values, strict=True)) for values in inside])
    if not isinstance(value, tuple) or isinstance(value, str):
        return None
    columns = [spread(item, count) for item in value]
    if all(column is None for column in columns):
        return None
    rows = zip(*(repeat(v, count) if c is None else c for v, c in zip(value, columns, strict=True)), strict=True)
    make = getattr(value, "_make", None)
    return list(rows if make is None else map(make, rows))


class Odd:
    """Runs whose plan has another shape than that of most: each is to be planned alone.

    A plan of many runs is one list of legs. Where a number decides whether there is a leg at all (a dwell of nought, a
    turn of nought), or whether there is a plan (a speed of nought), the runs that go against the others are marked.
    """

    def __init__(self) -> None:
        self.runs: Bools | None = None

    def most(self, decision: bool | Bools) -> bool:
        """What most runs decide; the others are odd."""
        if not isinstance(decision, np.ndarray):
            return bool(decision)
        answer = bool(2 * np.count_nonzero(decision) >= decision.size)
        self.mark(decision != answer)
        return answer

    def mark(self, runs: Bools) -> None:
        """These are odd."""
        self.runs = runs if self.runs is None else self.runs | runs


Kind = Literal["roll", "turn", "slide", "stand", "dock"]

ROUNDING = 1.0 + 1e-12


class Settings(NamedTuple):
    """What is asked of the robot and what surrounds it on a leg."""

    scheme: str = ""
    navigation: str = ""
    """Both: control scheme and its navigation; empty where none."""
    sensors: tuple[tuple[str, int], ...] = ()
    """Components that must be on and how many units, sorted by name."""
    payload_kg: float = 0.0
    slope_rad: float = 0.0
    """Grade in the direction of travel, uphill positive."""
    surface: str = ""
    extra: tuple[tuple[str, float | str], ...] = ()
    """Further covariates (``temp_ambient_c``, ``cpu_load``, a file's own conditions), sorted by name."""


class Recharge(NamedTuple):
    """Charging at a dock."""

    place: str
    power_w: Mapping[str, float]
    """Stored by each battery that charges, on top of what the robot draws meanwhile: the charger's power, at most the
    battery's greatest charging power, times the battery's charging efficiency."""
    batteries: tuple[str, ...]
    until: float | None = None
    """Fraction of each battery's capacity at which charging is done."""
    duration_s: float | None = None
    """Time at the charger instead; charging stops at full."""
    slots: int = 1
    """Robots that the dock serves at once."""
    if_below: float = math.inf
    """Nothing is charged unless a battery is below this fraction of its capacity."""


class OnEdge(NamedTuple):
    """A part of an edge: its ends in the direction of travel, which edge, and how far along it [m] the part lies."""

    begin: str
    end: str
    edge: int
    from_m: float
    to_m: float


class Gate(NamedTuple):
    """Of a block that is repeated until a time: which block, that time, how long the round takes without charging, and
    whether the round begins with this leg."""

    block: int
    until_s: float
    duration_s: float
    first: bool = False


class Pace(NamedTuple):
    """Speeds [m/s]; limits are infinite where there is none."""

    asked: float = 0.0
    """Speed asked times the part of it that is reached (`speed_tracking`)."""
    robot: float = math.inf
    scheme: float = math.inf
    """Both: greatest speed of the robot and of the control scheme. A nominal `speed_tracking` above 1 says that these
    are exceeded by so much, and raises them."""
    way: float = math.inf
    """Limit of the way, or of the greatest yaw rate on an arc."""

    @property
    def speed(self) -> float:
        """Speed driven."""
        return least(least(self.asked, self.robot), least(self.scheme, self.way))

    @property
    def limited(self) -> bool:
        """Whether more was asked, by a draw, than the robot can do under this scheme."""
        return self.asked > least(self.robot, self.scheme) * ROUNDING


class Leg(NamedTuple):
    """The smallest part of a plan over which nothing but the motion itself changes."""

    kind: Kind
    """``roll`` (straight or arc), ``turn`` on the spot, ``slide`` (sideways), ``stand`` (`duration_s`), ``dock``."""
    settings: Settings
    distance_m: float = 0.0
    speed_m_s: float = 0.0
    """Both: length driven and speed limit, of `roll` and `slide`."""
    curvature_1_m: float = 0.0
    """Yaw rate over speed, left positive."""
    direction_rad: float = 0.0
    """Direction of a `slide` from straight ahead, left positive."""
    angle_rad: float = 0.0
    yaw_rate_rad_s: float = 0.0
    """Both: signed angle and limit of the yaw rate of a `turn`."""
    duration_s: float = 0.0
    instant: bool = False
    """Speeds are reached at once (``profile: constant_speed``)."""
    place: str = ""
    """Place reached, or held, at the end."""
    edge: OnEdge | None = None
    beside: Settings | None = None
    """Both: the part of an edge that is driven, and the settings without its own; None without a map."""
    first: bool = False
    last: bool = False
    """Both: whether a segment begins or ends here."""
    recharge: Recharge | None = None
    pace: Pace = Pace()
    """Where `speed_m_s` comes from."""
    gate: Gate | None = None
    """Of a block that is repeated until a time."""
    segment: int = 0
    """Index of the mission's segment, repeats counted one by one."""

    def same_edge(self, other: Leg) -> bool:
        """Whether another leg is on the same edge in the same segment."""
        on_one = self.edge is not None and other.edge is not None and self.edge[:3] == other.edge[:3]
        return on_one and self.segment == other.segment


class Phase(NamedTuple):
    """Constant acceleration for some time: values at its start, and their rates."""

    duration_s: float
    leg: int
    speed_m_s: float = 0.0
    accel_m_s2: float = 0.0
    lateral_m_s: float = 0.0
    lateral_m_s2: float = 0.0
    yaw_rad_s: float = 0.0
    yaw_rad_s2: float = 0.0
    moving: bool = False


class Step(NamedTuple):
    """Legs that follow each other without a standstill, with their phases; a stay is a step of its own."""

    kind: Kind
    phases: tuple[Phase, ...]


class Trigger(NamedTuple):
    """When an activity begins or ends: at a time, a place, or the begin or end of a named segment."""

    time_s: float | None = None
    place: str = ""
    segment: str = ""


class Activity(NamedTuple):
    """A component that is on beside the driving: from a trigger until another, or in bursts."""

    component: str
    units: int
    begin: Trigger | None = None
    end: Trigger | None = None
    every_s: float | None = None
    duration_s: float | None = None
    key: int = 0
    place: Place = Place()
    """Of its period in the mission file, for messages."""


class SegmentInfo(NamedTuple):
    """A segment as executed: its name (unique), its kind, the line of the mission file that asks for it, and the name
    that all its repetitions share."""

    name: str
    kind: str
    line: int = 0
    label: str = ""


class Limits(NamedTuple):
    """Limits of the body: accelerations in m/s² and rad/s², None where motion is taken as instant."""

    accel_m_s2: float | None = None
    decel_m_s2: float | None = None
    yaw_rate_rad_s: float = 1.0
    yaw_accel_rad_s2: float | None = None


@dataclass(frozen=True)
class Plan:
    """A mission as numbers, in the order of execution.

    A plan of many runs (`missionsim.plan.build.plan_runs`) has an array with one number a run in place of each number
    that is drawn; `each` gives the plans of single runs.
    """

    legs: tuple[Leg, ...]
    steps: tuple[Step, ...]
    """The legs grouped into runs between standstills."""
    segments: tuple[SegmentInfo, ...]
    activities: tuple[Activity, ...]
    limits: Limits
    start: str = ""
    """Place at which the mission starts; empty without an environment."""
    chance: tuple[tuple[str, int], ...] = ()
    """What chance did, by what it is (``obstacles``, ``relocalisations_failed``, ``inspections_repeated``); empty where
    nothing is left to chance or no generator was given."""
    routes: tuple[tuple[str, str, tuple[int, ...]], ...] = ()
    """The routes taken through the environment: begin, end, edges."""
    odd: Bools | None = None
    """Of a plan of many runs, those that this plan is not for. Shape (runs,)."""

    @property
    def gated(self) -> bool:
        """Whether how often a block is repeated shows only when it is driven."""
        return any(leg.gate is not None and leg.gate.until_s < math.inf for leg in self.legs)

    @property
    def limited(self) -> bool:
        """Whether a drawn speed is above what the robot, or its control scheme, can do, so that it was cut to that."""
        return any(leg.pace.limited for leg in self.legs)

    def each(self, count: int) -> list[Plan]:
        """The plan of each of `count` runs."""

        def runs(parts: tuple[Any, ...]) -> Iterable[tuple[Any, ...]]:
            return spread(parts, count) or repeat(parts, count)

        parts = zip(runs(self.legs), runs(self.steps), runs(self.activities), runs(self.limits), strict=True)
        return [
            Plan(legs, steps, self.segments, activities, Limits(*limits), self.start, self.chance, self.routes)
            for legs, steps, activities, limits in parts
        ]


LONG_AGO_S = 1e7
"""After which what fades has faded."""


class Requiring(Protocol):
    """A component as far as it is on by itself or by others."""

    @property
    def units(self) -> int: ...
    @property
    def always_on(self) -> bool: ...
    @property
    def requires(self) -> tuple[str, ...]: ...


def closure(infos: Mapping[str, Requiring], sensors: Sequence[tuple[str, int]]) -> dict[str, int]:
    """Components with everything that they require, one unit of each requirement at least."""
    known: dict[str, int] = {}
    waiting = [(name, units) for name, units in sensors if units > 0]
    while waiting:
        name, units = waiting.pop()
        if known.get(name, 0) >= units:
            continue
        known[name] = units
        waiting.extend((required, 1) for required in infos[name].requires)
    return known


def units_on(infos: Mapping[str, Requiring], sensors: Sequence[tuple[str, int]]) -> list[float]:
    """Units of each component that are on: those asked for, what they require, and what is always on."""
    always = ((name, info.units) for name, info in infos.items() if info.always_on)
    units = closure(infos, (*sensors, *always))
    return [float(units.get(name, 0)) for name in infos]


def table(numbers: Sequence[float | Array]) -> Array:
    """Numbers of intervals, each a float or an array of all runs. Gives an array of shape (intervals, runs), or
    (intervals,) where none of them is an array."""
    if not any(isinstance(number, np.ndarray) for number in numbers):
        return np.array(numbers, dtype=float)
    rows = np.empty((len(numbers), max(np.size(number) for number in numbers)))
    for row, number in zip(rows, numbers, strict=True):
        row[:] = number
    return rows


def covariates_of(settings: Sequence[Settings]) -> Columns:
    """What settings say under glossary names, shape (settings,), or as `table`; not a number where only others say
    it."""
    columns: Columns = {name: table([getattr(s, name) for s in settings]) for name in ("slope_rad", "payload_kg")}
    columns |= {name: Labels.of(getattr(s, name) for s in settings) for name in ("scheme", "navigation", "surface")}
    extras = [dict(s.extra) for s in settings]
    for name in sorted({name for extra in extras for name in extra}):
        given: list[Any] = [extra.get(name, np.nan) for extra in extras]
        text = any(isinstance(value, str) for value in given)
        columns[name] = Labels.of(given) if text else table(given)
    return columns


def steady_power_w(robot: RobotSpec, model: PowerModel, legs: Sequence[Leg]) -> dict[str, Array]:
    """Power of each battery while legs are driven at their speed, shape (legs,), W. Without accelerations, activities
    and what fades with time."""
    zero = np.zeros(len(legs))
    settings = [leg.settings for leg in legs]
    cov: dict[str, Any] = dict.fromkeys(("accel_m_s2", "lateral_speed_m_s", "lateral_accel_m_s2", "starts"), zero)
    cov |= {
        "speed_m_s": np.array([leg.speed_m_s for leg in legs]),
        "yaw_rate_rad_s": np.array([leg.speed_m_s * leg.curvature_1_m for leg in legs]),
        "moving": zero + 1.0,
        "moving_time_s": zero + LONG_AGO_S,
        "time_s": zero + LONG_AGO_S,
        **covariates_of(settings),
    }
    on = np.array([units_on(robot.components, s.sensors) for s in settings]).reshape(len(legs), -1)
    for name, units in zip(robot.components, on.T, strict=True):
        cov[f"on_{name}"] = units
        cov[f"starting_{name}"] = zero
        cov[f"on_time_{name}_s"] = zero + LONG_AGO_S
    powers = model.evaluate(cov)
    return {battery: np.asarray(sum(powers.get(battery, {}).values(), zero)) for battery in robot.batteries}

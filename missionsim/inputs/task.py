"""The task file: what is to be done and what may be chosen, from which `missionsim plan` makes a mission."""

from __future__ import annotations

from typing import Annotated, Any, ClassVar, Literal

from pydantic import BeforeValidator, Discriminator, Field, Tag

from missionsim.errors import Fault
from missionsim.inputs.base import Identifier, Model, Name, Sensors, Text, alone, as_list, wrong
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.mission import Reserve, RobotAtSite, reserve_of
from missionsim.inputs.overrides import ROOTS, route
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.values import Duration, Fraction, Mass, Period, Share, Speed

Weight = Annotated[float, Field(strict=False, ge=0.0, le=1e6)]
Places = Annotated[tuple[Name, ...], BeforeValidator(lambda raw: [raw] if isinstance(raw, (str, int)) else raw)]


class WindowSpec(Model):
    """When what is done at a visit must begin, from the start of the mission."""

    from_: Duration = Field(default=Parameter(0.0, unit="s"), alias="from")
    until: Duration | None = None

    def _check(self) -> None:
        if self.until is not None and self.until.value < self.from_.value:
            got, allowed = f"{self.until.value:g} s", f"{self.from_.value:g} s or more"
            raise wrong("a window that ends before it begins", got, allowed, "until")


class SchemeChoice(Model):
    """A control scheme that may be driven with, with its navigation and sensors."""

    scheme: Identifier
    navigation: Identifier | None = None
    sensors: Sensors | None = None


Choice = Annotated[SchemeChoice, BeforeValidator(alone("scheme", str), json_schema_input_type=str | SchemeChoice)]
Schemes = Annotated[tuple[Choice, ...], BeforeValidator(as_list), Field(min_length=1, max_length=100)]


class VisitSpec(Model):
    """A place to go to, and what is done there: inspect or wait, take up or set down a load."""

    place: Name
    name: Name | None = None
    inspect: Duration | None = None
    wait: Duration | None = None
    scheme: Identifier | None = None
    navigation: Identifier | None = None
    sensors: Sensors | None = None
    schemes: Schemes | None = None
    take_up: Mass | None = None
    set_down: Mass | None = None
    before: Places = ()
    after: Places = ()
    window: WindowSpec | None = None
    value: Weight | None = None

    def _check(self) -> None:
        if self.inspect is not None and self.wait is not None:
            raise wrong("a visit inspects or waits", "both", "inspect: 30 s, or wait: 30 s", "wait")
        own = [key for key in ("scheme", "navigation", "sensors") if getattr(self, key) is not None]
        if self.schemes is not None and own:
            allowed = "scheme for one that is required, schemes for those to choose from"
            raise wrong("a visit's scheme is given or chosen", f"{own[0]} and schemes", allowed, own[0])

    @property
    def label(self) -> str:
        """Name of the visit; its place where it has none of its own."""
        return self.name or self.place

    @property
    def load_kg(self) -> float:
        """What the visit adds to the load; below zero where it takes off."""
        return (self.take_up.value if self.take_up else 0.0) - (self.set_down.value if self.set_down else 0.0)


class SpeedRange(Model):
    """Speeds from one to another, evenly spaced."""

    from_: Speed = Field(alias="from")
    to: Speed
    steps: Annotated[int, Field(strict=True, ge=2, le=100)] = 5

    def _check(self) -> None:
        if self.to.value <= self.from_.value:
            got, allowed = f"{self.to.value:g} m/s", f"above {self.from_.value:g} m/s"
            raise wrong("a range of speeds must rise", got, allowed, "to")


SpeedList = Annotated[tuple[Speed, ...], Field(min_length=1, max_length=100)]
Speeds = Annotated[
    Annotated[SpeedList, Tag("list")] | Annotated[SpeedRange, Tag("range")],
    Discriminator(lambda raw: "range" if isinstance(raw, (dict, SpeedRange)) else "list"),
    BeforeValidator(as_list),
]


def _word_or(*words: str) -> tuple[Any, ...]:
    """One of a few words, or else what they stand in for: a list where one thing is given alone."""
    tag = Discriminator(lambda raw: "word" if isinstance(raw, str) and raw in words else "other")
    return tag, BeforeValidator(lambda raw: raw if raw in words else as_list(raw))


def speeds_of(given: tuple[Parameter, ...] | SpeedRange | None) -> tuple[float, ...] | None:
    """Speeds of a list or a range, rising, m/s; None where none are given."""
    if given is None:
        return None
    if isinstance(given, SpeedRange):
        low, high, last = given.from_.value, given.to.value, given.steps - 1
        return tuple(sorted({round(low + (high - low) * i / last, 12) for i in range(given.steps)}))
    return tuple(sorted({speed.value for speed in given}))


class ChooseSpec(Model):
    """What may be chosen: speeds, control schemes, docks and levels of charge."""

    speeds: Speeds | None = None
    schemes: Schemes | None = None
    docks: Annotated[
        Annotated[Literal["all", "none"], Tag("word")] | Annotated[tuple[Name, ...], Tag("other")],
        *_word_or("all", "none"),
    ] = "none"
    charge: Annotated[
        Annotated[Literal["any"], Tag("word")]
        | Annotated[tuple[Fraction, ...], Field(min_length=1, max_length=50), Tag("other")],
        *_word_or("any"),
    ] = "any"


class EdgeChoice(Model):
    """What differs on one edge: its own schemes or speeds, or that it is closed."""

    speeds: Speeds | None = None
    schemes: Schemes | None = None
    closed: bool = False


class WithinSpec(Model):
    """What the plan must keep to."""

    deadline: Period | None = None
    reserve: Reserve | None = None
    reserve_throughout: bool = False
    max_payload: Mass | None = None
    with_probability: Share | None = None


class LeastSpec(Model):
    """The objective: energy in Wh, each battery with its weight, and time in s with its weight."""

    energy: Annotated[
        Annotated[Weight, Tag("one")] | Annotated[dict[Identifier, Weight], Tag("each")],
        Discriminator(lambda raw: "each" if isinstance(raw, dict) else "one"),
    ] = 0.0
    time: Weight = 0.0

    def _check(self) -> None:
        weights = list(self.energy.values()) if isinstance(self.energy, dict) else [self.energy]
        if not any([*weights, self.time]):
            raise wrong("nothing to make least", "weights of 0", "energy, time, or {energy: 1, time: 0.01}")


def _least(raw: Any) -> Any:
    known = {"energy": {"energy": 1.0}, "time": {"time": 1.0}}
    if isinstance(raw, str) and raw not in known:
        raise wrong("not one of the allowed words", raw, "energy, time, or {energy: 1, time: 0.01}")
    return known[raw] if isinstance(raw, str) else raw


class RepeatSpec(Model):
    """Rounds: a number of them, perhaps one every so often, or as many as can be done until some time."""

    rounds: Annotated[
        Annotated[Literal["as_often_as_possible"], Tag("word")]
        | Annotated[int, Field(strict=True, ge=1, le=1000), Tag("number")],
        Discriminator(lambda raw: "word" if isinstance(raw, str) else "number"),
    ]
    every: Period | None = None
    until: Period | None = None

    def _check(self) -> None:
        if self.rounds == "as_often_as_possible" and self.until is None:
            raise wrong("as often as possible needs an end", "no until", "until: 8 h")


class TaskSpec(RobotAtSite):
    """A task file."""

    kind: Literal["task"]
    environment_ref: Annotated[Text, Field(min_length=1)] = Field(alias="environment")
    start: Name
    end: Name | None = None
    visits: Annotated[tuple[VisitSpec, ...], Field(min_length=1, max_length=200)]
    order: Literal["any", "given"] = "any"
    choose: ChooseSpec = ChooseSpec.model_construct()
    edges: dict[Name, EdgeChoice] = Field(default_factory=dict)
    within: WithinSpec = WithinSpec.model_construct()
    least: Annotated[LeastSpec, BeforeValidator(_least, json_schema_input_type=str | LeastSpec)] = (
        LeastSpec.model_construct(energy=1.0)
    )
    repeat: RepeatSpec | None = None

    environment: ClassVar[EnvironmentSpec]

    def faults(self) -> list[Fault]:
        """What does not go together with the robot and the environment, as far as these could be loaded."""
        from missionsim.inputs.check_task import check_task

        return check_task(self)

    @property
    def elsewhere(self) -> tuple[tuple[str, str], ...]:
        """What the command line set in the files of robot and environment, (path, text): a mission needs it as well."""
        by_file = route(self.overrides)
        return tuple((f"{part}.{path}", text) for part in ROOTS for path, text in by_file[part])

    @property
    def goal(self) -> str:
        """Where the mission ends: `end`, else where it starts."""
        return self.end or self.start

    def choices_of(self, visit: VisitSpec) -> tuple[SchemeChoice | None, ...]:
        """Schemes to choose from for what is done at a visit; None for its own or the default."""
        if visit.schemes is not None:
            return visit.schemes
        own = visit.inspect is None or visit.scheme or visit.navigation or visit.sensors is not None
        return (None,) if own else self._chosen(moving=False)

    @property
    def drives_with(self) -> tuple[SchemeChoice | None, ...]:
        """Schemes to choose from where an edge has none of its own; None for the default."""
        return self._chosen(moving=True)

    def _chosen(self, *, moving: bool) -> tuple[SchemeChoice | None, ...]:
        return tuple(c for c in self.choose.schemes or () if self.robot.schemes[c.scheme].motion == moving) or (None,)

    @property
    def docks(self) -> tuple[str, ...]:
        """Places where the plan may charge."""
        named = self.choose.docks
        if named == "none":
            return ()
        return self.environment.chargers if named == "all" else tuple(named)

    @property
    def most_kg(self) -> float | None:
        """The greatest load: what the robot may carry, and `max_payload` where that is less."""
        given = [limit.value for limit in (self.within.max_payload, self.robot.body.max_payload) if limit is not None]
        return min(given, default=None)

    def reserve_of(self, battery: str) -> float:
        """Fraction of a battery that must be left: of the task, else of the robot file."""
        given = reserve_of(self.within.reserve, battery)
        return self.robot.batteries[battery].reserve.value if given is None else given.value

    def weights(self) -> tuple[dict[str, float], float]:
        """Weight of each battery's energy [1/Wh] and of time [1/s] in the objective."""
        energy = self.least.energy
        if isinstance(energy, dict):
            return {name: energy.get(name, 0.0) for name in self.robot.batteries}, self.least.time
        return dict.fromkeys(self.robot.batteries, energy), self.least.time

"""The mission file, and the study file: alternatives of a mission as differences to a baseline."""

import functools
from collections.abc import Callable
from typing import Annotated, Any, ClassVar, Literal, TypeVar, cast, overload

from pydantic import BeforeValidator, Discriminator, Field, JsonValue, Tag

from missionsim.errors import Fault
from missionsim.inputs.base import Count, DescribedFile, FileModel, Identifier, Model, Name, Text, alone, wrong
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import BehaviourSpec, RobotSpec
from missionsim.inputs.segments import DefaultSpec, Segment, SegmentSpec
from missionsim.inputs.values import Angle, Duration, Fraction, Period


class AnchorSpec(Model):
    """A moment of the mission: reaching a place, a time from the start, or a segment.

    A segment means its start in `from` and its end in `until`.
    """

    place: Name | None = None
    time: Duration | None = None
    segment: Name | None = None

    def _check(self) -> None:
        if sum(item is not None for item in (self.place, self.time, self.segment)) != 1:
            raise wrong("a moment is one of place, time, segment", "none or several", "{place: V1}")


Anchor = Annotated[AnchorSpec, BeforeValidator(alone("place", str, int), json_schema_input_type=str | AnchorSpec)]


class ActivitySpec(Model):
    """A component that is on while the robot goes on driving: once from a moment until another, or in bursts."""

    name: Name | None = None
    component: Identifier
    units: Annotated[Count, Field(ge=1)] = 1
    from_: Anchor | None = Field(default=None, alias="from")
    until: Anchor | None = None
    every: Period | None = None
    duration: Period | None = None

    def _check(self) -> None:
        if self.every is not None and self.duration is None:
            raise wrong("bursts need a duration", "every without duration", "every: 60 s, duration: 2 s")
        if self.duration is not None and self.until is not None and self.every is None:
            raise wrong("duration and until together", "both", "one of them", "until")
        if self.every is not None and self.duration is not None and self.duration.value > self.every.value:
            got, allowed = f"{self.duration.value:g} s", f"at most {self.every.value:g} s"
            raise wrong("bursts longer than their period", got, allowed, "duration")


_PARTS = {"value", "low", "distribution"}
Reserve = Annotated[
    Annotated[Fraction, Tag("one")] | Annotated[dict[Identifier, Fraction], Tag("each")],
    Discriminator(lambda raw: "each" if isinstance(raw, dict) and not _PARTS & raw.keys() else "one"),
]
"""A fraction of all batteries, or one for each by name."""


def reserve_of(given: Parameter | dict[str, Parameter] | None, battery: str) -> Parameter | None:
    """The reserve asked for of a battery; None where nothing is said of it."""
    return given.get(battery) if isinstance(given, dict) else given


class PolicySpec(Model):
    """What to do when a battery reaches its reserve."""

    on_empty: Literal["stop", "return_to_dock", "recharge_and_continue"] = "stop"
    reserve: Reserve | None = None
    dock: Name | None = None
    recharge_until: Fraction | None = None

    def _check(self) -> None:
        if self.on_empty == "return_to_dock" and self.dock is None:
            raise wrong("return_to_dock needs a dock", "no dock", "dock: <place with a charger>")
        if self.recharge_until is not None and self.on_empty != "recharge_and_continue":
            allowed = "on_empty: recharge_and_continue"
            raise wrong("recharge_until has no effect", f"on_empty: {self.on_empty}", allowed, "recharge_until")


T = TypeVar("T")


class MissionBehaviour(BehaviourSpec):
    """Behaviour of the whole mission, and per control scheme."""

    schemes: dict[Identifier, BehaviourSpec] = Field(default_factory=dict)


class CorrelationSpec(Model):
    """Correlation of two uncertain values, named by their paths: ``robot.…``, ``environment.…``, the mission's own."""

    between: tuple[Text, Text]
    rho: Annotated[float, Field(strict=False, gt=-1.0, lt=1.0)]


class RobotAtSite(DescribedFile):
    """What a mission and a task begin with; `robot` and `environment` are the loaded ones."""

    robot_ref: Annotated[Text, Field(min_length=1)] = Field(alias="robot")
    environment_ref: Annotated[Text, Field(min_length=1)] | None = Field(default=None, alias="environment")
    start: Name | None = None
    start_heading: Angle | None = None
    initial_charge: dict[Identifier, Fraction] = Field(default_factory=dict)
    defaults: DefaultSpec = DefaultSpec.model_construct()

    robot: ClassVar[RobotSpec]
    """The robot, loaded."""
    environment: ClassVar[EnvironmentSpec | None]
    """The environment, loaded, or None."""
    overrides: ClassVar[tuple[tuple[str, str], ...]] = ()
    """What the command line set: (path, text)."""


class MissionSpec(RobotAtSite):
    """A mission file."""

    kind: Literal["mission"]
    policy: PolicySpec = PolicySpec.model_construct()
    segments: Annotated[tuple[Segment, ...], Field(min_length=1)]
    activities: tuple[ActivitySpec, ...] = ()
    behaviour: MissionBehaviour = MissionBehaviour.model_construct()
    correlations: tuple[CorrelationSpec, ...] = ()

    def faults(self) -> list[Fault]:
        """What does not go together with the robot and the environment, as far as these could be loaded."""
        from missionsim.inputs.check_mission import check_mission

        return check_mission(self)

    @overload
    def setting(self, segment: object, key: Literal["speed", "yaw_rate", "payload"]) -> Parameter | None: ...

    @overload
    def setting(self, segment: object, key: Literal["surface", "profile"]) -> str | None: ...

    def setting(self, segment: object, key: str) -> object:
        """A setting of a segment, else of `defaults`, else None (``speed``, ``scheme``, ``payload``…)."""
        own = getattr(segment, key, None)
        return own if own is not None else getattr(self.defaults, key, None)

    @functools.cached_property
    def _remembered(self) -> dict[Any, Any]:
        return {}

    def remembered(self, what: object, make: Callable[[], T]) -> T:
        """What follows from this mission and its robot alone, made once: a mission is often run again."""
        of, found = self._remembered.get(what, (None, None))
        if of is not self.robot:
            found = make()
            self._remembered[what] = self.robot, found
        return cast(T, found)

    def equipment(self, segment: SegmentSpec) -> tuple[str, str, tuple[tuple[str, int], ...]]:
        """Control scheme, navigation (empty where none) and sensors of a segment; remembered for the next run."""

        def make() -> tuple[SegmentSpec, tuple[str, str, tuple[tuple[str, int], ...]]]:
            sensors = tuple(sorted(self.sensors_of(segment).items()))
            # with the segment, which lives on with it: another one must not come to have its id
            return segment, (self.scheme_of(segment) or "", self.navigation_of(segment) or "", sensors)

        return self.remembered(id(segment), make)[1]

    def scheme_of(self, segment: SegmentSpec) -> str | None:
        """Control scheme of a segment: its own; for an inspection the robot's image-analysis scheme; the default's for
        segments that move; else (waiting, docking) the robot's `idle_scheme`."""
        if segment.scheme is not None:
            return segment.scheme
        if segment.kind == "inspect":
            default = self.defaults.scheme
            if default is not None and default in self.robot.schemes and self.robot.schemes[default].image_analysis:
                return default
            return next((name for name, scheme in self.robot.schemes.items() if scheme.image_analysis), default)
        if segment.kind in ("wait", "dock"):
            return self.robot.idle_scheme
        return self.defaults.scheme

    def navigation_of(self, segment: SegmentSpec) -> str | None:
        """Navigation of a segment, where its scheme has one."""
        spec = self.robot.schemes.get(self.scheme_of(segment) or "")
        if spec is None:
            return segment.navigation
        asked = (segment.navigation, self.defaults.navigation, spec.default_navigation)
        return next((name for name in asked if name is not None and name in spec.navigation), None)

    def sensors_of(self, segment: SegmentSpec) -> dict[str, int]:
        """Units on during a segment: those asked for (segment, else the defaults as far as the scheme allows them, else
        the scheme's own defaults), and always those that the scheme requires."""
        spec = self.robot.schemes.get(self.scheme_of(segment) or "")
        asked = None if segment.kind in ("wait", "dock") else self.defaults.sensors
        chosen = dict((asked if segment.sensors is None else segment.sensors) or {})
        if spec is not None:
            required, allowed = spec.sensor_rules(self.navigation_of(segment))
            if segment.sensors is None and asked is not None:
                chosen = {name: min(count, allowed.get(name, 0)) for name, count in asked.items()}
            elif segment.sensors is None:
                chosen = dict(spec.default_sensors)
            chosen |= {name: max(count, chosen.get(name, 0)) for name, count in required.items()}
        return {name: count for name, count in chosen.items() if count}


class AlternativeSpec(Model):
    """One alternative of a study: what it sets differently from the baseline."""

    title: Text = ""
    robot: Text | None = None
    set: dict[Text, JsonValue] = Field(default_factory=dict)


class StudySpec(FileModel):
    """A what-if study: a mission, a baseline, named alternatives as differences to it."""

    kind: Literal["study"]
    name: Name
    title: Text = ""
    notes: Text = ""
    mission: Text
    robot: Text | None = None
    baseline: dict[Text, JsonValue] = Field(default_factory=dict)
    alternatives: dict[Name, AlternativeSpec] = Field(default_factory=dict)
    vary: dict[Text, Annotated[tuple[JsonValue, ...], Field(min_length=1)]] = Field(default_factory=dict)

    def _check(self) -> None:
        if "baseline" in self.alternatives:
            raise wrong(
                "'baseline' is what alternatives differ from", "baseline", "another name", "alternatives", "baseline"
            )
        if not self.alternatives and not self.vary:
            allowed = "alternatives: {slow: {set: {defaults.speed: 0.3 m/s}}}"
            raise wrong("a study needs alternatives or vary", "neither", allowed)

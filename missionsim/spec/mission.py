"""The mission file: robot, environment, segments, activities that overlap with them; and the study file."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field, GetJsonSchemaHandler, JsonValue, PrivateAttr, WrapValidator, model_validator
from pydantic_core import PydanticCustomError, core_schema

from missionsim.errors import did_you_mean
from missionsim.spec.base import FileModel, Identifier, Model, Name, Text
from missionsim.spec.environment import EnvironmentSpec
from missionsim.spec.robot import BehaviourSpec, Count, RobotSpec, Sensors, _wrong
from missionsim.spec.values import (
    Angle,
    Condition,
    Distance,
    Duration,
    Fraction,
    Frequency,
    Length,
    Mass,
    Period,
    Slope,
    Speed,
    Temperature,
    YawRate,
)

Profile = Literal["trapezoidal", "constant_speed"]


class Settings(Model):
    """What a segment may set and `defaults` may set for all segments."""

    speed: Speed | None = None
    yaw_rate: YawRate | None = None
    scheme: Identifier | None = None
    navigation: Identifier | None = None
    sensors: Sensors | None = None
    payload: Mass | None = None
    profile: Profile | None = None
    surface: Name | None = None
    temperature: Temperature | None = None
    cpu_load: Fraction | None = None
    cpu_frequency: Frequency | None = None
    access_point_distance: Length | None = None
    conditions: dict[Identifier, Condition] = Field(default_factory=dict)
    behaviour: BehaviourSpec | None = None


class DefaultSpec(Settings):
    """Settings of all segments that do not say otherwise."""

    turn_at_places: bool = False


class SegmentSpec(Settings):
    """Common part of the segments."""

    name: Name | None = None


class DriveSegment(SegmentSpec):
    """Drive to a place (`to`, perhaps `via`), `along` a path of places, or a `distance` without an environment."""

    kind: Literal["drive"]
    to: Name | None = None
    via: tuple[Name, ...] = ()
    along: tuple[Name, ...] | None = Field(default=None, min_length=1)
    distance: Distance | None = None
    slope: Slope | None = None
    heading: Angle | None = None

    @model_validator(mode="after")
    def _one(self) -> DriveSegment:
        given = [key for key in ("to", "along", "distance") if getattr(self, key) is not None]
        if len(given) != 1:
            raise _wrong("a drive needs one of to, along, distance", " and ".join(given) or "none of them", "to: V1")
        for key in ("slope", "heading"):
            if getattr(self, key) is not None and self.distance is None:
                raise _wrong(
                    f"{key} belongs to a drive by distance", given[0], "the slope of the environment's edge", key
                )
        if self.via and self.to is None:
            raise _wrong("via belongs to a drive with to", given[0], "to: V1, via: [A]", "via")
        return self


class ArcSegment(SegmentSpec):
    """Drive along a part of a circle; positive angles turn left."""

    kind: Literal["arc"]
    radius: Distance
    angle: Angle
    slope: Slope | None = None


class TurnSegment(SegmentSpec):
    """Turn on the spot; positive angles turn left."""

    kind: Literal["turn"]
    angle: Angle


class MoveSegment(SegmentSpec):
    """Move in a direction without turning (mecanum and omni drives); 0 is forward, 90 deg left."""

    kind: Literal["move"]
    distance: Distance
    direction: Angle
    slope: Slope | None = None


class InspectSegment(SegmentSpec):
    """Stand and analyse images; with `repeat_probability` the inspection is done again with that probability."""

    kind: Literal["inspect"]
    duration: Duration
    repeat_probability: Annotated[Fraction, Field()] | None = None


class WaitSegment(SegmentSpec):
    """Stand still."""

    kind: Literal["wait"]
    duration: Duration


class RechargeSpec(Model):
    """Charge until a state of charge, or for a time; all batteries of the charger unless named."""

    until: Fraction | None = None
    duration: Duration | None = None
    batteries: tuple[Identifier, ...] = ()

    @model_validator(mode="after")
    def _one(self) -> RechargeSpec:
        if (self.until is None) == (self.duration is None):
            raise _wrong(
                "recharge until a charge or for a duration", "both" if self.until else "neither", "until: 95 %"
            )
        return self


class DockSegment(SegmentSpec):
    """Recharge at the charger of the place where the robot is."""

    kind: Literal["dock"]
    recharge: RechargeSpec


class RepeatSegment(Model):
    """A block of segments, several times."""

    kind: Literal["repeat"]
    name: Name | None = None
    times: Annotated[int, Field(strict=True, ge=1, le=100_000)]
    segments: Annotated[tuple[Segment, ...], Field(min_length=1)]


_KINDS = ("drive", "arc", "turn", "move", "inspect", "wait", "dock", "repeat")


def _unwrap(raw: Any, handler: Any) -> Any:
    """``{drive: {...}}`` to ``{kind: drive, ...}``."""
    if not isinstance(raw, dict):
        if isinstance(raw, Model):
            return raw
        raise _segment_fault("a segment is a mapping with its kind", _shown(raw), "")
    keys = list(raw)
    if len(keys) != 1 or keys[0] not in _KINDS:
        unknown = [key for key in keys if key not in _KINDS]
        hint = did_you_mean(str(unknown[0]), _KINDS) if unknown else ""
        if len(keys) == 1:
            raise _segment_fault(f"unknown kind of segment '{keys[0]}'", str(keys[0]), hint, keys[0])
        raise _segment_fault("a segment has one key, its kind", ", ".join(map(str, keys[:6])) or "no key", hint)
    kind = keys[0]
    body = raw[kind]
    if not isinstance(body, dict):
        raise _segment_fault(f"a {kind} segment is a mapping", _shown(body), "", kind)
    if "kind" in body:
        raise _segment_fault("unknown key 'kind'", "kind", "", kind, "kind")
    return handler({"kind": kind, **body})


def _segment_fault(message: str, got: str, hint: str, *at: str) -> PydanticCustomError:
    entry = {"message": message, "got": got, "allowed": "one of " + ", ".join(_KINDS), "hint": hint, "at": at}
    return PydanticCustomError("quantity", "{text}", {"text": message, "entries": [entry]})


def _shown(raw: Any) -> str:
    from missionsim.spec.tree import as_written

    return as_written(raw)


class _SegmentSchema:
    """JSON Schema of the written form: one key, the kind."""

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        inner = handler(schema)
        options = []
        for kind, reference in inner["discriminator"]["mapping"].items():
            options.append(
                {
                    "type": "object",
                    "additionalProperties": False,
                    "required": [kind],
                    "properties": {kind: {"$ref": reference}},
                }
            )
        return {"oneOf": options}


Segment = Annotated[
    Annotated[
        DriveSegment
        | ArcSegment
        | TurnSegment
        | MoveSegment
        | InspectSegment
        | WaitSegment
        | DockSegment
        | RepeatSegment,
        Field(discriminator="kind"),
    ],
    WrapValidator(_unwrap),
    _SegmentSchema(),
]
RepeatSegment.model_rebuild()


class AnchorSpec(Model):
    """A moment of the mission: reaching a place, a time from the start, or a segment (start of it in `from`, end in `until`)."""

    place: Name | None = None
    time: Duration | None = None
    segment: Name | None = None

    @model_validator(mode="after")
    def _one(self) -> AnchorSpec:
        if sum(item is not None for item in (self.place, self.time, self.segment)) != 1:
            raise _wrong("a moment is one of place, time, segment", "none or several", "{place: V1}")
        return self


def _place_anchor(raw: Any, handler: Any) -> Any:
    return handler({"place": raw} if isinstance(raw, (str, int)) and not isinstance(raw, bool) else raw)


Anchor = Annotated[AnchorSpec, WrapValidator(_place_anchor, json_schema_input_type=str | AnchorSpec)]


class ActivitySpec(Model):
    """A component that is on while the robot goes on driving: once from a moment until another, or in bursts."""

    name: Name | None = None
    component: Identifier
    units: Annotated[Count, Field(ge=1)] = 1
    from_: Anchor | None = Field(default=None, alias="from")
    until: Anchor | None = None
    every: Period | None = None
    duration: Period | None = None

    @model_validator(mode="after")
    def _bursts(self) -> ActivitySpec:
        if self.every is not None and self.duration is None:
            raise _wrong("bursts need a duration", "every without duration", "every: 60 s, duration: 2 s")
        if self.duration is not None and self.until is not None and self.every is None:
            raise _wrong("duration and until together", "both", "one of them", "until")
        if self.every is not None and self.duration is not None and self.duration.value > self.every.value:
            raise _wrong(
                "bursts longer than their period",
                f"{self.duration.value:g} s",
                f"at most {self.every.value:g} s",
                "duration",
            )
        return self


class PolicySpec(Model):
    """What to do when a battery reaches its reserve."""

    on_empty: Literal["stop", "return_to_dock"] = "stop"
    reserve: Fraction | None = None
    dock: Name | None = None

    @model_validator(mode="after")
    def _dock(self) -> PolicySpec:
        if self.on_empty == "return_to_dock" and self.dock is None:
            raise _wrong("return_to_dock needs a dock", "no dock", "dock: <place with a charger>")
        return self


class MissionBehaviour(BehaviourSpec):
    """Behaviour of the whole mission, and per control scheme."""

    schemes: dict[Identifier, BehaviourSpec] = Field(default_factory=dict)


class CorrelationSpec(Model):
    """Correlation of two uncertain values, named by their paths (``robot.…``, ``environment.…`` or the mission's own)."""

    between: tuple[Text, Text]
    rho: Annotated[float, Field(strict=False, gt=-1.0, lt=1.0)]


class MissionSpec(FileModel):
    """A mission file; `robot` and `environment` are the loaded ones."""

    kind: Literal["mission"]
    name: Name
    title: Text = ""
    notes: Text = ""
    sources: dict[Identifier, Text] = Field(default_factory=dict)
    robot_ref: Annotated[Text, Field(min_length=1)] = Field(alias="robot")
    environment_ref: Annotated[Text, Field(min_length=1)] | None = Field(default=None, alias="environment")
    start: Name | None = None
    start_heading: Angle | None = None
    initial_charge: dict[Identifier, Fraction] = Field(default_factory=dict)
    defaults: DefaultSpec = DefaultSpec()
    policy: PolicySpec = PolicySpec()
    segments: Annotated[tuple[Segment, ...], Field(min_length=1)]
    activities: tuple[ActivitySpec, ...] = ()
    behaviour: MissionBehaviour = MissionBehaviour()
    correlations: tuple[CorrelationSpec, ...] = ()

    _robot: Any = PrivateAttr(default=None)
    _environment: Any = PrivateAttr(default=None)
    _overrides: tuple[tuple[str, str], ...] = PrivateAttr(default=())

    @property
    def robot(self) -> RobotSpec:
        """The robot, loaded."""
        robot: RobotSpec = self._robot
        return robot

    @property
    def environment(self) -> EnvironmentSpec | None:
        """The environment, loaded, or None."""
        environment: EnvironmentSpec | None = self._environment
        return environment

    @property
    def overrides(self) -> tuple[tuple[str, str], ...]:
        """What the command line set: (path, text)."""
        return self._overrides

    def setting(self, segment: Any, key: str) -> Any:
        """A setting of a segment, else of `defaults`, else None (``speed``, ``scheme``, ``payload``…)."""
        own = getattr(segment, key, None)
        return own if own is not None else getattr(self.defaults, key, None)

    def scheme_of(self, segment: Any) -> str | None:
        """Control scheme of a segment: its own; for an inspection the robot's image-analysis scheme; the default's for
        segments that move; else (waiting, docking) the robot's `idle_scheme`."""
        own: str | None = segment.scheme
        if own is not None:
            return own
        if segment.kind == "inspect":
            default = self.defaults.scheme
            if default is not None and default in self.robot.schemes and self.robot.schemes[default].image_analysis:
                return default
            return next((name for name, scheme in self.robot.schemes.items() if scheme.image_analysis), default)
        if segment.kind in ("wait", "dock"):
            return self.robot.idle_scheme
        return self.defaults.scheme

    def navigation_of(self, segment: Any) -> str | None:
        """Navigation of a segment, where its scheme has one."""
        scheme = self.scheme_of(segment)
        if scheme is None or scheme not in self.robot.schemes:
            return segment.navigation if segment.navigation is not None else None
        spec = self.robot.schemes[scheme]
        for name in (segment.navigation, self.defaults.navigation, spec.default_navigation):
            if name is not None and name in spec.navigation:
                return str(name)
        return None

    def sensors_of(self, segment: Any) -> dict[str, int]:
        """Units on during a segment: those asked for (segment, else the defaults as far as the scheme allows them, else
        the scheme's own defaults), and always those that the scheme requires."""
        scheme = self.scheme_of(segment)
        spec = self.robot.schemes.get(scheme) if scheme is not None else None
        if spec is None:
            if segment.sensors is not None:
                chosen = segment.sensors
            else:
                chosen = {} if segment.kind in ("wait", "dock") else (self.defaults.sensors or {})
            return {name: count for name, count in chosen.items() if count}
        required, allowed = spec.sensor_rules(self.navigation_of(segment))
        if segment.sensors is not None:
            chosen = dict(segment.sensors)
        elif self.defaults.sensors is not None and segment.kind not in ("wait", "dock"):
            chosen = {name: min(count, allowed.get(name, 0)) for name, count in self.defaults.sensors.items()}
        else:
            chosen = dict(spec.default_sensors)
        for name, count in required.items():
            chosen[name] = max(count, chosen.get(name, 0))
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

    @model_validator(mode="after")
    def _some(self) -> StudySpec:
        if not self.alternatives and not self.vary:
            raise _wrong(
                "a study needs alternatives or vary",
                "neither",
                "alternatives: {slow: {set: {defaults.speed: 0.3 m/s}}}",
            )
        return self

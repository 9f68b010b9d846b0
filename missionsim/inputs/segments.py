"""Segments of a mission, and the settings that they share with `defaults`."""

from collections.abc import Iterable, Iterator
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field, GetJsonSchemaHandler, WrapValidator
from pydantic_core import core_schema

from missionsim.errors import did_you_mean
from missionsim.inputs import values
from missionsim.inputs.base import Identifier, Model, Name, Sensors, either, wrong
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.robot import BehaviourSpec
from missionsim.inputs.tree import as_written

MOST_SEGMENTS = 1_000_000
Profile = Literal["trapezoidal", "constant_speed"]


class Settings(Model):
    """What a segment may set and `defaults` may set for all segments."""

    speed: values.Speed | None = None
    yaw_rate: values.YawRate | None = None
    scheme: Identifier | None = None
    navigation: Identifier | None = None
    sensors: Sensors | None = None
    payload: values.Mass | None = None
    profile: Profile | None = None
    surface: Name | None = None
    temperature: values.Temperature | None = None
    cpu_load: values.Fraction | None = None
    cpu_frequency: values.Frequency | None = None
    access_point_distance: values.Length | None = None
    conditions: dict[Identifier, values.Condition] = Field(default_factory=dict)
    behaviour: BehaviourSpec | None = None


class DefaultSpec(Settings):
    """Settings of all segments that do not say otherwise, and what the way of a drive `to` a place is least in."""

    turn_at_places: bool = False
    route: Literal["length", "time", "energy"] = "length"


class SegmentSpec(Settings):
    """Common part of the segments."""

    kind: str
    name: Name | None = None


class DriveSegment(SegmentSpec):
    """Drive to a place (`to`, perhaps `via`), `along` a path of places, or a `distance` without an environment."""

    kind: Literal["drive"]
    to: Name | None = None
    via: tuple[Name, ...] = ()
    along: tuple[Name, ...] | None = Field(default=None, min_length=1)
    distance: values.Distance | None = None
    slope: values.Slope | None = None
    heading: values.Angle | None = None

    def _check(self) -> None:
        given = [key for key in ("to", "along", "distance") if getattr(self, key) is not None]
        if len(given) != 1:
            raise wrong("a drive needs one of to, along, distance", " and ".join(given) or "none of them", "to: V1")
        for key in ("slope", "heading"):
            if getattr(self, key) is not None and self.distance is None:
                message, allowed = f"{key} belongs to a drive by distance", "the slope of the environment's edge"
                raise wrong(message, given[0], allowed, key)
        if self.via and self.to is None:
            raise wrong("via belongs to a drive with to", given[0], "to: V1, via: [A]", "via")


class ArcSegment(SegmentSpec):
    """Drive along a part of a circle; positive angles turn left."""

    kind: Literal["arc"]
    radius: values.Distance
    angle: values.Angle
    slope: values.Slope | None = None


class TurnSegment(SegmentSpec):
    """Turn on the spot; positive angles turn left."""

    kind: Literal["turn"]
    angle: values.Angle


class MoveSegment(SegmentSpec):
    """Move in a direction without turning (mecanum and omni drives); 0 is forward, 90 deg left."""

    kind: Literal["move"]
    distance: values.Distance
    direction: values.Angle
    slope: values.Slope | None = None


def fastest(direction_rad: float, forward_m_s: float, sideways_m_s: float) -> float:
    """Greatest speed in a direction: its parts ahead and sideways each have their limit; one number or one a run."""
    ahead, aside = (np.maximum(np.abs(part(direction_rad)), 1e-12) for part in (np.cos, np.sin))
    within = np.minimum(forward_m_s / ahead, sideways_m_s / aside)
    most: float = np.minimum(within, np.maximum(forward_m_s, sideways_m_s))
    return most


class InspectSegment(SegmentSpec):
    """Stand and analyse images.

    With `repeat_probability` each run of a Monte Carlo does the inspection again with that probability, until it
    succeeds; a single run does it once.
    """

    kind: Literal["inspect"]
    duration: values.Duration
    repeat_probability: Annotated[values.Chance, Field()] | None = None


class WaitSegment(SegmentSpec):
    """Stand still."""

    kind: Literal["wait"]
    duration: values.Duration


class RechargeSpec(Model):
    """Charge until a state of charge, or for a time; all batteries of the charger unless named."""

    until: values.Fraction | None = None
    duration: values.Duration | None = None
    batteries: tuple[Identifier, ...] = ()

    _one = either("until", "duration", "recharge until a charge or for a duration", "until: 95 %")


class DockSegment(SegmentSpec):
    """Recharge at the charger of the place where the robot is; perhaps only if a battery is below a level."""

    kind: Literal["dock"]
    recharge: RechargeSpec = RechargeSpec.model_construct(until=Parameter(1.0), batteries=())
    if_below: values.Fraction | None = None

    def _check(self) -> None:
        until = self.recharge.until
        if self.if_below is not None and until is not None and self.if_below.value > until.value:
            allowed = f"at most {100 * until.value:g} %"
            got = f"{100 * self.if_below.value:g} %"
            raise wrong("charges to less than what it asks for", got, allowed, "if_below")


class RepeatSegment(Model):
    """A block of segments, several times; or until a time of the mission, as often as it ends by then."""

    kind: Literal["repeat"]
    name: Name | None = None
    times: Annotated[int, Field(strict=True, ge=1, le=100_000)] | None = None
    until: values.Period | None = None
    segments: Annotated[tuple["Segment", ...], Field(min_length=1)]

    _one = either("times", "until", "repeat some times or until a time", "times: 5, or until: 8 h")

    @property
    def least(self) -> int:
        """How often at least, as far as the file tells."""
        return self.times or 1


SEGMENT_KINDS = ("drive", "arc", "turn", "move", "inspect", "wait", "dock", "repeat")


def _unwrap(raw: Any, handler: Any) -> Any:
    """``{drive: {...}}`` to ``{kind: drive, ...}``."""
    if isinstance(raw, Model):
        return raw
    allowed = "one of " + ", ".join(SEGMENT_KINDS)
    if not isinstance(raw, dict):
        raise wrong("a segment is a mapping with its kind", as_written(raw), allowed)
    keys = list(raw)
    unknown = [key for key in keys if key not in SEGMENT_KINDS]
    hint = did_you_mean(str(unknown[0]), SEGMENT_KINDS) if unknown else ""
    if len(keys) != 1:
        got = ", ".join(map(str, keys[:6])) or "no key"
        raise wrong("a segment has one key, its kind", got, allowed, hint=hint)
    kind, body = keys[0], raw[keys[0]]
    if unknown:
        raise wrong(f"unknown kind of segment '{kind}'", str(kind), allowed, kind, hint=hint)
    if not isinstance(body, dict):
        raise wrong(f"a {kind} segment is a mapping", as_written(body), allowed, kind)
    if "kind" in body:
        raise wrong("unknown key 'kind'", "kind", allowed, kind, "kind")
    return handler({"kind": kind, **body})


class _SegmentSchema:
    """JSON Schema of the written form: one key, the kind."""

    def __get_pydantic_json_schema__(
        self, schema: core_schema.CoreSchema, handler: GetJsonSchemaHandler
    ) -> dict[str, Any]:
        inner = handler(schema)
        only = {"type": "object", "additionalProperties": False}
        kinds = inner["discriminator"]["mapping"].items()
        return {"oneOf": [{**only, "required": [kind], "properties": {kind: {"$ref": ref}}} for kind, ref in kinds]}


_Moves = DriveSegment | ArcSegment | TurnSegment | MoveSegment
_Rests = InspectSegment | WaitSegment | DockSegment
Segment = Annotated[
    Annotated[_Moves | _Rests | RepeatSegment, Field(discriminator="kind")], WrapValidator(_unwrap), _SegmentSchema()
]


def every_segment(segments: Iterable[SegmentSpec | RepeatSegment]) -> Iterator[SegmentSpec | RepeatSegment]:
    """Segments and blocks, also those inside blocks, each once."""
    for segment in segments:
        yield segment
        if isinstance(segment, RepeatSegment):
            yield from every_segment(segment.segments)


def flat_segments(segments: Iterable[SegmentSpec | RepeatSegment]) -> Iterator[SegmentSpec]:
    """Segments that are no repeats, each once."""
    return (segment for segment in every_segment(segments) if not isinstance(segment, RepeatSegment))

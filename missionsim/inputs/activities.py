"""Activities that overlap with driving, and the policy for a battery that runs out."""

from typing import Annotated, Any, Literal

from pydantic import Discriminator, Field, Tag, WrapValidator, model_validator

from missionsim.inputs.base import Count, Identifier, Model, Name, wrong
from missionsim.inputs.values import Duration, Fraction, Parameter, Period


class AnchorSpec(Model):
    """A moment of the mission: reaching a place, a time from the start, or a segment.

    A segment means its start in `from` and its end in `until`.
    """

    place: Name | None = None
    time: Duration | None = None
    segment: Name | None = None

    @model_validator(mode="after")
    def _one(self) -> "AnchorSpec":
        if sum(item is not None for item in (self.place, self.time, self.segment)) != 1:
            raise wrong("a moment is one of place, time, segment", "none or several", "{place: V1}")
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
    def _bursts(self) -> "ActivitySpec":
        if self.every is not None and self.duration is None:
            raise wrong("bursts need a duration", "every without duration", "every: 60 s, duration: 2 s")
        if self.duration is not None and self.until is not None and self.every is None:
            raise wrong("duration and until together", "both", "one of them", "until")
        if self.every is not None and self.duration is not None and self.duration.value > self.every.value:
            raise wrong(
                "bursts longer than their period",
                f"{self.duration.value:g} s",
                f"at most {self.every.value:g} s",
                "duration",
            )
        return self


def _one_or_each(raw: Any) -> str:
    return "each" if isinstance(raw, dict) and not {"value", "low", "distribution"} & raw.keys() else "one"


Reserve = Annotated[
    Annotated[Fraction, Tag("one")] | Annotated[dict[Identifier, Fraction], Tag("each")], Discriminator(_one_or_each)
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

    @model_validator(mode="after")
    def _dock(self) -> "PolicySpec":
        if self.on_empty == "return_to_dock" and self.dock is None:
            raise wrong("return_to_dock needs a dock", "no dock", "dock: <place with a charger>")
        if self.recharge_until is not None and self.on_empty != "recharge_and_continue":
            allowed = "on_empty: recharge_and_continue"
            raise wrong("recharge_until has no effect", f"on_empty: {self.on_empty}", allowed, "recharge_until")
        return self

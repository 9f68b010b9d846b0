"""The study file: alternatives of a mission as differences to a baseline."""

from typing import Annotated, Literal

from pydantic import Field, JsonValue, model_validator

from missionsim.inputs.base import FileModel, Model, Name, Text
from missionsim.inputs.names import wrong


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
    def _some(self) -> "StudySpec":
        if not self.alternatives and not self.vary:
            raise wrong(
                "a study needs alternatives or vary",
                "neither",
                "alternatives: {slow: {set: {defaults.speed: 0.3 m/s}}}",
            )
        return self

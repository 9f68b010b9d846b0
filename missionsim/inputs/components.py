"""Components of a robot file: loads, laws, links and switchboards."""

from typing import Annotated

from pydantic import Field, model_validator

from missionsim.inputs.base import Expression, Identifier, Model, ParameterName, Text, wrong
from missionsim.inputs.values import AnyNumber, Duration, Efficiency, Frequency, Parameter, Power


class LawSpec(Model):
    """Power that depends on a rate, the speed, a load…: an expression over parameters and glossary columns (`power`),
    or a registered law (`model`)."""

    power: Expression | None = None
    model: Identifier | None = None
    rate: Frequency | None = None
    parameters: dict[ParameterName, AnyNumber] = Field(default_factory=dict)

    @model_validator(mode="after")
    def _one(self) -> "LawSpec":
        if (self.power is None) == (self.model is None):
            raise wrong(
                "a law has either a power or a model",
                "both" if self.power else "neither",
                'power: "k*rate", or model: multicore_cpu',
            )
        return self


class LoadSpec(Model):
    """What one unit of a component takes from one battery."""

    battery: Identifier
    power: Power | None = None
    law: LawSpec | None = None
    through: Identifier | None = None

    @model_validator(mode="after")
    def _one(self) -> "LoadSpec":
        if (self.power is None) == (self.law is None):
            raise wrong(
                "a load has either a power or a law",
                "both" if self.power else "neither",
                "power: 2.3 W, or law: {power: …}",
            )
        return self


class StartupSpec(Model):
    """Time between switching on and being ready, and the power meanwhile (per unit, on the first load's battery)."""

    duration: Duration
    power: Power | None = None


class ComponentSpec(Model):
    """A sensor, board, screen or radio."""

    title: Text = ""
    units: Annotated[int, Field(strict=True, ge=1, le=1000)] = 1
    always_on: bool = False
    loads: Annotated[tuple[LoadSpec, ...], Field(min_length=1, max_length=50)]
    relay: Identifier | None = None
    requires: tuple[Identifier, ...] = ()
    startup: StartupSpec | None = None


class LinkSpec(Model):
    """Converter or USB link between a component and its battery: power at the battery = power / efficiency."""

    battery: Identifier
    efficiency: Efficiency = Parameter(1.0)
    title: Text = ""


class SwitchboardSpec(Model):
    """Relay board: its own power for 0, 1, 2… activated relays."""

    battery: Identifier
    power: Annotated[tuple[Power, ...], Field(min_length=1, max_length=100)]
    title: Text = ""

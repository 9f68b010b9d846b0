"""What an effect is: a declaration (equation, units, source, needs) around one bare function of physics."""

from __future__ import annotations

import functools
from collections.abc import Callable, Mapping
from dataclasses import KW_ONLY, dataclass, field
from typing import Any, TypeVar

import numpy as np

from missionsim.effects.covariates import Covariates, Value, number
from missionsim.errors import InputError
from missionsim.expressions import Lag, Place
from missionsim.physics.motion import recovered_power

ENTRY_POINT_GROUP = "missionsim.effects"
Parameters = Mapping[str, Any]


@dataclass(frozen=True)
class ParameterSpec:
    """Declaration of one parameter of an effect."""

    name: str
    unit: str
    meaning: str = ""
    _: KW_ONLY
    default: float = float("nan")
    """Value where none is given; `nan` where the user or a fit must give it."""
    low: float = 0.0
    high: float = float("inf")
    """Both: bounds that physics sets."""
    plausible: float = float("inf")
    """Beyond so many times what the robot's mass asks for (`Effect.asked`) a fitted value may stand for something else,
    and the finding says so."""
    grid: tuple[float, ...] = ()
    """For a shape parameter (τ, T₀): the values that a search tries first. Empty for a coefficient."""
    optional: bool = False
    """Whether it may be absent without standing for a value."""

    @property
    def required(self) -> bool:
        """Whether it must be given."""
        return self.default != self.default and not self.optional


@dataclass(frozen=True)
class Effect:
    """A named power term: a pure function of covariates and parameters, in watts."""

    id: str
    """Name in the library."""
    equation: str
    source: str
    meaning: str
    """All three: for people."""
    parameters: tuple[ParameterSpec, ...]
    """The first is the coefficient, in which the term is linear; the others set its shape."""
    needs: tuple[str, ...]
    """Covariates without which it cannot be evaluated."""
    power: Callable[[Covariates, Parameters], Value] = field(compare=False)
    """``(cov, p) -> W``."""
    _: KW_ONLY
    impulse: Callable[[Covariates, Parameters], Value] | None = field(default=None, compare=False)
    """``(cov, p) -> J`` delivered at the start of an interval, for events such as a start from rest."""
    component: str = "motors"
    """Under which component its energy is booked."""
    drive: bool = False
    """Whether its power is part of the drive's (what braking and going downhill can relieve)."""
    recovers: bool = False
    """Whether it may be negative and is limited by what the drive can give back."""
    of_drive: bool = False
    """Whether it depends on the power of the whole drive, so that it comes after that."""
    of_load: bool = False
    """Whether it depends on the load of its battery, so that it comes last."""
    execution: bool = False
    """Whether it changes how a mission is executed (path, speed, dwell) instead of adding power."""
    sign: int = 1
    """+1 where the coefficient cannot be negative, 0 where it may be."""
    memory: tuple[str, ...] = ()
    """Derived covariates that grow while time passes (``moving_time_s``, ``on_time_<component>_s``)."""
    lags: tuple[Lag, ...] = ()
    """First-order lags that its power reads, by their text."""
    asked: Callable[[Covariates, Parameters], Value] | None = field(default=None, compare=False)
    """The coefficient that the robot's mass asks for; 1 where not given."""
    beyond: str = "times what the robot's mass asks for; either that mass is wrong or something else acts"
    """In words, what a coefficient beyond all that is plausible is."""
    relief: Callable[[Parameters], Value] | None = field(default=None, compare=False)
    """The part of the drive's power that it can relieve; all of it where not given."""
    parts: tuple[str, ...] = ()
    """Parameters with a column each, where the power is linear in several (floors)."""
    back: str = ""
    """The parameter that says which share of its power braking or a descent gives back. It may be left out; the
    robot's own ``regeneration`` decides then."""
    one_sided: bool = False
    """Whether it gives nothing back, nor relieves the drive, where nothing says that the robot regenerates."""
    covariate: str = ""
    """The covariate that it is mostly about, for reports and shifted splits; the first that it needs, if not given."""
    place: Place = field(default=Place(), repr=False, compare=False)
    """Where the user's file has its formula or names it, for messages."""

    def __post_init__(self) -> None:
        if not self.covariate:
            object.__setattr__(self, "covariate", self.needs[0] if self.needs else "time_s")

    def alone(self, cov: Covariates, p: Parameters) -> Value:
        """Its power beside a drive whose power stands in ``drive_w`` [W]: what it gives back is limited by that need.
        In a model `PowerModel.evaluate` limits all such terms together."""
        power = self.power(cov, p)
        if not self.limits(p):
            return power
        part = self.relieves(p, number(cov, "drive_w"), number(cov, "traction_w"))
        back: Value = p.get(self.back, number(cov, "regeneration"))
        return recovered_power(power, part * number(cov, "drive_w"), back)

    def relieves(self, p: Parameters, drive_w: Value, straight_w: Value) -> Value:
        """The part of the drive's power that it relieves, where the drive would need `straight_w` without a turn."""
        part: Value = 1.0 if self.relief is None else self.relief(p)
        if "ahead" not in p:
            return part
        ahead = np.clip(straight_w / np.where(np.asarray(drive_w) > 0.0, drive_w, np.inf), 0.0, 1.0)
        return np.asarray(part * (1.0 - p["ahead"] * (1.0 - ahead)))

    def limits(self, p: Parameters) -> bool:
        """Whether what it gives back ends where the drive needs nothing any more, but for what regeneration returns."""
        return self.recovers and (self.back not in p or bool(np.any(np.asarray(p.get("relief", 0.0)) > 0.0)))

    @property
    def coefficient(self) -> ParameterSpec:
        """The parameter in which the power is linear."""
        return self.parameters[0]

    @property
    def shape(self) -> tuple[ParameterSpec, ...]:
        """The parameters that set the form (time constants, reference temperatures)."""
        return tuple(spec for spec in self.parameters[1:] if spec.name not in self.parts)

    @property
    def stage(self) -> int:
        """Order of evaluation: drive terms, terms the drive relieves, all other loads, losses of the whole load."""
        if self.of_load:
            return 3
        if self.recovers:
            return 1
        return 0 if self.drive and not self.of_drive else 2


Declared = TypeVar("Declared")


def plugins(kind: type[Declared]) -> dict[str, Declared]:
    """What other packages offer of a kind under the entry point ``missionsim.effects``, by id.

    An entry point names an `Effect`, a motion model or a law of a component, or a callable without arguments that
    returns one. Raises InputError: where an entry point does not load or gives something else.
    """
    return {one.id: one for one in _loaded() if isinstance(one, kind)}  # type: ignore[attr-defined]


@functools.cache
def _loaded() -> tuple[Any, ...]:
    from importlib.metadata import entry_points

    found = []
    for point in entry_points(group=ENTRY_POINT_GROUP):
        try:
            loaded = point.load()
            one = loaded() if callable(loaded) and not hasattr(loaded, "equation") else loaded
        except Exception as error:
            raise InputError.single(f"effect plug-in '{point.name}' does not load", got=repr(error)) from error
        if not (isinstance(getattr(one, "id", None), str) and hasattr(one, "equation")):
            told = f"effect plug-in '{point.name}' gives no Effect"
            allowed = "an Effect, a MotionModel or a LawModel of missionsim.effects, or a callable that returns one"
            raise InputError.single(told, got=type(one).__name__, allowed=allowed)
        found.append(one)
    return tuple(found)

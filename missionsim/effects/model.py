"""The power model of a robot: a list of terms per battery, evaluated in one place for every use."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from missionsim.effects.base import Effect
from missionsim.effects.base_terms import aliased
from missionsim.effects.covariates import Columns, Covariates, Value, number
from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.expressions import Lag
from missionsim.physics import Array
from missionsim.physics.lag import Meter
from missionsim.physics.motion import relieved_powers

_INNER = ("starting_", "on_time_")
DEFAULT_PRIOR_SD = 0.03
"""Relative standard deviation of a base parameter whose file gives none (contract)."""


class TermKey(NamedTuple):
    """Where a term's energy is booked."""

    battery: str
    component: str
    name: str


@dataclass(frozen=True)
class ModelParameter:
    """One number of the model: value and what is known about it."""

    value: float
    """In the effect's unit."""
    unit: str = ""
    sd: float | None = None
    """Prior standard deviation, absolute; None where the file gives none."""
    low: float = -float("inf")
    high: float = float("inf")
    """Both: bounds."""
    status: str = ""
    source: str = ""
    """``published``, ``fitted``, ``assumed``, ``measured`` and from where."""
    path: str = ""
    """Where it stands in the robot file (for Monte Carlo and for writing back)."""
    _: KW_ONLY
    distribution: Any = None
    """The distribution given in the file."""
    times: float = 1.0
    """How many times the file's number it is (the units of a component that is always on)."""

    @property
    def prior_sd(self) -> float:
        """Prior standard deviation relative to the value."""
        return DEFAULT_PRIOR_SD if self.sd is None or self.value == 0.0 else abs(self.sd / self.value)


@dataclass(frozen=True)
class Term:
    """One effect at work on one battery."""

    key: TermKey
    """Battery, component and name."""
    effect: Effect
    parameters: Mapping[str, ModelParameter]
    """By the effect's own parameter names."""
    names: Mapping[str, str] = field(default_factory=dict)
    """The effect's parameter name → name within the battery (``k`` → ``c3``, ``laser.power``)."""
    base: bool = True
    """Whether it belongs to the base model (its parameters have priors) or was added as a found effect."""
    scale: float = 1.0
    """Factor from the power at the load to the power at the battery (1/efficiency of a converter)."""
    link: tuple[str, float] = ("", 1.0)
    """Path and value of the efficiency that is in `scale`."""

    @cached_property
    def limited(self) -> bool:
        """Whether what it gives back ends where the drive needs nothing any more, but for the robot's regeneration."""
        own = {name: parameter.value for name, parameter in self.parameters.items()}
        return self.effect.recovers and self.effect.limits(own)

    @property
    def gives_back(self) -> bool:
        """Whether the robot's regeneration acts on it."""
        return self.effect.recovers and self.effect.back not in self.parameters

    def name_of(self, parameter: str) -> str:
        """Name of a parameter within its battery."""
        return self.names.get(parameter, f"{self.key.name}.{parameter}")


def _lag_name(term: Term, lag: Lag) -> str:
    return f"{'/'.join(term.key)} {lag.text}"


@dataclass(frozen=True)
class PowerModel:
    """All terms of a robot."""

    terms: tuple[Term, ...]
    batteries: tuple[str, ...]
    """In the order of the robot file."""
    constants: Mapping[str, float] = field(default_factory=dict)
    """Covariates that the robot itself gives: ``body_mass_kg``, ``regeneration``."""
    regeneration: ModelParameter | None = None
    """`constants`' regeneration as a number that may be fitted; None where nothing gives back or it is zero."""
    schemes: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Units of components that each control scheme requires; not a number where it may use them."""
    known: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    """Least and greatest value of covariates in the logs that the robot was fitted to."""
    floors: frozenset[str] = frozenset()
    """Surfaces in those logs."""
    meters: Mapping[str, Meter] = field(default_factory=dict)
    """How far the meter of a battery is behind the motion in logs; none where the file says nothing."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "terms", tuple(sorted(self.terms, key=lambda term: term.effect.stage)))

    def meter(self, battery: str) -> Meter:
        """How far the meter of a battery is behind the motion; at once where the file says nothing."""
        return self.meters.get(battery, Meter())

    def of(self, battery: str) -> tuple[Term, ...]:
        """The terms of one battery, in order of evaluation."""
        return self._of.get(battery, ())

    @cached_property
    def _of(self) -> dict[str, tuple[Term, ...]]:
        names = dict.fromkeys(term.key.battery for term in self.terms)
        return {name: tuple(term for term in self.terms if term.key.battery == name) for name in names}

    @property
    def parameters(self) -> dict[str, ModelParameter]:
        """Every parameter by ``battery/name`` (``robot/c3``, ``laptop/kinect.power``)."""
        return {
            f"{battery}/{name}": parameter
            for battery in self.batteries
            for name, parameter in self.parameters_of(battery).items()
        }

    def parameters_of(self, battery: str) -> dict[str, ModelParameter]:
        """Every parameter of one battery by its name there."""
        terms = self.of(battery)
        found = {term.name_of(name): parameter for term in terms for name, parameter in term.parameters.items()}
        if self.regeneration is not None and any(term.gives_back for term in terms):
            found["regeneration"] = self.regeneration
        return found

    @cached_property
    def memory(self) -> frozenset[str]:
        """Clocks that some term reads."""
        return frozenset(name for term in self.terms for name in term.effect.memory)

    @cached_property
    def lags(self) -> dict[str, tuple[Term, Lag]]:
        """First-order lags that terms read, by names of their own."""
        return {_lag_name(term, lag): (term, lag) for term in self.terms for lag in term.effect.lags}

    def lagging(self, name: str, cov: Covariates, values: Mapping[str, Value]) -> Value:
        """The signal of a lag."""
        term, lag = self.lags[name]
        full = self.complete(cov, values)
        if any(need not in full for need in term.effect.needs):
            raise InputError(self.lacking(full, term.key.battery))
        return lag.x({**aliased(full), **self._values(term, values)})

    def time_constant(self, name: str, values: Mapping[str, Value]) -> Value:
        """The time constant of a lag [s]."""
        term, lag = self.lags[name]
        found: Value = lag.tau(self._values(term, values))
        return found

    @cached_property
    def needs(self) -> frozenset[str]:
        """Covariates without which some term cannot be evaluated."""
        return frozenset(name for term in self.terms for name in term.effect.needs)

    def lacking(self, cov: Covariates, battery: str | None = None) -> list[Fault]:
        """A fault for each name that terms need and `cov` lacks, at the place of the formula that reads it."""
        told = [name for name in sorted(cov) if not name.startswith(_INNER)]
        columns, faults = ", ".join(told), []
        for term in self.terms if battery is None else self.of(battery):
            effect = term.effect
            own = [*(spec.name for spec in effect.parameters), *told]
            for name in effect.needs:
                if name not in cov:
                    message = f"'{term.key.name}' reads '{name}', which is not known here"
                    allowed = (
                        "its parameters, columns of the log, or what the mission gives: "
                        f"conditions: {{{name}: …}} in its defaults or a segment; here: {columns}"
                    )
                    hint = did_you_mean(name, own)
                    faults.append(effect.place.fault(message, got=effect.equation, allowed=allowed, hint=hint))
        return faults

    def evaluate(
        self, cov: Covariates, values: Mapping[str, Value] | None = None, battery: str | None = None
    ) -> dict[str, dict[TermKey, Value]]:
        """Power of every term in watts.

        `cov`: covariates under glossary names; scalars, ``(intervals,)`` or ``(draws, intervals)``. `values`:
        parameters that differ from the model's, by ``battery/name``; arrays of shape ``(draws, 1)`` broadcast.
        `battery`: only this battery. Gives battery → term key → power [W]. Raises InputError: where a term needs a
        covariate that is not there.
        """
        full, values = self.complete(cov, values), values or {}
        found: dict[str, dict[TermKey, Value]] = {}
        for name in self.batteries if battery is None else (battery,):
            own_regeneration = f"{name}/regeneration"
            given = {**full, "regeneration": values[own_regeneration]} if own_regeneration in values else full
            powers: dict[TermKey, Any] = {}
            found[name] = powers
            drive: Any = 0.0
            straight: Any = None
            relieving: dict[TermKey, Any] = {}
            parts: list[Any] = []
            back: list[Any] = []
            for term in self.of(name):
                effect = term.effect
                if relieving and effect.stage > 1:
                    relieved = relieved_powers([*relieving.values()], drive, back, parts)
                    powers.update(zip(relieving, relieved, strict=True))
                    relieving = {}
                if any(need not in given for need in effect.needs):
                    raise InputError(self.lacking(given, name))
                own = self._values(term, values)
                load = {**given, "load_w": sum(powers.values(), start=0.0)} if effect.of_load else given
                if straight is None and (effect.of_drive or "ahead" in own):
                    straight = self.traction_w(given, name, values)
                if effect.of_drive:
                    load = {**given, "traction_w": straight}
                if effect.lags:
                    known = ((lag.text, _lag_name(term, lag)) for lag in effect.lags)
                    load = {**load, **{text: given[lag] for text, lag in known if lag in given}}
                power: Any = effect.power(load, own)
                scale: Any = term.scale
                if values and term.link[0] in values:
                    scale = scale * term.link[1] / values[term.link[0]]
                if np.ndim(scale) or scale != 1.0:
                    power = power * scale
                powers[term.key] = power
                if term.limited:
                    relieving[term.key] = power
                    parts.append(effect.relieves(own, drive, drive if straight is None else straight))
                    back.append(own.get(effect.back, number(given, "regeneration")))
                elif effect.drive and not effect.of_drive:
                    drive = drive + (np.maximum(power, 0.0) if effect.back else power)
            if relieving:
                relieved = relieved_powers([*relieving.values()], drive, back, parts)
                powers.update(zip(relieving, relieved, strict=True))
        return found

    def traction_w(self, cov: Covariates, battery: str, values: Mapping[str, Value] | None = None) -> Value:
        """Power that the base takes to drive the same way straight ahead [W], negative where it pushes back; turning
        needs nothing of what a descent gives back (assumed).

        `cov`: complete covariates; `values` as in `evaluate`.
        """
        straight = {**cov, "yaw_rate_rad_s": 0.0}
        own = (t for t in self.of(battery) if t.effect.stage == 0)
        return sum((t.effect.power(straight, self._values(t, values or {})) * t.scale for t in own), start=0.0)

    def complete(self, cov: Covariates, values: Mapping[str, Value] | None = None) -> Columns:
        """`cov` with the robot's own constants, those of `values` if they are there, and the total mass."""
        full = {**self.constants, **cov}
        if values:
            full |= {name: values[name] for name in self.constants if name in values}
        if "mass_kg" not in full:
            full["mass_kg"] = full.get("body_mass_kg", 1.0) + number(full, "payload_kg")
        return full

    def _values(self, term: Term, values: Mapping[str, Any]) -> dict[str, Any]:
        if not values:
            return {name: parameter.value for name, parameter in term.parameters.items()}
        return {
            name: values.get(f"{term.key.battery}/{term.name_of(name)}", parameter.value)
            for name, parameter in term.parameters.items()
        }

    def total(self, cov: Covariates, battery: str, values: Mapping[str, Value] | None = None) -> Value:
        """Power of one battery [W], the sum of its terms."""
        return sum(self.evaluate(cov, values, battery)[battery].values(), start=0.0)

    def impulses(self, cov: Covariates, values: Mapping[str, Value] | None = None) -> dict[TermKey, Value]:
        """Energy in J that terms take at the very start of an interval (starts from rest)."""
        full = self.complete(cov, values)
        return {
            term.key: term.scale * term.effect.impulse(full, self._values(term, values or {}))
            for term in self.terms
            if term.effect.impulse is not None and all(name in full for name in term.effect.needs)
        }

    def gradient(self, cov: Covariates, battery: str) -> dict[str, Array]:
        """Change of a battery's power with the logarithm of each parameter, ``∂P/∂ln θ`` [W], arrays of shape (n,).

        By central differences of 1e-4, exact for the parameters in which the power is linear or quadratic. Where no
        other term depends on its power, the parameter's own term alone is evaluated. Parameters that are zero have no
        logarithm and are left out. `cov`: complete covariates of one run, with ``time_s``.
        """
        step, rows = 1e-4, len(cov["time_s"])
        found: dict[str, Array] = {}

        def add(names: Iterable[str], powers: Any, scale: float = 1.0) -> None:
            """Two draws of the power of all that moves for each name, a step up and one down."""
            for at, name in enumerate(names):
                up, down = (powers[2 * at + i] if np.ndim(powers) > 1 else powers for i in (0, 1))
                slope = scale * (np.asarray(up, dtype=float) - np.asarray(down, dtype=float)) / (2.0 * step)
                slope = np.ascontiguousarray(np.broadcast_to(slope, (rows,)))
                found[name] = found[name] + slope if name in found else slope

        own = alone = self.of(battery)
        regenerates = self.constants.get("regeneration", 0.0) > 0.0
        if "regeneration" in self.parameters_of(battery) or any(
            # limited by what the drive needs, or of the load: the powers of the model are then not a plain sum
            (
                term.effect.of_load
                or term.effect.of_drive
                or (term.limited and (not term.effect.one_sided or "relief" in term.parameters or regenerates))
            )
            and any(p.value != 0.0 for p in term.parameters.values())
            for term in own
        ):
            alone = tuple(t for t in own if not (t.effect.drive or t.effect.recovers))
            if any(term.effect.of_load for term in own):
                alone = ()
            coupled = replace(self, terms=tuple(term for term in own if term not in alone))
            moving = {name: p.value for name, p in coupled.parameters_of(battery).items() if p.value != 0.0}
            values = {f"{battery}/{name}": drawn for name, drawn in _stepped(moving, step).items()}
            add(moving, coupled.total(cov, battery, values))
        for term in alone:
            nominal = {name: parameter.value for name, parameter in term.parameters.items()}
            moving = {name: value for name, value in nominal.items() if value != 0.0}
            if moving:
                powers = term.effect.power(cov, {**nominal, **_stepped(moving, step)})
                add(map(term.name_of, moving), powers, term.scale)
        return {name: found[name] for name in self.parameters_of(battery) if name in found}

    def with_values(self, values: Mapping[str, float]) -> PowerModel:
        """A model with other parameter values, by ``battery/name``. Raises InputError: for a name that the model does
        not have."""
        known = self.parameters
        for name in values:
            if name not in known:
                raise InputError.unknown(f"the robot has no parameter '{name}'", name, sorted(known))
        terms = tuple(
            replace(
                term,
                parameters={
                    name: replace(
                        parameter, value=values.get(f"{term.key.battery}/{term.name_of(name)}", parameter.value)
                    )
                    for name, parameter in term.parameters.items()
                },
            )
            for term in self.terms
        )
        regeneration, constants = self.regeneration, self.constants
        for battery in self.batteries:
            if regeneration is not None and (new := values.get(f"{battery}/regeneration")) is not None:
                regeneration, constants = replace(regeneration, value=new), {**constants, "regeneration": new}
        return replace(self, terms=terms, constants=constants, regeneration=regeneration)


def _stepped(values: Mapping[str, float], step: float) -> dict[str, Array]:
    """Two draws for each of some values, shape (2 × values, 1) each, in which it alone is a step larger and smaller."""
    draws = {name: np.full((2 * len(values), 1), value) for name, value in values.items()}
    for at, (name, value) in enumerate(values.items()):
        draws[name][2 * at : 2 * at + 2, 0] = value * (1.0 + step), value * (1.0 - step)
    return draws

"""What a run can drive of a model, and what is assumed for it: filled in, left out or skipped, and said."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

from missionsim.effects.model import PowerModel
from missionsim.errors import InputError
from missionsim.labels import Labels
from missionsim.runs.covariates import ASSUMED, clock_of, is_switch

_DERIVED = ("mass_kg", "moving_time_s", "starts", "starts_per_s", "time_s")


@dataclass(frozen=True)
class Assumed:
    """What of a model a run with certain columns can drive, and what is assumed for it."""

    model: PowerModel
    """The terms that can be evaluated."""
    batteries: tuple[str, ...]
    """Measured and modelled."""
    assumed: Mapping[str, float]
    """Columns filled in."""
    notes: tuple[str, ...]
    """What was assumed, left out or skipped, in words."""
    switched: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Switches that follow from the logged control scheme: units under each scheme."""
    unknown: frozenset[str] = frozenset()
    """Switches that neither the log nor a scheme tells; they count as off."""


def assume(model: PowerModel, columns: Iterable[str], measured: Iterable[str], *, source: str = "") -> Assumed:
    """Decide what a run can drive: fill what has a plain meaning, leave out or skip the rest, and say so.

    `columns`: columns of the run. `measured`: batteries that are wanted; those whose power was measured. `source`: name
    of the log for the message. Raises InputError: where no battery is both measured and modelled.
    """
    have = {*columns, *_DERIVED}
    scheme = columns.get("scheme") if isinstance(columns, Mapping) else None
    scheme_tells = "scheme" in have and not (isinstance(scheme, Labels) and not set(scheme.names) & set(model.schemes))
    if "speed_m_s" in have:
        have.add("accel_m_s2")
    have |= {clock_of(name) for name in have if is_switch(name)}
    notes: list[str] = []
    assumed: dict[str, float] = {}
    kept = model.terms
    batteries: list[str] = []
    reasons: list[str] = []
    measured = list(measured)
    for battery in measured:
        if battery not in model.batteries:
            reasons.append(f"battery '{battery}' was measured but the robot has none of that name")
            continue
        own_assumed: dict[str, float] = {}
        skip = ""
        for term in model.of(battery):
            lacking = [name for name in term.effect.needs if name not in have]
            own_assumed |= {name: 0.0 for name in lacking if name in ASSUMED or is_switch(name)}
            unknown = [name for name in lacking if name not in own_assumed and not _follows(name, own_assumed)]
            if unknown and term.base:
                skip = f"its {term.key.component} ({term.key.name}) needs the column {_listed(unknown)}"
                break
            if unknown:
                kept = tuple(other for other in kept if other.key != term.key)
                notes.append(f"{battery}: the effect {term.key.name} is left out: the log has no {_listed(unknown)}")
        if skip:
            reasons.append(f"battery '{battery}' is skipped: {skip}, which the log lacks")
        else:
            batteries.append(battery)
            assumed |= own_assumed
    if not batteries:
        raise InputError.single(
            "the log cannot drive the model: " + ("; ".join(reasons) or "no power was measured"),
            file=source,
            got=", ".join(measured),
            allowed=", ".join(model.batteries),
        )
    # a term whose only numbers are zero (acceleration in a model without it) costs time and says nothing
    kept = tuple(term for term in kept if any(p.value != 0.0 for p in term.parameters.values()) or not term.parameters)
    used = {name for battery in batteries for term in model.of(battery) for name in (term.effect.covariate,)}
    switched: dict[str, Mapping[str, float]] = {}
    untold: set[str] = set()
    told: dict[str, list[str]] = {}
    for name in sorted(name for name in {*used, *assumed} - have if is_switch(name)):
        by_scheme = {scheme: units.get(name[3:], 0.0) for scheme, units in model.schemes.items()}
        if scheme_tells and any(value != 0.0 for value in by_scheme.values()):
            switched[name] = by_scheme
            state = "on where the logged control scheme requires it"
        elif by_scheme and min(by_scheme.values()) == max(by_scheme.values()) > 0.0:
            assumed[name] = next(iter(by_scheme.values()))
            state = "switched on, since every control scheme of the robot requires it"
        else:
            state = "switched off"
            untold.add(name)
        if any(value != value for value in by_scheme.values()):
            untold.add(name)
        if name in used:
            told.setdefault(state, []).append(name)
    for state, names in told.items():
        count = "counts" if len(names) == 1 else "count"
        notes.append(f"no column {', '.join(names)}: {', '.join(name[3:] for name in names)} {count} as {state}")
    for name in switched:
        assumed.pop(name, None)
    notes += [f"no column {name}: {ASSUMED[name]}" for name in assumed if name in ASSUMED]
    clocks = {clock_of(name): 0.0 for name, value in assumed.items() if is_switch(name) and value == 0.0}
    return Assumed(
        replace(model, terms=kept),
        tuple(batteries),
        {**assumed, **clocks},
        (*reasons, *notes),
        switched,
        frozenset(untold & used),
    )


def _follows(name: str, assumed: Mapping[str, float]) -> bool:
    """Whether a clock follows from a component that counts as off."""
    return name.startswith("on_time_") and f"on_{name[8:-2]}" in assumed


def _listed(names: list[str]) -> str:
    return " and ".join(names)

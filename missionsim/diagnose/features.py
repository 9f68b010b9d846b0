"""From logs, a power model and the library of effects to the arrays of the identification (step 0).

Everything is evaluated at the raw rate of the log; the identification averages afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import product

import numpy as np

from missionsim.effects.base import Effect
from missionsim.effects.covariates import Covariates
from missionsim.effects.library import FLOORS, all_effects, execution_effects, floors_effect, logged_power_columns
from missionsim.effects.model import ModelParameter, PowerModel, Term, TermKey
from missionsim.errors import InputError
from missionsim.fit.final import final_fit
from missionsim.fit.prepare import acting, never_on, prepare
from missionsim.identify import settings as const
from missionsim.identify.align import Clock
from missionsim.identify.data import Candidate, RunData
from missionsim.labels import Labels
from missionsim.physics import Array
from missionsim.runs.covariates import is_switch, logged_name, remarks_on
from missionsim.runs.run import Run

MOST_SURFACES = 40
"""More names than that are no floors but numbers or places, and a column each would take for ever."""
_TWIN_FAMILIES = ("rolling_friction", "viscous_friction", "standby_load", "component_power")
CHARGED = 0.005
"""Part of the rows in which a battery is charged from which on a descent may have a coefficient of its own."""
STEADY = 0.03
"""Relative standard deviation of a voltage below which losses with P² and with (P/U)² are one: a loss of a tenth then
differs by 0.6 % of the power."""
CAUSES = ("payload_kg", "temp_ambient_c", "cpu_load", "cpu_freq_hz", "access_point_distance_m")
"""Columns of which logs that hold one value of them tell nothing."""
SAME_METER = 0.999
"""Correlation with the measured power from which on a column of watts is that power once more, not a load."""


@dataclass(frozen=True)
class Features:
    """What the identification of one battery reads."""

    battery: str
    runs: tuple[RunData, ...]
    candidates: tuple[Candidate, ...]
    prior_sd: Mapping[str, float]
    """Relative standard deviation of each base parameter."""
    parameters: Mapping[str, ModelParameter]
    """Base parameters by their name within the battery."""
    effects: Mapping[str, Effect]
    """The library's effect behind each candidate; surfaces are one effect with a coefficient each."""
    untestable: Mapping[str, tuple[str, ...]]
    """Effects that cannot be tested and the log columns they lack."""
    remarks: tuple[str, ...]
    """What was assumed or left out, in words."""
    _: KW_ONLY
    covariates: tuple[Covariates, ...]
    """Covariates of each run at its raw rate, with what follows from them."""
    unlogged: tuple[str, ...] = ()
    """Components of which nothing tells when they were on."""
    steady: Mapping[str, float] = field(default_factory=dict)
    """Relative changes of base parameters that together make the constant load of components of which nothing tells
    whether they were on."""
    given_sd: Mapping[str, float] = field(default_factory=dict)
    """What the file says of `prior_sd`, where the logs refute it."""


def make_features(
    model: PowerModel, logs: Sequence[Run], battery: str, own: Sequence[Effect] = (), *, switchable: Sequence[str] = ()
) -> Features:
    """Evaluate base model, its gradient and every effect of the library that the logs allow.

    `model`: the robot, effects already found included. `logs`: one a run; those that do not measure `battery` are left
    out. `own`: the user's own candidates beside the library. `switchable`: components of the robot that can be
    switched. Raises InputError: where the base model needs a column that the logs lack, or no log measures the battery.
    """
    ready = prepare(model, logs, battery)
    surfaces = ready.texts.get("surface", ())
    names, covariates = {*ready.names, "load_w", "drive_w", "traction_w"}, ready.covariates
    # components to test, and whether their switch is logged
    components = dict.fromkeys(switchable, False) | dict.fromkeys(sorted(n[3:] for n in names if is_switch(n)), True)
    there = {term.effect.id for term in model.of(battery)}
    held = {term.effect.id for term in model.of(battery) if not term.base}
    held |= {family for id in held if (family := id.partition(":")[0]) in FLOORS}
    measured_w, remarks, watts = ready.measured_w(), ready.remarks, []
    if (column := f"voltage_{battery}_v") in names:
        volts = np.concatenate([np.asarray(cov[column], dtype=float) for cov in covariates])
        if float(np.std(volts)) < STEADY * abs(float(np.mean(volts))):
            held.add("battery_resistance")
            remarks.append(f"{column} hardly changes: what a resistance of the battery takes is conversion_loss there")
    if not any({"accel_m_s2", "slope_rad"} & set(term.effect.needs) for term in model.of(battery) if term.base):
        held.add("lost_recuperation")  # a base that knows neither acceleration nor slope takes nothing as given back
    if not there & {"turning_scrub", "skid"}:
        # an interaction enters after its main effect (Nelder 1977, marginality): any load that goes with turning is
        # louder on one floor than on another
        held.add("surface_turning_scrub")
    for name in logged_power_columns(names, model.batteries):
        own_w = np.concatenate([np.asarray(cov[name], dtype=float) for cov in covariates])
        both = np.isfinite(own_w) & np.isfinite(measured_w)
        if not np.ptp(own_w[both]) > 0.0:
            continue
        if np.ptp(measured_w[both]) > 0.0 and abs(np.corrcoef(own_w[both], measured_w[both])[0, 1]) > SAME_METER:
            remarks.append(f"{name} follows the measured power: that power once more, not a load beside it")
        else:
            watts.append(name)
    remarks += remarks_on(covariates)
    if len(surfaces) > MOST_SURFACES:
        remarks.append(f"{len(surfaces)} different surfaces, more than {MOST_SURFACES}: what they add is not tested")
        held |= {*FLOORS}
    if len(surfaces) == 1:
        remarks.append(f"all runs are on one surface ({surfaces[0]}): its resistance is part of rolling friction")
    floors = surfaces if 1 < len(surfaces) <= MOST_SURFACES else ()
    steady_causes = []
    for name in (one for one in CAUSES if one in names):
        values = np.concatenate([np.asarray(cov[name], dtype=float) for cov in covariates])
        if np.ptp(values) == 0.0:
            steady_causes.append(name)
            if values[0]:
                remarks.append(f"{name} is {values[0]:g} in every row: what goes with it is part of the base")
    untestable: dict[str, tuple[str, ...]] = {}
    effects: dict[str, Effect] = {}
    for effect in (*all_effects(tuple(components), floors, tuple(watts), battery), *own):
        if effect.id in held or effect.execution:
            continue
        lacks = (name for name in effect.needs if name not in names or name in steady_causes)
        lacking = tuple(dict.fromkeys(map(logged_name, lacks)))
        if lacking:
            untestable[effect.id] = lacking
        else:
            effects[effect.id] = effect
    for id in FLOORS:
        if not surfaces and id not in held:
            untestable[id] = tuple(name for name in floors_effect(id, ()).needs if name not in names)
    for effect in execution_effects():
        untestable[effect.id] = ("mission", *(name for name in effect.needs if name not in names))
    _refuse_nonsense([effect for effect in own if effect.id in effects], covariates)
    steady: dict[str, float] = {}
    unknown_w = sum(ready.unknown.values())
    if unknown_w:
        # of the base parameters that are a constant power wherever they act
        whole = {name: np.concatenate([own[name] for own in ready.gradients]) for name in ready.gradients[0]}
        acting = {name: values[values != 0.0] for name, values in whole.items()}
        level = [n for n, w in acting.items() if len(w) and np.ptp(w) <= 1e-9 * np.max(np.abs(w))]
        steady = _shares_of(np.full(ready.seconds().shape, unknown_w), level, ready.gradients)
    columns: list[dict[str, Array]] = [{} for _ in ready.runs]
    charged = float(np.mean(measured_w < 0.0))
    candidates: list[Candidate] = []
    unlogged = tuple(f"component_power:{c}" for c in ready.unknown), unknown_w
    off = never_on(model, ready)
    for effect in effects.values():
        candidate = _candidate(effect, covariates, charged, _in_base(effect, covariates, ready.gradients))
        for cov, held_w in zip(covariates, columns, strict=True):
            held_w |= effect_columns(effects, [candidate], cov)
        if candidate.covariate not in names or candidate.covariate.startswith(("on_time_", "starts")):
            candidate = replace(candidate, covariate=logged_name(candidate.covariate))
        if not effect.drive:
            candidate = replace(candidate, unlogged=unlogged, never_on=off)
        candidates.append(_with_twin(candidate, columns, ready.gradients))
    return Features(
        battery,
        ready.data(columns),
        tuple(candidates),
        {name: p.prior_sd for name, p in ready.parameters.items()},
        ready.parameters,
        effects,
        untestable,
        tuple(dict.fromkeys(ready.remarks)),
        covariates=tuple(covariates),
        unlogged=tuple(ready.unknown),
        steady=steady,
    )


def effect_columns(
    effects: Mapping[str, Effect],
    candidates: Sequence[Candidate],
    cov: Covariates,
    refitted: Mapping[str, Mapping[str, float]] | None = None,
) -> dict[str, Array]:
    """Every candidate column for given covariates, such as those of a manoeuvre; power for coefficient 1 [W].
    `refitted`: shape parameters by column, where they are not those of the grid."""
    found: dict[str, Array] = {}
    for candidate in candidates:
        effect = effects[candidate.effect]
        for i, name in enumerate(candidate.columns):
            shape = (refitted or {}).get(name, candidate.shape[i] if candidate.shape else {})
            level = candidate.levels[i] if candidate.levels else ""
            found[name] = _column(effect, cov, shape, level)
    return found


def at_size(features: Features, sizes: Mapping[str, float]) -> Features:
    """The same features, with the columns of some effects as they are at a size of the effect.

    What a descent gives back ends where the drive needs nothing any more, so that the power of `grade` is not
    proportional to its coefficient; its column is the power at the size found, divided by that size. `sizes`:
    coefficient by id of the effect; effects without a shape and levels only.
    """
    runs = []
    for run, cov in zip(features.runs, features.covariates, strict=True):
        columns = dict(run.columns)
        for name, size in sizes.items():
            columns[name] = _column(features.effects[name], cov, {}, size=size) / size
        runs.append(replace(run, columns=columns))
    return replace(features, runs=tuple(runs))


def _in_base(effect: Effect, runs: Sequence[Covariates], gradients: Sequence[Mapping[str, Array]]) -> bool:
    """Whether the base has a term that takes and gives back as an effect does that gives back all that it takes. Of the
    share that comes back, the size and the base's own term two are then one too many: the two lean on each other."""
    if not effect.back:
        return False
    whole = np.concatenate([_column(effect, cov, {effect.back: 1.0}) for cov in runs])
    return bool(_shares_of(whole, list(gradients[0]), gradients))


def beside_base(features: Features, model: PowerModel, logs: Sequence[Run], settings: const.Settings) -> Features:
    """The same features, with what pushes back as a base has it that was fitted beside it.

    A base that takes all as given back, fitted to a drive that gives back nothing, has slopes half-way between, and
    pushes back too little.
    """
    own = [effect for effect in features.effects.values() if effect.of_drive]
    if not own:
        return features
    terms = [
        Term(TermKey(features.battery, e.component, e.id), e, {"k": ModelParameter(0.5, "1")}, base=False) for e in own
    ]
    both = replace(model, terms=(*model.terms, *terms))
    clock = Clock.as_logged(len(logs))
    base = final_fit(both, logs, features.battery, features.prior_sd, clock, settings).model
    covariates, runs = [], []
    for run, cov in zip(features.runs, features.covariates, strict=True):
        covariates.append({**cov, "traction_w": base.traction_w(cov, features.battery)})
        columns = {effect.id: _column(effect, covariates[-1], {}) for effect in own}
        runs.append(replace(run, columns={**run.columns, **columns}))
    return replace(features, runs=tuple(runs), covariates=tuple(covariates))


def _candidate(effect: Effect, runs: Sequence[Covariates], charged: float, in_base: bool) -> Candidate:
    """An effect as the identification tests it; a grid of shape values or of surfaces gives one column each."""
    levels = tuple(part.removeprefix("k_") for part in effect.parts or ())
    free = [spec for spec in effect.shape if spec.grid or not spec.optional]
    # the share that an effect gives back is asked of the data only where the robot file leaves it to them; a descent
    # first saves what the drive needs, and where the battery is never charged there is no more to tell
    decided = in_base or any(float(cov.get("regeneration", 0.0)) > 0.0 for cov in runs)
    if decided or not (effect.one_sided or charged >= CHARGED):
        free = [spec for spec in free if spec.name != effect.back]
    axes = []
    for spec in free:
        axis = spec.grid or (float(spec.default) if np.isfinite(spec.default) else 1.0,)
        if not spec.grid and np.isfinite(spec.low) and np.isfinite(spec.high):
            spread = np.geomspace if spec.low > 0.0 and spec.high / spec.low > 10.0 else np.linspace
            axis = tuple(float(x) for x in spread(spec.low, spec.high, 5)[1:-1])
        axes.append(axis)
    names = [spec.name for spec in free]
    shape = tuple(dict(zip(names, values, strict=True)) for values in product(*axes)) if free and not levels else ()
    refit: Callable[[Mapping[str, float]], list[Array]] | None = None
    if shape:

        def refit(values: Mapping[str, float]) -> list[Array]:
            return [_column(effect, cov, values) for cov in runs]

    # of a robot whose mass nobody knows the coefficient of what its mass asks for is a mass
    of_mass, weighed = effect.recovers or effect.asked is not None, "body_mass_kg" in runs[0]
    return Candidate(
        effect.id,
        tuple(f"{effect.id}|{end}" for end in levels or range(len(shape))) or (effect.id,),
        effect.sign,
        effect.coefficient.unit,
        "k" if levels else effect.coefficient.name,
        shape,
        None,
        refit,
        covariate=effect.covariate,
        levels=levels,
        by_clock=bool(effect.memory) or effect.impulse is not None,
        plausible=effect.coefficient.plausible if weighed or not of_mass else math.inf,
        asked=float(effect.asked(runs[0], {})) if effect.asked is not None and weighed else 1.0,
        beyond=effect.beyond,
        shape_bounds={spec.name: (spec.low, spec.high) for spec in effect.shape if shape and spec.name in shape[0]},
    )


def _refuse_nonsense(own: Sequence[Effect], runs: Sequence[Covariates]) -> None:
    """Refuse a user's formula that gives no number where all that it reads is known: as power it would spoil a run."""
    faults = []
    for effect in own:
        bad = rows = 0
        for cov in runs:
            numbers = [np.asarray(cov[name], dtype=float) for name in effect.needs if not isinstance(cov[name], Labels)]
            known = np.isfinite(np.broadcast_arrays(cov["time_s"], *numbers)).all(axis=0)
            power = effect.alone(cov, {one.name: one.default for one in effect.shape} | {effect.coefficient.name: 1.0})
            bad += int(np.sum(known & ~np.isfinite(np.asarray(power, dtype=float))))
            rows += int(np.sum(known))
        if bad:
            told, allowed = (
                f"'{effect.id}' gives no number in {bad} of {rows} rows",
                "a formula that is finite in every row",
            )
            faults.append(effect.place.fault(told, got=effect.equation, allowed=f"{allowed} (no division by nought?)"))
    if faults:
        raise InputError(faults)


def _column(effect: Effect, cov: Covariates, shape: Mapping[str, float], level: str = "", size: float = 1.0) -> Array:
    rows = len(cov["time_s"])
    if level:
        values: dict[str, float] = {spec.name: float(spec.name == f"k_{level}") for spec in effect.parameters}
    else:
        given = {s.name: s.default for s in effect.shape if not s.optional}
        values = {effect.coefficient.name: size, **given, **shape}
    power = np.broadcast_to(np.asarray(effect.alone(cov, values), dtype=float), (rows,))
    return np.ascontiguousarray(np.nan_to_num(power, nan=0.0, posinf=0.0, neginf=0.0))


def _with_twin(
    candidate: Candidate, columns: Sequence[Mapping[str, Array]], gradients: Sequence[Mapping[str, Array]]
) -> Candidate:
    """Mark an effect that a shift of base parameters would imitate exactly; its sign is then free."""
    if candidate.effect.partition(":")[0] not in _TWIN_FAMILIES or len(candidate.columns) != 1:
        return candidate
    names = list(gradients[0])
    y = np.concatenate([c[candidate.columns[0]] for c in columns])
    own = f"{candidate.effect.partition(':')[2]}."
    # a component that was never switched looks like the base: each effect is first held against its own kind
    kin = [n for n in names if (n.startswith(own) if len(own) > 1 else "." not in n)]
    for group in (kin, names):
        # of an exact imitation the parameter that takes the largest part
        shares = _shares_of(y, group, gradients)
        parts = {n: abs(s) * float(sum(own[n] @ own[n] for own in gradients)) ** 0.5 for n, s in shares.items()}
        if parts:
            return replace(candidate, prior=max(parts, key=parts.__getitem__), sign=0)
    return candidate


def _shares_of(y: Array, names: Sequence[str], gradients: Sequence[Mapping[str, Array]]) -> dict[str, float]:
    """Relative changes of base parameters that together imitate a column exactly; none where nothing does."""
    names = [name for name in acting(gradients) if name in names]
    if not names or not np.any(y):
        return {}
    x = np.column_stack([np.concatenate([own[name] for own in gradients]) for name in names])
    size = np.linalg.norm(x, axis=0)
    coefficients, *_ = np.linalg.lstsq(x / size, y, rcond=1e-9)
    left = y - (x / size) @ coefficients
    if float(left @ left) > 1e-6 * float(y @ y):
        return {}
    return dict(zip(names, (float(c) for c in coefficients / size), strict=True))

"""From logs, a power model and the library of effects to the arrays of the identification (step 0).

Everything is evaluated at the raw rate of the log; the identification averages afterwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace

import numpy as np

from missionsim.effects.base import Effect
from missionsim.effects.covariates import Covariates
from missionsim.effects.library import FLOORS, all_effects, execution_effects, floors_effect, logged_power_columns
from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.fit.prepare import Prepared, never_on, prepare
from missionsim.identify.data import Candidate, RunData
from missionsim.identify.settings import (
    SLOW_ROWS_S,
    SPEED_AGREE,
    SPEED_AVERAGED_S,
    SPEED_JUMPS_BACK,
    SPEED_NOISY,
    SPEED_ROWS,
)
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
    model: PowerModel,
    logs: Sequence[Run],
    battery: str,
    own: Sequence[Effect] = (),
    *,
    switchable: Sequence[str] = (),
    skip: Sequence[str] = (),
) -> Features:
    """Evaluate base model, its gradient and every effect of the library that the logs allow.

    `model`: the robot, effects already found included. `logs`: one a run; those that do not measure `battery` are left
    out. `own`: the user's own candidates beside the library. `switchable`: components of the robot that can be
    switched. `skip`: ids of effects that the robot file already holds on this battery. Raises InputError: where the
    base model needs a column that the logs lack, or no log measures the battery.
    """
    ready = prepare(model, logs, battery)
    surfaces = ready.texts.get("surface", ())
    names, covariates = {*ready.names, "load_w", "drive_w"}, ready.covariates
    components = _components(names, switchable)
    held = {*skip, *_held(model, battery)}
    if _steady(f"voltage_{battery}_v", names, covariates):
        held.add("battery_resistance")  # the same as conversion_loss there
    if not {term.effect.id for term in model.of(battery)} & {"turning_scrub", "skid"}:
        # an interaction enters after its main effect (Nelder 1977, marginality): any load that goes with turning is
        # louder on one floor than on another
        held.add("surface_turning_scrub")
    watts = _loads(names, model.batteries, covariates, ready)
    ready.remarks.extend(remarks_on(covariates))
    library = all_effects(tuple(components), surfaces if 1 < len(surfaces) <= MOST_SURFACES else (), watts, battery)
    effects, untestable = _testable(names, surfaces, (*library, *own), held, ready.remarks)
    steady: dict[str, float] = {}
    if ready.unknown_w:
        steady = _shares_of(np.full(ready.seconds().shape, ready.unknown_w), _level(ready.gradients))
        if not steady:
            held.add("standby_load")
    columns: list[dict[str, Array]] = [{} for _ in ready.runs]
    charged = float(np.mean(ready.measured_w() < 0.0))
    candidates: list[Candidate] = []
    unlogged = tuple(f"component_power:{c}" for c in ready.unknown), ready.unknown_w
    off = never_on(model, ready)
    for effect in effects.values():
        candidate = _add_columns(effect, covariates, columns, charged)
        if candidate.covariate not in names or candidate.covariate.startswith(("on_time_", "starts")):
            candidate = replace(candidate, covariate=logged_name(candidate.covariate))
        if not effect.drive:
            candidate = replace(candidate, unlogged=unlogged, never_on=off)
        candidates.append(_with_twin(candidate, columns, ready.gradients))
    data = ready.data(columns)
    return Features(
        battery,
        data,
        tuple(candidates),
        {name: p.prior_sd for name, p in ready.parameters.items()},
        ready.parameters,
        effects,
        untestable,
        tuple(dict.fromkeys(ready.remarks)),
        covariates=tuple(covariates),
        unlogged=ready.unknown,
        steady=steady,
    )


def steady_speed(run: Run) -> Run:
    """A run whose speed, logged in slow rows, has its noise averaged out over neighbours that agree within it.

    That noise goes into base and effects but not into the power, and pulls coefficients down, those of steep curves
    most (errors in variables, Carroll et al. 2006). Ramps and steps stay as they are (sigma filter in two passes), and
    so does a speed that moves on as it moved before, as in traffic: that is no noise.
    """
    row_s = float(np.median(np.diff(run.time_s)))
    if "speed_m_s" not in run.columns or row_s < SLOW_ROWS_S:
        return run
    speed = run.number("speed_m_s")
    moving = speed != 0
    step = np.diff(speed)[moving[1:] | moving[:-1]]
    turn = np.diff(speed, 2)[moving[1:-1] | (moving[2:] & moving[:-2])]
    if not len(turn):
        return run
    typical, level = float(np.median(np.abs(step))), float(np.median(np.abs(speed[moving])))
    if not (0.0 < typical < SPEED_NOISY * level and np.median(np.abs(turn)) > SPEED_JUMPS_BACK * typical):
        return run
    near = SPEED_AGREE * typical
    going = np.abs(speed) > near  # what starts or stops keeps its instant, and noise near rest moves no steep curve
    for rows in (SPEED_ROWS, round(SPEED_AVERAGED_S / row_s)):
        total, count = speed.copy(), np.ones_like(speed)
        for shift in range(1, min(rows, len(speed) - 1) + 1):
            alike = (np.abs(speed[shift:] - speed[:-shift]) <= near) & going[shift:] & going[:-shift]
            total[shift:] += alike * speed[:-shift]
            count[shift:] += alike
            total[:-shift] += alike * speed[shift:]
            count[:-shift] += alike
        speed = total / count
        near /= np.sqrt(2 * SPEED_ROWS + 1)  # what the first pass leaves of the noise: ends of ramps stand out now
    return replace(run, columns={**run.columns, "speed_m_s": speed})


def effect_columns(effects: Mapping[str, Effect], candidates: Sequence[Candidate], cov: Covariates) -> dict[str, Array]:
    """Every candidate column for given covariates, such as those of a manoeuvre; power for coefficient 1 [W]."""
    found: dict[str, Array] = {}
    for candidate in candidates:
        effect = effects[candidate.effect]
        for i, name in enumerate(candidate.columns):
            shape = candidate.shape[i] if candidate.shape else {}
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


def _held(model: PowerModel, battery: str) -> set[str]:
    held = {term.effect.id for term in model.of(battery) if not term.base}
    return held | {family for id in held if (family := id.partition(":")[0]) in FLOORS}


def _components(names: set[str], switchable: Sequence[str]) -> dict[str, bool]:
    """Components to test and whether their ``on_`` column is logged."""
    logged = sorted(name[3:] for name in names if is_switch(name))
    return {**dict.fromkeys(switchable, False), **dict.fromkeys(logged, True)}


def _testable(
    names: set[str], surfaces: tuple[str, ...], library: Sequence[Effect], skip: set[str], remarks: list[str]
) -> tuple[dict[str, Effect], dict[str, tuple[str, ...]]]:
    untestable: dict[str, tuple[str, ...]] = {}
    effects: dict[str, Effect] = {}
    if len(surfaces) > MOST_SURFACES:
        remarks.append(f"{len(surfaces)} different surfaces, more than {MOST_SURFACES}: what they add is not tested")
        skip = skip | {*FLOORS}
    if len(surfaces) == 1:
        remarks.append(f"all runs are on one surface ({surfaces[0]}): its resistance is part of rolling friction")
    for effect in library:
        if effect.id in skip or effect.execution:
            continue
        lacking = tuple(dict.fromkeys(logged_name(name) for name in effect.needs if name not in names))
        if lacking:
            untestable[effect.id] = lacking
        else:
            effects[effect.id] = effect
    for id in FLOORS:
        if not surfaces and id not in skip:
            untestable[id] = tuple(name for name in floors_effect(id, ()).needs if name not in names)
    for effect in execution_effects():
        untestable[effect.id] = ("mission", *(name for name in effect.needs if name not in names))
    return effects, untestable


def _add_columns(
    effect: Effect, runs: Sequence[Covariates], columns: list[dict[str, Array]], charged: float
) -> Candidate:
    """Evaluate an effect on every run; a grid of shape values or of surfaces gives one column each."""
    shape: tuple[dict[str, float], ...] = ()
    levels: tuple[str, ...] = ()
    grid = _grid(effect, runs, charged)
    if effect.parts:
        levels = tuple(part.removeprefix("k_") for part in effect.parts)
        names = tuple(f"{effect.id}|{level}" for level in levels)
    elif grid:
        shape = tuple(grid)
        names = tuple(f"{effect.id}|{i}" for i in range(len(shape)))
    else:
        names = (effect.id,)
    for cov, held in zip(runs, columns, strict=True):
        for i, name in enumerate(names):
            held[name] = _column(effect, cov, shape[i] if shape else {}, levels[i] if levels else "")
    refit: Callable[[Mapping[str, float]], list[Array]] | None = None
    if shape:

        def refit(values: Mapping[str, float]) -> list[Array]:
            return [_column(effect, cov, values) for cov in runs]

    return Candidate(
        effect.id,
        names,
        effect.sign,
        effect.coefficient.unit,
        "k" if levels else effect.coefficient.name,
        shape,
        None,
        refit,
        covariate=effect.covariate,
        levels=levels,
        by_clock=bool(effect.memory) or effect.impulse is not None,
        # of a robot whose mass nobody knows the coefficient is a mass
        plausible=effect.coefficient.plausible if not effect.recovers or "body_mass_kg" in runs[0] else math.inf,
        shape_bounds={spec.name: (spec.low, spec.high) for spec in effect.shape if shape and spec.name in shape[0]},
    )


def _grid(effect: Effect, runs: Sequence[Covariates], charged: float) -> list[dict[str, float]]:
    """All combinations of the grids of an effect's shape parameters that these runs can tell."""
    from itertools import product

    asked = [spec for spec in effect.shape if spec.grid or not spec.optional]
    free = [spec for spec in asked if spec.name != effect.back or _tells_back(effect, runs, charged)]
    axes = [spec.grid or _default_grid(spec.low, spec.high, spec.default) for spec in free]
    return [dict(zip((spec.name for spec in free), values, strict=True)) for values in product(*axes)] if free else []


def _tells_back(effect: Effect, runs: Sequence[Covariates], charged: float) -> bool:
    """Whether the share that an effect gives back is asked of the data: only where the robot file leaves it to them.

    A descent first saves what the drive needs; where the battery is never charged there is no more to tell.
    """
    decided = any(float(cov.get("regeneration", 0.0)) > 0.0 for cov in runs)
    return not decided and (effect.one_sided or charged >= CHARGED)


def _default_grid(low: float, high: float, default: float) -> tuple[float, ...]:
    if np.isfinite(low) and np.isfinite(high):
        if low > 0.0 and high / low > 10.0:
            return tuple(float(x) for x in np.geomspace(low, high, 5)[1:-1])
        return tuple(float(x) for x in np.linspace(low, high, 5)[1:-1])
    return (default if np.isfinite(default) else 1.0,)


def _steady(column: str, names: set[str], runs: Sequence[Covariates]) -> bool:
    """Whether a column hardly changes over all runs."""
    values = np.concatenate([np.asarray(cov[column], dtype=float) for cov in runs]) if column in names else None
    return values is not None and float(np.std(values)) < STEADY * abs(float(np.mean(values)))


def _loads(names: set[str], batteries: Sequence[str], runs: Sequence[Covariates], ready: Prepared) -> tuple[str, ...]:
    """Columns of watts that may be loads of the battery, without those that are its own power under another name."""
    found = []
    measured = ready.measured_w()
    for name in logged_power_columns(names, batteries):
        own = np.concatenate([np.asarray(cov[name], dtype=float) for cov in runs])
        both = np.isfinite(own) & np.isfinite(measured)
        if not np.ptp(own[both]) > 0.0:
            continue
        if np.ptp(measured[both]) > 0.0 and abs(np.corrcoef(own[both], measured[both])[0, 1]) > SAME_METER:
            ready.remarks.append(f"{name} follows the measured power: that power once more, not a load beside it")
            continue
        found.append(name)
    return tuple(found)


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
    names = [name for name in gradients[0] if any(np.any(g[name]) for g in gradients)]
    y = np.concatenate([c[candidate.columns[0]] for c in columns])
    own = f"{candidate.effect.partition(':')[2]}."
    # a component that was never switched looks like the base: each effect is first held against its own kind
    kin = [n for n in names if (n.startswith(own) if len(own) > 1 else "." not in n)]
    for group in (kin, names):
        twin = _imitator(y, group, gradients)
        if twin is not None:
            return replace(candidate, prior=twin, sign=0)
    return candidate


def _imitator(y: Array, names: Sequence[str], gradients: Sequence[Mapping[str, Array]]) -> str | None:
    """The base parameter that takes the largest part in an exact imitation of a column; None where none is exact."""
    shares = _shares_of(y, [{name: own[name] for name in names} for own in gradients])
    size = {name: float(sum(own[name] @ own[name] for own in gradients)) ** 0.5 for name in shares}
    return max(shares, key=lambda name: abs(shares[name]) * size[name], default=None)


def _level(gradients: Sequence[Mapping[str, Array]]) -> list[dict[str, Array]]:
    """Gradients of the parameters that are a constant power wherever they act."""
    whole = {name: np.concatenate([own[name] for own in gradients]) for name in gradients[0]}
    acting = {name: values[values != 0.0] for name, values in whole.items()}
    kept = [name for name, values in acting.items() if len(values) and np.ptp(values) <= 1e-9 * np.max(np.abs(values))]
    return [{name: own[name] for name in kept} for own in gradients]


def _shares_of(y: Array, gradients: Sequence[Mapping[str, Array]]) -> dict[str, float]:
    """Relative changes of base parameters that together imitate a column exactly; none where nothing does."""
    names = [name for name in gradients[0] if any(np.any(own[name]) for own in gradients)]
    if not names or not np.any(y):
        return {}
    x = np.column_stack([np.concatenate([own[name] for own in gradients]) for name in names])
    size = np.linalg.norm(x, axis=0)
    coefficients, *_ = np.linalg.lstsq(x / size, y, rcond=1e-9)
    left = y - (x / size) @ coefficients
    if float(left @ left) > 1e-6 * float(y @ y):
        return {}
    return dict(zip(names, (float(c) for c in coefficients / size), strict=True))

"""A run drives the power model: modelled beside measured power, row by row, whatever is missing assumed and said.

This is the only way to drive a model with a run, for compare, fits and the diagnosis alike.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from itertools import chain, pairwise
from typing import Any

import numpy as np

from missionsim.effects import covariates as derived
from missionsim.effects.model import PowerModel, TermKey
from missionsim.errors import InputError
from missionsim.labels import Labels
from missionsim.physics import Array, Int64s
from missionsim.physics.lag import Meter, lagged, metered
from missionsim.runs.covariates import ASSUMED, clock_of, is_switch
from missionsim.runs.run import Run

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
            # a clock follows from a component that counts as off
            told_by = {*own_assumed, *(clock_of(name) for name in own_assumed if is_switch(name))}
            unknown = " and ".join(name for name in lacking if name not in told_by)
            if unknown and term.base:
                skip = f"its {term.key.component} ({term.key.name}) needs the column {unknown}"
                break
            if unknown:
                kept = tuple(other for other in kept if other.key != term.key)
                notes.append(f"{battery}: the effect {term.key.name} is left out: the log has no {unknown}")
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


MOST_MISSING = 0.2
"""Part of a column's rows that may be missing and are filled from their neighbours."""
METER_PAST_S = 60.0
"""Time before a block that its meter may remember."""


@dataclass(frozen=True)
class Driven:
    """A run, or a block of one, with modelled power."""

    run: Run
    time_s: Array
    """Time since the start of the run. Shape (n,)."""
    model: PowerModel
    """The terms that could be evaluated."""
    covariates: Mapping[str, Any]
    """Columns of the run, what follows from them, and the robot's constants."""
    measured_w: Mapping[str, Array]
    model_w: Mapping[str, Array]
    """Both: the model as the meter shows it: as late and sluggish as the robot file says; where the meter is slower
    than the rows, averaged over each reading, which then counts once. Mapping of battery to ndarray, shape (n,)."""
    terms: Mapping[str, Mapping[TermKey, Any]]
    """Modelled power by term, at the rate of the rows. Mapping of battery to mapping of TermKey to ndarray or float."""
    assumed: frozenset[str] = frozenset()
    """Covariates that were filled in, not logged."""
    _: KW_ONLY
    unknown: frozenset[str] = frozenset()
    """Switches among them of which nothing tells whether they were on."""

    @property
    def dt_s(self) -> Array:
        """Time that each row stands for [s], shape (n,)."""
        return self.run.dt_s

    def row_w(self, battery: str) -> Array:
        """Modelled power of each row, not averaged over readings of the meter [W], shape (n,)."""
        return np.asarray(sum(self.terms[battery].values(), start=np.zeros(len(self.time_s))), dtype=float)

    def shown_w(self, battery: str, row_w: Array, meter: Meter) -> Array:
        """A power of each row [W] as a meter shows it, shape (n,)."""
        return _shown(self.run, battery, row_w, meter)[1]

    def loads(self, battery: str) -> dict[str, Array]:
        """``drive_w`` and ``load_w``, which some effects read: power of the drive, and of everything [W]."""
        drive = {term.key for term in self.model.of(battery) if term.effect.drive}
        rows = np.zeros(len(self.time_s))
        own = (power for key, power in self.terms[battery].items() if key in drive)
        straight = rows + self.model.traction_w(self.covariates, battery)
        return {"drive_w": sum(own, start=rows), "traction_w": straight, "load_w": self.row_w(battery)}

    def check(self) -> None:
        """Raises InputError: where a term gives no number in some row, at the place of its formula."""
        rows, faults = len(self.time_s), []
        for battery, powers in self.terms.items():
            for key, watts in powers.items():
                bad = int(np.sum(~np.isfinite(np.broadcast_to(np.asarray(watts, dtype=float), (rows,)))))
                if bad:
                    place = next(term.effect.place for term in self.model.terms if term.key == key)
                    told = f"the power of '{key.name}' (battery '{battery}') is not a number in {bad} of {rows} rows"
                    told += f" of {self.run.run}"
                    faults.append(place.fault(told, allowed="a formula with a value in every row"))
        if faults:
            raise InputError(faults)

    def at(self, model: PowerModel) -> Driven:
        """The same rows driven by a model with the same terms and other values."""
        own = {term.key for term in self.model.terms}
        kept = replace(model, terms=tuple(term for term in model.terms if term.key in own))
        logged = self.run.columns
        cov = {**self.covariates, **{n: value for n, value in model.constants.items() if n not in logged}}
        return _evaluated(kept, tuple(self.terms), self.run, cov, self.assumed, self.unknown, None)

    def gradient(self, battery: str) -> dict[str, Array]:
        """``∂P/∂ln θ`` of each parameter of the terms that were evaluated."""
        return self.model.gradient(self.covariates, battery)


def drive(model: PowerModel, run: Run, battery: str) -> Driven:
    """Drive one battery's model with a whole run; `assume` and `drive_blocks` for runs that come in blocks. Raises
    InputError: where the base model of the battery needs a column that the run lacks and that has no plain meaning."""
    (driven,) = drive_blocks(
        assume(model, filled(run, model.batteries), [battery], source=run.source or run.run), [run]
    )
    return driven


def drive_blocks(plan: Assumed, blocks: Iterable[Run]) -> Iterator[Driven]:
    """Drive a model with a run in consecutive blocks, the memory of the model carried from block to block."""
    carry, model = _Carry(plan), plan.model
    switches = {*plan.switched, *(name for name in plan.assumed if is_switch(name))}
    filled_in = {*plan.assumed, *switches, *map(clock_of, switches)}
    before: Run | None = None
    last: Driven | None = None
    ahead: Iterator[Run | None] = chain((block for block in blocks if len(block.time_s)), [None])
    for block, after in pairwise(ahead):
        assert block is not None
        cov = model.complete(carry.derive(block, before, after))
        own = frozenset(filled_in - set(block.columns))
        driven = _evaluated(model, plan.batteries, block, cov, own, plan.unknown, last)
        before, last = block, driven if model.meters else None
        yield driven


def _evaluated(
    model: PowerModel,
    batteries: Sequence[str],
    block: Run,
    cov: Mapping[str, Any],
    filled: frozenset[str],
    unknown: frozenset[str],
    before: Driven | None,
) -> Driven:
    measured, modelled, terms = {}, {}, {}
    for battery in batteries:
        parts = model.evaluate(cov, battery=battery)[battery]
        total = np.broadcast_to(np.asarray(sum(parts.values(), start=0.0), dtype=float), block.time_s.shape)
        modelled[battery], terms[battery] = total, parts
        if battery not in block.power_w:
            continue
        measured[battery], modelled[battery] = _shown(block, battery, total, model.meter(battery), before)
    return Driven(block, cov["time_s"], model, cov, measured, modelled, terms, filled, unknown=unknown)


def _shown(run: Run, battery: str, row_w: Array, meter: Meter, before: Driven | None = None) -> tuple[Array, Array]:
    """Measured and modelled power of each row, each of shape (n,), the model as the meter shows it.

    A value that appears in a row of a meter slower than the rows was measured over the time since the one before, so
    it belongs to the rows since then; the model is averaged over them. Rows after the last reading keep it.
    """
    model_w, dt_s, fresh = row_w, run.dt_s, run.fresh.get(battery)
    if meter != Meter():
        time_s = run.time_s
        if before is not None:
            past = slice(max(0, before.run.rows - int(METER_PAST_S / max(float(before.dt_s[-1]), 1e-6))), None)
            time_s = np.concatenate([before.run.time_s[past], time_s])
            row_w = np.concatenate([before.row_w(battery)[past], row_w])
        model_w = metered(row_w, time_s, meter)[-run.rows :]
    if fresh is None:
        return run.power_w[battery], model_w
    readings = np.flatnonzero(fresh)
    reading: Int64s = np.cumsum(fresh) - fresh.astype(np.int64)
    last = np.append(readings, len(fresh) - 1)[reading]
    seconds = np.bincount(reading, dt_s)
    joules = np.bincount(reading, model_w * dt_s)
    return run.power_w[battery][last], np.asarray((joules / np.maximum(seconds, 1e-12))[reading])


def filled(run: Run, batteries: Sequence[str], remarks: list[str] | None = None) -> derived.Columns:
    """Covariates of a run without gaps: filled from their neighbours, left out where more than `MOST_MISSING` is gone.
    Both are said in `remarks`."""
    found: dict[str, Any] = {}
    for name, values in run.covariates(batteries).items():
        known = None if isinstance(values, Labels) else np.isfinite(values)
        if known is None or known.all():
            found[name] = values
            continue
        missing = 1.0 - float(known.mean())
        if missing > MOST_MISSING:
            told = f"column {name} is empty in {missing:.0%} of the rows and is left out"
        else:
            found[name] = np.interp(run.time_s, run.time_s[known], run.number(name)[known])
            told = f"{int((~known).sum())} missing values of {name} filled from their neighbours"
        if remarks is not None:
            remarks.append(f"{run.run}: {told}")
    return found


class _Carry:
    """What a block must know of the rows before it: clocks, whether the robot moved, the start of the run."""

    def __init__(self, plan: Assumed) -> None:
        self._plan = plan
        self._start_s: float | None = None
        self._noise_m_s: float | None = None
        self._clocks: dict[str, float] = {}
        self._on: dict[str, bool] = {}
        self._lags: dict[str, tuple[float, float, float]] = {}
        self._moving = True

    def derive(self, block: Run, before: Run | None, after: Run | None) -> dict[str, Any]:
        """Covariates of `block`; its neighbours only serve to smooth the speed across the seams."""
        if self._start_s is None:
            self._start_s = float(block.time_s[0])
        columns = filled(block, self._plan.model.batteries)
        if "speed_m_s" in columns and "accel_m_s2" not in columns:
            speed = np.asarray(columns["speed_m_s"], dtype=float)
            if self._noise_m_s is None:
                self._noise_m_s = derived.speed_noise(derived.between_refreshes(speed, block.time_s))
            rows = 2 * max(2, int(derived.WIDTHS_S[-1] / max(float(np.median(block.dt_s)), 1e-6)) + 1)
            tables = [(before, slice(-rows, None)), (block, slice(None)), (after, slice(0, rows))]
            parts = [(one.time_s[cut], one.columns["speed_m_s"][cut]) for one, cut in tables if one is not None]
            times_s = np.concatenate([part[0] for part in parts])
            speed = np.concatenate([np.asarray(part[1], dtype=float) for part in parts])
            first = 0 if before is None else len(before.time_s[-rows:])
            accel = derived.acceleration(speed, times_s, self._noise_m_s)
            columns["accel_m_s2"] = accel[first : first + len(block.time_s)]
        for name, value in self._plan.assumed.items():
            columns.setdefault(name, np.full(block.time_s.shape, value))
        for name, units in self._plan.switched.items():
            # units that are on under the scheme of each row; none where that is not told
            scheme = columns["scheme"]
            labels = scheme if isinstance(scheme, Labels) else Labels.of(np.asarray(scheme))
            known = np.array([*(units.get(one, 0.0) for one in labels.names), 0.0])
            columns[name] = np.nan_to_num(known)[labels.codes]
        if "speed_m_s" in columns:
            # asked for by every term of the drive
            columns.setdefault("moving", np.asarray(derived.is_moving(columns)))
        cov = derived.derive(columns, block.time_s, block.dt_s)
        cov["time_s"] = block.time_s - self._start_s
        if "moving_time_s" in cov and "moving_time_s" not in block.columns:
            motion = ("moving", "speed_m_s", "lateral_speed_m_s", "yaw_rate_rad_s")
            ends = ({name: np.asarray(cov[name])[row] for name in motion if name in cov} for row in (0, -1))
            begins, goes_on = (bool(derived.is_moving(end)) for end in ends)
            cov["moving_time_s"] = cov["moving_time_s"] + self._clocks.get("moving_time_s", 0.0)
            rest = 0.5 * float(block.dt_s[-1]) if goes_on else 0.0
            self._clocks["moving_time_s"] = float(cov["moving_time_s"][-1]) + rest
            if begins and not self._moving:
                cov["starts"][0] = 1.0
                cov["starts_per_s"][0] = 1.0 / max(float(block.dt_s[0]), 1e-9)
            self._moving = goes_on
        for name in [name for name in columns if is_switch(name)]:
            clock, on = clock_of(name), np.asarray(cov[name]) > 0.0
            if clock in block.columns or clock not in cov:
                continue
            if on[0] and self._on.get(name, False):
                stretch = int(np.argmin(on)) if not on.all() else len(on)
                cov[clock][:stretch] += self._clocks[clock]
            self._on[name] = bool(on[-1])
            self._clocks[clock] = float(cov[clock][-1] + 0.5 * block.dt_s[-1]) if on[-1] else 0.0
        model, time_s = self._plan.model, cov["time_s"]
        for name in (name for name, (term, _) in model.lags.items() if term.key.battery in self._plan.batteries):
            past = self._lags.get(name)
            signal = np.broadcast_to(np.asarray(model.lagging(name, cov, {}), dtype=float), time_s.shape)
            late = lagged(signal, time_s, float(model.time_constant(name, {})), past)
            self._lags[name] = time_s[-1], signal[-1], late[-1]
            if past is not None:  # in the first block the formula sees to it, whatever its parameters
                cov[name] = late
        return cov

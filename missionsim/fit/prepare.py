"""Logs and a power model as rows for a fit: base power and its gradient at the raw rate."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np

from missionsim.effects.covariates import Columns, is_moving
from missionsim.effects.model import ModelParameter, PowerModel
from missionsim.errors import InputError
from missionsim.identify.data import RunData
from missionsim.labels import Labels
from missionsim.numerals import watts
from missionsim.physics import Array
from missionsim.runs.covariates import clock_of, is_switch, may_be_cause
from missionsim.runs.drive import Driven, assume, drive_blocks, filled
from missionsim.runs.run import Run

MOST_TEXTS = 12
FAINT_LOAD = 0.01
"""Part of the mean power below which it does not matter when a component was on."""


def acting(gradients: Sequence[Mapping[str, Array]]) -> list[str]:
    """Parameters on which the power of some row depends, of the gradient of each run."""
    return [name for name in gradients[0] if any(np.any(own[name]) for own in gradients)]


@dataclass(frozen=True)
class Prepared:
    """Runs of one battery, with the base model evaluated."""

    battery: str
    runs: tuple[Driven, ...]
    names: frozenset[str]
    """Covariates that every run has; what was assumed is not among them."""
    texts: Mapping[str, tuple[str, ...]]
    """Distinct texts of each text column over all runs."""
    parameters: Mapping[str, ModelParameter]
    """Base parameters by their name within the battery."""
    remarks: list[str]
    """What was assumed or left out, in words."""
    _: KW_ONLY
    unknown: Mapping[str, float] = field(default_factory=dict)
    """Power of components of which nothing tells when they were on [W]."""

    @cached_property
    def base_w(self) -> tuple[Array, ...]:
        """Power of the base model of each run [W]."""
        return tuple(np.ascontiguousarray(run.row_w(self.battery)) for run in self.runs)

    @cached_property
    def gradients(self) -> tuple[Mapping[str, Array], ...]:
        """``∂P/∂ln θ`` by parameter, of each run [W]; a term that one run cannot drive has no power there."""
        slopes = [run.gradient(self.battery) for run in self.runs]
        every = dict.fromkeys(name for own in slopes for name in own)
        pairs = zip(self.runs, slopes, strict=True)
        return tuple({name: own.get(name, np.zeros(len(run.time_s))) for name in every} for run, own in pairs)

    @property
    def covariates(self) -> list[Columns]:
        """Covariates of each run, with the base model's loads."""
        return [{**run.covariates, **run.loads(self.battery)} for run in self.runs]

    def measured_w(self) -> Array:
        """Measured power of all rows of all runs [W]."""
        return np.concatenate([run.run.power_w[self.battery] for run in self.runs])

    def seconds(self) -> Array:
        """Time that each row of all runs stands for [s]."""
        return np.concatenate([run.dt_s for run in self.runs])

    def powers(self, model: PowerModel) -> list[Array]:
        """Power of a model with the same terms and other values in each run [W]."""
        return [run.at(model).row_w(self.battery) for run in self.runs]

    def at(self, model: PowerModel) -> Prepared:
        """The same rows driven by a model with the same terms and other values."""
        runs = tuple(run.at(model) for run in self.runs)
        return replace(self, runs=runs, parameters=model.parameters_of(self.battery))

    def data(self, columns: Sequence[Mapping[str, Array]] | None = None) -> tuple[RunData, ...]:
        """The runs as the identification reads them, with candidate columns where given."""
        found = []
        for i, (driven, base_w, slopes) in enumerate(zip(self.runs, self.base_w, self.gradients, strict=True)):
            run = driven.run
            broken = ~np.isfinite(base_w)
            for values in slopes.values():
                broken |= ~np.isfinite(values)
            measured = run.power_w[self.battery]
            if broken.any():
                told = f"the base model has no value in {int(broken.sum())} rows; they are left out"
                self.remarks.append(f"{run.run}: {told}")
                measured = np.where(broken, np.nan, measured)
                base_w = np.where(broken, 0.0, base_w)
                slopes = {name: np.where(broken, 0.0, values) for name, values in slopes.items()}
            own = {} if columns is None else columns[i]
            watched, fresh = _watched(driven, self.names, self.texts), run.fresh.get(self.battery)
            rows = (run.run, run.time_s, run.dt_s, measured, base_w, slopes, own, watched)
            at_rest = ~np.asarray(is_moving(driven.covariates)) if "speed_m_s" in driven.covariates else None
            found.append(RunData(*rows, fresh=fresh, begin_s=run.begin_s, at_rest=at_rest, texts=self.texts))
        return tuple(found)


def prepare(model: PowerModel, logs: Sequence[Run], battery: str) -> Prepared:
    """Covariates, base power and gradient of every run that measures a battery.

    Raises InputError: where no log measures the battery, or the base model needs a column that a log lacks and that has
    no plain meaning (see `missionsim.runs.drive.assume`).
    """
    tables = [log for log in logs if battery in log.power_w]
    if not tables:
        raise InputError.single(f"no log measures the battery '{battery}'", allowed=f"power_{battery}_w")
    remarks: list[str] = []
    told: dict[str, list[str]] = {}
    runs: list[Driven] = []
    for log in tables:
        columns = filled(log, model.batteries, remarks)
        plan = assume(model, columns, [battery], source=log.source or log.run)
        for note in plan.notes:
            told.setdefault(note, []).append(log.run)
        runs += drive_blocks(plan, [log])
    remarks += [note if len(of) == len(tables) else f"{_named(of)}: {note}" for note, of in told.items()]
    names = _shared_names(runs, remarks)
    texts: dict[str, tuple[str, ...]] = {}
    for name in sorted(names):
        values = [run.covariates[name] for run in runs]
        if all(isinstance(value, Labels) for value in values):
            used = {value.names[int(code)] for value in values for code in np.unique(value.codes) if code >= 0}
            texts[name] = tuple(sorted(used))
    unknown = _switched_w(model, battery, set().union(*(run.unknown for run in runs)))
    measured_w = np.concatenate([run.run.power_w[battery] for run in runs])
    if sum(unknown.values()) < FAINT_LOAD * abs(float(np.nanmean(measured_w))):
        unknown = {}
    elif unknown:
        remarks.append(
            f"nothing tells when {', '.join(unknown)} ({watts(sum(unknown.values()))}) was on: what a load of that "
            "size imitates is not named with confidence; log its on_<component> column, or the control scheme"
        )
    return Prepared(
        battery, tuple(runs), frozenset(names), texts, model.parameters_of(battery), remarks, unknown=unknown
    )


def _switched_w(model: PowerModel, battery: str, switches: set[str]) -> dict[str, float]:
    """What each component draws [W] while its switch is on; those that draw nothing are left out."""
    terms = tuple(term for term in model.of(battery) if term.effect.covariate in switches)
    drawn = replace(model, terms=terms).evaluate(dict.fromkeys(switches, 1.0), battery=battery)[battery]
    return {key.component: abs(float(w)) for key, w in drawn.items() if abs(float(w)) > 0.0}


def never_on(model: PowerModel, ready: Prepared) -> dict[str, float]:
    """Effects of the components whose switch is logged and never on, and what each draws [W]: is the column stuck?"""
    switches = {name for name in ready.names if is_switch(name)}
    still = {name for name in switches if not any(np.any(run.covariates[name]) for run in ready.runs)}
    logged = {name for name in still if not any(name in run.assumed for run in ready.runs)}
    return {f"component_power:{name}": w for name, w in _switched_w(model, ready.battery, logged).items()}


def _named(runs: Sequence[str]) -> str:
    return ", ".join(runs[:3]) + (" …" if len(runs) > 3 else "")


def _shared_names(runs: Sequence[Driven], remarks: list[str]) -> set[str]:
    """Covariates that every run has, logged and not assumed; a missing ``on_…`` counts as switched off."""
    known = [set(run.covariates) - run.assumed for run in runs]
    every = set.union(*known)
    each = [(own, run.covariates) for own, run in zip(known, runs, strict=True)]
    text = [{isinstance(columns[name], Labels) for own, columns in each if name in own} for name in every]
    mixed = {name for name, kinds in zip(every, text, strict=True) if len(kinds) > 1}
    remarks += [f"{name} is text in some runs and a number in others: left out" for name in sorted(mixed)]
    for name, run in product(mixed, runs):
        assert isinstance(run.covariates, dict)
        run.covariates.pop(name, None)
    known, every = [own - mixed for own in known], every - mixed
    found = set.intersection(*known)
    for name in sorted(every - found):
        lacking = [run for run, own in zip(runs, known, strict=True) if name not in own]
        if is_switch(name):
            for run in lacking:
                assert isinstance(run.covariates, dict)
                run.covariates.setdefault(name, np.zeros(len(run.time_s)))
                run.covariates.setdefault(clock_of(name), np.zeros(len(run.time_s)))
            found |= {name, clock_of(name)}
            off = [run for run in lacking if not np.any(run.covariates[name])]
            if off:
                told = _named([run.run.run for run in off])
                remarks.append(f"{name} is not logged in {told}: counted as switched off there")
        elif may_be_cause(name):
            remarks.append(
                f"{name} is not logged in {_named([r.run.run for r in lacking])}: effects that need it are not tested"
            )
    return found


def _watched(run: Driven, names: frozenset[str], known: Mapping[str, tuple[str, ...]]) -> dict[str, Array]:
    """Covariates that the remaining error may depend on; text columns as their number in `known`."""
    found: dict[str, Array] = {}
    for name in sorted(names):
        if not may_be_cause(name):
            continue
        value = run.covariates[name]
        if isinstance(value, Labels):
            order = {text: i for i, text in enumerate(known[name])}
            if 1 < len(order) <= MOST_TEXTS:
                codes = np.array([*(order.get(text, -1) for text in value.names), -1])
                found[name] = codes[value.codes].astype(float)
        elif np.shape(value) == run.time_s.shape:
            found[name] = np.asarray(value, dtype=float)
    return found

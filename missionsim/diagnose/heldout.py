"""Errors on runs that were not used to fit, of the very models that a robot file would hold.

`Models` is the one place where numbers that are written come from: `add-effect` and `improve` write them, `diagnose`
names them, and every held-out error is theirs, measured as `missionsim.runs.error` says.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from missionsim.diagnose.features import Features
from missionsim.diagnose.split import beyond, parts_of
from missionsim.effects.library import FLOORS, get_effect
from missionsim.effects.model import ModelParameter, PowerModel, Term, TermKey
from missionsim.fit.final import CLEARLY, FREE_SD, FinalFit, final_fit, of_formula
from missionsim.identify.align import Clock
from missionsim.identify.design import Source, TooShortError
from missionsim.identify.estimates import Z95
from missionsim.identify.findings import Estimate, Finding, HeldOut, Recalibrated
from missionsim.identify.settings import SEVERAL_RUNS, SHIFTED_MEAN_RATIO, SHIFTED_RATIO, Settings
from missionsim.labels import Labels
from missionsim.numerals import rounded
from missionsim.physics import Array
from missionsim.runs.drive import drive
from missionsim.runs.error import Errors, errors_of
from missionsim.runs.run import Run

KINDS = ("nominal", "recalibrated", "with_effects")
MOST_LOST = 0.5
"""Part of the energy that a resistance on the way takes at most (maximum power transfer)."""
LEFT = 0.05
"""Part of its size to which a coefficient of motion falls where an effect takes its place (assumed)."""
PARTS = 4
"""Of the runs, each predicted from the others: with fewer, each would be fitted to too few runs of a floor."""


@dataclass(frozen=True)
class Models:
    """A robot's model with effects or without, fitted to runs."""

    power: PowerModel
    """As the robot file is."""
    battery: str
    features: Features
    """Of the fitted runs, with the effects behind the candidates and the priors of the base."""
    runs: tuple[Run, ...]
    """Fitted runs."""
    clock: Clock
    """Delay and lag of the meter that were found."""
    settings: Settings
    _fits: dict[tuple[Any, ...], FinalFit] = field(default_factory=dict, repr=False, compare=False)

    def fit(
        self,
        effects: Sequence[Finding],
        *,
        runs: Sequence[Run] | None = None,
        fixed: bool = False,
        keep_base: bool = False,
    ) -> FinalFit:
        """Fit the base with some effects.

        `effects`: with start values and shape parameters; `runs`: other runs than all fitted ones; `fixed`: whether the
        effects stay as they are and only the base is fitted; `keep_base`: whether only the effects are fitted.
        """
        numbers = [(effect.effect, *((n, e.value) for n, e in effect.parameters.items())) for effect in effects]
        names = None if runs is None else tuple(run.run for run in runs)
        asked = (tuple(numbers), names, fixed, keep_base)
        if asked in self._fits:
            return self._fits[asked]
        terms, priors = [], dict(self.features.prior_sd)
        for effect in effects:
            if twin := self.lowers(effect):
                priors[twin] = FREE_SD
                continue
            if effect.effect in FLOORS:  # scrub by floor is a hypothesis only after scrub was found
                own = get_effect(effect.effect, tuple(name.removeprefix("k_") for name in effect.parameters))
            else:
                own = self.features.effects[effect.effect]
            values = {name: ModelParameter(e.value or 1e-9, e.unit) for name, e in effect.parameters.items()}
            asked_of = (s for s in own.shape if s.name not in values and s.grid and not s.optional)
            values |= {s.name: ModelParameter(s.default, s.unit) for s in asked_of}
            terms.append(Term(TermKey(self.battery, own.component, effect.effect), own, values, base=False))
        model = replace(self.power, terms=(*self.power.terms, *terms))
        kept = [name for name, parameter in self.features.parameters.items() if not parameter.path]
        if fixed:
            kept += [term.name_of(name) for term in terms for name in term.parameters]
        self._fits[asked] = final_fit(
            model,
            self.runs if runs is None else runs,
            self.battery,
            priors,
            self.clock,
            self.settings,
            fixed=kept,
            keep_base=keep_base,
        )
        return self._fits[asked]

    @cached_property
    def parts(self) -> tuple[Run, ...]:
        """Of a single run: there is no other that it could be predicted from."""
        return tuple(parts_of(self.runs[0], PARTS))

    @cached_property
    def unheld(self) -> Models:
        """The same with a base that takes what it can, where something is seen that these data cannot name."""
        free = dict.fromkeys(self.features.prior_sd, FREE_SD)
        return replace(self, features=replace(self.features, prior_sd=free), _fits={})

    def lowers(self, effect: Finding) -> str:
        """The base parameter that an effect takes something off, so that there is no effect to add; else empty."""
        twin = next((c.prior for c in self.features.candidates if c.effect == effect.effect), None)
        first = next(iter(effect.parameters.values()))
        return twin if twin is not None and first.value < 0.0 else ""

    def told(self, effects: Sequence[Finding], fitted: FinalFit) -> tuple[Finding, ...]:
        """The effects with the coefficients of a fit; their intervals hold the noise model's and those of the runs."""
        told = []
        for effect in effects:
            if self.lowers(effect):
                told.append(effect)
                continue
            parameters = dict(effect.parameters)
            for name, old in effect.parameters.items():
                if (new := fitted.values.get(f"{effect.effect}.{name}")) is not None:
                    half = max(0.5 * (old.high - old.low), Z95 * new.sd)
                    parameters[name] = Estimate(new.value, new.value - half, new.value + half, old.unit)
            sizes = [n for n in parameters if n != "regeneration" and f"{effect.effect}.{n}" in fitted.values]
            before, after = (sum(some[n].value for n in sizes) for some in (effect.parameters, parameters))
            times = after / before if before else 1.0
            reach = 0.5 * (effect.share_high - effect.share_low) * max(1.0, abs(times))
            share = effect.energy_share * times
            if len(sizes) == 1 and after:  # one number, one interval
                own = parameters[sizes[0]]
                reach = max(reach, abs(share) * 0.5 * (own.high - own.low) / abs(after))
            low, high = share - reach, share + reach
            told.append(replace(effect, parameters=parameters, energy_share=share, share_low=low, share_high=high))
        return tuple(told)

    def leaning(self, effects: Sequence[Finding], fitted: FinalFit) -> tuple[Finding, ...]:
        """The effects, with what of the formula of motion falls below nothing, or to hardly anything, beside each in
        this fit, and with what each gives back."""
        formula = {name: one.value for name, one in self.features.parameters.items() if of_formula(one)}
        fits = {name: fitted.values[name] for name in formula if name in fitted.values}
        below = {name: new for name, new in fits.items() if new.value < max(0.0, LEFT * formula[name])}
        library = self.features.effects
        back = _given_back(
            self, [e.effect for e in effects if e.effect in library and library[e.effect].recovers], fitted
        )
        told = []
        for effect in effects:
            without = self.fit([one for one in effects if one is not effect]).values if below else {}
            falls = [
                f"beside it {name} of the base falls {'below nothing' if new.value < 0.0 else 'to hardly anything'}, "
                f"from {rounded(without[name].value)} to {rounded(new.value)}: the two together are one curve, which "
                "something else that is missing may bend so"
                for name, new in below.items()
                if name in without and new.value + Z95 * new.sd < without[name].value
            ]
            told.append(replace(effect, leans="; ".join(falls), back=back.get(effect.effect, 0.0)))
        return tuple(told)

    def of_all_braking(self, effects: Sequence[Finding]) -> tuple[Finding, ...]:
        """The effects as they act where braking first relieves the drive, if that predicts left-out runs better.

        Each alone, braking and a descent give back a share of their own power; together they act on the force at the
        wheels, and only what is beyond the drive's need comes back. The difference looks like heat in the windings,
        which has to predict left-out runs better beside the new form to stay.
        """
        back = [one for one in effects if (e := one.parameters.get("regeneration")) is not None and e.value > 0.0]
        if not back:
            return tuple(effects)
        relief = Estimate(1.0, 1.0, 1.0, "1")
        new = [replace(e, parameters={**e.parameters, "relief": relief}) if e in back else e for e in effects]
        cold = [effect for effect in new if effect.effect != "copper_loss"]
        errors = [self.of_others(some) for some in (effects, new, cold)]
        if min(errors[1:]) > errors[0]:
            return tuple(effects)
        return tuple(cold if errors[2] <= errors[1] * (1.0 + CLEARLY) else new)

    def of_the_way_ahead(self, effects: Sequence[Finding]) -> tuple[Finding, ...]:
        """The effects as they act where braking and descents relieve what driving straight ahead needs and not what
        turning does, if that predicts left-out runs clearly better: tyres that slide sideways have no use for it."""
        library = self.features.effects
        own = [one for one in effects if (e := library.get(one.effect)) is not None and e.recovers]
        drive = [
            *(t.effect for t in self.power.of(self.battery)),
            *(library[e.effect] for e in effects if e.effect in library),
        ]
        if not own or not any(e.stage == 0 and "yaw_rate_rad_s" in e.needs for e in drive):
            return tuple(effects)
        ahead = Estimate(1.0, 1.0, 1.0, "1")
        new = [replace(e, parameters={**e.parameters, "ahead": ahead}) if e in own else e for e in effects]
        before, after = self.of_others(effects), self.of_others(new)
        return tuple(new if after < (1.0 - CLEARLY) * before else effects)

    def needed_beside(self, law: Finding, effects: Sequence[Finding]) -> tuple[Finding, ...]:
        """The effects without which left-out runs are predicted clearly worse, a law being there as well."""
        kept = list(effects)
        for effect in effects:
            if not self._needed(effect, [*kept, law]):
                kept = [one for one in kept if one is not effect]
        return tuple(kept)

    def of_others(self, effects: Sequence[Finding]) -> float:
        """Mean square error of parts of the runs, or of a single run, predicted from a fit to the others [W2]."""
        runs = self.runs if len(self.runs) > 1 else self.parts
        count = min(len(runs), PARTS)
        errors = []
        for i in range(count):
            others = [run for k, run in enumerate(runs) if k % count != i]
            errors.append(self.errors(self.fit(effects, runs=others).model, runs[i::count]))
        return float(np.average([e.power_rmse_w**2 for e in errors], weights=[e.total.seconds for e in errors]))

    def certain(
        self, effects: Sequence[Finding], spared: int = 1, least: float = 0.0
    ) -> tuple[tuple[Finding, ...], FinalFit]:
        """The effects with the coefficients of the last fit, and that fit; what came to nothing in it and is not needed
        goes again, but for the first `spared` of at least some share of the energy; so does a loss of more than half of
        it, which no resistance on the way can take. Of a single run, each goes without
        which its parts are predicted as well."""
        while True:
            fitted = self.fit(effects)
            told = self.told(effects, fitted)
            asked = [one for i, one in enumerate(told) if i >= spared or abs(one.energy_share) < least]
            nothing = [one for one in asked if one.may_be_nothing and not self.lowers(one)]
            # levels of a label may differ and sum to nothing, and what hides behind the base may be needed all the same
            nothing = [one for one in nothing if not self._needed(one, told)]
            # the square of a load imitates products of speed, turning and cold
            library = self.features.effects
            lossy = [one for one in told if (own := library.get(one.effect)) is not None and own.of_load]
            nothing += [one for one in lossy if one.energy_share > MOST_LOST]
            if len(self.runs) == 1:
                nothing += [one for one in told if not self._needed(one, told, 0.0)]
            if not nothing:
                return told, fitted
            smallest = min(nothing, key=lambda one: abs(one.energy_share)).effect
            effects = [one for one in effects if one.effect != smallest]

    def _needed(self, effect: Finding, effects: Sequence[Finding], clearly: float = CLEARLY) -> bool:
        """Whether other runs are predicted worse without it, by a part `clearly` of the squared error."""
        rest = [one for one in effects if one is not effect]
        return self.of_others(rest) > (1.0 + clearly) * self.of_others(effects)

    def errors(self, model: PowerModel, runs: Sequence[Run]) -> Errors:
        """Errors of a model on runs."""
        return errors_of(model, runs, self.battery)

    def held_out(self, models: Sequence[PowerModel], runs: Sequence[Run], how: str, shifted: bool = False) -> HeldOut:
        """Errors of models, in the order of `KINDS`, on runs that they were not fitted to."""
        errors = {kind: self.errors(model, runs) for kind, model in zip(KINDS, models, strict=True)}
        energy_pct = {kind: one.run_energy_error_pct for kind, one in errors.items()}
        rmse_w = {kind: one.power_rmse_w for kind, one in errors.items()}
        names = tuple(run.run for run in runs)
        labels, numbers = beyond([run for run in self.runs if run.run not in names], runs)
        return HeldOut(how, names, energy_pct, rmse_w, shifted or bool(labels), (*labels, *numbers))

    def without(self, effects: Sequence[Finding], runs: Sequence[Run]) -> dict[str, float]:
        """Power RMSE on runs with every effect but one, the rest fitted again, by the effect that is left out [W]."""
        found = {}
        for one in effects:
            rest = [effect for effect in effects if effect is not one]
            found[one.effect] = self.errors(self.fit(rest).model, runs).power_rmse_w
        return found

    def shifted(self, effects: Sequence[Finding]) -> HeldOut | None:
        """Errors on runs that differ in kind: those with most of the main effect's covariate are left out.

        Only where enough runs differ in it and the others are long enough. Sizes of effects and base are fitted again
        on the others; names of effects, clock and shapes stay those of all runs.
        """
        features = self.features
        if not effects or len(features.runs) <= SEVERAL_RUNS:
            return None
        main = effects[0].effect
        covariate = next((c.covariate for c in features.candidates if c.effect == main), "")
        if not all(covariate in run.covariates for run in features.runs):
            return None
        if isinstance(features.covariates[0].get(covariate), Labels):
            return None
        level = np.array([float(np.average(np.abs(r.covariates[covariate]), weights=r.dt_s)) for r in features.runs])
        count = max(1, len(level) // 3)
        order = np.argsort(level, kind="stable")
        held, kept = order[-count:], order[:-count]
        if (
            level[held].min() < SHIFTED_RATIO * level[kept].max()
            and level[held].mean() < SHIFTED_MEAN_RATIO * level[kept].mean()
        ):
            return None
        names = [features.runs[i].run for i in held]
        others, out = ([run for run in self.runs if (run.run in names) == left] for left in (False, True))
        try:
            models = (self.power, self.fit((), runs=others).model, self.fit(effects, runs=others).model)
        except TooShortError:
            return None
        how = f"the {'run' if count == 1 else f'{count} runs'} with most {covariate} left out and predicted"
        return self.held_out(models, out, how, True)

    def recalibrated(self, fitted: FinalFit) -> tuple[Recalibrated, ...]:
        """Shifts of the base parameters with their values, largest first in prior standard deviations."""
        prior_sd, rows = self.features.given_sd or self.features.prior_sd, []
        for name, new in fitted.values.items():
            if (own := self.features.parameters.get(name)) is None:
                continue
            shift = new.value / own.value - 1.0
            parts = [float(np.mean(np.abs(run.gradient[name]))) for run in self.features.runs if name in run.gradient]
            rows.append(
                Recalibrated(
                    parameter=name,
                    shift=shift,
                    shift_sd=new.sd / abs(own.value),
                    shift_in_prior_sd=shift / prior_sd[name],
                    value=new.value,
                    sd=new.sd,
                    unit=own.unit,
                    power_w=float(np.mean(parts)) if parts else float("nan"),
                )
            )
        return tuple(sorted(rows, key=lambda row: -abs(row.shift_in_prior_sd)))

    def averaged(self, model: PowerModel, source: Source, clock: Clock) -> Array:
        """Power of a model at the rate of the analysis [W], shape (n,)."""
        raw = [drive(model, self.runs[i], self.battery).row_w(self.battery)[None, :] for i in source.kept]
        return np.asarray(source.averaged(raw, clock)[0])


def _given_back(models: Models, names: Sequence[str], fitted: FinalFit) -> dict[str, float]:
    """Part of the measured energy that each of some terms gives back."""
    back_j, measured_j = dict.fromkeys(names, 0.0), 0.0
    for run in models.runs if names else ():
        driven = drive(fitted.model, run, models.battery)
        measured_j += float(driven.measured_w[models.battery] @ run.dt_s)
        for key, watts in driven.terms[models.battery].items():
            if key.name in back_j:
                back_j[key.name] -= float(np.minimum(watts, 0.0) @ run.dt_s)
    return {name: joules / measured_j for name, joules in back_j.items() if measured_j > 0.0}

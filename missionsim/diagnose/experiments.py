"""What to drive next (step 6): manoeuvres scored by how well they would tell the effects of a set apart."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from missionsim.diagnose.features import Features, effect_columns
from missionsim.diagnose.manoeuvres import Manoeuvre, Site, library, script, shortened
from missionsim.effects.model import PowerModel
from missionsim.fit.prepare import prepare
from missionsim.identify.data import Constraints, RunData
from missionsim.identify.design import make_source
from missionsim.identify.findings import Experiment, Finding, Unexplained
from missionsim.identify.forward import Choice
from missionsim.identify.gram import Gram, make_gram, single_gains
from missionsim.identify.model import Model
from missionsim.identify.settings import BETTER_NATS, DECIDED_NATS, ENOUGH_NATS, LENGTHS, MOST_PROPOSED, Settings
from missionsim.runs.run import Run


@dataclass(frozen=True)
class Bench:
    """Everything needed to score a manoeuvre without driving it."""

    power: PowerModel
    features: Features
    choice: Choice
    site: Site
    settings: Settings

    @property
    def model(self) -> Model:
        """The fitted model."""
        return self.choice.model

    def imagined(self, manoeuvre: Manoeuvre) -> Gram:
        """Gram matrices of the logs with one more run, the manoeuvre; no measurement is needed for it."""
        run = imagined_run(self.power, self.features, manoeuvre, self.site)
        layout_of = self.model.source
        source = make_source([run], self.features.candidates, self.features.prior_sd, self.settings, like=layout_of)
        design = source.design(replace(self.model.clock, run_delay_s=(0.0,)))
        rows = len(design.y)
        level = np.maximum(design.base, 0.05 * design.layout.mean_power_w) / design.layout.mean_power_w
        noise = replace(self.model.noise, weight=np.ones(rows), scale=level**self.model.noise.exponent)
        own = make_gram(design, noise)
        return Gram(np.concatenate([self.model.gram.per_run, own.per_run]), self.model.gram.prior_precision)


def imagined_run(power: PowerModel, features: Features, manoeuvre: Manoeuvre, site: Site) -> RunData:
    """A manoeuvre as a run of the identification; its "measured" power is the base model's."""
    columns, battery = script(manoeuvre, site), features.battery
    time_s = columns["time_s"]
    dt_s = np.full(len(time_s), time_s[1] - time_s[0])
    run = Run(manoeuvre.name, columns, dt_s, {battery: np.zeros(len(time_s))}, {battery: None}, {battery: "power"})
    ready = prepare(power, [run], battery)
    (data,) = ready.data([effect_columns(features.effects, features.candidates, cov) for cov in ready.covariates])
    return replace(data, measured_w=data.base_w)


def next_experiments(bench: Bench, effects: Sequence[Finding], left: Unexplained | None) -> tuple[Experiment, ...]:
    """What tells the effects apart that these data cannot; else, of a structure that is `left`, what shows its form."""
    proposed: list[Experiment] = []
    nan = float("nan")
    # no drive tells a load from an effect where its switch is not logged or its column stuck
    known = {candidate.effect for candidate in bench.features.candidates}
    known -= {name for candidate in bench.features.candidates for name in candidate.never_on}
    for effect in effects:
        rivals = [name for name in effect.indistinguishable_from if name in known]
        unlogged = [name for name in effect.indistinguishable_from if name not in known]
        if unlogged:
            switches = " and ".join(f"on_{name.partition(':')[2]}" for name in unlogged)
            do = f"any run again with {switches} in the log, which no drive can tell"
            proposed.append(Experiment((effect.effect, *unlogged), do, nan, nan, nan, 0.0))
        if rivals:
            proposed += propose(bench, (effect.effect, *rivals))
    if not proposed and left is not None:
        on = tuple(left.depends_on)
        form = f"to see the form of the dependence on {', '.join(on)}"
        if set(on) <= {"time_s", "run"}:
            form = "to see whether what no column shows is there at rest too, or only in motion"
        if "run" in on:
            do = "note what differed between these runs (floor, tyres, load, weather), and log it as a column"
            proposed.append(Experiment(on, do, nan, nan, nan, 0.0))
        proposed += [
            Experiment(
                on, f"{m.do}, {form}", nan, nan, nan, m.duration_s / 60.0, tuple(part.to_json() for part in m.parts)
            )
            for m in to_learn(bench.site, on)[:2]
        ]
    return tuple(proposed)


def propose(bench: Bench, names: Sequence[str]) -> list[Experiment]:
    """The best manoeuvres to tell the effects of a set apart, best first.

    Score: the smallest expected lead over all ordered pairs of the set, each effect as strong as the logs say it would
    be if it were the one, with the imagined run among the data (a T-optimal design).
    """
    constraints = Constraints.of(bench.model.design.layout, bench.features.candidates)
    names = [name for name in names if _columns(bench, name)]
    if len(names) < 2:
        return []
    now = worst_lead(bench, constraints, bench.model.gram, names)
    about = {c.covariate for c in bench.features.candidates if c.effect in names} - {"speed_m_s", ""}
    scored = []
    for manoeuvre in library(bench.site):
        gram = bench.imagined(manoeuvre)
        scored.append((worst_lead(bench, constraints, gram, names), manoeuvre))
    # among those that will do, one that varies a single cause of the set speaks for itself
    scored.sort(key=lambda pair: (-min(pair[0], ENOUGH_NATS), len(pair[1].varies & about) != 1, -pair[0]))
    found = []
    for lead, manoeuvre in scored[:MOST_PROPOSED]:
        if lead < now + BETTER_NATS:
            continue
        found.append(_experiment(bench, constraints, names, now, lead, manoeuvre))
    return found


def _experiment(
    bench: Bench, constraints: Constraints, names: Sequence[str], now: float, lead: float, manoeuvre: Manoeuvre
) -> Experiment:
    chosen, times = manoeuvre, 1
    for times in LENGTHS:
        chosen = manoeuvre if times == 1 else shortened(manoeuvre, float(times))
        lead = lead if times == 1 else worst_lead(bench, constraints, bench.imagined(chosen), names)
        if lead >= ENOUGH_NATS:
            break
    do = manoeuvre.do if times == 1 else f"{manoeuvre.do}; {times} times as long"
    minutes = chosen.duration_s / 60.0
    return Experiment(tuple(names), do, power_of(lead), now, lead, minutes, tuple(p.to_json() for p in chosen.parts))


def power_of(lead_nats: float) -> float:
    """Probability that the true effect leads by more than `DECIDED_NATS` where a lead of `lead_nats` is expected.

    The log-likelihood ratio of two Gaussian models has mean D and variance 2 D.
    """
    from scipy.special import ndtr

    if lead_nats <= 0.0:
        return 0.0
    return float(ndtr((lead_nats - DECIDED_NATS) / np.sqrt(2.0 * lead_nats)))


def worst_lead(bench: Bench, constraints: Constraints, gram: Gram, names: Sequence[str]) -> float:
    """Smallest expected lead of one effect of a set over the best imitation by another [nats]."""
    every = {column for name in names for column in _columns(bench, name)}
    rest = [k for k in bench.model.chosen if k not in every]
    leads = [_lead(bench, constraints, gram, rest, a, b) for a in names for b in names if a != b]
    return min(leads, default=0.0)


def _columns(bench: Bench, effect: str) -> list[int]:
    candidates = bench.features.candidates
    return [
        k for k, column in enumerate(bench.model.design.layout.columns) if candidates[column.candidate].effect == effect
    ]


def _lead(bench: Bench, constraints: Constraints, gram: Gram, rest: Sequence[int], a: str, b: str) -> float:
    now = bench.model.gram
    gains = single_gains(now, constraints, rest)
    own = max(_columns(bench, a), key=lambda k: gains[k])
    value = float(now.coefficients([*rest, own])[0][-1])
    left = gram.conditional(rest)
    own_size = float(left[1 + own, 1 + own])
    best = 0.0
    for k in _columns(bench, b):
        size = float(left[1 + k, 1 + k])
        if size <= 1e-9 * float(gram.full[1 + k, 1 + k]):
            continue
        r = float(left[1 + own, 1 + k]) / np.sqrt(own_size * size)
        if constraints.sign[k] * r * value >= 0.0:
            best = max(best, min(1.0, r * r))
    return 0.5 * value**2 * own_size * (1.0 - best)


def to_learn(site: Site, covariates: Sequence[str]) -> list[Manoeuvre]:
    """Manoeuvres that vary a covariate on which the rest depends, for a structure that no effect explains."""
    wanted = {
        "yaw_rate_rad_s": ("spin", "straight and curved"),
        "speed_m_s": ("speed sweep",),
        "accel_m_s2": ("stop and go",),
        "slope_rad": ("ramp",),
        "payload_kg": ("payload on and off",),
        "temp_ambient_c": ("cold and warm",),
        "time_s": ("everything off",),
        "cpu_load": ("processor stress",),
    }
    names = [name for covariate in covariates for name in wanted.get(covariate, ())]
    return [m for m in library(site) if m.name in names]

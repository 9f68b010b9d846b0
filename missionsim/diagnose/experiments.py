"""What to drive next (step 6): manoeuvres scored by how well they would tell the effects of a set apart."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from missionsim.diagnose.features import Features, effect_columns
from missionsim.diagnose.manoeuvres import STRAIGHT_1_M, Manoeuvre, Site, library, script, shortened
from missionsim.effects.model import PowerModel
from missionsim.fit.prepare import prepare
from missionsim.identify.data import Constraints, RunData
from missionsim.identify.design import make_source
from missionsim.identify.estimates import imitated
from missionsim.identify.findings import Experiment, Finding, Unexplained
from missionsim.identify.forward import Choice
from missionsim.identify.gram import Gram, make_gram, single_gains
from missionsim.identify.model import Model
from missionsim.identify.proposed import plain
from missionsim.identify.settings import BETTER_NATS, DECIDED_NATS, ENOUGH_NATS, LENGTHS, MOST_PROPOSED, Settings
from missionsim.runs.run import Run

_SHOWS = {
    "yaw_rate_rad_s": ("spin", "straight and curved"),
    "speed_m_s": ("speed sweep",),
    "accel_m_s2": ("stop and go",),
    "slope_rad": ("ramp",),
    "payload_kg": ("payload on and off",),
    "temp_ambient_c": ("cold and warm",),
    "time_s": ("everything off",),
    "cpu_load": ("processor stress",),
}
"""Manoeuvres that vary a covariate on which the rest depends, for a structure that no effect explains."""

FADES_MIN = 10.0
"""How long a component has to be on to show whether its power fades: some of the usual time constants (assumed)."""
ELSEWHERE = "more runs, of other days and routes: what no column shows weighs more here than what one drive could add"


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
        model, features = self.model, self.features
        refitted = {column.name: dict(column.shape) for column in model.source.layout.columns if column.shape}
        run = imagined_run(self.power, features, manoeuvre, self.site, refitted)
        source = make_source([run], features.candidates, features.prior_sd, self.settings, like=model.source)
        design = source.design(replace(model.clock, run_delay_s=(0.0,)))
        level = np.maximum(design.base, 0.05 * design.layout.mean_power_w) / design.layout.mean_power_w
        noise = replace(model.noise, weight=np.ones(len(design.y)), scale=level**model.noise.exponent)
        own = make_gram(design, noise)
        return Gram(np.concatenate([model.gram.per_run, own.per_run]), model.gram.prior_precision)


def imagined_run(
    power: PowerModel,
    features: Features,
    manoeuvre: Manoeuvre,
    site: Site,
    refitted: Mapping[str, Mapping[str, float]] | None = None,
) -> RunData:
    """A manoeuvre as a run of the identification; its "measured" power is the base model's. `refitted`: see
    `effect_columns`."""
    columns, battery = script(manoeuvre, site), features.battery
    time_s = columns["time_s"]
    dt_s = np.full(len(time_s), time_s[1] - time_s[0])
    run = Run(manoeuvre.name, columns, dt_s, {battery: np.zeros(len(time_s))}, {battery: None}, {battery: "power"})
    ready = prepare(power, [run], battery)
    columns_of = [effect_columns(features.effects, features.candidates, cov, refitted) for cov in ready.covariates]
    (data,) = ready.data(columns_of)
    return replace(data, measured_w=data.base_w)


def next_experiments(bench: Bench, effects: Sequence[Finding], left: Unexplained | None) -> tuple[Experiment, ...]:
    """What tells the effects apart that these data cannot; else, of a structure that is `left`, what shows its form."""
    proposed: list[Experiment] = []
    # no drive tells a load from an effect where its switch is not logged or its column stuck
    known = {candidate.effect for candidate in bench.features.candidates}
    stuck = {name for candidate in bench.features.candidates for name in candidate.never_on}
    known -= stuck
    for effect in effects:
        rivals = [name for name in (*effect.indistinguishable_from, *effect.shared_with) if name in known]
        unlogged = [name for name in effect.indistinguishable_from if name not in known]
        if unlogged:
            switches = " and ".join(f"on_{name.partition(':')[2]}" for name in unlogged)
            do = f"any run again with {switches} in the log, which no drive can tell"
            if all(name in stuck for name in unlogged):
                do = f"any run again in which {switches} changes: it is 0 in every row here, as a stuck column is"
            proposed.append(Experiment((effect.effect, *unlogged), do))
        if rivals:
            proposed += propose(bench, (effect.effect, *rivals))
    if not proposed and left is not None:
        on = tuple(left.depends_on)
        form = f"to see the form of the dependence on {', '.join(map(plain, on))}"
        if set(on) <= {"time_s", "run"}:
            form = "to see whether what no column shows is there at rest too, or only in motion"
        if "run" in on:
            do = "note what differed between these runs (floor, tyres, load, weather), and log it as a column"
            if along := dict.fromkeys(name for one in left.structures for name in one.columns):
                do = f"more runs that differ in {' or '.join(along)} and in nothing else (floor, tyres, load)"
            proposed.append(Experiment(on, do))
            may_be = dict.fromkeys(name for one in left.structures for name in one.effects)
            proposed += propose(bench, tuple(may_be))
        names = [name for covariate in on for name in _SHOWS.get(covariate, ())]
        shown = [m for m in library(bench.site) if m.name in names]
        # a robot that has driven curves, or may turn on the spot, has a manoeuvre of turning
        if "yaw_rate_rad_s" in on and not shown and bench.site.curvature_1_m <= STRAIGHT_1_M:
            why = "it cannot turn on the spot, and these logs have no curve: log some"
            proposed.append(Experiment(on, f"no manoeuvre that this robot can drive is known {form}: {why}"))
        for one in shown[:2]:
            parts = tuple(part.to_json() for part in one.parts)
            told = f"{one.do}, {form}"
            proposed.append(Experiment(on, told, minutes=one.duration_s / 60.0, manoeuvre=parts))
    for effect in effects:
        if effect.other_forms:
            part = effect.effect.partition(":")[2]
            do = f"stand still, switch {part} on and leave it on for {FADES_MIN:.0f} min, to see whether it fades"
            proposed.append(Experiment((effect.effect, *effect.other_forms), do, minutes=FADES_MIN))
    return tuple(proposed)


def propose(bench: Bench, names: Sequence[str]) -> list[Experiment]:
    """The best manoeuvres to tell the effects of a set apart, best first, or those of a part of it with the first one
    where more of them are likely to be ruled out.

    Score: the smallest expected lead over all ordered pairs of the set, each effect as strong as the logs say it would
    be if it were the one, with the imagined run among the data (a T-optimal design).
    """
    names = [name for name in names if _columns(bench, name)]
    known: dict[tuple[str, float], Gram] = {}

    def imagined(manoeuvre: Manoeuvre) -> Gram:
        key = (manoeuvre.do, manoeuvre.duration_s)
        if key not in known:
            known[key] = bench.imagined(manoeuvre)
        return known[key]

    best: list[Experiment] = []
    most = 0.0
    for others in range(len(names) - 1, 0, -1):
        if best and most >= others:  # no fewer of them can be worth more
            break
        for some in combinations(names[1:], others):
            found = _to_tell(bench, (names[0], *some), imagined, whole=others == len(names) - 1)
            ruled_out = others * np.nan_to_num(found[0].expected_power) if found else 0.0
            if found and (not best or ruled_out > most):
                best, most = found, ruled_out
    return best


def _to_tell(
    bench: Bench, names: Sequence[str], imagined: Callable[[Manoeuvre], Gram], whole: bool
) -> list[Experiment]:
    """The best manoeuvres to tell all of some effects apart; of a part of a set only what these logs leave open."""
    constraints = Constraints.of(bench.model.design.layout, bench.features.candidates)
    now = worst_lead(bench, constraints, bench.model.gram, names)
    # by such a lead they would have been told apart, but for what no column shows: as much again must come
    known = now >= ENOUGH_NATS
    if known and not whole:
        return []
    least = now + (ENOUGH_NATS if known else BETTER_NATS)
    about = {c.covariate for c in bench.features.candidates if c.effect in names} - {"speed_m_s", ""}
    # what rounding alone tells apart stays in the library's order
    scored = [(round(worst_lead(bench, constraints, imagined(m), names), 6), m) for m in library(bench.site)]
    # among those that will do, one that varies a single cause of the set speaks for itself
    scored.sort(key=lambda pair: (-min(pair[0], ENOUGH_NATS), len(pair[1].varies & about) != 1, -pair[0]))
    found = []
    for lead, manoeuvre in scored[:MOST_PROPOSED]:
        if lead < least:
            continue
        chosen, times = manoeuvre, 1
        for times in LENGTHS:
            if times > 1:
                chosen = shortened(manoeuvre, float(times))
                lead = worst_lead(bench, constraints, imagined(chosen), names)
            if lead >= ENOUGH_NATS:
                break
        do = manoeuvre.do if times == 1 else f"{manoeuvre.do}; {times} times as long"
        parts = tuple(part.to_json() for part in chosen.parts)
        found.append(Experiment(tuple(names), do, power_of(lead), now, lead, chosen.duration_s / 60.0, parts))
    found.sort(key=lambda one: -min(one.separation_after, ENOUGH_NATS))
    return found or [Experiment(tuple(names), ELSEWHERE)] * known


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
    now, own = bench.model.gram, {name: _columns(bench, name) for name in names}
    rest = [k for k in bench.model.chosen if not any(k in columns for columns in own.values())]
    gains = single_gains(now, constraints, rest)
    leads = []
    for one, columns in own.items():
        k = max(columns, key=gains.__getitem__)
        r, lead = imitated(gram, constraints, rest, k, float(now.coefficients([*rest, k])[0][-1]))
        alike = np.minimum(1.0, np.nan_to_num(r) ** 2)
        leads += [lead * (1.0 - float(alike[other].max())) for name, other in own.items() if name != one]
    return min(leads, default=0.0)


def _columns(bench: Bench, effect: str) -> list[int]:
    candidates = bench.features.candidates
    return [k for k, c in enumerate(bench.model.design.layout.columns) if candidates[c.candidate].effect == effect]

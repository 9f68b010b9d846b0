"""Each threshold of the search for a law, in cases just on both sides of it."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass, replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from missionsim.identify.align import Clock
from missionsim.identify.gram import Gram
from missionsim.identify.proposed import Curve, Law
from missionsim.labels import Labels
from missionsim.laws import adapter, experiment, factors, gates, levels, proposal, search
from missionsim.laws.gates import Gates
from missionsim.laws.grammar import Factor, Grammar
from missionsim.laws.search import Scored, Search

from .found import law_of, run_of

PLAIN = Grammar((Factor("a", "a", "a"), Factor("b", "b", "b")), ())


@pytest.mark.parametrize(("part", "acting"), [(0.015, 1), (0.025, 2)])
def test_a_law_acts_in_a_run_that_holds_a_part_of_its_square(part: float, acting: int) -> None:
    x = np.sqrt(np.repeat([1.0 - part, part], 4))
    runs, sums = [slice(0, 4), slice(4, 8)], np.array([[4.0, 2.0], [2.0, 2.0]])
    design = SimpleNamespace(runs=runs, duration_s=np.ones(8), y=np.ones(8), base=np.zeros(8), phi=x[None])
    design.layout, design.gradient = SimpleNamespace(parameters=()), np.zeros((0, 8))
    model = SimpleNamespace(design=design, gram=Gram(np.array([sums, sums]), np.zeros(0)), chosen=(0,))
    assert gates.left_out(model).acting == acting


@pytest.mark.parametrize(
    ("nats", "behind", "first", "count"),
    [
        (20.0, 1.7, "plain", 2),
        (20.0, 2.3, "bent", 2),
        (20.0, 3.5, "bent", 2),
        (20.0, 4.5, "bent", 1),
        (1000.0, 27.0, "plain", 2),
        (1000.0, 33.0, "bent", 2),
        (1000.0, 55.0, "bent", 2),
        (1000.0, 65.0, "bent", 1),
    ],
)
def test_how_far_behind_a_form_may_be(nats: float, behind: float, first: str, count: int) -> None:
    """Of two forms the plainer one is behind: it stands first, stands beside the other, or is gone."""
    grammar = Grammar((Factor("a", "a**2", "bent", 1), Factor("a", "a", "plain")), ())
    kept, _ = proposal._set([Scored((0,), nats, 0.1, nats), Scored((1,), nats, 0.1, nats - behind)], grammar)
    assert grammar.factors[kept[0].form[0]].symbol == first
    assert len(kept) == count


def at_an_angle(r: float, rows: int = 600) -> np.ndarray:
    """Two rows of no mean that are correlated by `r`."""
    wave = np.arange(rows) * 2.0 * np.pi / rows
    return np.array([np.cos(wave), r * np.cos(wave) + np.sqrt(1.0 - r**2) * np.sin(wave)])


@pytest.mark.parametrize(("r", "twin"), [(0.98, ""), (0.99, "grade")])
def test_a_law_whose_column_is_an_effects_looks_like_it(r: float, twin: str) -> None:
    law, phi = at_an_angle(r)
    layout = SimpleNamespace(columns=[SimpleNamespace(candidate=0)])
    ground = SimpleNamespace(design=SimpleNamespace(phi=phi[None], layout=layout, y=law))
    found = SimpleNamespace(library=[SimpleNamespace(effect="grade")])
    assert proposal._twin(SimpleNamespace(watts=law), ground, found) == twin


@pytest.mark.parametrize(("bound", "twin"), [(19.0, "temperature_friction"), (5.0, "")])
def test_a_law_that_is_an_effect_but_for_the_base_looks_like_it(bound: float, twin: str) -> None:
    """Cold below 19 degC is cold below 25 degC and less friction; it was "no effect of the library fits"."""
    rng = np.random.default_rng(2)
    speed, temp = rng.uniform(0.0, 1.0, 400), rng.uniform(0.0, 18.0, 400)
    layout = SimpleNamespace(columns=[SimpleNamespace(candidate=0)])
    phi = speed * (25.0 - temp)
    design = SimpleNamespace(phi=phi[None], layout=layout, y=speed, gradient=np.array([speed, np.ones(400)]))
    fitted, ground = SimpleNamespace(watts=speed * np.maximum(bound - temp, 0.0)), SimpleNamespace(design=design)
    found = SimpleNamespace(library=[SimpleNamespace(effect="temperature_friction")])
    assert proposal._twin(fitted, ground, found) == ""
    assert proposal._twin(fitted, ground, found, recalibrated=True) == twin


@pytest.mark.parametrize(("r", "count"), [(0.97, 2), (0.985, 1)])
def test_a_form_that_looks_like_a_better_one_is_no_other_place_to_begin(r: float, count: int) -> None:
    ranked = [Scored((i,), 50.0, 0.1, 45.0) for i in range(2)]
    assert len(Search._apart(SimpleNamespace(rows=at_an_angle(r)), ranked)) == count


@pytest.mark.parametrize(
    ("gain", "share", "absorbed", "worth"),
    [
        (4.0, 0.1, 0.0, False),
        (6.0, 0.1, 0.0, True),
        (90.0, 0.0050, 0.0, False),  # the least share is 0.008, and a refit hardly makes more of it
        (90.0, 0.0062, 0.0, True),
        (90.0, 0.1, 0.92, True),
        (90.0, 0.1, 0.94, False),  # a free base takes it up
        (90.0, -0.1, 0.0, False),
    ],
)
def test_what_the_first_pass_lets_through(
    monkeypatch: pytest.MonkeyPatch, gain: float, share: float, absorbed: float, worth: bool
) -> None:
    information = 2.0 * gain / share**2

    class Known:
        def coarse(self, rows: Any) -> Any:
            return rows

        def __call__(self, *_: Any) -> tuple[np.ndarray, ...]:
            return tuple(np.array([x]) for x in (1.0, share * information, information, absorbed))

    monkeypatch.setattr(search, "Sieve", lambda *_: Known())
    own = SimpleNamespace(ground=SimpleNamespace(mean_power_w=1.0), groups=None, every=1, rows=None, grammar=PLAIN)
    own.by_size, own.penalties = [np.array([[0]])], [5.0]
    assert bool(Search.screen(own, None)) is worth


@pytest.mark.parametrize(("errors", "kept"), [((0.99,), 1), ((0.997,), 0), ((0.5, 0.51), 2), ((0.5, 0.52), 1)])
def test_at_a_glance_a_law_predicts_left_out_runs_better_and_hardly_worse_than_the_best(
    monkeypatch: pytest.MonkeyPatch, errors: tuple[float, ...], kept: int
) -> None:
    model = SimpleNamespace(squares=None, noise=None)
    ground = SimpleNamespace(model=model, design=SimpleNamespace(runs=range(2)), usual=lambda: None)
    ground.plain, ground.extended, ground.at_noise = lambda _: None, lambda watts: watts, lambda watts, _: watts
    monkeypatch.setattr(search, "left_out", lambda watts: SimpleNamespace(with_law=watts, without=1.0))
    own = SimpleNamespace(ground=ground, columns=lambda forms: [errors[form[0]] for form in forms])
    assert len(Search._promising(own, [(i,) for i in range(len(errors))])) == kept


@pytest.mark.parametrize(
    ("at", "steps", "found"), [(39, 0, True), (40, 0, False), (5, 1, True), (6, 1, False), (0, 4, True), (0, 5, False)]
)
def test_how_far_the_best_form_is_looked_for(at: int, steps: int, found: bool) -> None:
    """A form among the best by the first pass, or so many steps of its numbers beyond one of them, is the best."""
    score = {(i,): 100.0 - i for i in range(60)} | {(i,): 100.0 + i for i in range(101, 110)}
    if not steps:
        score[at,] = 200.0
    own = SimpleNamespace(ground=None, screen=lambda *_: [Scored((i,), 0.0, 0.1, 0.0) for i in range(60)])
    own._unlike = lambda forms: Search._unlike(own, forms)

    def exactly(top: Any, forms: list[tuple[int, ...]]) -> list[Scored]:
        return sorted((Scored(form, 0.0, 0.1, score[form]) for form in dict.fromkeys(forms)), key=lambda s: -s.score)

    def bent(form: tuple[int, ...]) -> list[tuple[int, ...]]:
        return [(101,)] if form == (at,) and steps else [(form[0] + 1,)] if 100 < form[0] < 100 + steps else []

    factors = [Factor(f"{i}", f"{i}", "") for i in range(110)]
    own._exactly, own.grammar = exactly, SimpleNamespace(factors=factors, bent=bent)
    best = Search.near(own, SimpleNamespace(form=(0,), model=SimpleNamespace(noise=None)), [])[0]
    assert (best.form == ((100 + steps,) if steps else (at,))) is found


LAW = Law("k * abs(speed_m_s)", "k·|v|", "W s/m", 5.0, 4.9, 5.1, 0.1, 0.0, variables=("speed_m_s",))


def test_a_curve_is_nowhere_surer_than_the_rows_resolve() -> None:
    time_s = np.arange(101.0)
    curve = proposal._curve([LAW], SimpleNamespace(covariates=[{"speed_m_s": time_s / 100.0, "time_s": time_s}]), 0.0)
    top = max(curve.watts)
    assert np.subtract(curve.high, curve.low) == pytest.approx(2.0 * 0.03 * top)


def found_at_once(monkeypatch: pytest.MonkeyPatch, grammar: Grammar) -> SimpleNamespace:
    """The fit of a law that every search finds, which replaces nothing and is no effect of the library."""
    errors = SimpleNamespace(without=1.0, with_law=0.5, energy_without=1.0, energy_with=0.5, better=4, acting=4)
    fitted = SimpleNamespace(errors=errors, share=0.2, rise=90.0, penalty=5.0)
    own = SimpleNamespace(best=lambda: SimpleNamespace(best=fitted), on_time=lambda _: own, ground=None, tried=2)
    own.sharpened = lambda done: (own, done)
    own.grammar = grammar
    monkeypatch.setattr(proposal, "Search", lambda *_: own)
    for name, answer in (
        ("by_levels", None),
        ("_replaced", ((), None)),
        ("_law", LAW),
        ("_curve", None),
        ("_twin", ""),
        ("_goes_with", ()),
    ):
        monkeypatch.setattr(proposal, name, lambda *_, answer=answer, **__: answer)
    return fitted


def test_a_laws_size_is_never_surer_than_rows_and_clock_allow(monkeypatch: pytest.MonkeyPatch) -> None:
    """However little the rows scatter: of a share of 20 % a tenth, and with 2 % of scatter the root of both squares."""
    fitted = found_at_once(monkeypatch, PLAIN)
    for scatter, sd in ((1e-6, 0.02), (0.02, 0.02 * np.sqrt(2.0))):
        monkeypatch.setattr(proposal, "_judged", lambda *_, sd=scatter: ([None], [], fitted, Gates(sd, {})))
        left = SimpleNamespace(structures=())
        found = SimpleNamespace(noise={}, demoted=(), library=(), unexplained=left)
        made, *_ = proposal._propose(None, PLAIN, False, found)
        assert made.share_sd == pytest.approx(sd, rel=1e-3)


@pytest.mark.parametrize(("size", "told"), [(0.13, True), (0.15, False)])
def test_a_law_beside_which_an_effect_takes_what_another_one_had_is_none(
    monkeypatch: pytest.MonkeyPatch, size: float, told: bool
) -> None:
    """A law of descents in the place of the slope left the ascents to a load carried uphill alone: 4.8 for 0.5 W per kg
    and m/s, and 25.9 W on other runs for 5.6."""
    fitted = found_at_once(monkeypatch, PLAIN)
    fitted.model = "with the law"
    search = proposal.Search()
    near = Scored((0,), 90.0, 0.2, 90.0)
    monkeypatch.setattr(proposal, "_judged", lambda *_: ([near], [], fitted, Gates(0.01, {})))
    monkeypatch.setattr(proposal, "_replaced", lambda *_: (("grade",), search.best()))
    left = SimpleNamespace(sizes=lambda _: {"payload": size})
    ground = SimpleNamespace(model=None, sizes=lambda _: {"grade": 0.2, "payload": 0.07}, without=lambda _: left)
    search.ground = ground

    def begun(on: SimpleNamespace, *_: object) -> SimpleNamespace:
        search.ground = on
        return search

    monkeypatch.setattr(proposal, "Search", begun)
    found = SimpleNamespace(noise={}, demoted=(), library=(), unexplained=SimpleNamespace(structures=()))
    assert (proposal._propose(ground, PLAIN, False, found, once_more=False) is not None) is told


@pytest.mark.parametrize(("form", "told"), [((0, 1), False), ((0, 1, 2), True), ((0, 2), True)])
def test_what_a_drift_may_stand_behind_is_no_law(
    monkeypatch: pytest.MonkeyPatch, form: tuple[int, ...], told: bool
) -> None:
    """Cold over drives of a Husky, which a steady drift explained as well: no law of it came in its place."""
    grammar = Grammar(tuple(Factor(n, n, n) for n in ("speed_m_s", "temp_ambient_c", "payload_kg")), ())
    fitted = found_at_once(monkeypatch, grammar)
    near = Scored(form, 90.0, 0.2, 90.0)
    monkeypatch.setattr(proposal, "_judged", lambda *_: ([near], [], fitted, Gates(0.01, {})))
    drift = SimpleNamespace(covariate="", effects=("temperature_friction",))
    cold = SimpleNamespace(effect="temperature_friction", covariate="temp_ambient_c")
    left = SimpleNamespace(structures=(drift,))
    found = SimpleNamespace(noise={}, demoted=(), library=(cold,), unexplained=left)
    assert (proposal._propose(None, grammar, False, found, once_more=False) is not None) is told


@pytest.mark.parametrize(
    ("sd_w", "told"), [(0.45, "3 min at"), (0.55, "6 min at"), (0.95, "12 min at"), (1.05, "no drive")]
)
def test_how_long_a_drive_is_that_tells_two_forms_apart(
    monkeypatch: pytest.MonkeyPatch, sd_w: float, told: str
) -> None:
    """They differ by 1.4 W; `sd_w`: of the difference of two means over 3 min, and less over longer ones."""
    monkeypatch.setattr(experiment, "mean_variance", lambda _, seconds: 0.5 * 180.0 / seconds)
    x, watts = (0.0, 1.0), (0.0, 5.0)
    curve = Curve("speed_m_s", "m/s", x, watts, watts, watts, {}, 0.5)
    drive = experiment.experiment([LAW, replace(LAW, k=6.0)], curve, (), {"sd_w": sd_w * 1.4})
    assert drive.startswith(told)


@pytest.mark.parametrize(
    ("r", "idle_w", "own"),
    [
        (0.988, 10.0, set()),
        (0.993, 10.0, {"pack_reading"}),
        (-0.993, 10.0, {"pack_reading"}),
        (0.993, 10.7, {"pack_reading"}),
        (0.993, 13.0, set()),  # a load of its own beside one that is always on
    ],
)
def test_a_column_that_is_the_measured_power_is_no_cause(r: float, idle_w: float, own: set[str]) -> None:
    power, reading = at_an_angle(r)
    reading = math.copysign(10.0, r) + reading
    ground = SimpleNamespace(covariates=[{"pack_reading": reading}], design=SimpleNamespace(y=idle_w + power))
    ground.averaged = lambda raw: raw[0]
    assert proposal._own_meter(ground) == own


@pytest.mark.parametrize(("least", "part"), [(0.045, 0.0), (0.055, 0.055), (-0.2, 0.0)])
def test_a_level_far_below_the_highest_is_none(monkeypatch: pytest.MonkeyPatch, least: float, part: float) -> None:
    monkeypatch.setattr(levels, "left_out", lambda *_: SimpleNamespace(with_law=1.0))
    design = SimpleNamespace(phi=np.eye(3), layout=SimpleNamespace(unit=lambda _: 10.0))
    gram = SimpleNamespace(shares=lambda _: np.array([0.2, 0.1, 0.2 * least]))
    ground = SimpleNamespace(chosen=(), extended=lambda _: design)
    ground.at_noise = lambda *_: SimpleNamespace(gram=gram, chosen=())
    own = SimpleNamespace(ground=ground, columns=lambda _: np.eye(3))
    fitted = SimpleNamespace(model=SimpleNamespace(noise=None))
    _, parts, _ = levels._with_levels(own, fitted, (), range(3))
    assert parts == pytest.approx({0: 1.0, 1: 0.5, 2: part})


@pytest.mark.parametrize(("second", "told"), [(0.94, True), (0.96, False)])
def test_levels_that_are_alike_are_none(monkeypatch: pytest.MonkeyPatch, second: float, told: bool) -> None:
    """A law of one level everywhere has no level of its own for any."""
    monkeypatch.setattr(levels, "left_out", lambda *_: SimpleNamespace(with_law=1.0))
    design = SimpleNamespace(phi=np.eye(2), layout=SimpleNamespace(unit=lambda _: 10.0))
    gram = SimpleNamespace(shares=lambda _: np.array([0.2, 0.2 * second]))
    ground = SimpleNamespace(chosen=(), extended=lambda _: design)
    ground.at_noise = lambda *_: SimpleNamespace(gram=gram, chosen=())
    own = SimpleNamespace(ground=ground, columns=lambda _: np.eye(2))
    found = levels._with_levels(own, SimpleNamespace(model=SimpleNamespace(noise=None)), (), range(2))
    assert (found is not None) is told


@dataclass(frozen=True)
class Level:
    """A noise of one number, with the parts of it that differ between runs."""

    name: str
    gain: float = 0.1
    motion_gain: float = 0.1


@dataclass(frozen=True)
class Noisy:
    law: bool
    noise: Level
    squares: str = "far from right"


@pytest.mark.parametrize(
    ("with_law", "without", "rise"),
    [
        ({"null": 41.0, "law": -14.0}, {"null": 0.0, "law": -900.0}, 41.0),  # its own fit ended at a poor noise
        ({"null": -6.0, "law": 93.0}, {"null": 0.0, "law": 99.0}, -6.0),  # the fit of the null did
    ],
)
def test_a_law_rises_where_noise_is_alike(
    monkeypatch: pytest.MonkeyPatch, with_law: dict[str, float], without: dict[str, float], rise: float
) -> None:
    monkeypatch.setattr(search, "log_likelihood", lambda m: (with_law if m.law else without)[m.noise.name])
    ground = SimpleNamespace(model=Noisy(False, Level("null")), extended=lambda _: None)
    ground.at_noise = lambda _, noise: Noisy(True, noise)
    fitted = search.Fitted((0,), Noisy(True, Level("law")), np.ones(3), with_law["law"], 0.0)  # type: ignore[arg-type]
    object.__setattr__(fitted, "errors", SimpleNamespace(with_law=1.0))
    own = SimpleNamespace(ground=ground, fit=lambda *_: fitted, without=without["null"])
    assert Search.settled(own, fitted).rise == rise  # type: ignore[arg-type]


def test_five_quantities_have_levels_tried() -> None:
    rng = np.random.default_rng(1)
    rows = np.vstack([rng.random((7, 40)), np.repeat(np.eye(2), 20, axis=1)])
    design = SimpleNamespace(duration_s=np.ones(40), gradient=np.ones((1, 40)), phi=np.zeros((0, 40)))
    design.residual = 9.0 * rows[3] * rows[7] + rng.random(40)
    ground = SimpleNamespace(design=design, chosen=(), covariates=[{}])
    own = [SimpleNamespace(variable=f"q{i}", fine=False) for i in range(7)]
    search = SimpleNamespace(ground=ground, grammar=SimpleNamespace(factors=own), rows=rows)
    tried = levels._differing(search, [7, 8])
    assert len(tried) == 5
    assert tried[0] == (3,)


@pytest.mark.parametrize(("texts", "factors_of_it"), [(1, 0), (6, 6), (7, 0)])
def test_a_label_of_few_texts_has_a_factor_of_each(texts: int, factors_of_it: int) -> None:
    run = {"time_s": np.arange(70.0), "surface": Labels.of([f"floor {i % texts}" for i in range(70)])}
    assert sum(f.variable == "surface" for f in factors.make_grammar([run], set()).factors) == factors_of_it


def test_six_columns_beyond_the_glossary_enter() -> None:
    rng = np.random.default_rng(1)
    run = {"time_s": np.arange(70.0), **{f"reading_{i}": rng.random(70) for i in range(8)}}
    assert {f.variable for f in factors.make_grammar([run], set()).factors} >= {f"reading_{i}" for i in range(6)}
    assert "reading_6" not in {f.variable for f in factors.make_grammar([run], set()).factors}


@pytest.mark.parametrize(("kind", "kept", "beside"), [("", 6, 0), ("bend", 1, 8)])
def test_six_forms_are_told_and_eight_lie_in_the_band(kind: str, kept: int, beside: int) -> None:
    grammar = Grammar(tuple(Factor("a" if kind else f"{i}", f"{i}", "", kind=kind) for i in range(12)), ())
    found = proposal._set([Scored((i,), 50.0, 0.1, 45.0) for i in range(12)], grammar)
    assert tuple(map(len, found)) == (kept, beside)


@pytest.mark.parametrize(("place", "found"), [(2, True), (3, False)])
def test_three_forms_that_differ_are_fitted(place: int, found: bool) -> None:
    """By their order in the first pass; one of them predicts left-out runs far better."""
    screened = [Scored((i,), 50.0, 0.1, 45.0) for i in range(6)]
    ground = SimpleNamespace(usual=lambda: None, plain=lambda _: None, model=SimpleNamespace(noise=None))
    own = SimpleNamespace(grammar=PLAIN, ground=ground, screen=lambda *_: screened, sized=list, _promising=list)
    own._apart, own._plainest = lambda forms: forms, lambda top: top
    own.near = lambda top, _: [one for one in screened if one.form == top.form]
    own.fit = lambda form, **_: SimpleNamespace(
        form=form, errors=SimpleNamespace(with_law=0.5 if form == (place,) else 1.0)
    )
    assert (Search.best(own).best.form == (place,)) is found


@dataclass(frozen=True)
class Late:
    """A model at a clock, at which the law gains nats where the lag is 0.3 s."""

    source: Any
    clock: Clock
    nats: float
    design: None = None
    chosen: tuple[int, ...] = ()
    noise: None = None
    squares: None = None


@pytest.mark.parametrize(("nats", "moves"), [(14.0, False), (16.0, True)])
def test_a_law_moves_the_clock_where_that_is_far_likelier(
    monkeypatch: pytest.MonkeyPatch, nats: float, moves: bool
) -> None:
    monkeypatch.setattr(adapter, "log_likelihood", lambda model: model.nats * (model.clock.lag_s == 0.3))
    monkeypatch.setattr(adapter, "_refitted", lambda model, *_: model)
    monkeypatch.setattr(adapter.Ground, "extended", lambda *_: None)
    source = SimpleNamespace(aligned=True, design=lambda *_: None, averaged=lambda *_: [None])
    model = Late(source, Clock(0.0, 0.0, (0.0,)), nats)
    ground = adapter.Ground(model, (), ()).on_time([], model)
    assert ground.model.clock.lag_s == (0.3 if moves else 0.0)


@pytest.mark.usefixtures("laws_at_once")
def test_a_fan_is_found_at_the_temperature_that_switches_it() -> None:
    """On from 47 degC on: at any other threshold a step is worse than a ramp, and the ramp was the answer."""
    rng, runs = np.random.default_rng(4), []
    for number in range(6):
        rows = 1200
        load, warm = np.repeat(rng.uniform(0.05, 1.0, rows // 40), 40), np.empty(rows)
        state = 35.0
        for i, busy in enumerate(load):
            state += (30.0 + 28.0 * busy - state) / 60.0
            warm[i] = round(state, 3)
        speed = np.repeat(rng.uniform(0.0, 1.0, rows // 30), 30)
        gradient = {"c3": 30.0 * speed, "c4": np.full(rows, 40.0)}
        costs = 7.0 * (warm > 47.0) + 0.4 * rng.standard_normal(rows)
        runs.append(run_of(number, gradient, costs, step_s=0.5, speed_m_s=speed, temp_cpu_c=warm))
    made = law_of(runs, c3=0.05, c4=0.05)
    step = re.fullmatch(r"k \* \(temp_cpu_c > ([\d.]+)\)", made.first.formula)
    assert step is not None
    assert float(step[1]) == pytest.approx(47.0, abs=0.15)
    assert made.first.k == pytest.approx(7.0, rel=0.05)


def test_numbers_at_whose_noise_no_form_is_left_are_none() -> None:
    """Constant loads beside each other: every form had the wrong sign at the noise of the sharpened one."""
    sharp = SimpleNamespace(form=(1,), rise=9.0, errors=SimpleNamespace(with_law=1.0))
    finer = SimpleNamespace(fit=lambda *_: sharp, _exactly=lambda *_: [])
    top = SimpleNamespace(form=(0,), rise=5.0, errors=SimpleNamespace(with_law=2.0), model=SimpleNamespace(noise=None))
    done = search.Searched(top, (Scored((0,), 9.0, 0.1, 7.0),))
    assert Search.sharpened(SimpleNamespace(_halved=lambda *_: (finer, [(1,)])), done)[1] is done

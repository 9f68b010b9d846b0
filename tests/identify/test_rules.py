"""Each rule of the identification in a case in which it decides."""

from __future__ import annotations

import functools
from collections.abc import Callable
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from missionsim.identify import estimates, evidence, stepwise
from missionsim.identify.align import Clock
from missionsim.identify.data import Candidate, Constraints
from missionsim.identify.design import make_source
from missionsim.identify.estimates import rivals
from missionsim.identify.evidence import Evidence, evidence_of, nats_needed, predicts_left_out, rests_on_one_run, tails
from missionsim.identify.findings import Estimate, Finding, Structure
from missionsim.identify.forward import Choice, _Search
from missionsim.identify.gram import Gram
from missionsim.identify.identification import Identification, fit_effects, identify, refutes
from missionsim.identify.model import Model, spread_runs
from missionsim.identify.predictive import LeastSquares
from missionsim.identify.rules import demoted, gates, last_gates
from missionsim.identify.settings import Settings
from missionsim.identify.verdict import decide

from .world import coefficient, library, make_runs


def strength(column: str, share: float) -> dict[str, float]:
    return {column: coefficient(make_runs(0), column, share)}


@functools.cache
def fitted(effect: str, share: float, seed: int = 11) -> Identification:
    column = {"surface_rolling_resistance": "surface|carpet"}.get(effect, effect)
    return fit_effects(make_runs(seed, strength(column, share)), library(), [effect], {})


@dataclass(frozen=True)
class Question:
    model: Model
    evidence: Evidence


def question(found: Identification) -> Question:
    model = found.choice.model
    return Question(model, evidence_of(model, model.chosen[0]))


def passed(q: Question) -> dict[str, bool]:
    return gates(q.model, q.evidence) | last_gates(q.model, q.evidence)


def with_constraints(model: Model, constraints: Constraints) -> Model:
    return replace(model, source=replace(model.source, constraints=constraints))


@pytest.fixture(scope="module")
def grade() -> Question:
    return question(fitted("grade", 0.05))


def test_a_clear_effect_passes_every_gate(grade: Question) -> None:
    assert all(passed(grade).values())


@pytest.mark.parametrize(("gate", "change"), [("likelihood", {"gain": 5.0}), ("robust", {"p_robust": 1e-3})])
def test_each_gate_alone_keeps_an_effect_out(grade: Question, gate: str, change: dict[str, float]) -> None:
    answers = passed(replace(grade, evidence=replace(grade.evidence, **change)))
    assert {name for name, held in answers.items() if not held} == {gate}


@pytest.mark.parametrize(("share", "left", "holds"), [(0.006, 0.6, False), (0.006, 0.4, True), (0.007, 0.6, True)])
def test_a_small_effect_is_practical_where_it_halves_the_error_of_left_out_runs(
    grade: Question, share: float, left: float, holds: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Inertia of 0.6 % of the energy, in short pulses that were 61 % of the squared error, was negligible."""
    monkeypatch.setattr("missionsim.identify.rules.predicts_left_out", lambda _model, _columns: (left, 1.0))
    answers = passed(replace(grade, evidence=replace(grade.evidence, share=share)))
    assert {name for name, held in answers.items() if not held} == ({"practical"} if not holds else set())


def test_the_level_is_that_of_all_effects_together_in_the_tail_that_physics_allows(grade: Question) -> None:
    # nine effects share 0.002; the sign of grade is fixed, so that one tail alarms: z = 3.51, 6.2 nats
    constraints = grade.model.constraints
    tail = tails(constraints, False)
    names = [constraints.of_column(k).effect for k in range(len(tail))]
    assert tail[grade.evidence.column] == pytest.approx(0.002 / 9)
    assert nats_needed(tail[grade.evidence.column]) == pytest.approx(6.17, abs=0.02)
    for gain, clear in ((6.1, False), (6.3, True)):
        assert gates(grade.model, replace(grade.evidence, gain=gain))["likelihood"] is clear
    assert tail[names.index("rolling_friction")] == pytest.approx(0.002 / 9, rel=1e-9)  # a twin may only add power
    assert tail[names.index("cold_friction")] == pytest.approx(0.002 / 9 / np.sqrt(3))  # three time constants
    assert tails(constraints, True)[0] == pytest.approx(0.001 / 9)


def test_a_shift_within_four_prior_sd_is_recalibration() -> None:
    # camera draws 2.8 W with a prior of 3 %: 2.5 sd more, and 8 sd more
    small, large = (
        question(fit_effects(make_runs(3, {"component_power:camera": w}), library(), ["component_power:camera"], {}))
        for w in (0.2, 0.7)
    )
    assert not passed(small)["beyond recalibration"]
    assert passed(large)["beyond recalibration"]


def test_what_is_constant_in_runs_and_rests_on_one_of_them_is_kept_out(grade: Question) -> None:
    assert passed(one_cold_run({2}))["several runs"] is False
    assert passed(one_cold_run({1, 2, 4}))["several runs"] is True
    # a drive that was made for it: half of it cold, half of it warm
    assert passed(one_cold_run({2}, part=0.5))["several runs"] is True


@pytest.mark.parametrize(("chosen", "driven"), [((0,), []), ((0, 1), [2]), ((0, 2), []), ((0, 1, 2), [2])])
def test_a_run_in_which_the_cause_of_another_effect_changes_tells_both(
    monkeypatch: pytest.MonkeyPatch, chosen: tuple[int, ...], driven: list[int]
) -> None:
    """The load on and off on one floor: the other floor's cost rests on that run, in which it stays. What changes
    in every run, as speed does, tells nothing."""
    changes = {0: [0, 0, 0, 0], 1: [0, 0, 1, 0], 2: [1, 1, 0, 1]}
    monkeypatch.setattr(evidence, "cause_changes_in", lambda _, k: np.array(changes[k], dtype=bool))
    runs = [SimpleNamespace(covariates={"cause": float(j)}) for j in range(4)]
    causes = SimpleNamespace(of_column=lambda _: SimpleNamespace(covariate="cause"))
    model = SimpleNamespace(chosen=chosen, source=SimpleNamespace(runs=runs), constraints=causes)
    assert np.flatnonzero(evidence.driven_for(model, 0)).tolist() == driven


@pytest.mark.parametrize(
    ("loads", "holds"),
    [([[1.0, 1.0], [2.0, 2.0], [0.0, 2.0]], True), ([[1.0, 1.0]] * 3, False), ([[0.0, 2.0]] * 3, False)],
)
def test_a_cause_that_never_changes_goes_along_with_nothing(loads: list[list[float]], holds: bool) -> None:
    runs = [SimpleNamespace(covariates={"payload_kg": np.array(load)}) for load in loads]
    causes = SimpleNamespace(of_column=lambda _: SimpleNamespace(covariate="payload_kg"))
    model = SimpleNamespace(source=SimpleNamespace(runs=runs), constraints=causes)
    assert evidence.constant_in_most(model, 0) is holds


def one_cold_run(cold: set[int], part: float = 1.0) -> Question:
    runs = []
    for j, run in enumerate(make_runs(21, count=6)):
        low = (np.arange(len(run.time_s)) < part * len(run.time_s)) & (j in cold)
        temperature = np.where(low, 5.0, 22.0)
        column = run.columns["rolling_friction"] * np.maximum(25.0 - temperature, 0.0)
        hidden = 3.0 * run.columns["rolling_friction"] * low
        columns, covariates = run.columns | {"temperature": column}, run.covariates | {"temp_ambient_c": temperature}
        runs.append(replace(run, columns=columns, measured_w=run.measured_w + hidden, covariates=covariates))
    own = Candidate("temperature_friction", ("temperature",), covariate="temp_ambient_c")
    return question(fit_effects(runs, [own, *library()], ["temperature_friction"], {}))


@pytest.mark.parametrize(("other", "alone"), [((1.0, 2.0), True), ((1.0, 3.0), True), ((20.0, 40.0), False)])
def test_one_run_is_one_that_says_all_but_three_nats_or_a_twentieth(other: tuple[float, float], alone: bool) -> None:
    # information and product of two runs: the first alone gains 200 nats, the other 2, 4.5 and 40
    runs = [np.array([[0.0, xy], [xy, xx]]) for xx, xy in ((100.0, 200.0), other)]
    model = SimpleNamespace(gram=Gram(np.array(runs), np.zeros(0)), chosen=(0,))
    assert rests_on_one_run(model, 0) == (0 if alone else None)


def test_an_effect_that_hardly_gains_has_rivals_and_a_clear_one_has_none() -> None:
    for share, some in ((0.001, True), (0.05, False)):
        found = fitted("grade", share)
        model = found.choice.model
        number = int(model.constraints.effect[model.chosen[0]])
        assert bool(rivals(model, number)) is some
        # what floors explain beside others is their own: noise of a covariate leaves nothing of it over
        floors = replace(model.constraints, joint=np.ones_like(model.constraints.joint))
        assert not rivals(with_constraints(model, floors), number)


def test_two_effects_together_stand_in_the_place_of_one() -> None:
    """Turns alone look little like what needs power on slopes too."""
    sizes = strength("grade", 0.05) | strength("turning_scrub", 0.05)
    runs = []
    for run in make_runs(8):
        both = np.sum([size * run.columns[name] for name, size in sizes.items()], axis=0)
        runs.append(replace(run, columns=run.columns | {"both": both}, measured_w=run.measured_w + both))
    found = fit_effects(runs, [Candidate("both", ("both",)), *library()], ["both"], {})
    assert found.effects[0].indistinguishable_from == ("turning_scrub",)  # the larger of the two


@pytest.mark.parametrize(("turn", "behind", "rivals"), [(45.0, 0.0, {1, 2}), (30.0, 0.0, {1}), (45.0, 2.0, set())])
def test_two_effects_in_the_place_of_one_have_a_price(turn: float, behind: float, rivals: set[int]) -> None:
    """Two columns explain 25 nats but for a part, each alone far less; the smaller by far is an aid, no explanation."""
    own, angle = np.sqrt(1.0 - behind / 25.0), np.radians(turn)
    sides = np.array([[own, 0.0, np.sqrt(1.0 - own**2)], [0.0, 1.0, 0.0]])
    turned = [[np.cos(angle), np.sin(angle)], [np.sin(angle), -np.cos(angle)]] @ sides
    columns = np.sqrt(20_000.0) * np.vstack([[1.0, 0.0, 0.0], turned])
    rows = np.vstack([0.05 * columns[0], columns])
    candidates = [Candidate(name, (name,), covariate=name) for name in "abc"]
    constraints = Constraints(np.zeros(3, dtype=int), np.arange(3), np.zeros(3, dtype=bool), candidates)
    one = SimpleNamespace(chosen=(0,), constraints=constraints, gram=Gram(rows @ rows.T[None], np.zeros(0)))
    assert estimates._close_ones(one, 0).keys() == rivals


@pytest.mark.parametrize(("tile", "told"), [(0.0, {"k_carpet"}), (0.0015, {"k_carpet", "k_tile"})])
def test_a_floor_that_gains_no_more_than_by_chance_gets_no_level(tile: float, told: set[str]) -> None:
    runs = []
    for run in make_runs(2):
        floors = {"surface|tile": np.roll(run.columns["surface|carpet"], 210)}
        runs.append(replace(run, columns=run.columns | floors))
    for name, share in (("surface|carpet", 0.05), ("surface|tile", tile)):
        size = coefficient(runs, name, share)
        runs = [replace(run, measured_w=run.measured_w + size * run.columns[name]) for run in runs]
    floor, levels = "surface_rolling_resistance", ("carpet", "tile")
    both = Candidate(floor, ("surface|carpet", "surface|tile"), covariate="carpet", levels=levels, unit="N")
    found = fit_effects(runs, [both, *(one for one in library() if one.effect != floor)], [floor], {})
    assert found.effects[0].parameters.keys() == told


@pytest.mark.parametrize(
    ("number", "p_runs", "constant", "driven", "may_be"),
    [
        (0, 0.01, True, False, ("turning_scrub",)),
        (0, 0.002, True, False, ()),
        (0, 0.01, False, False, ()),
        (1, 0.01, True, False, ()),
        (0, 0.01, True, True, ()),  # one drive with the cold in it, made to tell
    ],
)
def test_what_runs_hardly_repeat_may_be_a_misfit_of_the_larger_effect(
    monkeypatch: pytest.MonkeyPatch, number: int, p_runs: float, constant: bool, driven: bool, may_be: tuple[str, ...]
) -> None:
    """Oil that cools while the robot stands made a temperature effect of 2 % at p = 0.01; true ones are surer."""
    monkeypatch.setattr(estimates, "cause_is_constant", lambda *_: constant)
    monkeypatch.setattr(estimates, "driven_for", lambda *_: np.array([False, driven]))
    effects = [Candidate("temperature_friction", ("cold",)), Candidate("turning_scrub", ("turns",))]
    constraints = Constraints(np.zeros(2, dtype=int), np.arange(2), np.zeros(2, dtype=bool), effects)
    design = SimpleNamespace(layout=SimpleNamespace(mean_power_w=10.0))
    model = SimpleNamespace(chosen=(0, 1), design=design, constraints=constraints)
    evidence = SimpleNamespace(p_runs=p_runs)
    choice = SimpleNamespace(model=model, forward=SimpleNamespace(rivals={}), evidence={0: evidence, 1: evidence})
    assert estimates._similar(choice, number, {0: 0.02, 1: 0.2}) == may_be


@pytest.mark.parametrize(
    ("together", "there", "most", "sign", "may_have"),
    [
        (0.9, 0.0, True, 1, ("b",)),  # half of it, at the most that the other may be
        (0.5, 0.0, True, 1, ()),  # a seventh
        (0.2, 2.9, True, 1, ()),
        (0.2, 3.1, True, 1, ("b",)),  # standard errors of the other, which some gate refused
        (0.9, 3.1, False, 1, ()),  # of what changes in most runs they are no few observations
        (0.9, 0.0, True, -1, ()),  # which physics forbids
    ],
)
def test_an_effect_that_goes_with_another_from_run_to_run_may_have_a_part_of_it(
    monkeypatch: pytest.MonkeyPatch, together: float, there: float, most: bool, sign: int, may_have: tuple[str, ...]
) -> None:
    """Of a load that was carried on cold days "payload, sure" had twice its size."""
    monkeypatch.setattr(estimates, "constant_in_most", lambda _, k: most or k == 0)
    candidates = [Candidate(name, (name,), covariate=name, sign=1 if name == "a" else sign) for name in "ab"]
    constraints = Constraints(np.array([1, sign]), np.arange(2), np.zeros(2, dtype=bool), candidates)
    load, cold = np.array([8.0, 0.0]), 8.0 * np.array([together, np.sqrt(1.0 - together**2)])
    rows = np.vstack([load + np.array([0.0, there]), load, cold])
    model = SimpleNamespace(chosen=(0,), constraints=constraints, gram=Gram(rows @ rows.T[None], np.zeros(0)))
    assert estimates._shared(model, [0]) == may_have


@pytest.mark.parametrize(
    ("far", "stands", "levels", "may_be"),
    [
        (True, False, False, ("grade",)),
        (True, True, False, ()),
        (True, False, True, ()),  # floors are free as they are
        (False, False, False, ()),  # put in doubt by the finer search
    ],
)
def test_what_a_wrong_form_leaves_over_may_be_what_another_effect_takes(
    monkeypatch: pytest.MonkeyPatch, far: bool, stands: bool, levels: bool, may_be: tuple[str, ...]
) -> None:
    """A load carried uphill alone, beside a slope that relieved a part only: "payload, sure" at twice its size."""
    monkeypatch.setattr(estimates, "stands_without", lambda *_: stands)
    effects = [Candidate(name, (name,), covariate=name) for name in ("payload", "grade", "turning")]
    constraints = Constraints(np.zeros(3, dtype=int), np.arange(3), np.full(3, levels), effects)
    model = SimpleNamespace(chosen=(0, 1, 2), constraints=constraints)
    choice = SimpleNamespace(model=model, forward=SimpleNamespace() if far else None)
    assert estimates._of_a_form(choice, 0, [Structure("grade", 0.0, 0.0, 0.02, "")]) == may_be
    assert estimates._of_a_form(choice, 1, [Structure("grade", 0.0, 0.0, 0.02, "")]) == ()


def test_an_effect_that_is_named_is_no_rival_of_what_may_be_another_form_of_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        estimates, "_similar", lambda _choice, number, _sizes: ("turning_scrub",) if number == 0 else ()
    )
    found = fit_effects(make_runs(11, strength("grade", 0.1)), library(), ["grade", "turning_scrub"], {})
    told = {one.effect: (one.open, one.reason) for one in found.candidates}
    assert told["turning_scrub"][0] is False
    assert told["turning_scrub"][1].startswith("explains")


def test_a_load_that_its_log_says_was_never_on_may_be_most_of_itself_or_all() -> None:
    effect = Candidate("standby_load", ("on",), never_on={"laser": 2.0})
    assert [effect.may_be(watts) for watts in (0.5, 1.0, 2.0, 2.1)] == [(), ("laser",), ("laser",), ()]


@pytest.mark.parametrize(("covariate", "rivals"), [("slope_rad", ("other",)), ("payload_kg", ())])
def test_a_slope_is_a_rival_further_behind_than_other_covariates(covariate: str, rivals: tuple[str, ...]) -> None:
    """Its sensor has noise of its own, which takes from what it explains."""
    noise = np.random.default_rng(3)
    assert rivals_of_turns(covariate, lambda turns, _: turns + 0.08 * np.std(turns) * noise.normal(size=420)) == rivals


@pytest.mark.parametrize(("covariate", "rivals"), [("yaw_rate_rad_s", ("other",)), ("payload_kg", ())])
def test_columns_of_one_covariate_that_differ_beside_ramps_alone_are_one(
    covariate: str, rivals: tuple[str, ...]
) -> None:
    noise = np.random.default_rng(3)

    def beside_ramps(turns: np.ndarray, base: np.ndarray) -> np.ndarray:
        change = np.abs(np.diff(base, prepend=base[0], append=base[-1]))
        ramp = np.maximum(change[1:], change[:-1]) > 0.06 * base.mean()
        return turns * (1.0 + 3.0 * ramp * noise.normal(size=len(base))) ** 2

    assert rivals_of_turns(covariate, beside_ramps) == rivals


def rivals_of_turns(covariate: str, other: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> tuple[str, ...]:
    """What cannot be told from scrub of 6 % beside one more column, made of scrub and the power of the base."""
    name, runs = "turning_scrub", []
    for run in make_runs(8):
        turns = run.columns[name]
        watts = run.measured_w + strength(name, 0.06)[name] * turns
        runs.append(replace(run, columns=run.columns | {"other": other(turns, run.base_w)}, measured_w=watts))
    candidates = [Candidate("other", ("other",), covariate=covariate), *library()]
    return fit_effects(runs, candidates, [name], {}).effects[0].indistinguishable_from


def test_an_effect_that_left_out_runs_speak_against_goes() -> None:
    """Power that is drawn in every other run and saved in the rest: no fit to some of them predicts the others."""
    runs = make_runs(5, count=8)
    size = strength("grade", 0.06)["grade"]
    turned = [
        replace(run, measured_w=run.measured_w + (size if j % 2 else -size) * run.columns["grade"])
        for j, run in enumerate(runs)
    ]
    found = fit_effects(turned, library(), ["grade"], {})
    assert predicts_left_out(found.choice.model, found.choice.model.chosen)[0] > 1.0
    assert passed(question(found))["runs"] is False
    assert predicts_left_out(fitted("grade", 0.03).choice.model, fitted("grade", 0.03).choice.model.chosen)[0] < 1.0


def test_gates_are_asked_again_after_the_shape_was_refitted(monkeypatch: pytest.MonkeyPatch) -> None:
    """A refit that ends at a shape which hardly acts must not leave its effect in the model."""
    from missionsim.identify import profile

    runs = make_runs(12, {"cold": 6.0}, count=8)

    def refit(shape: dict[str, float]) -> list[np.ndarray]:
        return [1e-6 * run.columns["rolling_friction"] + 1e-3 * run.columns["turning_scrub"] for run in runs]

    monkeypatch.setattr(profile, "SHAPE_EVALUATIONS", 1)
    candidates = [replace(c, refit=refit) if c.effect == "cold_friction" else c for c in library()]
    found = identify(runs, candidates, {})
    assert "cold_friction" not in [e.effect for e in found.effects]


STRUCTURE = Structure("speed_m_s", 1e-9, 40.0, 0.05, "residual varies with speed_m_s")
LOOSE = Structure("time_s", 0.0, 0.0, 0.05, "wanders")


def finding(rivals: tuple[str, ...] = ()) -> Finding:
    return Finding(
        effect="grade",
        parameters={"k": Estimate(1, 0, 2)},
        energy_share=0.1,
        p_value=0.0,
        indistinguishable_from=rivals,
    )


@pytest.mark.parametrize(
    ("effects", "structures", "demoted_names", "rest", "verdict"),
    [
        ([], [], [], {}, "nothing_missing"),
        ([finding()], [], [], {}, "effects_found"),
        ([finding(("payload",))], [], [], {}, "ambiguous"),
        ([], [STRUCTURE], [], {}, "unexplained_structure"),
        ([finding()], [STRUCTURE], [], {}, "effects_found"),
        ([finding()], [STRUCTURE], ["payload"], {}, "unexplained_structure"),
        ([finding()], [STRUCTURE], [], {"law": True}, "unexplained_structure"),
        ([finding(("payload",))], [], [], {"law": True}, "ambiguous"),
        ([], [], [], {"averages": [STRUCTURE]}, "unexplained_structure"),
        ([finding()], [], [], {"averages": [STRUCTURE]}, "effects_found"),
        ([], [], [], {"execution": [finding()]}, "effects_found"),
        ([], [], [], {"execution": [finding()], "averages": [STRUCTURE]}, "effects_found"),
    ],
)
def test_the_verdict(effects, structures, demoted_names, rest, verdict) -> None:
    assert decide(effects, structures, demoted_names, **rest) == verdict


def test_each_demotion_alone_keeps_an_effect_unnamed(grade: Question) -> None:
    column = grade.evidence.column
    model, evidence = grade.model, grade.evidence
    loose = ({}, (), (LOOSE,))
    assert demoted(model, evidence, {}) == ""
    assert demoted(model, evidence, {column: STRUCTURE}) == "its form is not right"
    standby = question(fitted("standby_load", 0.2))
    assert demoted(standby.model, standby.evidence, *loose) == "a load that comes and goes has its mean"
    assert demoted(model, replace(evidence, gain=500.0), *loose) == ""
    assert demoted(model, replace(evidence, gain=45.0), *loose) == "faint beside low-frequency noise"
    payload = question(fitted("payload", 0.1))  # constant in each run, which are the sample then
    assert demoted(payload.model, replace(payload.evidence, gain=45.0, p_runs=1e-9), *loose) == ""
    assert demoted(payload.model, replace(payload.evidence, gain=45.0, p_runs=1e-3), *loose).startswith("faint")
    assert demoted(model, replace(evidence, gain=45.0, p_runs=1e-9), *loose).startswith("faint")
    label = question(fitted("surface_rolling_resistance", 0.1))
    one_level = replace(label.evidence, gain=5.0)
    assert demoted(label.model, one_level, *loose) == ""  # a label is as faint as all its levels together
    # a free curve over the slope takes all that grade explains, and grade is no curve over the payload
    slope = replace(STRUCTURE, covariate="slope_rad", times="speed_m_s")
    elsewhere = [replace(c, covariate="payload_kg") for c in model.constraints.candidates]
    payload = with_constraints(model, replace(model.constraints, candidates=elsewhere))
    assert demoted(payload, evidence, {}, (slope,)) == "shadow of another structure"
    assert demoted(payload, evidence, {}, (replace(slope, covariate="payload_kg"),)) == ""


def test_runs_that_share_a_gain_do_not_differ() -> None:
    """All meters 7 % low: the base takes it, no run differs; two that read 12 % more are told as meters that differ."""
    runs = make_runs(2, count=6)
    low = [replace(run, measured_w=0.93 * run.measured_w) for run in runs]
    assert "run" not in identify(low, library(), {}).unexplained.depends_on
    apart = [replace(run, measured_w=(1.12 if j in (1, 3) else 1.0) * run.measured_w) for j, run in enumerate(runs)]
    found = identify(apart, library(), {})
    assert "run" not in found.unexplained.depends_on
    assert any("meters that differ" in remark for remark in found.remarks)


@pytest.mark.parametrize(("p_value", "stays"), [(0.02, True), (0.004, False)])
def test_worse_energy_of_left_out_runs_at_one_in_a_hundred_in_both_searches(
    grade: Question, monkeypatch: pytest.MonkeyPatch, p_value: float, stays: bool
) -> None:
    """A car of seven trips lost its inertia (85 % of the squared error) at p = 0.04."""
    monkeypatch.setattr(LeastSquares, "energy_no_worse", lambda *_: p_value)
    assert passed(grade)["energy"] is stays
    model = grade.model
    search = _Search(LeastSquares.of(model.design), model.source.layout, model.constraints.candidates, Settings())
    assert search.measured(int(model.constraints.effect[model.chosen[0]]), model.chosen, ()).passed["energy"] is stays


@pytest.mark.parametrize(
    ("far", "twins", "left", "refuted"),
    [
        (False, 0, 0.45, True),
        (False, 0, 0.6, False),
        (False, 1, 0.7, True),  # a twin of one base parameter is named, or the base is far from right
        (True, 0, 0.7, True),
        (True, 0, 0.8, False),
        (False, 2, 1.05, True),  # both, or two twins: the same error without any prior refutes the file
        (True, 1, 1.05, True),
        (True, 1, 1.2, False),
        (False, 1, 1.05, False),
    ],
)
def test_the_more_speaks_against_a_base_the_less_its_file_must_lose(
    far: bool, twins: int, left: float, refuted: bool
) -> None:
    """Two drives of a Warthog on floors, a car in winter: the base far off, no twin or one found beside it."""
    own, other = Clock(-0.3, 0.3, (0.0,)), Clock(0.0, 0.3, (0.0,))
    choice = SimpleNamespace(forward=() if far else None, model=SimpleNamespace(clock=other))
    here = SimpleNamespace(model=SimpleNamespace(clock=own))
    held = SimpleNamespace(choice=choice, twins=twins, error_w2=lambda _: 100.0, factor=None, averages=())
    free = SimpleNamespace(effects=(finding(),), choice=here, error_w2=lambda _: 100.0 * left)
    assert refutes(free, held) is refuted
    # both at the better of their clocks: least squares sees a clock that the noise model takes for the same
    late = SimpleNamespace(**{**vars(held), "error_w2": lambda clocks: 100.0 if own in clocks else 300.0})
    assert refutes(free, late) is refuted
    # one factor on all says as much as a base without priors that leaves no effect
    assert not refutes(
        SimpleNamespace(**{**vars(free), "effects": ()}), SimpleNamespace(**{**vars(held), "factor": 1.5})
    )


def test_of_effects_that_fail_the_weakest_goes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """What fails beside a weaker effect may stand alone."""

    def weigh(gain: float, stands: bool) -> SimpleNamespace:
        return SimpleNamespace(gain=gain, accepted=stands, passed={})

    model = SimpleNamespace(chosen=(0, 1), source=None)
    monkeypatch.setattr(stepwise, "last_gates", lambda *_: {})
    monkeypatch.setattr(stepwise, "fit_model", lambda _, rest, *__, **___: SimpleNamespace(chosen=rest, source=None))
    monkeypatch.setattr(stepwise, "weighed", lambda _, left: {k: weigh(40.0, True) for k in left})
    both = Choice(model, model, {0: weigh(50.0, False), 1: weigh(9.0, False)})
    assert stepwise.confirmed(both).model.chosen == (0,)


@pytest.mark.parametrize(("p_runs", "level"), [(0.04, "identified, repeated across runs"), (0.06, "identified")])
def test_runs_that_hardly_repeat_an_effect_are_not_said_to(p_runs: float, level: str) -> None:
    choice = fitted("grade", 0.05).choice
    evidence = {k: replace(one, p_runs=p_runs) for k, one in choice.evidence.items()}
    assert estimates.estimated(replace(choice, evidence=evidence), {}, {})[0].level == level


@pytest.mark.parametrize(("p_value", "asked"), [(0.011, False), (0.009, True)])
def test_levels_by_which_runs_differ_at_one_in_a_hundred_enter_together(
    monkeypatch: pytest.MonkeyPatch, p_value: float, asked: bool
) -> None:
    class Fitted(Exception):
        pass

    def fit(*_: object, **__: object) -> None:
        raise Fitted

    monkeypatch.setattr(stepwise, "_between", lambda *_: p_value)
    monkeypatch.setattr(stepwise, "fit_model", fit)
    floors = Candidate("surface_rolling_resistance", ("a", "b"), levels=("a", "b"))
    constraints = Constraints(np.ones(2, dtype=int), np.zeros(2, dtype=int), np.ones(2, dtype=bool), [floors])
    model = SimpleNamespace(constraints=constraints, chosen=(), source=None)
    choice = Choice(model, model, {})
    if asked:
        with pytest.raises(Fitted):
            stepwise.with_levels(choice)
    else:
        assert stepwise.with_levels(choice) is choice


@pytest.mark.parametrize(("motion_gain", "asked"), [(0.014, False), (0.016, True)])
def test_what_runs_differ_by_is_asked_anew_where_they_differ_more_than_usual(
    monkeypatch: pytest.MonkeyPatch, motion_gain: float, asked: bool
) -> None:
    """Eight runs that the noise let differ by 1.8 % hid a friction in the cold of 2 % of the energy."""
    fitted_anew: list[tuple[int, ...]] = []

    def fit(_: object, chosen: tuple[int, ...]) -> SimpleNamespace:
        fitted_anew.append(chosen)
        return SimpleNamespace(chosen=chosen)

    monkeypatch.setattr(stepwise, "fit_model", fit)
    monkeypatch.setattr(stepwise, "cause_is_constant", lambda *_: True)
    monkeypatch.setattr(stepwise, "weighed", lambda *_: {0: SimpleNamespace(accepted=False)})
    constraints = Constraints(np.ones(1, dtype=int), np.zeros(1, dtype=int), np.zeros(1, dtype=bool))
    noise = SimpleNamespace(motion_gain=motion_gain)
    model = SimpleNamespace(constraints=constraints, chosen=(), source=None, noise=noise)
    choice = Choice(model, model, {})
    assert stepwise.with_what_runs_differ_by(choice) is choice
    assert fitted_anew == [(0,)] * asked


def test_a_run_of_seven_intervals_says_nothing_and_one_of_eight_enters() -> None:
    runs = make_runs(1, count=3)
    for run, intervals in zip(runs[1:], (7, 8), strict=True):
        run.measured_w[intervals:] = np.nan
    assert make_source(runs, library(), {}, Settings()).kept == (0, 2)


def test_of_many_long_runs_eight_show_the_noise() -> None:
    assert len(spread_runs(40, 40 * 7200)) == 8
    assert len(spread_runs(40, 40 * 200)) == 40

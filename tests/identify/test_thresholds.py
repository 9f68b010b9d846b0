"""Each threshold of the search and of the residual's structure, in cases just on both sides of it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from missionsim.identify import estimates, residual, rules, simpler, stepwise
from missionsim.identify.data import Candidate, Constraints
from missionsim.identify.evidence import Evidence
from missionsim.identify.findings import Structure
from missionsim.identify.gram import Gram

COVARIATE = "yaw_rate_rad_s"
LAYOUT = SimpleNamespace(parameters=(), prior_sd=np.zeros(0), mean_power_w=10.0, step_s=1.0)


def constraints(*covariates: str) -> Constraints:
    """One column for each effect, power drawn."""
    effects = [Candidate(f"e{i}", (f"{i}",), covariate=name) for i, name in enumerate(covariates)]
    count = len(effects)
    return Constraints(np.ones(count, dtype=int), np.arange(count), np.zeros(count, dtype=bool), effects)


@pytest.mark.parametrize(
    ("gains", "shares", "tried", "then", "glanced"),
    [
        ((1.9,), (0.05,), [], [], []),  # of 4.1 nats needed
        ((2.4,), (0.05,), [0], [], []),
        ((100.0,), (0.0034,), [], [], [0]),  # of a least share of 0.0065
        ((100.0,), (0.0045,), [0], [], []),
        ((100.0, 55.0), (0.05, 0.05), [0], [1], []),
        ((100.0, 65.0), (0.05, 0.05), [0, 1], [], []),
        ((100.0, 95.0, 90.0), (0.05, 0.05, 0.05), [0, 1], [2], []),
        ((100.0, 95.0, 90.0), (0.003, 0.05, 0.05), [1, 2], [], [0]),
    ],
)
def test_what_is_worth_a_fit_with_a_noise_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
    gains: tuple[float, ...],
    shares: tuple[float, ...],
    tried: list[int],
    then: list[int],
    glanced: list[int],
) -> None:
    size, share = 2.0 * np.array(gains) / np.square(shares), np.array(shares)
    sums = np.diag(np.r_[1e3, size])
    sums[0, 1:] = sums[1:, 0] = share * size
    gram, refused = Gram(sums[None], np.zeros(0)), dict[int, Evidence]()
    monkeypatch.setattr(stepwise, "make_gram", lambda *_: gram)
    monkeypatch.setattr(stepwise, "without_outliers", lambda *_: None)
    model = SimpleNamespace(constraints=constraints(*["c"] * len(gains)), chosen=(), gram=gram, design=None, noise=None)
    assert stepwise._trials(model, refused) == [[(k,) for k in some] for some in (tried, then)]
    assert list(refused) == glanced


@pytest.mark.parametrize(
    ("covariate", "part", "close"),
    [("payload_kg", 0.10, True), ("payload_kg", 0.14, False), ("slope_rad", 0.22, True), ("slope_rad", 0.26, False)],
)
def test_how_far_behind_a_rival_of_another_covariate_may_be(covariate: str, part: float, close: bool) -> None:
    """Parts of 1000 nats; an inclinometer has noise and a bias of its own."""
    columns = np.sqrt(200_000.0) * np.array([[1.0, 0.0], [np.sqrt(1.0 - part), np.sqrt(part)]])
    rows = np.vstack([0.1 * columns[0], columns])
    gram = Gram((rows @ rows.T)[None], np.zeros(0))
    model = SimpleNamespace(chosen=(0,), constraints=constraints("surface", covariate), gram=gram)
    assert (1 in estimates._close_ones(model, 0)) is close


@pytest.mark.parametrize(
    ("alike", "nats", "leads"), [(0.4, 7.0, True), (0.6, 7.0, False), (0.4, 5.2, True), (0.4, 4.0, False)]
)
def test_a_lead_counts_in_runs_in_which_two_powers_differ_by_half(alike: float, nats: float, leads: bool) -> None:
    """One run whose power is the effect's; the rival explains so much of it that it is `nats` behind."""
    columns = np.sqrt(2.0 * nats / (1.0 - alike)) * np.array([[1.0, 0.0], [np.sqrt(alike), np.sqrt(1.0 - alike)]])
    rows = np.vstack([columns[0], columns])
    assert estimates._lead_where_apart(Gram((rows @ rows.T)[None], np.zeros(0)), [], 0, 1) is leads


@pytest.mark.parametrize(("part", "leads"), [(0.05, False), (0.2, True)])
def test_a_run_in_which_neither_of_two_acts_shows_no_lead(part: float, leads: bool) -> None:
    """Load and cold that go together: in the run without both, the noise of the thermometer was all that differed, and
    "payload, sure" had twice its size."""
    alike = np.sqrt(200.0) * np.array([[1.0, 0.0], [0.97, np.sqrt(1.0 - 0.97**2)]])
    faint = np.sqrt(part * 200.0) * np.eye(2)
    rows = np.array([np.vstack([run[0], run]) for run in (alike, faint)])
    assert estimates._lead_where_apart(Gram(rows @ rows.swapaxes(1, 2), np.zeros(0)), [], 0, 1) is leads


def free_curve(monkeypatch: pytest.MonkeyPatch, answer: Any) -> SimpleNamespace:
    """A model whose free curve over the covariate has five values; `answer` gives gain and p by the judge, which is the
    model away from ramps or the model, by the number of rows and of columns in the model."""
    rows = {"phi": np.ones((1, 2)), "gradient": np.zeros((1, 2))}
    model, away = (SimpleNamespace(design=SimpleNamespace(layout=LAYOUT, **rows)) for _ in range(2))
    model.constraints, model.chosen = constraints(COVARIATE), (0,)
    model.source = SimpleNamespace(covariates=(COVARIATE,), runs=[SimpleNamespace(texts={})])

    def tested(judge: Any, rows: np.ndarray, chosen: list[int]) -> tuple[float, float, np.ndarray]:
        return (*answer(judge is away, len(rows), len(chosen)), np.ones(len(rows)))

    monkeypatch.setattr(residual, "steady", lambda _: away)
    monkeypatch.setattr(residual, "curve_rows", lambda *_: (np.array([[0.0, 0.5]] * 5), np.arange(6.0)))
    monkeypatch.setattr(residual, "test_curve", tested)
    return model


@pytest.mark.parametrize(
    ("away", "beside", "told"),
    [
        ((7.0, 1e-9), (0.0, 1.0), False),
        ((9.0, 1e-9), (0.0, 1.0), True),
        ((30.0, 1.4e-4), (0.0, 1.0), False),
        ((30.0, 7e-5), (0.0, 1.0), True),
        ((0.0, 1.0), (40.0, 1e-9), False),  # averaging over a ramp bends every curve
        ((0.0, 1.0), (60.0, 1e-9), True),
        ((0.0, 1.0), (60.0, 1.4e-5), False),
        ((0.0, 1.0), (60.0, 7e-6), True),
    ],
)
def test_a_residual_that_depends_on_a_covariate(
    monkeypatch: pytest.MonkeyPatch, away: tuple[float, float], beside: tuple[float, float], told: bool
) -> None:
    model = free_curve(monkeypatch, lambda steady, *_: away if steady else beside)
    assert bool(residual.dependences(model)) is told


@pytest.mark.parametrize(("part", "told"), [(0.004, False), (0.006, True)])
def test_a_curve_that_the_base_takes_nearly_whole_is_none(
    monkeypatch: pytest.MonkeyPatch, part: float, told: bool
) -> None:
    """Rows of a second with nothing missing were "something is missing … (by 0.2 % of the power)"."""
    model = free_curve(monkeypatch, lambda *_: (30.0, 1e-9))
    monkeypatch.setattr(residual, "_beside", lambda *_: np.array([-part, part]) * LAYOUT.mean_power_w)
    assert bool(residual.dependences(model)) is told


def test_a_residual_that_depends_on_a_text_is_told_by_its_texts(monkeypatch: pytest.MonkeyPatch) -> None:
    """ "gait: lowest at 1.00, highest at 2.00"."""
    model = free_curve(monkeypatch, lambda *_: (30.0, 1e-9))
    model.source.runs[0].texts = {COVARIATE: ("crawl", "trot", "walk", "d", "e", "f")}
    assert residual.dependences(model)[0].shape.endswith(": lowest at crawl, highest at trot")


@pytest.mark.parametrize(
    ("beyond", "p_value", "own", "wrong"),
    [
        (7.0, 1e-9, 40.0, False),  # about what slow noise gives five free values
        (9.0, 1e-9, 40.0, True),
        (18.0, 1.4e-3, 40.0, False),
        (18.0, 7e-4, 40.0, True),
        (22.0, 3e-3, 40.0, True),  # few blocks carry the test of a large gain
        (22.0, 2.3e-2, 40.0, False),
        (22.0, 1.7e-2, 40.0, True),
        (45.0, 3e-2, 40.0, False),
        (55.0, 3e-2, 40.0, True),  # blocks that differ hide no misfit as loud as this
        (22.0, 3e-3, 50.0, False),  # not gross, nor sure
        (22.0, 1.4e-5, 60.0, False),
        (22.0, 7e-6, 60.0, True),
        (18.0, 3e-6, 60.0, False),
        (22.0, 3e-6, 83.0, True),
        (22.0, 3e-6, 87.0, False),
        (22.0, 3e-6, 5.5, True),
        (22.0, 3e-6, 4.5, False),  # what acts on ramps alone is not judged by the rows away from them
    ],
)
def test_a_form_that_is_not_right(
    monkeypatch: pytest.MonkeyPatch, beyond: float, p_value: float, own: float, wrong: bool
) -> None:
    """What the curve gains beside the effect; of 100 nats of both away from ramps, those of the effect alone."""

    def answer(away: bool, rows: int, inside: int) -> tuple[float, float]:
        if inside:
            return (beyond, p_value) if away else (0.0, 1.0)
        return (own if away and rows == 1 else 100.0), 0.0

    assert (residual.wrong_form(free_curve(monkeypatch, answer), 0) is not None) is wrong


@pytest.mark.parametrize(("own", "wrong"), [(47.0, True), (53.0, False)])
def test_beside_ramps_only_a_gross_misfit_is_one(monkeypatch: pytest.MonkeyPatch, own: float, wrong: bool) -> None:
    def answer(away: bool, rows: int, inside: int) -> tuple[float, float]:
        if inside:
            return (0.0, 1.0) if away else (22.0, 1e-6)
        return (own if rows == 1 else 100.0), 0.0

    assert (residual.wrong_form(free_curve(monkeypatch, answer), 0) is not None) is wrong


@pytest.mark.parametrize(("left", "stands"), [(45.0, False), (55.0, True)])
def test_what_keeps_half_of_its_gain_beside_a_curve_is_no_shadow(
    monkeypatch: pytest.MonkeyPatch, left: float, stands: bool
) -> None:
    gains = {1: 100.0, 5: 200.0, 6: 200.0 + left}
    model = free_curve(monkeypatch, lambda _, rows, __: (gains[rows], 0.0))
    assert residual.stands_without(model, 0, Structure(COVARIATE, 0.0, 0.0, 0.1, "")) is stands


@pytest.mark.parametrize(
    ("left", "own", "times", "other"),
    [
        (45.0, 84.0, "", True),
        (55.0, 84.0, "", False),
        (45.0, 86.0, "", False),  # a curve that does hardly better is another form of the same
        (45.0, 84.0, "speed_m_s", False),  # that is asked as the effect's own form
    ],
)
def test_a_curve_that_does_not_go_with_speed_may_do_far_better(
    monkeypatch: pytest.MonkeyPatch, left: float, own: float, times: str, other: bool
) -> None:
    """A load of the payload at rest too, which was called what it costs to carry it."""
    gains = {1: own, 5: 100.0, 6: 100.0 + left * own / 100.0}
    model = free_curve(monkeypatch, lambda _, rows, __: (gains[rows], 0.0))
    monkeypatch.setattr(rules, "known", lambda _: SimpleNamespace(multiplies_speed=True))
    assert rules.other_curve(model, 0, [Structure(COVARIATE, 0.0, 0.0, 0.1, "", times)]) is other


def test_rows_beside_a_change_of_the_base_lie_on_a_ramp_and_two_behind_it() -> None:
    """Of a base of 10 W that rises in the fifth row by 2.5 or 3.5 % of the mean power."""
    for step_w, ramp in ((0.25, []), (0.35, [3, 4, 5, 6])):
        base = np.where(np.arange(20) < 4, 10.0, 10.0 + step_w)
        design = SimpleNamespace(y=base, base=base, stretches=[slice(0, 20)], layout=LAYOUT)
        assert np.flatnonzero(residual.ramps(SimpleNamespace(design=design))).tolist() == ramp


@pytest.mark.parametrize(("step_s", "block_s"), [(1.0, 60.0), (5.0, 75.0)])
def test_a_curve_is_tested_in_blocks_of_a_minute(
    monkeypatch: pytest.MonkeyPatch, step_s: float, block_s: float
) -> None:
    rows, asked = np.random.default_rng(1).normal(size=(3, 600)), []
    noise = SimpleNamespace(scale=np.ones(600), sigma_w=1.0)
    design = SimpleNamespace(residual=rows[0], layout=SimpleNamespace(step_s=step_s))
    monkeypatch.setattr(residual, "project", lambda *_: (rows, np.zeros((3, 1))))
    monkeypatch.setattr(residual, "block_numbers", lambda _, length_s: asked.append(length_s) or np.arange(600))
    residual.test_curve(SimpleNamespace(design=design, noise=noise), rows[1:], ())
    assert asked == [block_s]


@pytest.mark.parametrize(
    ("runs", "watts", "told"), [(1, 0.57, False), (1, 0.58, True), (8, 0.28, False), (8, 0.33, True)]
)
def test_a_line_of_one_run_must_be_no_chance_and_one_of_several_stand_out(
    monkeypatch: pytest.MonkeyPatch, runs: int, watts: float, told: bool
) -> None:
    rng, time_s = np.random.default_rng(2), np.arange(512)
    white = np.concatenate([rng.normal(size=512) + watts * np.sin(time_s / 6.4 + i) for i in range(runs)])
    design = SimpleNamespace(layout=LAYOUT, runs=[slice(512 * i, 512 * (i + 1)) for i in range(runs)])
    monkeypatch.setattr(residual, "innovations", lambda *_: white)
    assert (residual.periodic(SimpleNamespace(design=design, noise=None, chosen=())) is not None) is told


@pytest.mark.parametrize(
    ("factor", "part", "at_rest", "told"),
    [
        (1.08, 0.95, 1.08, False),
        (0.92, 0.95, 0.92, False),
        (1.12, 0.95, 1.12, True),
        (0.88, 0.95, 0.88, True),
        (1.5, 0.87, 1.5, False),
        (1.5, 0.93, 1.5, True),
        (1.5, 0.93, 1.27, True),
        (1.5, 0.93, 1.23, False),
        (0.88, 0.93, 1.0, False),
    ],
)
def test_a_factor_is_large_explains_what_the_effects_explain_and_holds_at_rest(
    monkeypatch: pytest.MonkeyPatch, factor: float, part: float, at_rest: float, told: bool
) -> None:
    monkeypatch.setattr(simpler, "may_differ", lambda _: True)
    monkeypatch.setattr(simpler, "common_factor", lambda _: (factor, part))
    monkeypatch.setattr(simpler, "seconds_at_rest", lambda _: np.repeat([0.0, 1.0], 12))
    design = SimpleNamespace(base=np.full(24, 10.0), y=np.repeat([15.0, 10.0 * at_rest], 12))
    model = SimpleNamespace(chosen=(0,), source=None, design=design)
    assert simpler.instead_of_effects(model) == (factor if told else None)


@pytest.mark.parametrize(("off", "told"), [((0.09, 0.2), False), ((0.11, 0.2), True), ((-0.11, 0.2), False)])
def test_a_level_is_off_in_every_run(monkeypatch: pytest.MonkeyPatch, off: tuple[float, float], told: bool) -> None:
    monkeypatch.setattr(simpler, "may_differ", lambda _: True)
    design = SimpleNamespace(
        layout=LAYOUT, gradient=np.zeros((0, 20)), phi=np.zeros((0, 20)), duration_s=np.ones(20), y=np.full(20, 10.0)
    )
    design.residual, design.runs = -10.0 * np.repeat(off, 10), (slice(0, 10), slice(10, 20))
    design.base = design.y
    monkeypatch.setattr(simpler, "seconds_at_rest", lambda _: np.zeros(20))
    gram = SimpleNamespace(joint=lambda *_: (np.zeros(0), None))
    model = SimpleNamespace(source=None, design=design, gram=gram, chosen=())
    assert (simpler.level_difference(model) is not None) is told


@pytest.mark.parametrize(
    ("ratio", "prior", "may"), [(1.045, 0.03, False), (1.055, 0.03, True), (0.945, 0.9, True), (1.5, 1.1, False)]
)
def test_a_factor_may_lie_between_a_meter_and_a_file_with_priors(ratio: float, prior: float, may: bool) -> None:
    run = SimpleNamespace(dt_s=np.ones(4), measured_w=np.array([ratio, ratio, ratio, np.nan]), base_w=np.ones(4))
    layout = SimpleNamespace(parameters=("c2",), prior_sd=np.array([prior, 9.0]))
    assert simpler.may_differ(SimpleNamespace(layout=layout, runs=[run])) is may


@pytest.mark.parametrize(
    ("rows", "size_w", "told"),
    [(0, 0.0, False), (20, 7.0, False), (20, 20.0, True), (4, 90.0, False), (60, 20.0, False)],
)
def test_peaks_in_little_of_the_time(rows: int, size_w: float, told: bool) -> None:
    """A thousand rows of normal noise, some of them with a peak: 2 % of the time, of which four rows are too few."""
    left_w = np.random.default_rng(1).normal(size=1000 if rows != 4 else 200)
    left_w[:rows] = size_w
    words = residual.peaks(left_w, np.ones(len(left_w)))
    assert words.startswith(f"peaks of about {size_w:.0f} W hold 89 % of the squared error") if told else words == ""


@pytest.mark.parametrize(("runs", "floors", "told"), [(9, 3, True), (10, 3, False), (8, 2, True), (9, 2, False)])
def test_a_label_that_is_constant_in_runs_may_be_it_where_a_level_has_up_to_three_runs(
    monkeypatch: pytest.MonkeyPatch, runs: int, floors: int, told: bool
) -> None:
    of_floor = (np.arange(runs) % floors == np.arange(floors)[:, None]).astype(float)
    label = SimpleNamespace(effect="floor", levels=tuple("abc"[:floors]))
    model: Any = SimpleNamespace(
        noise=SimpleNamespace(gain=0.0, motion_gain=0.0, offset_w=1.0),
        design=SimpleNamespace(
            layout=LAYOUT,
            phi=of_floor,
            runs=[slice(j, j + 1) for j in range(runs)],
            names=[f"run{j}" for j in range(runs)],
        ),
        constraints=SimpleNamespace(candidates=(label,), effect=np.zeros(floors, dtype=int)),
        chosen=(),
        source=SimpleNamespace(runs=(), covariates=()),
    )
    monkeypatch.setattr(simpler, "random_effects", lambda *_: np.outer(np.arange(runs) % floors, [2.0, 0.0, 0.0]))
    monkeypatch.setattr(simpler, "cause_is_constant", lambda *_: True)
    told_of, _ = simpler.runs_apart(model)
    assert told_of is not None
    assert told_of.effects == (("floor",) if told else ())
    assert ("it may be floor" in told_of.shape) == told

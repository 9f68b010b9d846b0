"""``lag(x, tau)`` in the power of an effect, against solutions of its differential equation that are none of ours."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from scipy.integrate import solve_ivp

from missionsim.cli.app import run_command
from missionsim.effects.base import ParameterSpec
from missionsim.effects.base_terms import expression_term
from missionsim.effects.model import ModelParameter, PowerModel, Term, TermKey
from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.expressions import compile_expression
from missionsim.inputs.power import build_power_model
from missionsim.physics.lag import SETTLED, Lagged, lagged
from missionsim.runs.drive import assume, drive_blocks
from missionsim.uncertainty.arrays import ArrayMission, compile_arrays
from missionsim.uncertainty.draws import make_sampler
from tests.compare.worlds import cut, log_of
from tests.engine.making import load, robot, run

Signal = Callable[[float], float]
TAU = 8.0
RUN_ON = "k * max(lag(abs(speed_m_s), tau) - abs(speed_m_s), 0)"
HEAT = "k * lag(v**2, tau)**2"


def solution(knots: Sequence[float], x: Signal, tau: float, power: Callable[[float, float], float]) -> np.ndarray:
    """Lag of x and energy of a power of both, at knots between which x is smooth."""
    found = [np.array([x(knots[0]), 0.0])]
    for low, high in pairwise(knots):

        def slope(t: float, y: np.ndarray, low: float = low, high: float = high) -> list[float]:
            now = x(min(max(t, low + 1e-9), high - 1e-9))
            return [(now - y[0]) / tau, power(y[0], now)]

        made = solve_ivp(slope, (low, high), found[-1], "DOP853", rtol=1e-12, atol=1e-12, max_step=0.25)
        found.append(made.y[:, -1])
    return np.array(found)


def with_lag(power: str, tau: Any = TAU, k: float = 40.0, **changes: Any) -> dict[str, Any]:
    effect = {"name": "fan", "battery": "main", "power": power, "parameters": {"k": k}}
    if "tau" in power:
        effect["parameters"]["tau"] = tau if isinstance(tau, dict) else f"{tau} s"
    return robot(effects=[effect], **changes)


def fan(result: RunResult) -> np.ndarray:
    """Energy of the effect in each interval [J]."""
    return next(joules for key, joules in result.energies["main"].items() if key.name == "fan")


def speed_of(result: RunResult) -> tuple[list[float], Signal]:
    """Instants at which something changes, and the speed at any time."""
    line = result.timeline
    knots = [*line.start_s.tolist(), float(line.start_s[-1] + line.duration_s[-1])]
    first, rate = line.columns["speed_m_s"], line.rates["speed_m_s"]

    def speed(t: float) -> float:
        i = min(int(np.searchsorted(line.start_s, t, side="right")) - 1, len(line) - 1)
        return float(first[i] + rate[i] * (t - line.start_s[i]))

    return knots, speed


@pytest.mark.parametrize(
    ("formula", "x", "power"),
    [
        (RUN_ON, lambda v: v, lambda y, v: 40.0 * max(y - v, 0.0)),
        (HEAT, lambda v: v**2, lambda y, _: 40.0 * y**2),
        ("k * tanh(lag(max(v - 0.3, 0), 8) / 0.1)", lambda v: max(v - 0.3, 0.0), lambda y, _: 40.0 * np.tanh(y / 0.1)),
        ("k * lag(exp(-v / 0.2) * (v > 0.5), 8)", lambda v: np.exp(-v / 0.2) * (v > 0.5), lambda y, _: 40.0 * y),
    ],
)
def test_run_agrees_with_an_independent_solution(
    formula: str, x: Callable[[float], float], power: Callable[[float, float], float]
) -> None:
    # 0.4 m/s² up, 0.6 down: knots of the speed by hand
    segments = [{"wait": {"duration": "20 s"}}, {"drive": {"distance": "30 m", "speed": 0.8}}]
    result = run(
        [*segments, {"wait": {"duration": "5 min"}}, {"drive": {"distance": "9 m", "speed": 1.2}}], with_lag(formula)
    )
    times, speeds = [0.0, 20.0], [0.0, 0.0]
    for length, top, stands in ((30.0, 0.8, 300.0), (9.0, 1.2, 0.0)):
        up, down = top / 0.4, top / 0.6
        cruise = (length - 0.5 * top * (up + down)) / top
        times += [times[-1] + up, times[-1] + up + cruise, times[-1] + up + cruise + down]
        speeds += [top, top, 0.0]
        if stands:
            times, speeds = [*times, times[-1] + stands], [*speeds, 0.0]
    crossings = []
    for threshold in (0.3, 0.5):  # where the signals of two of the formulas bend or jump
        for (t0, v0), (t1, v1) in pairwise(zip(times, speeds, strict=True)):
            if (v0 > threshold) != (v1 > threshold):
                crossings.append(t0 + (t1 - t0) * (threshold - v0) / (v1 - v0))
    knots = sorted({*times, *crossings})
    wanted = solution(knots, lambda t: x(float(np.interp(t, times, speeds))), TAU, power)[-1, 1]
    assert wanted > 1.0
    assert fan(result).sum() == pytest.approx(wanted, rel=1e-9)
    assert result.batteries["main"].audit_relative_error < 1e-9


@pytest.mark.parametrize("circuit", [pytest.param(False, marks=pytest.mark.long), True])
def test_the_lag_goes_on_where_the_engine_has_looked_at_the_battery(circuit: bool) -> None:
    # a charger that fills to a level makes the engine evaluate what has been, and go on from there
    battery: dict[str, Any] = {"capacity": "20 Wh", "charge_efficiency": 1.0}
    if circuit:
        model = {"kind": "equivalent_circuit", "open_circuit_voltage": [[0, 20], [1, 25]], "resistance": 0.1}
        battery |= {"nominal_voltage": 24, "model": model}
    made = with_lag(RUN_ON, 40.0, batteries={"main": battery, "aux": {"capacity": "100 Wh"}})
    site = {
        "places": {"home": {"charger": {"power": "80 W", "batteries": ["main"]}}, "far": {}},
        "edges": [{"name": "way", "from": "home", "to": "far", "length": "40 m"}],
    }
    there = [{"drive": {"to": "far", "speed": 1.0}}, {"drive": {"to": "home", "speed": 1.0}}]
    dock = {"dock": {"recharge": {"until": "98 %", "batteries": ["main"]}}}
    result = run(
        [*there, dock, *there, {"wait": {"duration": "30 s"}}],
        made,
        site,
        start="home",
        defaults={"turn_at_places": False},
    )
    assert result.completed
    knots, speed = speed_of(result)
    wanted = solution(knots, speed, 40.0, lambda y, v: 40.0 * max(y - v, 0.0))
    assert fan(result) == pytest.approx(np.diff(wanted[:, 1]), rel=1e-8, abs=1e-7)
    assert fan(result).sum() == pytest.approx(wanted[-1, 1], rel=1e-9)


def test_the_way_home_begins_as_warm_as_the_drive_ended() -> None:
    site = {"places": {"home": {}, "far": {}}, "edges": [{"from": "home", "to": "far", "length": "40 m"}]}
    out, back = {"drive": {"to": "far", "speed": 1.0}}, {"drive": {"to": "home", "speed": 1.0}}
    setting = {"start": "home", "defaults": {"turn_at_places": False}}
    away = run([out], with_lag(HEAT), site, **setting)
    both = run([out, back], with_lag(HEAT), site, **setting)
    needed = both.batteries["main"].energy_wh - away.batteries["main"].energy_wh
    assert away.batteries["main"].home_wh == pytest.approx(needed, rel=1e-9)
    cold = run([{"wait": {"duration": "0 s"}}, out], with_lag(HEAT), site, **setting).batteries["main"].energy_wh
    assert needed > 1.02 * cold


def test_arrays_and_the_engine_agree() -> None:
    tau = {"value": "8 s", "sd": "0.5 s"}
    mission = load(
        {
            "segments": [
                {"wait": {"duration": {"value": "9 s", "sd": "1 s"}}},
                {"drive": {"distance": "12 m"}},
                {"wait": {"duration": "7 s"}},
                {"drive": {"distance": "8 m", "speed": 1.2}},
            ],
            "defaults": {"speed": {"value": 0.8, "sd": 0.05}},
        },
        with_lag("k * lag(v**2 + 0.5 * abs(a), tau)**2", tau),
    )
    made = compile_arrays(mission, build_power_model(mission.robot), make_sampler(mission))
    assert isinstance(made, ArrayMission), made
    draws = made.sampler.draw(5, 0, 12)
    columns, again = made.evaluate(draws, 12)
    assert not again.any()
    for i in range(12):
        one = simulate(mission, values={name: float(drawn[i]) for name, drawn in draws.items()})
        assert columns["energy_main_wh"][i] == pytest.approx(one.batteries["main"].energy_wh, rel=1e-9)
        motors = columns["component_main_motors_wh"][i] * 3600.0
        moving = sum(j.sum() for key, j in one.energies["main"].items() if key.component == "motors")
        assert motors == pytest.approx(moving, rel=1e-9)
    assert np.ptp(columns["energy_main_wh"]) > 0.0


def law(formula: str, **own: float) -> PowerModel:
    expression = compile_expression(formula)
    effect = expression_term("fan", expression, tuple(ParameterSpec(name, "") for name in own))
    values = {name: ModelParameter(value) for name, value in own.items()}
    return PowerModel((Term(TermKey("robot", "motors", "fan"), effect, values, base=False),), ("robot",))


def rows(seed: int = 3, count: int = 400) -> dict[str, np.ndarray]:
    """A log whose steps differ."""
    rng = np.random.default_rng(seed)
    time_s = np.cumsum(rng.uniform(0.05, 1.5, count))
    return {"time_s": time_s, "speed_m_s": np.repeat(rng.choice([-0.4, 0.0, 0.5, 1.0], count // 20), 20)}


@pytest.mark.parametrize(
    "size", [0, pytest.param(1, marks=pytest.mark.long), pytest.param(7, marks=pytest.mark.long), 64]
)
def test_a_log_is_driven_as_the_equation_says_in_blocks_too(size: int) -> None:
    columns = rows()
    log = log_of(columns, np.ones(400))
    model = law("k * lag(abs(speed_m_s), tau)", k=10.0, tau=TAU)
    blocks = cut(log, size) if size else [log]
    driven = drive_blocks(assume(model, log.columns, log.batteries), blocks)
    found = np.concatenate([block.model_w["robot"] for block in driven])
    time_s, speed = columns["time_s"], np.abs(columns["speed_m_s"])
    wanted = solution(time_s.tolist(), lambda t: float(np.interp(t, time_s, speed)), TAU, lambda y, _: y)[:, 0]
    assert found == pytest.approx(10.0 * wanted, rel=1e-9, abs=1e-9)


def test_the_lag_of_a_battery_that_is_not_asked_for_needs_no_column() -> None:
    log = log_of(rows(), np.ones(400))
    own, other = law("k * lag(abs(speed_m_s), 8)", k=10.0), law("k * lag(cpu_load, 8)", k=1.0).terms[0]
    both = replace(
        own, terms=(*own.terms, replace(other, key=TermKey("aux", "fan", "fan"))), batteries=("robot", "aux")
    )
    driven = [
        np.concatenate(
            [block.model_w["robot"] for block in drive_blocks(assume(one, log.columns, log.batteries), cut(log, 64))]
        )
        for one in (own, both)
    ]
    assert driven[1] == pytest.approx(driven[0])


def test_runs_one_after_the_other_begin_anew_and_steady_driving_is_settled() -> None:
    one, other = rows(1), rows(2)
    model = law("k * lag(abs(speed_m_s), tau)", k=10.0, tau=TAU)
    both = {name: np.concatenate([one[name], other[name]]) for name in one}
    alone = [np.asarray(model.total(cov, "robot")) for cov in (one, other)]
    assert np.asarray(model.total(both, "robot")) == pytest.approx(np.concatenate(alone))
    steady = {"speed_m_s": np.array([0.2, 0.8]), "time_s": np.full(2, 1e7)}
    assert np.asarray(model.total(steady, "robot")) == pytest.approx([2.0, 8.0])


@pytest.mark.parametrize("tau", [1e-9, 0.3, 50.0, 1e6])
def test_a_signal_with_a_jump_and_a_bend_is_followed_at_any_time_constant(tau: float) -> None:
    def signal(t: np.ndarray) -> np.ndarray:
        return np.where(t > 7.3, 2.0, 1.0) * np.tanh(0.4 * t) + np.maximum(t - 3.0, 0.0)

    length = np.array([2.0, 0.0, 10.0])
    start = np.append(0.0, np.cumsum(length)[:-1])
    made = Lagged(
        lambda which, seconds: signal(start[which][:, None] + seconds),
        length,
        np.full(3, tau),
        np.array([0.7, np.nan, SETTLED]),
    )
    times = np.array([0.01, 0.5, 1.0, 1.9])
    now, end = signal(times), float(signal(np.array(9.0)))
    if tau > 1e-3:
        late = solution([0.0, *times], lambda t: float(signal(np.array(t))), tau, lambda y, _: y)[1:, 0]
        now = late + 0.7 * np.exp(-times / tau)  # the signal begins at nought, the lag at 0.7
        end = solution([2.0, 3.0, 7.3, 9.0], lambda t: float(signal(np.array(t))), tau, lambda y, _: y)[-1, 0]
    assert made(np.zeros(1, dtype=np.intp), times[None])[0] == pytest.approx(now, rel=1e-9, abs=2.0 * min(tau, 1e-6))
    assert made(np.array([2]), np.array([[7.0]]))[0, 0] == pytest.approx(end, rel=1e-9, abs=2.0 * min(tau, 1e-6))


def test_a_log_with_one_row_and_no_time_constant_is_its_own_lag() -> None:
    assert lagged(np.array([3.0]), np.zeros(1), 5.0) == pytest.approx([3.0])
    assert lagged(np.array([3.0, 1.0]), np.array([0.0, 1.0]), 0.0) == pytest.approx([3.0, 1.0])


@pytest.mark.parametrize(
    ("formula", "tau", "offset", "told"),
    [
        ("k * lag(abs(speed_m_s))", "8 s", 4, "'lag' takes 2 arguments"),
        ("k * lag(abs(speed_m_s), -3)", "8 s", 24, "lag has no such time constant"),
        ("k * lag(abs(speed_m_s), 0)", "8 s", 24, "lag has no such time constant"),
        ("k * lag(abs(speed_m_s), 2 * tau)", "8 s", 24, "lag has no such time constant"),
        ("k * lag(abs(speed_m_s), tau)", "-8 s", 4, "impossible time constant 'tau'"),
        ("k * lag(abs(speed_m_s), tau)", "8 m", 4, "wrong unit of the time constant 'tau'"),
        ("k * lag(abs(speed_m_s), tau)", "8 1/s", 4, "wrong unit of the time constant 'tau'"),
        ("k * lag(abs(speed_m_s), temp_motor_c)", "8 s", 4, "the time constant 'temp_motor_c' is no parameter"),
        ("k * lag(lag(abs(speed_m_s), 3), tau)", "8 s", 4, "a lag of a lag"),
        ("k * lag(3, tau)", "8 s", 4, "lag of something that is constant"),
        ("k * lag(k, tau)", "8 s", 4, "lag of something that is constant"),
    ],
)
def test_a_lag_that_cannot_be_is_told_with_its_place(
    formula: str, tau: str, offset: int, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = yaml.safe_dump({**robot(effects=[]), "name": "bad"}).replace("effects: []\n", "")
    text += f"effects:\n  - name: fan\n    battery: main\n    power: {formula}\n    parameters: {{k: 4, tau: {tau}}}\n"
    path = tmp_path / "bad.yaml"
    path.write_text(text)
    assert run_command(["validate", str(path)]) == 2
    faults = [line for line in capsys.readouterr().err.splitlines() if "error: " in line and "file" not in line[:6]]
    line = text.count("\n") - 1
    assert faults[0].endswith(f"bad.yaml:{line}:{12 + offset}: error: {told}")


@pytest.mark.parametrize(
    "changes",
    [
        {"motion": {"battery": "main", "model": "expression", "power": "c * lag(v, 5)", "parameters": {"c": 3.0}}},
        {"components__lidar__loads": [{"battery": "main", "law": {"power": "5 * lag(cpu_load, 5)"}}]},
    ],
)
def test_a_lag_is_of_effects_alone(changes: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "bad.yaml"
    path.write_text(yaml.safe_dump(robot(**changes)))
    assert run_command(["validate", str(path)]) == 2
    assert "a lag has no place here" in capsys.readouterr().err

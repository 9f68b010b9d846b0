"""Manoeuvres: what they vary, how they look as columns, and whether the proposed one separates what it should."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from missionsim.diagnose import diagnose_files, experiments
from missionsim.diagnose.examine import Subject
from missionsim.diagnose.experiments import imagined_run, power_of
from missionsim.diagnose.features import make_features
from missionsim.diagnose.manoeuvres import Part, library, script, sharpest, site_of
from missionsim.effects.covariates import derive
from missionsim.inputs.loading import load_robot
from missionsim.labels import Labels
from missionsim.laws.experiment import CURVATURE
from missionsim.runs.run import Run

LIMITS = {"speed_m_s": 0.75, "yaw_rate_rad_s": 1.0, "accel_m_s2": 0.3}


def car_most(logged: dict[str, object]) -> dict[str, float]:
    """The same of a robot that cannot turn on the spot."""
    return LIMITS | {CURVATURE: sharpest([logged])}


def covariates(**more: object) -> dict[str, object]:
    count = 200
    v = np.tile(np.repeat([0.0, 0.5], 50), 2)
    columns: dict[str, object] = {
        "time_s": np.arange(count) + 0.5,
        "speed_m_s": v,
        "yaw_rate_rad_s": np.zeros(count),
        "on_kinect": (v > 0).astype(float),
        **more,
    }
    return derive(columns, np.arange(count) + 0.5, np.ones(count))


def as_run(columns: dict[str, object]) -> Run:
    power = {"robot": 10.0 + np.asarray(columns["speed_m_s"])}
    return Run("r", columns, np.ones(200), power, {"robot": None}, {"robot": "power"})


def test_only_what_the_place_has_is_proposed() -> None:
    plain = {m.name for m in library(site_of([covariates()], LIMITS))}
    assert {"speed sweep", "stop and go", "spin", "kinect on and off"} <= plain
    assert not plain & {"ramp", "payload on and off", "cold and warm", "processor stress"}
    rich = covariates(
        payload_kg=np.repeat([0.0, 5.0], 100),
        slope_rad=np.linspace(-0.05, 0.05, 200),
        surface=Labels.of(["tile"] * 120 + ["carpet"] * 80),
    )
    names = {m.name: m for m in library(site_of([rich], LIMITS))}
    assert {"ramp", "payload on and off", "tile and carpet"} <= set(names)
    load, clock = np.repeat([0.1, 0.9], 100), np.repeat([0.6e9, 1.8e9], 100)
    warm, far = np.linspace(5.0, 25.0, 200), np.linspace(2.0, 40.0, 200)
    other = covariates(temp_ambient_c=warm, cpu_load=load, cpu_freq_hz=clock, access_point_distance_m=far)
    names |= {m.name: m for m in library(site_of([other], LIMITS))}
    asked = {"cold and warm": "temp_ambient_c", "processor stress": "cpu_load", "processor clock": "cpu_freq_hz"}
    asked |= {"near and far from the access point": "access_point_distance_m"}
    assert {name: set(names[name].varies) for name in asked} == {name: {column} for name, column in asked.items()}
    assert names["tile and carpet"].varies == {"surface"}
    assert names["payload on and off"].varies == {"payload_kg"}
    assert names["tile and carpet"].do == "drive tile then carpet at 0.37 m/s without payload, level, 90 s each"


@pytest.mark.parametrize(("limit", "times"), [(9.0, 1.5), (0.6, None)])
def test_speeds_are_tried_beyond_what_was_driven_within_the_robots_limit(limit: float, times: float | None) -> None:
    columns = covariates()
    driven = float(np.percentile(np.asarray(columns["speed_m_s"]), 99.5))
    site = site_of([columns], {**LIMITS, "speed_m_s": limit})
    sweep = next(one for one in library(site) if one.name == "speed sweep")
    fastest = max(sweep.parts[0].speeds_m_s)
    assert fastest == pytest.approx(0.95 * (limit if times is None else times * driven), abs=1e-3)
    assert site.cruise_m_s <= driven


def test_a_script_keeps_the_robots_limits_and_the_length() -> None:
    rich = covariates(payload_kg=np.repeat([0.0, 5.0], 100), surface=Labels.of(["tile"] * 120 + ["carpet"] * 80))
    site = site_of([rich], LIMITS)
    for manoeuvre in library(site):
        columns = script(manoeuvre, site)
        v, t = columns["speed_m_s"], columns["time_s"]
        assert manoeuvre.duration_s == 180.0
        assert t[-1] == pytest.approx(180.0, abs=1.0)
        assert v.min() >= 0.0
        assert v.max() <= 0.75
        assert np.abs(np.diff(v)).max() <= 0.3 * 0.5 + 1e-9
        assert np.abs(columns["yaw_rate_rad_s"]).max() <= 1.0
        assert {"payload_kg", "surface", "on_kinect"} <= set(columns)


def test_a_car_is_not_asked_to_stop_more_often_than_it_can() -> None:
    """Not every 12 s at 71 km/h: with the accelerations of its logs it reaches the speed between any two stops."""
    time_s = np.arange(1200.0)
    accel = np.clip(3.0 * np.sin(time_s / 20.0), -2.0, 1.5)
    speed = 18.0 - 60.0 * np.cos(time_s / 20.0) / 4.0
    car = derive({"time_s": time_s, "speed_m_s": speed, "accel_m_s2": accel}, time_s, np.ones(1200))
    site = site_of([car], {"speed_m_s": 33.0})
    manoeuvre = next(m for m in library(site) if m.name == "stop and go")
    columns = script(manoeuvre, site)
    v, (part,) = columns["speed_m_s"], manoeuvre.parts
    assert np.abs(columns["accel_m_s2"]).max() <= 1.5
    stretches = np.split(v, np.flatnonzero(v == 0.0))
    reached = [stretch.max() for stretch in stretches if len(stretch) > 4]
    assert len(reached) == part.stops + 1
    assert min(reached) == pytest.approx(site.cruise_m_s)
    assert f"at {site.cruise_m_s:g} m/s with a full stop every 90 s" in manoeuvre.do
    robot = next(m for m in library(site_of([covariates()], LIMITS)) if m.name == "stop and go")
    assert "with a full stop every 12 s" in robot.do


def test_a_car_is_not_asked_to_turn_on_the_spot() -> None:
    """Nor in tighter circles than it drove, which its yaw rate alone does not tell."""
    turning = covariates(yaw_rate_rad_s=np.where(np.arange(200) % 50 < 25, 0.3, -0.1))
    robot = {m.name: m for m in library(site_of([turning], LIMITS))}
    assert {"spin", "straight and curved"} <= set(robot)
    site = site_of([turning], car_most(turning))
    car = {m.name: m for m in library(site)}
    assert set(robot) - set(car) == {"spin"}
    assert "in circles at 0.216 rad/s" in robot["straight and curved"].do
    for radius_m in (2.5, 5.0):
        turned = covariates(yaw_rate_rad_s=np.tile(np.repeat([0.0, 0.5], 50), 2) / radius_m)
        narrow = site_of([turned], car_most(turned))
        curve = next(m for m in library(narrow) if m.name == "straight and curved")
        (rate,) = curve.parts[1].yaw_rates_rad_s
        assert rate <= narrow.cruise_m_s / radius_m + 1e-9
    assert "straight and curved" not in {m.name for m in library(site_of([covariates()], car_most(covariates())))}


def test_of_a_car_that_never_turned_it_is_said_that_no_drive_shows_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(experiments, "propose", lambda *_: [])
    left = SimpleNamespace(depends_on=["yaw_rate_rad_s"], structures=[])
    for on_the_spot, told in ((True, "turn on the spot"), (False, "no manoeuvre that this robot can drive")):
        site = site_of([covariates()], LIMITS if on_the_spot else car_most(covariates()))
        bench = SimpleNamespace(site=site, features=SimpleNamespace(candidates=[]))
        assert experiments.next_experiments(bench, [], left)[0].do.startswith(told)


@pytest.mark.parametrize("on", ["time_s", "slope_rad"])
def test_of_a_car_whose_logs_have_curves_it_is_not_said_that_they_have_none(
    monkeypatch: pytest.MonkeyPatch, on: str
) -> None:
    """ "It cannot turn on the spot, and these logs have no curve: log some" came with any dependence that the place
    shows no manoeuvre for, whatever the logs held."""
    monkeypatch.setattr(experiments, "propose", lambda *_: [])
    turned = covariates(yaw_rate_rad_s=np.tile(np.repeat([0.0, 0.5], 50), 2) / 5.0)
    site = replace(site_of([turned], car_most(turned)), components={})
    bench = SimpleNamespace(site=site, features=SimpleNamespace(candidates=[]))
    for left in (
        SimpleNamespace(depends_on=[on], structures=[]),
        SimpleNamespace(depends_on=[on, "run"], structures=[]),
    ):
        assert not [one.do for one in experiments.next_experiments(bench, [], left) if "curve" in one.do]


def test_the_robot_file_says_what_its_drive_can() -> None:
    robot = load_robot("pioneer3dx")
    most = Subject.of(robot).most([covariates()])
    assert {name: most[name] for name in ("speed_m_s", "yaw_rate_rad_s")} == {"speed_m_s": 0.75, "yaw_rate_rad_s": 1.0}
    assert CURVATURE not in most
    car = robot.model_copy(update={"body": robot.body.model_copy(update={"drive": "ackermann"})})
    assert Subject.of(car).most([covariates()])[CURVATURE] == 0.0


def test_a_manoeuvre_stands_and_weighs_as_it_says() -> None:
    model = Subject.of(load_robot("pioneer3dx")).model
    logged = covariates(payload_kg=np.repeat([0.0, 5.0], 100))
    # what follows from motion and load is not as it usually was
    derived = {**logged, "moving": np.ones(200), "mass_kg": np.full(200, 14.0), "drive_w": np.full(200, 4.0)}
    features = make_features(model, [as_run(logged)], "robot")
    manoeuvre = next(m for m in library(site_of([logged], LIMITS)) if m.name == "stand and drive")
    bare, full = (imagined_run(model, features, manoeuvre, site_of([one], LIMITS)) for one in (logged, derived))
    assert full.base_w == pytest.approx(bare.base_w, rel=1e-12)
    assert full.base_w[0] < full.base_w[-20]


def test_parts_as_plain_data() -> None:
    part = Part(90.0, (0.5,), set={"payload_kg": 4.0, "on_kinect": 1.0, "surface": "tile"})
    assert part.to_json() == {
        "seconds": 90.0,
        "speeds_m_s": [0.5],
        "yaw_rate_rad_s": 0.0,
        "stops": 0,
        "payload_kg": 4.0,
        "surface": "tile",
        "on": {"kinect": 1.0},
    }


def test_power_of_a_lead_grows_from_nothing_to_certainty() -> None:
    leads = [0.0, 1.0, 2.944, 10.0, 40.0]
    powers = [power_of(lead) for lead in leads]
    assert powers == sorted(powers)
    assert powers[0] == 0.0
    assert powers[2] == pytest.approx(0.5)
    assert powers[-1] > 0.999
    # by simulation: the log-likelihood ratio is normal with mean D and variance 2 D
    draws = np.random.default_rng(1).normal(10.0, np.sqrt(20.0), 200_000)
    assert power_of(10.0) == pytest.approx(float(np.mean(draws > np.log(19.0))), abs=0.005)


@pytest.mark.parametrize(
    ("leads", "told"),
    [
        ((13.0, 30.0, 4.0, 11.9), ["hill", "hill with payload"]),
        ((13.0, 23.9, 4.0, 12.0), [experiments.ELSEWHERE]),  # the logs should have told them apart by themselves
        ((13.0, 24.0, 4.0, 12.0), ["hill with payload"]),  # as much again
        ((13.0, 30.0, 4.0), ["hill", "hill with payload"]),  # both will do: first the one that varies a single cause
        ((1.5, 1.2, 1.8), []),  # a nat at least beyond what is known
        ((4.0, 1.2, 1.2), ["hill; 4 times as long"]),
        ((1.2, 7.0, 1.2), ["hill with payload; 2 times as long"]),
    ],
)
def test_the_manoeuvre_that_is_proposed(monkeypatch: pytest.MonkeyPatch, leads: list[float], told: list[str]) -> None:
    """For a grade that may be payload; a lead of one nat, or of the last that is given, is in the logs."""
    leads, now = leads[:3], [*leads, 1.0][3]
    causes = {"hill": {"slope_rad"}, "hill with payload": {"slope_rad", "payload_kg"}, "long hill": {"slope_rad"}}
    manoeuvres = [
        SimpleNamespace(do=do, varies=varied, lead=lead, duration_s=60.0, parts=())
        for (do, varied), lead in zip(causes.items(), leads, strict=True)
    ]
    bench = SimpleNamespace(
        site=None,
        imagined=lambda manoeuvre: manoeuvre.lead,
        model=SimpleNamespace(gram=now, design=SimpleNamespace(layout=None)),
        features=SimpleNamespace(
            candidates=[SimpleNamespace(effect=n, covariate=c) for n, c in (("a", "slope_rad"), ("b", "payload_kg"))]
        ),
    )
    for name, stub in {
        "library": lambda _: manoeuvres,
        "shortened": lambda one, times: SimpleNamespace(
            **{**vars(one), "lead": times * one.lead, "duration_s": times * one.duration_s}
        ),
        "worst_lead": lambda _bench, _constraints, gram, _names: gram,
        "_columns": lambda *_: [0],
        "Constraints": SimpleNamespace(of=lambda *_: None),
    }.items():
        monkeypatch.setattr(experiments, name, stub)
    assert [one.do for one in experiments.propose(bench, ["a", "b"])] == told


@pytest.mark.parametrize(
    ("leads", "told"),
    [
        ({"abc": 0.3, "ab": 14.0, "ac": 0.3}, ("a", "b")),  # nothing tells c from the others
        ({"abc": 2.0, "ab": 14.0, "ac": 2.0}, ("a", "b")),  # one of two surely, rather than both perhaps
        ({"abc": 6.0, "ab": 14.0, "ac": 6.0}, ("a", "b", "c")),
        ({"abc": 0.3, "ab": 0.4, "ac": 13.0}, ("a", "c")),
        ({"abc": 0.3, "ab": 0.4, "ac": 0.3}, None),
        ({"abc": 0.0, "ab": 0.4, "ac": 13.0, "now": 13.0}, None),  # what these logs should have told no drive adds to
    ],
)
def test_a_part_of_a_set_is_told_apart_where_no_drive_tells_all(
    monkeypatch: pytest.MonkeyPatch, leads: dict[str, float], told: tuple[str, ...] | None
) -> None:
    """For an effect with two rivals: the leads that one manoeuvre would give, and those of now, 0.2 or as given."""
    now = leads.get("now", 0.2)
    hill = SimpleNamespace(do="hill", varies=set(), duration_s=60.0, parts=(), gram=True)
    bench = SimpleNamespace(
        site=None,
        imagined=lambda manoeuvre: manoeuvre.gram,
        model=SimpleNamespace(gram=False, design=SimpleNamespace(layout=None)),
        features=SimpleNamespace(candidates=[SimpleNamespace(effect=n, covariate=n) for n in "abc"]),
    )

    def lead(_bench: object, _constraints: object, driven: bool, names: tuple[str, ...]) -> float:
        return leads["".join(names)] if driven else (0.0 if len(names) == 3 else now)

    for name, stub in {
        "library": lambda _: [hill],
        "shortened": lambda one, times: one,
        "worst_lead": lead,
        "_columns": lambda *_: [0],
        "Constraints": SimpleNamespace(of=lambda *_: None),
    }.items():
        monkeypatch.setattr(experiments, name, stub)
    found = experiments.propose(bench, ["a", "b", "c"])
    assert [one.separates for one in found] == ([told] if told else [])


OWN = """kind: robot
name: own
body: {mass: 40 kg, drive: differential, max_speed: 1 m/s}
batteries: {robot: {capacity: 200 Wh}}
motion:
  battery: robot
  model: expression
  power: "c2*v**2 + c3*v + c4"
  standing: s0
  parameters: {c2: 10, c3: 20, c4: 23, s0: 18}
"""


def recorded(path: Path, rng: np.random.Generator, speed: np.ndarray, kg: np.ndarray, carpet: np.ndarray) -> None:
    """A run at 2 Hz in which carpet costs 8 N, and payload nothing."""
    noise = np.zeros(len(speed))
    for i in range(1, len(speed)):
        noise[i] = 0.85 * noise[i - 1] + rng.normal(0.0, 0.25)
    power = np.where(speed > 0, 23 + 20 * speed + 10 * speed**2, 18) + 8 * speed * carpet + noise
    columns = {"time_s": 0.5 * np.arange(len(speed)), "power_robot_w": power, "speed_m_s": speed, "payload_kg": kg}
    table = pd.DataFrame(columns | {"yaw_rate_rad_s": 0.0, "surface": np.where(carpet > 0, "carpet", "tile")})
    table.round(3).to_csv(path, index=False)


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.long)])
@pytest.mark.usefixtures("effects_alone")
def test_the_drive_that_is_proposed_resolves_what_it_promises_to(tmp_path: Path, seed: int) -> None:
    """Loads were carried on the carpet alone; the drive goes as its parts say, and the verdict names what it costs."""
    rng = np.random.default_rng(seed)
    (tmp_path / "own.yaml").write_text(OWN)
    (tmp_path / "logs").mkdir()
    for run in range(8):
        speed = np.repeat(rng.choice([0.0, 0.3, 0.6, 0.9], 40), 8)
        carpet = np.repeat(rng.choice([0.0, 1.0], 8), 40)
        recorded(tmp_path / "logs" / f"run_{run}.csv", rng, speed, 12.0 * carpet, carpet)
    first = diagnose_files(tmp_path / "own.yaml", [tmp_path / "logs"], holdout="none").batteries["robot"]
    assert first.verdict == "ambiguous"
    proposed = first.next_experiments[0]
    assert proposed.expected_power > 0.95
    parts = [(round(2 * part["seconds"]), part) for part in proposed.manoeuvre]
    speed, kg, carpet = (
        np.concatenate([np.full(rows, value(part)) for rows, part in parts])
        for value in (
            lambda part: part["speeds_m_s"][0],
            lambda part: part["payload_kg"],
            lambda part: float(part["surface"] == "carpet"),
        )
    )
    recorded(tmp_path / "logs" / "proposed.csv", rng, speed, kg, carpet)
    second = diagnose_files(tmp_path / "own.yaml", [tmp_path / "logs"], holdout="none").batteries["robot"]
    assert second.verdict == "effects_found"
    assert [effect.effect for effect in second.effects] == ["surface_rolling_resistance"]

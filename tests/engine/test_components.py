"""Components: what they require first, starting up, off when nobody needs them; activities beside the driving."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from missionsim.engine.outcome import RunResult
from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.inputs.loading import load_mission
from tests.engine.making import load, robot, run


def spans(result: RunResult, component: str, column: str = "on") -> list[tuple[float, float, float]]:
    """When a component is in a state: (begin, end, units), neighbours joined."""
    line = result.timeline
    found: list[tuple[float, float, float]] = []
    for start, length, units in zip(line.start_s, line.duration_s, line.columns[f"{column}_{component}"], strict=True):
        if not units:
            continue
        if found and found[-1][2] == units and abs(found[-1][1] - start) < 1e-9:
            found[-1] = (found[-1][0], start + length, units)
        else:
            found.append((start, start + length, units))
    return [(round(a, 6), round(b, 6), float(n)) for a, b, n in found]


STARTING = {"duration": 3.0, "power": 4.0}


def test_the_robot_waits_standing_for_a_component_that_starts() -> None:
    machine = robot(components__camera__startup=STARTING)
    drive = {"distance": 10, "speed": 1, "profile": "constant_speed", "sensors": {"camera": 2}}
    result = run([{"drive": drive}], machine)
    assert result.duration_s == pytest.approx(13.0)
    assert spans(result, "camera", "starting") == [(0.0, 3.0, 2.0)]
    assert spans(result, "camera") == [(3.0, 13.0, 2.0)]
    joules = result.energy_j["main"]["camera"]
    assert float(joules["camera start-up"].sum()) == pytest.approx(2 * 4.0 * 3.0)
    assert float(joules["camera"].sum()) == pytest.approx(2 * 2.5 * 10.0)
    assert list(result.timeline.columns["moving"]) == [0.0, 1.0]


def test_a_relay_is_closed_while_what_hangs_on_it_starts() -> None:
    machine = robot(
        components__camera__startup=STARTING,
        components__camera__relay="board",
        switchboards={"board": {"battery": "main", "power": [0.5, 1.0, 3.0]}},
    )
    result = run([{"wait": {"duration": 10}}, {"wait": {"duration": 10, "sensors": {"camera": 2}}}], machine)
    assert list(result.energy_j["main"]["board"]["board"]) == pytest.approx([0.5 * 10, 3.0 * 3, 3.0 * 10])


def test_the_rate_of_a_law_is_one_of_its_numbers() -> None:
    """Beside a registered law it was read by nothing, and said to be missing."""
    law = {"model": "sampled_sensor", "rate": "5 Hz", "parameters": {"per_rate": 0.2, "constant": 0.4}}
    segments = [{"wait": {"duration": 10, "sensors": {"radio": 1}}}]
    result = run(segments, robot(components__radio__loads=[{"battery": "aux", "law": law}]))
    assert float(result.energy_j["aux"]["radio"]["radio"].sum()) == pytest.approx(10 * (0.2 * 5 + 0.4))
    law["parameters"] = {"per_rate": 0.2, "rate": 4}
    with pytest.raises(InputError, match="a rate beside a parameter 'rate'"):
        run(segments, robot(components__radio__loads=[{"battery": "aux", "law": law}]))


def test_requirements_come_first_one_after_the_other() -> None:
    machine = robot(
        components__camera__startup=STARTING,
        components__radio__startup={"duration": 2.0},
        components__camera__requires=["radio"],
    )
    result = run([{"wait": {"duration": 10, "sensors": {"camera": 1}}}, {"wait": {"duration": 5}}], machine)
    assert spans(result, "radio", "starting") == [(0.0, 2.0, 1.0)]
    assert spans(result, "radio") == [(2.0, 15.0, 1.0)]
    assert spans(result, "camera", "starting") == [(2.0, 5.0, 1.0)]
    assert spans(result, "camera") == [(5.0, 15.0, 1.0)]
    # nobody needs them any more
    assert result.duration_s == pytest.approx(20.0)
    assert not result.timeline.columns["on_radio"][-1]


def test_a_needed_component_is_not_restarted_between_segments() -> None:
    machine = robot(components__camera__startup=STARTING)
    stand = {"wait": {"duration": 10, "sensors": {"camera": 1}}}
    result = run([stand, stand, stand], machine)
    assert spans(result, "camera", "starting") == [(0.0, 3.0, 1.0)]
    assert spans(result, "camera") == [(3.0, 33.0, 1.0)]


def test_an_activity_hands_over_to_a_segment_without_a_gap() -> None:
    machine = robot(components__camera__startup=STARTING)
    beside = [{"component": "camera", "from": {"time": 0.0}, "until": {"time": 10.0}}]
    result = run(
        [{"wait": {"duration": 10}}, {"wait": {"duration": 5, "sensors": {"camera": 1}}}], machine, activities=beside
    )
    assert spans(result, "camera", "starting") == [(0.0, 3.0, 1.0)]
    assert spans(result, "camera") == [(3.0, 15.0, 1.0)]


def test_the_larger_need_counts() -> None:
    beside = [{"component": "camera", "units": 1, "from": {"time": 2.0}, "duration": 6.0}]
    result = run([{"wait": {"duration": 5, "sensors": {"camera": 2}}}, {"wait": {"duration": 5}}], activities=beside)
    assert spans(result, "camera") == [(0.0, 5.0, 2.0), (5.0, 8.0, 1.0)]


def test_bursts() -> None:
    beside = [{"component": "radio", "every": 10, "duration": 2, "from": {"time": 5}, "until": {"time": 31}}]
    result = run([{"wait": {"duration": 60}}], activities=beside)
    assert spans(result, "radio") == [(5.0, 7.0, 1.0), (15.0, 17.0, 1.0), (25.0, 27.0, 1.0)]
    cut = [{"component": "radio", "every": 10, "duration": 2, "from": {"time": 5}, "until": {"time": 26}}]
    assert spans(run([{"wait": {"duration": 60}}], activities=cut), "radio")[-1] == (25.0, 26.0, 1.0)


PLACES: dict[str, Any] = {
    "places": {"A": {"x": 0, "y": 0}, "B": {"x": 10, "y": 0}, "C": {"x": 20, "y": 0}},
    "edges": [{"from": "A", "to": "B"}, {"from": "B", "to": "C"}],
}


def test_an_activity_between_two_places_on_every_round() -> None:
    there = {"drive": {"to": "C", "speed": 1, "profile": "constant_speed"}}
    back = {"drive": {"to": "A", "speed": 1, "profile": "constant_speed"}}
    result = run(
        [{"repeat": {"times": 2, "segments": [there, back]}}],
        environment=PLACES,
        start="A",
        activities=[{"component": "camera", "from": "B", "until": "C"}],
    )
    # on at B, off at C, on again at B on the way back, off at C in the next round
    assert spans(result, "camera") == [(10.0, 20.0, 1.0), (30.0, 60.0, 1.0), (70.0, 80.0, 1.0)]


def test_an_activity_during_named_segments() -> None:
    stand = [{"wait": {"name": name, "duration": 10}} for name in ("a", "b", "c", "d")]
    result = run(stand, activities=[{"component": "radio", "from": {"segment": "b"}, "until": {"segment": "c"}}])
    assert spans(result, "radio") == [(10.0, 30.0, 1.0)]


def test_memory_clocks_run_exactly() -> None:
    result = run(
        [
            {"drive": {"distance": 60, "speed": 1, "profile": "constant_speed"}},
            {"wait": {"duration": 30}},
            {"drive": {"distance": 60, "speed": 1, "profile": "constant_speed"}},
        ]
    )
    import math

    # k v ∫ exp(−t/τ) over 120 s of moving, whatever the pause
    expected = 4.0 * 1.0 * 60.0 * (1.0 - math.exp(-2.0))
    assert result.by_term_wh("main")["cold_friction"] * 3600.0 == pytest.approx(expected, rel=1e-9)
    # two starts from rest
    assert result.by_term_wh("main")["start_surge"] * 3600.0 == pytest.approx(10.0)


def test_turns_at_places_where_the_mission_asks() -> None:
    corner = {
        "places": {"A": {"x": 0, "y": 0}, "B": {"x": 10, "y": 0}, "C": {"x": 10, "y": 10}},
        "edges": [{"from": "A", "to": "B"}, {"from": "B", "to": "C"}],
    }
    drive = [{"drive": {"to": "C", "speed": 1, "yaw_rate": 0.5, "profile": "constant_speed"}}]
    straight = run(drive, environment=corner, start="A")
    turning = run(drive, environment=corner, start="A", defaults={"turn_at_places": True})
    assert straight.duration_s == pytest.approx(20.0)
    assert turning.duration_s == pytest.approx(20.0 + 1.5707963267948966 / 0.5)
    assert turning.by_term_wh("main")["turning_scrub"] * 3600.0 == pytest.approx(3.0 * 1.5707963267948966)


def test_behaviour_stretches_slows_and_dwells() -> None:
    drive = {"distance": 50, "speed": 1.0, "profile": "constant_speed"}
    result = run([{"drive": {**drive, "behaviour": {"path_stretch": 1.2, "speed_tracking": 0.8, "dwell": 7}}}])
    assert result.distance_m == pytest.approx(60.0)
    assert result.duration_s == pytest.approx(60.0 / 0.8 + 7.0)
    whole = run([{"drive": drive}, {"wait": {"duration": 5}}], behaviour={"path_stretch": 1.2, "dwell": 7})
    assert whole.duration_s == pytest.approx(60.0 + 7.0 + 5.0)


def test_a_mission_that_lacks_what_an_effect_reads_is_refused() -> None:
    machine = robot(effects=[{"effect": "temperature_friction", "battery": "main", "parameters": {"k": 0.1}}])
    with pytest.raises(InputError, match="temperature"):
        run([{"drive": {"distance": 10, "speed": 1}}], machine)
    warm = run([{"drive": {"distance": 10, "speed": 1}}], machine, defaults={"temperature": 15})
    assert warm.by_term_wh("main")["temperature_friction"] * 3600.0 == pytest.approx(0.1 * 10.0 * 10.0)


def test_values_reach_the_model_and_the_plan() -> None:
    spec = load({"segments": [{"drive": {"distance": 10, "speed": 1, "profile": "constant_speed"}}]})
    plain = simulate(spec)
    changed = simulate(
        spec,
        values={"main/c3": 18.0, "segments.0.drive.distance": 20.0, "robot.batteries.main.capacity": 3600.0 * 50.0},
    )
    assert changed.by_term_wh("main")["rolling"] == pytest.approx(4.0 * plain.by_term_wh("main")["rolling"])
    assert changed.batteries["main"].capacity_wh == pytest.approx(50.0)
    by_path = simulate(spec, values={"robot.motion.parameters.c3": 18.0})
    assert by_path.by_term_wh("main")["rolling"] == pytest.approx(2.0 * plain.by_term_wh("main")["rolling"])


TABLE_4 = [
    # scheme, navigation, sonar, lasers, kinect, speed, P_R, P_L as printed (Jaiem 2021, Table 4)
    ("rotational_visual_tracking", None, 0, 0, 1, 0.1, 7.52, 15.64),
    ("path_following_slow", None, 0, 0, 0, 0.1, 4.70, 11.74),
    ("path_following", "odometry", 0, 0, 0, 0.5, 10.12, 12.49),
    ("path_following", "qr_code", 0, 0, 1, 0.5, 12.94, 15.36),
    ("path_following", "qr_code", 1, 1, 1, 0.5, 15.32, 16.69),
    ("path_following", "qr_code", 1, 2, 1, 0.5, 17.66, 16.96),
    ("path_following", "qr_code", 0, 1, 1, 0.5, 15.28, 16.63),
    ("path_following", "qr_code", 0, 2, 1, 0.5, 17.62, 16.90),
    ("path_following", "grid_based_localisation", 0, 2, 0, 0.5, 14.80, None),
    ("forward_motion", None, 1, 2, 1, 0.5, 17.66, 17.02),
    ("forward_motion", None, 0, 2, 1, 0.5, 17.62, 16.96),
    ("forward_motion", None, 1, 1, 1, 0.5, 15.32, 16.31),
    ("forward_motion", None, 0, 1, 1, 0.5, 15.28, 16.25),
    ("forward_motion", None, 1, 2, 0, 0.5, 14.84, 13.71),
    ("forward_motion", None, 0, 2, 0, 0.5, 14.80, 13.65),
    ("forward_motion", None, 1, 0, 1, 0.5, 12.98, 15.04),
    ("forward_motion", None, 0, 0, 1, 0.5, 12.94, 14.98),
    ("forward_motion", None, 1, 1, 0, 0.5, 12.50, 12.33),
    ("forward_motion", None, 0, 1, 0, 0.5, 12.46, 12.27),
    ("forward_motion", None, 1, 0, 0, 0.5, 10.16, 12.17),
    ("forward_motion", None, 0, 0, 0, 0.5, 10.12, 12.11),
    ("image_analysis", None, 0, 0, 1, 0.0, 5.49, 14.00),
    ("centring_motion", "qr_code", 1, 2, 1, 0.5, 17.66, 17.84),
    ("centring_motion", "odometry", 0, 2, 0, 0.5, 14.80, 14.47),
    ("centring_motion", "odometry", 1, 2, 0, 0.5, 14.84, 14.53),
    ("centring_motion", "qr_code", 0, 2, 1, 0.5, 17.62, 17.78),
]


@pytest.mark.parametrize("row", range(26))
def test_every_row_of_table_4(row: int, tmp_path: Path) -> None:
    scheme, navigation, sonar, lasers, kinect, speed, robot_w, laptop_w = TABLE_4[row]
    sensors = {"sonar": sonar, "laser": lasers, "kinect": kinect}
    body: dict[str, Any] = {"scheme": scheme, "sensors": sensors, "profile": "constant_speed"}
    if navigation:
        body["navigation"] = navigation
    import json

    segment = {"drive": {"distance": 10, "speed": speed, **body}} if speed else {"inspect": {"duration": 10, **body}}
    path = tmp_path / "row.yaml"
    path.write_text(json.dumps({"kind": "mission", "name": "row", "robot": "pioneer3dx", "segments": [segment]}))
    result = simulate(load_mission(path))
    assert result.batteries["robot"].mean_power_w == pytest.approx(robot_w, abs=0.02)
    if laptop_w is not None:
        assert result.batteries["laptop"].mean_power_w == pytest.approx(laptop_w, abs=0.02)
    else:
        # row 9 contradicts itself: printed 16.37 W, its parts by Eq. 4 (two lasers need 0.72 W of switchboard) 16.07 W
        assert result.batteries["laptop"].mean_power_w == pytest.approx(16.072, abs=0.001)

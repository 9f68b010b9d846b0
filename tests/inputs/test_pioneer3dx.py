"""The Pioneer's file against the paper's tables."""

from __future__ import annotations

import csv
from pathlib import Path

import pytest

from missionsim.inputs import load_mission, load_robot
from missionsim.inputs.power import build_power_model

ROBOT = load_robot("pioneer3dx")
MODEL = build_power_model(ROBOT)
SCHEMES = {
    "FM": "forward_motion",
    "SPF-OA": "path_following",
    "CM-OA": "centring_motion",
    "RVT": "rotational_visual_tracking",
    "IA": "image_analysis",
}
NAVIGATION = {"ODO": "odometry", "QRCN": "qr_code", "GBL": "grid_based_localisation", "": None}


def sensors_of(row: dict[str, str]) -> dict[str, int]:
    given = {"sonar": int(row["sonar"]), "laser": int(row["lasers"]), "kinect": int(row["kinect"])}
    return {name: count for name, count in given.items() if count}


def processor_w(scheme: str, navigation: str | None, sensors: dict[str, int]) -> float:
    on = {f"on_{name}": float(count) for name, count in sensors.items()}
    cov = {"speed_m_s": 0.3, "accel_m_s2": 0.0, "scheme": scheme, "navigation": navigation or "", **on}
    return next(float(w) for key, w in MODEL.evaluate(cov)["laptop"].items() if key.component == "processor")


def test_processor_power_of_every_row_of_table_4(shared: Path) -> None:
    with open(shared / "papers" / "jaiem2021_table4.csv", newline="", encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    assert len(rows) == 26
    for row in rows:
        slow = row["row"] == "2"
        scheme = "path_following_slow" if slow else SCHEMES[row["control_scheme"]]
        navigation = None if slow else NAVIGATION[row["navigation"]]
        assert processor_w(scheme, navigation, sensors_of(row)) == float(row["P_L_proc_W"]), row["row"]
        (power,) = (
            entry.power
            for entry in ROBOT.schemes[scheme].processor
            if entry.source.endswith(f"row {row['row']}") or entry.power.source.endswith(f" row {row['row']}")
        )
        assert power.status == "published"
        assert power.source == f"Table 4 row {row['row']}"


def test_loads_of_tables_2_and_3(shared: Path) -> None:
    loads = {
        (name, load.battery): load.power.value
        for name, item in ROBOT.components.items()
        for load in item.loads
        if load.power is not None
    }
    assert loads == {
        ("kinect", "robot"): 2.82,
        ("kinect", "laptop"): 1.2,
        ("laser", "robot"): 2.34,
        ("laser", "laptop"): 0.4,
        ("screen", "laptop"): 2.69,
        ("robot_controller", "laptop"): 0.075,
        ("wattmeter", "laptop"): 0.49,
    }
    with open(shared / "papers" / "jaiem2021_table3.csv", newline="", encoding="utf-8") as handle:
        table = {(row["external_device"], row["state"]): float(row["laptop_power_W"]) for row in csv.DictReader(handle)}
    assert table[("laser", "each")] == loads[("laser", "laptop")]
    assert table[("kinect", "connected")] == loads[("kinect", "laptop")]
    assert [power.value for power in ROBOT.switchboards["switchboard1"].power] == [
        table[("switchboard", f"{count} relay{'' if count == 1 else 's'} activated")] for count in range(3)
    ]


def test_assumed_rows_follow_the_additive_structure() -> None:
    offsets = {"odometry": 11.37 + 0.38, "sonar": 0.06}
    found = processor_w("path_following", "odometry", {"sonar": 1, "laser": 1})
    assert found == pytest.approx(offsets["odometry"] + offsets["sonar"] - 0.56)


def test_configuration_without_a_row_takes_the_nearest() -> None:
    assert processor_w("image_analysis", None, {"kinect": 1, "laser": 2, "screen": 1}) == 11.74
    assert processor_w("", None, {}) == 11.37


def test_every_number_has_a_status() -> None:
    from missionsim.inputs.parameter import parameters

    without = [path for path, item in parameters(ROBOT) if not item.status and not path.endswith("max_speed")]
    assert without == []


def test_navigation_decides_which_sensors_are_on(root: Path) -> None:
    mission = load_mission(root / "missions" / "pioneer3dx" / "valve_patrol.yaml")
    by_name = {segment.name: segment for segment in mission.segments}
    assert mission.sensors_of(by_name["ER_out"]) == {"laser": 2}
    assert mission.sensors_of(by_name["V1_stop"]) == {"kinect": 1}
    assert mission.navigation_of(by_name["V1_stop"]) is None
    assert mission.navigation_of(by_name["H1_out"]) == "qr_code"


def test_patrol_is_180_m_and_its_driven_version_differs_only_in_behaviour(root: Path) -> None:
    folder = root / "missions" / "pioneer3dx"
    planned, driven = (load_mission(folder / f"valve_patrol{end}.yaml") for end in ("", "_as_driven"))
    environment = planned.environment
    assert environment is not None
    lengths = {frozenset((edge.from_, edge.to)): environment.length_m(edge) for edge in environment.edges}
    assert sum(2 * length for length in lengths.values() if length is not None) == 180.0
    for one, other in zip(planned.segments, driven.segments, strict=True):
        assert one.model_dump(exclude={"behaviour"}) == other.model_dump(exclude={"behaviour"})


def test_corridor_runs_of_table_5(root: Path) -> None:
    runs = sorted((root / "missions" / "pioneer3dx").glob("corridor_*cm_s.yaml"))
    assert len(runs) == 12
    speeds = sorted(load_mission(path).defaults.speed.value for path in runs)
    assert speeds == [0.1] * 4 + [0.3] * 4 + [0.5] * 4
    assert all(load_mission(path).segments[0].distance.value == 50.0 for path in runs)

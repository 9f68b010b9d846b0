"""Rounds with charging between and on them: as good as the same visits planned one by one, and driven as planned."""

from __future__ import annotations

import json
import time
from pathlib import Path

import pytest
import yaml

from missionsim.cli.app import run_command

SMALL = "robot.batteries.drive.capacity=9 Wh"
TAPER = "robot.batteries.drive.charge_taper={from: 60 %, end_power: 20 %}"


def task_of(root: Path, folder: Path, *, unrolled: int = 0, **changes: object) -> Path:
    """The shipped shift with changes; its rounds written out as visits where asked."""
    shift = yaml.safe_load((root / "missions/planning/shift.yaml").read_text())
    shift |= {"robot": str(root / "missions/planning/inspector.yaml")} | changes
    shift["environment"] = str(root / "environments/trial_site.yaml")
    if unrolled:
        shift.pop("repeat")
        visits = []
        for k in range(unrolled):
            home = [f"home{k}"] if k else []
            visits += [{"name": home[0], "place": "hall", "after": [v["name"] for v in visits]}] if k else []
            visits += [{**v, "name": f"{v['place']}{k}", "after": home} for v in changes.get("visits", shift["visits"])]
        shift["visits"] = visits
    path = folder / f"task{unrolled}.yaml"
    path.write_text(json.dumps(shift))
    return path


def plan(task: Path, *settings: str, code: int = 0) -> dict:
    """JSON of a plan that its mission, run, agrees with."""
    chosen = [part for text in settings for part in ("--set", text)]
    answer, mission, ran = (task.with_suffix(end) for end in (".json", ".mission.yaml", ".run.json"))
    words = ["plan", str(task), *chosen, "--json", str(answer), "--out", str(mission), "--quiet"]
    assert run_command(words) == code
    found = json.loads(answer.read_text())
    if code == 0:
        assert run_command(["run", str(mission), *chosen, "--json", str(ran), "--quiet"]) == 0
        run = json.loads(ran.read_text())
        assert found["duration_s"] == pytest.approx(run["duration_s"], rel=1e-9)
        for name, battery in found["batteries"].items():
            for key in ("energy_wh", "charge_left_wh"):
                assert battery[key] == pytest.approx(run["batteries"][name][key], rel=1e-9)
    return found


@pytest.mark.parametrize(
    ("dock", "charge", "settings"),
    [
        ("shed", "any", (SMALL,)),
        ("shed", ["70 %", "100 %"], (SMALL, TAPER)),
        ("all", "any", ("robot.batteries.drive.capacity=7 Wh", TAPER)),
    ],
)
def test_two_rounds_are_as_good_as_their_visits_planned_one_by_one(
    root: Path, tmp_path: Path, dock: object, charge: object, settings: tuple[str, ...]
) -> None:
    choose = {
        "speeds": ["0.9 m/s"],
        "schemes": ["mapped"],
        "docks": dock if dock == "all" else [dock],
        "charge": charge,
    }
    rounds = plan(task_of(root, tmp_path, choose=choose, repeat={"rounds": 2}), *settings)
    single = plan(task_of(root, tmp_path, choose=choose, unrolled=2), *settings)
    assert any(leg["kind"] == "charge" for leg in rounds["legs"])
    assert rounds["objective"] == pytest.approx(single["objective"], rel=1e-8)
    assert rounds["order"] == [name[:-1] for name in single["order"] if not name.startswith("home")]


@pytest.mark.long
def test_charges_on_a_round_that_the_battery_cannot_do_whole(root: Path, tmp_path: Path) -> None:
    choose = {"speeds": ["0.7 m/s", "0.9 m/s"], "schemes": ["mapped"], "docks": ["shed"], "charge": ["80 %", "100 %"]}
    visits = [{"place": "tank", "inspect": "30 s"}, {"place": "mast", "inspect": "30 s"}, {"place": "well"}]
    settings = (SMALL, TAPER)
    task = task_of(root, tmp_path, choose=choose, visits=visits, repeat={"rounds": 3, "every": "25 min"})
    without = plan(task, *settings, "choose.docks=none", code=1)
    assert "0 can" in without["why"]["text"][0] or "not even one round" in without["why"]["text"][0]
    found = plan(task, *settings)
    places = [leg["to"] for leg in found["legs"]]
    assert places.count("mast") >= 3
    charges = [i for i, leg in enumerate(found["legs"]) if leg["kind"] == "charge"]
    assert len(charges) >= 3
    assert {found["legs"][i]["until"] for i in charges} <= {0.8, 1.0}
    # no round sets out before it is due
    clock, homes = 0.0, [0.0]
    for leg in found["legs"]:
        if leg["kind"] == "drive" and leg["from"] == "hall":
            homes.append(clock)
        clock += leg["duration_s"]
    assert sum(time >= 1500.0 * (1 - 1e-12) for time in homes) >= 1
    assert max(homes) >= 3000.0 * (1 - 1e-12)


FIVE = [{"place": place, "inspect": "30 s"} for place in ("pump", "tank", "mast", "well", "shed")]
SHIFTS = [
    ({}, 40),
    ({"visits": FIVE, "docks": ["hall", "shed"]}, 22),
    ({"visits": FIVE, "docks": ["hall", "shed"], "repeat": {"rounds": 9, "until": "8 h"}}, 9),
    ({"visits": FIVE, "docks": ["hall", "shed"], "small": True}, 20),
]


@pytest.mark.study
@pytest.mark.parametrize(("changes", "rounds"), SHIFTS)
def test_a_shift_of_eight_hours_is_planned_within_half_a_minute_and_driven_as_planned(
    root: Path, tmp_path: Path, changes: dict, rounds: int
) -> None:
    shift = yaml.safe_load((root / "missions/planning/shift.yaml").read_text())
    choose = shift["choose"] | {"docks": changes.pop("docks", ["hall"])}
    settings = ("robot.batteries.drive.capacity=12 Wh",) if changes.pop("small", False) else ()
    began = time.process_time()
    found = plan(task_of(root, tmp_path, choose=choose, **changes), *settings)
    seconds = time.process_time() - began
    charges = sum(leg["kind"] == "charge" for leg in found["legs"])
    at_most, gap = found.get("rounds_at_most", rounds), found["gap"]
    print(f"{found['rounds']} rounds of at most {at_most}, {charges} charges, gap {100 * gap:.2g} %: {seconds:.1f} s")
    assert seconds < 30.0
    assert found["rounds"] >= rounds
    assert found["duration_s"] <= 8 * 3600.0


def test_a_shift_that_is_stopped_is_a_plan_with_its_gap(root: Path, tmp_path: Path) -> None:
    choose = {"speeds": ["0.9 m/s"], "schemes": ["mapped"], "docks": ["shed"], "charge": ["80 %", "100 %"]}
    visits = [{"place": "tank", "inspect": "30 s"}, {"place": "mast", "inspect": "30 s"}, {"place": "well"}]
    repeat = {"rounds": "as_often_as_possible", "until": "70 min"}
    task = task_of(root, tmp_path, choose=choose, visits=visits, repeat=repeat)
    words = ["plan", str(task), "--set", SMALL, *f"--seconds 0.000001 --json {tmp_path}/early.json --quiet".split()]
    assert run_command(words) == 0
    early = json.loads((tmp_path / "early.json").read_text())
    best = plan(task, SMALL)
    assert "stopped" in early["claim"]
    assert early["rounds"] <= best["rounds"] <= early["rounds_at_most"]
    assert early["bound"] <= early["objective"]


@pytest.mark.parametrize(
    ("changes", "told"),
    [
        ({"visits": [{"place": "pump", "window": {"until": "9 min"}}]}, "rounds are many"),
        ({"visits": [{"place": "pump", "take_up": "1 kg"}]}, "set down what it takes up"),
    ],
)
def test_what_rounds_cannot_have(
    root: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], changes: dict, told: str
) -> None:
    assert run_command(["plan", str(task_of(root, tmp_path, **changes)), "--quiet"]) == 2
    assert told in capsys.readouterr().err

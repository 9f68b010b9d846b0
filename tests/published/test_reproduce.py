"""The command, what the papers' figures come to, and that ``results/published`` is fresh."""

from __future__ import annotations

import ast
import csv
import dataclasses
import io
import json
import math
import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.inputs import load_robot
from missionsim.inputs.power import build_power_model
from missionsim.published import hou2019, jaiem2021, parasuraman2012, rover2025
from missionsim.published.figures import (
    ABOUT,
    AGREES,
    CALIBRATED,
    CONTRADICTS,
    DIFFERS,
    PAPERS,
    Item,
    load_figures,
    mission,
    run,
)
from missionsim.published.reproduce import files, reproduce_paper, side_tables


@pytest.fixture(scope="module")
def items() -> dict[str, list[Item]]:
    return {paper: reproduce_paper(paper) for paper in PAPERS.values()}


@pytest.fixture(scope="module")
def by_key(items: dict[str, list[Item]]) -> dict[str, dict[str, Item]]:
    return {paper: {item.figure.key: item for item in found} for paper, found in items.items()}


def test_every_figure_has_one_row(items: dict[str, list[Item]]) -> None:
    for paper, found in items.items():
        assert [item.figure.key for item in found] == list(load_figures(paper))


def test_only_unchecked_figures_have_no_value(items: dict[str, list[Item]]) -> None:
    for found in items.values():
        for item in found:
            if item.ours is None:
                assert item.figure.basis == "uncheckable", item.figure.key
            assert item.note or item.status in (AGREES, DIFFERS), item.figure.key


def test_agreement_is_within_the_rounding_of_print(items: dict[str, list[Item]]) -> None:
    for found in items.values():
        for item in found:
            if item.status == AGREES and item.figure.rule.partition(":")[0] in ("rounded", "truncated", "inputs"):
                assert item.difference is not None
                assert abs(item.difference) <= item.figure.tolerance + 1e-9


def test_table_4_row_by_row(by_key: dict[str, dict[str, Item]]) -> None:
    found = by_key["jaiem2021"]
    for row in range(1, 27):
        for name in ("P_R", "P_L", "P_total", "pct_P_R", "pct_P_L", "delta_P", "P_L_switch1", "P_L_kinect"):
            status = found[f"table4.r{row:02d}.{name}"].status
            if row == 9 and name not in ("P_R", "P_L_kinect"):
                assert status == CONTRADICTS
            else:
                assert status == AGREES, f"row {row} {name}"


def test_only_measured_runs_of_table_5_differ(items: dict[str, list[Item]]) -> None:
    differing = [item.figure.key for found in items.values() for item in found if item.status == DIFFERS]
    assert all(key.startswith("table5.") and key.endswith(".experiment") for key in differing)


def test_stretch_predicts_runs_that_it_has_not_seen() -> None:
    figures = load_figures("jaiem2021")
    runs = jaiem2021.runs_of_table5(figures)
    stretch = jaiem2021.stretch_left_out(runs)
    closed = [run for run in runs if run[0] != "fm"]
    plain = [runs[run][0] / runs[run][1] - 1.0 for run in closed]
    with_stretch = [runs[run][0] * stretch[run] / runs[run][1] - 1.0 for run in closed]
    assert np.sqrt(np.mean(np.square(with_stretch))) < 0.3 * np.sqrt(np.mean(np.square(plain)))
    # a run is not in its own fit
    changed = dict(runs)
    changed["cm", "0.3"] = (runs["cm", "0.3"][0], 99.0)
    assert jaiem2021.stretch_left_out(changed)["cm", "0.3"] == stretch["cm", "0.3"]
    assert jaiem2021.stretch_left_out(changed)["cm", "0.1"] != stretch["cm", "0.1"]


def test_patrol_is_called_calibrated(by_key: dict[str, dict[str, Item]]) -> None:
    for battery in ("robot", "laptop"):
        for name in ("peak", "final", "mean", "std"):
            item = by_key["jaiem2021"][f"sec342.{battery}.{name}"]
            assert item.status == CALIBRATED
            assert abs(item.difference or 0.0) < 0.4  # percentage points; the search reached 0.37
            assert "not predicted" in item.note


def test_error_curve_ends_with_the_energies_of_the_runs() -> None:
    curve = jaiem2021.error_curve("robot")
    plan, driven = (jaiem2021.run(name).batteries["robot"].energy_wh for name in (jaiem2021.PLAN, jaiem2021.DRIVEN))
    assert curve.predicted_wh[-1] == pytest.approx(plan, rel=1e-12)
    assert curve.measured_wh[-1] == pytest.approx(driven, rel=1e-12)
    of_predicted, of_measured = curve.percent("predicted")[-1], curve.percent("measured")[-1]
    assert of_measured == pytest.approx(of_predicted / (1.0 + of_predicted / 100.0))


def test_drawn_behaviour_covers_the_final_errors() -> None:
    drawn = jaiem2021.uncertain_statistics(300, 3)
    figures = load_figures("jaiem2021")
    for battery in ("robot", "laptop"):
        low, high = np.quantile(drawn[battery]["final"], (0.05, 0.95))
        assert low < figures[f"sec342.{battery}.final"].value < high
    again = jaiem2021.uncertain_statistics(300, 3)
    assert np.array_equal(again["robot"]["mean"], drawn["robot"]["mean"])


def test_khepera_file_is_the_fit() -> None:
    found = parasuraman2012.static_powers(load_figures("parasuraman2012"))
    assert parasuraman2012.static_power(None) == pytest.approx(found.without_radio_w, abs=2e-6)
    robot = load_robot("khepera3")
    assert float(robot.components["wifi"].loads[0].power or 0) == pytest.approx(found.wifi_w, abs=1e-6)
    assert float(robot.components["bluetooth"].loads[0].power or 0) == pytest.approx(found.bluetooth_w, abs=1e-6)


def test_sequence_of_operations_finds_the_components() -> None:
    robot = load_robot("khepera3")
    for noise, tolerance in ((0.0, 1e-9), (0.05, 0.01)):
        for name, watts in parasuraman2012.identified_components(noise, seed=5).items():
            assert watts == pytest.approx(float(robot.components[name].loads[0].power or 0), abs=tolerance)


def test_task_a_is_equation_12_and_its_record_equation_16() -> None:
    result = run(parasuraman2012.TASK_A["wifi"])
    energy_j = result.batteries["robot"].energy_wh * 3600.0
    speed = float(mission(parasuraman2012.TASK_A["wifi"]).defaults.speed or 0.0)
    needed = parasuraman2012.energy_needed(
        result.distance_m,
        speed,
        static_w=parasuraman2012.static_power("wifi"),
        motion_w=parasuraman2012.motion_power(speed),
        standing_s=25.0,
    )
    assert energy_j == pytest.approx(float(needed), rel=1e-12)
    line = result.timeline
    time_s = np.arange(0.025, result.duration_s, 0.05)
    power = result.power_w("robot")[np.searchsorted(line.start_s, time_s, side="right") - 1]
    # Eq. 16, with the sampling time that the printed sum lacks
    assert 0.05 * np.sum(power) == pytest.approx(energy_j, rel=1e-6)


def test_mecanum_file_is_the_fit_and_beats_the_paper() -> None:
    figures = load_figures("hou2019")
    fit = hou2019.mecanum_fit(figures, profile="linear", duration_s=figures["time.max"].value)
    parameters = build_power_model(load_robot("mecanum4")).parameters
    for name, value in (
        ("wheel_friction", fit.friction_n),
        ("copper_resistance", fit.copper_w_n2),
        ("control_pulse", fit.pulse_w),
        ("electronics", fit.electronics_w),
    ):
        assert parameters[f"robot/{name}"].value == pytest.approx(value, rel=1e-5)
    assert float(load_robot("mecanum4").body.mass or 0) == pytest.approx(fit.mass_kg, rel=1e-5)
    paper, ours = hou2019.model_errors(figures).values()
    for table in ("3", "4"):
        assert ours[table][0] < paper[table][0]
        assert ours[table][1] < paper[table][1]


def test_mass_is_not_identified() -> None:
    rows = hou2019.identifiability()
    masses = [float(row["mass_kg"]) for row in rows]
    assert max(masses) > 3.0 * min(masses)
    assert float(rows[0]["rmse_table3_w"]) == pytest.approx(float(rows[1]["rmse_table3_w"]), rel=1e-4)


def test_directions_and_the_friction_ratio() -> None:
    threshold = hou2019.threshold_ratio()
    angles = np.radians(np.arange(0.0, 181.0, 3.0))
    for ratio, least in ((0.5 * threshold, 45.0), (1.5 * threshold, 0.0)):
        power = hou2019.direction_power(angles, ratio)
        assert np.degrees(angles[int(np.argmin(power))]) == pytest.approx(least)
        assert np.degrees(angles[int(np.argmax(power))]) == pytest.approx(90.0)
        assert power == pytest.approx(power[::-1], rel=1e-9)


def test_rover_file_is_the_fit(by_key: dict[str, dict[str, Item]]) -> None:
    figures = load_figures("rover2025")
    parameters = build_power_model(load_robot("rover_tx2")).parameters
    printed = figures["mech.speed"].value
    assert parameters["robot/drive_constant"].value == pytest.approx(rover2025.drive_constant(printed), rel=1e-5)
    rest, more = rover2025.processing_work(figures, fixed_s=parameters["robot/cpu.fixed_time"].value, share_at_rest=0.5)
    assert parameters["robot/cpu.cycles"].value == pytest.approx(rest, rel=1e-6)
    assert parameters["robot/cpu.cycles_per_speed"].value == pytest.approx(more, rel=1e-6)
    assert by_key["rover2025"]["joint.speed"].status == CONTRADICTS
    assert by_key["rover2025"]["joint.speed.kmh"].ours == pytest.approx(7.5)


def test_constant_power_makes_the_printed_optimum() -> None:
    """81 W of constant power put the least energy per metre at 7.5 m/s, in SI units."""
    printed = load_figures("rover2025")["joint.speed"].value
    speeds = np.linspace(1.0, 15.0, 1401)
    power = rover2025.mechanical_power(speeds, with_constant=False) + rover2025.drive_constant(printed)
    assert speeds[int(np.argmin(power / speeds))] == pytest.approx(printed, abs=0.011)
    assert rover2025.drive_constant(printed) == pytest.approx(81.4, abs=0.1)


def _cells(name: str, text: str) -> Iterator[list[str]]:
    """Rows of cells of a CSV table, or lines of numbers and of what stands between them of a page."""
    if name.endswith(".md"):
        yield from (re.split(r"(-?\d+(?:\.\d+)?)", line) for line in text.splitlines())
    else:
        yield from csv.reader(io.StringIO(text))


def test_results_are_fresh(root: Path, items: dict[str, list[Item]]) -> None:
    """``missionsim reproduce --out results/published`` gives what is in the repository."""
    folder = root / "results" / "published"
    made = files(items, {paper: side_tables(paper) for paper in items})
    for name, text in made.items():
        kept = (folder / name).read_text(encoding="utf-8")
        # the last printed digit may be another one with another Python or NumPy
        for row, old in zip(_cells(name, text), _cells(name, kept), strict=True):
            for cell, before in zip(row, old, strict=True):
                same = cell == before or math.isclose(float(cell), float(before), rel_tol=1e-4)
                assert same, f"{name} is stale (missionsim reproduce --out results/published): {old} → {row}"
    pictures = {f"{paper}_{name}.png" for paper, about in ABOUT.items() for name in about.pictures}
    assert {path.name for path in folder.iterdir()} == set(made) | pictures


@pytest.mark.long
def test_pictures_are_the_same_from_run_to_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from missionsim.published.pictures import draw

    # the one that could show times
    about = ABOUT["rover2025"]
    only = dataclasses.replace(about, pictures={"fidelity": about.pictures["fidelity"]})
    monkeypatch.setitem(ABOUT, "rover2025", only)
    (once,), (again,) = (draw("rover2025", tmp_path / name) for name in "ab")
    assert once.read_bytes() == again.read_bytes()


def test_command_writes_json_tables_and_pictures(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out"
    assert run_command(["reproduce", "rover_tx2", "--out", str(out), "--json", str(tmp_path / "r.json")]) == 0
    shown = capsys.readouterr().out
    assert "joint optimum," in shown
    assert max(len(line) for line in shown.splitlines()) <= 100
    data = json.loads((tmp_path / "r.json").read_text(encoding="utf-8"))
    assert data["schema"] == "missionsim.reproduction/1"
    row = next(item for item in data["items"] if item["item"] == "joint optimum, speed")
    assert row["published"] == 7.5
    names = {"paper", "item", "where", "published", "ours", "unit", "difference", "tolerance", "status", "note"}
    assert set(row) >= names
    names = {path.name for path in out.iterdir()}
    assert {"README.md", "rover2025.csv", "rover2025_complexities.png", "rover2025_fidelity.csv"} <= names


def test_command_refuses_an_unknown_robot(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["reproduce", "kepera3"]) == 2
    assert "did you mean: khepera3" in capsys.readouterr().err


def test_json_to_standard_output_is_only_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["reproduce", "parasuraman2012", "--json", "-"]) == 0
    assert len(json.loads(capsys.readouterr().out)["items"]) == len(load_figures("parasuraman2012"))


@pytest.mark.parametrize("module", ["jaiem2021", "parasuraman2012", "hou2019", "rover2025", "reproduce"])
def test_no_published_number_in_the_code(root: Path, module: str) -> None:
    """Code that computes ours holds none of the papers' figures with two or more significant digits."""
    tree = ast.parse((root / "missionsim" / "published" / f"{module}.py").read_text(encoding="utf-8"))
    constants = {
        float(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Constant) and isinstance(node.value, int | float) and not isinstance(node.value, bool)
    }
    figures = [f for paper in PAPERS.values() for f in load_figures(paper).values()]
    printed = {f.value for f in figures if len(f.printed.strip("0.").replace(".", "")) >= 2}
    # per cent, angles, quantiles and grids of our own arithmetic
    own = {100.0, 180.0, 45.0, 90.0, 0.25, 0.95, 12.0, 16.0, 30.0}
    assert constants & printed <= own

"""``missionsim compare`` as a user runs it: exit codes, files, faults, width."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from missionsim.labels import Labels
from tests.compare.worlds import drive, true_power


@pytest.fixture
def logs(tmp_path: Path) -> Path:
    folder = tmp_path / "logs"
    folder.mkdir()
    for i in range(2):
        columns = drive(seed=i)
        # pioneer3dx without lasers and sonar: the motion, the controller and the camera
        power = true_power(columns) + 25.0 * 9.81 * columns["speed_m_s"] * np.sin(columns["slope_rad"])
        table = {name: c.texts() if isinstance(c, Labels) else np.round(c, 6) for name, c in columns.items()}
        with open(folder / f"run_{i:02d}.csv", "w", newline="", encoding="utf-8") as handle:
            writer = csv.writer(handle)
            writer.writerow([*table, "power_robot_w"])
            writer.writerows(zip(*table.values(), np.round(power, 6), strict=True))
    return folder


def test_tables_fit_a_terminal_of_100_columns(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["compare", "--robot", "pioneer3dx", str(logs)]) == 0
    out = capsys.readouterr().out
    assert max(len(line) for line in out.splitlines()) <= 100
    assert "The error varies with slope" in out
    assert "no column on_laser, on_sonar: laser, sonar count as switched off" in " ".join(out.split())


def test_json_on_standard_output_is_json_alone(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["compare", "--robot", "pioneer3dx", str(logs), "--json", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert data["schema"] == "missionsim.comparison/1"
    assert data["runs"] == ["run_00", "run_01"]
    assert data["batteries"]["robot"]["where"][0]["by"] == "slope_rad"
    assert len(data["logs"][0]["sha256"]) == 64


def test_tolerance_decides_the_exit_code(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["compare", "--robot", "pioneer3dx", str(logs), "--tolerance", "0.5"]) == 1
    assert "OUTSIDE the tolerance" in capsys.readouterr().out
    assert run_command(["compare", "--robot", "pioneer3dx", str(logs), "--tolerance", "50", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


def test_files_of_a_comparison(logs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, page = tmp_path / "out", tmp_path / "page.html"
    files = ["--out", str(out), "--report", str(page)]
    assert run_command(["compare", "--robot", "pioneer3dx", str(logs / "run_00.csv"), *files, "--quiet"]) == 0
    assert capsys.readouterr().out == ""
    assert {path.name for path in out.iterdir()} == {
        "runs.csv",
        "where.csv",
        "terms.csv",
        "power_robot_run_00.png",
        "error_by_covariate_robot.png",
        "error_over_progress_robot.png",
        "error_map_robot.png",
    }
    with open(out / "runs.csv", encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    assert [row["run"] for row in rows] == ["run_00"]
    measured, model = float(rows[0]["energy_measured_wh"]), float(rows[0]["energy_model_wh"])
    assert float(rows[0]["energy_error_pct"]) == pytest.approx(100 * (model - measured) / measured)
    for picture in out.glob("*.png"):
        assert picture.read_bytes().startswith(b"\x89PNG")
        assert picture.stat().st_size > 5000
    assert "pioneer3dx: model against measurements" in page.read_text("utf-8")


def test_all_faults_of_a_command_at_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["compare", "--robot", "pioner3dx", str(tmp_path / "nowhere.csv"), "--mission", "no.yaml"]) == 2
    err = capsys.readouterr().err
    assert "did you mean: pioneer3dx" in err
    assert "nowhere.csv: error: there is no such file" in err
    assert "no.yaml" in err


@pytest.mark.parametrize(
    ("extra", "text"),
    [
        (["--tolerance", "-3"], "the tolerance is a percentage"),
        (["--report", "page.pdf"], "a name that ends in .html"),
        (["--by", "payload"], "the log has no column 'payload'"),
    ],
)
def test_wrong_options_are_told(logs: Path, extra: list[str], text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["compare", "--robot", "pioneer3dx", str(logs), *extra]) == 2
    assert text in capsys.readouterr().err


def test_a_further_column_can_be_looked_at(logs: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run_command(["compare", "--robot", "pioneer3dx", str(logs), "--by", "x_m", "--json", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert "x_m" in {where["by"] for where in data["batteries"]["robot"]["where"]}


def test_a_battery_whose_model_needs_a_missing_column_is_skipped_and_said(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    rows = [(0.5 + i, 12.0, 15.0, 0.4) for i in range(60)]
    with open(tmp_path / "run.csv", "w", newline="", encoding="utf-8") as handle:
        writer = csv.writer(handle)
        writer.writerow(["time_s", "power_robot_w", "power_laptop_w", "speed_m_s"])
        writer.writerows(rows)
    assert run_command(["compare", "--robot", "pioneer3dx", str(tmp_path / "run.csv"), "--json", "-"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert list(data["batteries"]) == ["robot"]
    assert any("battery 'laptop' is skipped" in note and "scheme" in note for note in data["notes"])


def write(folder: Path, count: int, **changes: float) -> None:
    """So many drives of the robot, noise on their power [W]; `changes`: of the power of one run, by its name."""
    for number in range(count):
        columns, name = drive(rows=300, seed=number), f"run_{number:02d}"
        power = true_power(columns) + np.random.default_rng(number).normal(0.0, 0.1 * number, 300)
        table = {one: c.texts() if isinstance(c, Labels) else np.round(c, 6) for one, c in columns.items()}
        table["power_robot_w"] = power * changes.get(f"{name}_times", 1.0) + changes.get(f"{name}_more", 0.0)
        with open(folder / f"{name}.csv", "w", newline="", encoding="utf-8") as handle:
            writer = csv.writer(handle)
            writer.writerow(table)
            writer.writerows(zip(*table.values(), strict=True))


def test_every_model_is_compared_on_the_same_runs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A run that lies beside the others and the model is told and stays in the numbers; one in milliwatts goes out."""
    write(tmp_path, 6, run_04_more=6.0, run_05_times=1000.0)
    saved = tmp_path / "c.json"
    assert run_command(["compare", "--robot", "pioneer3dx", str(tmp_path), "--json", str(saved)]) == 1
    data = json.loads(saved.read_text("utf-8"))
    assert data["runs"] == [f"run_{number:02d}" for number in range(5)]
    assert [line.split(":")[0] for line in data["left_out"]] == ["run_05"]
    (told,) = [
        note for note in data["notes"] if "every model is compared on the same runs: run_04: power_robot_w" in note
    ]
    assert "run_05" not in told
    assert f" {data['batteries']['robot']['run_energy_error_pct']:.2f} │" in capsys.readouterr().out


def test_of_many_runs_the_worst_stand_first_and_the_rest_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write(tmp_path, 20)
    run_command(["compare", "--robot", "pioneer3dx", str(tmp_path), "--json", str(tmp_path / "c.json")])
    data = json.loads((tmp_path / "c.json").read_text("utf-8"))
    errors = [run["energy_error_pct"] for run in data["batteries"]["robot"]["per_run"]]
    assert len(errors) == 20
    out = capsys.readouterr().out
    table = out[out.index("Runs, the worst first") :].splitlines()
    shown = [float(line.split("│")[5].replace("−", "-")) for line in table if line.startswith("│run_")]
    assert shown == pytest.approx(sorted(errors, key=lambda error: -abs(error))[: len(shown)], abs=0.005)
    assert any(line.startswith(f"│the other {20 - len(shown)} ") for line in table)

"""Names that users give: shown as they are, never markup, commands, formulas or mathematics."""

from __future__ import annotations

import csv
import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from missionsim.cli.app import run_command

HOSTILE = (
    "aisle [b4]",
    "[/bold]",
    "red \x1b[31m ink",
    '=HYPERLINK("http://x")',
    r"$\frac{",
    ":smile:",
    "bell\x07 \u202e",
)
SHOWN = ("aisle [b4]", "[/bold]", r"\x1b[31m", "HYPERLINK", r"$\frac{", ":smile:", r"bell\x07 \u202e")


def _yaml(folder: Path, name: str, data: object) -> Path:
    path = folder / name
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


@pytest.fixture
def mission(tmp_path: Path) -> Path:
    segments = [{"drive": {"distance": "20 m", "name": name}} for name in HOSTILE]
    data = {
        "kind": "mission",
        "name": "".join(HOSTILE[:5]),
        "robot": "pioneer3dx",
        "defaults": {"speed": "0.4 m/s", "scheme": "forward_motion"},
        "segments": segments,
    }
    return _yaml(tmp_path, "mission.yaml", data)


@pytest.fixture
def log(tmp_path: Path) -> Path:
    rows = []
    for i in range(700):
        speed = 0.2 + 0.2 * ((i // 50) % 3)
        place = HOSTILE[(i // 100) % 7]
        rows.append([i, 6.25 * speed**2 + 9.79 * speed + 3.66 + (1.0 if i // 100 == 1 else 0.0), speed, place, i * 0.5])
    path = tmp_path / "run [b4].csv"
    with path.open("w", newline="", encoding="utf-8") as out:
        csv.writer(out).writerows([["time_s", "power_robot_w", "speed_m_s", "surface", HOSTILE[3]], *rows])
    return path


@pytest.fixture
def site(tmp_path: Path) -> Path:
    points = [
        {
            "type": "Feature",
            "properties": {"id": i, "metadata": {"name": name}, "frame": "map"},
            "geometry": {"type": "Point", "coordinates": [5.0 * i, 0.0]},
        }
        for i, name in enumerate(HOSTILE)
    ]
    lines = [
        {
            "type": "Feature",
            "properties": {"id": 100 + i, "startid": i, "endid": i + 1},
            "geometry": {"type": "MultiLineString", "coordinates": [[[5.0 * i, 0.0], [5.0 * i + 5.0, 0.0]]]},
        }
        for i in range(len(HOSTILE) - 1)
    ]
    data = {"type": "FeatureCollection", "name": "graph", "features": [*points, *lines]}
    return _yaml(tmp_path, "graph.geojson", data)


COMMANDS = {
    "run": "run {mission} --out {out}/run --plot",
    "whatif": "whatif {mission} --vary defaults.speed=0.3,0.4 --out {out}/whatif.csv",
    "montecarlo": "montecarlo {mission} --runs 20 --out {out}/batch",
    "compare": "compare --robot pioneer3dx {log} --out {out}/compare --report {out}/c.html",
    "diagnose": "diagnose --robot pioneer3dx {log} --report {out}/d.html",
    "validate": "validate {mission} {log}",
    "import": "import {log}",
    "suggest": "import {log} --suggest --out {out}/map.yaml",
    "import-site": "import-site {site} --out {out}/site.yaml",
    "export": "export nav2 {site} --robot pioneer3dx --out {out}/costs.geojson",
    "missing file": "validate \x1b[31m[/bold].yaml",
    "unknown option": "run --\x1b[31m[/bold]",
}


@pytest.mark.usefixtures("effects_alone")
@pytest.mark.filterwarnings("error:Glyph")
@pytest.mark.parametrize(
    "name", [pytest.param(o, marks=pytest.mark.long) if o in ("run", "compare") else o for o in COMMANDS]
)
def test_names_are_shown_as_they_are(
    name: str, mission: Path, log: Path, site: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    out.mkdir()
    code = run_command([word.format(mission=mission, log=log, site=site, out=out) for word in COMMANDS[name].split()])
    shown = capfd.readouterr()
    assert code in ((0, 1) if name not in ("missing file", "unknown option") else (2,)), shown.err
    text = shown.out + shown.err
    assert not {"\x1b", "\x07", "\u202e"} & set(text)
    if name in ("missing file", "unknown option"):
        assert r"\x1b[31m[/bold]" in text
    for table in out.rglob("*.csv"):
        with table.open(newline="", encoding="utf-8") as rows:
            assert not [cell for row in csv.reader(rows) for cell in row if cell.startswith("=")], table.name


def test_every_name_stands_on_the_terminal_and_in_the_tables(
    mission: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["run", str(mission), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr().out
    assert [name for name in SHOWN if name not in shown] == []
    with (tmp_path / "out" / "segments.csv").open(newline="", encoding="utf-8") as rows:
        names = [row["segment_name"] for row in csv.DictReader(rows)]
    assert names == [f"'{name}" if name.startswith("=") else name for name in HOSTILE]


def test_a_planned_task_and_an_imported_site_keep_names(
    site: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run_command(["import-site", str(site), "--out", str(tmp_path / "site.yaml"), "--quiet"]) == 0
    task = {
        "kind": "task",
        "name": "[/bold] round",
        "robot": "pioneer3dx",
        "environment": "site.yaml",
        "start": "0",
        "end": "3",
        "visits": [{"place": "3", "inspect": "5 s"}],
    }
    code = run_command(["plan", str(_yaml(tmp_path, "task.yaml", task)), "--out", str(tmp_path / "plan")])
    shown = capsys.readouterr()
    assert code in (0, 1), shown.err
    assert "[/bold] round" in shown.out


EVERY = """import sys
from missionsim.cli.app import run_command
for words in (["effects"], ["run", "missions/pioneer3dx/valve_patrol.yaml"], ["--help"]):
    assert run_command(words) == 0
"""


@pytest.mark.parametrize(
    "encoding", ["ascii", *(pytest.param(one, marks=pytest.mark.long) for one in ("cp1252", "utf-16"))]
)
def test_any_encoding_of_the_output_will_do(root: Path, encoding: str) -> None:
    done = _in_encoding(root, encoding, ["-c", EVERY])
    assert (done.returncode, done.stderr) == (0, b"")


def test_json_on_an_ascii_output_is_json(root: Path) -> None:
    done = _in_encoding(root, "ascii", ["-m", "missionsim", "effects", "--json", "-"])
    utf8 = _in_encoding(root, "utf-8", ["-m", "missionsim", "effects", "--json", "-"])
    assert json.loads(done.stdout) == json.loads(utf8.stdout)


def _in_encoding(root: Path, encoding: str, words: list[str]) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, *words],
        cwd=root,
        env={**os.environ, "PYTHONIOENCODING": encoding, "PYTHONUTF8": "0"},
        capture_output=True,
        check=False,
    )


@pytest.mark.parametrize(
    ("base", "told"),
    [
        ("c1*hypot(1e308,1e308)", "no number"),
        ("c1*" + "9" * 400, "number is too large"),
        ("c1*where(v > 0.2, 'a', 1)", "a word stands alone"),
        ("c1*v**10**400", "exponent"),
        ("c1*v**'a'", "a word stands alone"),
    ],
)
def test_formulas_that_are_none(
    root: Path, base: str, told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    logs = str(root / "docs" / "examples" / "ramp_runs")
    assert run_command(["calibrate", "--new", "cart", "--base", base, logs, "--out", str(tmp_path / "cart.yaml")]) == 2
    assert told in capsys.readouterr().err
    assert not (tmp_path / "cart.yaml").exists()


def test_truth_counts_as_one_in_a_power(root: Path, tmp_path: Path) -> None:
    logs = str(root / "docs" / "examples" / "ramp_runs")
    words = ["calibrate", "--new", "cart", "--base", "c1*(v > 0.1)**2 + c0", logs]
    assert run_command([*words, "--out", str(tmp_path / "cart.yaml")]) == 0

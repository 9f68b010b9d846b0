"""The notebook of docs runs from top to bottom, in a folder that looks like the repository."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import missionsim

pytestmark = pytest.mark.usefixtures("examined_once")

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.long
@pytest.mark.usefixtures("effects_alone")
def test_notebook(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    matplotlib = pytest.importorskip("matplotlib")
    matplotlib.use("Agg")
    for name in ("missions", "environments", "docs/examples", "missionsim/robots"):
        shutil.copytree(ROOT / name, tmp_path / name)
    for path in sorted((tmp_path / "docs/examples/ramp_runs").iterdir())[5:]:
        path.unlink()  # five runs show what eleven show
    monkeypatch.chdir(tmp_path)
    notebook = json.loads((ROOT / "docs/notebook.ipynb").read_text(encoding="utf-8"))
    names: dict[str, Any] = {}
    count = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec(compile("".join(cell["source"]), "notebook", "exec"), names)
            count += 1
    assert count >= 8
    assert [name for name in missionsim.__all__ if name in ("run", "whatif", "monte_carlo", "compare", "diagnose")]
    answers = [names[name] for name in ("run", "speeds", "draws", "before", "found", "better", "after", "site")]
    for answer in answers:
        assert 10 < len(repr(answer)) < 300
        assert "<table" in answer._repr_html_()
        assert len(answer.to_frame()) > 0
        assert json.dumps(answer.to_json(), default=str)
        assert answer.plot().axes
    assert "grade" in repr(names["found"])
    assert names["better"].to_json()["schema"] == "missionsim.add_effect/1"
    assert names["run"].value.feasible
    assert names["draws"].to_frame().shape[0] == 500


def test_plan_and_import_log_from_python(tmp_path: Path) -> None:
    found = missionsim.plan(ROOT / "missions/planning/inspection.yaml")
    frame = found.to_frame()
    energies = [name for name in frame.columns if name.startswith("energy_") and name != "energy_wh"]
    assert frame["energy_wh"].to_numpy() == pytest.approx(frame[energies].sum(axis=1).to_numpy())
    assert found.plot().axes
    (tmp_path / "raw.csv").write_text("t,p\n" + "".join(f"{i},{5 + i % 3}\n" for i in range(50)))
    (tmp_path / "map.yaml").write_text("kind: map\nname: raw\ncolumns: {time_s: t, power_robot_w: p}\n")
    (run,) = missionsim.import_log(tmp_path / "raw.csv", tmp_path / "map.yaml")
    assert run.power_w["robot"].tolist() == [5 + i % 3 for i in range(50)]
    with pytest.raises(ValueError, match="no file to write"):
        missionsim.run(ROOT / "missions/pioneer3dx/valve_patrol.yaml").save(tmp_path / "x.yaml")
    fitted = missionsim.calibrate("pioneer3dx", ROOT / "docs/examples/ramp_runs")
    assert {"c2", "c3"} <= set(fitted.to_frame()["name"])
    assert fitted.plot().axes
    assert missionsim.load_robot(fitted.save(tmp_path / "fitted.yaml")).name == "pioneer3dx"
    assert "diagnose" in missionsim.__all__
    assert len(missionsim.__all__) <= 20

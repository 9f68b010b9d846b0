"""What docs/exchange.md promises a newcomer: from a graph, a fleet config and bags to the answers, by commands."""

from __future__ import annotations

import json
import re
import shutil
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from missionsim.cli.app import run_command
from tests.logs.bag_writers import STEP_S, battery_volts, write_bag

ROOT = Path(__file__).resolve().parents[2]
SITES = ROOT / "docs" / "examples" / "sites"
MASS_KG, FRICTION, AMBIENT_W = 40.0, 0.08, 13.0


def write_shift(path: Path, seed: int, duration_s: float = 200.0) -> None:
    """A bag of a cart on ramps: friction, speeding up, climbing, 2 % noise."""
    rng = np.random.default_rng(seed)
    t = np.arange(0, duration_s, STEP_S)
    asked, ramp = (rng.choice([0, 0.3, 0.6, 0.8], len(t)), rng.choice([0, 0, 0.06, -0.06, 0.1], len(t)))
    v = np.convolve(asked[(t // 6).astype(int)], np.ones(15) / 15)[: len(t)]
    slope = np.convolve(ramp[(t // 15).astype(int)], np.ones(20) / 20)[: len(t)]
    power = AMBIENT_W + MASS_KG * v * (FRICTION * 9.81 + np.maximum(np.gradient(v, t), 0) + 9.81 * np.sin(slope))
    ampere = power * (1 + 0.02 * rng.normal(size=len(t))) / battery_volts(t)
    drive = {"speed": v, "amps": ampere, "slope": slope, "turn": np.zeros(len(t))}

    def at(values: np.ndarray, time: float) -> float:
        return float(np.interp(time, t, values))

    write_bag(path, "mcap", duration_s, drive={name: partial(at, values) for name, values in drive.items()})


@pytest.mark.study
def test_from_nothing_to_the_answers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(SITES / "yard.geojson", tmp_path / "graph.geojson")
    shutil.copy(SITES / "cart_config.yaml", tmp_path / "config.yaml")
    (tmp_path / "bags").mkdir()
    for seed in range(6):
        write_shift(tmp_path / "bags" / f"shift_{seed}", seed)
    monkeypatch.chdir(tmp_path)
    page = (ROOT / "docs" / "exchange.md").read_text(encoding="utf-8")
    block = re.search(r"```text\n(missionsim import-site graph.*?)```", page, re.DOTALL)
    assert block is not None
    commands = block[1].splitlines()
    assert [line.split()[1] for line in commands][-3:] == ["diagnose", "add-effect", "reach"]
    for line in commands:
        name = line.split()[1]
        allowed = 1 if name == "reach" else 0  # no way leads back from a place of that graph
        assert run_command([*line.split()[1:], "--json", f"{name}.json"]) == allowed, capsys.readouterr()
    effects = json.loads(Path("diagnose.json").read_text())["batteries"]["robot"]["effects"]
    assert [effect["effect"] for effect in effects] == ["grade"]
    k = effects[0]["parameters"]["k"]
    assert k["low"] < 1.0 < k["high"]
    reached = json.loads(Path("reach.json").read_text())
    assert reached["places"]["1"]["sure"]
    assert reached["unreachable"] == ["2"]

"""The package as others meet it: public names, lazy imports, every entry of the registries."""

from __future__ import annotations

import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

import missionsim
from missionsim.cli.app import COMMANDS, run_command
from missionsim.effects.library import all_effects, effect_ids, execution_effects, get_effect
from missionsim.effects.named_models import get_motion_model, motion_model_ids

ROOT = Path(__file__).resolve().parents[2]
SLOW = ("pandas", "scipy", "matplotlib", "sklearn", "pyarrow", "networkx", "pint")


def loaded_by(code: str) -> set[str]:
    done = subprocess.run(
        [sys.executable, "-c", f"import sys\n{code}\nprints = sys.modules\nprint(' '.join(sorted(sys.modules)))"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    )
    return {name.split(".")[0] for name in done.stdout.splitlines()[-1].split()}


def test_at_most_fifteen_public_names_and_each_loads() -> None:
    assert 0 < len(missionsim.__all__) <= 20
    for name in missionsim.__all__:
        assert getattr(missionsim, name).__doc__, name


def test_import_loads_nothing_slow() -> None:
    assert loaded_by("import missionsim").isdisjoint(SLOW)


@pytest.mark.parametrize(
    "arguments",
    [
        ["validate", "missions/pioneer3dx/valve_patrol.yaml"],
        ["run", "missions/pioneer3dx/valve_patrol.yaml", "--quiet"],
        ["--help"],
    ],
    ids=["validate", "run", "help"],
)
def test_quick_commands_load_nothing_slow(arguments: list[str]) -> None:
    modules = loaded_by(f"from missionsim.cli.app import run_command\nassert run_command({arguments!r}) == 0")
    assert modules.isdisjoint(SLOW)
    assert arguments == ["--help"] or "cyclopts" not in modules


def test_an_import_of_usual_units_loads_no_pint() -> None:
    """One of 46 units was asked of pint, which takes half a second to load."""
    modules = loaded_by("from missionsim.importer.roles import UNITS; assert UNITS['cA'] == ('current', 0.01)")
    assert "pint" not in modules


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_loads_and_explains_itself(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    module, attribute = COMMANDS[name][0].split(":")
    assert hasattr(importlib.import_module(f"missionsim.cli.{module}"), attribute)
    for part in ("nav2", "rmf", "vda5050", "qgc") if name == "export" else ("",):
        assert run_command([word for word in (name, part, "--help") if word]) == 0
        text = capsys.readouterr().out
        assert "--json" in text
        assert "--quiet" in text


def test_every_effect_of_the_registry_loads() -> None:
    for id in effect_ids():
        effect = get_effect(id.replace("<component>", "kinect"), surfaces=("carpet",))
        assert effect.parameters
        assert effect.equation
    library = (*all_effects(("kinect",), ("carpet",), ("arm_w",)), *execution_effects())
    found = {effect.id for effect in library}
    families = {id.partition(":")[0] for id in found}
    assert {id.partition(":")[0] for id in effect_ids()} == families


def test_every_motion_model_loads() -> None:
    for id in motion_model_ids():
        assert get_motion_model(id).parameters


def test_repository_names_no_machine_path() -> None:
    # spelled in parts, so that this file does not hold what it forbids
    forbidden = re.compile("|".join(["/wo" + "rk/", "/tmp/pl" + "an", "opt/py" + "pi"]))
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False).stdout.split()
    if not listed:
        pytest.skip("this is not a git checkout")
    for name in listed:
        path = ROOT / name
        if path.is_file() and path.suffix in (".py", ".md", ".yaml", ".toml", ".txt", ".csv", ".json", ""):
            assert not forbidden.search(path.read_text(encoding="utf-8", errors="ignore")), name


def test_completion_installs(tmp_path: Path) -> None:
    script = tmp_path / "completion.bash"
    words = ["--install-completion", "--shell", "bash", "--output", str(script)]
    environment = {**os.environ, "HOME": str(tmp_path)}
    command = [sys.executable, "-m", "missionsim", *words]
    assert subprocess.run(command, env=environment, capture_output=True, check=False).returncode == 0
    text = script.read_text(encoding="utf-8")
    assert all(name in text for name in COMMANDS)
    assert subprocess.run(["bash", "-n", str(script)], check=False).returncode == 0

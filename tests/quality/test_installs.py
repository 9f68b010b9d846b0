"""The wheel alone, outside the clone: lowest and newest versions allowed, and every Python that this machine has."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from tests.quality.installs import build_wheel, failures, install

PYTHONS = [name for name in ("3.11", "3.12", "3.13", "3.14") if shutil.which(f"python{name}")]


@pytest.mark.study
@pytest.mark.parametrize("resolution", ["lowest-direct", "highest"])
@pytest.mark.parametrize("python", PYTHONS)
def test_main_commands_run_in_a_clean_environment(python: str, resolution: str, tmp_path: Path) -> None:
    pytest.importorskip("uv", reason="the study installs with uv")
    binaries = install(build_wheel(tmp_path), tmp_path / "environment", python, resolution)
    assert not list(failures(binaries, tmp_path))

"""The strict tools, run as tests, so that one command checks everything."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
BIN = Path(sys.executable).parent


@pytest.mark.parametrize(
    "command", [["ruff", "check", "."], ["mypy"], ["lint-imports", "--no-logo"]], ids=["ruff", "mypy", "import-linter"]
)
def test_tool_is_content(command: list[str]) -> None:
    if command == ["mypy"] and not (ROOT / ".mypy_cache").is_dir():
        command = ["mypy", f"--cache-dir={os.devnull}"]  # in a fresh clone what is kept is read by nobody
    done = subprocess.run([str(BIN / command[0]), *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:] + done.stderr[-2000:]

"""Every command that README and docs show is run, in the order shown, in a folder that looks like the repository.

Convention: fenced blocks marked ``bash`` are run with ``bash -eu``; a line that may answer "no" ends in ``# exit 1``.
Blocks marked ``text``, ``yaml`` or ``json`` are shown only; ``python`` blocks of a page are run one after the other.
The two blocks under "Run it" and "Test it" set the project up; they are tried in a clean clone instead.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)


def blocks(page: Path) -> list[tuple[str, str]]:
    text = page.read_text(encoding="utf-8")
    if page.name == "README.md":
        for heading in ("## Run it", "## Test it"):
            start = text.index(heading)
            fence = text.index("```", text.index("```", start) + 3)
            text = text[:start] + text[fence + 3 :]
    return [(language, code) for language, code in FENCE.findall(text) if language in ("bash", "python")]


def allowed_exit(line: str) -> int:
    match = re.search(r"#\s*exit (\d)", line)
    return int(match.group(1)) if match else 0


def script(code: str) -> str:
    """The block with each line that may say "no" allowed to do so, and nothing else."""
    lines = []
    for line in code.splitlines():
        wanted = allowed_exit(line)
        lines.append(f"{line.split('#')[0]} && code=0 || code=$?; [ $code -eq {wanted} ]" if wanted else line)
    return "\n".join(lines)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_page(page: Path, tmp_path: Path) -> None:
    parts = blocks(page)
    if not parts:
        pytest.skip("this page shows no command")
    if any("../shared" in code for _, code in parts) and not (ROOT.parent / "shared" / "contract.md").is_file():
        pytest.skip("this page reads the shared logs, which are not here")
    here = tmp_path / "repository"
    here.mkdir()
    for name in ("missions", "environments", "docs", "missionsim", "results"):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, here / name)
    if (ROOT.parent / "shared").is_dir():
        (tmp_path / "shared").symlink_to(ROOT.parent / "shared")
    environment = {**os.environ, "PATH": f"{Path(sys.executable).parent}:{os.environ['PATH']}", "COLUMNS": "100"}
    for language, code in parts:
        shell = ["bash", "-euo", "pipefail", "-c", script(code)]
        command = shell if language == "bash" else [sys.executable, "-c", code]
        done = subprocess.run(
            command,
            cwd=here,
            env=environment,
            capture_output=True,
            text=True,
            timeout=600,
            check=False,
            stdin=subprocess.DEVNULL,
        )
        told = f"--- out\n{done.stdout[-3000:]}\n--- err\n{done.stderr[-3000:]}"
        assert done.returncode == 0, f"{page.name}:\n{code}\n{told}"

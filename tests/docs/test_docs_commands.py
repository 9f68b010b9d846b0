"""Every command that README and docs show is run, in the order shown, in a folder that looks like the repository.

Convention: in fenced blocks marked ``bash`` the shell reads each line as it would for a user; commands of missionsim
then run in this process through `missionsim.cli.main`, whatever else there is in the shell. A line that may answer "no"
ends in ``# exit 1``. Blocks marked ``text``, ``yaml`` or ``json`` are shown only; ``python`` blocks are run in turn.
The two blocks under "Run it" and "Test it" set the project up; they are tried in a clean clone instead.

That takes minutes and is marked `long`; the quick tests run README and two more pages, without the commands that take
long, and ask of all the others whether they are there as shown.
"""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest

from missionsim.cli import main
from missionsim.cli.app import read_call

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted([ROOT / "README.md", *(ROOT / "docs").rglob("*.md")])
QUICK = [ROOT / "README.md", ROOT / "docs/exchange.md", ROOT / "docs/stories/racing_rover.md"]
"""What the suite runs of the pages; all of them, whole, are long."""
TAKES_LONG = ("missionsim improve ", "missionsim reach ")
STORIES = sorted((ROOT / "docs" / "stories").glob("*.md"))
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.MULTILINE | re.DOTALL)
STATEMENT = re.compile(r"(?:.*<<'END'\n(?:.*\n)*?END|(?:.*\\\n)*.+)(?:\n|\Z)")
"""A line with what continues it, or one with the text that it feeds to a program."""


def blocks(page: Path) -> list[tuple[str, str]]:
    text = page.read_text(encoding="utf-8")
    if page.name == "README.md":
        for heading in ("## Run it", "## Test it"):
            start = text.index(heading)
            fence = text.index("```", text.index("```", start) + 3)
            text = text[:start] + text[fence + 3 :]
    return [(language, code) for language, code in FENCE.findall(text) if language in ("bash", "python")]


def statements(page: Path) -> Iterator[tuple[str, str]]:
    for language, code in blocks(page):
        if language == "python":
            yield language, code
        else:
            yield from ((language, found) for found in STATEMENT.findall(code) if not found.startswith("#"))


def shell(script: str) -> str:
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", script],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        check=False,
    )
    assert done.returncode == 0, f"{script}\n{done.stdout}\n{done.stderr}"
    return done.stdout


def run(statement: str, monkeypatch: pytest.MonkeyPatch) -> int:
    if not statement.startswith("missionsim ") or " > " in statement:
        shell(statement)
        return 0
    words = shell('missionsim() { printf "%s\\0" "$@"; }\n' + statement).split("\0")[:-1]
    monkeypatch.setattr(sys, "argv", ["missionsim", *words])
    with pytest.raises(SystemExit) as left:
        main()
    assert isinstance(left.value.code, int)
    return left.value.code


@pytest.mark.long
@pytest.mark.usefixtures("examined_once")
@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_page(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_page(page, tmp_path, monkeypatch, capsys)


@pytest.mark.usefixtures("examined_once")
@pytest.mark.parametrize("page", QUICK, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_page_but_what_takes_long(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    run_page(page, tmp_path, monkeypatch, capsys, without=TAKES_LONG)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_commands_of_page_are_commands(page: Path) -> None:
    """Every command and option that a page shows is there, whether or not it is run here."""
    assert "shared/" not in page.read_text(encoding="utf-8"), "nobody else has these files"
    for language, code in statements(page):
        if language == "bash" and code.startswith("missionsim "):
            words = shlex.split(code, comments=True)
            assert read_call(words[1 : words.index(">") if ">" in words else None]) is not None, code


def test_tests_that_are_left_out_have_their_command() -> None:
    options = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["pytest"]["ini_options"]
    tiers = re.findall(r"not (\w+)", options["addopts"])
    assert tiers == ["study", "long"]
    assert {one.partition(":")[0] for one in options["markers"]} >= {*tiers}
    for page in ("README.md", "CONTRIBUTING.md"):
        shown = re.findall(r"-m pytest -m (\w+)", (ROOT / page).read_text(encoding="utf-8"))
        assert sorted(shown) == sorted(tiers), page


@pytest.mark.study
@pytest.mark.parametrize("page", STORIES, ids=lambda page: page.name)
def test_story_on_the_measured_data(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], shared: Path
) -> None:
    """Where the public data are at hand, the stories' figures hold on them."""
    (tmp_path / "repository").mkdir()
    (tmp_path / "repository" / "data").symlink_to(shared / "data")
    run_page(page, tmp_path, monkeypatch, capsys)


def run_page(
    page: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    without: tuple[str, ...] = (),
) -> None:
    parts = list(statements(page))
    if not parts:
        pytest.skip("this page shows no command")
    here = tmp_path / "repository"
    here.mkdir(exist_ok=True)
    for name in ("missions", "environments", "docs", "results"):
        if (ROOT / name).is_dir():
            shutil.copytree(ROOT / name, here / name)
    (here / "missionsim").symlink_to(ROOT / "missionsim")
    monkeypatch.chdir(here)
    monkeypatch.setenv("COLUMNS", "100")
    monkeypatch.setenv("PATH", f"{Path(sys.executable).parent}:{os.environ['PATH']}")
    for language, code in parts:
        if without and code.startswith(without):
            continue
        if language == "python":
            exec(compile(code, page.name, "exec"), {"__name__": "__main__"})
        else:
            allowed = re.search(r"#\s*exit (\d)", code)
            left = run(code, monkeypatch)
            assert left == (int(allowed[1]) if allowed else 0), "\n".join([code, *capsys.readouterr()])

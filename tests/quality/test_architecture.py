"""The page on the architecture draws the rooms as the import rules have them, and leaves none out."""

from __future__ import annotations

import configparser
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DATA = {"robots", "schemas"}


def drawn() -> list[str]:
    text = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    block = text.split("```text\n", 1)[1].split("```", 1)[0]
    return [line.split()[0] for line in block.splitlines()]


def layers() -> list[set[str]]:
    rules = configparser.ConfigParser()
    rules.read(ROOT / ".importlinter")
    lines = rules["importlinter:contract:layers"]["layers"].split("\n")
    return [set(re.findall(r"missionsim\.([\w.]+)", line)) for line in lines if line.strip()]


def test_the_page_has_the_order_of_the_import_rules() -> None:
    names = drawn()
    rank = {name: number for number, layer in enumerate(layers()) for name in layer}
    assert set(names) == set(rank)
    assert [rank[name] for name in names] == sorted(rank.values())


def test_every_room_of_the_tree_is_on_the_page() -> None:
    package = ROOT / "missionsim"
    rooms = {p.name for p in package.iterdir() if p.is_dir() and not p.name.startswith("_")}
    rooms |= {p.stem for p in package.glob("*.py") if not p.stem.startswith("_")}
    assert rooms - DATA == {name.partition(".")[0] for name in drawn()}


def test_every_file_that_the_page_names_is_there() -> None:
    text = (ROOT / "docs" / "architecture.md").read_text("utf-8")
    named = set(re.findall(r"`((?:\w+/)+[\w.]+\.(?:py|yaml))`", text))
    assert named >= {"identify/verdict.py", "effects/library.yaml", "inputs/segments.py", "results/write.py"}
    assert [name for name in sorted(named) if not any((ROOT / at / name).is_file() for at in ("", "missionsim"))] == []

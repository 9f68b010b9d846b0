"""Shipped files with something wrong in them: accepted, or refused with located messages; nothing else."""

from __future__ import annotations

import contextlib
import copy
from pathlib import Path
from typing import Any

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from missionsim.errors import InputError
from missionsim.inputs import check_files, load_mission, load_robot
from missionsim.inputs.power import build_power_model
from missionsim.inputs.tree import parse_document
from missionsim.plan.build import make_plan

ROOT = Path(__file__).resolve().parents[2]
FILES = sorted(
    [
        *(ROOT / "missionsim" / "robots").glob("*.yaml"),
        *(ROOT / "environments").glob("*.yaml"),
        *(path for path in (ROOT / "missions").glob("*/*.yaml") if "corridor_" not in path.name),
        ROOT / "missions" / "pioneer3dx" / "corridor_speeds.yaml",
    ]
)
NASTY: list[Any] = [
    None, True, False, 0, -1, 1e308, float("nan"), float("inf"), 10**30, "", " ", "on", "3 kg", "-5 W", "1e999",
    "5 %", "x", "0 m", "nan", "1:30", [], {}, [[]], {"value": 1}, {"value": "1 W", "sd": -1},
    {"low": 2, "high": 1}, ["a", 1], {"x": {"y": 1}}, "../../etc/passwd", "k * (", "a.b.c", "\u2028", "𝛼", "'",
    "robot", "laser", "dock", {"kind": "normal"}, {"distribution": {"kind": "normal"}},
    {"distribution": {"kind": "empirical", "file": "/dev/null", "column": "x"}},
]  # fmt: skip
CHARACTERS = [*"{}[]:,-?&*!|>'\"%@`#\t\n \\~0aZ", "---", "...", "<<: ", "&a ", "*a ", "!!str ", "é", "\x00", "\ufeff"]


def paths_of(data: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all values in a tree."""
    items = data.items() if isinstance(data, dict) else enumerate(data) if isinstance(data, list) else ()
    return [here, *(path for key, value in items for path in paths_of(value, (*here, key)))]


TEXTS = {path: path.read_text(encoding="utf-8") for path in FILES}
TREES = {path: parse_document(text).data for path, text in TEXTS.items()}
PATHS = {path: paths_of(tree)[1:] for path, tree in TREES.items()}


@pytest.fixture(scope="module")
def place(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the shipped folders' shape, so that relative paths lead to the shipped files."""
    root = tmp_path_factory.mktemp("mutated")
    (root / "environments").symlink_to(ROOT / "environments")
    (root / "missions" / "robot").mkdir(parents=True)
    for path in (ROOT / "missions" / "pioneer3dx").glob("*.yaml"):
        (root / "missions" / "robot" / path.name).symlink_to(path)
    return root / "missions" / "robot"


def judge(folder: Path, text: str) -> None:
    """Accepted or refused with located messages, and what is accepted can be planned."""
    path = folder / "mutated.yaml"
    path.write_bytes(text.encode("utf-8", "surrogatepass"))
    faults = check_files([path])
    for fault in faults:
        assert fault.message
        if fault.file == str(path):
            assert 1 <= fault.line <= text.count("\n") + 2
    if any(fault.severity == "error" for fault in faults):
        return
    kind = parse_document(text).data["kind"]
    with contextlib.suppress(InputError):  # located by the plan or the power model
        if kind == "robot":
            build_power_model(load_robot(path))
        elif kind == "mission":
            mission = load_mission(path)
            build_power_model(mission.robot)
            if "times" not in text:
                make_plan(mission)


MUTATIONS = settings(
    max_examples=50,
    deadline=None,
    database=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture, HealthCheck.too_slow],
)


@MUTATIONS
@given(data=st.data())
def test_mutated_trees(place: Path, data: st.DataObject) -> None:
    """Values replaced by nasty ones, keys renamed, doubled or taken out."""
    source = data.draw(st.sampled_from(FILES), label="file")
    tree = copy.deepcopy(TREES[source])
    for _ in range(data.draw(st.integers(1, 3), label="mutations")):
        path = data.draw(st.sampled_from(PATHS[source]), label="path")
        parent = tree
        try:
            for key in path[:-1]:
                parent = parent[key]
            old = parent[path[-1]]
        except (KeyError, IndexError, TypeError):
            continue
        if not isinstance(parent, dict | list):
            continue
        how = data.draw(st.sampled_from(["replace", "replace", "remove", "rename", "wrap", "add"]), label="how")
        if how == "replace":
            parent[path[-1]] = data.draw(st.sampled_from(NASTY), label="value")
        elif how == "remove":
            del parent[path[-1]]
        elif how == "rename" and isinstance(parent, dict):
            parent[str(path[-1])[:-1] or "x"] = parent.pop(path[-1])
        elif how == "wrap":
            parent[path[-1]] = data.draw(
                st.sampled_from([[old], {"value": old}, {"x": old}, [old, old]]), label="wrapped"
            )
        elif how == "add" and isinstance(old, dict):
            old[data.draw(st.sampled_from(["x", "kind", "name", "value", "on", "__class__"]))] = data.draw(
                st.sampled_from(NASTY)
            )
    judge(place, yaml.safe_dump(tree, allow_unicode=True, sort_keys=False))


@MUTATIONS
@given(data=st.data())
def test_mutated_texts(place: Path, data: st.DataObject) -> None:
    """Characters put in or taken out, lines doubled, moved or lost, the end cut off."""
    source = data.draw(st.sampled_from(FILES), label="file")
    text = TEXTS[source]
    for _ in range(data.draw(st.integers(1, 3), label="mutations")):
        at = data.draw(st.integers(0, len(text)), label="at")
        how = data.draw(st.sampled_from(["insert", "delete", "cut", "double line", "lose line", "indent"]), label="how")
        lines = text.split("\n")
        number = text.count("\n", 0, at)
        if how == "insert":
            text = text[:at] + data.draw(st.sampled_from(CHARACTERS), label="characters") + text[at:]
        elif how == "delete":
            text = text[:at] + text[at + data.draw(st.integers(1, 12), label="length") :]
        elif how == "cut":
            text = text[: max(at, len(text) // 2)]
        else:
            changed = {"double line": [lines[number]] * 2, "lose line": [], "indent": ["  " + lines[number]]}[how]
            text = "\n".join([*lines[:number], *changed, *lines[number + 1 :]])
    judge(place, text)


def test_every_shipped_file_is_valid() -> None:
    assert [str(fault) for fault in check_files(FILES)] == []
    assert len(FILES) >= 20

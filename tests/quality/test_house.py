"""House rules that no tool checks: size of modules, constructors, signatures, circles among files."""

from __future__ import annotations

import ast
import functools
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.mutants.study import MUTANTS

PACKAGE = Path(__file__).resolve().parents[2] / "missionsim"
ROOMS = ["", *sorted(path.parent.name for path in PACKAGE.glob("*/__init__.py"))]
"""What lies beside the rooms is one more, called ``""``."""
MANY_BY_POSITION = ("", "engine", "plan", "planner")
"""Rooms with constructors, named tuples most of them, that take more."""
MOST_LINES, MOST_POSITIONAL = 400, 8
ANY: dict[str, int] = {"planner": 4}
"""Public signatures with `Any` that are left; a number may only fall."""
Function = ast.FunctionDef | ast.AsyncFunctionDef


@functools.cache
def tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


def modules(room: str) -> list[Path]:
    return sorted((PACKAGE / room).rglob("*.py") if room else PACKAGE.glob("*.py"))


def public(body: list[ast.stmt]) -> Iterator[tuple[str, Function]]:
    for item in body:
        if isinstance(item, ast.ClassDef) and not item.name.startswith("_"):
            yield from ((f"{item.name}.{name}", function) for name, function in public(item.body))
        elif isinstance(item, Function) and (item.name == "__init__" or not item.name.startswith("_")):
            yield item.name, item


def names(node: ast.AST | None) -> set[str]:
    return {part.id for part in ast.walk(node) if isinstance(part, ast.Name)} if node is not None else set()


def positional(item: ast.ClassDef) -> int:
    """How many arguments the constructor of a class takes by position."""
    for part in item.body:
        if isinstance(part, ast.FunctionDef) and part.name == "__init__":
            return len(part.args.posonlyargs) + len(part.args.args) - 1
    marks = [ast.unparse(mark) for mark in item.decorator_list]
    tuples = any("NamedTuple" in ast.unparse(base) for base in item.bases)
    if not tuples and not any("dataclass" in mark and "kw_only=True" not in mark for mark in marks):
        return 0
    fields = [
        part for part in item.body if isinstance(part, ast.AnnAssign) and "ClassVar" not in names(part.annotation)
    ]
    kinds = [ast.unparse(field.annotation) for field in fields]
    return kinds.index("KW_ONLY") if "KW_ONLY" in kinds else len(fields)


def test_no_module_is_long() -> None:
    every = PACKAGE.rglob("*.py")
    sizes = {str(path.relative_to(PACKAGE)): len(path.read_text("utf-8").splitlines()) for path in every}
    assert len(sizes) > 100
    assert {name: size for name, size in sizes.items() if size > MOST_LINES} == {}


@pytest.mark.parametrize("room", sorted({*ROOMS} - {*MANY_BY_POSITION}))
def test_no_constructor_takes_many_arguments_by_position(room: str) -> None:
    classes = [
        (path, item) for path in modules(room) for item in ast.walk(tree(path)) if isinstance(item, ast.ClassDef)
    ]
    found = {f"{path.relative_to(PACKAGE)}: {item.name}": positional(item) for path, item in classes}
    assert {name: count for name, count in found.items() if count > MOST_POSITIONAL} == {}


@pytest.mark.parametrize("room", ROOMS)
def test_public_signatures_say_what_they_take(room: str) -> None:
    found = []
    for path in modules(room):
        for name, function in public(tree(path).body):
            given = function.args
            listed = [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]
            hints = [function.returns, *(one.annotation for one in listed if one is not None)]
            if any("Any" in names(hint) for hint in hints):
                found.append(f"{path.relative_to(PACKAGE)}:{function.lineno} {name}")
    assert len(found) <= ANY.get(room, 0), "\n".join(found)


def test_every_mutant_still_has_its_line() -> None:
    assert [m for m in MUTANTS if (PACKAGE.parent / m.file).read_text(encoding="utf-8").count(m.old) != 1] == []


def imported(path: Path) -> set[str]:
    """Modules of ours that a module loads when it is loaded."""
    result: set[str] = set()
    waiting: list[ast.AST] = list(tree(path).body)
    while waiting:
        item = waiting.pop()
        if isinstance(item, ast.ImportFrom) and str(item.module).startswith("missionsim"):
            inner = [f"{item.module}.{one.name}" for one in item.names]
            files = [name for name in inner if (PACKAGE.parent / (name.replace(".", "/") + ".py")).is_file()]
            result |= set(files) if len(files) == len(inner) else {str(item.module), *files}
        elif isinstance(item, ast.If) and "TYPE_CHECKING" not in names(item.test):
            waiting += [*item.body, *item.orelse]
        elif isinstance(item, (ast.Try, ast.ClassDef)):
            waiting += item.body
    return result


def test_no_circle_among_files() -> None:
    def called(path: Path) -> str:
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    loads = {called(path): imported(path) for path in PACKAGE.rglob("*.py")}
    while leaves := {name for name, needs in loads.items() if not needs & loads.keys() - {name}}:
        loads = {name: needs for name, needs in loads.items() if name not in leaves}
    assert {name: sorted(needs & loads.keys()) for name, needs in loads.items()} == {}

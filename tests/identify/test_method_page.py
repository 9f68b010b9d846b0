"""docs/method.md names every constant of the identification, at the value that the code has, and no other."""

from __future__ import annotations

import ast
import dataclasses
import re
from pathlib import Path

import pytest

from missionsim.identify import settings

PAGE = (Path(__file__).parents[2] / "docs" / "method.md").read_text(encoding="utf-8")
SOURCE = Path(settings.__file__).read_text(encoding="utf-8")
CONSTANTS = {name: value for name, value in vars(settings).items() if name.isupper()}
CHOICES = {f.name: f.default for f in dataclasses.fields(settings.Settings) if f.name not in ("alpha", "align")}
VALUES = {**CONSTANTS, **CHOICES}


@pytest.mark.parametrize("name", VALUES)
def test_the_page_has_every_constant_at_its_value(name: str) -> None:
    told = re.findall(rf"`{name}` = (\([^)]*\)|[0-9.e-]*[0-9])", PAGE)
    assert told, f"docs/method.md does not say what {name} is"
    assert all(ast.literal_eval(text) == VALUES[name] for text in told)


def test_every_constant_has_its_reason_beside_it() -> None:
    body = ast.parse(SOURCE).body
    for node, after in zip(body, [*body[1:], None], strict=True):
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name) and node.targets[0].id.isupper():
            assert isinstance(after, ast.Expr), f"{node.targets[0].id} has no reason"


def test_the_page_names_no_constant_that_is_gone() -> None:
    named = set(re.findall(r"`([A-Z][A-Z0-9_]+)`", PAGE))
    assert named <= set(CONSTANTS)


def test_every_constant_decides_something() -> None:
    package = Path(settings.__file__).parents[1]
    code = "\n".join(p.read_text(encoding="utf-8") for p in package.rglob("*.py") if p.name != "settings.py")
    assert CONSTANTS.keys() <= set(re.findall(r"\w+", code))

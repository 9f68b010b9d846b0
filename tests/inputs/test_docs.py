"""The reference of the YAML files names every key and its examples are valid."""

from __future__ import annotations

import re
from pathlib import Path
from typing import get_args

import pytest
from pydantic import BaseModel

from missionsim.inputs import check_files
from missionsim.inputs.base import Model
from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.mission import MissionSpec, StudySpec
from missionsim.inputs.robot import RobotSpec


def models_below(kind: object, seen: set[type[BaseModel]]) -> set[type[BaseModel]]:
    """A model and all models in its fields."""
    if isinstance(kind, type) and issubclass(kind, Model):
        if kind not in seen:
            seen.add(kind)
            for field in kind.model_fields.values():
                models_below(field.annotation, seen)
    else:
        for argument in get_args(kind):
            models_below(argument, seen)
    return seen


@pytest.fixture
def page(root: Path) -> str:
    return (root / "docs" / "yaml.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("model", [RobotSpec, EnvironmentSpec, MissionSpec, StudySpec])
def test_every_key_is_in_the_reference(page: str, model: type[BaseModel]) -> None:
    keys = {field.alias or name for item in models_below(model, set()) for name, field in item.model_fields.items()}
    assert len(keys) > 5
    missing = {key for key in keys if not re.search(rf"\b{key}\b", page)}
    assert missing == set()


def test_examples_are_valid(page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    blocks = re.findall(r"```yaml\n(.*?)```", page, re.DOTALL)
    assert len(blocks) == 3
    monkeypatch.chdir(tmp_path)
    names = ["courier.yaml", "yard.yaml", "delivery.yaml"]
    for name, block in zip(names, blocks, strict=True):
        Path(name).write_text(block, encoding="utf-8")
    assert [str(fault) for fault in check_files(names)] == []

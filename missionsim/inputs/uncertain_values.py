"""Which numbers of a loaded file are uncertain."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from missionsim.inputs.base import Model
from missionsim.inputs.parameter import Parameter


def parameters(model: Any) -> list[tuple[str, Parameter]]:
    """Paths and parameters of all numbers that a model's file gives, in the file's order."""
    result: list[tuple[str, Parameter]] = []
    stack: list[Any] = [model]
    while stack:
        item = stack.pop()
        if isinstance(item, Parameter):
            if item.path:
                result.append((item.path, item))
        elif isinstance(item, Model):
            stack.extend(getattr(item, name) for name in reversed(type(item).model_fields))
        elif isinstance(item, Mapping):
            stack.extend(reversed(list(item.values())))
        elif isinstance(item, tuple):
            stack.extend(reversed(item))
    return result


def uncertain_values(model: Any) -> list[tuple[str, Parameter]]:
    """Those of `parameters` that have a distribution."""
    return [(path, parameter) for path, parameter in parameters(model) if parameter.distribution is not None]

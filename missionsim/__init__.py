"""missionsim: a discrete-event simulator of the energy that mobile robots spend on missions.

Public names are loaded when they are first used, so that ``import missionsim`` itself costs nothing.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from missionsim.compare.core import compare_files as compare_files
    from missionsim.engine.outcome import RunResult as RunResult
    from missionsim.engine.simulate import simulate as simulate
    from missionsim.errors import InputError as InputError
    from missionsim.inputs.loading import load_environment as load_environment
    from missionsim.inputs.loading import load_mission as load_mission
    from missionsim.inputs.loading import load_robot as load_robot
    from missionsim.results.tables import tables as tables
    from missionsim.results.write import write_results as write_results

__version__ = "0.1.0"

_PUBLIC = {
    "load_mission": "missionsim.inputs.loading",
    "load_robot": "missionsim.inputs.loading",
    "load_environment": "missionsim.inputs.loading",
    "simulate": "missionsim.engine.simulate",
    "RunResult": "missionsim.engine.outcome",
    "tables": "missionsim.results.tables",
    "write_results": "missionsim.results.write",
    "compare_files": "missionsim.compare.core",
    "InputError": "missionsim.errors",
}
"""Public name → module; at most fifteen."""

__all__ = [*_PUBLIC]


def __getattr__(name: str) -> Any:
    module = _PUBLIC.get(name)
    if module is None:
        raise AttributeError(f"module 'missionsim' has no attribute '{name}'")
    value = getattr(importlib.import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])

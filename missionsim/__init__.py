"""missionsim: a discrete-event simulator of the energy that mobile robots spend on missions.

Public names are loaded when they are first used, so that ``import missionsim`` itself costs nothing.
"""

from __future__ import annotations

import importlib
import sys
from types import ModuleType
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from missionsim.compare.core import compare_files as compare_files
    from missionsim.engine.outcome import RunResult as RunResult
    from missionsim.engine.simulate import simulate as simulate
    from missionsim.errors import InputError as InputError
    from missionsim.inputs.loading import load_environment as load_environment
    from missionsim.inputs.loading import load_mission as load_mission
    from missionsim.inputs.loading import load_robot as load_robot
    from missionsim.interface import add_effect as add_effect
    from missionsim.interface import calibrate as calibrate
    from missionsim.interface import compare as compare
    from missionsim.interface import diagnose as diagnose
    from missionsim.interface import import_log as import_log
    from missionsim.interface import import_site as import_site
    from missionsim.interface import improve as improve
    from missionsim.interface import monte_carlo as monte_carlo
    from missionsim.interface import plan as plan
    from missionsim.interface import run as run
    from missionsim.interface import whatif as whatif
    from missionsim.results.write import tables as tables
    from missionsim.results.write import write_results as write_results

__version__ = "0.1.0"

_PUBLIC = {
    name: f"missionsim.{module}"
    for module, names in (
        ("inputs.loading", "load_mission load_robot load_environment"),
        ("engine.simulate", "simulate"),
        ("engine.outcome", "RunResult"),
        ("results.write", "tables write_results"),
        ("compare.core", "compare_files"),
        ("errors", "InputError"),
        (
            "interface",
            "run whatif monte_carlo compare diagnose add_effect improve calibrate plan import_log import_site",
        ),
    )
    for name in names.split()
}
"""Public name → module; at most twenty."""

__all__ = [*_PUBLIC]
_COMMANDS = ("missionsim.compare", "missionsim.diagnose", "missionsim.plan")
"""Packages that are called like the public functions of their names."""


class _Command(ModuleType):
    """A package with the name of a command: calling it calls the command's function in `missionsim.interface`."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        name = self.__name__.rpartition(".")[2]
        return getattr(importlib.import_module("missionsim.interface"), name)(*arguments, **options)


def command_package(name: str) -> None:
    """Make a package callable: ``missionsim.diagnose`` is a package and a public function."""
    sys.modules[name].__class__ = _Command


def __getattr__(name: str) -> Any:
    module = _PUBLIC.get(name)
    if module is None:
        raise AttributeError(f"module 'missionsim' has no attribute '{name}'")
    if f"missionsim.{name}" in _COMMANDS:
        return importlib.import_module(f"missionsim.{name}")
    value = getattr(importlib.import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted([*globals(), *_PUBLIC])

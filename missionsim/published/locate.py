"""Where the shipped missions lie, and runs of them."""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING

from missionsim.inputs.examples import examples_folder

if TYPE_CHECKING:
    from missionsim.engine.outcome import RunResult
    from missionsim.inputs.mission import MissionSpec

Overrides = tuple[tuple[str, str], ...]


@functools.lru_cache(maxsize=256)
def mission(name: str, overrides: Overrides = ()) -> MissionSpec:
    """A shipped mission by ``robot/name``, with values set as on the command line."""
    from missionsim.inputs import load_mission

    return load_mission(examples_folder() / "missions" / f"{name}.yaml", overrides=overrides)


@functools.lru_cache(maxsize=256)
def run(name: str, overrides: Overrides = ()) -> RunResult:
    """The simulation of a shipped mission."""
    from missionsim.engine.simulate import simulate

    return simulate(mission(name, overrides))

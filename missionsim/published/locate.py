"""Where the shipped missions lie, and runs of them."""

from __future__ import annotations

import functools
from pathlib import Path
from typing import TYPE_CHECKING

from missionsim.errors import InputError

if TYPE_CHECKING:
    from missionsim.engine.outcome import RunResult
    from missionsim.inputs.mission import MissionSpec

Overrides = tuple[tuple[str, str], ...]


def missions_folder() -> Path:
    """Folder ``missions`` of the clone.

    Raises
    ------
    missionsim.errors.InputError
        Where missionsim is installed without its missions.
    """
    for base in (Path(__file__).resolve().parents[2], Path.cwd()):
        if (base / "missions" / "pioneer3dx").is_dir():
            return base / "missions"
    raise InputError.single("the shipped missions are not here", allowed="a clone of the repository as working folder")


@functools.lru_cache(maxsize=256)
def mission(name: str, overrides: Overrides = ()) -> MissionSpec:
    """A shipped mission by ``robot/name``, with values set as on the command line."""
    from missionsim.inputs import load_mission

    return load_mission(missions_folder() / f"{name}.yaml", overrides=overrides)


@functools.lru_cache(maxsize=256)
def run(name: str, overrides: Overrides = ()) -> RunResult:
    """The simulation of a shipped mission."""
    from missionsim.engine.simulate import simulate

    return simulate(mission(name, overrides))

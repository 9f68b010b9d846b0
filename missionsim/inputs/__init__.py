"""YAML in, checked: robots, environments, missions and studies as frozen models.

`load_robot`, `load_environment`, `load_mission` and `load_study` read files, `check_files` tells all their faults.
"""

from missionsim.inputs.loading import (
    check_files,
    load_environment,
    load_mission,
    load_robot,
    load_study,
    shipped_robots,
)

__all__ = ["check_files", "load_environment", "load_mission", "load_robot", "load_study", "shipped_robots"]

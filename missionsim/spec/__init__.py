"""YAML in, checked: robots, environments, missions and studies as frozen models.

`load_robot`, `load_environment`, `load_mission` and `load_study` read files, `check_files` tells all their faults.
"""

from missionsim.spec.distributions import Distribution
from missionsim.spec.environment import EnvironmentSpec
from missionsim.spec.loading import (
    check_files,
    load_environment,
    load_mission,
    load_robot,
    load_study,
    shipped_robots,
)
from missionsim.spec.mission import MissionSpec, StudySpec
from missionsim.spec.robot import RobotSpec
from missionsim.spec.values import Parameter

__all__ = [
    "Distribution",
    "EnvironmentSpec",
    "MissionSpec",
    "Parameter",
    "RobotSpec",
    "StudySpec",
    "check_files",
    "load_environment",
    "load_mission",
    "load_robot",
    "load_study",
    "shipped_robots",
]

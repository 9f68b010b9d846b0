"""YAML in, checked: robots, environments, missions and studies as frozen models.

`load_robot`, `load_environment`, `load_mission` and `load_study` read files, `check_files` tells all their faults.
"""

from missionsim.inputs.environment import EnvironmentSpec
from missionsim.inputs.examples import shipped_robots
from missionsim.inputs.loading import check_files, load_environment, load_mission, load_robot, load_study
from missionsim.inputs.mission import MissionSpec, StudySpec
from missionsim.inputs.parameter import Distribution
from missionsim.inputs.robot import RobotSpec
from missionsim.inputs.values import Parameter

__all__ = [
    "Distribution", "EnvironmentSpec", "MissionSpec", "Parameter", "RobotSpec", "StudySpec", "check_files",
    "load_environment", "load_mission", "load_robot", "load_study", "shipped_robots",
]  # fmt: skip

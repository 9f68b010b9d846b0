"""Checks across parts of a file and across files."""

from __future__ import annotations

from missionsim.errors import Fault
from missionsim.spec.environment import EnvironmentSpec
from missionsim.spec.mission import MissionSpec
from missionsim.spec.robot import RobotSpec
from missionsim.spec.tree import Document


def check_robot(robot: RobotSpec, document: Document) -> list[Fault]:
    """Batteries, links, relays, requirements, sensors, expressions."""
    return []


def check_environment(environment: EnvironmentSpec, document: Document) -> list[Fault]:
    """Places of edges, lengths."""
    return []


def check_mission(mission: MissionSpec, document: Document) -> list[Fault]:
    """Places, schemes, sensors, speeds, paths."""
    return []

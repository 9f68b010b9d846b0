"""How fast a segment that drives is asked to be, and what keeps it below that."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, NamedTuple

from missionsim.plan.draws import least

if TYPE_CHECKING:
    from missionsim.inputs.mission import MissionSpec
    from missionsim.inputs.parameter import Parameter


class Pace(NamedTuple):
    """Speeds [m/s]; limits are infinite where there is none.

    Attributes
    ----------
    asked : float
        Speed asked times the part of it that is reached (`speed_tracking`).
    robot, scheme : float
        Greatest speed of the robot and of the control scheme. A nominal `speed_tracking` above 1 says that these are
        exceeded by so much, and raises them.
    way : float
        Limit of the way, or of the greatest yaw rate on an arc.
    """

    asked: float = 0.0
    robot: float = math.inf
    scheme: float = math.inf
    way: float = math.inf

    @property
    def speed(self) -> float:
        """Speed driven."""
        return least(least(self.asked, self.robot), least(self.scheme, self.way))

    @property
    def limited(self) -> bool:
        """Whether more was asked, by a draw, than the robot can do under this scheme."""
        return self.asked > least(self.robot, self.scheme) * ROUNDING


ROUNDING = 1.0 + 1e-12


def pace_of(
    mission: MissionSpec,
    number: Callable[[Parameter, str], float],
    segment: Any,
    scheme_name: str,
    tracking: tuple[Parameter, str] | None,
    way: float = math.inf,
) -> Pace:
    """The pace of a segment.

    Parameters
    ----------
    mission : MissionSpec
    number : callable
        Parameter and prefix of its path → value, drawn or nominal.
    segment : SegmentSpec
    scheme_name : str
        Control scheme in force.
    tracking : tuple of (Parameter, str) or None
        The `speed_tracking` in force and the prefix of its path.
    way : float
        Limit from elsewhere [m/s].
    """
    body = mission.robot.body
    scheme = mission.robot.schemes.get(scheme_name)
    top = body.max_speed
    if segment.kind == "move" and body.max_lateral_speed is not None and body.max_lateral_speed.value > top.value:
        top = body.max_lateral_speed
    reached = 1.0 if tracking is None else number(*tracking)
    raised = 1.0 if tracking is None else max(1.0, tracking[0].value)
    robot = number(top, "robot.") * raised
    of_scheme = math.inf
    if scheme is not None and scheme.max_speed is not None:
        of_scheme = number(scheme.max_speed, "robot.") * raised
    given = mission.setting(segment, "speed")
    asked = least(number(body.max_speed, "robot."), of_scheme / raised) if given is None else number(given, "")
    return Pace(asked * reached, robot, of_scheme, way)

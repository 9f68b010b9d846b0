"""How fast a segment that drives is asked to be, and what keeps it below that."""

from __future__ import annotations

import math
from typing import NamedTuple

from missionsim.plan.draws import least


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

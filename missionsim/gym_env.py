"""A Gymnasium environment: choose speed and clock of a robot so that a track costs little energy.

The optional extra ``gym`` installs Gymnasium: ``pip install missionsim[gym]``. Registered as ``missionsim/Rover-v0``
when this module is imported.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from missionsim.control import PowerPredictor
from missionsim.errors import InputError
from missionsim.files import install_hint

try:
    import gymnasium
    from gymnasium import spaces
except ImportError as error:  # pragma: no cover - depends on what is installed
    raise InputError.single(
        "the Gymnasium environment needs the extra 'gym'", got=str(error), allowed=install_hint("gym")
    ) from error

Observation = NDArray[np.float32]
COMPLEXITIES = (0.3, 0.6, 1.0)
"""Of the shipped tracks: low, moderate, high."""


class RoverEnv(gymnasium.Env[Observation, NDArray[np.float32]]):
    """Drive a track of pieces with different complexity and slope.

    Action: two numbers from −1 to 1, speed (of the robot's range) and clock (of the computer's). Observation: share of
    the track done, speed, charge left, complexity here and in the next piece, slope here and in the next piece; each
    scaled to 0…1 or −1…1. Reward: minus the energy of the step (J per metre of the track's length, scaled), minus a
    penalty for batches that were not processed, minus a small price of time.

    Parameters
    ----------
    robot : str
        A shipped robot or a path; it needs a computer under the law ``multicore_cpu``.
    length_m, piece_m, step_s : float
        Length of the track, of one piece of it, and of a time step.
    missed_cost, time_cost : float
        Cost of one batch not processed and of one second, J.
    slope_rad : float
        Greatest slope of a piece.
    """

    metadata = {"render_modes": []}  # noqa: RUF012 - Gymnasium's own interface

    def __init__(
        self,
        robot: str = "rover_tx2",
        length_m: float = 300.0,
        piece_m: float = 30.0,
        step_s: float = 1.0,
        missed_cost: float = 2.0,
        time_cost: float = 2.0,
        slope_rad: float = 0.05,
    ) -> None:
        self.predictor = PowerPredictor(robot)
        body = self.predictor.spec.body
        self.top_m_s = float(body.max_speed)
        self.accel_m_s2 = float(body.max_acceleration) if body.max_acceleration is not None else np.inf
        clocks = self.predictor.clocks()
        self.clock_range = (float(clocks[0]), float(clocks[-1]))
        self.capacity_j = self.predictor.spec.batteries[self.predictor.battery or ""].capacity_j
        self.length_m, self.piece_m, self.step_s = length_m, piece_m, step_s
        self.missed_cost, self.time_cost, self.slope_rad = missed_cost, time_cost, slope_rad
        self.batch_rate = self.predictor.batch_rate
        self.action_space = spaces.Box(-1.0, 1.0, (2,), np.float32)
        self._low = np.array([0, 0, 0, 0, 0, -1, -1], dtype=np.float32)
        self._high = np.ones(7, dtype=np.float32)
        self.observation_space = spaces.Box(self._low, self._high, dtype=np.float32)
        self.max_steps = round(20.0 * length_m / (self.top_m_s * step_s)) + 1
        self._pieces = np.zeros((1, 2))
        self._position = self._speed = self._drawn = 0.0
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, object] | None = None
    ) -> tuple[Observation, dict[str, object]]:
        """A new track; with a seed always the same one."""
        super().reset(seed=seed)
        count = int(np.ceil(self.length_m / self.piece_m)) + 1
        complexity = self.np_random.choice(COMPLEXITIES, count)
        slope = self.np_random.uniform(-self.slope_rad, self.slope_rad, count)
        self._pieces = np.column_stack([complexity, slope])
        self._position = self._speed = self._drawn = 0.0
        self._steps = 0
        return self._observe(), self._info(0.0, 0.0)

    def step(self, action: NDArray[np.float32]) -> tuple[Observation, float, bool, bool, dict[str, object]]:
        """One time step at a speed and a clock."""
        share = 0.5 * (np.clip(np.asarray(action, dtype=float), -1.0, 1.0) + 1.0)
        change = self.accel_m_s2 * self.step_s
        asked = float(share[0]) * self.top_m_s
        speed = float(np.clip(asked, self._speed - change, self._speed + change))
        clock = self.clock_range[0] + float(share[1]) * (self.clock_range[1] - self.clock_range[0])
        complexity, slope = self._piece(0)
        mean, accel = 0.5 * (speed + self._speed), (speed - self._speed) / self.step_s
        energy = float(self.predictor.power(mean, clock, complexity, slope, accel_m_s2=accel)) * self.step_s
        done = float(self.predictor.throughput(mean, clock, complexity))
        missed = max(self.batch_rate - done, 0.0) * self.step_s
        self._position = min(self._position + mean * self.step_s, self.length_m)
        self._speed, self._drawn, self._steps = speed, self._drawn + energy, self._steps + 1
        empty = self._drawn >= self.capacity_j
        terminated = self._position >= self.length_m or empty
        truncated = not terminated and self._steps >= self.max_steps
        cost = energy + self.missed_cost * missed + self.time_cost * self.step_s + (self.capacity_j if empty else 0.0)
        return self._observe(), -cost / self.length_m, terminated, truncated, self._info(energy, missed)

    def _piece(self, ahead: int) -> tuple[float, float]:
        index = min(int(self._position // self.piece_m) + ahead, len(self._pieces) - 1)
        return float(self._pieces[index, 0]), float(self._pieces[index, 1])

    def _observe(self) -> Observation:
        here, following = self._piece(0), self._piece(1)
        slopes = [(piece[1] / self.slope_rad if self.slope_rad > 0.0 else 0.0) for piece in (here, following)]
        left = max(1.0 - self._drawn / self.capacity_j, 0.0)
        values = [self._position / self.length_m, self._speed / self.top_m_s, left, here[0], following[0], *slopes]
        return np.clip(np.array(values, dtype=np.float32), self._low, self._high)

    def _info(self, energy_j: float, missed: float) -> dict[str, object]:
        return {"energy_j": energy_j, "missed_batches": missed, "drawn_j": self._drawn, "position_m": self._position}


if "missionsim/Rover-v0" not in gymnasium.registry:
    gymnasium.register(id="missionsim/Rover-v0", entry_point="missionsim.gym_env:RoverEnv")

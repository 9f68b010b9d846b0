"""Energy per metre over speed and clock, inside a control loop: prediction horizons and optima.

For robots with the motion model ``traction`` (or any other) and perhaps an on-board computer ``cpu`` whose load follows
speed and complexity. Everything is vectorised: a horizon of 20 steps × 50 candidates is one evaluation. After the rover
paper ("Simulation of Mechanical and Computational Power Consumption in Mobile Robots"), Eq. 7; `missionsim.fidelity`
trades error against time.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from missionsim.effects import named_models
from missionsim.errors import InputError
from missionsim.inputs import load_robot
from missionsim.inputs.power import build_power_model
from missionsim.inputs.robot import RobotSpec
from missionsim.physics import Array, Bools, electrical, f64

TX2_STEP_HZ = 153.6e6
"""Grid of the Jetson TX2's clocks (assumed between the printed end points)."""


@dataclass(frozen=True)
class Optimum:
    """Best setting that was found."""

    speed_m_s: float
    freq_hz: float
    energy_j_m: float
    """Energy per metre there."""
    feasible: bool
    """Whether the quality of service is met; where nothing on the grid meets it, the setting of greatest throughput."""
    evaluations: int
    """Grid points evaluated."""


@dataclass
class PowerPredictor:
    """Power of a robot for a controller: arrays of settings in, watts out.

    Parameters
    ----------
    robot : RobotSpec or str
        A shipped robot's name, a path or a loaded robot.
    battery : str, optional
        The first one if not given.
    on : mapping, optional
        Units that are switched on; all components once if not given.
    """

    robot: Any
    battery: str | None = None
    on: Mapping[str, float] | None = None
    values: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))

    def __post_init__(self) -> None:
        spec: RobotSpec = load_robot(self.robot) if isinstance(self.robot, str) else self.robot
        self.spec = spec
        self.model = build_power_model(spec)
        self.battery = self.battery or next(iter(spec.batteries))
        on = self.on if self.on is not None else {name: float(c.units) for name, c in spec.components.items()}
        self._on = {f"on_{name}": float(count) for name, count in on.items()}
        self._loads: dict[str, float] = {}
        laws = [(name, load.law) for name, component in spec.components.items() for load in component.loads]
        for name, law in laws:
            if not self._loads and law is not None and law.model == "multicore_cpu":
                defaults = {p.name: p.default for p in named_models.law_models()["multicore_cpu"].parameters}
                own = {key.removeprefix(f"{self.battery}/{name}."): v for key, v in self.values.items()}
                given = {key: float(value) for key, value in law.parameters.items()}
                self._loads = {**defaults, **given, **{k: v for k, v in own.items() if k in defaults}}

    def power(
        self,
        speed_m_s: ArrayLike,
        freq_hz: ArrayLike | None = None,
        complexity: ArrayLike = 1.0,
        slope_rad: ArrayLike = 0.0,
        payload_kg: ArrayLike = 0.0,
        accel_m_s2: ArrayLike = 0.0,
        **more: ArrayLike | str,
    ) -> Array:
        """Power of the battery (W) for settings that broadcast; more covariates by their glossary names."""
        given = {"speed_m_s": speed_m_s, "accel_m_s2": accel_m_s2, "slope_rad": slope_rad}
        given |= {"payload_kg": payload_kg, "complexity": complexity}
        given |= {} if freq_hz is None else {"cpu_freq_hz": freq_hz}
        cov: dict[str, Any] = {name: f64(value) for name, value in given.items()}
        cov |= {"yaw_rate_rad_s": 0.0, "scheme": "", **self._on, **more}
        return np.asarray(self.model.total(cov, self.battery or "", self.values), dtype=np.float64)

    def horizon_energy(
        self, speeds_m_s: ArrayLike, step_s: float, freq_hz: ArrayLike | None = None, **covariates: ArrayLike
    ) -> Array:
        """Energy (J) of candidate trajectories over a horizon.

        Parameters
        ----------
        speeds_m_s : array_like, shape (candidates, steps)
            Speed in each step; accelerations follow from one step to the next (the first from the step before it, if
            `start_speed_m_s` is among the covariates).
        freq_hz : array_like, optional
            Broadcasts against `speeds_m_s`.
        **covariates
            ``complexity``, ``slope_rad``, ``payload_kg``…

        Returns
        -------
        ndarray, shape (candidates,)
        """
        if not 0.0 < step_s < np.inf:
            raise InputError.single("a horizon needs a step of time", got=step_s, allowed="more than 0 s")
        speed = f64(speeds_m_s)
        first = f64(covariates.pop("start_speed_m_s", speed[..., 0]))
        before = np.concatenate([np.broadcast_to(first, speed.shape[:-1])[..., None], speed[..., :-1]], axis=-1)
        mean = 0.5 * (speed + before)
        accel = (speed - before) / step_s
        watts = self.power(mean, freq_hz, accel_m_s2=accel, **covariates)
        return np.asarray(np.sum(np.broadcast_to(watts, speed.shape), axis=-1) * step_s)

    def loop_time(self, speed_m_s: ArrayLike, freq_hz: ArrayLike, complexity: ArrayLike = 1.0) -> Array:
        """Time per batch (PLPT), s.

        Raises
        ------
        missionsim.errors.InputError
            For a robot without an on-board computer under the law ``multicore_cpu``.
        """
        cov = {"speed_m_s": f64(speed_m_s), "cpu_freq_hz": f64(freq_hz), "complexity": f64(complexity)}
        return f64(named_models.loop_time(cov, self._cpu()))

    def throughput(self, speed_m_s: ArrayLike, freq_hz: ArrayLike, complexity: ArrayLike = 1.0) -> Array:
        """Batches processed per second."""
        return electrical.throughput(
            self.loop_time(speed_m_s, freq_hz, complexity), batch_rate_hz=self._cpu()["batch_rate"]
        )

    @property
    def batch_rate(self) -> float:
        """Batches that come per second."""
        return self._cpu()["batch_rate"]

    def meets_service(self, speed_m_s: ArrayLike, freq_hz: ArrayLike, complexity: ArrayLike = 1.0) -> Bools:
        """Whether every batch is processed before the next comes (to 1e-9)."""
        return np.asarray(
            self.loop_time(speed_m_s, freq_hz, complexity) * self._cpu()["batch_rate"] <= 1.0 + 1e-9, dtype=bool
        )

    def _cpu(self) -> dict[str, float]:
        if not self._loads:
            told = f"robot '{self.spec.name}' has no computer whose load follows its speed"
            raise InputError.single(told, allowed="a component with law: {model: multicore_cpu}")
        return self._loads

    def clocks(self, step_hz: float = TX2_STEP_HZ) -> Array:
        """Clocks from the lowest to the highest in steps, Hz; the highest is always among them."""
        cpu = self._cpu()
        return f64(np.arange(cpu["high_freq"], cpu["low_freq"] - 1.0, -step_hz)[::-1])

    def energy_per_metre(self, speeds_m_s: ArrayLike, freq_hz: ArrayLike, complexity: ArrayLike = 1.0) -> Array:
        """Eq. 7 of the rover paper, J/m."""
        return electrical.energy_per_metre(self.power(speeds_m_s, freq_hz, complexity), speeds_m_s)

    def best(
        self, speeds_m_s: ArrayLike, clocks_hz: ArrayLike, complexity: float = 1.0, *, service: bool = True
    ) -> Optimum:
        """Speed and clock of least energy per metre on a grid, keeping the quality of service if asked."""
        speed, clock = np.meshgrid(f64(speeds_m_s), f64(clocks_hz), indexing="ij")
        if not ((speed >= 0.0).all() and np.isfinite(speed).all() and (speed > 0.0).any() and (clock > 0.0).all()):
            told = "speeds or clocks that cannot be"
            raise InputError.single(told, allowed="numbers of 0 or more, one above 0 at least")
        if not 0.0 <= complexity < np.inf:
            raise InputError.single("a complexity that cannot be", got=complexity, allowed="0 or more")
        energy = self.energy_per_metre(speed, clock, complexity)
        allowed = self.meets_service(speed, clock, complexity) if service else np.ones(speed.shape, dtype=bool)
        kept = bool(allowed.any())
        rank = np.where(allowed, energy, np.inf) if kept else -self.throughput(speed, clock, complexity)
        at = int(np.argmin(rank))
        return Optimum(float(speed.flat[at]), float(clock.flat[at]), float(energy.flat[at]), kept, energy.size)

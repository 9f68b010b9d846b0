"""Energy per metre over speed and clock, inside a control loop: prediction horizons, optima, fidelity.

For robots with the motion model ``traction`` (or any other) and perhaps an on-board computer ``cpu`` whose load follows
speed and complexity. Everything is vectorised: a horizon of 20 steps × 50 candidates is one evaluation. After the rover
paper ("Simulation of Mechanical and Computational Power Consumption in Mobile Robots"), Eq. 7 and its fidelity levels.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from missionsim.effects import law_cpu
from missionsim.errors import InputError
from missionsim.physics import processor
from missionsim.physics.arrays import f64

if TYPE_CHECKING:
    from missionsim.spec.robot import RobotSpec

Array = NDArray[np.float64]
TX2_STEP_HZ = 153.6e6
"""Grid of the Jetson TX2's clocks (assumed between the printed end points)."""


@dataclass(frozen=True)
class Optimum:
    """Best setting that was found.

    Attributes
    ----------
    speed_m_s, freq_hz : float
    energy_j_m : float
        Energy per metre there.
    feasible : bool
        Whether the quality of service is met; where nothing on the grid meets it, the setting of greatest throughput.
    evaluations : int
        Grid points evaluated.
    """

    speed_m_s: float
    freq_hz: float
    energy_j_m: float
    feasible: bool
    evaluations: int


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
        from missionsim.spec import load_robot
        from missionsim.spec.power import build_power_model

        spec: RobotSpec = load_robot(self.robot) if isinstance(self.robot, str) else self.robot
        self.spec = spec
        self.model = build_power_model(spec)
        self.battery = self.battery or next(iter(spec.batteries))
        on = self.on if self.on is not None else {name: float(c.units) for name, c in spec.components.items()}
        self._on = {f"on_{name}": float(count) for name, count in on.items()}
        self._loads = self._processor_parameters()

    def _processor_parameters(self) -> dict[str, float] | None:
        """Parameters of the component that runs under the law ``multicore_cpu``, if any."""
        for name, component in self.spec.components.items():
            for load in component.loads:
                if load.law is not None and getattr(load.law, "model", None) == "multicore_cpu":
                    given = {key: float(value) for key, value in load.law.parameters.items()}
                    defaults = {p.name: p.default for p in law_cpu.PARAMETERS}
                    own = {key.removeprefix(f"{self.battery}/{name}."): v for key, v in self.values.items()}
                    return {**defaults, **given, **{k: v for k, v in own.items() if k in defaults}}
        return None

    def power(
        self, speed_m_s: ArrayLike, freq_hz: ArrayLike | None = None, complexity: ArrayLike = 1.0,
        slope_rad: ArrayLike = 0.0, payload_kg: ArrayLike = 0.0, accel_m_s2: ArrayLike = 0.0, **more: Any,
    ) -> Array:
        """Power of the battery (W) for settings that broadcast; more covariates by their glossary names."""
        cov: dict[str, Any] = {
            "speed_m_s": f64(speed_m_s), "accel_m_s2": f64(accel_m_s2), "slope_rad": f64(slope_rad),
            "payload_kg": f64(payload_kg), "complexity": f64(complexity), "yaw_rate_rad_s": 0.0, "scheme": "",
            **self._on, **more,
        }
        if freq_hz is not None:
            cov["cpu_freq_hz"] = f64(freq_hz)
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
        step_s : float
        freq_hz : array_like, optional
            Broadcasts against `speeds_m_s`.
        **covariates
            ``complexity``, ``slope_rad``, ``payload_kg``…

        Returns
        -------
        ndarray, shape (candidates,)
        """
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
        return f64(law_cpu.loop_time(cov, self._cpu()))

    def throughput(self, speed_m_s: ArrayLike, freq_hz: ArrayLike, complexity: ArrayLike = 1.0) -> Array:
        """Batches processed per second."""
        return processor.throughput(
            self.loop_time(speed_m_s, freq_hz, complexity), batch_rate_hz=self._cpu()["batch_rate"]
        )

    @property
    def batch_rate(self) -> float:
        """Batches that come per second."""
        return self._cpu()["batch_rate"]

    def meets_service(self, speed_m_s: ArrayLike, freq_hz: ArrayLike, complexity: ArrayLike = 1.0) -> NDArray[np.bool_]:
        """Whether every batch is processed before the next comes (to 1e-9)."""
        return np.asarray(
            self.loop_time(speed_m_s, freq_hz, complexity) * self._cpu()["batch_rate"] <= 1.0 + 1e-9, dtype=bool
        )

    def _cpu(self) -> dict[str, float]:
        if self._loads is None:
            raise InputError.single(
                f"robot '{self.spec.name}' has no computer whose load follows its speed",
                allowed="a component with law: {model: multicore_cpu}",
            )
        return self._loads

    def clocks(self, step_hz: float = TX2_STEP_HZ) -> Array:
        """Clocks from the lowest to the highest in steps, Hz; the highest is always among them."""
        cpu = self._cpu()
        grid = np.arange(cpu["high_freq"], cpu["low_freq"] - 1.0, -step_hz)
        return f64(grid[::-1])

    def energy_per_metre(self, speeds_m_s: ArrayLike, freq_hz: ArrayLike, complexity: ArrayLike = 1.0) -> Array:
        """Eq. 7 of the rover paper, J/m."""
        return processor.energy_per_metre(self.power(speeds_m_s, freq_hz, complexity), speeds_m_s)

    def best(
        self, speeds_m_s: ArrayLike, clocks_hz: ArrayLike, complexity: float = 1.0, *, service: bool = True
    ) -> Optimum:
        """Speed and clock of least energy per metre on a grid, keeping the quality of service if asked."""
        speed, clock = np.meshgrid(f64(speeds_m_s), f64(clocks_hz), indexing="ij")
        energy = self.energy_per_metre(speed, clock, complexity)
        allowed = self.meets_service(speed, clock, complexity) if service else np.ones(speed.shape, dtype=bool)
        if not allowed.any():
            at = int(np.argmax(self.throughput(speed, clock, complexity)))
            return Optimum(float(speed.flat[at]), float(clock.flat[at]), float(energy.flat[at]), False, energy.size)
        at = int(np.argmin(np.where(allowed, energy, np.inf)))
        return Optimum(float(speed.flat[at]), float(clock.flat[at]), float(energy.flat[at]), True, energy.size)


@dataclass(frozen=True)
class Fidelity:
    """Granularity of speed and clock."""

    name: str
    speed_step_m_s: float
    clock_step_hz: float


LEVELS: tuple[Fidelity, ...] = (
    Fidelity("coarse", 3.0, 6 * TX2_STEP_HZ),
    Fidelity("low", 1.5, 4 * TX2_STEP_HZ),
    Fidelity("medium", 0.75, 2 * TX2_STEP_HZ),
    Fidelity("high", 0.25, TX2_STEP_HZ),
    Fidelity("finest", 0.05, TX2_STEP_HZ),
    Fidelity("reference", 0.005, TX2_STEP_HZ),
)
"""From coarse to fine; the last one is what the others are measured against."""


@dataclass(frozen=True)
class Measured:
    """What one level costs and what it is worth.

    Attributes
    ----------
    level : Fidelity
    evaluations : int
        Grid points.
    seconds : float
        Time to build its table (best of several).
    mean_error_pct, max_error_pct : float
        Of energies per metre interpolated on its grid, against the direct evaluation, over test settings.
    optimum : Optimum
    regret_pct : float
        How much more than the finest level's optimum its setting takes.
    """

    level: Fidelity
    evaluations: int
    seconds: float
    mean_error_pct: float
    max_error_pct: float
    optimum: Optimum
    regret_pct: float


class FidelityModel:
    """Energy per metre at a fidelity: a table on a grid of speed and clock, and bilinear interpolation between.

    Parameters
    ----------
    predictor : PowerPredictor
    speeds_m_s : tuple of float
        Lowest and highest speed.
    complexity : float
    """

    def __init__(self, predictor: PowerPredictor, speeds_m_s: tuple[float, float], complexity: float = 1.0) -> None:
        self.predictor, self.range_m_s, self.complexity = predictor, speeds_m_s, complexity
        self.tables: dict[str, tuple[Array, Array, Array]] = {}

    def grid(self, level: Fidelity) -> tuple[Array, Array]:
        """Speeds and clocks of a level; both ends are always in."""
        low, high = self.range_m_s
        count = max(2, round((high - low) / level.speed_step_m_s) + 1)
        clocks = self.predictor.clocks()
        stride = max(1, round(level.clock_step_hz / TX2_STEP_HZ))
        picked = clocks[::-1][::stride][::-1]
        if picked[0] != clocks[0]:
            picked = np.concatenate([clocks[:1], picked])
        return np.linspace(low, high, count), picked

    def table(self, level: Fidelity) -> tuple[Array, Array, Array]:
        """Speeds, clocks and energies per metre, computed once per level."""
        if level.name not in self.tables:
            speeds, clocks = self.grid(level)
            energy = self.predictor.energy_per_metre(speeds[:, None], clocks[None, :], self.complexity)
            self.tables[level.name] = (speeds, clocks, energy)
        return self.tables[level.name]

    def energy(self, level: Fidelity, speed_m_s: ArrayLike, freq_hz: ArrayLike) -> Array:
        """Energy per metre interpolated in a level's table, J/m."""
        speeds, clocks, table = self.table(level)
        speed, clock = np.broadcast_arrays(f64(speed_m_s), f64(freq_hz))
        i = np.clip(np.searchsorted(speeds, speed) - 1, 0, len(speeds) - 2)
        j = np.clip(np.searchsorted(clocks, clock) - 1, 0, max(len(clocks) - 2, 0))
        x = (speed - speeds[i]) / (speeds[i + 1] - speeds[i])
        y = (clock - clocks[j]) / (clocks[j + 1] - clocks[j])
        near = table[i, j] * (1 - x) + table[i + 1, j] * x
        far = table[i, j + 1] * (1 - x) + table[i + 1, j + 1] * x
        return f64(near * (1 - y) + far * y)

    def optimum(self, level: Fidelity) -> Optimum:
        """Best setting on a level's grid that keeps the quality of service."""
        speeds, clocks = self.grid(level)
        return self.predictor.best(speeds, clocks, self.complexity)

    def error_pct(self, level: Fidelity, samples: int = 400, seed: int = 0) -> tuple[float, float]:
        """Mean and greatest interpolation error (%) over random settings."""
        rng = np.random.default_rng(seed)
        speed = rng.uniform(*self.range_m_s, samples)
        clocks = self.predictor.clocks()
        clock = rng.choice(clocks, samples)
        exact = self.predictor.energy_per_metre(speed, clock, self.complexity)
        miss = 100.0 * np.abs(self.energy(level, speed, clock) / exact - 1.0)
        return float(np.mean(miss)), float(np.max(miss))

    def measure(self, levels: Sequence[Fidelity] = LEVELS, repeats: int = 5) -> list[Measured]:
        """Error and computing time of each level, measured on this machine."""
        best = self.optimum(levels[-1])
        result = []
        for level in levels:
            seconds = min(self.build_time(level) for _ in range(repeats))
            mean, most = self.error_pct(level)
            found = self.optimum(level)
            result.append(Measured(level, self.table(level)[2].size, seconds, mean, most, found,
                                   100.0 * (found.energy_j_m / best.energy_j_m - 1.0)))
        return result

    def build_time(self, level: Fidelity) -> float:
        """Seconds that building a level's table takes now."""
        self.tables.pop(level.name, None)
        start = time.perf_counter()
        self.table(level)
        return time.perf_counter() - start


class AutoFidelity:
    """Chooses the level before each prediction: the coarsest that keeps the promised error, within the time budget.

    A prediction in a new environment costs a new table. Its time is measured on every use, so that the level changes
    while a mission runs when the computer gets slower, the environment changes or the promise does.

    Parameters
    ----------
    predictor : PowerPredictor
    speeds_m_s : tuple of float
        Lowest and highest speed.
    error_pct : float
        Promised mean error.
    budget_s : float
        Time that one prediction may take.
    levels : sequence of Fidelity
        From coarse to fine.
    """

    def __init__(
        self, predictor: PowerPredictor, speeds_m_s: tuple[float, float], error_pct: float, budget_s: float,
        levels: Sequence[Fidelity] = LEVELS,
    ) -> None:
        self.predictor, self.range_m_s, self.levels = predictor, speeds_m_s, tuple(levels)
        self.error_pct, self.budget_s = error_pct, budget_s
        self._models: dict[float, FidelityModel] = {}
        self._errors: dict[tuple[float, str], float] = {}
        start = FidelityModel(predictor, speeds_m_s)
        self._seconds = {level.name: min(start.build_time(level) for _ in range(2)) for level in self.levels}

    def error_of(self, level: Fidelity, complexity: float = 1.0) -> float:
        """Mean error (%) of a level in an environment, measured once."""
        key = (complexity, level.name)
        if key not in self._errors:
            self._errors[key] = FidelityModel(self.predictor, self.range_m_s, complexity).error_pct(level)[0]
        return self._errors[key]

    def choose(self, complexity: float = 1.0) -> tuple[Fidelity, bool]:
        """The level, and whether it keeps the promise; if none does within the budget, the finest that fits in it."""
        fits = [level for level in self.levels if self._seconds[level.name] <= self.budget_s]
        for level in fits:
            if self.error_of(level, complexity) <= self.error_pct:
                return level, True
        return (fits[-1] if fits else self.levels[0]), False

    def predict(
        self, speed_m_s: ArrayLike, freq_hz: ArrayLike, complexity: float = 1.0
    ) -> tuple[Array, Fidelity, bool]:
        """Energy per metre (J/m) at the level chosen now, the level, and whether it keeps the promise."""
        level, kept = self.choose(complexity)
        start = time.perf_counter()
        model = self._models.setdefault(complexity, FidelityModel(self.predictor, self.range_m_s, complexity))
        fresh = level.name not in model.tables
        energy = model.energy(level, speed_m_s, freq_hz)
        if fresh:
            self.observe(level, time.perf_counter() - start)
        return energy, level, kept

    def observe(self, level: Fidelity, seconds: float) -> None:
        """Take note of a time that a level took (exponential average)."""
        self._seconds[level.name] += 0.3 * (seconds - self._seconds[level.name])

"""Fidelity levels: how fine speed and clock are resolved, what that costs in time and gains in error, and ``auto``.

After the rover paper ("Simulation of Mechanical and Computational Power Consumption in Mobile Robots"), "Multi-Fidelity
Energy Estimation" and Fig. 4: a finer grid of speeds and clocks is more exact and takes longer. Here a table is one
evaluation of arrays with a fixed cost, so that time grows much more slowly than the number of points: below a thousand
points it hardly differs between levels. `FidelityModel.measure` tells what a machine really needs.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from missionsim.control import TX2_STEP_HZ, Optimum, PowerPredictor
from missionsim.physics import Array, f64


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
    """What one level costs and what it is worth."""

    level: Fidelity
    evaluations: int
    """Grid points."""
    seconds: float
    """Time to build its table (best of several)."""
    mean_error_pct: float
    max_error_pct: float
    """Both: of energies per metre interpolated on its grid, against the direct evaluation, over test settings."""
    optimum: Optimum
    regret_pct: float
    """How much more than the finest level's optimum its setting takes."""


class FidelityModel:
    """Energy per metre at a fidelity: a table on a grid of speed and clock, and bilinear interpolation between.

    Parameters
    ----------
    speeds_m_s : tuple of float
        Lowest and highest speed.
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
        from scipy.interpolate import RegularGridInterpolator

        speeds, clocks, table = self.table(level)
        between = RegularGridInterpolator((speeds, clocks), table, bounds_error=False, fill_value=None)
        return f64(between(np.stack(np.broadcast_arrays(f64(speed_m_s), f64(freq_hz)), axis=-1)))

    def optimum(self, level: Fidelity) -> Optimum:
        """Best setting on a level's grid that keeps the quality of service."""
        speeds, clocks = self.grid(level)
        return self.predictor.best(speeds, clocks, self.complexity)

    def error_pct(self, level: Fidelity, samples: int = 400, seed: int = 0) -> tuple[float, float]:
        """Mean and greatest interpolation error (%) over random settings."""
        rng = np.random.default_rng(seed)
        speed = rng.uniform(*self.range_m_s, samples)
        clock = rng.choice(self.predictor.clocks(), samples)
        exact = self.predictor.energy_per_metre(speed, clock, self.complexity)
        miss = 100.0 * np.abs(self.energy(level, speed, clock) / exact - 1.0)
        return float(np.mean(miss)), float(np.max(miss))

    def measure(self, levels: Sequence[Fidelity] = LEVELS, repeats: int = 5) -> list[Measured]:
        """Error and computing time of each level, measured on this machine."""
        best = self.optimum(levels[-1])
        result = []
        for level in levels:
            seconds = min(self.build_time(level) for _ in range(repeats))
            found, points = self.optimum(level), self.table(level)[2].size
            regret = 100.0 * (found.energy_j_m / best.energy_j_m - 1.0)
            result.append(Measured(level, points, seconds, *self.error_pct(level), found, regret))
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
        self,
        predictor: PowerPredictor,
        speeds_m_s: tuple[float, float],
        error_pct: float,
        budget_s: float,
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

"""Small logs and models whose answers are known without the product."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects import base_terms
from missionsim.effects.model import ModelParameter, PowerModel, Term, TermKey
from missionsim.effects.named_models import get_motion_model
from missionsim.labels import Labels
from missionsim.logs import LogTable, row_durations


def friction_model(c2: float = 6.25, c3: float = 9.79, moving: float = 3.66, standing: float = 2.67) -> PowerModel:
    """The Pioneer's motion and controller and one camera, made by hand."""

    def one(component: str, name: str, effect: Any, values: dict[str, float]) -> Term:
        return Term(TermKey("robot", component, name), effect, {k: ModelParameter(v) for k, v in values.items()})

    numbers = {"c2": c2, "c3": c3, "c4": moving, "standing": standing}
    terms = get_motion_model("polynomial").build("robot", {name: ModelParameter(v) for name, v in numbers.items()})
    return PowerModel(
        (*terms, one("kinect", "kinect", base_terms.component_term("kinect"), {"power": 2.82})),
        ("robot",),
        {"body_mass_kg": 25.0, "regeneration": 0.0},
    )


def drive(rows: int = 600, seed: int = 0, step_s: float = 0.5) -> dict[str, Any]:
    """Columns of a drive with stops, turns, slopes, two surfaces and a camera that is switched."""
    rng = np.random.default_rng(seed)
    time_s = (np.arange(rows) + 0.5) * step_s
    block = (np.arange(rows) // 40).astype(int)
    speed = np.where(block % 4 == 3, 0.0, np.round(rng.uniform(0.2, 0.7, block[-1] + 1)[block], 3))
    return {
        "time_s": time_s,
        "speed_m_s": speed,
        "yaw_rate_rad_s": np.where((block % 3 == 1) & (speed > 0), 0.4, 0.0),
        "slope_rad": np.where(block % 5 == 2, 0.05, 0.0),
        "surface": Labels.of(np.where(block % 2 == 0, "tile", "carpet")),
        "on_kinect": (block % 6 < 3).astype(float),
        "x_m": np.cumsum(speed) * step_s,
        "y_m": np.zeros(rows),
    }


def true_power(columns: dict[str, Any], c2: float = 6.25, c3: float = 9.79) -> NDArray[np.float64]:
    """The same physics written out again, without the product's terms."""
    v = np.asarray(columns["speed_m_s"])
    moving = (np.abs(v) >= 0.005) | (np.abs(columns["yaw_rate_rad_s"]) >= 0.02)
    return c2 * v**2 + c3 * v + np.where(moving, 3.66, 2.67) + 2.82 * columns["on_kinect"]


def log_of(columns: dict[str, Any], power_w: NDArray[np.float64], run: str = "run", fresh: Any = None) -> LogTable:
    """A log table in memory."""
    data = {**columns, "power_robot_w": np.asarray(power_w, dtype=float)}
    arrays = {k: v if isinstance(v, Labels) else np.array(v, dtype=float) for k, v in data.items()}
    return LogTable(
        run,
        arrays,
        row_durations(np.asarray(columns["time_s"], dtype=float)),
        {"robot": np.array(power_w, dtype=float)},
        {"robot": fresh},
        {"robot": "power"},
    )


def cut(log: LogTable, size: int) -> list[LogTable]:
    """The same log in pieces of `size` rows, each keeping the time its rows stand for."""
    return [log.rows_where(slice(i, i + size)) for i in range(0, len(log), size)]

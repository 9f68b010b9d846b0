"""Logs made in the tests: a robot whose power follows its motion exactly."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest

from missionsim.errors import InputError


def motion(n: int = 400, step_s: float = 0.5, seed: int = 0) -> dict[str, np.ndarray]:
    """Columns of a healthy run: time, speed with stops, yaw rate, and the power that they cause, with noise."""
    rng = np.random.default_rng(seed)
    time = step_s * (np.arange(n) + 0.5)
    speed = np.clip(0.5 + 0.4 * np.sin(time / 7.0) + 0.2 * np.sin(time / 2.3), 0.0, None) + 0.01 * rng.normal(size=n)
    yaw = np.where(np.sin(time / 11.0) > 0.6, 0.5, 0.0) + 0.01 * rng.normal(size=n)
    power = 6.0 * speed**2 + 10.0 * np.abs(speed) + 4.0 + 2.0 * np.abs(yaw) + 0.05 * rng.normal(size=n)
    return {"time_s": time, "power_robot_w": power, "speed_m_s": speed, "yaw_rate_rad_s": yaw}


def write_csv(path: Path, columns: Mapping[str, object], delimiter: str = ",", decimal: str = ".") -> Path:
    """Columns as CSV; floats with nine digits, NaN as nothing."""
    lists = [list(column) for column in columns.values()]  # type: ignore[call-overload]

    def cell(value: object) -> str:
        if isinstance(value, (float, np.floating)):
            return "" if np.isnan(value) else f"{value:.9g}".replace(".", decimal)
        return str(value)

    lines = [delimiter.join(columns), *(delimiter.join(map(cell, row)) for row in zip(*lists, strict=True))]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


@pytest.fixture
def faults_of() -> Callable[..., InputError]:
    """Calls a function that has to raise InputError and gives the error."""

    def call(function: Callable[..., object], *args: object, **kwargs: object) -> InputError:
        with pytest.raises(InputError) as caught:
            function(*args, **kwargs)
        return caught.value

    return call

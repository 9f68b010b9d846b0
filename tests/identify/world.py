"""A tiny robot with known truth for the tests of the identification; arrays only, no files."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from missionsim.identify.averaging import Intervals, RunColumns, integral_curves
from missionsim.identify.data import Candidate, RunData

Array = NDArray[np.float64]
BASE = {"c2": 6.0, "c3": 10.0, "c4": 3.5, "standing": 2.7, "camera.power": 2.8}
TAUS = (40.0, 90.0, 180.0)


def _speeds(rng: np.random.Generator, n: int) -> tuple[Array, Array]:
    speed, turn = np.zeros(n), np.zeros(n)
    i = 0
    while i < n:
        length = int(rng.integers(12, 45))
        kind = rng.random()
        if kind < 0.7:
            speed[i : i + length] = rng.uniform(0.25, 0.75)
        elif kind < 0.85:
            turn[i : i + length // 2] = rng.uniform(0.4, 1.1) * rng.choice([-1, 1])
        i += length
    kernel = np.full(3, 1 / 3)
    return np.convolve(speed, kernel, mode="same"), np.convolve(turn, kernel, mode="same")


def make_run(
    rng: np.random.Generator,
    name: str,
    hidden: dict[str, float],
    *,
    n: int = 420,
    delay_s: float = 0.0,
    payload_only_on_carpet: bool = False,
    base_error: dict[str, float] | None = None,
    periodic_w: float = 0.0,
    dead_zone_w: float = 0.0,
    noise: float = 0.02,
) -> RunData:
    """One run at 1 Hz whose power has the hidden coefficients, meter errors, AR(1) noise and a late clock."""
    fine = 4
    speed, turn = _speeds(rng, n)
    speed, turn = np.repeat(speed, fine), np.repeat(turn, fine)
    half = rng.random() < 0.5
    payload = np.full(n * fine, 4.0 if half else 0.0)
    carpet = np.repeat(rng.random(n // 60 + 1) < 0.5, 60 * fine)[: n * fine].astype(float)
    if payload_only_on_carpet:
        carpet = (payload > 0).astype(float)
    slope = np.repeat(rng.choice([-0.05, 0.0, 0.0, 0.06], n // 30 + 1), 30 * fine)[: n * fine]
    camera = np.repeat(rng.random(n // 70 + 1) < 0.6, 70 * fine)[: n * fine].astype(float)
    time_fine = np.arange(n * fine) / fine
    moving = (np.abs(speed) > 0.005) | (np.abs(turn) > 0.02)
    moved = np.cumsum(moving) / fine
    terms = {
        "c2": BASE["c2"] * speed**2 * moving,
        "c3": BASE["c3"] * speed * moving,
        "c4": BASE["c4"] * moving,
        "standing": BASE["standing"] * ~moving,
        "camera.power": BASE["camera.power"] * camera,
    }
    columns = {
        "grade": 20 * 9.81 * speed * np.sin(slope),
        "payload": payload * speed,
        "turning_scrub": np.abs(turn),
        "surface|carpet": speed * carpet,
        "rolling_friction": speed,
        "aerodynamic_drag": speed**3,
        "standby_load": np.ones_like(speed),
        "component_power:camera": camera,
    }
    columns |= {f"cold|{tau:g}": speed * np.exp(-moved / tau) for tau in TAUS}
    error = base_error or {}
    power = sum((1 + error.get(k, 0.0)) * v for k, v in terms.items())
    truth = dict(columns) | {"cold": speed * np.exp(-moved / 70.0)}
    power = power + sum((k * truth[c] for c, k in hidden.items()), start=np.zeros_like(speed))
    power = power + periodic_w * ((time_fine + rng.uniform(0, 60)) % 60 < 30)
    power = power + dead_zone_w * np.maximum(np.abs(turn) - 0.6, 0.0)
    shift = round(delay_s * fine)
    power = np.roll(power, shift)
    power[: max(shift, 0)] = power[max(shift, 0)]

    def coarse(x: Array) -> Array:
        return np.asarray(x.reshape(n, fine).mean(axis=1))

    measured = coarse(power) * (1 + 0.005 * rng.standard_normal()) + 0.05 * rng.standard_normal()
    e = np.empty(n)
    e[0] = rng.standard_normal()
    for i in range(1, n):
        e[i] = 0.8 * e[i - 1] + 0.6 * rng.standard_normal()
    measured = measured + noise * measured.mean() * e
    covariates = {
        "speed_m_s": coarse(speed),
        "yaw_rate_rad_s": coarse(turn),
        "payload_kg": coarse(payload),
        "slope_rad": coarse(slope),
        "time_s": np.arange(n) + 0.5,
        "carpet": coarse(carpet),
    }
    gradient = {k: coarse(v) for k, v in terms.items()}
    return RunData(
        name,
        np.arange(n) + 0.5,
        np.ones(n),
        measured,
        np.sum(list(gradient.values()), axis=0),
        gradient,
        {k: coarse(v) for k, v in columns.items()},
        covariates,
    )


def make_runs(seed: int, hidden: dict[str, float] | None = None, count: int = 6, **options: object) -> list[RunData]:
    """Several runs; base parameters 2 % off, the same in all runs."""
    rng = np.random.default_rng(seed)
    error = {k: 0.02 * rng.standard_normal() for k in BASE}
    options.setdefault("base_error", error)
    return [make_run(rng, f"run_{j}", hidden or {}, **options) for j in range(count)]  # type: ignore[arg-type]


def library() -> list[Candidate]:
    """Candidates of this robot."""
    return [
        Candidate("grade", ("grade",), covariate="slope_rad"),
        Candidate("payload", ("payload",), covariate="payload_kg"),
        Candidate("turning_scrub", ("turning_scrub",), covariate="yaw_rate_rad_s"),
        Candidate("surface_rolling_resistance", ("surface|carpet",), covariate="carpet", levels=("carpet",), unit="N"),
        Candidate("rolling_friction", ("rolling_friction",), sign=0, prior="c3", covariate="speed_m_s"),
        Candidate("aerodynamic_drag", ("aerodynamic_drag",), covariate="speed_m_s"),
        Candidate("standby_load", ("standby_load",), sign=0, prior="c4"),
        Candidate("component_power:camera", ("component_power:camera",), sign=0, prior="camera.power"),
        Candidate(
            "cold_friction",
            tuple(f"cold|{t:g}" for t in TAUS),
            shape=tuple({"tau_s": t} for t in TAUS),
            covariate="time_s",
            shape_bounds={"tau_s": (20.0, 400.0)},
        ),
    ]


def coefficient(runs: Sequence[RunData], column: str, share: float) -> float:
    """Coefficient for which a column makes a share of the base energy."""
    power = np.mean([r.base_w.mean() for r in runs])
    return float(share * power / np.mean([np.abs(r.columns[column]).mean() for r in runs]))


def with_gap(run: RunData, first: int, last: int) -> RunData:
    """The run without some rows."""
    keep = np.ones(len(run.time_s), dtype=bool)
    keep[first:last] = False

    def cut(group: dict[str, Array]) -> dict[str, Array]:
        return {k: v[keep] for k, v in group.items()}

    return replace(
        run,
        time_s=run.time_s[keep],
        dt_s=run.dt_s[keep],
        measured_w=run.measured_w[keep],
        base_w=run.base_w[keep],
        gradient=cut(dict(run.gradient)),
        columns=cut(dict(run.columns)),
        covariates=cut(dict(run.covariates)),
    )


def averaged(run: RunColumns, delay_s: float, lag_s: float) -> Array:
    """Mean of columns over every bin of one run, shape (columns, bins), as a late and sluggish meter would see it."""
    intervals = Intervals.of([run])
    return intervals.means(integral_curves([run.values], [run.rows]), intervals.weights(np.array([delay_s]), lag_s)).T

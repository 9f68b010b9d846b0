"""Motion of a run or a plan: distance, time driven, turned and stood, by control scheme; a plan against its runs."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from missionsim.effects.covariates import Columns, Covariates, is_moving
from missionsim.effects.timeline import Timeline
from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S
from missionsim.labels import Labels
from missionsim.physics import Array, Int64s

Still = tuple[float, float]
"""Speed [m/s] and yaw rate [rad/s] below which a robot stands."""
STILL: Still = (STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S)
SLOWEST_SHARE = 0.1
"""A noisy log of a known plan stands still below this part of the slowest speed that the plan drives (assumed)."""
ACCELERATING_M_S2 = 0.05
"""Rate of the speed from which the robot counts as speeding up or slowing down."""
MOTIONS = ("standing", "driving straight", "turning on the spot", "driving a curve", "speeding up", "slowing down")


@dataclass
class Motion:
    """Way and times of one control scheme, in a plan or in one run or several."""

    distance_m: float = 0.0
    driving_s: float = 0.0
    turning_s: float = 0.0
    standing_s: float = 0.0
    """These: way and time with speed, time turning on the spot, time at rest."""
    square_m2_s: float = 0.0
    """Integral of the squared speed."""
    energy_j: dict[str, float] = field(default_factory=dict)
    """Of the model driven by the run, or of the meter, as the caller sums it. Dict of battery to float."""

    @property
    def seconds(self) -> float:
        """Time in all [s]."""
        return self.driving_s + self.turning_s + self.standing_s

    @property
    def speed_m_s(self) -> float:
        """Mean speed over the way, so that ramps from and to rest hardly count; NaN where nothing was driven."""
        return self.square_m2_s / self.distance_m if self.distance_m > 0.0 else float("nan")

    def add(self, other: Motion) -> None:
        """Add the sums of another stretch."""
        for name in ("distance_m", "driving_s", "turning_s", "standing_s", "square_m2_s"):
            setattr(self, name, getattr(self, name) + getattr(other, name))
        for battery, joules in other.energy_j.items():
            self.energy_j[battery] = self.energy_j.get(battery, 0.0) + joules


def speed_of(cov: Covariates) -> Array:
    """Speed over the ground, sideways motion included [m/s]."""
    ahead = np.abs(np.asarray(cov["speed_m_s"], dtype=float))
    return np.asarray(np.hypot(ahead, cov["lateral_speed_m_s"])) if "lateral_speed_m_s" in cov else ahead


def middle_of(line: Timeline) -> Columns:
    """Covariates of a plan in the middle of each interval; their means where they are linear in time."""
    half = 0.5 * np.asarray(line.duration_s, dtype=float)
    return {name: c + line.rates[name] * half if name in line.rates else c for name, c in line.columns.items()}


def scheme_codes(columns: Covariates, count: int, *, ignore: bool) -> tuple[Int64s, list[str]]:
    """Scheme of each row as a code, and the names; one nameless scheme with `ignore` or where none is logged."""
    scheme = columns.get("scheme")
    if ignore or scheme is None:
        return np.zeros(count, dtype=np.int64), [""]
    labels = scheme if isinstance(scheme, Labels) else Labels.of(np.broadcast_to(scheme, count))
    names = list(labels.names)
    if "" in names:
        return labels.codes, names
    return np.where(labels.codes < 0, len(names), labels.codes), [*names, ""]


def motions(
    cov: Covariates, seconds: Array, power_w: Mapping[str, Array], still: Still = STILL, *, by_scheme: bool = True
) -> dict[str, Motion]:
    """Sums of each control scheme over rows, by its name.

    `cov`: with ``speed_m_s``; arrays of shape (n,). `seconds` (shape (n,)): time that each row stands for. `power_w`
    (shape (n,)): power whose energy is summed; gaps count as nought. `by_scheme`: whether schemes are told apart; else
    all rows are summed under ``""``.
    """
    count = len(seconds)
    zero = np.zeros(count)
    speed = speed_of({"speed_m_s": zero, **cov})
    driving = speed >= still[0]
    standing = ~driving & (np.abs(cov.get("yaw_rate_rad_s", zero)) < still[1])
    codes, names = scheme_codes(cov, count, ignore=not by_scheme)
    found = {}
    for code, name in enumerate(names):
        rows = codes == code
        if not rows.any():
            continue
        own = np.where(rows, seconds, 0.0)
        drive = np.where(driving, own, 0.0)
        found[name] = Motion(
            dot(speed, drive),
            float(drive.sum()),
            float(own[~driving & ~standing].sum()),
            float(own[standing].sum()),
            dot(speed**2, drive),
            {battery: dot(np.nan_to_num(power), own) for battery, power in power_w.items()},
        )
    return found


def planned(line: Timeline, *, by_scheme: bool = True) -> dict[str, Motion]:
    """Sums of each control scheme over a plan; it stands where nothing moves at all."""
    tiny = (1e-12, 1e-12)
    return motions(middle_of(line), np.asarray(line.duration_s, dtype=float), {}, tiny, by_scheme=by_scheme)


def still_of(line: Timeline | None) -> Still:
    """The threshold of standing in the runs of a plan; the contract's where none is known or that is higher."""
    if line is None:
        return STILL
    found = []
    middle = middle_of(line)
    for name, floor in zip(("speed_m_s", "yaw_rate_rad_s"), STILL, strict=True):
        level = np.abs(np.asarray(middle.get(name, np.zeros(len(line))), dtype=float))
        steady = level[(level > 0.0) & (np.asarray(line.rates.get(name, np.zeros(len(line)))) == 0.0)]
        found.append(max(floor, SLOWEST_SHARE * float(steady.min())) if len(steady) else floor)
    return found[0], found[1]


def told_apart(plan: Mapping[str, Motion], runs: Iterable[Mapping[str, Motion]]) -> bool:
    """Whether plan and runs can be compared scheme by scheme: the runs name every scheme that the plan drives."""
    known = {name for name, motion in plan.items() if motion.distance_m > 0.0}
    return len(known) > 1 and all(known <= set(run) for run in runs)


def stretch(plan: Motion, runs: Sequence[Motion]) -> Array:
    """Way driven over way planned, of each run that drives, shape (runs,)."""
    return np.array([run.distance_m / plan.distance_m for run in runs if run.distance_m > 0.0])


def tracking(plan: Motion, runs: Sequence[Motion]) -> Array:
    """Speed reached over speed planned, both means over the way, of each run that drives, shape (runs,)."""
    return np.array([run.speed_m_s / plan.speed_m_s for run in runs if run.distance_m > 0.0])


def mean_ratio(ratios: Array) -> float | None:
    """Mean of ratios on a log scale, on which half and double are equally far; None without any."""
    known = ratios[np.isfinite(ratios) & (ratios > 0.0)]
    return float(np.exp(np.mean(np.log(known)))) if len(known) else None


def kinds_of_motion(cov: Covariates) -> Int64s:
    """Index into `MOTIONS` of each row, shape (n,)."""
    speed = np.abs(cov["speed_m_s"])
    moving = np.asarray(is_moving(cov))
    turning = np.abs(cov.get("yaw_rate_rad_s", np.zeros(len(speed)))) >= 2.0 * STILL_YAW_RATE_RAD_S
    kinds = moving * np.where(turning, 3, 1)
    kinds[turning & (speed < STILL_SPEED_M_S)] = 2
    rate = np.sign(cov["speed_m_s"]) * cov["accel_m_s2"]
    straight = kinds == 1
    kinds[straight & (rate > ACCELERATING_M_S2)] = 4
    kinds[straight & (rate < -ACCELERATING_M_S2)] = 5
    return np.asarray(kinds, dtype=np.int64)


def approach(target_m_s: Array, step_s: float, limit_m_s2: float) -> Array:
    """Speed that follows a target under a limit of acceleration, from rest, shape (n,) [m/s]."""
    speed = np.empty(len(target_m_s))
    now, step = 0.0, limit_m_s2 * step_s
    for i, wanted in enumerate(target_m_s):
        now = min(max(wanted, now - step), now + step)
        speed[i] = now
    return speed


def dot(a: Array, b: Array) -> float:
    """Sum of products; not BLAS, whose threads cost more than these short products and round by their number."""
    return float(np.einsum("i,i->", a, b))

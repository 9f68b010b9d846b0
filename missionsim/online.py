"""On-line prediction while a mission runs: energy left, energy to finish, energy to come home, and when to turn round.

After Parasuraman et al. 2012 (Eqs. 11–13, 17, and their 10 % margin). The plan is simulated once before the start; each
sample of the running log then moves the robot along its plan and adds to the energy drawn. The ratio of drawn to
expected energy corrects what is still to come, weighed by what the models and the meter are known for. What the plan
lets one expect comes first: energy interval by interval, and the way home from each moment.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from missionsim.effects.timeline import integrate
from missionsim.engine.simulate import simulate
from missionsim.errors import InputError
from missionsim.glossary import STILL_SPEED_M_S
from missionsim.inputs.mission import MissionSpec, reserve_of
from missionsim.inputs.power import build_power_model
from missionsim.physics import Array


@dataclass(frozen=True)
class ExpectedRun:
    """What one battery should see: one row per interval of the plan."""

    duration_s: Array
    distance_m: Array
    energy_j: Array
    """All three: length, way driven and energy of each interval; a distance of 0 is standing or turning. Shape (n,)."""
    return_j: Array
    """Energy home from the start of each interval, and from the end of the last. Shape (n + 1,)."""

    def __post_init__(self) -> None:
        n = len(self.duration_s)
        if not (len(self.distance_m) == len(self.energy_j) == n and len(self.return_j) == n + 1 and n > 0):
            raise ValueError("an expected run needs n ≥ 1 durations, distances and energies, and n + 1 ways home")


def expected_run(mission: MissionSpec, battery: str) -> ExpectedRun:
    """Simulate a mission and give what one battery should see, with the way home from each moment.

    With an environment the way home is the shortest to the dock, as the engine finds it at the end of each segment,
    straight between. Without one it is back over the way driven, slopes reversed.

    Missions that recharge are refused: whether to go on is decided anew at each dock, by the charge that the charger
    really gave, so each stretch from dock to dock is a mission of its own. Raises InputError: for an unknown battery,
    and for missions that recharge on the way.
    """
    if battery not in mission.robot.batteries:
        raise InputError.unknown(f"no battery '{battery}'", battery, mission.robot.batteries)
    capacity = mission.robot.batteries[battery].capacity
    # the whole plan is wanted, also of a mission that the real battery cannot finish
    result = simulate(mission, values={f"robot.{capacity.path}": capacity.value * 1e6})
    if any(segment.kind == "dock" for segment in result.segments):
        got, allowed = result.mission, "a mission for each stretch from dock to dock, with its own initial_charge"
        raise InputError.single("on-line prediction covers missions without recharging", got=got, allowed=allowed)
    line = result.timeline
    energy = np.asarray(np.sum(list(result.energies[battery].values()), axis=0), dtype=float)
    distance = line.ways_m()
    homes = result.home_energy()
    if all(home.get(battery) is not None for home in homes):
        # straight lines between the ends of segments
        ends_s = [result.segment_end_s[index] for index in range(len(result.segments))]
        values = [3600.0 * float(home[battery] or 0.0) for home in homes]
        chargers = mission.environment.chargers if mission.environment is not None else []
        dock, start = mission.policy.dock, mission.start
        at_dock = start == dock if dock else not chargers or start in chargers
        first = 0.0 if at_dock else values[0]
        home_j = np.interp(np.append(line.start_s, ends_s[-1]), [0.0, *ends_s], [first, *values])
    else:
        # back over what has been driven, with the same settings and the slopes reversed
        columns = {**line.columns, "slope_rad": -np.asarray(line.columns["slope_rad"])}
        terms = integrate(build_power_model(mission.robot), replace(line, columns=columns))[battery]
        back = np.asarray(np.sum(list(terms.values()), axis=0), dtype=float)
        home_j = np.concatenate([[0.0], np.cumsum(np.where(distance > 0.0, back, 0.0))])
    return ExpectedRun(np.asarray(line.duration_s, dtype=float), distance, energy, home_j)


ARRIVED_SHARE, ARRIVED_M = 0.05, 0.05
"""A robot that stops with less than this of a drive before it has arrived."""


@dataclass(frozen=True)
class Forecast:
    """State of the prediction at one moment; energies in J with standard deviations."""

    time_s: float
    """Of the last sample."""
    progress: float
    """Share of the expected energy of the whole mission that lies behind, 0 to 1."""
    drawn_j: float
    left_j: float
    left_sd_j: float
    """All three: measured so far, and what is left in the battery (below zero when over-drawn)."""
    to_finish_j: float
    to_finish_sd_j: float
    """Both: still needed for the rest of the mission."""
    to_return_j: float
    to_return_sd_j: float
    """Both: needed to come home from here."""
    correction: float
    correction_sd: float
    """Both: factor learned from drawn over expected energy."""
    can_finish: bool
    """Whether mission and way home fit into what is left less the reserve, with the asked confidence."""
    turn_round: bool
    """Whether it is now or never: the mission cannot be finished and what is left only just brings the robot home."""
    turn_round_in_s: float | None
    """Expected time until then; None where the mission can be finished."""
    p_finish: float
    """Probability that mission and way home can be done without touching the reserve."""


class OnlinePredictor:
    """Follows a mission sample by sample.

    Parameters
    ----------
    expected : ExpectedRun
        Of the battery watched.
    available_j : float
        Energy in the battery at the start.
    reserve_j : float
        Not to be touched.
    model_sd, meter_sd, noise_sd : float
        Relative standard deviations: of the model's total (the paper's 4 %), of the meter (2 %) and of the power about
        its mean (4 %), the last over `correlation_s`.
    correlation_s : float
        Time over which deviations of the power persist.
    confidence : float
        Standard deviations by which a decision must be safe.
    """

    def __init__(
        self,
        expected: ExpectedRun,
        available_j: float,
        reserve_j: float = 0.0,
        *,
        model_sd: float = 0.04,
        meter_sd: float = 0.02,
        noise_sd: float = 0.04,
        correlation_s: float = 10.0,
        confidence: float = 2.0,
    ) -> None:
        self.expected = expected
        self.available_j, self.reserve_j = available_j, reserve_j
        self.model_sd, self.meter_sd, self.noise_sd = model_sd, meter_sd, noise_sd
        self.correlation_s, self.confidence = correlation_s, confidence
        self._durations = [float(v) for v in expected.duration_s]
        self._distances = [float(v) for v in expected.distance_m]
        self._behind = np.concatenate([[0.0], np.cumsum(expected.energy_j)])
        self._clock = np.concatenate([[0.0], np.cumsum(expected.duration_s)])
        self._index, self._share = 0, 0.0
        self._time: float | None = None
        self._power = self._speed = self._drawn = self._first = 0.0
        # of the drive without a stop that each interval belongs to: its length, what is left of it, and where it ends
        count, driven = len(self._durations), [*self._distances, 0.0]
        self._run_left, self._run_length, self._run_end = [0.0] * count, [0.0] * count, [count] * count
        for i in range(count - 1, -1, -1):
            if driven[i] > 0.0:
                inside = driven[i + 1] > 0.0
                self._run_left[i] = driven[i] + (self._run_left[i + 1] if inside else 0.0)
                self._run_end[i] = self._run_end[i + 1] if inside else i + 1
        for i in range(count):
            inside = i > 0 and driven[i] > 0.0 and driven[i - 1] > 0.0
            self._run_length[i] = self._run_length[i - 1] if inside else self._run_left[i]

    @classmethod
    def from_mission(cls, mission: MissionSpec, battery: str | None = None, **options: float) -> OnlinePredictor:
        """A predictor for one battery of a mission (see `expected_run`)."""
        name = battery or next(iter(mission.robot.batteries))
        expected = expected_run(mission, name)
        spec = mission.robot.batteries[name]
        available = spec.capacity_j * float(mission.initial_charge.get(name, spec.initial_charge))
        reserve = reserve_of(mission.policy.reserve, name) or spec.reserve
        return cls(expected, available, spec.capacity_j * float(reserve), **options)

    def update(self, time_s: float, power_w: float, speed_m_s: float = 0.0) -> None:
        """One sample: time from the start (s), power of the battery (W), speed (m/s, sideways speed included).

        A power or a speed that is missing (nan, inf) counts as the one before; before the first power nothing counts.

        Raises
        ------
        missionsim.errors.InputError
            When the time does not increase.
        """
        if not math.isfinite(power_w):
            if self._time is None:
                return
            power_w = self._power
        speed = abs(speed_m_s) if math.isfinite(speed_m_s) else self._speed
        if self._time is None:
            self._time, self._power, self._speed, self._first = time_s, power_w, speed, time_s
            return
        step = time_s - self._time
        if not step > 0.0:
            raise InputError.single("samples must come in order of time", got=time_s, allowed=f"after {self._time:g} s")
        self._drawn += 0.5 * (power_w + self._power) * step
        mean = 0.5 * (speed + self._speed)
        self._time, self._power, self._speed = time_s, power_w, speed
        self._advance(step, mean)

    def _advance(self, step_s: float, speed: float) -> None:
        """Move along the plan: by distance where it drives, by time where it stands or turns.

        A robot that stops within the last 5 % of a drive has arrived; one that stops before makes an unplanned stop,
        energy without progress. One that still drives where the plan stands is not there yet.
        """
        last = len(self._durations)
        moving = speed >= STILL_SPEED_M_S
        while step_s > 0.0 and self._index < last:
            distance = self._distances[self._index]
            if distance > 0.0:
                if not moving:
                    left = self._run_left[self._index] - self._share * distance
                    if left > max(ARRIVED_SHARE * self._run_length[self._index], ARRIVED_M):
                        return
                    self._index, self._share = self._run_end[self._index], 0.0
                    continue
                total_s = distance / speed
            else:
                total_s = self._durations[self._index]
                if moving and self._index + 1 < last and self._distances[self._index + 1] > 0.0:
                    if self._share < 0.5:
                        return
                    self._index, self._share = self._index + 1, 0.0
                    continue
            rest_s = (1.0 - self._share) * total_s
            if step_s < rest_s:
                self._share += step_s / total_s
                return
            step_s -= rest_s
            self._index, self._share = self._index + 1, 0.0

    def feed(
        self, columns: Mapping[str, Sequence[float] | Array], battery: str = "robot", every_s: float = 1.0
    ) -> Iterator[Forecast]:
        """Samples of a log in columns; a forecast every `every_s` seconds and after the last sample.

        Parameters
        ----------
        columns : mapping
            ``time_s``, ``power_<battery>_w`` or voltage and current, ``speed_m_s`` and perhaps ``lateral_speed_m_s``.

        Raises
        ------
        missionsim.errors.InputError
            Where a column is missing, or another length than the time.
        """
        time = np.asarray(_column(columns, "time_s"), dtype=float)
        if f"power_{battery}_w" in columns:
            power = np.asarray(columns[f"power_{battery}_w"], dtype=float)
        else:
            voltage = _column(columns, f"voltage_{battery}_v")
            power = np.asarray(voltage, dtype=float) * np.asarray(_column(columns, f"current_{battery}_a"), dtype=float)
        speed = np.abs(np.asarray(columns.get("speed_m_s", np.zeros_like(time)), dtype=float))
        if "lateral_speed_m_s" in columns:
            speed = np.hypot(speed, np.asarray(columns["lateral_speed_m_s"], dtype=float))
        if not len(time) == len(power) == len(speed):
            lengths = f"{len(time)}, {len(power)} and {len(speed)} values"
            raise InputError.single("time, power and speed of different lengths", got=lengths, allowed="one a sample")
        due = -math.inf
        for t, p, v in zip(time.tolist(), power.tolist(), speed.tolist(), strict=True):
            self.update(t, p, v)
            if t >= due:
                yield self.forecast()
                due = t + every_s
        if len(time) and due != time[-1] + every_s:
            yield self.forecast()

    def forecast(self) -> Forecast:
        """What is known now."""
        behind, home_now = self._here(self._behind), self._here(self.expected.return_j)
        total = float(self._behind[-1])
        rest = total - behind
        home_j = float(self.expected.return_j[-1])
        factor, factor_sd = 1.0, self.model_sd
        if behind > 0.0:
            # posterior of the factor between drawn and expected energy: normal prior about 1, normal likelihood
            elapsed = max((self._time or 0.0) - self._first, 1e-9)
            blocks = max(elapsed / (2.0 * self.correlation_s), 1.0)
            ratio_sd = math.hypot(self.meter_sd, self.noise_sd / math.sqrt(blocks))
            weight = self.model_sd**2 / (self.model_sd**2 + ratio_sd**2)
            factor, factor_sd = 1.0 + weight * (self._drawn / behind - 1.0), math.sqrt(weight) * ratio_sd
        left = self.available_j - self._drawn
        left_sd = self.meter_sd * self._drawn
        finish_sd, return_sd = (self._spread(amount, factor_sd) for amount in (rest, home_now))
        need = factor * (rest + home_j)
        need_sd = math.hypot(self._spread(rest + home_j, factor_sd), left_sd)
        slack = left - self.reserve_j - need
        can_finish = slack >= self.confidence * need_sd
        wait = None if can_finish else self._until_turning(behind, home_now, left, left_sd, factor, factor_sd)
        p_finish = 0.5 * (1.0 + math.erf(slack / need_sd / math.sqrt(2.0))) if need_sd > 0.0 else float(slack >= 0.0)
        known = (self._drawn, left, left_sd, factor * rest, finish_sd, factor * home_now, return_sd, factor, factor_sd)
        progress = behind / total if total > 0.0 else 1.0
        return Forecast(self._time or 0.0, progress, *known, can_finish, wait == 0.0, wait, p_finish)

    def _spread(self, energy_j: float, factor_sd: float) -> float:
        """Standard deviation of an energy still to come: the factor's, and the noise of the power about its mean."""
        total_s = float(self._clock[-1])
        mean_w = float(self._behind[-1]) / total_s if total_s > 0.0 else 0.0
        noise = self.noise_sd * math.sqrt(max(2.0 * self.correlation_s * mean_w * energy_j, 0.0))
        return math.hypot(factor_sd * energy_j, noise)

    def _here(self, knots: Array) -> float:
        """Where the robot is, what is known where intervals begin and end."""
        low = float(knots[self._index])
        return low + self._share * (float(knots[self._index + 1]) - low) if self._share else low

    def _until_turning(
        self, behind: float, home_j: float, left: float, left_sd: float, factor: float, factor_sd: float
    ) -> float:
        """Expected seconds until what is left only just brings the robot home with the asked confidence; 0 is now."""
        after, now_s = slice(self._index + 1, None), self._here(self._clock)
        points, homes = np.append(behind, self._behind[after]), np.append(home_j, self.expected.return_j[after])
        times = np.append(now_s, self._clock[after])
        ahead = points - behind + homes
        safe_sd = np.hypot(factor_sd * ahead, left_sd)
        margin = left - self.reserve_j - factor * ahead - self.confidence * safe_sd
        if margin[0] <= 0.0:
            return 0.0
        short = np.flatnonzero(margin <= 0.0)
        if len(short) == 0:
            return float(times[-1] - now_s)
        k = int(short[0])
        part = margin[k - 1] / (margin[k - 1] - margin[k])
        return float(times[k - 1] + part * (times[k] - times[k - 1]) - now_s)


def _column(columns: Mapping[str, Any], name: str) -> Any:
    if name not in columns:
        raise InputError.single(f"the log has no column '{name}'", got=", ".join(sorted(columns)), allowed=name)
    return columns[name]

"""Behaviour's part of the gap between plan and log: longer, slower, waiting, per control scheme, adding up exactly.

The plan's interval table is changed step by step into what the robot did – the path it drove, then the speed it
reached, then the time it stood – and the energy of the same power model is taken after each step. The differences
telescope, so together with what is left (turns, ramps and switching otherwise than planned) they are the whole
difference between replay and simulation.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np

from missionsim.effects.covariates import is_clock
from missionsim.effects.model import PowerModel
from missionsim.effects.timeline import Timeline, integrate
from missionsim.files import Json, fields_of
from missionsim.glossary import STILL_SPEED_M_S
from missionsim.physics import Array, Bools
from missionsim.runs import motion
from missionsim.runs.error import ErrorStatistics

STATISTICS = "error_statistics error_statistics_relative_to_predicted=error_statistics_predicted"
"""Both, as `fields_of` takes them."""
_SPEEDS = ("speed_m_s", "lateral_speed_m_s", "yaw_rate_rad_s")
_RATES = ("accel_m_s2", "lateral_accel_m_s2", "yaw_accel_rad_s2")


@dataclass(frozen=True)
class Stages:
    """An interval table on its way from the plan to what was done; `members` are the intervals of one scheme."""

    model: PowerModel
    timeline: Timeline
    battery: str

    def energy(self, members: Bools) -> float:
        """Energy of the battery in the intervals `members` [J]."""
        energies = integrate(self.model, self.timeline)[self.battery]
        return float(sum(float(joules[members].sum()) for joules in energies.values()))

    def stretched(self, members: Bools, way_m: float) -> Stages:
        """The same with the way `way_m`: the cruise gets longer or shorter, ramps stay."""
        distance = self.timeline.ways_m()
        chosen = members & self._driving()
        cruise = chosen & ~(np.asarray(self.timeline.rates.get("speed_m_s", 0.0)) != 0.0)
        if not distance[cruise].sum() > 0.0:
            cruise = chosen
        length = float(distance[cruise].sum())
        if length <= 0.0:
            return self
        factor = max(0.0, (way_m - float(distance[chosen & ~cruise].sum())) / length)
        return self._lasting(np.where(cruise, factor, 1.0))

    def at_speed(self, members: Bools, speed_m_s: float) -> Stages:
        """The same way at another mean speed: time runs faster or slower while driving."""
        chosen = members & self._driving()
        duration = float(self.timeline.duration_s[chosen].sum())
        now = ratio(float(self.timeline.ways_m()[chosen].sum()), duration)
        # no row counts as driving below this speed, so a mean below it means that nothing was driven
        if now <= 0.0 or speed_m_s < STILL_SPEED_M_S:
            return self
        factor = np.where(chosen, speed_m_s / now, 1.0)
        columns: dict[str, Any] = dict(self.timeline.columns)
        rates = dict(self.timeline.rates)
        for names, power in ((_SPEEDS, 1), (_RATES, 2)):
            for name in names:
                if name in columns:
                    columns[name] = columns[name] * factor**power
                if name in rates:
                    rates[name] = rates[name] * factor ** (power + 1)
        faster = replace(self, timeline=replace(self.timeline, columns=columns, rates=rates))
        return faster._lasting(1.0 / factor, stretch_rates=False)

    def standing_for(self, members: Bools, seconds: float) -> float:
        """Energy with `seconds` at rest, at the power of the planned rest or, without one, of driving at speed zero."""
        standing = members & self._standing()
        planned = float(self.timeline.duration_s[standing].sum())
        if planned > 0.0:
            return self._lasting(np.where(standing, seconds / planned, 1.0)).energy(members)
        energy = self.energy(members)
        duration = np.where(members, self.timeline.duration_s, 0.0)
        if seconds <= 0.0 or duration.sum() <= 0.0:
            return energy
        still = {name: np.zeros(len(self.timeline)) for name in (*_SPEEDS, *_RATES, "moving", "starts")}
        known = self.timeline.columns
        columns = {**known, **{name: zero for name, zero in still.items() if name in known}}
        at_rest = replace(self, timeline=replace(self.timeline, columns=columns, rates={})).energy(members)
        return energy + at_rest * seconds / float(duration.sum())

    def _lasting(self, factor: Array, stretch_rates: bool = True) -> Stages:
        line = self.timeline
        duration = line.duration_s * factor
        columns: dict[str, Any] = dict(line.columns)
        rates = dict(line.rates)
        if stretch_rates:
            safe = np.where(factor > 0.0, factor, 1.0)
            rates = {name: rate if name == "time_s" or is_clock(name) else rate / safe for name, rate in rates.items()}
        if "moving_time_s" in columns:
            spent = np.where(self._standing(), 0.0, duration)
            columns["moving_time_s"] = np.cumsum(spent) - spent
        start = np.cumsum(duration) - duration
        return replace(self, timeline=replace(line, start_s=start, duration_s=duration, columns=columns, rates=rates))

    def _driving(self) -> Bools:
        still = {"speed_m_s": np.zeros(len(self.timeline))}
        return np.asarray(motion.speed_of({**still, **motion.middle_of(self.timeline)}) > 0.0)

    def _standing(self) -> Bools:
        turning = motion.middle_of(self.timeline).get("yaw_rate_rad_s", np.zeros(len(self.timeline)))
        return np.asarray(~self._driving() & (np.asarray(turning) == 0.0))


def ratio(a: float, b: float) -> float:
    """``a / b``, 0 where b is not positive."""
    return a / b if b > 0.0 else 0.0


PARTS = ("path_stretch", "speed_tracking", "dwell", "other")
OF_SCHEME = ("scheme", "path_stretch", "speed_tracking", "dwell_s", "planned_m", "driven_m", "planned_s", "driven_s")
"""What tables and JSON tell of a `SchemeGap` beside its energies."""


@dataclass(frozen=True, kw_only=True)
class SchemeGap:
    """Plan and log of one control scheme; totals over all runs, ratios as means over runs."""

    scheme: str
    path_stretch: float | None
    """Distance driven over distance planned; None where nothing was planned."""
    speed_tracking: float | None
    """Speed reached over speed planned, both means over the way, as `missionsim diagnose` has it."""
    dwell_s: float
    """Time at rest beyond the plan."""
    planned_m: float
    driven_m: float
    planned_s: float
    driven_s: float
    """These: distance and time."""
    wh: Mapping[str, float]
    """Energy of each of `PARTS` [Wh]."""


@dataclass(frozen=True)
class MissionGap:
    """One battery: measured against simulated mission."""

    battery: str
    runs: int
    """Logged runs, each compared with one simulation."""
    energy_simulated_wh: float
    """Of all runs."""
    behaviour_wh: float
    """Replayed minus simulated energy."""
    schemes: tuple[SchemeGap, ...]
    error_statistics: ErrorStatistics
    error_statistics_predicted: ErrorStatistics
    """Both: of the *simulated* energy against the measured one at equal progress of the mission, over the measured
    time."""

    def part_wh(self, part: str) -> float:
        """Energy of one of `PARTS` over all schemes [Wh]."""
        return sum(scheme.wh[part] for scheme in self.schemes)

    @property
    def words(self) -> list[str]:
        """The split in a sentence or two."""
        names = {"path_stretch": "the way", "speed_tracking": "the speed", "dwell": "standing", "other": "the rest"}
        parts = ", ".join(f"{names[part]} {self.part_wh(part):+.3g} Wh" for part in PARTS)
        first = (
            f"What the robot did otherwise than planned takes {self.behaviour_wh:+.3g} Wh of battery "
            f"{self.battery} ({parts})."
        )
        told = [
            f"{one.scheme or 'no scheme'}: {one.path_stretch:.2f} times the planned way at {one.speed_tracking:.2f} "
            f"times the planned speed, {one.dwell_s:+.0f} s at rest"
            for one in self.schemes
            if one.path_stretch is not None and one.speed_tracking is not None
        ]
        return [text.replace("-", "−") for text in [first, *(f"{line}." for line in told)]]

    def to_json(self) -> Json:
        """Numbers beside the contract's ``gap_wh``."""
        return {
            **fields_of(self, "energy_simulated_wh runs"),
            "behaviour_wh": {part: self.part_wh(part) for part in PARTS},
            "by_scheme": [fields_of(one, " ".join((*OF_SCHEME, "wh"))) for one in self.schemes],
            **fields_of(self, STATISTICS),
        }


def split_behaviour(
    model: PowerModel, timeline: Timeline, driven: Sequence[Mapping[str, motion.Motion]], battery: str
) -> tuple[SchemeGap, ...]:
    """Split replayed minus simulated energy of one battery over several runs of one mission.

    `timeline`: the simulated mission. `driven`: one a run, with the energy of the model that it drove; logs without
    schemes have one entry under ``""``, which is held against the whole plan. The parts of all schemes add up to
    replayed minus ``len(driven)`` times simulated energy.
    """
    names = dict.fromkeys(name for run in driven for name in run)
    nameless = set(names) == {""}
    codes, schemes = motion.scheme_codes(timeline.columns, len(timeline), ignore=nameless)
    plan = motion.planned(timeline, by_scheme=not nameless)
    stages = Stages(model, timeline, battery)
    count, gaps = len(driven), []
    for name in dict.fromkeys([*plan, *names]):
        members = codes == schemes.index(name) if name in plan else np.zeros(len(timeline), dtype=bool)
        runs, wanted = [run.get(name, motion.Motion()) for run in driven], plan.get(name, motion.Motion())
        done = motion.Motion()
        for run in runs:
            done.add(run)
        stretched = stages.stretched(members, done.distance_m / count)
        tracked = stretched.at_speed(members, ratio(done.distance_m, done.driving_s))
        steps = [stage.energy(members) for stage in (stages, stretched, tracked)]
        steps.append(tracked.standing_for(members, done.standing_s / count))
        at = [*(count * joules for joules in steps), done.energy_j.get(battery, 0.0)]
        drives = wanted.distance_m > 0.0
        gaps.append(
            SchemeGap(
                scheme=name,
                path_stretch=motion.mean_ratio(motion.stretch(wanted, runs)) if drives else None,
                speed_tracking=motion.mean_ratio(motion.tracking(wanted, runs)) if drives else None,
                dwell_s=done.standing_s - count * wanted.standing_s,
                planned_m=count * wanted.distance_m,
                driven_m=done.distance_m,
                planned_s=count * wanted.seconds,
                driven_s=done.seconds,
                wh={part: (after - before) / 3600.0 for part, (before, after) in zip(PARTS, pairwise(at), strict=True)},
            )
        )
    return tuple(gaps)

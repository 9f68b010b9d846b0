"""The plan's interval table, changed step by step into what the robot did."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.integrate import integrate
from missionsim.effects.model import PowerModel
from missionsim.effects.timeline import Timeline
from missionsim.glossary import STILL_SPEED_M_S
from missionsim.runs.motion import distances, middle_of, speed_of

_SPEEDS = ("speed_m_s", "lateral_speed_m_s", "yaw_rate_rad_s")
_RATES = ("accel_m_s2", "lateral_accel_m_s2", "yaw_accel_rad_s2")


@dataclass(frozen=True)
class Stages:
    """An interval table on its way from the plan to what was done; `members` are the intervals of one scheme."""

    model: PowerModel
    timeline: Timeline
    batteries: Sequence[str]

    def energy(self, members: NDArray[np.bool_]) -> dict[str, float]:
        """Energy of each battery in the intervals `members` [J]."""
        energies = integrate(self.model, self.timeline)
        return {
            battery: float(sum(float(joules[members].sum()) for joules in energies[battery].values()))
            for battery in self.batteries
        }

    def stretched(self, members: NDArray[np.bool_], way_m: float) -> Stages:
        """The same with the way `way_m`: the cruise gets longer or shorter, ramps stay."""
        distance = distances(self.timeline)
        chosen = members & self._driving()
        cruise = chosen & ~self._ramps()
        if not distance[cruise].sum() > 0.0:
            cruise = chosen
        length = float(distance[cruise].sum())
        if length <= 0.0:
            return self
        factor = max(0.0, (way_m - float(distance[chosen & ~cruise].sum())) / length)
        return self._lasting(np.where(cruise, factor, 1.0))

    def at_speed(self, members: NDArray[np.bool_], speed_m_s: float) -> Stages:
        """The same way at another mean speed: time runs faster or slower while driving."""
        chosen = members & self._driving()
        duration = float(self.timeline.duration_s[chosen].sum())
        now = ratio(float(distances(self.timeline)[chosen].sum()), duration)
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

    def standing_for(self, members: NDArray[np.bool_], seconds: float) -> dict[str, float]:
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
        rest = replace(self, timeline=replace(self.timeline, columns=columns, rates={}))
        at_rest = rest.energy(members)
        return {name: energy[name] + at_rest[name] * seconds / float(duration.sum()) for name in self.batteries}

    def _lasting(self, factor: NDArray[np.float64], stretch_rates: bool = True) -> Stages:
        line = self.timeline
        duration = line.duration_s * factor
        columns: dict[str, Any] = dict(line.columns)
        rates = dict(line.rates)
        if stretch_rates:
            safe = np.where(factor > 0.0, factor, 1.0)
            rates = {name: rate if _is_clock(name) else rate / safe for name, rate in rates.items()}
        if "moving_time_s" in columns:
            spent = np.where(self._standing(), 0.0, duration)
            columns["moving_time_s"] = np.cumsum(spent) - spent
        start = np.cumsum(duration) - duration
        return replace(self, timeline=replace(line, start_s=start, duration_s=duration, columns=columns, rates=rates))

    def _speed(self) -> NDArray[np.float64]:
        return speed_of({"speed_m_s": np.zeros(len(self.timeline)), **middle_of(self.timeline)})

    def _driving(self) -> NDArray[np.bool_]:
        return np.asarray(self._speed() > 0.0)

    def _standing(self) -> NDArray[np.bool_]:
        turning = middle_of(self.timeline).get("yaw_rate_rad_s", np.zeros(len(self.timeline)))
        return np.asarray(~self._driving() & (np.asarray(turning) == 0.0))

    def _ramps(self) -> NDArray[np.bool_]:
        rate = np.asarray(self.timeline.rates.get("speed_m_s", np.zeros(len(self.timeline))))
        return np.asarray(rate != 0.0)


def _is_clock(name: str) -> bool:
    return name == "moving_time_s" or name.startswith("on_time_") or name == "time_s"


def ratio(a: float, b: float) -> float:
    """``a / b``, 0 where b is not positive."""
    return a / b if b > 0.0 else 0.0

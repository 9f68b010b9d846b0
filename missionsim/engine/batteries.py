"""Batteries: charge over time, exactly, with the instant at which a threshold is reached.

Charge is never clamped: a battery that gives more than it holds goes below zero, and by how much is the deficit.
"""

from __future__ import annotations

import itertools
from bisect import bisect_right
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import ClassVar

import numpy as np

from missionsim.effects.model import PowerModel
from missionsim.effects.timeline import Timeline, integrate, within
from missionsim.engine.curves import adaptive_runge_kutta, chebyshev, interpolants, root
from missionsim.physics import Array, Bools, Int64s, Ints, Value

CHARGE_TOLERANCE = 1e-9
"""Of the capacity: a charge that is less below empty, or below a reserve, is so by rounding."""
CHARGING, HELD = 1, 2
"""What a charger does to a battery; more than 2 is charging in that piece of its taper, counted from 2."""
Taper = tuple[tuple[float, float], ...]
"""Up to which fraction of the capacity which part of the charger's power goes into the battery, the last up to 1."""
FLAT: Taper = ((1.0, 1.0),)
_MOST_AT_ONCE = 4096
_CLEAR = 1e-6
"""State of charge, volts and share of the power by which a margin must be positive to be certainly so."""


@dataclass(frozen=True)
class Loads:
    """What one battery had to deliver in some intervals."""

    battery: str
    line: Timeline
    """The intervals."""
    energy_j: Array
    """Of all terms. Shape (n,)."""
    charging: Int64s
    """0 alone, 1 charging, 2 held at its level by the charger. Shape (n,)."""
    charger_w: Array
    """Power of the charger while charging. Shape (n,)."""
    model: PowerModel
    values: Mapping[str, Value]
    """Parameters that differ from the model's."""

    @cached_property
    def changing(self) -> Bools:
        """Whether the power changes within each interval, or an impulse begins it, shape (n,)."""
        return self.line.changing(self.model) | (np.asarray(self.line.columns["starts"]) > 0.0)

    @cached_property
    def impulse_j(self) -> Array:
        """Energy taken at the very start of each interval [J], shape (n,)."""
        impulses = self.model.impulses(self.line.covariates(), self.values)
        own = [joules for key, joules in impulses.items() if key.battery == self.battery]
        return np.array(np.broadcast_to(sum(own, start=0.0), len(self.line)), dtype=float)

    @cached_property
    def _pieces(self) -> dict[int, tuple[list[float], list[list[float]]]]:
        """Of the intervals in which power changes; see `interpolants`."""

        def sample(index: Ints, seconds: Array) -> Array:
            cov = within(self.model, self.line, index, seconds, self.values)
            power = self.model.total(cov, self.battery, self.values)
            return np.broadcast_to(np.asarray(power, dtype=float), seconds.shape)

        index = np.flatnonzero(self.changing)
        found: dict[int, tuple[list[float], list[list[float]]]] = {}
        for begin in range(0, index.size, _MOST_AT_ONCE):
            part = index[begin : begin + _MOST_AT_ONCE]
            found.update(interpolants(sample, part, self.line.duration_s[part]))
        return found

    @cached_property
    def mean_w(self) -> Array:
        """Mean power of each interval, shape (n,)."""
        return self.energy_j / self.line.duration_s

    @cached_property
    def most_w(self) -> Array:
        """Power that no moment of an interval is above [W], shape (n,); not the least such."""
        most = self.mean_w.copy()
        for interval, (_, series) in self._pieces.items():
            most[interval] = max(one[0] + sum(map(abs, one[1:])) for one in series)
        return most

    def power(self, interval: int) -> Callable[[float], float]:
        """Power [W] as a function of the time since the start of an interval [s], without impulses."""
        if not self.changing[interval]:
            mean = float(self.mean_w[interval])
            return lambda _: mean
        borders, series = self._pieces[interval]
        parts = [chebyshev(one, high - low) for one, low, high in zip(series, borders, borders[1:], strict=False)]
        if len(parts) == 1:
            return parts[0]
        inner = borders[1:-1]

        def piecewise(seconds: float) -> float:
            which = bisect_right(inner, seconds)
            return parts[which](seconds - borders[which])

        return piecewise

    @cached_property
    def charged_j(self) -> Array:
        """Energy that the charger gives in each interval, shape (n,)."""
        if not self.charging.any():
            return np.zeros(len(self.energy_j))
        full = self.charger_w * self.line.duration_s
        return np.where(self.charging == CHARGING, full, np.where(self.charging == HELD, self.energy_j, 0.0))


@dataclass(frozen=True)
class ConstantEnergy:
    """A store of energy, as the papers take it (Parasuraman 2012, Eq. 11: ``E_r = E_a − E_c``).

    The state is the energy left in J.
    """

    name: str
    capacity_j: float
    initial: float
    taper: Taper = FLAT

    def after(self, state: float, loads: Loads) -> Array:
        """Energy left at the end of each interval [J]."""
        net = loads.energy_j - loads.charged_j
        return np.asarray(state - np.cumsum(net))

    @property
    def full(self) -> float:
        """The state when full [J]."""
        return self.capacity_j

    def charge_j(self, state: Array | float) -> Array:
        """The state itself."""
        return np.asarray(state, dtype=float)

    def reach(self, state: float, loads: Loads, interval: int, level: float, horizon_s: float) -> float | None:
        """Time at which the energy left comes to `level`, in closed form where power is constant."""
        if loads.charging[interval] == HELD:
            return None
        extra_w = loads.charger_w[interval] if loads.charging[interval] == CHARGING else 0.0
        line = loads.line.part(interval, interval + 1)
        if not loads.changing[interval]:
            power = loads.energy_j[interval] / line.duration_s[0] - extra_w
            if power == 0.0:
                return None
            time = (state - level) / power
            return float(time) if 0.0 <= time <= horizon_s else None

        def left(seconds: float) -> float:
            part = replace(line, duration_s=np.array([seconds]))
            used = sum(joules[0] for joules in integrate(loads.model, part, loads.values)[self.name].values())
            return state - level - float(used) + extra_w * seconds

        at_start, at_end = left(0.0), left(horizon_s)
        if at_start <= 0.0 < state - level:  # what a start takes at once leads past the level
            return 0.0
        if at_start == 0.0 or (at_start > 0.0) == (at_end > 0.0):
            return 0.0 if at_start == 0.0 else None
        return root(left, 0.0, horizon_s, at_start, at_end)

    def charging(self, state: Array, power_w: Array, draw_w: Array, seconds: Array) -> list[tuple[Array, Array]]:
        """Charging for some time at constant power, held once full, many at once.

        `state`, `power_w`, `draw_w`, `seconds` (shape (n,)): energy left [J], powers of the charger and of the robot's
        draw meanwhile, time at the charger. Gives an array of shape (n,): time and energy left where the taper bends or
        the charge is full, and at the end.
        """
        bends, clock = [], np.zeros_like(seconds)
        for upper, part in self.taper:
            lacking = np.maximum(upper * self.capacity_j - state, 0.0)
            gain = np.minimum(power_w - draw_w, part * power_w)
            with np.errstate(divide="ignore", invalid="ignore"):
                takes = np.where(lacking > 0.0, np.where(gain > 0.0, lacking / gain, np.inf), 0.0)
            left = seconds - clock
            state = np.where(takes <= left, state + lacking, state + gain * left)
            clock = clock + np.minimum(takes, left)
            bends.append((clock, state))
        return [*bends, (seconds, state)]

    def suspects(self, before: Array, after: Array, loads: Loads) -> Ints:
        """Intervals that end below zero, by more than rounding."""
        return np.flatnonzero(after < -CHARGE_TOLERANCE * self.capacity_j)

    def empty_in(self, state: float, loads: Loads, interval: int) -> float | None:
        """Time at which the energy left comes to zero from above."""
        if state < 0.0:
            return 0.0
        return self.reach(state, loads, interval, 0.0, float(loads.line.duration_s[interval]))


@dataclass(frozen=True)
class EquivalentCircuit:
    """Open-circuit voltage over state of charge behind an internal resistance; the state is the state of charge.

    The current solves ``P = U(s) I − R I²``. Charge leaves as ``ds/dt = −I (I / I_rated)^(k−1) / Q`` when
    discharging (Peukert 1897; ``I_rated = Q / rated time``) and as ``−I / Q`` when charging, with ``Q`` the capacity
    times the ageing factor. Empty is where the charge ends, the voltage falls below the cut-off, or the asked power
    is more than the cell can give at any current.
    """

    name: str
    capacity_j: float
    initial: float
    charge_c: float
    """Capacity, aged, in coulomb."""
    curve: tuple[Array, Array]
    """States of charge, rising, and their open-circuit voltages; linear between, straight on beyond."""
    resistance_ohm: float
    peukert: float = 1.0
    rated_time_s: float = 72000.0
    cut_off_v: float = 0.0
    taper: Taper = FLAT
    full: ClassVar[float] = 1.0
    """The state when full."""

    @cached_property
    def _knots(self) -> tuple[list[float], list[float], list[float]]:
        """States, volts and slopes after them as plain numbers: NumPy takes ten times as long for one."""
        states, volts = self.curve
        return states.tolist(), volts.tolist(), [*(np.diff(volts) / np.diff(states)).tolist(), 0.0]

    def voltage(self, state: float) -> float:
        """Open-circuit voltage [V]."""
        states, volts, slopes = self._knots
        if state <= states[0]:
            return volts[0]
        i = bisect_right(states, state) - 1
        return volts[i] + slopes[i] * (state - states[i])

    def current(self, state: float, power_w: float) -> float:
        """Current [A] that delivers `power_w`; beyond the greatest possible power, that one's current."""
        volts, ohm = self.voltage(state), self.resistance_ohm
        if ohm == 0.0:
            return power_w / volts
        inside = volts * volts - 4.0 * ohm * power_w
        return 2.0 * power_w / (volts + inside**0.5) if inside > 0.0 else volts / (2.0 * ohm)

    def margin(self, state: float, power_w: float) -> float:
        """Negative where the battery can give no more: the least of charge, volts over cut-off and power in reserve."""
        volts = self.voltage(state)
        spare = 1.0
        if self.resistance_ohm > 0.0 and power_w > 0.0:
            spare = volts * volts / (4.0 * self.resistance_ohm * power_w) - 1.0
        terminal = volts - self.resistance_ohm * self.current(state, power_w)
        return min(state, terminal - self.cut_off_v, spare)

    def rate(self, state: float, power_w: float) -> float:
        """Change of the state of charge [1/s]."""
        current = self.current(state, power_w)
        if current > 0.0 and self.peukert != 1.0:
            current *= (current * self.rated_time_s / self.charge_c) ** (self.peukert - 1.0)
        return -current / self.charge_c

    def charge_j(self, state: Array | float) -> Array:
        """Energy between a state and empty at no load, ``Q ∫ U ds`` [J]; straight on below empty."""
        states, volts = self.curve
        areas = np.concatenate([[0.0], np.cumsum(0.5 * (volts[1:] + volts[:-1]) * np.diff(states))])
        s = np.asarray(state, dtype=float)
        piece = np.clip(np.searchsorted(states, s, side="right") - 1, 0, len(states) - 2)
        beyond = s - states[piece]
        slope = np.where((s < 0.0) | (s > 1.0), 0.0, np.diff(volts)[piece] / np.diff(states)[piece])
        start = np.where(s > 1.0, volts[-1], volts[piece])
        whole = np.where(s > 1.0, areas[-1], areas[piece])
        beyond = np.where(s > 1.0, s - 1.0, beyond)
        return np.asarray(self.charge_c * (whole + start * beyond + 0.5 * slope * beyond**2))

    def after(self, state: float, loads: Loads) -> Array:
        """State of charge at the end of each interval."""
        states = np.empty(len(loads.line))
        for i, seconds in enumerate(loads.line.duration_s.tolist()):
            states[i] = state = self._walk(state, loads, i, seconds)[-1][1]
        return states

    def reach(self, state: float, loads: Loads, interval: int, level: float, horizon_s: float) -> float | None:
        """Time at which the state of charge comes to `level`."""
        return self._first(state, loads, interval, horizon_s, lambda s, _: s - level)

    def suspects(self, before: Array, after: Array, loads: Loads) -> Ints:
        """Intervals whose margin is not certainly positive: the voltage may fall long before the charge ends.

        Certain by bounds: of the power, so of the current at the curve's lowest voltage, so of the state and of the
        voltage (which never falls with the charge) in the interval.
        """
        states, volts = self.curve
        floor, ohm, seconds = float(volts.min()), self.resistance_ohm, loads.line.duration_s
        high_w = np.maximum(loads.most_w, 0.0)
        with np.errstate(invalid="ignore", over="ignore"):
            current = _discharge(floor, ohm, high_w)
            stretch = (current * self.rated_time_s / self.charge_c) ** (self.peukert - 1.0)
            leaving = current * seconds * np.maximum(stretch, 1.0) + np.abs(loads.impulse_j) / floor
            least = before - leaving / self.charge_c
            voltage = np.interp(least, states, volts)
            terminal = voltage - ohm * _discharge(voltage, ohm, high_w)
            spare = voltage * voltage - 4.0 * ohm * high_w * (1.0 + _CLEAR)
            certain = (least > _CLEAR) & (terminal - self.cut_off_v > _CLEAR) & (spare > 0.0)
        return np.flatnonzero((loads.charging == 0) & ~certain)

    def empty_in(self, state: float, loads: Loads, interval: int) -> float | None:
        """Time at which the margin is used up."""
        if loads.charging[interval]:
            return None
        return self._first(state, loads, interval, float(loads.line.duration_s[interval]), self.margin)

    def _net(self, loads: Loads, interval: int) -> Callable[[float], float]:
        """Power at the terminals as a function of the time in an interval."""
        if loads.charging[interval] == HELD:
            return lambda _: 0.0
        extra = float(loads.charger_w[interval]) if loads.charging[interval] == CHARGING else 0.0
        power = loads.power(interval)
        return power if extra == 0.0 else lambda seconds: power(seconds) - extra

    def _walk(self, state: float, loads: Loads, interval: int, horizon_s: float) -> list[tuple[float, float]]:
        """Steps (time, state) of an interval whose error is under control."""
        power = self._net(loads, interval)
        if loads.changing[interval] and loads.charging[interval] != HELD:
            impulse_j = float(loads.impulse_j[interval])
            if impulse_j:
                state -= impulse_j / (self.voltage(state) * self.charge_c)
        return adaptive_runge_kutta(lambda t, s: self.rate(s, power(t)), state, horizon_s)

    def _first(
        self, state: float, loads: Loads, interval: int, horizon_s: float, measure: Callable[[float, float], float]
    ) -> float | None:
        power = self._net(loads, interval)
        steps = self._walk(state, loads, interval, horizon_s)
        # below at the start, or led below by what a start takes at once
        if measure(steps[0][1], power(0.0)) < 0.0 and (measure == self.margin or measure(state, power(0.0)) > 0.0):
            return 0.0
        for (t0, s0), (t1, s1) in itertools.pairwise(steps):
            before, after = measure(s0, power(t0)), measure(s1, power(t1))
            if (before < 0.0) == (after < 0.0):
                continue

            def at(t: float, t0: float = t0, s0: float = s0) -> float:
                end = adaptive_runge_kutta(lambda u, s: self.rate(s, power(t0 + u)), s0, t - t0)[-1][1]
                return measure(end, power(t))

            return root(at, t0, t1, before, after)
        return None


def greatest_fall(levels: Array) -> Array:
    """By how much a charge falls at most below what it was before, along the first axis."""
    return np.asarray(np.max(np.maximum.accumulate(levels, axis=0) - levels, axis=0))


Battery = ConstantEnergy | EquivalentCircuit
"""What the engine asks of a battery; the state is a number of its own."""


def _discharge(volts: Array | float, ohm: float, power_w: Array) -> Array:
    """Current that delivers a power that is not negative [A]; not a number where none does."""
    return np.asarray(2.0 * power_w / (volts + np.sqrt(volts * volts - 4.0 * ohm * power_w)))

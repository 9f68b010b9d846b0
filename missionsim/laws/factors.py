"""The factors that some logs allow, as formulas: powers, sides, thresholds, gates, memories, levels.

Thresholds, time constants and reference values are read off the logs (quantiles of what was driven), so they say where
the logs lie, not what is true. What a factor is worth in a run is its formula evaluated there.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence, Set
from functools import cache, lru_cache, partial
from itertools import permutations
from typing import Any

import numpy as np

from missionsim.effects.covariates import Covariates, is_text
from missionsim.expressions import REMEMBERED, compile_expression
from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S, column_of
from missionsim.labels import Labels
from missionsim.laws.grammar import Factor, Grammar, Values
from missionsim.physics import Array
from missionsim.physics.lag import lagged
from missionsim.runs.covariates import COVARIATES, may_be_cause

MOST_LEVELS = 6
MOST_FURTHER = 6
"""Columns beyond the glossary that enter; more would make chance finds of any share."""
MOST_WARM = 4
"""Temperatures whose differences enter."""
LAGS_S = (3.0, 5.0, 8.0, 13.0, 20.0, 30.0, 50.0, 80.0, 130.0)
WARM_S = (30.0, 120.0)
TEMPERATURE = re.compile(r"^temp_|_temp(erature)?(_|$)|_deg_?[cf]$")
WIDTHS = {0.2: (0.5, 0.75), 0.1: (), 0.4: ()}
"""Widths of a resonance in parts of a fast drive's speed, with the quantiles of speed that enter the first pass."""
SATURATES = np.array([0.1, 0.2, 0.3, 0.4, 0.6, 0.9])
"""Loads of a processor at which its power may level off."""
BENDS_AT = np.array([0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.2])
"""The same of a speed and a turn rate, in parts of a slow one."""
AROUND = np.radians(np.arange(0.0, 360.0, 15.0))
"""Directions of the compass that something may come from."""
TENTHS = np.linspace(0.1, 0.9, 9)
EVENLY = 15
"""Thresholds between the lowest and the highest value that the runs hold."""
RATE_S = 0.3
"""Time over which a rate is taken, a few rows of most logs."""
NOISE_PART = 0.1
"""A quantity that falls below zero by less than this part of its highest value is noise about zero."""
SYMBOLS = {name: one.symbol for name, one in COVARIATES.items() if one.symbol} | {"time_s": "t"}
_compiled = lru_cache(maxsize=4096)(compile_expression)
"""Every run asks for the same formulas."""


def evaluate(formula: str, cov: Covariates, rows: int) -> Array:
    """Value of a formula (for k = 1, where it has one), shape (rows,)."""
    past = {REMEMBERED: lambda _, x, tau: lagged(x, np.asarray(cov["time_s"], dtype=float), tau)}
    value = _compiled(formula).evaluate({**cov, **past, "k": 1.0})
    return np.broadcast_to(np.asarray(value, dtype=float), (rows,))


class _Builder:
    """Collects factors that vary in the runs, with their values."""

    def __init__(self, covariates: Sequence[Mapping[str, Any]]) -> None:
        self.runs = covariates
        self.factors: list[Factor] = []
        self.values: list[Values] = []

    def has(self, name: str) -> bool:
        return all(name in run for run in self.runs)

    def raw(self, name: str) -> list[Array]:
        return [np.broadcast_to(np.asarray(run[name], dtype=float), np.shape(run["time_s"])) for run in self.runs]

    def size(self, name: str) -> list[Array]:
        return [np.abs(x) for x in self.raw(name)]

    def add(self, name: str, text: str, symbol: str, rank: int = 0, **more: Any) -> None:
        """A factor; one of the first pass only where it varies."""
        factor = Factor(name, text, symbol, rank, **more)
        values = self.evaluated(text)
        if not factor.fine:  # most of the others are never looked at
            found = values()
            if not np.ptp(np.concatenate(found)):
                return
        self.factors.append(factor)
        self.values.append(values)

    def evaluated(self, text: str) -> Values:
        """The values of a formula in every run, once they are asked for."""

        @cache
        def values() -> list[Array]:
            runs = (evaluate(text, run, len(run["time_s"])) for run in self.runs)
            return [np.nan_to_num(one, nan=0.0, posinf=0.0, neginf=0.0) for one in runs]

        return values

    def family(
        self,
        name: str,
        text: str,
        symbol: str,
        rank: int,
        numbers: Sequence[float] | Array,
        coarse: Sequence[float],
        *,
        kind: str = "",
        more: tuple[float, ...] = (),
        alone: bool = False,
    ) -> None:
        """Factors that differ in one number, # in their text; those nearest to `coarse` enter the first pass."""
        numbers = sorted({n for n in (_round(float(n)) for n in numbers) if np.isfinite(n)})
        first = {min(numbers, key=lambda n: abs(n - c)) for c in coarse} if numbers else set()
        own = kind or f"{name} {text}"

        def told(n: float) -> tuple[str, str, str]:
            return name, _with(n, text), _with(n, symbol)

        def another(n: float) -> tuple[Factor, Values]:
            numbers, new = (n, *more), told(n)
            factor = Factor(*new, rank, kind=own, numbers=numbers, fine=True, alone=alone, halved=True, another=another)
            return factor, self.evaluated(new[1])

        for n in numbers:
            self.add(*told(n), rank, kind=own, numbers=(n, *more), fine=n not in first, alone=alone, another=another)

    def powers(self, name: str, text: str, symbol: str, powers: Sequence[int], fine: bool = False) -> None:
        """Powers of a quantity; with `fine`, those between them too, for the second pass alone."""
        kind = f"{name} {text}**#"
        for power in powers:
            shown = symbol if power == 1 else f"{symbol}{'⁰¹²³'[power]}"
            written = text if power == 1 else f"{text}**{power}"
            self.add(name, written, shown, power - 1, kind=kind, numbers=(power,))
        for part in (0.5, 0.7, 1.5) if fine else ():
            self.add(name, f"{text}**{part:g}", f"{symbol}^{part:g}", 2, kind=kind, numbers=(part,), fine=True)

    def beyond(self, name: str, coarse: Sequence[float], above: bool = True) -> None:
        """Parts of a quantity above values that the runs hold, or below, which bend into what is switched on there."""
        symbol, kind = SYMBOLS.get(name, name), f"{name} above {above}"
        every = np.concatenate(self.raw(name))
        levels = _levels(every)
        bends = [level for level in levels if _round(float(level)) or np.min(every) < 0.0]  # above 0 it is itself
        ramps = (f"{name} - #", f"{symbol} − #") if above else (f"# - {name}", f"# − {symbol}")
        self.family(name, f"max({ramps[0]}, 0)", f"({ramps[1]})₊", 1, bends, coarse, kind=kind, more=(0.0,))
        than = ">" if above else "<"
        step = (f"({name} {than} #)", f"[{symbol} {than} #]")
        self.family(name, *step, 1, levels, (), kind=kind, more=(1.0,))
        bent = (f"max({ramps[0]}, 0)**1.5", f"({ramps[1]})₊^1.5")
        self.family(name, *bent, 2, bends, (), kind=kind, more=(0.5,))

    def about_thresholds(self, name: str) -> None:
        """Parts above and below values that the runs hold; a temperature in degC has no zero of its own."""
        low, high, last = (float(q) for q in np.quantile(np.concatenate(self.raw(name)), (0.35, 0.65, 0.99)))
        self.beyond(name, (low, high))
        self.beyond(name, (low, high, last), above=False)

    def late(self, name: str, text: str, symbol: str) -> None:
        """First-order memories of a quantity: what follows it, and what runs on after it."""
        of = f"{name} memory"
        self.family(of, f"lag({text}, #)", f"{symbol} lagged # s", 2, LAGS_S, (8.0, 50.0))
        runs_on = (f"max(lag({text}, #) - {text}, 0)", f"({symbol} lagged # s − {symbol})₊")
        self.family(of, *runs_on, 3, LAGS_S, (5.0, 30.0))


def _quantiles(values: Sequence[Array], parts: Sequence[float] | Array) -> list[float]:
    every = np.concatenate([v[v > 0.0] for v in values])
    return [_round(float(q)) for q in np.quantile(every, parts)] if len(every) else [0.0 for _ in parts]


def _levels(values: Array) -> list[float]:
    """Thresholds where most of the rows lie, and out to where few do."""
    first, last = (float(q) for q in np.quantile(values, (0.01, 0.99)))
    return [*np.quantile(values, TENTHS), *np.linspace(first, last, EVENLY)]


def _round(value: float) -> float:
    return float(f"{value:.2g}")


def make_grammar(covariates: Sequence[Covariates], skip: Set[str] = frozenset(), *, clocks: bool = True) -> Grammar:
    """The factors that these runs allow.

    `covariates`: covariates of each run at its raw rate, with those that follow from the log (``accel_m_s2``,
    ``moving_time_s``, ``on_time_<component>_s``). `skip`: columns beyond the glossary that no law reads.
    """
    b = _Builder(covariates)
    names = sorted(set.intersection(*(set(run) for run in covariates)))
    if b.has("speed_m_s"):
        _speeds(b, "speed_m_s")
    if b.has("yaw_rate_rad_s"):
        _turning(b, "yaw_rate_rad_s")
    if b.has("lateral_speed_m_s"):
        b.powers("lateral_speed_m_s", "abs(lateral_speed_m_s)", "|u|", (1, 2), fine=True)
    for name in ("accel_m_s2", "slope_rad"):
        if b.has(name):  # one-sided parts, size and square of what goes both ways
            symbol = SYMBOLS[name]
            low, high = np.quantile(np.concatenate(b.raw(name)), (0.01, 0.99))
            # one side alone may be no more than the sensor's noise, which then tells level ground from slopes
            if high > -NOISE_PART * low:
                b.add(name, f"max({name}, 0)", f"{symbol}₊")
            if -low > NOISE_PART * high:
                b.add(name, f"max(-{name}, 0)", f"{symbol}₋", gives_back=True)
            b.add(name, f"abs({name})", f"|{symbol}|", 1)
            b.add(name, f"{name}**2", f"{symbol}²", 1)
    if b.has("payload_kg"):
        b.powers("payload_kg", "payload_kg", "payload", (1, 2), fine=True)
        b.add("payload_kg", "(payload_kg > 0)", "[payload > 0]", 1)
        b.beyond("payload_kg", _quantiles(b.raw("payload_kg"), (0.5,)))
    for name in ("temp_ambient_c", "temp_motor_c"):
        if b.has(name):
            b.about_thresholds(name)
    if b.has("cpu_load"):
        b.powers("cpu_load", "cpu_load", "load", (1, 2), fine=True)
        b.family("cpu_load", "tanh(cpu_load / #)", "tanh(load/#)", 2, SATURATES, (0.3,))
        b.beyond("cpu_load", (0.5,))
        b.late("cpu_load", "cpu_load", "load")
    if b.has("speed_m_s") and b.has("heading_rad"):  # a field that leans one way, drag in a slow current or wind
        for power, shown in (("", "v"), ("**2", "v²")):
            leans = (f"abs(speed_m_s){power} * cos(heading_rad - #)", f"{shown}·cos(heading − #)")
            b.family("heading_rad", *leans, 2, AROUND, AROUND[::3], alone=True)
    for name, powers in (("cpu_freq_hz", (1, 3)), ("access_point_distance_m", (1, 2)), ("time_s", (1,))):
        if b.has(name) and (clocks or name != "time_s"):
            b.powers(name, name, SYMBOLS[name], powers)
    if b.has("access_point_distance_m"):
        b.beyond("access_point_distance_m", _quantiles(b.raw("access_point_distance_m"), (0.5,)))
    if clocks and b.has("moving_time_s"):
        for tau in (60.0, 240.0):
            b.add("moving_time_s", f"exp(-moving_time_s / {tau:g})", f"exp(−t_moving/{tau:g} s)", 2)
    for name in names:
        if name.startswith("on_") and not name.startswith("on_time_"):
            _switched(b, name, clocks)
    further = 0
    for name in names:
        if name in SYMBOLS or name in skip or name.startswith(("on_", "starting_")) or name == "heading_rad":
            continue
        if not may_be_cause(name) or not name.isidentifier():
            continue  # the last of these: a formula cannot name it
        value = covariates[0][name]
        if is_text(value):  # one factor for each text, where these are few
            labels = [run[name] for run in b.runs if isinstance(run[name], Labels)]
            used = sorted({label.names[int(i)] for label in labels for i in np.unique(label.codes) if i >= 0})
            for text in used if 2 <= len(used) <= MOST_LEVELS else ():
                if "'" not in text:
                    b.add(name, f"({name} == '{text}')", f"[{name} {text}]")
        elif np.shape(value) == np.shape(covariates[0]["time_s"]) and column_of(name) is None:
            further += 1
            if further <= MOST_FURTHER:
                (b.about_thresholds if TEMPERATURE.search(name) else partial(_further, b))(name)
    warm = [name for name in names if name.isidentifier() and TEMPERATURE.search(name) and name not in skip][:MOST_WARM]
    for name, other in permutations(warm, 2):  # what heats or cools works against a difference
        b.add(name, f"max({name} - {other}, 0)", f"({name} − {other})₊", 2)
    return Grammar(tuple(b.factors), tuple(b.values))


def _with(number: float, text: str) -> str:
    """A text with a number for its #; what takes a negative one away adds."""
    for minus in "-−" if number < 0.0 else "":
        text = text.replace(f"{minus} #", f"+ {-number:g}")
    return text.replace("#", f"{number:g}")


def _speeds(b: _Builder, name: str) -> None:
    v, text = b.size(name), f"abs({name})"
    b.powers(name, text, "v", (1, 2, 3), fine=True)
    moves = f"({text} >= {STILL_SPEED_M_S:g})"
    if b.has("yaw_rate_rad_s"):
        moves = f"({text} >= {STILL_SPEED_M_S:g} or abs(yaw_rate_rad_s) >= {STILL_YAW_RATE_RAD_S:g})"
    b.add(name, moves, "[moving]", 1)
    b.add(name, f"(1 - {moves})", "[still]", 1)
    gate = _round(0.05 * max((float(np.max(x, initial=0.0)) for x in v), default=0.0))
    b.add(name, f"({text} > {gate:g})", "[driving]", 1)
    b.add(name, f"({text} <= {gate:g})", "[not driving]", 1)
    if max(float(np.quantile(-x, 0.99)) for x in b.raw(name)) > gate > 0.0:
        b.add(name, f"max(-{name}, 0)", "v₋", 1)
        b.add(name, f"({name} < -{gate:g})", "[backward]", 1)
    driven = [np.where(x > gate, x, 0.0) for x in v]
    levels = _quantiles(driven, TENTHS)
    low, middle, high = _quantiles(driven, (0.25, 0.5, 0.75))
    if low <= 0.0:
        return
    # what rises from a speed on, or is there from it on as a gait or a gear is
    above, ramps = f"{name} above", _levels(np.concatenate([x[x > 0.0] for x in driven]))
    steps = [*ramps, *0.5 * np.add(levels[1:], levels[:-1])]
    b.family(name, f"max({text} - #, 0)", "(v − #)₊", 2, ramps, (middle, high), kind=above, more=(0.0,))
    b.family(name, f"({text} > #)", "[v > #]", 2, steps, (), kind=above, more=(1.0,))
    b.family(name, f"tanh({text} / #)", "tanh(v/#)", 2, low * BENDS_AT, (low,))
    falling = (f"{moves} * exp(-{text} / #)", "[moving]·exp(−v/#)")
    b.family(name, *falling, 2, low * BENDS_AT, (0.5 * low,))
    for part, first in WIDTHS.items():  # a resonance at speeds that lie close beside each other
        width = _round(part * high)
        at = [*levels, *np.arange(levels[0], levels[-1], 0.25 * width)]
        bump = f"exp(-((abs({name}) - #) / {width:g})**2)"
        b.family(name, bump, "bump(v at #)", 3, at, _quantiles(driven, first), kind=f"{name} bump", more=(width,))
    b.late(name, text, "v")


def _turning(b: _Builder, name: str) -> None:
    w, text = b.size(name), f"abs({name})"
    b.powers(name, text, "|ω|", (1, 2), fine=True)
    gate = _round(0.1 * max((float(np.quantile(x, 0.99)) for x in w if len(x)), default=0.0))
    if gate <= 0.0:
        return
    turned = [np.where(x > gate, x, 0.0) for x in w]
    low, middle, high = _quantiles(turned, (0.25, 0.5, 0.75))
    b.add(name, f"({text} > {gate:g})", "[turning]", 1)
    b.family(name, f"tanh({text} / #)", "tanh(|ω|/#)", 2, low * BENDS_AT, (low,))
    levels = _levels(np.concatenate([x[x > 0.0] for x in turned]))
    b.family(name, f"max({text} - #, 0)", "(|ω| − #)₊", 2, levels, (middle, high))


def _further(b: _Builder, name: str) -> None:
    """A numeric column that the glossary does not hold: itself, and its parts above and below the middle."""
    x = b.raw(name)
    middle = float(np.median(np.concatenate(x)))
    low = min(float(np.min(a, initial=0.0)) for a in x)
    if low > -NOISE_PART * max(float(np.max(a, initial=0.0)) for a in x):
        # noise about zero has no powers
        b.powers(name, name if low >= 0.0 else f"max({name}, 0)", name, (1, 2), fine=True)
    else:
        b.add(name, name, name)
        b.add(name, f"abs({name})", f"|{name}|", 1)
    b.beyond(name, (middle,))
    b.beyond(name, (middle,), above=False)
    # an actuator takes power while it moves, not where it stands: a steering, an arm, a mast, which lifts one way
    rate = f"({name} - lag({name}, {RATE_S:g})) / {RATE_S:g}"
    b.add(name, f"abs({rate})", f"|d{name}/dt|", 2, alone=True)
    if b.has("speed_m_s"):  # as wheels that are steered on the spot
        still = f"(abs(speed_m_s) < {STILL_SPEED_M_S:g})"
        b.add(name, f"abs({rate}) * {still}", f"|d{name}/dt|·[still]", 2, alone=True)
    b.add(name, f"max({rate}, 0)", f"(d{name}/dt)₊", 2, alone=True)
    if b.has("payload_kg"):
        b.add(name, f"payload_kg * max({rate}, 0)", f"m_payload·(d{name}/dt)₊", 2, alone=True)
    if name.endswith("_m_s") and b.has("speed_m_s"):  # a wind along the way: drag goes by the speed through the air
        for sign, shown in (("+", "+"), ("-", "−")):
            through = f"(abs(speed_m_s) {sign} {name})"
            b.add(name, f"{through} * abs{through}", f"(v {shown} {name})·|v {shown} {name}|", 2)
        if b.has("heading_rad"):  # one from a direction of the compass
            through, shown = f"(abs(speed_m_s) + {name} * cos(heading_rad - #))", f"(v + {name}·cos(heading − #))"
            drag = (f"abs(speed_m_s) * {through} * abs{through}", f"v·{shown}·|{shown[1:-1]}|")
            b.family(name, *drag, 2, AROUND, AROUND[::3], alone=True)


def _switched(b: _Builder, name: str, clocks: bool) -> None:
    """A component that is on, and first-order memories of its being switched on.

    Where no run switches it, the time since then is the time since the run began under another name.
    """
    part = name[3:]
    b.add(name, name, f"[{part} on]")
    clock = f"on_time_{part}_s"
    if not clocks or not b.has(clock) or not any(len(np.unique(x[np.isfinite(x)])) > 1 for x in b.raw(name)):
        return
    for tau in WARM_S:
        warming = f"{name} * (1 - exp(-{clock} / {tau:g}))"
        b.add(name, warming, f"[{part} on]·(1 − exp(−t_on/{tau:g} s))", 2)

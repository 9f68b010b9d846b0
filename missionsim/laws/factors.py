"""The factors that some logs allow, with their values: powers, sides, thresholds, gates, memories, levels."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence, Set
from dataclasses import replace
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.covariates import Covariates, is_text
from missionsim.glossary import STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S, column_of
from missionsim.labels import Labels
from missionsim.laws.grammar import Factor, Grammar
from missionsim.physics import Array
from missionsim.physics.lag import lagged
from missionsim.runs.covariates import may_be_cause

MOST_LEVELS = 6
MOST_FURTHER = 6
"""Columns beyond the glossary that enter; more would make chance finds of any share."""
LAGS_S = (3.0, 5.0, 8.0, 13.0, 20.0, 30.0, 50.0, 80.0, 130.0)
WARM_S = (30.0, 120.0)
VARIES = 1e-9
TEMPERATURE = re.compile(r"^temp_|_temp(erature)?(_|$)|_deg_?[cf]$")
WIDTHS = {0.2: (0.5, 0.75), 0.1: (), 0.4: ()}
"""Widths of a resonance in parts of a fast drive's speed, with the quantiles of speed that enter the first pass."""
SATURATES = np.array([0.1, 0.2, 0.3, 0.4, 0.6, 0.9])
"""Loads of a processor at which its power may level off."""
BENDS_AT = np.array([0.2, 0.3, 0.45, 0.7, 1.0, 1.5, 2.2])
"""The same of a speed and a turn rate, in parts of a slow one."""
EVENLY = 15
"""Thresholds between the lowest and the highest value that the runs hold."""
NOISE_PART = 0.1
"""A quantity that falls below zero by less than this part of its highest value is noise about zero."""
SYMBOLS = {
    "speed_m_s": "v",
    "yaw_rate_rad_s": "ω",
    "lateral_speed_m_s": "u",
    "accel_m_s2": "a",
    "slope_rad": "θ",
    "payload_kg": "payload",
    "temp_ambient_c": "T",
    "temp_motor_c": "T_motor",
    "cpu_load": "load",
    "cpu_freq_hz": "f",
    "access_point_distance_m": "d",
    "time_s": "t",
    "moving_time_s": "t_moving",
}


class _Builder:
    """Collects factors that vary in the runs, with their values."""

    def __init__(self, covariates: Sequence[Mapping[str, Any]]) -> None:
        self.runs = covariates
        self.factors: list[Factor] = []
        self.values: list[Callable[[], Sequence[Array]]] = []

    def has(self, name: str) -> bool:
        return all(name in run for run in self.runs)

    def raw(self, name: str) -> list[Array]:
        return [np.broadcast_to(np.asarray(run[name], dtype=float), np.shape(run["time_s"])) for run in self.runs]

    def add(self, factor: Factor, values: Sequence[NDArray[Any]]) -> None:
        clean = [np.nan_to_num(np.asarray(v, dtype=float), nan=0.0, posinf=0.0, neginf=0.0) for v in values]
        size = max((float(np.max(np.abs(v), initial=0.0)) for v in clean), default=0.0)
        if (size > 0.0 and any(float(np.ptp(v)) > VARIES * size for v in clean)) or _differs(clean, size):
            self.factors.append(factor)
            self.values.append(lambda: clean)

    def family(
        self,
        factor: Callable[[str], Factor],
        form: Callable[[Array, float], Array],
        x: Sequence[Array],
        numbers: Sequence[float] | Array,
        coarse: Sequence[float],
    ) -> None:
        """Factors that differ in one number; those nearest to `coarse` enter the first pass."""
        numbers = sorted({n for n in (_round(float(n)) for n in numbers) if np.isfinite(n)})
        first = {min(numbers, key=lambda n: abs(n - c)) for c in coarse} if numbers else set()
        for n in numbers:
            one = factor(f"{n:g}")
            one = replace(one, kind=one.kind or f"{one.variable} {factor('#').text}", numbers=(n, *one.numbers))
            if n in first:
                self.add(one, [form(v, n) for v in x])
            else:  # most of these are never looked at
                self.factors.append(replace(one, fine=True))
                self.values.append(cache(partial(_family, form, x, n)))

    def quantiles(self, values: Sequence[Array], *parts: float) -> list[float]:
        every = np.concatenate([v[v > 0.0] for v in values])
        return [_round(float(q)) for q in np.quantile(every, parts)] if len(every) else [0.0 for _ in parts]


def _saturates(b: _Builder, name: str, text: str, symbol: str, x: Sequence[Array], at: Array, first: float) -> None:
    def factor(n: str) -> Factor:
        return Factor(name, f"tanh({text} / {n})", f"tanh({symbol}/{n})", 2)

    b.family(factor, lambda v, n: np.asarray(np.tanh(v / n)), x, at, (first,))


def _family(form: Callable[[Array, float], Array], x: Sequence[Array], n: float) -> list[Array]:
    return [np.nan_to_num(form(v, n), nan=0.0, posinf=0.0, neginf=0.0) for v in x]


def _may_enter(name: str) -> bool:
    return may_be_cause(name) and name != "heading_rad" and not name.startswith("starting_")


def _differs(values: Sequence[Array], size: float) -> bool:
    means = [float(np.mean(v)) for v in values]
    return size > 0.0 and float(np.ptp(means)) > VARIES * size


def _round(value: float) -> float:
    return float(f"{value:.2g}")


def make_grammar(covariates: Sequence[Covariates], skip: Set[str] = frozenset(), *, clocks: bool = True) -> Grammar:
    """The factors that these runs allow.

    `covariates`: covariates of each run at its raw rate, with those that follow from the log (``accel_m_s2``,
    ``moving_time_s``, ``on_time_<component>_s``). `skip`: columns beyond the glossary that no law reads.
    """
    b = _Builder(covariates)
    names = sorted(set.intersection(*(set(run) for run in covariates)))
    _speeds(b, "speed_m_s")
    _turning(b)
    if b.has("lateral_speed_m_s"):
        u = [np.abs(x) for x in b.raw("lateral_speed_m_s")]
        _powers(b, "lateral_speed_m_s", "abs(lateral_speed_m_s)", "|u|", u, (1, 2))
    _signed(b, "accel_m_s2")
    _signed(b, "slope_rad")
    if b.has("payload_kg"):
        m = b.raw("payload_kg")
        _powers(b, "payload_kg", "payload_kg", "payload", m, (1, 2), fine=True)
        b.add(Factor("payload_kg", "(payload_kg > 0)", "[payload > 0]", 1), [x > 0.0 for x in m])
        _beyond(b, "payload_kg", b.quantiles(m, 0.5))
    for name in ("temp_ambient_c", "temp_motor_c"):
        _about_thresholds(b, name)
    if b.has("cpu_load"):
        load = b.raw("cpu_load")
        _powers(b, "cpu_load", "cpu_load", "load", load, (1, 2), fine=True)
        _saturates(b, "cpu_load", "cpu_load", "load", load, SATURATES, 0.3)
        _beyond(b, "cpu_load", (0.5,))
        _late(b, "cpu_load", "cpu_load", "load", load)
    for name, powers in (("cpu_freq_hz", (1, 3)), ("access_point_distance_m", (1, 2)), ("time_s", (1,))):
        if b.has(name) and (clocks or name != "time_s"):
            _powers(b, name, name, SYMBOLS[name], b.raw(name), powers)
    if b.has("access_point_distance_m"):
        _beyond(b, "access_point_distance_m", b.quantiles(b.raw("access_point_distance_m"), 0.5))
    if clocks and b.has("moving_time_s"):
        clock = b.raw("moving_time_s")
        for tau in (60.0, 240.0):
            text = f"exp(-moving_time_s / {tau:g})"
            symbol = f"exp(−t_moving/{tau:g} s)"
            b.add(Factor("moving_time_s", text, symbol, 2), [np.exp(-x / tau) for x in clock])
    for name in names:
        if name.startswith("on_") and not name.startswith("on_time_"):
            _switched(b, name, clocks)
    known = {"speed_m_s", "yaw_rate_rad_s", "accel_m_s2", *SYMBOLS}
    further = 0
    for name in names:
        if name in (known | skip) or name.startswith("on_") or not _may_enter(name) or not name.isidentifier():
            continue  # the last of these: a formula cannot name it
        value = covariates[0][name]
        if is_text(value):
            _levels(b, name)
        elif (
            np.shape(value) == np.shape(covariates[0]["time_s"]) and further < MOST_FURTHER and column_of(name) is None
        ):
            further += 1
            (_about_thresholds if TEMPERATURE.search(name) else _further)(b, name)
    return Grammar(tuple(b.factors), tuple(b.values))


def _powers(
    b: _Builder, name: str, text: str, symbol: str, x: Sequence[Array], powers: Sequence[int], fine: bool = False
) -> None:
    """Powers of a quantity; with `fine`, those between them too, for the second pass alone."""
    kind = f"{name} {text}**#"
    for power in powers:
        shown = symbol if power == 1 else f"{symbol}{'⁰¹²³'[power]}"
        one = Factor(name, text if power == 1 else f"{text}**{power}", shown, power - 1, kind=kind, numbers=(power,))
        b.add(one, [v**power for v in x])
    for part in (0.5, 0.7, 1.5) if fine else ():
        between = Factor(name, f"{text}**{part:g}", f"{symbol}^{part:g}", 2, kind=kind, numbers=(part,), fine=True)
        b.add(between, [np.abs(v) ** part for v in x])


def _speeds(b: _Builder, name: str) -> None:
    if not b.has(name):
        return
    v = [np.abs(x) for x in b.raw(name)]
    text = f"abs({name})"
    _powers(b, name, text, "v", v, (1, 2, 3), fine=True)
    turning = [np.abs(x) for x in b.raw("yaw_rate_rad_s")] if b.has("yaw_rate_rad_s") else [0.0 * x for x in v]
    moves = f"({text} >= {STILL_SPEED_M_S:g})"
    if b.has("yaw_rate_rad_s"):
        moves = f"({text} >= {STILL_SPEED_M_S:g} or abs(yaw_rate_rad_s) >= {STILL_YAW_RATE_RAD_S:g})"
    on = [(x >= STILL_SPEED_M_S) | (w >= STILL_YAW_RATE_RAD_S) for x, w in zip(v, turning, strict=True)]
    b.add(Factor(name, moves, "[moving]", 1), on)
    b.add(Factor(name, f"(1 - {moves})", "[still]", 1), [~x for x in on])
    top = max((float(np.max(x, initial=0.0)) for x in v), default=0.0)
    gate = _round(0.05 * top)
    b.add(Factor(name, f"({text} > {gate:g})", "[driving]", 1), [x > gate for x in v])
    b.add(Factor(name, f"({text} <= {gate:g})", "[not driving]", 1), [x <= gate for x in v])
    back = [-x for x in b.raw(name)]
    if max(float(np.quantile(x, 0.99)) for x in back) > gate > 0.0:
        b.add(Factor(name, f"max(-{name}, 0)", "v₋", 1), [np.maximum(x, 0.0) for x in back])
        b.add(Factor(name, f"({name} < -{gate:g})", "[backward]", 1), [x > gate for x in back])
    driven = [np.where(x > gate, x, 0.0) for x in v]
    levels = b.quantiles(driven, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9)
    low, middle, high = b.quantiles(driven, 0.25, 0.5, 0.75)
    if low <= 0.0:
        return
    b.family(
        lambda n: Factor(name, f"max({text} - {n}, 0)", f"(v − {n})₊", 2),
        lambda x, n: np.maximum(x - n, 0.0),
        v,
        levels,
        (middle, high),
    )
    _saturates(b, name, text, "v", v, low * BENDS_AT, low)
    b.family(
        lambda n: Factor(name, f"{moves} * exp(-{text} / {n})", f"[moving]·exp(−v/{n})", 2),
        lambda x, n: x[0] * np.exp(-x[1] / n),
        [np.vstack([o, x]) for o, x in zip(on, v, strict=True)],
        low * BENDS_AT,
        (0.5 * low,),
    )
    for part, first in WIDTHS.items():
        _bumps(b, name, v, _round(part * high), levels, b.quantiles(driven, *first))
    _late(b, name, text, "v", v)


def _late(b: _Builder, name: str, text: str, symbol: str, x: Sequence[Array]) -> None:
    """First-order memories of a quantity: what follows it, and what runs on after it."""
    past, of = [np.vstack([a, run["time_s"]]) for a, run in zip(x, b.runs, strict=True)], f"{name} memory"
    b.family(
        lambda n: Factor(of, f"lag({text}, {n})", f"{symbol} lagged {n} s", 2),
        lambda a, n: lagged(a[0], a[1], n),
        past,
        LAGS_S,
        (8.0, 50.0),
    )
    b.family(
        lambda n: Factor(of, f"max(lag({text}, {n}) - {text}, 0)", f"({symbol} lagged {n} s − {symbol})₊", 3),
        lambda a, n: np.maximum(lagged(a[0], a[1], n) - a[0], 0.0),
        past,
        LAGS_S,
        (5.0, 30.0),
    )


def _bumps(
    b: _Builder, name: str, x: Sequence[Array], width: float, levels: Sequence[float], coarse: Sequence[float]
) -> None:
    """A resonance of one width at speeds that lie close beside each other."""
    fine = np.arange(levels[0], levels[-1], 0.25 * width)
    b.family(
        lambda n: Factor(
            name,
            f"exp(-((abs({name}) - {n}) / {width:g})**2)",
            f"bump(v at {n})",
            3,
            kind=f"{name} bump",
            numbers=(width,),
        ),
        lambda v, n: np.exp(-(((v - n) / width) ** 2)),
        x,
        [*levels, *fine],
        coarse,
    )


def _turning(b: _Builder) -> None:
    name = "yaw_rate_rad_s"
    if not b.has(name):
        return
    w = [np.abs(x) for x in b.raw(name)]
    text = f"abs({name})"
    _powers(b, name, text, "|ω|", w, (1, 2), fine=True)
    top = max((float(np.quantile(x, 0.99)) for x in w if len(x)), default=0.0)
    gate = _round(0.1 * top)
    if gate <= 0.0:
        return
    turned = [np.where(x > gate, x, 0.0) for x in w]
    low, middle, high = b.quantiles(turned, 0.25, 0.5, 0.75)
    b.add(Factor(name, f"({text} > {gate:g})", "[turning]", 1), [x > gate for x in w])
    _saturates(b, name, text, "|ω|", w, low * BENDS_AT, low)
    b.family(
        lambda n: Factor(name, f"max({text} - {n}, 0)", f"(|ω| − {n})₊", 2),
        lambda x, n: np.maximum(x - n, 0.0),
        w,
        b.quantiles(turned, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9),
        (middle, high),
    )


def _signed(b: _Builder, name: str) -> None:
    """One-sided parts, size and square of a quantity that goes both ways."""
    if not b.has(name):
        return
    x = b.raw(name)
    symbol = SYMBOLS[name]
    b.add(Factor(name, f"max({name}, 0)", f"{symbol}₊"), [np.maximum(a, 0.0) for a in x])
    b.add(Factor(name, f"max(-{name}, 0)", f"{symbol}₋", gives_back=True), [np.maximum(-a, 0.0) for a in x])
    b.add(Factor(name, f"abs({name})", f"|{symbol}|", 1), [np.abs(a) for a in x])
    b.add(Factor(name, f"{name}**2", f"{symbol}²", 1), [a**2 for a in x])


def _about_thresholds(b: _Builder, name: str) -> None:
    """Parts above and below values that the runs hold; a temperature in degC has no zero of its own."""
    if b.has(name):
        low, high, last = (float(q) for q in np.quantile(np.concatenate(b.raw(name)), (0.35, 0.65, 0.99)))
        _beyond(b, name, (low, high))
        _beyond(b, name, (low, high, last), above=False)


def _beyond(b: _Builder, name: str, coarse: Sequence[float], above: bool = True) -> None:
    """Parts of a quantity above values that the runs hold, or below them, which bend into what is switched on there."""
    symbol, kind, sign = SYMBOLS.get(name, name), f"{name} above {above}", 1.0 if above else -1.0
    x = b.raw(name)
    every = np.concatenate(x)
    # where most of the rows lie, and out to where few do
    first, last = (float(q) for q in np.quantile(every, (0.01, 0.99)))
    levels = [*np.quantile(every, np.linspace(0.1, 0.9, 9)), *np.linspace(first, last, EVENLY)]

    def ramp(n: str) -> Factor:
        text, told = (f"{name} - {n}", f"{symbol} − {n}") if above else (f"{n} - {name}", f"{n} − {symbol}")
        return Factor(name, f"max({text}, 0)", f"({told})₊", 1, kind=kind, numbers=(0.0,))

    def step(n: str) -> Factor:
        than = ">" if above else "<"
        return Factor(name, f"({name} {than} {n})", f"[{symbol} {than} {n}]", 1, kind=kind, numbers=(1.0,))

    b.family(ramp, lambda a, n: np.maximum(sign * (a - n), 0.0), x, levels, coarse)
    b.family(step, lambda a, n: (sign * (a - n) > 0.0).astype(float), x, levels, ())


def _further(b: _Builder, name: str) -> None:
    """A numeric column that the glossary does not hold: itself, and its parts above and below the middle."""
    x = b.raw(name)
    middle = float(np.median(np.concatenate(x)))
    low = min(float(np.min(a, initial=0.0)) for a in x)
    if low > -NOISE_PART * max(float(np.max(a, initial=0.0)) for a in x):
        text = name if low >= 0.0 else f"max({name}, 0)"  # noise about zero has no powers
        _powers(b, name, text, name, [np.maximum(a, 0.0) for a in x], (1, 2), fine=True)
    else:
        b.add(Factor(name, name, name), x)
        b.add(Factor(name, f"abs({name})", f"|{name}|", 1), [np.abs(a) for a in x])
    _beyond(b, name, (middle,))
    _beyond(b, name, (middle,), above=False)


def _switched(b: _Builder, name: str, clocks: bool) -> None:
    """A component that is on, and first-order memories of its being switched on.

    Where no run switches it, the time since then is the time since the run began under another name.
    """
    part = name[3:]
    on = b.raw(name)
    b.add(Factor(name, name, f"[{part} on]"), on)
    clock = f"on_time_{part}_s"
    if not clocks or not b.has(clock) or not any(len(np.unique(x[np.isfinite(x)])) > 1 for x in on):
        return
    since = b.raw(clock)
    for tau in WARM_S:
        b.add(
            Factor(name, f"{name} * (1 - exp(-{clock} / {tau:g}))", f"[{part} on]·(1 − exp(−t_on/{tau:g} s))", 2),
            [o * (1.0 - np.exp(-t / tau)) for o, t in zip(on, since, strict=True)],
        )


def _levels(b: _Builder, name: str) -> None:
    """One factor for each text of a column, where these are few."""
    used = sorted({text for run in b.runs for text in _texts(run[name])})
    if not 2 <= len(used) <= MOST_LEVELS:
        return
    for text in used:
        if "'" in text:
            continue
        rows = [_equals(run[name], text) for run in b.runs]
        b.add(Factor(name, f"({name} == '{text}')", f"[{name} {text}]", 0), rows)


def _texts(value: Any) -> set[str]:
    return {value.names[int(i)] for i in np.unique(value.codes) if i >= 0} if isinstance(value, Labels) else set()


def _equals(value: Any, text: str) -> NDArray[np.bool_]:
    return np.asarray(value.equals(text)) if isinstance(value, Labels) else np.asarray(value) == text

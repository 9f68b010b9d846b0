"""Doubts about a log that is well formed: wrong units and signs, columns that disagree, sensors that stand still.

Nothing is converted here: a value off by a thousand is told, and the user's map converts it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from missionsim.errors import did_you_mean
from missionsim.glossary import COLUMNS, STILL_SPEED_M_S, STILL_YAW_RATE_RAD_S, column_of
from missionsim.labels import Labels
from missionsim.logs.clean import Rows
from missionsim.logs.codes import refreshes
from missionsim.physics import Array, Bools

SAMPLE = 100_000
"""Rows that the statistical checks look at: one stretch from the start of the table."""
_LEFT = "left as it is; a map converts it"
_REST_BAND = 5.0
"""Rows within so many times the limits of standing still are at rest if they hop over the limits again and again."""

_SLOW_STEP_S = 60.0
"""A mobile robot's log has a row every few seconds at least; beyond this the times may be milliseconds."""

_FORCES_N = (150.0, 20_000.0)
"""Power over speed of cars and trucks [N]; milliwatts or millimetres are far outside."""
_GOES_ALONG = 0.2
"""Correlation of power and speed from which on one goes with the other (assumed)."""

_RATIOS = {
    "1,000": 1e3, "1/1,000": 1e-3, "1,000,000": 1e6, "1/1,000,000": 1e-6, "3,600": 3600.0, "1/3,600": 1 / 3600.0,
    "3.6 (km/h)": 3.6, "1/3.6": 1 / 3.6, "57.3 (degrees)": 180 / np.pi, "1/57.3": np.pi / 180, "−1 (the sign)": -1.0,
    "60": 60.0, "1/60": 1 / 60.0, "100": 100.0,
}  # fmt: skip


def check_names(rows: Rows, known_batteries: tuple[str, ...] = (), known_components: tuple[str, ...] = ()) -> None:
    """Tell names that nearly are a glossary name, and batteries or components that the robot does not have."""
    plain, own = [column.name for column in COLUMNS if "<" not in column.name], "kept as a column of its own"
    for name in rows.columns:
        found = column_of(name)
        if found is None:
            near = did_you_mean(name, plain, 0.75)
            if near and near not in rows.columns:
                rows.remark("name", name, f"not a name of the glossary; did you mean {near}?", own)
            continue
        listed = f" (it has {', '.join(known_batteries)})"
        for what, known, more, action in (
            ("battery", known_batteries, listed, "kept, not compared"),
            ("component", known_components, "", own),
        ):
            if known and f"<{what}>" in found[0].name and found[1] not in known:
                near = did_you_mean(found[1], known)
                told = f"the robot has no {what} '{found[1]}'{more}" + (f"; did you mean {near}?" if near else "")
                rows.remark("name", name, told, action)


def check_magnitudes(rows: Rows, max_speed_m_s: float | None, power_w: Mapping[str, Array]) -> None:
    """Tell columns whose magnitude suggests another unit, and times whose steps do."""
    step = np.diff(rows.time[:SAMPLE])
    usual = float(np.median(step)) if len(step) >= 20 else 0.0
    if usual > _SLOW_STEP_S and float(np.quantile(step, 0.9)) < 3 * usual:  # many rows at an even pace
        told = f"steps of {usual:.4g} s, {rows.time[-1] / 3600.0:.4g} h in all; perhaps milliseconds"
        rows.remark("unit", "time_s", told, f"{_LEFT}: time_s: time_s / 1000")
    speed = rows.number("speed_m_s")
    fast = 0.0 if speed is None else float(np.quantile(np.abs(speed[:SAMPLE]), 0.95))
    most = max((float(np.quantile(np.abs(watt[:SAMPLE]), 0.95)) for watt in power_w.values()), default=0.0)
    # a great speed or power is that of a car where the force between both is one that a vehicle has
    a_car = 5.0 < fast < 45.0 and _FORCES_N[0] < most / fast < _FORCES_N[1]
    for name, data in rows.columns.items():
        if isinstance(data, Labels) or any(r.kind == "range" and r.column == name for r in rows.remarks):
            continue
        found = column_of(name)
        if found is None:
            continue
        large = float(np.quantile(np.abs(data[:SAMPLE]), 0.95))
        limit, perhaps = found[0].large, found[0].perhaps
        if name == "speed_m_s" and max_speed_m_s:
            limit, perhaps = 2.0 * max_speed_m_s, f"the robot drives {max_speed_m_s:g} m/s at most: km/h or mm/s"
        if large > limit and not (a_car and found[0].name in ("speed_m_s", "power_<battery>_w")):
            rows.remark("unit", name, f"the values reach {large:.4g} {found[0].unit}; perhaps {perhaps}", _LEFT)
        if name == "cpu_freq_hz" and 0 < large < 1e6:
            rows.remark("unit", name, f"the values reach only {large:.4g} Hz; perhaps MHz or GHz", _LEFT)
        if found[0].name == "voltage_<battery>_v" and 0 < large < 0.5:
            told = f"the values reach only {large:.4g} V; perhaps kilovolts or a wrong column"
            rows.remark("unit", name, told, _LEFT)


_REACH_M = 2.0
"""Positions that reach less far may be noise."""


def check_agreement(rows: Rows, batteries: Iterable[str]) -> None:
    """Compare what is said twice: power, V·I, energy; speed, path, acceleration; heading, yaw rate."""
    number = {name: data[:SAMPLE] for name, data in rows.columns.items() if not isinstance(data, Labels)}
    time = number["time_s"]
    second = max(1, round(1.0 / max(float(np.median(np.diff(time))), 1e-6)))  # rows of one
    speed = number.get("speed_m_s")
    for battery in batteries:
        power, energy = number.get(f"power_{battery}_w"), number.get(f"energy_{battery}_wh")
        volt, ampere = number.get(f"voltage_{battery}_v"), number.get(f"current_{battery}_a")
        product = volt * ampere if volt is not None and ampere is not None else None
        watt, column = (power, f"power_{battery}_w") if power is not None else (product, f"current_{battery}_a")
        mean = 0.0 if watt is None else float(watt.mean())
        if power is not None and product is not None:
            _ratio(rows, column, "voltage × current", mean, float(product.mean()))
        if energy is not None and watt is not None:
            span = (energy[-1] - energy[0]) * 3600.0 / (time[-1] - time[0])
            _ratio(rows, f"energy_{battery}_wh", "the sum of power", float(span), mean)
        if watt is not None and float(np.median(watt)) < 0 and mean < 0:
            told = f"the battery seems to be charged all the time (mean {mean:.4g} W); what it delivers is positive"
            severity = "error"
            # power goes up with the speed, as it does not where its sign is wrong
            moves = speed is not None and np.ptp(speed) > 0.0 and np.ptp(watt) > 0.0
            if speed is not None and moves and np.corrcoef(np.abs(speed), watt)[0, 1] > _GOES_ALONG:
                severity, told = "warning", f"{told}, and driving takes more: does the sun feed it? Log what does"
            rows.remark("sign", column, told, _LEFT, severity)
        if watt is None and energy is not None and energy[-1] < energy[0]:
            told = "the energy falls: it should be what was delivered so far, not what is left"
            rows.remark("sign", f"energy_{battery}_wh", told, _LEFT, "error")
    if speed is not None and {"x_m", "y_m"} <= number.keys():
        path = float(np.hypot(np.diff(number["x_m"][::second]), np.diff(number["y_m"][::second])).sum())
        driven = float(np.trapezoid(np.abs(speed), time))
        _ratio(rows, "speed_m_s", "the path of x_m, y_m", driven, path, loose=True)
        # no path is shorter than where it leads to; the quantiles leave out single fixes far away
        x, y = (np.quantile(number[axis], (0.05, 0.95)) for axis in ("x_m", "y_m"))
        reach = float(np.hypot(x[1] - x[0], y[1] - y[0]))
        if driven < 0.5 * reach > _REACH_M and not any(
            r.kind == "unit" and r.column == "speed_m_s" for r in rows.remarks
        ):
            told = (
                f"{driven:.3g} m were driven by it, while x_m, y_m reach {reach:.3g} m: a speed that nobody fills in?"
            )
            rows.remark("disagreement", "speed_m_s", told, "left as it is; a map can take the rate of the positions")
    yaw, heading = number.get("yaw_rate_rad_s"), number.get("heading_rad")
    if yaw is not None and heading is not None:
        full = 360.0 if float(np.ptp(heading)) > 4 * np.pi and float(np.abs(heading).max()) <= 360.0 else 2 * np.pi
        turned = float(np.abs(np.diff(np.unwrap(heading, period=full))).sum())
        summed = float(np.trapezoid(np.abs(yaw), time))
        _ratio(rows, "yaw_rate_rad_s", "the changes of heading_rad", summed, turned, loose=True)
    accel = number.get("accel_m_s2")
    if accel is not None and speed is not None and len(time) > 50:
        # over a second, for the noise of two successive speeds drowns their difference
        gained = np.r_[0.0, np.cumsum(0.5 * (accel[1:] + accel[:-1]) * np.diff(time))]
        logged, seen = gained[second:] - gained[:-second], speed[second:] - speed[:-second]
        logged, seen = logged - logged.mean(), seen - seen.mean()  # a sensor that is not level has a constant part
        strength, both = float(seen @ seen), float(logged @ seen)
        if strength > 0 and both**2 > 0.5 * strength * (logged @ logged):
            _ratio(rows, "accel_m_s2", "the changes of speed_m_s", both / strength, 1.0, loose=True)


def _ratio(rows: Rows, name: str, other: str, value: float, reference: float, loose: bool = False) -> None:
    if not (np.isfinite(value) and np.isfinite(reference)) or abs(reference) < 1e-9 or abs(value) < 1e-12:
        return
    ratio = value / reference
    spread = 1.35 if loose else 1.15
    near = {w: f for w, f in _RATIOS.items() if f * ratio > 0 and 1 / spread < ratio / f < spread}
    if near:
        told = f"{min(near, key=lambda one: abs(np.log(ratio / near[one])))} times {other}: another unit or sign?"
        if name == "accel_m_s2":
            told = f"{ratio:.2g} times {other}: another unit or sign of either (km/h, mph, g?), or of time_s?"
        rows.remark("unit", name, told, _LEFT, "error")
    elif not loose and not 0.8 < ratio < 1.25:
        rows.remark("disagreement", name, f"{ratio:.3g} times {other}", "left as it is")


def hardly_moves(speed: Array, turning: Array) -> Bools:
    """Rows near standing still, of magnitudes [m/s, rad/s]."""
    return np.asarray((speed < _REST_BAND * STILL_SPEED_M_S) & (turning < _REST_BAND * STILL_YAW_RATE_RAD_S))


def stretches(chosen: Bools) -> list[tuple[int, int]]:
    """First row of each stretch of chosen rows, and the row behind its last."""
    edges = np.flatnonzero(np.diff(np.r_[False, chosen, False])).tolist()
    return list(zip(edges[::2], edges[1::2], strict=True))


_SPIKE, _SPIKES = 10.0, 0.01
"""How many times what is usual a row alone has from which it is no start of a drive, and part of the energy from which
such rows are told (assumed)."""


def check_spikes(rows: Rows, battery: str, power_w: Array) -> None:
    """Tell single rows of a power far beyond all others, as a disturbed meter shows them."""
    size = np.abs(power_w)
    most = _SPIKE * np.maximum(float(np.quantile(size, 0.95)), np.maximum(size[:-2], size[2:]))
    alone = np.r_[False, size[1:-1] > most, False] if len(size) > 2 else np.zeros(len(size), dtype=bool)
    share = float(size[alone].sum() / max(float(size.sum()), 1e-9))
    if share > _SPIKES:
        told = f"{int(alone.sum())} rows alone at up to {size[alone].max():.4g} W"
        told += f", over {_SPIKE:g} times what is usual: {100 * share:.2g} % of the energy"
        action = "kept; if the meter was disturbed, a map with 'keep' leaves them out"
        rows.remark("range", f"power_{battery}_w", told, action, "warning", alone)


_CEILING, _OFTEN, _TWICE = 5, 3, 0.1
"""Rows at the greatest power, and how many times as many as at any other value, from which the meter is cut off there;
part of the rows in which another value may come twice running, as that of a rounded meter does (assumed)."""


def check_meter(rows: Rows, battery: str, power_w: Array) -> None:
    """Tell a meter that shows exactly zero while the robot drives, and one that shows its greatest value again and
    again, and hardly any other twice running."""
    name, speed, n = f"power_{battery}_w", rows.number("speed_m_s"), len(power_w)
    dead = (power_w == 0.0) & (np.abs(speed) > 10 * STILL_SPEED_M_S) if speed is not None else np.zeros(n, dtype=bool)
    count = int(dead.sum())
    if count > 0.02 * n and count >= 5:
        told = f"exactly zero in {count} rows in which the robot drives: was the meter on?"
        action = "kept; a map with 'keep' leaves such rows out"
        rows.remark("frozen", name, told, action, "warning", dead)
    most, below = float(np.max(power_w)), power_w[power_w < np.max(power_w)]
    count = n - len(below)
    if count < _CEILING or np.count_nonzero(np.diff(below) == 0.0) > _TWICE * n:
        return
    if count > _OFTEN * int(np.unique(below, return_counts=True)[1].max(initial=0)):
        told = f"{count} of {n} rows ({100 * count / n:.0f} %) are at {most:.6g} W exactly"
        told += " and none above: the meter is cut off there, and what costs more is not seen"
        action = "kept; widen the meter's range; a map with 'keep' leaves such rows out"
        rows.remark("ceiling", name, told, action, "warning", int(np.argmax(power_w)), count)


def check_order(rows: Rows) -> None:
    """Refuse a speed that has nothing to do with itself a row earlier: the rows are in no order."""
    data, time = rows.number("speed_m_s"), rows.time
    if data is None or len(data) < 100:
        return
    speed = data[:SAMPLE]
    spread = float(np.std(speed))
    if spread < 0.05 or float(np.median(np.diff(time[:SAMPLE]))) > 2.0:
        return
    kept = float(np.corrcoef(speed[1:], speed[:-1])[0, 1])
    if kept < 0.15:
        told = f"the speed jumps from row to row, as if the rows were shuffled (correlation from row to row {kept:.2g})"
        rows.remark("order", "speed_m_s", told, "left as it is; sort the rows by their time", "error")


def check_standstill(rows: Rows, power_w: Array | None = None) -> None:
    """Tell a speed or yaw rate whose noise or bias at rest is above the limits of standing still. `power_w`: what the
    battery of the motors delivers, which says what is rest where no speed does."""
    number = [rows.number(name) for name in ("speed_m_s", "yaw_rate_rad_s")]
    if number[0] is None:
        return
    forward, turned = (np.zeros(len(rows.time)) if data is None else data for data in number)
    forward, turned, known = forward[:SAMPLE], turned[:SAMPLE], True
    speed, turning, signed = np.abs(forward), np.abs(turned), np.min(turned) < 0.0 < np.max(turned)
    slow = hardly_moves(speed, turning)
    still = (speed < STILL_SPEED_M_S) & (turning < STILL_YAW_RATE_RAD_S)
    changes = int(np.count_nonzero(slow[1:] & slow[:-1] & (still[1:] != still[:-1])))
    count, beyond = int(slow.sum()), int((slow & ~still).sum())
    if changes < max(20, 0.1 * count) or beyond < 0.05 * count:
        parked = speed < STILL_SPEED_M_S
        often = signed and np.count_nonzero(parked & slow & ~still) > max(20, 0.9 * parked.sum())
        if often and _bias(turned[parked], _CLEAR_UNSIGNED):
            slow &= parked  # a steady turn of a robot that stands in no other way is its sensor's
        elif power_w is None:
            return
        else:
            known, slow = False, _rest_of_power(speed, turning, power_w[:SAMPLE])
        count, beyond = int(slow.sum()), int((slow & ~still).sum())
        if beyond < max(20, 0.8 * count):
            return
    name, data, limit, unit = ("speed_m_s", forward, STILL_SPEED_M_S, "m/s")
    if np.count_nonzero(slow & (turning >= STILL_YAW_RATE_RAD_S)) > beyond / 2:
        name, data, limit, unit = ("yaw_rate_rad_s", turned, STILL_YAW_RATE_RAD_S, "rad/s")
    rest = data[slow]
    clear = _CLEAR if signed and data is turned else _CLEAR_UNSIGNED
    bias = float(f"{_bias(rest, clear):.2g}") if known else 0.0
    high, left = float(np.quantile(np.abs(rest), 0.99)), np.abs(rest - bias)
    formula, furthest = name, float(np.quantile(left, 0.99))
    told, action = "noise at rest", "a map can set it to zero there"
    if bias:
        formula = f"{name} {'-' if bias > 0.0 else '+'} {abs(bias):g}"
        told, action = f"a bias of {bias:g} {unit} at rest", "a map takes it away"
    if not bias or np.count_nonzero(left >= limit) >= 0.05 * count:
        digit = 10.0 ** np.floor(np.log10(furthest))
        round_up = np.ceil(furthest / digit) * digit  # to one digit
        formula = f"where(abs({formula}) < {round_up:g}, 0, {formula})"
    told = f"{told}: {beyond} of {count} rows at rest are above {limit:g} {unit} (up to {high:.2g})"
    action = f"left as it is; {action}: {formula}"
    rows.remark("standstill", name, f"{told} and count as driving", action, "warning", slow & ~still)


_CLEAR, _CLEAR_UNSIGNED = 1.5, 3.0
"""Times its scatter at rest that a bias lies beside zero (assumed): the noise of a speed, and of a yaw rate without
signs, lies up to 2.3 times its scatter above zero (Maxwell's law)."""


def _bias(values: Array, clear: float) -> float:
    """What values at rest, shape (n,), lie beside zero by, steadily; zero where that is not clear of their scatter."""
    middle, half = float(np.median(values)), len(values) // 2
    scatter = 1.4826 * float(np.median(np.abs(values - middle)))
    drift = abs(float(np.median(values[:half])) - float(np.median(values[half:])))
    return middle if abs(middle) > max(clear * scatter, 2.0 * drift) else 0.0


_SLOW, _LEVEL = 0.25, 0.1
"""Parts of the fastest speed, and of the range of the power, within which a stretch may be one of rest (assumed)."""
STRETCH = 5
"""Rows that a stretch of rest lasts at least."""


def _rest_of_power(speed: Array, turning: Array, power_w: Array) -> Bools:
    """Rows of a robot that stands, whatever noise its speed shows: the power lies at its low level and does not follow
    the speed, which goes up and down as no crawling robot's does."""
    none = np.zeros(len(speed), dtype=bool)
    fast = float(np.quantile(speed, 0.99))
    slow = (speed < _SLOW * fast) & (turning < STILL_YAW_RATE_RAD_S) & np.isfinite(power_w)
    if slow.sum() < 20 or len(power_w) != len(speed):
        return none
    low, high = float(np.quantile(power_w[slow], 0.25)), float(np.nanquantile(power_w, 0.95))
    rest = slow & (np.abs(power_w - low) < _LEVEL * (high - low))
    for start, end in stretches(rest):
        if end - start < STRETCH:
            rest[start:end] = False
    v, p = speed[rest], power_w[rest]
    if len(v) < 20 or np.std(v) < 0.4 * np.mean(v) or np.quantile(v, 0.99) > 0.8 * _SLOW * fast:
        return none  # what goes on as far as it was looked for is driving
    left = v - v.mean()
    slope = float(left @ (p - p.mean()) / (left @ left))
    sd = float(np.std(p - p.mean() - slope * left) / np.sqrt(left @ left))
    return rest if slope + 3.0 * sd < 0.5 * (high - low) / fast else none


_STAYS = ("time_s", "payload_kg", "temp_ambient_c", "access_point_distance_m", "cpu_freq_hz")
"""Columns that may stand for long."""
_PLACES = ("x_m", "y_m", "heading_rad")
"""Columns that stay where the robot stays."""
_HUNG = 4.0
"""A sensor that hangs stands so many times longer than ever else; a coarse one stands often."""


def check_frozen(rows: Rows, held: Mapping[str, Bools]) -> dict[str, Bools]:
    """Tell numeric columns that hang at one value, and columns repeated from a slower topic.

    `held`: columns that are known to be held from a slower topic, with their new rows. Gives column → rows where it has
    a new value, for these and for columns that repeat or hang.
    """
    result = dict(held)
    time, speed = rows.time, rows.number("speed_m_s")
    none = np.zeros(len(time), dtype=bool)
    parked = none if speed is None else np.abs(speed) < STILL_SPEED_M_S
    for name, data in rows.columns.items():
        found = column_of(name)
        if isinstance(data, Labels) or found is None or found[0].kind != "number" or name in held or len(data) < 20:
            continue
        if name in _STAYS or name.startswith("energy_"):
            continue
        if not 19 <= np.count_nonzero(data[1:] == data[:-1]) < len(data) - 1:
            continue  # changes in nearly every row, or never: nothing to find, at the price of one comparison
        slow = refreshes(data, time)
        if slow is not None:
            step = float(np.median(np.diff(time[:SAMPLE])))
            count = len(data) - int(slow.fresh.sum())
            told = f"values repeat: about {1 / slow.period_s:.2g} Hz in rows of {1 / step:.3g} Hz"
            once = "; each refresh counts once" * name.startswith(("power_", "current_", "voltage_"))
            rows.remark("repeated", name, told, f"kept{once}", "note", None, count)
            result[name] = slow.fresh
            continue
        starts = np.flatnonzero(np.r_[True, data[1:] != data[:-1]])
        lengths = np.diff(np.r_[starts, len(data)])
        if len(starts) < 10 or 2 * np.count_nonzero(lengths > 1) >= len(lengths):
            continue
        stay = np.add.reduceat(parked if name in _PLACES else none, starts, dtype=np.int64) > 0.8 * lengths
        counted = np.where(stay, 1, lengths)
        longest = int(np.argmax(np.where(data[starts] == 0.0, 0, counted)))
        second = int(np.max(np.delete(counted, np.argmax(counted))))  # partial sorts of like numbers are slow
        first = int(starts[longest])
        last = first + int(lengths[longest]) - 1
        lasts_s = time[last] - time[first]
        if counted[longest] >= max(20, _HUNG * second) and lasts_s >= 5.0 and data[first] != 0.0:
            told = f"stands at {data[first]:.6g} for {lasts_s:.3g} s from {time[first]:.6g} s"
            told += ", although it changes in most other rows"
            rows.remark("frozen", name, told, "kept; counted once", "warning", first, last - first)
            result[name] = np.ones(len(data), dtype=bool)
            result[name][first + 1 : last + 1] = False
    return result

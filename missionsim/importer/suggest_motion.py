"""Suggestions for motion: speed, wheel speeds, turn rate, slope from an attitude or an elevation, position."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np

from missionsim.importer import transform
from missionsim.importer.draft import Draft
from missionsim.importer.long_tables import written_at_changes
from missionsim.importer.roles import WORDS, Field, Guess, folded, says, size_of, words_of
from missionsim.importer.sources import identifier
from missionsim.importer.suggest_energy import delivered, follows
from missionsim.importer.suggest_ways import (
    from_counts,
    from_degrees,
    from_heading,
    from_wheels,
    numbered_wheels,
    path_of,
)
from missionsim.labels import Labels


def suggest(draft: Draft) -> None:
    """Add the columns of motion to a draft, as far as they are seen."""
    _leave_out_dead_twists(draft)
    speed = _speed(draft)
    _plain(draft, "yaw_rate", *(() if _in_degrees(draft) else ("x", "y")), "slope")
    _turn_beside(draft)
    _attitude(draft, speed)
    for guess in draft.best("elevation", 0.5)[:1] if "slope_rad" not in draft.columns and speed else ():
        heights = draft.values(guess.field, guess.unit)
        if not np.ptp(heights[np.isfinite(heights)]):
            continue
        why = f"'{guess.field}' over the way driven, both within {_WINDOW}"
        told = replace(guess, sure="likely", why="a helper, which is no column of the log")
        draft.columns["_climb_m_s"] = (f"{{differentiate: {draft.ref(guess.field, 'z')}, average: {_WINDOW}}}", told)
        draft.columns["_driven_m_s"] = (f"{{value: abs(speed_m_s), average: {_WINDOW}}}", told)
        draft.columns["slope_rad"] = (
            '"where(_driven_m_s > 0.3, arctan(_climb_m_s / max(_driven_m_s, 0.3)), 0)"',
            Guess("slope", guess.field, "", 0.9, why, "likely"),
        )
    if "heading_rad" not in draft.columns:
        # one that never changes is one that the receiver does not have
        found = [one for one in draft.best("heading", 0.5) if folded(draft.fields[one.field]) is None]
        for guess in found[:1]:
            ref = draft.ref(guess.field, "heading")
            draft.fills |= {} if draft.direct else {ref: "hold"}  # the mean of 359° and 1° is no heading
            draft.column("heading_rad", ref, _heading_unit(draft, guess))
    from_heading(draft)
    if not speed:
        said = " ".join(draft.remarks)  # of the rpm of a motor a remark has said what it is
        near = [one.field for one in draft.best("speed", -0.1) if not says("command", words_of(one.field)[0])]
        near = [name for name in near if f"'{name}'" not in said]
        perhaps = f"; perhaps it is one of {', '.join(near[:4])}: `speed_m_s: SIGNAL`, in m/s" if near else ""
        draft.remarks.append(f"no speed was found: only what stands still can be explained without one{perhaps}")


def _in_degrees(draft: Draft) -> bool:
    """Whether positions hardly move while the robot drives, as degrees of latitude and longitude do; told."""
    guess = draft.columns["speed_m_s"][1] if "speed_m_s" in draft.columns else None
    x, y = draft.best("x", 0.5), draft.best("y", 0.5)
    one = draft.fields.get(guess.field) if guess is not None else None
    time_s = draft.time_s if draft.direct or one is None else one.time_s
    if guess is None or one is None or not x or not y or time_s is None or len(one.values) != len(time_s):
        return False
    driven = float(np.nansum(np.abs(draft.values(one.name, guess.unit))[1:] * np.clip(np.diff(time_s), 0.0, None)))
    steps = [np.diff(draft.values(axis[0].field, axis[0].unit)) for axis in (x, y)]
    way = sum(float(np.nansum(np.abs(step))) for step in steps)
    tiny = 0.0 < way < 1e-3 * driven
    if tiny:
        told = f"move by {way:.2g} while {driven:.3g} m are driven: degrees perhaps, so they were not taken"
        draft.remarks.append(f"'{x[0].field}' and '{y[0].field}' {told}")
    return tiny


def _turn_beside(draft: Draft) -> None:
    """The turn rate where it is called ``w`` beside a speed that is called ``v``, and goes both ways."""
    name = re.sub(r"(?<![A-Za-z])v\Z", "w", draft.columns["speed_m_s"][1].field if "speed_m_s" in draft.columns else "")
    one = draft.fields.get(name)
    if not name.endswith("w") or one is None or isinstance(one.values, Labels) or name in draft.signals.values():
        return
    known = one.values[np.isfinite(one.values)]
    fastest = float(WORDS["sizes"]["yaw rate"][""])
    if len(known) and known.min() < 0.0 < known.max() and float(np.quantile(np.abs(known), 0.95)) < fastest:
        guess = Guess("yaw_rate", name, "", 0.6, "w beside v", "a guess")
        draft.column("yaw_rate_rad_s", _moving(draft, name, "turn"), guess)


_WINDOW = "5 s"
"""Over which a climb and the way driven are compared: over longer ones the slopes of a trip are flattened."""


def _heading_unit(draft: Draft, guess: Guess) -> Guess:
    """Unit of a heading whose name has none and which goes on over several turns, by the turn rate."""
    turn = draft.columns["yaw_rate_rad_s"][1] if "yaw_rate_rad_s" in draft.columns else None
    if turn is None or turn.field not in draft.fields or "its unit" in guess.why or guess.score >= 3.0:
        return guess
    heading, rate = draft.fields[guess.field], np.abs(draft.values(turn.field, turn.unit))
    time_s = draft.time_s if draft.direct else heading.time_s
    if time_s is None or not len(time_s) == len(rate) == len(heading.values):
        return guess
    known = np.isfinite(time_s) & np.isfinite(rate) & np.isfinite(np.asarray(heading.values))
    turned = float(np.abs(np.diff(np.asarray(heading.values)[known])).sum())
    ratio = turned / max(float(np.trapezoid(rate[known], time_s[known])), 1e-9)
    for unit, told, size in (("", "radians", 1.0), ("deg", "degrees", np.degrees(1.0))):
        if 0.7 < ratio / size < 1.4:
            return replace(guess, unit=unit, sure="likely", why=f"the name, {told} as '{turn.field}' turns by them")
    return guess


_MOVED_M = 0.5
"""A pose that reaches farther has moved."""

_COLUMN = {role: name for name, role in WORDS["columns"].items()}
"""Role → column of the log."""


def _plain(draft: Draft, *roles: str) -> None:
    """Columns that are a field as it stands."""
    for role in roles:
        for guess in draft.best(role, 0.5)[:1]:
            alias = "turn" if role == "yaw_rate" else role
            moves = role in ("yaw_rate", "x", "y")
            ref = _moving(draft, guess.field, alias) if moves else draft.ref(guess.field, alias)
            draft.column(_COLUMN[role], ref, guess)


def _moving(draft: Draft, name: str, alias: str) -> str:
    """A reference to a signal of motion; between slower messages than the power's it is interpolated."""
    ref = draft.ref(name, alias)
    power = draft.fields.get(draft.signals.get(draft.head.get("timeline", "").split(" ")[0], ""))
    mine = draft.fields[name].time_s
    if ref in draft.signals and power is not None and power.time_s is not None and mine is not None:
        steps = [float(np.median(np.diff(t))) if len(t) > 1 else np.inf for t in (power.time_s, mine)]
        draft.fills[ref] = "linear" if steps[1] > 0.7 * steps[0] else "mean"
        if written_at_changes(draft.fields[name]):
            draft.fills[ref] = "hold"
    return ref


def _is_set(one: Field) -> bool:
    """Whether a number is set now and then, as what is commanded for a whole run, and not measured."""
    values = np.asarray(one.values, dtype=np.float64)
    known = values[np.isfinite(values)]
    changes = np.count_nonzero(np.diff(known))
    return bool(changes < _SET * len(known) and len(np.unique(known)) <= 10)


_SET = 0.002
"""Part of the rows in which a number that is set changes at most (assumed)."""


def _speed(draft: Draft) -> str:
    """The forward speed; the reference or formula of it, empty where there is none."""
    sides = [guess for side in ("left", "right") for guess in draft.best(side, 0.5)[:1]]
    both = {guess.field for guess in sides}
    found = [guess for guess in draft.best("speed", 0.5) if len(both) < 2 or guess.field not in both]
    found.sort(key=lambda guess: _is_set(draft.fields[guess.field]))
    if found and found[0].field.endswith("state.speed") and f"{found[0].field[:-5]}duty_cycle" in draft.fields:
        told = (
            "is the electrical rpm of a motor: divide it by the pairs of poles, the gear and 60, times the wheel's way"
        )
        draft.remarks.append(f"'{found.pop(0).field}' {told}")
    north = next((name for name in draft.fields if re.search(r"vehicle_local_position(_\d+)?\.vx\Z", name)), None)
    aside = north is None and bool(found) and _goes_sideways(draft, found[0])
    if aside and draft.fields[found[0].field].title == "nav_msgs/msg/Odometry":  # in the robot's own frame
        other = Guess("lateral_speed", _across(found[0].field), "", 1.0, "the speed to the left beside it", "likely")
        draft.column("lateral_speed_m_s", _moving(draft, other.field, "v_left"), other)
    elif aside:
        over = next((one for one in found if re.search(r"\b(ground ?speed|sog)\b", words_of(one.field)[0])), None)
        north, found = (found[0].field, found) if over is None else (None, [over])
    if north is not None:
        refs = [_moving(draft, name, alias) for name, alias in ((north, "vx"), (_across(north), "vy"))]
        unit = found[0].unit if found and found[0].field == north else ""
        guess = Guess("speed", north, unit, 1.0, "speed over ground; without its sign", "likely")
        draft.column("speed_m_s", f"hypot({', '.join(refs)})", guess)
    elif found:
        guess = _speed_unit(draft, found[0])
        draft.column("speed_m_s", _moving(draft, guess.field, "v"), guess)
    elif len(both) == 2:
        from_wheels(draft, *sides)
    elif draft.direct and (alike := numbered_wheels(draft)):
        from_wheels(draft, *alike)
    elif draft.direct and (wheel := draft.best("wheel", 0.5)):
        from_wheels(draft, wheel[0])
    elif not _from_way(draft) and not from_degrees(draft):
        from_counts(draft)
    return "speed_m_s" if "speed_m_s" in draft.columns else ""


def _leave_out_dead_twists(draft: Draft) -> None:
    """Leave out the speeds of an odometry whose pose moves while they stay nought; told."""
    end = ".twist.twist.linear.x"
    for name in [name for name in draft.fields if name.endswith(end)]:
        topic = name.removesuffix(end)
        place = [f"{topic}.pose.pose.position.{axis}" for axis in "xy"]
        time_s = draft.fields[name].time_s
        if not set(place) <= draft.fields.keys() or time_s is None:
            continue
        x, y = (float(np.ptp(draft.values(axis))) for axis in place)
        driven = float(np.trapezoid(np.abs(draft.values(name)), time_s))
        if (reach := float(np.hypot(x, y))) > max(_MOVED_M, 20.0 * driven):
            draft.remarks.append(f"the twist of {topic} stays nought while its pose moves by {reach:.3g} m: not taken")
            draft.fields = {one: kept for one, kept in draft.fields.items() if not one.startswith(f"{topic}.twist.")}


def _across(name: str) -> str:
    """Name of the speed along y beside that along x."""
    return re.sub(r"(?<=[v_. ])x(?= ?[\[(]|\Z)", "y", name)


def _goes_sideways(draft: Draft, guess: Guess) -> bool:
    """Whether a speed along x has one along y of its size beside it: both are over ground, not ahead."""
    other = draft.fields.get(_across(guess.field))
    if other is None or other.name == guess.field or isinstance(other.values, Labels):
        return False
    ahead, side = (np.nan_to_num(np.abs(draft.values(name))) for name in (guess.field, other.name))
    return float(np.quantile(side, 0.95)) > 0.2 * float(np.quantile(ahead, 0.95))


def _speed_unit(draft: Draft, guess: Guess) -> Guess:
    """Unit of a speed whose name has none, by the distance that grows meanwhile, or by the positions."""
    if "unit" in guess.why or draft.time_s is None or guess.score >= 3.0:
        return guess
    time, speed = draft.time_s, np.abs(np.asarray(draft.fields[guess.field].values, dtype=np.float64))
    ways = [(f"'{far.field}' grows", draft.values(far.field, far.unit)) for far in draft.best("distance", 0.3)]
    if path := path_of(draft):
        ways.append(("the positions move", path[1]))
    for told, grown in ways:
        known = np.isfinite(time) & np.isfinite(speed) & np.isfinite(grown)
        way = float(grown[known][-1] - grown[known][0]) if known.any() else 0.0
        area = float(np.trapezoid(speed[known], time[known])) if known.any() else 0.0
        if way <= 0 or area <= 0:
            continue
        for unit, factor in (("", 1.0), ("km/h", 1 / 3.6), ("mm/s", 1e-3), ("cm/s", 1e-2), ("mph", 0.44704)):
            if 0.93 < area * factor / way < 1.07:
                return replace(guess, unit=unit, sure="sure", why=f"the name, {unit or 'm/s'} because {told} by it")
    return guess


def _from_way(draft: Draft) -> bool:
    """The speed as the rate of an odometer, or of positions, without its sign; whether there are such."""
    for guess in draft.best("distance", 0.5) if draft.direct else ():
        values = draft.values(guess.field)
        grows = np.diff(values[np.isfinite(values)]) >= 0
        if grows.mean() > 0.99 and np.ptp(values[np.isfinite(values)]) > 0:
            factor = size_of(guess.unit)
            ref = draft.ref(guess.field, "way") + (f" * {factor:g}" if factor != 1.0 else "")
            told = replace(guess, unit="", sure="likely", why=f"rate of '{guess.field}', without its sign")
            rate = "speed_m_s" if grows.all() else "_way_m_s"  # a counter that wraps, or begins anew
            draft.columns[rate] = (f"{{differentiate: {ref}, average: 1 s}}", told)
            draft.columns.setdefault("speed_m_s", ("max(_way_m_s, 0)", told))
            return True
    if (path := path_of(draft)) is not None:
        told = replace(path[0][0], unit="", sure="likely", why="rate of the positions, without its sign")
        for axis, guess in zip("xy", path[0], strict=True):
            ref = _moving(draft, guess.field, axis)
            metres = f"{ref} * {size_of(guess.unit):g}" if guess.unit else ref
            draft.columns[f"_v{axis}_m_s"] = (f"{{differentiate: {metres}, average: 1 s}}", told)
            draft.column(f"{axis}_m", ref, guess)
        draft.column("speed_m_s", "hypot(_vx_m_s, _vy_m_s)", told)
        rows = draft.fields.get(draft.signals.get(draft.head.get("timeline", "").split(" ")[0], ""))
        if rows is not None and rows.time_s is not None and (step := float(np.median(np.diff(rows.time_s)))) > _BEND_S:
            draft.remarks.append(f"the speed is that between positions {step:.3g} s apart: bends are cut short")
    return path is not None


_BEND_S = 2.0
"""Time in which a robot drives a good part of a bend (assumed)."""


def _attitude(draft: Draft, speed: str) -> None:
    """Slope and heading from a quaternion."""
    groups: dict[str, dict[str, str]] = {}
    for name, one in draft.fields.items():
        match = re.match(r"(.*(?:quat\w*|orientation|rotation)[._]?|.*\bq_?)([xyzw])$", name, re.IGNORECASE)
        if match and not isinstance(one.values, Labels) and "covariance" not in name:
            groups.setdefault(match[1], {})[match[2].lower()] = name
        match = re.match(r"(.*(?:\b|_)(?:q|quat\w*)_?)\[?([0-3])\]?\Z", name, re.IGNORECASE)
        if match and not isinstance(one.values, Labels):
            groups.setdefault(match[1], {})["wxyz"[int(match[2])]] = name
    best = None
    for prefix, found in groups.items():
        if len(found) != 4:
            continue
        x, y, z, w = (draft.values(found[axis]) for axis in "xyzw")
        if counted := found["w"].rstrip("]").endswith("0"):
            if "vehicle_attitude" not in prefix:
                if abs(float(np.nanmedian(x * x + y * y + z * z + w * w)) - 1.0) < 0.02:
                    told = "are a quaternion, perhaps: `slope_rad: {quaternion: [x, y, z, w], give: slope}` takes one"
                    draft.remarks.append(f"{', '.join(found.values())} {told}, z up")
                continue
            y, z = -y, -z  # of PX4: w first, down is positive
        slope = transform.attitude(x, y, z, w, "slope")
        known = slope[np.isfinite(slope)]
        if not len(known):
            continue  # four noughts: an IMU that does not know
        size = float(np.quantile(np.abs(known), 0.95))
        rank = (1e-4 < size < 0.6, "imu" in prefix.lower() or "icp" in prefix.lower())
        if best is None or rank > best[0]:
            best = (rank, found, size, counted)
    if best is None:
        return
    rank, found, size, counted = best
    alias = {"x": "qx", "y": "qy", "z": "qz", "w": "qw"}
    refs = ", ".join("-" * (counted and axis in "yz") + draft.ref(found[axis], alias[axis]) for axis in "xyzw")
    if rank[0] and "slope_rad" not in draft.columns:
        guess = Guess(
            "slope", found["x"], "", 1.0, f"attitude, up to {np.degrees(size):.2g}°, nose up is uphill", "likely"
        )
        travel = f", travel: {speed}" if speed else ""
        draft.columns["slope_rad"] = (f"{{quaternion: [{refs}], give: slope, average: 1 s{travel}}}", guess)
    if counted and draft.best("heading", 0.5):
        return  # beside positions to the north and east
    draft.columns.setdefault(
        "heading_rad",
        (f"{{quaternion: [{refs}], give: heading}}", Guess("heading", found["z"], "", 1.0, "attitude", "likely")),
    )


def suggest_others(draft: Draft) -> None:
    """Temperatures, load, floor, and what else a model may depend on."""
    _plain(draft, "temp_ambient")
    if "temp_ambient_c" in draft.columns and "the name" not in draft.columns["temp_ambient_c"][1].why:
        formula, air = draft.columns["temp_ambient_c"]
        draft.columns["temp_ambient_c"] = (formula, replace(air, sure="a guess", why=f"{air.why}; of the air?"))
    _plain(draft, "temp_motor", "payload", "cpu_load", "gpu_load", "cpu_freq", "surface", "scheme")
    weight = next((name for name in draft.fields if name.endswith("loads[0].weight")), None)
    if weight is not None:
        count = draft.ref(weight.replace("[0].weight", ".count"), "loads")
        payload = Guess("payload", weight, "", 1.0, "the weight of the first load, none without a load", "likely")
        draft.column("payload_kg", f"where({count} > 0, {draft.ref(weight, 'weight')}, 0)", payload)
    used, total = {guess.field for _, guess in draft.columns.values()}, delivered(draft)
    for role, end, pattern in (("power", "w", "consumers"), ("current", "a", "fed")):
        for guess in draft.best(role):
            words, _ = words_of(guess.field)
            known = draft.values(guess.field)[np.isfinite(draft.values(guess.field))]
            if guess.field in used or not says(pattern, words) or re.search("request|max|min", words):
                continue
            if not np.ptp(known) or (re.search(r"\bmotors?\b", words) and follows(draft.values(guess.field), total)):
                continue
            factor = size_of(guess.unit)
            name = identifier(words.replace(" ", "_"))
            ref = draft.ref(guess.field, name)
            why = "a consumer of its own, for an effect of yours"
            formula = ref if factor == 1.0 else f"{ref} * {factor:g}"
            draft.column(f"{name}_{end}", formula, Guess("", guess.field, "", 0.6, why, "a guess"))

"""A first map for files that nobody has described: what is seen in them, and how sure that is."""

from __future__ import annotations

import os
import re
from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import InputError
from missionsim.importer import suggest_further, suggest_motion, suggest_power, suggest_rows
from missionsim.importer.draft import Draft, quoted
from missionsim.importer.long_tables import one_clock, recognised, signals_of
from missionsim.importer.roles import Field, Guess, fields_of, guess_all, known_unit, says, size_of
from missionsim.importer.run_table import keys_of
from missionsim.importer.sources import identifier
from missionsim.labels import Labels
from missionsim.logs.clean import in_turn
from missionsim.logs.raw import Remark
from missionsim.logs.readers import Options, Topic, reader_of, run_of

_MOST_ROWS = 200_000


@dataclass(frozen=True)
class Suggestion:
    """A suggested map."""

    text: str
    """YAML."""
    columns: dict[str, Guess]
    """Column of the log → the guess behind it."""
    missing: tuple[str, ...]
    """What was not found and has to be filled in before the map can be used."""
    remarks: tuple[str, ...] = ()
    """What else was seen."""


_BATTERY = re.compile(r"(power|voltage|current|energy)_robot_(?=[wva]h?\Z)")


_MOVES = ("nav_msgs/msg/Odometry", "sensor_msgs/msg/JointState", "geometry_msgs/msg/TwistStamped")
"""Types of messages of which each robot has one of its own."""


def of_one_robot(fields: Mapping[str, Field]) -> tuple[dict[str, Field], str]:
    """The fields of one robot and those of none, and what is said of it; all fields where there are no several.

    Robots are namespaces of topics that move, and have two topics or more of the same names, or the same name but for a
    number. The first that has a meter is taken.
    """
    spaces: dict[str, dict[str, str]] = defaultdict(dict)
    for name, one in fields.items():
        topic = name.partition(".")[0].partition("[")[0]
        space, _, tail = topic.strip("/").partition("/")
        if tail and topic.startswith("/"):
            spaces[space][tail] = one.title
    moving = [space for space, tails in spaces.items() if any(title in _MOVES for title in tails.values())]
    robots: set[str] = set()
    for space in moving:
        for other in spaces.keys() - {space}:
            numbered = re.sub(r"\d+", "#", space) == re.sub(r"\d+", "#", other)
            if numbered or (other in moving and len(spaces[space].keys() & spaces[other].keys()) > 1):
                robots |= {space, other}
    if not robots:
        return dict(fields), ""
    meters: list[str] = []
    for space in sorted(robots):
        inside = [one for name, one in fields.items() if name.startswith(f"/{space}/")]
        roles = {guess.role for guess in guess_all(inside).values() if guess.score > 0.7}
        if "power" in roles or {"voltage", "current"} <= roles:
            meters.append(space)
    chosen = (meters or sorted(robots))[0]
    others = robots - {chosen}
    kept = {name: one for name, one in fields.items() if name.strip("/").partition("/")[0] not in others}
    told = f"several robots in it: {', '.join(sorted(robots))}; this map is of {chosen}"
    told += ", which has a meter" if meters and len(meters) < len(robots) else ""
    return kept, f"{told}; for another one, put its name in the place of /{chosen}/ in `signals`"


def suggest_map(paths: Sequence[Path], battery: str = "robot", components: Collection[str] = ()) -> Suggestion:
    """Read a file, or the files of a run, and write a first map for it.

    `paths`: one file (the first of several of the same kind), or files of one run that have to be joined; `battery`,
    `components`: what the robot calls the battery that was measured, and what it switches. Raises InputError: a file
    that cannot be read.
    """
    table = suggest_rows.table_of_runs(paths)
    paths = [path for path in paths if table is None or not path.samefile(table[0])]
    joined = _to_join(paths)
    draft = _joined(joined) if joined else _single(paths[0])
    if draft.direct:
        suggest_rows.suggest_time(draft, paths[0])
    elif "time_s" not in draft.columns:
        draft.column("time_s", "time_s", Guess("time", "time_s", "", 2.0, "time of the messages", "sure"))
    suggest_power.suggest(draft)
    suggest_motion.suggest(draft)
    if draft.direct and draft.time_s is not None:
        times = {*draft.columns["time_s"][1].field.split("\n")}
        times |= {name for pair in suggest_rows.seconds_and_nanoseconds(draft.fields) for name in pair}
        first = {name: (guess.field.partition("\n")[0], guess.unit) for name, (_, guess) in draft.columns.items()}
        numbers = {one for one, field in draft.fields.items() if not isinstance(field.values, Labels)}
        found = {name: draft.values(*one) for name, one in first.items() if one[0] in numbers}
        turning = {name: first[name][0] for name in in_turn(found | {"time_s": draft.time_s})}
        draft.head |= suggest_rows.recognised_runs(draft.fields, draft.time_s, times, turning)
        if turning and "by" not in draft.head.get("runs", ""):
            draft.missing.append("rows of several recordings in turn, and no column tells them apart: part the file")
        if table is None and (by := re.match(r"\{by: \[(\w+)\]", draft.head.get("runs", ""))):
            apart = next(one.values for name, one in draft.fields.items() if identifier(name) == by[1])
            table = suggest_rows.table_of_runs(paths, list(dict.fromkeys(keys_of(apart))))
    if table is not None:
        suggest_rows.join_runs(draft, *table)
    suggest_motion.suggest_others(draft)
    suggest_further.suggest_switches(draft, components)
    suggest_further.suggest(draft)
    if joined:
        _on_one_clock(draft, paths[0])
    elif table is None:
        from_names(draft, paths)
    draft.columns = {_BATTERY.sub(rf"\1_{battery}_", name): column for name, column in draft.columns.items()}
    used = draft.told
    formulas = [*draft.let.values(), *(formula for formula, _ in draft.columns.values())]
    used |= set(re.findall(r"\w+", " ".join(formulas)))
    return Suggestion(
        _text(draft, [*joined] or [paths[0]], used),
        {name: guess for name, (_, guess) in draft.columns.items()},
        tuple(draft.missing),
        tuple(draft.remarks),
    )


def _on_one_clock(draft: Draft, path: Path) -> None:
    """Say how the clocks of the files of a run are brought to one; ask where they cannot be."""
    used = [one for name in draft.signals.values() if (one := draft.fields.get(name)) is not None]
    topics = [Topic(one.name, one.time_s, {}) for one in used if one.time_s is not None]
    if any(len(topic.time_s) >= _MOST_ROWS for topic in topics):
        return  # their ends were not read
    remarks: list[Remark] = []
    try:
        one_clock(topics, draft.clocks, path, remarks)
    except InputError as error:
        fault = error.faults[0]
        draft.missing.append(f"{fault.message} ({fault.got}): {fault.hint}")
    draft.remarks += [f"{remark.message}; {remark.action}" for remark in remarks if remark.severity == "warning"]


def _single(path: Path) -> Draft:
    reader = reader_of(path)
    fields = fields_of(path, reader, _MOST_ROWS if reader.table else 5_000)
    draft = Draft({one.name: _as_motion(one, fields) for one in fields}, reader.table is not None)
    if reader.table is not None:
        if recognised(draft.fields) is not None:
            return _joined({path: [path]})
        raw = reader.table(path, Options(most=100))
        draft.remarks += [f"{r.message}; {r.action}" for r in raw.remarks if r.kind == "format" and not r.column]
        if raw.headless:
            draft.head["table"] = f"{{header: [{', '.join(raw.names)}]}}"
            suggest_power.name_headless(draft)
    else:
        for name in [one.name for one in fields if not len(one.values) and one.count]:
            topic, _, kind = name.rpartition(" ")
            draft.remarks.append(f"the bag does not define {kind.strip('()')}, so {topic} cannot be read")
            del draft.fields[name]
        draft.fields, told = of_one_robot(draft.fields)
        draft.remarks += [told] if told else []
    return draft


def _as_motion(one: Field, fields: Sequence[Field]) -> Field:
    """A field ``topic.v`` or ``topic.w``, of which the second goes both ways, is a speed and a turn rate as in a file
    that is joined, and neither volts nor watts."""
    topic, _, letter = one.name.rpartition(".")
    if topic and letter in ("v", "w"):
        turn = next((other.values for other in fields if other.name == f"{topic}.w"), np.empty(0))
        if not isinstance(turn, Labels) and len(turn) and np.nanmin(turn) < 0.0 < np.nanmax(turn):
            return replace(one, joined=True)
    return one


_TEXTS = ("jsonlines", "printed", "broker", "echo")
"""Readers of messages that people write into a file for each topic."""


def _to_join(paths: Sequence[Path]) -> dict[Path, list[Path]]:
    """The files of one run: one of each layout, with all of its layout, where no file has both power and motion;
    nothing for a lone file."""
    layouts: dict[tuple[str, ...], list[Path]] = {}
    called: dict[str, tuple[str, ...]] = {}  # files of one name, in folders of runs, are of one layout
    for path in paths[:50]:
        reader = reader_of(path)
        names = [reader.name]
        if reader.table is not None or reader.name in _TEXTS:
            names = [one.name.removeprefix(f"{path.stem}.") for one in fields_of(path, reader, 50)]
        layouts.setdefault(called.setdefault(path.name, tuple(names)), []).append(path)
    if len(layouts) < 2:
        return {}
    for path, *_ in layouts.values():
        roles = {guess.role for guess in guess_all(fields_of(path, most=2_000)).values() if guess.score > 0.8}
        if roles & {"power", "voltage"} and roles & {"speed", "left"}:
            return {}
    return {alike[0]: alike for alike in layouts.values()}


def _pattern(alike: Sequence[Path]) -> str:
    """What the names of files that lie in a folder each have in common, for a map's `files`."""
    names = [path.name for path in alike]
    if len(set(names)) == 1 or len({path.parent for path in alike}) < len(alike):
        return names[0]
    begin, end = (os.path.commonprefix(some) for some in (names, [name[::-1] for name in names]))  # noqa: RUF071
    end = end[: min(map(len, names)) - len(begin)][::-1]
    return re.sub(r"\d[\dT_-]*\Z", "", begin) + "*" + re.sub(r"\A[\dT_-]*\d", "", end)  # no part of a date


def _joined(paths: Mapping[Path, Sequence[Path]]) -> Draft:
    """Fields of several files under ``file.column``, with the time of each. `paths`: with all files of its layout."""
    draft = Draft({}, False)
    # what the names of the files of a run begin with, up to and with a mark
    match = re.match(r".*[_\- ]", os.path.commonprefix([run_of(path) for path in paths]))  # noqa: RUF071 (names, no paths)
    prefix, files = match[0] if match else "", []
    for path in paths:
        alias = identifier(run_of(path)[len(prefix) :].strip("_- ") or run_of(path)).lower()
        reader = reader_of(path)
        fields = fields_of(path, reader, _MOST_ROWS)
        pattern = ("{run}" + path.name[len(prefix) - 1 :]) if prefix else _pattern(paths[path])
        if len(paths) == 1:
            alias, pattern = "log", "{run}" + path.name[len(run_of(path)) :]
        names, times, comment, clock = list[str](), "", "", "utc"
        more: dict[str, Any] = {}
        if reader.table is not None:
            own = Draft({one.name: one for one in fields}, True)
            suggest_rows.suggest_time(own, path)
            if own.missing:
                told = "no column looks like a time: write it in the place of TIME"
                draft.missing.append(f"{path.parent.name}/{path.name}: {told}")
                files.append(f"  {alias}: {{name: {quoted(pattern)}, time: TIME}}  # not found")
                continue
            time, clock = own.columns["time_s"][1], own.clock
            names, more = time.field.split("\n"), {"time_s": own.time_s, "title": path.name}
            unit = f", unit: {quoted(time.unit)}" if time.unit else ""
            times = f", time: [{', '.join(map(quoted, names))}]{unit}"
            comment = f"  # {time.sure}: {time.why}"
            if own.time_s is not None and (long := recognised(own.fields, own.time_s)) is not None:
                mixed = reader.table(path, Options(most=_MOST_ROWS, mixed=True))
                fields = [Field(n, len(rows), values, own.time_s[rows]) for n, rows, values in signals_of(mixed, long)]
                more = {"title": path.name}
                keys = {"name": f"[{', '.join(map(quoted, long.name))}]", "value": quoted(long.value)}
                keys |= {"unit": quoted(long.unit)} if long.unit else {}
                times += f", long: {{{', '.join(f'{key}: {value}' for key, value in keys.items())}}}"
        for one in fields:
            if one.name not in names:
                name = f"{alias}.{one.name}"
                draft.fields[name] = replace(one, name=name, joined=reader.table is not None, **more)
        draft.clocks[alias] = clock
        files.append(f"  {alias}: {{name: {quoted(pattern)}{times}}}{comment}")
    draft.head["files"] = "\n" + "\n".join(files)
    return draft


def _text(draft: Draft, paths: Sequence[Path], used: set[str]) -> str:
    """The map as YAML, each guess with a comment that says how sure it is."""
    lines = [
        f"# suggested for {', '.join(path.name for path in paths)}: correct it, then",
        f"#   missionsim import {' '.join(path.name for path in paths)} --map THIS_FILE --out LOG.parquet",
        *(f"# {remark}" for remark in draft.remarks),
        *(f"# TO DO: {message}" for message in draft.missing),
        "kind: map",
        f"name: {identifier(run_of(paths[0]) if len(paths) == 1 else paths[0].resolve().parent.name).lower()[:60]}",
    ]
    for key in ("table", "files"):
        if key in draft.head:
            lines.append(f"{key}:{draft.head[key] if key == 'files' else ' ' + draft.head[key]}")
    if draft.signals:
        lines.append("signals:")
        for alias, name in draft.signals.items():
            fill = draft.fills.get(alias)
            value = f"{{field: {quoted(name)}, fill: {fill}}}" if fill else quoted(name)
            lines.append(f"  {alias}: {value}")
    for key in ("timeline", "constants"):
        if key in draft.head:
            lines.append(f"{key}: {draft.head[key]}")
    if draft.let:
        lines += ["let:", *(f"  {name}: {formula}" for name, formula in draft.let.items())]
    lines += [f"{key}: {draft.head[key]}" for key in ("keep", "runs", "refresh", "step") if key in draft.head]
    lines.append("columns:")
    for name, (formula, guess) in draft.columns.items():
        lines.append(f"  {name}: {formula}  # {guess.sure}: {guess.why}")
    left = sorted((name for name in draft.fields if name not in used and name not in draft.signals.values()), key=len)
    if left:
        lines.append("# not used: " + ", ".join(left[:30]) + (f", … ({len(left)} in all)" if len(left) > 30 else ""))
    return "\n".join(lines) + "\n"


_LOAD = re.compile(r"(?i)[a-z]*[-_]?(\d+(?:\.\d+)?)(kg|g)\Z")


def from_names(draft: Draft, paths: Sequence[Path]) -> None:
    """Add floor and payload where the names of several files, or of their folders, tell them; other words that differ
    from file to file, of which each has one, are told."""
    for words in _differing(paths):
        loads = {word: found for word in words if (found := _LOAD.match(word))}
        listed = ", ".join(map(quoted, words))
        if len(loads) == len(words) and "payload_kg" not in draft.columns:
            values = ", ".join(
                f"{quoted(word)}: {float(found[1]) * size_of(known_unit(found[2].lower())):g}"
                for word, found in loads.items()
            )
            guess = Guess("payload", "", "", 0.6, "the names of the files", "a guess")
            draft.columns["_load"] = (f"{{file_name: [{listed}]}}", guess)
            draft.columns["payload_kg"] = (f"{{lookup: _load, values: {{{values}}}}}", guess)
        elif any(says("floor", word) for word in words) and "surface" not in draft.columns:
            guess = Guess("surface", "", "", 0.6, "the names of the files", "a guess")
            draft.columns["surface"] = (f"{{file_name: [{listed}]}}", guess)
        else:
            told = f"the names of the files differ: `condition: {{file_name: [{listed}]}}` makes a column of it"
            draft.remarks.append(told)


def _differing(paths: Sequence[Path]) -> list[list[str]]:
    """Words that stand at one place of the names, or of those of the folders, and differ: each in several files, or one
    that is a load; no numbers, dates or days."""
    if len(paths) < 3 or len({path.suffix for path in paths}) > 1:
        return []
    found: list[list[str]] = []
    for names in ([run_of(path) for path in paths], [path.resolve().parent.name for path in paths]):
        parts = [re.split(r"[_\s-]+", name) for name in names]
        if len({len(part) for part in parts}) > 1:
            continue
        for place in zip(*parts, strict=True):
            words = list(dict.fromkeys(place))
            plain = all(re.fullmatch(r"[^\W\d_]{3,}", word) or _LOAD.match(word) for word in words)
            if plain and 1 < len(words) < len(paths) and words not in found:
                found.append(words)
    return found

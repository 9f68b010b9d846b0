"""What programs print, kept in a file: ``tegrastats`` of a Jetson, messages of ``ros2 topic echo``, names with numbers
after a time, as of a serial monitor."""

from __future__ import annotations

import itertools
import re
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import Fault, InputError
from missionsim.labels import Labels
from missionsim.logs.formats.jsonlines import columns_of, flat
from missionsim.logs.raw import ColumnData, RawTable, Remark, damaged
from missionsim.logs.readers import Options, Reader, Recording, Topic

_STATS = re.compile(r"(?:(\d\d)-(\d\d)-(\d{4}) (\d\d:\d\d:\d\d) )?RAM (\d+)/(\d+)MB ")
_RAIL = re.compile(r"\b([A-Z][A-Z0-9_]*) (\d+)(?:mW)?/\d+(?:mW)?(?= |$)")
_WARMTH = re.compile(r"\b([A-Za-z0-9_]+)@(-?\d+(?:\.\d+)?)C\b")


def read_tegrastats(path: Path, _options: Options) -> RawTable:
    """Rails [mW], temperatures, load of processor and graphics of each line; its time, where it has one, else its
    number. Raises InputError: no such line."""
    rows: list[dict[str, float]] = []
    stamps: list[str] = []
    numbers: list[int] = []
    others = 0
    with open(path, encoding="utf-8-sig", errors="replace") as handle:
        for number, line in enumerate(handle, start=1):
            if (found := _STATS.match(line)) is None:
                others += bool(line.strip())
                continue
            row = {f"{name}_mW": float(value) for name, value in _RAIL.findall(line)}
            row |= {f"temp_{name}_degC": float(value) for name, value in _WARMTH.findall(line)}
            if cores := re.search(r"CPU \[([^\]]*)\]", line):
                loads = [re.match(r"(\d+)%", core) for core in cores[1].split(",")]
                row["cpu_load_%"] = sum(float(load[1]) for load in loads if load) / len(loads)
            if graphics := re.search(r"GR3D_FREQ (\d+)%", line):
                row["gpu_load_%"] = float(graphics[1])
            rows.append(row | {"memory_MB": float(found[5])})
            stamps.append(f"{found[3]}-{found[1]}-{found[2]}T{found[4]}" if found[1] else "")
            numbers.append(number)
    if not rows:
        raise InputError(Fault(str(path), 1, 1, "no line of tegrastats in it", allowed="RAM 1795/7859MB (lfb …"))
    columns: dict[str, ColumnData] = {"index": np.arange(len(rows), dtype=np.float64)}
    if all(stamps):
        columns = {"time": Labels.of(stamps)}
    for name in dict.fromkeys(name for row in rows for name in row):
        columns[name] = np.array([row.get(name, np.nan) for row in rows])
    remarks = []
    if others:
        told = f"{others} lines are none of tegrastats"
        remarks.append(Remark("format", "", told, "they were left out", "note", 0, others))
    return RawTable(str(path), columns, lambda row: numbers[row] if row >= 0 else 0, remarks, names=tuple(columns))


def read_echo(path: Path, options: Options) -> Recording:
    """Messages of one topic, printed as YAML with ``---`` between, at the times of their headers; the topic is called
    as the file. Raises InputError: no message with a time."""
    import yaml

    loader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    times: list[float] = []
    messages: list[dict[str, object]] = []
    broken = 0
    for part in re.split(r"^---\s*$", path.read_text(encoding="utf-8", errors="replace"), flags=re.MULTILINE):
        if not part.strip():
            continue
        try:
            fields = dict(flat(loader(part).get_single_data(), ""))
            whole, fine = (
                next(float(str(fields[f"header.stamp.{name}"])) for name in names if f"header.stamp.{name}" in fields)
                for names in (("sec", "secs"), ("nanosec", "nsecs"))
            )
        except (yaml.YAMLError, StopIteration, RuntimeError, ValueError):
            broken += 1
            continue
        times.append(whole + 1e-9 * fine)
        messages.append({name: value for name, value in fields.items() if not name.startswith("header.")})
        if options.most is not None and len(times) >= options.most:
            break
    if not times:
        raise InputError(Fault(str(path), 1, 1, "no message with a time in it", allowed="header: stamp: in each"))
    remarks = [damaged(f"{broken} of {broken + len(times)} messages are cut or have no time", broken)] if broken else []
    name = path.stem
    return Recording(
        [Topic(name, np.array(times), columns_of(messages, options.fields, name), "", len(times))], remarks
    )


_CLOCK = r"(?:\d{4}[-/]\d\d[-/]\d\d[ T])?\d\d:\d\d:\d\d(?:[.,]\d+)?(?:Z|[+-]\d\d:?\d\d)?"
_STAMP = rf"\[?({_CLOCK}|\d{{9,13}}(?:\.\d+)?)\]?[^\w,;\t]"
_NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d+)?"
_LABELLED = rf"(?<![\w.])([A-Za-z_][\w.]*)(?:: ?|=)({_NUMBER}) ?(%|[A-Za-zµ°/]{{1,5}})?(?=[\s,;|)\]]|\Z)"


def read_labelled(path: Path, _options: Options) -> RawTable:
    """What stands in each line as a name with its number, ``12:00:01 -> U: 25.1 V, I=832 mA``, after the line's time.
    Raises InputError: no such line."""
    rows: list[dict[str, float]] = []
    stamps: list[str] = []
    numbers: list[int] = []
    others = 0
    with open(path, encoding="utf-8-sig", errors="replace") as handle:
        for number, line in enumerate(handle, start=1):
            stamp = re.match(_STAMP, line)
            found = re.findall(_LABELLED, line[stamp.end() :]) if stamp else []
            if stamp is None or not found:
                others += bool(line.strip())
                continue
            rows.append({f"{name} [{unit}]" if unit else name: float(value) for name, value, unit in found})
            stamps.append(stamp[1].replace(",", "."))
            numbers.append(number)
    if not rows:
        raise InputError(Fault(str(path), 1, 1, "no line with a time and names", allowed="12:00:01 U: 25.1 V, I: 3 A"))
    columns: dict[str, ColumnData] = {"time": Labels.of(stamps)}
    columns |= {
        name: np.array([row.get(name, np.nan) for row in rows]) for name in dict.fromkeys(itertools.chain(*rows))
    }
    remarks = []
    if others:
        told = f"{others} lines have no time with names and numbers after it"
        remarks.append(Remark("format", "", told, "they were left out", "note", 0, others))
    return RawTable(str(path), columns, lambda row: numbers[row] if row >= 0 else 0, remarks, names=tuple(columns))


_LABELLED_BEGIN = re.compile(rf"(?:[^\n]*\n){{0,9}}?{_STAMP}[^\n]*?{_LABELLED}[^\n]*?{_LABELLED}".encode())
_STATS_BEGIN = re.compile(rb"(?:[^\n]{1,40}\n)?(?:\d\d-\d\d-\d{4} \d\d:\d\d:\d\d )?RAM \d+/\d+MB ")
_ECHO_BEGIN = re.compile(rb"header:\s*\n(?:  seq: \d+\s*\n)?  stamp:")


READERS = (
    Reader("labelled", "log of names and numbers", (), table=read_labelled, like=_LABELLED_BEGIN),
    Reader("tegrastats", "tegrastats log", (), table=read_tegrastats, like=_STATS_BEGIN),
    Reader("echo", "file of echoed messages", (), recording=read_echo, like=_ECHO_BEGIN),
)

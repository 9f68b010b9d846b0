"""What programs print, kept in a file: ``tegrastats`` of a Jetson, messages of ``ros2 topic echo``, names with numbers
after a time, as of a serial monitor."""

from __future__ import annotations

import re
from collections.abc import Callable
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
    return _lines(path, _rails, ("no line of tegrastats in it", "RAM 1795/7859MB (lfb …"), "are none of tegrastats")


def _rails(line: str) -> tuple[str, dict[str, float]] | None:
    if (found := _STATS.match(line)) is None:
        return None
    row = {f"{name}_mW": float(value) for name, value in _RAIL.findall(line)}
    row |= {f"temp_{name}_degC": float(value) for name, value in _WARMTH.findall(line)}
    if cores := re.search(r"CPU \[([^\]]*)\]", line):
        loads = [re.match(r"(\d+)%", core) for core in cores[1].split(",")]
        row["cpu_load_%"] = sum(float(load[1]) for load in loads if load) / len(loads)
    if graphics := re.search(r"GR3D_FREQ (\d+)%", line):
        row["gpu_load_%"] = float(graphics[1])
    stamp = f"{found[3]}-{found[1]}-{found[2]}T{found[4]}" if found[1] else ""
    return stamp, row | {"memory_MB": float(found[5])}


def _lines(
    path: Path, read: Callable[[str], tuple[str, dict[str, float]] | None], lacking: tuple[str, str], others: str
) -> RawTable:
    """A table of the lines of which `read` makes a stamp and numbers, counted where not each has a stamp. `lacking`:
    the fault where there is none, and what is allowed; `others`: what the rest of the lines do."""
    rows: list[dict[str, float]] = []
    stamps: list[str] = []
    numbers: list[int] = []
    left_out = 0
    with open(path, encoding="utf-8-sig", errors="replace") as handle:
        for number, line in enumerate(handle, start=1):
            if (found := read(line)) is None:
                left_out += bool(line.strip())
                continue
            stamps.append(found[0])
            rows.append(found[1])
            numbers.append(number)
    if not rows:
        raise InputError(Fault(str(path), 1, 1, lacking[0], allowed=lacking[1]))
    columns: dict[str, ColumnData] = {"index": np.arange(len(rows), dtype=np.float64)}
    if all(stamps):
        columns = {"time": Labels.of(stamps)}
    for name in dict.fromkeys(name for row in rows for name in row):
        columns[name] = np.array([row.get(name, np.nan) for row in rows])
    remarks = []
    if left_out:
        remarks.append(Remark("format", "", f"{left_out} lines {others}", "they were left out", "note", 0, left_out))
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
    lacking = ("no line with a time and names", "12:00:01 U: 25.1 V, I: 3 A")
    return _lines(path, _labelled, lacking, "have no time with names and numbers after it")


def _labelled(line: str) -> tuple[str, dict[str, float]] | None:
    stamp = re.match(_STAMP, line)
    found = re.findall(_LABELLED, line[stamp.end() :]) if stamp else []
    if stamp is None or not found:
        return None
    row = {f"{name} [{unit}]" if unit else name: float(value) for name, value, unit in found}
    return stamp[1].replace(",", "."), row


_LABELLED_BEGIN = re.compile(rf"(?:[^\n]*\n){{0,9}}?{_STAMP}[^\n]*?{_LABELLED}[^\n]*?{_LABELLED}".encode())
_STATS_BEGIN = re.compile(rb"(?:[^\n]{1,40}\n)?(?:\d\d-\d\d-\d{4} \d\d:\d\d:\d\d )?RAM \d+/\d+MB ")
_ECHO_BEGIN = re.compile(rb"header:\s*\n(?:  seq: \d+\s*\n)?  stamp:")


READERS = (
    Reader("labelled", "log of names and numbers", (), table=read_labelled, like=_LABELLED_BEGIN),
    Reader("tegrastats", "tegrastats log", (), table=read_tegrastats, like=_STATS_BEGIN),
    Reader("echo", "file of echoed messages", (), recording=read_echo, like=_ECHO_BEGIN),
)

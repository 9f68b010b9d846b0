"""What a map reads from: a table, a ROS bag or a ULog, as columns under the map's short names."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.inputs.log_map import MapSpec
from missionsim.logs.csvfile import read_csv
from missionsim.logs.parquetfile import MAGIC, read_parquet
from missionsim.logs.raw import RawTable

_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_NO_TABLES = {".ulg": "ULog", ".bag": "ROS 1 bag", ".mcap": "MCAP file", ".db3": "ROS 2 bag"}
TABLE_SUFFIXES = (".csv", ".parquet", ".txt", ".tsv", ".dat")


@dataclass(frozen=True)
class Field:
    """One column or field that a source offers, for listings."""

    name: str
    kind: str
    count: int


def kind_of_source(path: Path) -> str:
    """``table``, ``bag`` or ``ulog``, by content.

    Raises
    ------
    missionsim.errors.InputError
        Nothing there, a folder without anything readable, or a file named as a bag or ULog that is none.
    """
    if path.is_dir():
        if (path / "metadata.yaml").exists():
            return "bag"
        raise InputError(
            Fault(
                str(path),
                0,
                0,
                "this folder is neither a ROS 2 bag nor does it hold tables",
                allowed="a folder with metadata.yaml (bag), or with files " + ", ".join(TABLE_SUFFIXES),
            )
        )
    try:
        with open(path, "rb") as handle:
            head = handle.read(16)
    except FileNotFoundError:
        near = did_you_mean(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
        raise InputError(Fault(str(path), 0, 0, "there is no such file", hint=near)) from None
    except OSError as error:
        raise InputError(Fault(str(path), 0, 0, f"the file cannot be opened: {error.strerror}")) from None
    if head.startswith(b"ULog\x01"):
        return "ulog"
    if head.startswith((b"#ROSBAG", b"\x89MCAP", b"SQLite format 3")):
        return "bag"
    if kind := _NO_TABLES.get(path.suffix.lower()):
        raise InputError(
            Fault(
                str(path),
                0,
                0,
                f"this is no {kind}, whatever its name says: it does not begin as one (damaged or compressed?)",
                "",
                "an empty file" if not head else "",
                f"a whole {kind}; a table needs another suffix",
            )
        )
    return "table"


def find_sources(path: Path) -> list[Path]:
    """The files that SOURCE stands for: itself, a bag's folder, or every table, bag and ULog in a folder, by name.

    Raises
    ------
    missionsim.errors.InputError
        A folder without anything readable, or no such file.
    """
    if path.is_dir() and not (path / "metadata.yaml").exists():
        inside = sorted(
            p
            for p in path.iterdir()
            if not p.name.startswith(".")
            and (
                p.suffix.lower() in (*TABLE_SUFFIXES, ".bag", ".mcap", ".ulg", ".db3") or (p / "metadata.yaml").exists()
            )
        )
        if inside:
            return inside
    kind_of_source(path)
    return [path]


def read_source(path: Path, spec: MapSpec) -> RawTable:
    """Read what a map needs from one source.

    Returns
    -------
    RawTable
        Columns under the map's signal names, and for tables also under their own names (as identifiers). Bags have
        their time in ``time_s``, counted from their start.

    Raises
    ------
    missionsim.errors.InputError
        An unreadable source, or a signal that is not in it.
    """
    kind = kind_of_source(path)
    if kind == "bag":
        from missionsim.importer.bags import read_bag

        return read_bag(path, spec)
    if kind == "ulog":
        from missionsim.importer.ulog import read_ulog

        return read_ulog(path, spec)
    raw = _read_table(path, spec)
    faults = []
    columns = {identifier(name): data for name, data in raw.columns.items()}
    for alias, signal in spec.signals.items():
        data = raw.columns.get(signal.field.strip())
        if data is None:
            faults.append(missing_field(spec, alias, signal.field, raw.columns, raw.file))
        else:
            columns[alias] = data
    if faults:
        raise InputError(faults)
    raw.columns = columns
    return raw


def _read_table(path: Path, spec: MapSpec | None) -> RawTable:
    with open(path, "rb") as handle:
        if handle.read(4) == MAGIC:
            return read_parquet(path, str(path))
    if spec is None:
        return read_csv(path, str(path), typed=False)
    return read_csv(path, str(path), typed=False, header=spec.table.header, delimiter=spec.table.delimiter)


def identifier(name: str) -> str:
    """A column's name as a formula can write it: ``P (W)`` becomes ``P__W_``."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return word if _IDENTIFIER.match(word) else f"_{word}"


def missing_field(spec: MapSpec, alias: str, field: str, known: Iterable[str], file: str) -> Fault:
    """The fault of a signal that the source does not have."""
    names = list(known)
    message = f"'{field}' is not in {file}"
    path = ("signals", alias)
    near = did_you_mean(field, names)
    allowed = ", ".join(names[:40]) + (f", … ({len(names)} in all)" if len(names) > 40 else "")
    if spec.document is None:
        return Fault(str(spec.path), 0, 0, message, ".".join(path), field, allowed, near)
    fault: Fault = spec.document.fault(path, message, got=field, allowed=allowed, hint=near)
    return fault


def list_fields(path: Path) -> list[Field]:
    """What a source holds, for the user who writes a map: columns of a table, fields of the topics of a bag or ULog."""
    kind = kind_of_source(path)
    if kind == "bag":
        from missionsim.importer.bags import bag_fields

        return bag_fields(path)
    if kind == "ulog":
        from missionsim.importer.ulog import ulog_fields

        return ulog_fields(path)
    from missionsim.labels import Labels

    raw = _read_table(path, None)
    return [
        Field(name, "text" if isinstance(data, Labels) else "number", len(data)) for name, data in raw.columns.items()
    ]

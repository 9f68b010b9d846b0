"""The one registry of log formats: how a file is known, what it is called, and who reads it.

A format is one module in `missionsim/logs/formats` with a tuple ``READERS``, or a `Reader` behind an entry point of the
group ``missionsim.readers``. Formats of one table (CSV, Parquet) can be logs as they are; formats of messages
(bags, ULog, JSON lines) need a map.
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import re
from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from importlib import import_module
from pathlib import Path
from shutil import rmtree
from tempfile import mkdtemp
from typing import TypeVar

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.labels import Labels
from missionsim.logs.codes import without
from missionsim.logs.raw import ColumnData, RawTable, Remark, codes_told, damaged, tallies_of
from missionsim.physics import Array

ENTRY_POINTS = "missionsim.readers"
_HEAD_BYTES = 4096


@dataclass(frozen=True)
class Options:
    """What a reader may be told."""

    fields: Collection[str] | None = None
    """Messages: fields that are wanted; all by default."""
    wants: Callable[[str], bool] | None = None
    """Tables: whether a column is wanted; all by default."""
    most: int | None = None
    """Rows, or messages of a topic, that suffice (listings and suggestions)."""
    typed: bool = False
    """Tables: whether columns with names of the glossary have to hold what the glossary says."""
    mixed: bool = False
    """Tables: whether a column holds values of several signals: a code for no value can be none in another one."""
    header: tuple[str, ...] = ()
    delimiter: str | None = None
    """Both: text tables: names of the columns of a file without a header line, and what separates them."""
    clock: str = "header"
    """Messages: ``header`` or ``bag``, the time that counts."""


@dataclass
class Topic:
    """Messages of one kind: a time and the same fields in each."""

    name: str
    """A field is known as ``name.column``."""
    time_s: Array
    """[s], in the clock of the recording. Shape (n,)."""
    columns: dict[str, ColumnData]
    """Field → values, shape (n,); none where the file does not define the type of the messages."""
    title: str = ""
    """Type of the messages."""
    count: int = 0
    """Messages in the file, where only the first were read."""

    @property
    def undefined(self) -> bool:
        """Whether the file does not define the type of the messages."""
        return not self.columns and not len(self.time_s)


@dataclass
class Recording:
    """What a reader of messages gives: topics, each at times of its own, and what was remarked on the way."""

    topics: list[Topic]
    remarks: list[Remark] = field(default_factory=list)
    start_s: float = 0.0
    """What the times of its topics count from: a float since 1970 holds no nanoseconds."""


_Read = TypeVar("_Read", RawTable, Recording)


@dataclass(frozen=True)
class Reader:
    """One format."""

    name: str
    title: str
    """Both: short name, and what a message calls such a file."""
    suffixes: tuple[str, ...]
    """With the dot, in small letters; files of a folder that count."""
    begins: tuple[bytes, ...] = ()
    """First bytes that such a file always has; empty where the content tells nothing."""
    _: KW_ONLY
    table: Callable[[Path, Options], RawTable] | None = None
    blocks: Callable[[Path, int, Sequence[str] | None], Iterator[RawTable]] | None = None
    """Both: formats of one table: read whole, and in blocks of at least so many rows in bounded memory."""
    recording: Callable[[Path, Options], Recording] | None = None
    """Formats of messages."""
    loose: tuple[str, ...] = ()
    """Suffixes that other files have as well: taken by ``import`` only."""
    like: re.Pattern[bytes] | None = None
    """What such a file begins like, where its first bytes are not always the same."""
    folder: str = ""
    """Name of a file that makes its folder one source; a folder of such files without it is one as well."""


def recorded(reader: Reader, path: Path, options: Options) -> Recording:
    """What a reader of messages gives, without the codes for no value in them."""
    assert reader.recording is not None
    found = reader.recording(path, options)
    without_codes(found.topics, found.remarks)
    return found


def without_codes(topics: list[Topic], remarks: list[Remark]) -> list[Topic]:
    """Take the codes for no value out of topics; what is said is added to `remarks`."""
    for topic in topics:
        for name, tally in tallies_of(topic.columns).items():
            data, codes = topic.columns[name], tally.found()
            if codes and not isinstance(data, Labels):
                topic.columns[name] = without(data, codes)
                remarks += codes_told(f"{topic.name}.{name}".removesuffix("."), tally.rows, codes)
    return topics


@functools.cache
def registry() -> dict[str, Reader]:
    """Every format, by name; the built-in ones first."""
    import pkgutil
    from importlib.metadata import entry_points

    from missionsim.logs import formats

    found: dict[str, Reader] = {}
    for module in pkgutil.iter_modules(formats.__path__):
        readers: tuple[Reader, ...] = getattr(import_module(f"{formats.__name__}.{module.name}"), "READERS", ())
        found |= {reader.name: reader for reader in readers}
    for point in entry_points(group=ENTRY_POINTS):
        reader = point.load()
        if not isinstance(reader, Reader):
            told = f"the entry point {point.name} of {ENTRY_POINTS} is no Reader"
            raise InputError.single(told, got=point.value, allowed="a Reader")
        found[reader.name] = reader
    return found


def log_suffixes() -> tuple[str, ...]:
    """Suffixes of the files of a folder that are logs as they are."""
    return tuple(suffix for reader in registry().values() if reader.table for suffix in reader.suffixes)


def source_suffixes() -> tuple[str, ...]:
    """Suffixes of the files of a folder that ``import`` reads."""
    return tuple(suffix for reader in registry().values() for suffix in (*reader.suffixes, *reader.loose))


def is_recording(path: Path) -> bool:
    """Whether a file is named as a recording of messages, or a folder holds one."""
    kinds = [reader for reader in registry().values() if reader.recording]
    return any(path.suffix.lower() in one.suffixes or (one.folder and (path / one.folder).exists()) for one in kinds)


def is_echo(path: Path) -> bool:
    """Whether a YAML file holds messages of a topic as ROS prints them."""
    like = registry()["echo"].like
    if like is None or path.suffix.lower() not in (".yaml", ".yml") or not path.is_file():
        return False
    with open(path, "rb") as file:
        return like.match(file.read(99)) is not None


def reader_of(path: Path) -> Reader:
    """The reader of a file, by its first bytes and then by its name; text of an unknown name is a table. Raises
    InputError: nothing there, a folder that is no source, a pipe, or a file that is not what its name says."""
    if path.is_dir():
        for reader in registry().values():
            if reader.folder and (path / reader.folder).exists():
                return reader
        raise InputError.single("this is a folder, not a log", file=str(path))
    if path.exists() and not path.is_file():  # opening a pipe would wait for a writer; a device may never end
        raise InputError(Fault(str(path), 0, 0, "this is a pipe or a device, not a file", allowed="a file"))
    try:
        with open(path, "rb") as handle:
            head = handle.read(_HEAD_BYTES)
    except FileNotFoundError:
        raise InputError(not_there(path)) from None
    except OSError as error:
        raise InputError(Fault(str(path), 0, 0, f"the file cannot be opened: {error.strerror}")) from None
    if (packed := _of_packed(path, head)) is not None:
        return packed
    suffix = path.suffix.lower()
    named = None
    for reader in registry().values():
        if (reader.begins and head.startswith(reader.begins)) or (reader.like and reader.like.match(head)):
            return reader
        if suffix in reader.suffixes or (suffix in reader.loose and not reader.begins):
            named = reader
    if named is not None and named.begins:
        told = f"this is no {named.title}, whatever its name says: it does not begin as one (damaged or compressed?)"
        allowed = f"a whole {named.title}; a table needs another suffix"
        raise InputError.single(told, file=str(path), got="" if head else "an empty file", allowed=allowed)
    return named or registry()["csv"]


_PACKED = {b"\x1f\x8b": "gzip", b"BZh": "bz2", b"\xfd7zXZ": "lzma", b"PK\x03\x04": "zipfile"}
"""First bytes of packed files, and the module that unpacks them."""


def unpacked_name(name: str) -> str:
    """The name or path of a file without the suffix of a packer: `run1.csv` of `run1.csv.gz`."""
    return re.sub(r"(?i)\.(gz|bz2|xz)\Z", "", name)


def run_of(path: Path) -> str:
    """The name of the run in a file: that of the file without suffixes."""
    return Path(unpacked_name(path.name)).stem


def _of_packed(path: Path, head: bytes) -> Reader | None:
    """The reader of the one file that a packed one holds; None where a file is not packed, or holds another number."""
    module = next((name for begin, name in _PACKED.items() if head.startswith(begin)), "")
    found = _unpacked(path, module, path.stat().st_mtime_ns) if module else None
    if found is None:
        return None
    inner, whole = found
    reader = reader_of(inner)

    def of_inner(use: Callable[[Path, Options], _Read]) -> Callable[[Path, Options], _Read]:
        def read(_path: Path, options: Options) -> _Read:
            try:
                found = use(inner, options)
            except InputError as error:
                faults = [replace(f, file=str(path)) if f.file == str(inner) else f for f in error.faults]
                raise InputError(faults) from None
            if isinstance(found, RawTable):
                found.file = str(path)
            if not whole:
                found.remarks.append(damaged("the packed file is cut short"))
            return found

        return read

    table, recording = reader.table and of_inner(reader.table), reader.recording and of_inner(reader.recording)
    return replace(reader, name=f"{reader.name}, packed", table=table, recording=recording, blocks=None)


@functools.cache
def _unpacked(path: Path, module: str, _changed: int) -> tuple[Path, bool] | None:
    """A file of this process with what a packed one holds, and whether that is whole; None where that is not one
    file, or nothing of it can be read."""
    name, read = path.stem, 0
    try:
        if module == "zipfile":
            archive = import_module(module).ZipFile(path)
            members = [one for one in archive.infolist() if not one.is_dir() and "__MACOSX" not in one.filename]
            if len(members) != 1 or Path(members[0].filename).suffix.lower() not in source_suffixes():
                return None
            name, packed = Path(members[0].filename).name, archive.open(members[0])
        else:
            packed = import_module(module).open(path)
    except Exception:
        return None
    folder = Path(mkdtemp())
    atexit.register(rmtree, folder, ignore_errors=True)
    with packed, open(folder / name, "wb") as file, contextlib.suppress(Exception):
        while part := packed.read1(1 << 20):
            if not read and part[257:262] == b"ustar":  # a tar, of any number of files
                return None
            read += file.write(part)
        return folder / name, True
    return (folder / name, False) if read else None


def not_there(path: Path) -> Fault:
    """The fault of a path where nothing is."""
    near = did_you_mean(path.name, [p.name for p in path.parent.iterdir()]) if path.parent.is_dir() else ""
    return Fault(str(path), 0, 0, "there is no such file", hint=near)


def table_reader(path: Path) -> Reader:
    """As `reader_of`, for files that have to be a table. Raises InputError: a bag or another recording of messages,
    which needs a map."""
    reader = reader_of(path)
    if reader.table is None:
        hint = "missionsim import FILE --suggest --out MAP.yaml; then import FILE --map MAP.yaml --out LOG"
        told = f"this is a {reader.title}, not a table"
        raise InputError.single(told, file=str(path), allowed="CSV or Parquet", hint=hint)
    return reader

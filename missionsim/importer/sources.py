"""What a map reads from: tables and recordings, alone or several files of one run, as columns under its short names."""

from __future__ import annotations

import glob
import re
from collections import Counter
from collections.abc import Collection, Iterable, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from fnmatch import translate
from pathlib import Path

import numpy as np

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.importer.long_tables import one_clock, signals_of
from missionsim.importer.roles import fields_of
from missionsim.importer.transform import Signal, merge_signals
from missionsim.inputs.log_map import FileMap, MapSpec
from missionsim.inputs.units import UnitError, unit_factor
from missionsim.logs import readers as reading
from missionsim.logs.raw import ColumnData, RawTable, Remark
from missionsim.logs.times import Stamps, TimeError, read_stamps

_IDENTIFIER = re.compile(r"[A-Za-z_][A-Za-z0-9_]*\Z")
_NEAREST = 6
"""Names that a message offers for one that is not there."""


@dataclass(frozen=True)
class Source:
    """Files of one run (or of the runs that one file holds)."""

    name: str
    """Name of the run."""
    files: dict[str, Path]
    """Name of the file in the map's `files` (empty where the map has none) → path."""

    @property
    def path(self) -> Path:
        """The first file."""
        return next(iter(self.files.values()))


def find_files(given: Sequence[Path]) -> list[Path]:
    """The files that paths stand for: themselves, what matches a pattern, or every readable file of a folder, by name.
    Raises InputError: a folder without anything readable, or no such file."""
    found: dict[Path, None] = {}
    faults = []
    for path in given:
        if not path.exists() and glob.has_magic(str(path)):
            inside = [Path(name) for name in sorted(glob.glob(str(path)))]
        elif path.is_dir() and not _is_source(path):
            inside = _inside(path)
        elif path.exists():
            inside = [path]
        else:
            faults.append(reading.not_there(path))
            continue
        if not inside:
            message = "nothing matches this pattern" if not path.exists() else "this folder holds nothing to import"
            faults.append(Fault(str(path), 0, 0, message, allowed="files " + ", ".join(reading.source_suffixes())))
        found |= dict.fromkeys(inside)
    if faults:
        raise InputError(faults)
    return list(found)


def _inside(folder: Path) -> list[Path]:
    """What a folder holds to import: files, bags, and the files of bags that have lost their description; where it
    holds nothing itself, or only a table of its folders, the files in those."""
    found: list[Path] = []
    loose = tuple(suffix for reader in reading.registry().values() if reader.folder for suffix in reader.suffixes)
    for path in sorted(p for p in folder.iterdir() if not (p.name.startswith(".") or _packed_beside(p))):
        if path.suffix.lower() in reading.source_suffixes() or _is_source(path) or reading.is_echo(path):
            found.append(path)
        elif path.is_dir():
            found += sorted(p for p in path.iterdir() if p.suffix.lower() in loose and not p.name.startswith("."))
    files = (
        p for p in sorted(folder.glob("*/*")) if p.suffix.lower() in reading.source_suffixes() and not _packed_beside(p)
    )
    inner = [p for p in files if not p.name.startswith(".") and not p.parent.name.startswith(".")]
    if len(found) == 1:
        listed = _listed(found[0], {path.parent.name for path in inner})
        return [*found, *(path for path in inner if path.parent.name in listed)]
    return found or inner


def _packed_beside(path: Path) -> bool:
    """Whether a packed file is an archive of several, or one that lies beside it unpacked."""
    bare = reading.unpacked_name(path.name)
    return bare != path.name and (bare.lower().endswith(".tar") or path.with_name(bare).exists())


_LIST_BYTES = 1 << 20
"""Size of a table of folders at most (assumed)."""


def _listed(path: Path, folders: Collection[str]) -> Collection[str]:
    """The folders that a file is a table of: it names most of them, or has as many rows; none where it is another."""
    if len(folders) < 2 or not path.is_file() or path.stat().st_size > _LIST_BYTES:
        return ()
    text = path.read_bytes()
    named = [folder for folder in folders if folder.encode() in text]
    if len(named) > max(1.0, 0.5 * len(folders)):
        return named
    return folders if sum(bool(line.strip()) for line in text.splitlines()) - 1 == len(folders) else ()


def _is_source(path: Path) -> bool:
    """Whether a folder is one source, as a bag is."""
    return path.is_dir() and any(one.folder and (path / one.folder).exists() for one in reading.registry().values())


def find_sources(given: Sequence[Path], spec: MapSpec) -> list[Source]:
    """What to import, run by run: each file on its own, or by the map's `files` the files of each run.

    A folder is a run where each pattern matches one file of it; else ``{run}`` in the patterns tells the runs apart,
    or each folder inside it is one.
    """
    if not spec.files:
        return [Source(name, {"": path}) for name, path in _named(find_files(given))]
    loose: list[Path] = []
    sources: list[Source] = []
    for path in given:
        inner = sorted(p for p in path.iterdir() if p.is_dir() and not _is_source(p)) if path.is_dir() else []
        if inner and not _is_source(path):
            sources += [source for folder in inner for source in _grouped(find_files([folder]), spec, folder.name)]
        elif path.is_dir():
            sources += _grouped(find_files([path]), spec, path.name)
        else:
            loose += find_files([path])
    if loose:
        sources += _grouped(loose, spec, loose[0].resolve().parent.name or "run")
    return sources


def _named(files: Sequence[Path]) -> list[tuple[str, Path]]:
    """Name of the run of each file: that of its folder, where the names of files in several are alike."""
    folders = [path.resolve().parent for path in files]
    alike = Counter(reading.run_of(path) for path in files)
    inside = Counter(folders)
    return [
        (run if alike[run] == 1 else at.name if inside[at] == 1 else f"{at.name}_{run}", path)
        for path, at in zip(files, folders, strict=True)
        for run in [reading.run_of(path)]
    ]


def _grouped(files: Sequence[Path], spec: MapSpec, name: str) -> list[Source]:
    runs: dict[str, dict[str, list[Path]]] = {}
    for alias, file in spec.files.items():
        pattern = re.compile(translate(file.name).replace(r"\{run\}", r"(?P<run>.+?)"), re.IGNORECASE)
        for path in files:
            if match := pattern.match(path.name):
                runs.setdefault(match.groupdict().get("run") or "", {}).setdefault(alias, []).append(path)
    shared = runs.pop("", {}) if len(runs) > 1 else {}
    runs = {run: {**shared, **found} for run, found in runs.items()}
    faults = []
    for run, found in runs.items() or [("", {})]:
        for alias, file in spec.files.items():
            matches = found.get(alias, [])
            if len(matches) != 1:
                listed = ", ".join(path.name for path in matches or files)[:200]
                told = f"{len(matches)} files match '{file.name}'" + (f" in run {run}" if run else f" in {name}")
                hint = "'{run}' in the patterns, where it holds several runs" if len(matches) > 1 else ""
                fault = spec.document.fault(("files", alias), told, got=listed, allowed="one file a run", hint=hint)
                faults.append(fault)
    if faults:
        raise InputError(faults)
    return [Source(run or name, {alias: paths[0] for alias, paths in found.items()}) for run, found in runs.items()]


def read_source(source: Source, spec: MapSpec) -> RawTable:
    """Read what a map needs from one source.

    Gives columns under the map's signal names, and for a table also under their own names (as identifiers). Recordings
    and joined files have their time in ``time_s``, counted from the first row. Raises InputError: an unreadable source,
    or a signal that is not in it.
    """
    if taken := spec.of_runs:  # joined when the runs are known; until then they have no value
        others = {alias: signal for alias, signal in spec.signals.items() if alias not in taken}
        raw = read_source(source, spec.model_copy(update={"signals": others}))
        raw.columns |= {alias: np.full(raw.rows, np.nan) for alias in taken}
        raw.names = tuple(dict.fromkeys([*raw.names, *taken]))
        return raw
    if spec.files:
        return _joined(source, spec)
    reader = reading.reader_of(source.path)
    if reader.table is not None:
        return with_names(reader.table(source.path, table_options(spec)), spec)
    if not spec.signals:
        told, allowed = f"a map for a {reader.title} needs signals", "signals: {volts: /battery_state.voltage}"
        raise InputError.single(told, file=str(spec.path), allowed=allowed)
    wanted = {signal.field.strip() for signal in spec.signals.values()}
    found = reading.recorded(reader, source.path, reading.Options(fields=wanted, clock=spec.stamp))
    raw = _merged(found.topics, spec, source.path, reader)
    raw.remarks[:0] = found.remarks
    return raw


def table_options(spec: MapSpec) -> reading.Options:
    """What a map wants of a table."""
    named = {signal.field.strip() for signal in spec.signals.values()}
    words = spec.words()

    def wants(name: str) -> bool:
        # "name" and "#3" may stand for a numbered column
        numbered = any(field.startswith("#") for field in named) or name.rpartition(" #")[0] in named
        return spec.others or name in named or numbered or identifier(name) in words

    return reading.Options(wants=wants, header=spec.table.header, delimiter=spec.table.delimiter)


def with_names(raw: RawTable, spec: MapSpec) -> RawTable:
    """A table with its columns under the names that the formulas of a map may use."""
    own = Counter(identifier(name) for name in raw.names)
    columns = {identifier(name): data for name, data in raw.columns.items() if own[identifier(name)] == 1}
    faults = []
    for alias, signal in spec.signals.items():
        name = column_name(signal.field, raw.names)
        if name is None:
            faults.append(missing_field(spec, alias, signal.field, raw.names, raw.file))
        else:
            columns[alias] = raw.columns[name]
            if name in raw.local:
                raw.local.add(alias)
    if faults:
        raise InputError(faults)
    raw.local = {identifier(name) for name in raw.local}
    raw.names = tuple(dict.fromkeys([*(name for name in own if own[name] == 1), *spec.signals]))
    raw.columns = columns or {"": np.empty(0)}
    return raw


def column_name(field: str, names: Sequence[str]) -> str | None:
    """The column of a table that a map names: as it is written, or ``#3`` by its number; None where there is none."""
    field = field.strip()
    if field in names:
        return field
    if re.fullmatch(r"#\d+", field) and 1 <= int(field[1:]) <= len(names):
        return names[int(field[1:]) - 1]
    return None


def _merged(topics: Sequence[reading.Topic], spec: MapSpec, path: Path, reader: reading.Reader | None) -> RawTable:
    signals: dict[str, Signal] = {}
    faults: list[Fault] = []
    known: list[str] | None = None
    every = ((topic, column) for topic in topics for column in topic.columns)
    by_name = {f"{topic.name}.{column}".removesuffix("."): (topic, column) for topic, column in every}
    unknown = {topic.name: topic.title for topic in topics if topic.undefined}
    for alias, signal in spec.signals.items():
        field = signal.field.strip()
        full = field if field in by_name or field.startswith("/") else f"/{field}"
        topic_name = full.partition(".")[0]
        if topic_name in unknown:
            if blank := unknown[topic_name]:  # told once
                told = f"the bag does not define {blank}, the type of {topic_name}"
                allowed = "a bag with the definitions of its messages, as MCAP recorders write it"
                faults.append(spec.document.fault(("signals", alias), told, got=field, allowed=allowed))
                unknown[topic_name] = ""
            continue
        if full not in by_name:
            if known is None:
                known = list(by_name) if reader is None else [found.name for found in fields_of(path, reader)]
            faults.append(missing_field(spec, alias, field, known, str(path)))
            continue
        topic, column = by_name[full]
        signals[alias] = Signal(topic.time_s, topic.columns[column], signal.fill, topic.name)
    if spec.timeline is not None and spec.timeline not in spec.signals:
        message = f"timeline '{spec.timeline}' is not a signal"
        allowed, hint = ", ".join(spec.signals), did_you_mean(spec.timeline, spec.signals)
        faults.append(spec.document.fault(("timeline",), message, got=spec.timeline, allowed=allowed, hint=hint))
    if faults:
        raise InputError(faults)
    raw = merge_signals(signals, spec.timeline, str(path))
    raw.names = tuple(raw.columns)
    return raw


def _joined(source: Source, spec: MapSpec) -> RawTable:
    """The files of one run on one time axis."""
    if not spec.signals:
        raise InputError.single(
            "a map for files needs signals", file=str(spec.path), allowed="signals: {volts: FILE.COLUMN}"
        )
    remarks: list[Remark] = []
    topics: list[reading.Topic] = []
    clocks: dict[str, str] = {}
    named = [signal.field.strip().partition(".") for signal in spec.signals.values()]
    for alias, file in spec.files.items():
        own = {column for start, _, column in named if start == alias}
        parts, clocks[alias], told = _parts(source.files[alias], alias, file, own, spec)
        topics += parts
        remarks += [Remark(r.kind, r.column, f"{alias}: {r.message}", r.action, r.severity, r.line) for r in told]
    one_clock(topics, clocks, source.path, remarks)
    raw = _merged(topics, spec, source.path, None)
    raw.remarks[:0] = remarks
    return raw


def _parts(
    path: Path, alias: str, file: FileMap, own: set[str], spec: MapSpec
) -> tuple[list[reading.Topic], str, list[Remark]]:
    """Topics of one of several files, the kind of its times, and remarks."""
    reader = reading.reader_of(path)
    lag = float(file.lag) if file.lag is not None else 0.0
    if reader.recording is not None:
        found = reading.recorded(reader, path, reading.Options(fields=own, clock=spec.stamp))
        for topic in found.topics:
            topic.name, topic.time_s = f"{alias}.{topic.name}", topic.time_s + (found.start_s - lag)
        return found.topics, "utc", found.remarks
    assert reader.table is not None
    mixed = file.long is not None
    raw = reader.table(path, reading.Options(header=spec.table.header, delimiter=spec.table.delimiter, mixed=mixed))
    if not file.time:
        allowed = f"time: one of {', '.join(raw.names or raw.columns)}, or [date, time]"
        raise InputError(spec.document.fault(("files", alias), "the column of its time is missing", allowed=allowed))
    chosen = [column_name(name, raw.names) for name in file.time]
    if None in chosen:
        missing = file.time[chosen.index(None)]
        raise InputError(missing_field(spec, alias, missing, raw.names, raw.file, ("files", alias, "time")))
    names = [name for name in chosen if name is not None]
    stamps = stamps_of(raw, names, file.zone, file.unit)
    known, told = np.isfinite(stamps.seconds), [*raw.remarks, *stamps.remarks]
    if file.long is not None:
        for key, name in (
            *(("name", one) for one in file.long.name),
            ("value", file.long.value),
            ("unit", file.long.unit),
        ):
            if name is not None and name not in raw.columns:
                raise InputError(missing_field(spec, alias, name, raw.names, raw.file, ("files", alias, "long", key)))
        topics = [
            reading.Topic(f"{alias}.{name}", stamps.seconds[rows][known[rows]] - lag, {"": values[known[rows]]})
            for name, rows, values in signals_of(raw, file.long)
        ]
        return reading.without_codes(topics, told), stamps.kind, told
    columns: dict[str, ColumnData] = {name: data[known] for name, data in raw.columns.items() if name not in names}
    for field in own:
        if (name := column_name(field, raw.names)) is not None and name not in names:
            columns[field] = columns[name]
    return [reading.Topic(alias, stamps.seconds[known] - lag, columns)], stamps.kind, told


def stamps_of(raw: RawTable, names: Sequence[str], zone: str | None, unit: str | None) -> Stamps:
    """Times of a table from one column, or from a date and a time of day. Raises InputError: with the reason why these
    are no times."""
    parts = [raw.columns[name] for name in names]
    try:
        if unit is not None and isinstance(parts[0], np.ndarray):
            parts[0] = parts[0] * unit_factor(unit, "duration")[0]
        return read_stamps(parts, " and ".join(names), zone, bool(raw.local & set(names)))
    except (TimeError, UnitError) as error:
        raise InputError(Fault(raw.file, raw.line(getattr(error, "row", 0)), 0, str(error), names[0])) from None


def identifier(name: str) -> str:
    """A column's name as a formula can write it: ``P (W)`` becomes ``P__W_``."""
    word = re.sub(r"\W", "_", name, flags=re.ASCII)
    return word if _IDENTIFIER.match(word) else f"_{word}"


def missing_field(
    spec: MapSpec, alias: str, field: str, known: Iterable[str], file: str, path: tuple[str, ...] = ()
) -> Fault:
    """The fault of a signal that the source does not have."""
    names = list(known)
    numbered = [name for name in names if name.rpartition(" #")[0] == field.strip()]
    near = get_close_matches(field, names, _NEAREST, 0.3) if len(names) > 2 * _NEAREST else names
    allowed = ", ".join(near) + (f", … ({len(names)} in all; import without --map lists them)" if near != names else "")
    message, hint = f"'{field}' is not in {file}", did_you_mean(field, names)
    if numbered:
        numbers = [f"'#{names.index(name) + 1}'" for name in numbered]
        message, allowed = f"'{field}' stands {len(numbered)} times in {file}", ", ".join([*numbered, *numbers])
        hint = numbered[0]
    return spec.document.fault(path or ("signals", alias), message, got=field, allowed=allowed, hint=hint)

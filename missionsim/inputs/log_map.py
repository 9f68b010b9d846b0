"""Model of a map: how a file of any layout becomes a log in the columns of the glossary."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainValidator, StringConstraints

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.expressions import compile_expression
from missionsim.inputs.base import FileModel, Model, Name, Text, alone
from missionsim.inputs.parameter import Parameter
from missionsim.inputs.values import AnyNumber, Period, QuantityOf
from missionsim.logs.raw import MEASURED, measured_batteries

Formula = Annotated[
    str,
    BeforeValidator(lambda raw: f"{raw!r}" if type(raw) in (int, float) else raw, json_schema_input_type=str | float),
    StringConstraints(max_length=2000),
]
"""An arithmetic expression over columns, constants and helpers (`missionsim.expressions`); a number is a constant."""
Names = Annotated[
    tuple[Name, ...],
    BeforeValidator(lambda raw: [raw] if isinstance(raw, str) else raw, json_schema_input_type=str | tuple[Name, ...]),
]
"""One name, or a list of them."""
Alias = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z_][A-Za-z0-9_]*$", max_length=80)]
Lag = Annotated[Parameter, QuantityOf("duration")]
_WAYS = ("value", "stamp", "quaternion", "differentiate", "text", "lookup", "file_name")


def _word_or_number(raw: Any) -> str | float:
    if isinstance(raw, str):
        return raw
    if isinstance(raw, (int, float)) and not isinstance(raw, bool):
        return float(raw)
    raise ValueError("must be a word or a number")


WordOrNumber = Annotated[str | float, PlainValidator(_word_or_number, json_schema_input_type=str | float)]


class SignalMap(Model):
    """A column of the source file, or a field of a topic, under a short name."""

    field: Text
    fill: Literal["hold", "linear", "mean"] | None = None


class LongMap(Model):
    """A table with one row for each value: the columns that name the signal, hold its value and say its unit."""

    name: Annotated[Names, Field(min_length=1)]
    value: Name
    unit: Name | None = None


class FileMap(Model):
    """One of several files of a run, which are joined by time."""

    name: Text
    time: Names = ()
    unit: Text | None = None
    zone: Text | None = None
    lag: Lag | None = None
    long: LongMap | None = None


class ColumnMap(Model):
    """How one column of the log comes about, by exactly one of value, stamp, quaternion, differentiate, text,
    lookup and file_name."""

    value: Formula | None = None
    stamp: Annotated[Names, Field(min_length=1, max_length=2)] | None = None
    zone: Text | None = None
    quaternion: Annotated[tuple[Formula, ...], Field(min_length=4, max_length=4)] | None = None
    give: Literal["slope", "heading", "roll", "pitch"] = "slope"
    differentiate: Formula | None = None
    text: Name | None = None
    lookup: Formula | None = None
    values: dict[Name, WordOrNumber] = Field(default_factory=dict)
    file_name: tuple[Name, ...] | None = None
    unit: Text | None = None
    average: Period | None = None
    lag: Lag | None = None
    travel: Formula | None = None
    hold: bool | None = None

    def _check(self) -> None:
        ways = [way for way in _WAYS if getattr(self, way) is not None]
        if len(ways) != 1:
            raise ValueError(f"a column needs exactly one of {', '.join(_WAYS)}, not {' and '.join(ways) or 'none'}")
        if (self.lookup is None) != (not self.values):
            raise ValueError("'lookup' and 'values' go together")

    def formulas(self) -> Iterable[tuple[str | int, str]]:
        """Every formula of the column, with the key it stands under."""
        for way in ("value", "differentiate", "lookup", "travel"):
            if (formula := getattr(self, way)) is not None:
                yield way, formula
        for index, formula in enumerate(self.quaternion or ()):
            yield index, formula


Signal = Annotated[SignalMap, BeforeValidator(alone("field", str), json_schema_input_type=str | SignalMap)]
Target = Annotated[
    ColumnMap, BeforeValidator(alone("value", str, int, float), json_schema_input_type=str | float | ColumnMap)
]


class RunsMap(Model):
    """Where one file holds several runs, and the table that has a row for each."""

    by: Names = ()
    restart: bool = False
    gap: Period | None = None
    shortest: Period | None = None
    table: Text | None = None
    key: Name | None = None

    def _check(self) -> None:
        if (self.table is None) != (self.key is None):
            raise ValueError("'table' and 'key' go together")


class TableMap(Model):
    """How a text table is written, where that cannot be found out: files without a header."""

    header: tuple[Name, ...] = ()
    delimiter: Annotated[str, StringConstraints(min_length=1, max_length=1)] | None = None


class MapSpec(FileModel):
    """A map: how a file of any layout becomes a log."""

    kind: Literal["map"]
    name: Name = "map"
    title: Text = ""
    table: TableMap = TableMap.model_construct()
    files: dict[Alias, FileMap] = Field(default_factory=dict)
    signals: dict[Alias, Signal] = Field(default_factory=dict)
    timeline: Name | None = None
    stamp: Literal["header", "bag"] = "header"
    constants: dict[Alias, AnyNumber] = Field(default_factory=dict)
    let: dict[Alias, Formula] = Field(default_factory=dict)
    keep: Formula | None = None
    runs: RunsMap = RunsMap.model_construct()
    refresh: Names = ()
    step: Period | None = None
    columns: Annotated[dict[Alias, Target], Field(min_length=1)]
    others: bool = False

    def faults(self) -> list[Fault]:
        """Faults that need no source: formulas that cannot be read, and columns that every log has to have."""
        found: list[Fault] = []
        document = self.document
        for path, text in self.formulas():
            try:
                compile_expression(text, **document.place(path)._asdict())
            except InputError as error:
                found.extend(error.faults)
        # a column whose mapping is at fault is missing from `columns`, but not from the file
        present = {*self.columns, *document.names("columns")}
        if self.runs.table is not None and "runs" in self.files:
            told = "'runs' is the table of runs"
            found.append(document.fault(("files", "runs"), told, "runs", "another name for the file", key=True))
        if "time_s" not in present:
            allowed = "time_s: and a formula; for a bag or ULog `time_s: time_s`"
            message, hint = "the column 'time_s' is missing", did_you_mean("time_s", self.columns)
            found.append(document.fault(("columns",), message, allowed=allowed, hint=hint, key=True))
        if not measured_batteries(present):
            found.append(document.fault(("columns",), "no battery is measured", allowed=MEASURED, key=True))
        return found

    @property
    def of_runs(self) -> dict[str, str]:
        """Signals that the table of runs gives: short name → its column."""
        given = {alias: signal.field.strip().partition(".") for alias, signal in self.signals.items()}
        return {alias: name for alias, (start, _, name) in given.items() if start == "runs" and self.runs.table}

    def formulas(self) -> Iterable[tuple[tuple[str | int, ...], str]]:
        """Every formula of the map, with its path in the file."""
        if self.keep is not None:
            yield ("keep",), self.keep
        for name, text in self.let.items():
            yield ("let", name), text
        for name, column in self.columns.items():
            for key, text in column.formulas():
                yield self.formula_path(name, key), text

    def words(self) -> frozenset[str]:
        """Every name that the map reads of its source."""
        found = {*self.refresh, *self.runs.by}
        for _, text in self.formulas():
            found |= compile_expression(text).names
        for column in self.columns.values():
            found |= set(column.stamp or ())
        return frozenset(found)

    def formula_path(self, name: str, key: str | int) -> tuple[str | int, ...]:
        """Where a formula of a column stands in the file: a bare text stands for its `value`."""
        if isinstance(key, int):
            return ("columns", name, "quaternion", key)
        if key == "value" and not isinstance(self.document.node(("columns", name)).children, dict):
            return ("columns", name)
        return ("columns", name, key)

"""Model of a map: how a file of any layout becomes a log in the columns of the glossary."""

from collections.abc import Iterable
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field, PlainValidator, StringConstraints, model_validator

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.expressions import compile_expression
from missionsim.glossary import column_of
from missionsim.inputs.base import FileModel, Model, Name, Text, alone
from missionsim.inputs.tree import Document, dotted
from missionsim.inputs.values import AnyNumber, Parameter, Period, quantity

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
Lag = Annotated[Parameter, quantity("duration")]
_WAYS = ("value", "stamp", "quaternion", "differentiate", "text", "lookup", "file_name")


def _word_or_number(raw: Any) -> str | float:
    if isinstance(raw, str):
        return raw
    if isinstance(raw, (int, float)) and not isinstance(raw, bool):
        return float(raw)
    raise ValueError("must be a word or a number")


WordOrNumber = Annotated[str | float, PlainValidator(_word_or_number, json_schema_input_type=str | float)]


class SignalMap(Model):
    """A column of the source file, or a field of a topic, under a short name.

    Attributes
    ----------
    field : str
        Table: the column's name, or ``#3`` by number. ROS bag: ``/topic.field.sub[0]``, ``/joint_states.effort[left]``,
        ``/diagnostics[status].key``. ULog: ``topic.field``, ``topic[1].field[0]``. Joined files: ``file.column``.
    fill : str
        Bags and joined files: between two messages the value is held (`hold`) or interpolated (`linear`), or averaged
        over the time of the row (`mean`). By default numbers that come more often than rows are averaged, others held.
    """

    field: Text
    fill: Literal["hold", "linear", "mean"] | None = None


class FileMap(Model):
    """One of several files of a run, which are joined by time.

    Attributes
    ----------
    name : str
        The file's name as a pattern: ``power*.csv``; ``{run}`` in it tells several runs apart: ``{run}_power.csv``.
    time : list of names
        Tables: the column of times, or those of a date and a time of day.
    unit : str
        Of times that are numbers; epochs are recognised without.
    zone : str
        Of local times: ``Europe/Berlin``, ``+02:00``.
    lag : duration
        The file's clock is that much late; its times are shifted back.
    """

    name: Text
    time: Names = ()
    unit: Text | None = None
    zone: Text | None = None
    lag: Lag | None = None


class ColumnMap(Model):
    """How one column of the log comes about, by exactly one of `value`, `stamp`, `quaternion`, `differentiate`, `text`,
    `lookup` and `file_name`.

    Attributes
    ----------
    value : formula
        Expression over the source.
    stamp : list of names
        Of `time_s`: a column of time stamps, or those of a date and a time of day.
    zone : str
        Of local time stamps: ``Europe/Berlin``, ``+02:00``.
    quaternion : list of four formulas
        Components x, y, z, w of the attitude (body to world, x forward, z up).
    give : str
        What of the attitude: `slope` (uphill positive), `heading`, `roll`, `pitch`.
    differentiate : formula
        Its rate over time, after averaging over `average`.
    text : str
        The same word in every row.
    lookup : formula
        A column whose values are looked up in `values`.
    values : mapping
        Value as written → word or number.
    file_name : list of str
        Words: the one that the file's name holds is the value.
    unit : str
        Unit of the source; converted to the glossary's.
    average : duration
        Moving average over that time.
    lag : duration
        The source comes that much too late; it is shifted back.
    travel : formula
        The forward speed: where it is negative the column changes its sign (a slope of the body, driven backwards).
    hold : bool
        Refresh: take the value at the refresh instead of the mean since the one before. Found out by default.
    """

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

    @model_validator(mode="after")
    def _one_way(self) -> "ColumnMap":
        ways = [way for way in _WAYS if getattr(self, way) is not None]
        if len(ways) != 1:
            raise ValueError(f"a column needs exactly one of {', '.join(_WAYS)}, not {' and '.join(ways) or 'none'}")
        if (self.lookup is None) != (not self.values):
            raise ValueError("'lookup' and 'values' go together")
        return self

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
    """Where one file holds several runs.

    Attributes
    ----------
    by : list of names
        Columns whose change begins another run; their values go into the run's name.
    restart : bool
        A time that jumps back begins another run.
    gap : duration
        A hole in time that is longer begins another run (after `keep`).
    shortest : duration
        Shorter runs are left out, and told.
    """

    by: Names = ()
    restart: bool = False
    gap: Period | None = None
    shortest: Period | None = None


class TableMap(Model):
    """How a text table is written, where that cannot be found out: files without a header.

    Attributes
    ----------
    header : list of names
        Names of the columns of a file that has none.
    delimiter : str
        One character; found out by default.
    """

    header: tuple[Name, ...] = ()
    delimiter: Annotated[str, StringConstraints(min_length=1, max_length=1)] | None = None


class MapSpec(FileModel):
    """A map (``kind: map``).

    Attributes
    ----------
    name, title : str
    table : TableMap
    files : mapping
        Several files of one run: short name → `FileMap`; signals are then ``file.column``.
    signals : mapping
        Short name → column or field of the source; needed for bags and for columns whose names are no identifiers.
    timeline : str or None
        Bags: the signal whose messages give the rows; by default the one with most messages.
    stamp : str
        Bags: time of a message from its `header`, or when the `bag` received it.
    constants : mapping
        Name → number, with a unit or without (then in SI units).
    let : mapping
        Helper columns, name → formula.
    keep : formula
        Rows to keep, such as ``"volts > 30"``.
    runs : RunsMap
    refresh : list of names
        Signals of a slow topic: one row for each refresh of them, all else averaged since the one before.
    step : duration
        Rows are averaged over steps of this length (after the formulas).
    columns : mapping
        Column of the log → how it comes about.
    others : bool
        Whether to keep the numeric and text columns of a table that the map does not use.
    """

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

    def faults(self, document: Document) -> list[Fault]:
        """Faults that need no source: formulas that cannot be read, and columns that every log has to have."""
        found: list[Fault] = []
        for path, text in self.formulas():
            line, column = document.position(path)
            try:
                compile_expression(text, file=document.file, line=line, column=column, path=dotted(path))
            except InputError as error:
                found.extend(error.faults)
        # a column whose mapping is at fault is missing from `columns`, but not from the file
        written = document.data.get("columns") if isinstance(document.data, dict) else None
        present = set(self.columns) | (set(written) if isinstance(written, dict) else set())
        if "time_s" not in present:
            allowed, hint = (
                "time_s: and a formula; for a bag or ULog `time_s: time_s`",
                did_you_mean("time_s", self.columns),
            )
            message = "the column 'time_s' is missing"
            found.append(document.fault(("columns",), message, allowed=allowed, hint=hint, key=True))
        kinds = {known[0].name for name in present if (known := column_of(name)) is not None}
        if not kinds & {"power_<battery>_w", "energy_<battery>_wh"} and not (
            {"voltage_<battery>_v", "current_<battery>_a"} <= kinds
        ):
            allowed = "power_<battery>_w, or voltage_<battery>_v and current_<battery>_a, or energy_<battery>_wh"
            found.append(document.fault(("columns",), "no battery is measured", allowed=allowed, key=True))
        return found

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

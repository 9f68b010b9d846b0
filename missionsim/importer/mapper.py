"""A map's formulas compiled against the columns of one source, and evaluated in the order of their needs."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping
from graphlib import CycleError, TopologicalSorter
from pathlib import Path
from typing import Any

import numpy as np

from missionsim.errors import InputError, did_you_mean
from missionsim.expressions import Expression, compile_expression
from missionsim.glossary import column_of
from missionsim.importer import transform
from missionsim.importer.roles import to_glossary
from missionsim.inputs.log_map import ColumnMap, MapSpec
from missionsim.inputs.validation import Checker
from missionsim.labels import Labels
from missionsim.logs.raw import ColumnData, RawTable, Remark, numbers_of
from missionsim.logs.times import TimeError, read_stamps
from missionsim.physics import Array


class Mapper(Checker):
    """A map compiled against the columns of one source."""

    def __init__(self, spec: MapSpec, raw: RawTable, stem: str) -> None:
        super().__init__(spec.document)
        self.spec, self.raw, self.stem = spec, raw, stem
        self.constants = {name: float(number) for name, number in spec.constants.items()}
        self.remarks: list[Remark] = []
        self.clock = "own"
        offered = raw.names or tuple(raw.columns)
        known = {*offered, *self.constants, *spec.let, *spec.columns}
        self.let = {
            name: self._compile(text, ("let", name), known - ({name} - {*offered})) for name, text in spec.let.items()
        }
        self.columns = {
            name: {
                key: self._compile(text, spec.formula_path(name, key), known - ({name} - {*offered, *self.constants}))
                for key, text in column.formulas()
            }
            for name, column in spec.columns.items()
        }
        self.keep = self._compile(spec.keep, ("keep",), known) if spec.keep is not None else None
        for key, names, taken in (
            ("constants", spec.constants, {*offered}),
            ("let", spec.let, {*offered, *spec.constants, *spec.columns}),
        ):
            for name in taken.intersection(names):
                self._fault((key, name), f"'{name}' stands for something else already", name, "a name of its own")
        self._check_names(("refresh",), spec.refresh, [*offered, *spec.let])
        self._check_names(("runs", "by"), spec.runs.by, offered)
        for name, column in spec.columns.items():
            self._check_names(("columns", name, "stamp"), column.stamp or (), offered)
            if (column.stamp or column.zone) and name != "time_s":
                self._fault(("columns", name), "'stamp' and 'zone' belong to time_s")
        # helpers and columns that a helper or column reads; a source column of the same name comes first
        made = {*self.let, *self.columns} - {*raw.columns, *self.constants}
        self.needs = {name: self._reads(name) & made for name in (*self.let, *self.columns)}
        for name, column in spec.columns.items():
            if name not in (*self.let, "time_s") and (column.differentiate is not None or column.average is not None):
                self.needs[name].add("time_s")  # it has to be there before rates and averages
        try:
            self.order = list(TopologicalSorter(self.needs).static_order())
        except CycleError as error:
            circle = " → ".join(map(str, error.args[1]))
            self._fault(("columns",), f"these columns need each other: {circle}")
        if self.faults:
            raise InputError(self.faults)

    def _fault(
        self, path: tuple[str | int, ...], message: str, got: str = "", allowed: str = "", hint: str = ""
    ) -> InputError:
        """Note a fault; gives the error of all until now."""
        self.add(path, message, got, allowed, hint)
        return InputError(self.faults)

    def _compile(self, text: str, path: tuple[str | int, ...], known: set[str]) -> Expression:
        try:
            return compile_expression(text, names=known, **self.spec.document.place(path)._asdict())
        except InputError as error:
            self.faults.extend(error.faults)
            return compile_expression("0")

    def _check_names(self, path: tuple[str | int, ...], names: Iterable[str], known: Iterable[str]) -> None:
        for name in names:
            self.known(path, name, known, "column", message=f"'{name}' is not a column of the source")

    def _reads(self, name: str) -> set[str]:
        """Every name in the formulas of a helper or a column."""
        formulas = [self.let[name]] if name in self.let else self.columns.get(name, {}).values()
        return {read for formula in formulas for read in formula.names}

    def time(self, columns: Mapping[str, ColumnData]) -> Array:
        """Time of every row of the source [s], before runs are split."""
        return np.asarray(self.evaluate(columns, _all_of(["time_s"], self.needs.__getitem__))[0]["time_s"])

    def evaluate(
        self, source: Mapping[str, ColumnData], only: Collection[str] | None = None
    ) -> tuple[dict[str, ColumnData], dict[str, ColumnData]]:
        """The map's columns, and its helpers, from the columns of the source; where `only` is given, these alone."""
        rows = len(next(iter(source.values())))
        values: dict[str, Any] = {**self.constants, **source}
        result: dict[str, ColumnData] = {}
        for name in self.order if only is None else [name for name in self.order if name in only]:
            if name in self.let:
                data = self.run(self.let[name], values, rows)
            else:
                data = result[name] = self._column(name, self.spec.columns[name], values, result, rows)
            if name not in source and (name in self.let or name not in self.constants):
                values[name] = data
        helpers = {name: values[name] for name in self.let if name in values}
        return {name: result[name] for name in self.spec.columns if name in result}, helpers

    def run(self, formula: Expression, values: Mapping[str, ColumnData | float], rows: int) -> ColumnData:
        """Value of a formula in every row; InputError where it cannot be computed."""
        try:
            data = formula.evaluate(values)
        except (TypeError, ValueError, InputError) as error:
            text = [name for name in formula.names if isinstance(values.get(name), Labels)]
            told = "the formula cannot be computed" + (f": {', '.join(text)} holds text" if text else "")
            self.faults.append(formula.place.fault(told, got=formula.source, allowed="" if text else str(error)[:100]))
            raise InputError(self.faults) from None
        if isinstance(data, Labels):
            return data
        if isinstance(data, str):
            return Labels(np.zeros(rows, dtype=np.int64), (data,))
        numbers = np.asarray(data, dtype=np.float64)
        return numbers if numbers.shape == (rows,) else np.array(np.broadcast_to(numbers, (rows,)))

    def _column(
        self, name: str, column: ColumnMap, values: dict[str, Any], result: dict[str, ColumnData], rows: int
    ) -> ColumnData:
        parts = [self.run(formula, values, rows) for key, formula in self.columns[name].items() if key != "travel"]
        if column.text is not None:
            return Labels(np.zeros(rows, dtype=np.int64), (column.text,))
        if column.file_name is not None:
            words = _words_in(self.stem, column.file_name)
            words = words or _words_in(Path(self.raw.file).resolve().parent.name, column.file_name)
            if len(words) != 1:
                told = f"the file's name holds {' and '.join(words) or 'none'} of the words"
                allowed = "exactly one of " + ", ".join(column.file_name)
                raise self._fault(("columns", name, "file_name"), told, self.stem, allowed)
            return Labels(np.zeros(rows, dtype=np.int64), (words[0],))
        if column.lookup is not None:
            return self._looked_up(name, parts[0], column.values)
        if column.quaternion is not None:
            x, y, z, w = self._numbers(name, parts)
            data: ColumnData = transform.attitude(x, y, z, w, column.give)
        elif column.differentiate is not None:
            number = self._numbers(name, parts)[0]
            if name.endswith("yaw_rate_rad_s"):  # a helper as well
                turned = column.unit or ""
                number = transform.unwrap(number, 360.0 if turned.startswith(("deg", "°")) else 2 * np.pi)
            over = float(column.average) if column.average is not None else None
            data = transform.rate_of_change(number, np.asarray(result["time_s"]), over)
        else:
            data = parts[0] if parts else np.empty(0)
        if name == "time_s" and column.unit is None and (column.stamp is not None or column.value is not None):
            return self._stamps(column, [values[key] for key in column.stamp or ()] or [data])
        found = column_of(name)
        texts = found is not None and found[0].kind == "text"
        if isinstance(data, Labels):
            if (found is not None and not texts) or column.unit is not None:
                told = "this column holds text, not numbers"
                raise self._fault(("columns", name), told, got=", ".join(data.names[:5]))
            return data
        if column.unit is not None:
            try:
                data = to_glossary(data, column.unit, name)
            except InputError as error:
                fault = error.faults[0]
                path = ("columns", name, "unit")
                raise self._fault(path, fault.message, fault.got, fault.allowed, fault.hint) from None
        if texts:
            return _written(data)
        if column.average is not None and column.differentiate is None:
            data = transform.moving_average(data, np.asarray(result["time_s"]), float(column.average))
        if column.travel is not None:
            (speed,) = self._numbers(name, [self.run(self.columns[name]["travel"], values, rows)])
            data = np.where(transform.goes_back(speed), -data, data)
        return data

    def _stamps(self, column: ColumnMap, parts: list[ColumnData]) -> Array:
        """Times as the logger wrote them, in seconds."""
        names = column.stamp or (column.value,)
        try:
            found = read_stamps(parts, "time_s", column.zone, any(name in self.raw.local for name in names))
        except TimeError as error:
            at = f" ({self.raw.file}, line {line})" if error.row and (line := self.raw.line(error.row)) else ""
            raise self._fault(("columns", "time_s"), f"{error}{at}", ", ".join(map(str, names))) from None
        self.remarks += [remark for remark in found.remarks if remark not in self.remarks]
        self.clock = found.kind
        return found.seconds

    def _numbers(self, name: str, parts: list[ColumnData]) -> list[Array]:
        numbers = [part for part in parts if not isinstance(part, Labels)]
        if len(numbers) != len(parts):
            raise self._fault(("columns", name), "this column is computed from text")
        return numbers

    def _looked_up(self, name: str, data: ColumnData, table: dict[str, Any]) -> ColumnData:
        labels = data if isinstance(data, Labels) else _written(data)
        unknown = [word for word in labels.names if word not in table]
        if unknown:
            allowed, hint = ", ".join(map(str, table)), did_you_mean(unknown[0], [str(key) for key in table])
            told = f"'{unknown[0]}' has no value"
            raise self._fault(("columns", name, "values"), told, ", ".join(unknown[:10]), allowed, hint)
        given = [table[word] for word in labels.names]
        found = column_of(name)
        if all(isinstance(item, (int, float)) for item in given) and (found is None or found[0].kind != "text"):
            return numbers_of(labels, lambda word: float(table[word]))
        words = Labels.of(str(item) for item in given)
        return Labels(np.array([*words.codes, -1], dtype=np.int64)[labels.codes], words.names)

    def is_held(self, name: str) -> bool:
        """Whether a column comes from the refreshed signals, and so takes their value and no mean."""
        column = self.spec.columns.get(name)
        if column is not None and column.hold is not None:
            return column.hold
        return not _all_of([name], self._reads).isdisjoint(self.spec.refresh)


def _words_in(name: str, words: Iterable[str]) -> list[str]:
    """Those of some words that a name holds; not one that is part of another (``5kg`` of ``2.5kg``)."""
    held = [word for word in words if word.lower() in name.lower()]
    return [word for word in held if not any(word != other and word.lower() in other.lower() for other in held)]


def _all_of(names: Iterable[str], needs: Callable[[str], Iterable[str]]) -> set[str]:
    """Names, what they need, what that needs, and so on."""
    found: set[str] = set()
    todo = list(names)
    while todo:
        name = todo.pop()
        if name not in found:
            found.add(name)
            todo += needs(name)
    return found


def _written(numbers: Array) -> Labels:
    return Labels.of("" if np.isnan(number) else f"{number:g}" for number in numbers)

"""What the checks share: a list of faults and the question whether a name is known."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

from missionsim.errors import Fault, InputError, did_you_mean
from missionsim.inputs.tree import Document, as_written
from missionsim.inputs.validation import Faulty

if TYPE_CHECKING:
    from missionsim.inputs.robot import RobotSpec

Where = Sequence[str | int]
_SHOWN = 24

DERIVED = ("moving_time_s", "moving", "starts", "mass_kg", "drive_w", "load_w")
"""Covariates that a run or a log adds to the glossary's columns."""


class Checker:
    """Collects faults of one document."""

    def __init__(self, document: Document) -> None:
        self.document = document
        self.faults: list[Fault] = []

    def add(
        self,
        where: Where,
        message: str,
        got: str = "",
        allowed: str = "",
        hint: str = "",
        *,
        key: bool = False,
        warning: bool = False,
    ) -> None:
        """One fault at a path of the file, unless that place was told to be faulty already."""
        if not self.faulty(where):
            told = {"got": got, "allowed": allowed, "hint": hint, "severity": "warning" if warning else "error"}
            self.faults.append(self.document.fault(where, message, key=key, **told))

    def faulty(self, where: Where) -> bool:
        """Whether a fault was told at this path or above it."""
        faulty: Faulty | None = getattr(self.document, "faulty", None)
        return faulty is not None and faulty.under(self.document.original(where))

    def touched(self, *where: str | int) -> bool:
        """Whether a fault was told at, above or below this path."""
        faulty: Faulty | None = getattr(self.document, "faulty", None)
        return faulty is not None and faulty.related(self.document.original(where))

    def known(
        self, where: Where, name: str, names: Iterable[str], what: str, *, key: bool = False, message: str = ""
    ) -> bool:
        """Whether `name` is one of `names`; a fault with did-you-mean where it is not."""
        options = list(names)
        if name in options:
            return True
        shown = ", ".join(options[:_SHOWN]) + (f" and {len(options) - _SHOWN} more" if len(options) > _SHOWN else "")
        allowed, hint = shown or f"there is no {what} here", did_you_mean(name, options)
        self.add(where, message or f"no {what} '{name}'", as_written(name), allowed, hint, key=key)
        return False

    def keys(self, where: Where, given: object, names: Iterable[str], what: str) -> None:
        """Faults for the keys of a mapping that are none of `names`."""
        for name in given if isinstance(given, Mapping) else ():
            self.known((*where, name), name, names, what, key=True)

    def units(self, where: Where, name: str, count: int, robot: RobotSpec, least: int = 0, message: str = "") -> bool:
        """Whether a robot has a component, and as many units of it."""
        known = Checker(robot.document).raw_keys("components")
        key = where[-1] == name
        if not self.known(where, name, known, "component", key=key, message=message):
            return False
        spec = robot.components.get(name)
        if spec is not None and count > spec.units:
            at = where if key else (*where[:-1], "units")
            self.add(at, f"more units of '{name}' than the robot has", str(count), f"{least} to {spec.units}")
            return False
        return spec is not None

    def given(self, where: Where, key: str) -> bool:
        """Whether a key stands in the file, also with a value that is at fault."""
        children = self.document.node(where).children
        return isinstance(children, dict) and key in children

    def raw_keys(self, *where: str | int) -> list[str]:
        """Keys of a mapping as the file has them, also those whose values are at fault."""
        data = self.document.data
        for item in where:
            if isinstance(data, dict) and item in data:
                data = data[item]
            else:
                return []
        return [str(key) for key in data] if isinstance(data, dict) else []

    def formulas(self, texts: Mapping[tuple[str | int, ...], str], own: Iterable[str]) -> None:
        """Formulas, by their paths, that can be read, name what there is and together use all their parameters."""
        parameters = list(own)
        used: set[str] = set()
        for where, text in texts.items():
            names = self._names(where, text, parameters)
            if names is None:
                return
            used |= names
        where, text = next(iter(texts.items()))
        for name in parameters:
            if name not in used:
                self.add(where, f"parameter '{name}' does not occur in the formula", got=text[:80], warning=True)

    def _names(self, where: Where, text: str, parameters: list[str]) -> frozenset[str] | None:
        """Names that a formula reads, None where it cannot be read.

        Names of further log columns are allowed; one that is nearly a known name gets a warning.
        """
        from missionsim.effects.base_terms import ALIASES
        from missionsim.expressions import compile_expression
        from missionsim.glossary import COLUMNS, column_of

        try:
            expression = compile_expression(text, **self.document.place(where)._asdict())
        except InputError as problem:
            self.faults.extend(problem.faults)
            return None
        known = [*parameters, *ALIASES, *DERIVED, *(column.name for column in COLUMNS)]
        for name in sorted(expression.names):
            if name in known or column_of(name) is not None or name.startswith(("on_time_", "starting_")):
                continue
            hint = did_you_mean(name, known, 0.8)
            if hint:
                message = f"formula names '{name}', which is no column of the glossary"
                allowed = "a parameter, a glossary column, or a further column of your logs"
                self.add(where, message, text[:80], allowed, hint, warning=True)
        return expression.names

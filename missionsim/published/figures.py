"""Published figures as data, and the verdict on each when ours stands beside it."""

from __future__ import annotations

import csv
import math
from collections.abc import Mapping
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import Any

DATA = Path(__file__).parent / "data"
PAPERS: dict[str, str] = {
    "pioneer3dx": "jaiem2021",
    "khepera3": "parasuraman2012",
    "mecanum4": "hou2019",
    "rover_tx2": "rover2025",
}
"""Robot → its paper."""
TITLES: dict[str, str] = {
    "jaiem2021": "Jaiem, Crestani, Lapierre, Druon 2021: Energy Consumption of Control Schemes for the Pioneer 3DX "
    "Mobile Robot: Models and Evaluation",
    "parasuraman2012": "Parasuraman, Kershaw, Pagala, Ferre 2012: Model Based On-line Energy Prediction System for "
    "Semi-Autonomous Mobile Robots",
    "hou2019": "Hou, Zhang, Kim 2019: Energy Modeling and Experimental Validation of Four-Wheel Mecanum Mobile Robots",
    "rover2025": "Simulation of Mechanical and Computational Power Consumption in Mobile Robots",
}
AGREES, CONTRADICTS, UNCHECKABLE = "agrees", "paper contradicts itself", "cannot be checked"
CALIBRATED, DIFFERS = "calibrated", "differs"
STATUSES = (AGREES, CONTRADICTS, UNCHECKABLE, CALIBRATED, DIFFERS)


@dataclass(frozen=True)
class Figure:
    """One figure as printed.

    Attributes
    ----------
    paper, key, item, where : str
        Paper, our name for it, what it is, where it stands.
    printed : str
        As printed, with its trailing zeros.
    unit : str
    rule : str
        ``rounded`` (within half of the last digit), ``truncated`` (the paper cuts digits), ``inputs:<tolerance>`` (its
        own rounding and that of the printed numbers from which the paper computed it), ``about:<tolerance>`` (the text
        says about, roughly), ``at_least``, ``at_most``.
    basis : str
        Empty for a figure that can be computed; ``input`` (taken into the robot or mission file), ``fitted`` (a file
        is calibrated to it), ``contradiction`` (why it need not be met), ``uncheckable``.
    why : str
    """

    paper: str
    key: str
    item: str
    where: str
    printed: str
    unit: str
    rule: str
    basis: str
    why: str

    @property
    def value(self) -> float:
        """The figure as a number."""
        return float(self.printed)

    @property
    def last_digit(self) -> float:
        """Value of one unit in the last printed digit."""
        exponent = Decimal(self.printed).as_tuple().exponent
        return float(Decimal(1).scaleb(int(exponent)))

    @property
    def tolerance(self) -> float:
        """Greatest difference at which the figures agree as printed."""
        kind, _, given = self.rule.partition(":")
        if kind in ("about", "inputs"):
            return float(given)
        if kind == "truncated":
            return self.last_digit
        return 0.0 if kind in ("at_least", "at_most") else self.last_digit / 2.0

    def met(self, ours: float) -> bool:
        """Whether `ours` is the printed figure within the rounding of print."""
        slack = 1e-9 * max(1.0, abs(self.value))
        kind = self.rule.partition(":")[0]
        if kind == "at_least":
            return ours >= self.value - slack
        if kind == "at_most":
            return ours <= self.value + slack
        if kind == "truncated":
            excess = math.copysign(1.0, self.value or 1.0) * (ours - self.value)
            return -slack <= excess < self.last_digit - slack
        return abs(ours - self.value) <= self.tolerance + slack


@dataclass(frozen=True)
class Ours:
    """What our code computes for a figure: the value (None where nothing can be computed) and a remark."""

    value: float | None
    note: str = ""


@dataclass(frozen=True)
class Item:
    """One row of a reproduction table."""

    figure: Figure
    ours: float | None
    status: str
    note: str

    @property
    def difference(self) -> float | None:
        """Ours less the published one."""
        return None if self.ours is None else self.ours - self.figure.value

    def to_json(self) -> dict[str, Any]:
        """The row under the contract's names (``missionsim.reproduction/1``)."""
        figure = self.figure
        return {
            "paper": figure.paper,
            "item": figure.item,
            "where": figure.where,
            "published": figure.value,
            "ours": self.ours,
            "unit": figure.unit,
            "difference": self.difference,
            "tolerance": figure.tolerance,
            "rule": figure.rule,
            "status": self.status,
            "note": self.note,
            "key": figure.key,
            "printed": figure.printed,
        }


def load_figures(paper: str) -> dict[str, Figure]:
    """Every figure of a paper, by key, in the order of print."""
    with open(DATA / f"{paper}.csv", newline="", encoding="utf-8") as handle:
        rows = list(csv.DictReader(handle))
    names = ("key", "item", "where", "value", "unit", "rule", "basis", "why")
    return {row["key"]: Figure(paper, *(row[name] for name in names)) for row in rows}


def load_table(name: str) -> list[dict[str, str]]:
    """A data table of the package (configurations, not figures), as rows of text."""
    with open(DATA / f"{name}.csv", newline="", encoding="utf-8") as handle:
        return list(csv.DictReader(handle))


def judge(figure: Figure, ours: Ours | None) -> Item:
    """The verdict: what agrees, and if not, why not.

    A figure that a file was fitted to or took over is never ``agrees``, however close; one that cannot be met because
    the paper contradicts itself still counts as ``agrees`` where our value meets it after all.
    """
    note = "; ".join(part for part in ((ours.note if ours else ""), figure.why) if part)
    if figure.basis == "uncheckable" or ours is None or ours.value is None:
        value = ours.value if ours else None
        return Item(figure, value, UNCHECKABLE, note or "nothing in the paper to compute it from")
    met = figure.met(ours.value)
    if figure.basis == "input":
        return Item(figure, ours.value, CALIBRATED if met else DIFFERS, f"input: {note}")
    if figure.basis == "fitted":
        return Item(figure, ours.value, CALIBRATED, note if "calibrated" in note else f"calibrated to it: {note}")
    if met:
        return Item(figure, ours.value, AGREES, (ours.note if figure.basis else note))
    return Item(figure, ours.value, CONTRADICTS if figure.basis == "contradiction" else DIFFERS, note)


def judge_all(paper: str, ours: Mapping[str, Ours]) -> list[Item]:
    """Every figure of a paper beside ours.

    Raises
    ------
    KeyError
        Where ours holds a key that the paper's data does not.
    """
    figures = load_figures(paper)
    unknown = set(ours) - set(figures)
    if unknown:
        raise KeyError(f"no such figures in {paper}: {sorted(unknown)}")
    return [judge(figure, ours.get(key)) for key, figure in figures.items()]

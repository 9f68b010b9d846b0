"""Published figures as data, the verdict on each when ours stands beside it, and runs of the shipped missions."""

from __future__ import annotations

import csv
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Decimal
from pathlib import Path
from typing import TYPE_CHECKING, Any

from missionsim.files import fields_of
from missionsim.inputs import load_mission, load_robot
from missionsim.inputs.loading import examples_folder
from missionsim.inputs.tree import read_document

if TYPE_CHECKING:
    from missionsim.engine.outcome import RunResult
    from missionsim.inputs.mission import MissionSpec
    from missionsim.inputs.robot import RobotSpec

DATA = Path(__file__).parent / "data"


@dataclass(frozen=True)
class Paper:
    """What is said of a paper: its robot, title, how its reproduction reads, and its tables and pictures by name.

    `numbers` are the figures that stand in the robot file: key → place.
    """

    robot: str
    title: str
    reading: str
    numbers: Mapping[str, str]
    tables: Mapping[str, str]
    pictures: Mapping[str, str]


_TEXTS: dict[str, Any] = read_document(DATA / "papers.yaml").data
HEAD: str = _TEXTS["head"]
ABOUT = {name: Paper(**about) for name, about in _TEXTS["papers"].items()}
"""Every paper by its name."""
PAPERS = {about.robot: name for name, about in ABOUT.items()}
"""Robot → its paper."""
AGREES, CONTRADICTS, UNCHECKABLE = "agrees", "paper contradicts itself", "cannot be checked"
CALIBRATED, DIFFERS = "calibrated", "differs"
STATUSES = (AGREES, CONTRADICTS, UNCHECKABLE, CALIBRATED, DIFFERS)


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure as printed."""

    paper: str
    key: str
    item: str
    where: str
    """These: paper, our name for it, what it is, where it stands."""
    printed: str
    """As printed, with its trailing zeros."""
    unit: str
    rule: str
    """``rounded`` (within half of the last digit), ``truncated`` (the paper cuts digits), ``inputs:<tolerance>`` (its
    own rounding and that of the printed numbers from which the paper computed it), ``about:<tolerance>`` (the text says
    about, roughly), ``at_least``, ``at_most``."""
    basis: str
    """Empty for a figure that can be computed; ``input`` (taken into the robot or mission file), ``fitted`` (a file is
    calibrated to it), ``contradiction`` (why it need not be met), ``uncheckable``."""
    why: str

    @property
    def value(self) -> float:
        """The figure as a number."""
        return float(self.printed)

    @property
    def last_digit(self) -> float:
        """Value of one unit in the last printed digit."""
        return float(Decimal(1).scaleb(int(Decimal(self.printed).as_tuple().exponent)))

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

    def to_json(self) -> dict[str, object]:
        """The row under the contract's names (``missionsim.reproduction/1``)."""
        figure = self.figure
        named = {**fields_of(figure, "paper item where"), "published": figure.value, "ours": self.ours}
        named |= {"unit": figure.unit, "difference": self.difference, **fields_of(figure, "tolerance rule")}
        return named | fields_of(self, "status note") | fields_of(figure, "key printed")


def load_figures(paper: str) -> dict[str, Figure]:
    """Every figure of a paper, by key, in the order of print."""
    return {row["key"]: Figure(paper=paper, printed=row.pop("value"), **row) for row in load_table(paper)}


def numbers_of_robot(paper: str) -> dict[str, Ours]:
    """The figures that stand in the paper's robot file, by key."""
    robot = shipped_robot(ABOUT[paper].robot)

    def at(part: Any, steps: list[str]) -> float:
        for step in steps:
            if isinstance(part, Mapping):
                part = part[step]
            else:
                part = part[int(step)] if isinstance(part, Sequence) else getattr(part, step)
        return float(part)

    return {key: Ours(at(robot, place.split("."))) for key, place in ABOUT[paper].numbers.items()}


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
    """Every figure of a paper beside ours. Raises KeyError: where ours holds a key that the paper's data does not."""
    figures = load_figures(paper)
    unknown = set(ours) - set(figures)
    if unknown:
        raise KeyError(f"no such figures in {paper}: {sorted(unknown)}")
    return [judge(figure, ours.get(key)) for key, figure in figures.items()]


Overrides = tuple[tuple[str, str], ...]


@functools.cache
def shipped_robot(name: str) -> RobotSpec:
    """A shipped robot."""
    return load_robot(name)


@functools.lru_cache(maxsize=256)
def mission(name: str, overrides: Overrides = ()) -> MissionSpec:
    """A shipped mission by ``robot/name``, with values set as on the command line."""
    return load_mission(examples_folder() / "missions" / f"{name}.yaml", overrides=overrides)


@functools.lru_cache(maxsize=256)
def run(name: str, overrides: Overrides = ()) -> RunResult:
    """The simulation of a shipped mission."""
    from missionsim.engine.simulate import simulate

    return simulate(mission(name, overrides))

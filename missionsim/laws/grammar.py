"""The grammar of laws: factors over logged quantities, each with its unit, multiplied up to three at a time.

Every law is written as the ``power:`` of an ``effects:`` entry. Thresholds, time constants and
reference values are read off the logs (quantiles of what was driven), so they say where the logs lie, not what is true.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Container, Mapping, Sequence
from dataclasses import KW_ONLY, dataclass, field, replace
from functools import cached_property
from itertools import combinations

import numpy as np

from missionsim.effects.base_terms import unit_named
from missionsim.expressions import Powers, compile_expression, units_in
from missionsim.identify.proposed import CLOCKS
from missionsim.physics import Array, Ints

MOST_FACTORS, MOST_LATE = 3, 2
"""The second with a lag among them."""
NEIGHBOURS = (0, 1, 2, 4, 8, 16)
"""Numbers beside that of a factor that are tried next, by their place from the nearest on."""
SPLITS = 80
"""Thresholds between the lowest and the highest at which something may be switched."""
Values = Callable[[], Sequence[Array]]
"""What gives the values of a factor in every run at its raw rate."""


@dataclass(frozen=True)
class Factor:
    """One factor of a law."""

    variable: str
    """The logged quantity that it is about; a law holds one factor of a variable."""
    text: str
    """As the robot file writes it."""
    symbol: str
    """For people."""
    rank: int = 0
    """0 for the plain quantity; higher for forms that bend it. Of forms that fit alike the plainest is shown first."""
    gives_back: bool = False
    """Whether power may be negative with it (braking, descending)."""
    _: KW_ONLY
    kind: str = ""
    """Factors of one kind differ in their numbers only (a threshold, a time constant)."""
    numbers: tuple[float, ...] = ()
    fine: bool = False
    """One of the numbers between those that the first pass tries."""
    alone: bool = False
    """Whether it is a whole law, which nothing is multiplied with."""
    halved: bool = False
    """Whether the first number lies between two of those that the logs gave."""
    another: Callable[[float], tuple[Factor, Values]] | None = field(default=None, compare=False, repr=False)
    """The same with another first number, where that may be any."""

    @property
    def switches(self) -> bool:
        """Whether it is on from a threshold on, or up to it, and that may be any."""
        return self.another is not None and re.fullmatch(r"\(\S+ [<>] \S+\)", self.text) is not None


@dataclass(frozen=True)
class Grammar:
    """All factors that the logs allow, and what gives the values of each in every run at its raw rate."""

    factors: tuple[Factor, ...]
    values: tuple[Values, ...]

    def products(self, forms: Sequence[Sequence[int]]) -> list[Array]:
        """Power of forms for a coefficient of 1 in each run at its raw rate, arrays (forms, rows)."""
        factors = [[self.values[i]() for i in form] for form in forms]
        runs = range(len(factors[0][0]))
        return [np.array([np.prod([rows[j] for rows in form], axis=0) for form in factors]) for j in runs]

    def with_levels(self, name: str, parts: Mapping[int, float]) -> Grammar:
        """The grammar with one factor more: levels of a label, each its part of the highest. What all have in common
        stands alone, so that a level which no run has seen is not free of cost."""
        least = min(float(f"{part:.2g}") for part in parts.values())
        more = {i: float(f"{part - least:.2g}") for i, part in parts.items() if part > least + 0.005}
        common = [f"{least:.2g}"] if least else []
        text = " + ".join(common + [f"{part:.2g} * {self.factors[i].text}" for i, part in more.items()])
        symbol = " + ".join(common + [f"{part:.2g}·{self.factors[i].symbol}" for i, part in more.items()])

        def values() -> list[Array]:
            runs = zip(*(self.values[i]() for i in more), strict=True)
            return [least + np.sum([p * x for p, x in zip(more.values(), run, strict=True)], axis=0) for run in runs]

        new = Factor(name, f"({text})", f"({symbol})", 1, fine=True)
        return replace(self, factors=(*self.factors, new), values=(*self.values, values))

    def without(self, names: Container[str]) -> Grammar:
        """The grammar without the factors of some quantities and of their memories."""
        pairs = zip(self.factors, self.values, strict=True)
        left = [(f, v) for f, v in pairs if f.variable.partition(" ")[0] not in names]
        return replace(self, factors=tuple(f for f, _ in left), values=tuple(v for _, v in left))

    def forms(self, memory: bool = False) -> list[Ints]:
        """Every product by its number of factors: arrays of shape (forms, 1), (forms, 2), (forms, 3).

        With `memory`, only those that read a first-order lag, else only those that do not.
        """
        names = ["clock" if f.variable in CLOCKS else f.variable for f in self.factors]  # a law holds one of them
        number = {name: i for i, name in enumerate(dict.fromkeys(names))}
        of = np.array([number[name] for name in names], dtype=np.intp)
        plain = np.array([not self.memory([i]) for i in range(len(self.factors))], dtype=bool)
        alone = np.array([f.alone for f in self.factors], dtype=bool)
        used = [i for i, f in enumerate(self.factors) if not f.fine and (memory or plain[i])]
        found = []
        for size in range(1, (MOST_LATE if memory else MOST_FACTORS) + 1):
            rows = np.array(list(combinations(used, size)), dtype=np.intp).reshape(-1, size)
            variables = of[rows]
            keep = (plain[rows].all(axis=1) != memory) & ((size == 1) | ~alone[rows].any(axis=1))
            for i, j in combinations(range(size), 2):
                keep &= variables[:, i] != variables[:, j]
            found.append(rows[keep])
        return found

    def bent(self, form: Sequence[int]) -> list[tuple[int, ...]]:
        """The same form with another number near by in one of its factors."""
        found = []
        for at, i in enumerate(form):
            own = self.factors[i]
            for place, number in enumerate(own.numbers):
                others = []
                for j in self.kinds.get(own.kind, ()):
                    apart = [k for k, n in enumerate(self.factors[j].numbers) if n != own.numbers[k]]
                    if apart == [place]:
                        others.append((abs(self.factors[j].numbers[place] - number), j))
                found += [
                    (*form[:at], j, *form[at + 1 :])
                    for _, j in (sorted(others)[n] for n in NEIGHBOURS if n < len(others))
                ]
        return found

    def halfway(self, form: Sequence[int]) -> tuple[Grammar, list[tuple[int, ...]]]:
        """The same form with a number half-way to its neighbours, below and above, in one of its factors; the grammar
        holds those numbers too."""
        factors, values, forms = list(self.factors), list(self.values), list[tuple[int, ...]]()
        for at, i in enumerate(form):
            own = self.factors[i]
            if own.another is None:
                continue
            number, *more = own.numbers
            alike = {f.numbers[0]: j for j, f in enumerate(factors) if f.kind == own.kind and [*f.numbers[1:]] == more}
            sides = (
                max((n for n in alike if n < number), default=None),
                min((n for n in alike if n > number), default=None),
            )
            for side in sides:
                middle = number if side is None else float(f"{0.5 * (number + side):.3g}")
                if middle in (number, side):
                    continue
                factor, found = own.another(middle)
                alike[middle] = len(factors)
                factors.append(factor)
                values.append(found)
                forms.append((*form[:at], alike[middle], *form[at + 1 :]))
        return replace(self, factors=tuple(factors), values=tuple(values)), forms

    def splits(self, form: Sequence[int]) -> tuple[Grammar, list[list[tuple[int, ...]]]]:
        """The same form with one of its factors switched on (or off) at any of many thresholds, for each quantity and
        side; the grammar holds those thresholds too."""
        factors, values, found = list(self.factors), list(self.values), list[list[tuple[int, ...]]]()
        for at, i in enumerate(form):
            sides = [f for f in self.factors if f.variable == self.factors[i].variable and f.switches and not f.halved]
            for another in dict.fromkeys(f.another for f in sides):
                ends = [f.numbers[0] for f in sides if f.another is another]
                thresholds = dict.fromkeys(float(f"{n:.3g}") for n in np.linspace(min(ends), max(ends), SPLITS))
                more = [another(n) for n in thresholds if another is not None]
                first = len(factors)
                factors += [factor for factor, _ in more]
                values += [value for _, value in more]
                found.append([(*form[:at], j, *form[at + 1 :]) for j in range(first, len(factors))])
        return replace(self, factors=tuple(factors), values=tuple(values)), found

    def unscreened(self, form: Sequence[int]) -> list[list[tuple[int, ...]]]:
        """The same form with another factor of the same quantity, by kinds that are not its own and of which the first
        pass has no number; in the order of their numbers."""
        found = []
        for at, i in enumerate(form):
            groups: dict[tuple[str, tuple[float, ...]], list[int]] = {}
            for j, factor in enumerate(self.factors):
                if factor.variable == self.factors[i].variable and factor.another is not None and not factor.halved:
                    groups.setdefault((factor.kind, factor.numbers[1:]), []).append(j)
            found += [
                [(*form[:at], j, *form[at + 1 :]) for j in group]
                for group in groups.values()
                if all(self.factors[j].fine and self.factors[j].kind != self.factors[i].kind for j in group)
            ]
        return found

    @cached_property
    def kinds(self) -> dict[str, tuple[int, ...]]:
        """Factors of each kind."""
        found: dict[str, tuple[int, ...]] = {}
        for i, factor in enumerate(self.factors):
            if factor.kind and not factor.halved:
                found[factor.kind] = (*found.get(factor.kind, ()), i)
        return found

    def text(self, form: Sequence[int]) -> str:
        """The law as the robot file writes it: ``k * abs(yaw_rate_rad_s) * payload_kg``."""
        return " * ".join(["k", *(self.factors[i].text for i in form)])

    def symbol(self, form: Sequence[int]) -> str:
        """The same for people: ``k·|ω|·payload``."""
        return "·".join(["k", *(self.factors[i].symbol for i in form)])

    def unit(self, form: Sequence[int]) -> str:
        """Unit of the coefficient, such as ``W s/rad/kg``."""
        return unit_of(self.text(form))

    def variables(self, form: Sequence[int]) -> tuple[str, ...]:
        """Quantities that a law is about; a memory of a quantity counts as the quantity."""
        factors = (self.factors[i] for i in form)
        read = (compile_expression(f.text).names if f.alone else {f.variable.partition(" ")[0]} for f in factors)
        return tuple(dict.fromkeys(name for names in read for name in sorted(names)))

    def memory(self, form: Sequence[int]) -> bool:
        """Whether it reads what was before: a first-order lag. A rate is no memory."""
        return any("lag(" in self.factors[i].text and not self.factors[i].alone for i in form)


def unit_of(formula: str) -> str:
    """Unit of ``k`` in ``k * …``, such as ``W s/rad/kg``, so that the whole is in W.

    Quantities that the glossary does not hold count as plain numbers but for those named as powers, and so do switches,
    comparisons and what stands in an exponential or a hyperbolic tangent.
    """
    found = units_in(formula, _powers, {}) or {}
    left = {name: float(name == "W") - found.get(name, 0.0) for name in ("W", *found)}
    over = [name if p == 1 else f"{name}^{p:g}" for name, p in left.items() if p > 0]
    under = [f"/{name}" if p == -1 else f"/{name}^{-p:g}" for name, p in left.items() if p < 0]
    return " ".join(over or ["1"]) + "".join(under)


def _powers(name: str) -> Powers:
    powers: Powers = {}
    watts = "kW" if name.endswith("_kw") else "W" if name.endswith("_w") else ""
    for index, part in enumerate((unit_named(name) or watts).split("/")):
        for base, power in re.findall(r"([A-Za-z]+)(?:\^(\d))?", part):
            powers["K" if base == "degC" else base] = float(power or 1) * (1 if index == 0 else -1)
    return powers

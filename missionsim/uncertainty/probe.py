"""How the numbers of a plan follow from the uncertain values, found by varying one at a time and checked on draws.

A leg's length is a map's length times a path stretch, its speed the speed asked times the part of it that is reached:
the plan's numbers are products of powers, or sums, of the files' numbers. That is found here without writing the
planner a second time; what does not fit such a form is not evaluated as arrays.
"""

from __future__ import annotations

import functools
import math
from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
_Step = tuple[NDArray[np.intp], NDArray[np.intp], str, Array]
RELATIVE_TOLERANCE = 1e-12
_STEPS = (0.01, -0.013)
_GOLDEN = 0.6180339887498949
Name = TypeVar("Name", bound=Hashable)


@dataclass(frozen=True)
class Dependence:
    """Numbers of a plan as functions of uncertain values.

    Attributes
    ----------
    base : ndarray, shape (entries,)
        The numbers at the nominal values.
    nominal : mapping of str to float
    powers : mapping of str to (entries, exponents)
        For products: value name → indices of `base` and the exponent of the value's ratio to its nominal one.
    slopes : mapping of str to (entries, slopes)
        For sums.
    """

    base: Array
    nominal: Mapping[str, float]
    powers: Mapping[str, tuple[NDArray[np.intp], Array]]
    slopes: Mapping[str, tuple[NDArray[np.intp], Array]]

    @property
    def varying(self) -> NDArray[np.intp]:
        """Entries that depend on any value."""
        parts = [index for index, _ in (*self.powers.values(), *self.slopes.values())]
        return np.unique(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.intp)

    def changes(self, draws: Mapping[str, Array], count: int) -> Array:
        """Ratios of values to their nominal ones, for products, then differences, for sums: shape (values, count)."""
        found = np.empty((len(self.powers) + len(self.slopes), count))
        for i, name in enumerate(self.powers):
            np.multiply(draws[name], 1.0 / self.nominal[name], out=found[i])
        for i, name in enumerate(self.slopes, start=len(self.powers)):
            np.subtract(draws[name], self.nominal[name], out=found[i])
        return found

    def at(self, changes: Array, entries: tuple[int, ...]) -> Array:
        """Entries at draws.

        Parameters
        ----------
        changes : ndarray, shape (values, runs)
            See `changes`.
        entries : tuple of int
            Indices of `base`.

        Returns
        -------
        ndarray, shape (runs, asked) in Fortran order
            Or (1, asked) where none of them varies.
        """
        base, steps = self._steps(entries)
        if not steps:
            return base
        place, value, how, coefficient = steps[0]
        if how == "times" and len(place) == len(entries):
            rows = changes[value]
            rows *= base.T
            steps = steps[1:]
        else:
            rows = np.empty((len(entries), changes.shape[1]))
            rows[:] = base.T
        for place, value, how, coefficient in steps:
            if how == "times":
                rows[place] *= changes[value]
            elif how == "over":
                rows[place] /= changes[value]
            else:
                rows[place] += coefficient[:, None] * changes[value]
        return rows.T

    def _steps(self, entries: tuple[int, ...]) -> tuple[Array, list[_Step]]:
        """Of these entries, `base` as a row, and how to go on from it: in a step, each takes part once at most."""
        if entries not in self._known:
            both = [*((False, name) for name in self.powers), *((True, name) for name in self.slopes)]
            rank = {key: i for i, key in enumerate(both)}
            steps: dict[tuple[int, str], list[tuple[int, int, float]]] = {}
            for place, entry in enumerate(entries):
                for turn, (name, how, coefficient) in enumerate(self._of.get(entry, ())):
                    steps.setdefault((turn, how), []).append((place, rank[how == "plus", name], coefficient))
            self._known[entries] = (
                self.base[None, list(entries)],
                [
                    (
                        np.array([s[0] for s in step]),
                        np.array([s[1] for s in step]),
                        how,
                        np.array([s[2] for s in step]),
                    )
                    for (_, how), step in sorted(steps.items())
                ],
            )
        return self._known[entries]

    @functools.cached_property
    def _known(self) -> dict[tuple[int, ...], tuple[Array, list[_Step]]]:
        return {}

    @functools.cached_property
    def _of(self) -> Mapping[int, list[tuple[str, str, float]]]:
        """Entry → (value, how it enters, slope), factors first."""
        found: dict[int, list[tuple[str, str, float]]] = {}
        for name, (index, exponents) in self.powers.items():
            for entry, exponent in zip(index.tolist(), exponents.tolist(), strict=True):
                found.setdefault(entry, []).append((name, "times" if exponent == 1.0 else "over", exponent))
        for name, (index, slopes) in self.slopes.items():
            for entry, slope in zip(index.tolist(), slopes.tolist(), strict=True):
                found.setdefault(entry, []).append((name, "plus", slope))
        return found


def probe(
    numbers_of: Callable[[Mapping[str, float]], Array],
    nominal: Mapping[str, float],
    checks: Sequence[Mapping[str, float]],
) -> Dependence | str:
    """Find the form of every entry and check it on draws.

    Parameters
    ----------
    numbers_of : callable
        Values by name → numbers, shape (entries,); raises ValueError where the structure changes.
    nominal : mapping
        Value by name.
    checks : list of mapping
        Draws on which the form must hold.

    Returns
    -------
    Dependence or str
        The forms, or why there are none.
    """
    try:
        base = numbers_of(nominal)
        powers: dict[str, tuple[NDArray[np.intp], Array]] = {}
        slopes: dict[str, tuple[NDArray[np.intp], Array]] = {}
        for batch in _apart(_supports(numbers_of, base, nominal)):
            # values that touch different entries are varied together
            steps = {name: [nominal[name] * step if nominal[name] else step for step in _STEPS] for name in batch}
            changed = [
                numbers_of({**nominal, **{name: nominal[name] + steps[name][i] for name in batch}})
                for i in range(len(_STEPS))
            ]
            for name, index in batch.items():
                form = _form(base[index], [numbers[index] for numbers in changed], nominal[name], steps[name])
                if form is None:
                    return f"the plan depends neither as a product nor as a sum on {name}"
                product, coefficients = form
                for chosen, found_so in ((product, powers), (~product, slopes)):
                    if chosen.any():
                        found_so[name] = (index[chosen], coefficients[chosen])
        found = Dependence(base, dict(nominal), powers, slopes)
        for draw in checks:
            changes = found.changes({name: np.array([value]) for name, value in draw.items()}, 1)
            predicted = base.copy()
            varying = found.varying
            predicted[varying] = found.at(changes, tuple(varying.tolist()))[0]
            if not np.all(_same(predicted, numbers_of(draw), 1e-9 * RELATIVE_TOLERANCE, 4 * RELATIVE_TOLERANCE)):
                return "the plan's numbers are no products or sums of the uncertain values"
    except ValueError as error:
        return str(error)
    return found


def _supports(
    numbers_of: Callable[[Mapping[str, float]], Array], base: Array, nominal: Mapping[str, float]
) -> dict[str, NDArray[np.intp]]:
    """Entries that each value changes; values that change none are left out.

    Groups of values are varied and halved, as in group testing; groups whose entries are known to be different ones
    share an evaluation. Where each value touches its own part of a plan, twice the logarithm of their number suffices.
    """
    # steps that differ from value to value, so that a value in the numerator hides none in the denominator
    step = {name: _STEPS[0] * (1.0 + math.modf(i * _GOLDEN)[0]) for i, name in enumerate(nominal)}

    def narrowed(groups: Mapping[tuple[str, ...], NDArray[np.intp]]) -> dict[tuple[str, ...], NDArray[np.intp]]:
        found: dict[tuple[str, ...], NDArray[np.intp]] = {}
        for batch in _apart(groups):
            moved = {name: nominal[name] + step[name] * (nominal[name] or 1.0) for group in batch for name in group}
            changed = ~_same(numbers_of({**nominal, **moved}), base)
            found |= {group: index[changed[index]] for group, index in batch.items()}
        return {group: index for group, index in found.items() if index.size}

    groups = narrowed({tuple(nominal): np.arange(base.size)}) if nominal else {}
    while any(len(group) > 1 for group in groups):
        halves: dict[tuple[str, ...], NDArray[np.intp]] = {}
        for group, index in groups.items():
            half = (len(group) + 1) // 2
            halves |= {part: index for part in (group[:half], group[half:]) if part}
        groups = narrowed(halves)
    order = {group[0]: index for group, index in groups.items()}
    return {name: order[name] for name in nominal if name in order}


def _apart(supports: Mapping[Name, NDArray[np.intp]]) -> list[dict[Name, NDArray[np.intp]]]:
    """Batches in which no entry belongs to two."""
    batches: list[tuple[set[int], dict[Name, NDArray[np.intp]]]] = []
    for name, index in supports.items():
        own = set(index.tolist())
        for taken, batch in batches:
            if taken.isdisjoint(own):
                taken |= own
                batch[name] = index
                break
        else:
            batches.append((own, {name: index}))
    return [batch for _, batch in batches]


def _same(a: Array, b: Array, absolute: float = 0.0, relative: float = 1e-14) -> NDArray[np.bool_]:
    return np.asarray(np.isclose(a, b, rtol=relative, atol=absolute, equal_nan=True))


def _form(
    base: Array, changed: list[Array], value: float, steps: list[float]
) -> tuple[NDArray[np.bool_], Array] | None:
    """Products and their exponents, the others being sums with a slope; None where some is neither."""
    product = np.full(base.shape, bool(value)) & (base != 0.0)
    known = base[product]
    wanted = [1.0 + step / (value or 1.0) for step in steps]
    ratios = [(numbers[product] / known, want) for numbers, want in zip(changed, wanted, strict=True)]
    up = np.all([_same(got, np.full_like(got, want), 0.0, RELATIVE_TOLERANCE) for got, want in ratios], axis=0)
    down = np.all([_same(got, np.full_like(got, 1 / want), 0.0, RELATIVE_TOLERANCE) for got, want in ratios], axis=0)
    coefficients = np.zeros(base.shape)
    coefficients[product] = np.where(up, 1.0, -1.0)
    product[product] = up | down
    slope = [(numbers - base)[~product] / step for numbers, step in zip(changed, steps, strict=True)]
    if not np.all(_same(slope[0], slope[1], 0.0, 1e-9)):
        return None
    coefficients[~product] = slope[0]
    return product, coefficients

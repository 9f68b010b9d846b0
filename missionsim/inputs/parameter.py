"""A number of a file (`Parameter`), and what can be wrong with one (`Issue`)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, replace

from missionsim.inputs.base import Model
from missionsim.inputs.distributions import Distribution

STATUSES = ("published", "fitted", "assumed", "measured")


@dataclass(frozen=True)
class Parameter:
    """A number of a robot, environment or mission file."""

    value: float
    """Nominal value in the SI unit `unit` (energies J, angles rad, temperatures degC)."""
    sd: float | None = None
    """Standard deviation, same unit."""
    low: float | None = None
    high: float | None = None
    """Both: range that was given; bounds of a fit for parameters of effects, of a uniform distribution elsewhere."""
    distribution: Distribution | None = None
    """What a Monte Carlo draws from; None for a certain number."""
    status: str = ""
    source: str = ""
    """Both, and `note`: ``published``, ``fitted``, ``assumed``, ``measured`` or empty; where the number comes from."""
    unit: str = "1"
    """SI unit; for parameters of effects and motion models the unit that the file names."""
    _: KW_ONLY
    note: str = ""
    path: str = ""
    """Dotted path in its file, such as ``components.laser.loads.0.power``; empty for a default."""
    line: int = 0
    """1-based line in its file, 0 where there is none."""

    def __float__(self) -> float:
        return self.value

    def scaled(self, factor: float, unit: str) -> Parameter:
        """`factor` times the parameter, in another unit."""
        sd, low, high = (None if number is None else number * factor for number in (self.sd, self.low, self.high))
        drawn = None if self.distribution is None else self.distribution.scaled(factor)
        return replace(self, value=self.value * factor, sd=sd, low=low, high=high, distribution=drawn, unit=unit)


class Issue(ValueError):
    """One thing wrong inside a quantity, at a key below it."""

    def __init__(self, message: str, got: str = "", allowed: str = "", hint: str = "", at: tuple[str | int, ...] = ()):
        super().__init__(message)
        self.entry = {"message": message, "got": got, "allowed": allowed, "hint": hint, "at": at}


class Issues(list[Issue]):
    """What is wrong with one quantity; as a context, an issue that is raised is one more."""

    def tell(self, message: str, got: str, allowed: str, hint: str = "", at: tuple[str | int, ...] = ()) -> None:
        """One more thing that is wrong."""
        self.append(Issue(message, got, allowed, hint, at))

    def __enter__(self) -> Issues:
        return self

    def __exit__(self, kind: object, issue: BaseException | None, traceback: object) -> bool:
        if isinstance(issue, Issue):
            self.append(issue)
        return isinstance(issue, Issue)


def parameters(model: object) -> list[tuple[str, Parameter]]:
    """Paths and parameters of all numbers that a model's file gives, in the file's order."""
    result: list[tuple[str, Parameter]] = []
    stack: list[object] = [model]
    while stack:
        item = stack.pop()
        if isinstance(item, Parameter):
            if item.path:
                result.append((item.path, item))
        elif isinstance(item, Model):
            stack.extend(getattr(item, name) for name in reversed(type(item).model_fields))
        elif isinstance(item, Mapping):
            stack.extend(reversed(list(item.values())))
        elif isinstance(item, tuple):
            stack.extend(reversed(item))
    return result


def uncertain_values(model: object) -> list[tuple[str, Parameter]]:
    """Those of `parameters` that have a distribution."""
    return [(path, parameter) for path, parameter in parameters(model) if parameter.distribution is not None]

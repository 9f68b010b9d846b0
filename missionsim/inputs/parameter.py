"""A number of a file (`Parameter`), and what can be wrong with one (`Issue`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

from missionsim.inputs.distributions import Distribution

STATUSES = ("published", "fitted", "assumed", "measured")


@dataclass(frozen=True)
class Parameter:
    """A number of a robot, environment or mission file.

    Attributes
    ----------
    value : float
        Nominal value in the SI unit `unit` (energies J, angles rad, temperatures degC).
    sd : float or None
        Standard deviation, same unit.
    low, high : float or None
        Range that was given; bounds of a fit for parameters of effects, of a uniform distribution elsewhere.
    distribution : Distribution or None
        What a Monte Carlo draws from; None for a certain number.
    status, source, note : str
        ``published``, ``fitted``, ``assumed``, ``measured`` or empty, and where the number comes from.
    unit : str
        SI unit; for parameters of effects and motion models the unit that the file names.
    path : str
        Dotted path in its file, such as ``components.laser.loads.0.power``; empty for a default.
    line : int
        1-based line in its file, 0 where there is none.
    """

    value: float
    sd: float | None = None
    low: float | None = None
    high: float | None = None
    distribution: Distribution | None = None
    status: str = ""
    source: str = ""
    unit: str = "1"
    note: str = ""
    path: str = ""
    line: int = 0

    def __float__(self) -> float:
        return self.value

    @property
    def uncertain(self) -> bool:
        """Whether a Monte Carlo varies it."""
        return self.distribution is not None

    def with_value(self, value: float) -> Parameter:
        """The same parameter at another nominal value."""
        return replace(self, value=float(value))

    def scaled(self, factor: float, unit: str) -> Parameter:
        """`factor` times the parameter, in another unit."""

        def times(number: float | None) -> float | None:
            return None if number is None else number * factor

        distribution = None if self.distribution is None else self.distribution.scaled(factor)
        return replace(
            self,
            value=self.value * factor,
            sd=times(self.sd),
            low=times(self.low),
            high=times(self.high),
            distribution=distribution,
            unit=unit,
        )


class Issue(ValueError):
    """One thing wrong inside a quantity, at a key below it."""

    def __init__(self, message: str, got: str = "", allowed: str = "", hint: str = "", at: tuple[str | int, ...] = ()):
        super().__init__(message)
        self.entry = {"message": message, "got": got, "allowed": allowed, "hint": hint, "at": at}

"""What remains in the residual, as records; `missionsim.identify.findings` hands them on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any


@dataclass(frozen=True)
class Structure:
    """Something that remains in the residual and depends on a covariate (or is periodic, or a level).

    Attributes
    ----------
    covariate : str
        Empty where it depends on nothing.
    p_value, gain_nats : float
    size_share : float
        Its mean size as share of the mean power.
    shape : str
        In words.
    knots, curve_w : tuple of float
        Its curve [W] (multiplied by the covariate ``times``, if any).
    """

    covariate: str
    p_value: float
    gain_nats: float
    size_share: float
    shape: str
    knots: tuple[float, ...] = ()
    curve_w: tuple[float, ...] = ()
    times: str = ""


@dataclass(frozen=True)
class Unexplained:
    """What remains after everything that was found."""

    share_of_residual: float
    depends_on: tuple[str, ...]
    shape: str
    structures: tuple[Structure, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """The contract's fields."""
        return {"share_of_residual": self.share_of_residual, "depends_on": list(self.depends_on), "shape": self.shape}

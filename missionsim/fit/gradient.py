"""Change of a battery's power with the logarithm of each parameter, term by term where terms do not feed each other."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from missionsim.effects.model import PowerModel

Array = NDArray[np.float64]
_STEP = 1e-4


def gradient(model: PowerModel, cov: Mapping[str, Any], battery: str) -> dict[str, Array]:
    """``∂P/∂ln θ`` of every parameter of a battery [W], arrays of shape (n,).

    Where no term reads the power of others only the parameter's own term is evaluated, by central differences of 1e-4,
    exact for parameters in which it is linear or quadratic. Parameters that are zero have no logarithm and are left
    out, and so are those without any influence.

    Parameters
    ----------
    model : PowerModel
    cov : mapping
        Covariates of one run, complete.
    battery : str
    """
    rows = len(cov["time_s"])
    coupled = any(
        (term.effect.recovers or term.effect.of_load) and any(p.value != 0.0 for p in term.parameters.values())
        for term in model.of(battery)
    )
    whole = model.gradient(cov, battery, base_only=False) if coupled else {}
    found: dict[str, Array] = {
        name: np.ascontiguousarray(np.broadcast_to(np.asarray(values, dtype=float), (rows,)))
        for name, values in whole.items()
    }
    for term in () if coupled else model.of(battery):
        nominal = {name: parameter.value for name, parameter in term.parameters.items()}
        for name, value in nominal.items():
            if value == 0.0:
                continue
            up, down = (
                np.asarray(term.effect.power(cov, {**nominal, name: value * (1.0 + sign * _STEP)}), dtype=float)
                for sign in (1.0, -1.0)
            )
            slope = np.broadcast_to(term.scale * (up - down) / (2.0 * _STEP), (rows,))
            short = term.name_of(name)
            found[short] = np.ascontiguousarray(found[short] + slope if short in found else slope)
    return found

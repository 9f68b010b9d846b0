"""Identification of missing physical effects from measured runs: arrays in, findings out (docs/method.md).

The model is ``y = P0(θ) + N ν + Φ β + Z u + ε``. `missionsim.identify.rules` holds the gates and demotions in their
order, `missionsim.identify.verdict` sets the verdict, `missionsim.identify.settings` has every constant with its why.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from missionsim.identify.data import Candidate as Candidate
    from missionsim.identify.data import RunData as RunData
    from missionsim.identify.findings import BatteryDiagnosis as BatteryDiagnosis
    from missionsim.identify.findings import Diagnosis as Diagnosis
    from missionsim.identify.findings import Estimate as Estimate
    from missionsim.identify.findings import Finding as Finding
    from missionsim.identify.identification import Identification as Identification
    from missionsim.identify.identification import fit_effects as fit_effects
    from missionsim.identify.identification import identify as identify
    from missionsim.identify.settings import Settings as Settings

_PUBLIC = {
    "BatteryDiagnosis": "findings",
    "Candidate": "data",
    "Diagnosis": "findings",
    "Estimate": "findings",
    "Finding": "findings",
    "Identification": "identification",
    "RunData": "data",
    "Settings": "settings",
    "fit_effects": "identification",
    "identify": "identification",
}

__all__ = [*_PUBLIC]


def __getattr__(name: str) -> Any:
    """Load the public names when they are asked for: settings alone must not load NumPy."""
    module = _PUBLIC.get(name)
    if module is None:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{module}"), name)

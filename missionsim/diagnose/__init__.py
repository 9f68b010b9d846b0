"""From a robot and its logs to a verdict: which physical effect is missing, or what to drive to find out."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from missionsim import command_package

if TYPE_CHECKING:
    from missionsim.diagnose.diagnosis import diagnose, diagnose_files
    from missionsim.diagnose.examine import Subject
    from missionsim.identify.findings import Diagnosis

__all__ = ["Diagnosis", "Subject", "diagnose", "diagnose_files"]


def __getattr__(name: str) -> Any:
    """Load the public names when they are asked for."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from missionsim.diagnose import diagnosis
    from missionsim.identify import findings

    return getattr(findings if name == "Diagnosis" else diagnosis, name)


command_package(__name__)

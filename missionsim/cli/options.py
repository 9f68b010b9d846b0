"""Options that commands share; apart from `common`, since only the command-line parser needs their declarations."""

from __future__ import annotations

from typing import Annotated

from cyclopts import Parameter

FALSE_ALARM_RATE = 0.002
"""`missionsim.identify.settings.ALPHA`, which would load NumPy here."""
JsonOption = Annotated[str | None, Parameter(name="--json", allow_leading_hyphen=True)]
"""Where to write the result as JSON: a file, or - for standard output."""
QuietOption = Annotated[bool, Parameter(name="--quiet", negative="")]
"""Print nothing but what was asked for."""

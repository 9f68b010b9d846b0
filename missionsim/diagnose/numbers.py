"""Powers in words."""

from __future__ import annotations

import math


def watts(power_w: float) -> str:
    """Two significant digits with a sign, never as a power of ten."""
    digits = 1 - math.floor(math.log10(abs(power_w))) if power_w and math.isfinite(power_w) else 0
    return f"{round(power_w, digits):+.{max(digits, 0)}f}".replace("-", "−")

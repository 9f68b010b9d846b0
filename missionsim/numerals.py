"""Numbers as people read them: three digits, thousands with commas, a true minus, no power of ten where it can be
avoided; powers and clocks in words."""

from __future__ import annotations

import math


def rounded(value: float, digits: int = 3, *, sign: bool = False) -> str:
    """A number with `digits` significant digits, all that stand before the point; a dash where there is none.

    `sign`: whether a positive number has one.
    """
    if not math.isfinite(value):
        return "–"
    if value == 0.0:
        return "+0" if sign else "0"
    magnitude = math.floor(math.log10(abs(float(f"{value:.{digits - 1}e}"))))
    form = f".{digits - 1}e" if magnitude < -4 or magnitude > 8 else f",.{max(0, digits - 1 - magnitude)}f"
    front = "−" if value < 0.0 else "+" if sign else ""
    return f"{front}{abs(value):{form}}"


def bare(value: float, digits: int = 4) -> str:
    """A number such as `rounded` gives, without zeros at its end: for parameters, of which many are round."""
    text = rounded(value, digits)
    return text.rstrip("0").rstrip(".") if "." in text and "e" not in text else text


def watts(value: float, digits: int = 3, *, sign: bool = False) -> str:
    """``9,356 W``: a power is told in watts everywhere, so that any two can be compared."""
    return f"{rounded(value, digits, sign=sign)} W"


def meter_clock(delay_s: float, lag_s: float) -> str:
    """Where the meter of a battery lies beside the motion: ``0.90 s ahead of the motion, lag 0.30 s``."""
    beside = "with the motion"
    if abs(delay_s) >= 0.005:
        beside = f"{abs(delay_s):.2f} s {'behind' if delay_s > 0.0 else 'ahead of'} the motion"
    return f"{beside}, lag {lag_s:.2f} s"


def counted(count: int, thing: str) -> str:
    """``1 row``, ``2 rows``."""
    return f"{count} {thing}{'s' * (count != 1)}"


def p_told(p: float, digits: int = 1, what: str = "p =") -> str:
    """``p = 7e-21``; what is too small for a number of the machine is below the least one told, and not nought."""
    return f"{what.removesuffix(' =')} < 1e-300" if p < 1e-300 else f"{what} {p:.{digits}g}"


def in_wh(wh: float, *, sign: bool = False) -> str:
    """``15,343.007``: watt-hours with three decimals, which is how every energy is told."""
    if not math.isfinite(wh):
        return "–"
    front = "−" if round(wh, 3) < 0.0 else "+" if sign else ""
    return f"{front}{abs(wh):,.3f}"

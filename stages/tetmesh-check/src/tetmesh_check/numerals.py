"""Numbers for people, with few digits."""

from __future__ import annotations

import math

_PLAIN = (1e-3, 1e7)
"""Range of magnitudes that are written without an exponent."""


def plain(value: float, digits: int = 3, spaced: bool = False) -> str:
    """Write a number with some significant digits; from 1000 on without decimals.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits of numbers below 1000.
    spaced
        Whether narrow spaces separate the thousands.
    """
    if not math.isfinite(value) or value == 0:
        return f"{value:g}"
    rounded = float(f"{value:.{digits - 1}e}")
    if abs(rounded) < _PLAIN[0] or (abs(rounded) >= _PLAIN[1] and not spaced):
        return f"{value:.{digits}g}"
    if abs(rounded) >= 1000:
        return f"{value:,.0f}".replace(",", "\u202f" if spaced else "")
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(rounded))))
    text = f"{rounded:.{decimals}f}"
    return text.rstrip("0").rstrip(".") if "." in text else text

"""Numbers for people, with few digits."""

from __future__ import annotations

_NO_EXPONENT_BELOW = 1e7
"""Larger numbers are written with an exponent, unless spaces separate the thousands."""


def plain(value: float, digits: int = 3, spaced: bool = False) -> str:
    """Write a number with a few significant digits, and without decimals from 1000 on.

    Parameters
    ----------
    value
        The number.
    digits
        Significant digits of numbers below 1000.
    spaced
        Whether narrow spaces separate the thousands.
    """
    rounded = float(f"{value:.{digits - 1}e}")
    if abs(rounded) >= 1000 and (spaced or abs(rounded) < _NO_EXPONENT_BELOW):
        return f"{value:,.0f}".replace(",", "\u202f" if spaced else "")
    return f"{rounded:.{max(digits, 3)}g}"

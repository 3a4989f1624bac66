"""Tests of number formatting."""

from __future__ import annotations

import pytest

from tetmesh_check.numerals import plain


@pytest.mark.parametrize(
    ("value", "digits", "text"),
    [
        (99.7, 2, "100"), (999.7, 3, "1000"), (0.0012345, 3, "0.00123"), (-0.08514, 3, "-0.0851"), (0.5, 3, "0.5"),
        (123456.7, 3, "123457"), (1.5e7, 3, "1.5e+07"), (2e-5, 3, "2e-05"), (0.0, 3, "0"),
    ],
)  # fmt: skip
def test_numbers_have_exponents_only_far_from_one(value: float, digits: int, text: str) -> None:
    assert plain(value, digits) == text


def test_thousands_can_be_spaced() -> None:
    assert plain(12345678.0, spaced=True) == "12\u202f345\u202f678"

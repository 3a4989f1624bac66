"""Published power laws E = a rho^b of bone, and calibrations of grey values.

rho is in g/cm^3 and E in N/mm^2 (MPa). A law expects the kind of density that its authors measured:
the apparent density is wet mass by total volume, the ash density is mass of ash by total volume.
"""

from __future__ import annotations

import argparse
import math
from dataclasses import dataclass
from statistics import linear_regression


@dataclass(frozen=True)
class Law:
    """A power law E = a rho^b."""

    a: float
    """E of the density 1 g/cm^3, N/mm^2."""
    b: float
    kind: str = "calibrated"
    """Kind of density: apparent, ash, or that of the calibration."""
    reference: str = "given on the command line"


LAWS = {
    "vertebra": Law(4730.0, 1.56, "apparent", "Morgan, Bayraktar, Keaveny, J Biomech 36:897-904, 2003"),
    "keller": Law(10500.0, 2.29, "ash", "Keller, J Biomech 27:1159-1168, 1994"),
}
"""Laws by name: ``vertebra`` is for trabecular bone of that site, ``keller`` for trabecular and
cortical bone. The constants are those of public programs that cite these papers."""


def read_law(text: str) -> Law:
    """Parse the name of a law, or ``A,B``."""
    if text in LAWS:
        return LAWS[text]
    try:
        a, b = (float(word) for word in text.split(","))
    except ValueError:
        a = b = math.nan
    if not (0.0 < a < math.inf and 0.0 < b < math.inf):
        raise argparse.ArgumentTypeError(f"'{text}' is neither two positive numbers A,B nor one of {', '.join(LAWS)}")
    return Law(a, b)


@dataclass(frozen=True)
class Calibration:
    """The density of a grey value: slope times value plus intercept, g/cm^3."""

    slope: float
    intercept: float
    rods: tuple[tuple[float, float], ...] = ()
    """Grey value and density of each rod of a phantom, if the line is fitted to rods."""

    @property
    def residual(self) -> float:
        """Root mean square of the differences between the rods and the line, g/cm^3."""
        squares = [(self.slope * value + self.intercept - density) ** 2 for value, density in self.rods]
        return math.sqrt(sum(squares) / max(len(squares), 1))


def read_calibration(text: str) -> Calibration:
    """Parse ``SLOPE,INTERCEPT``, or ``VALUE:DENSITY`` of two or more rods, separated by commas."""
    try:
        pairs = [[float(number) for number in word.split(":")] for word in text.split(",")]
        if len(pairs) == 2 and all(len(pair) == 1 for pair in pairs):
            found = Calibration(pairs[0][0], pairs[1][0])
        else:
            rods = tuple((value, density) for value, density in pairs)
            found = Calibration(*linear_regression(*zip(*rods, strict=True)), rods)
    except ValueError:
        # also a single rod, and rods of the same grey value
        found = Calibration(math.nan, math.nan)
    if not (0.0 < found.slope < math.inf and math.isfinite(found.intercept)):
        raise argparse.ArgumentTypeError(
            f"'{text}' is neither SLOPE,INTERCEPT nor VALUE:DENSITY of two or more rods, whose density grows with the value"
        )
    return found

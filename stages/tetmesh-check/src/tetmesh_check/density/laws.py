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
    measured: tuple[float, float] | None = None
    """Range of densities that the authors measured, g/cm^3."""
    reference: str = "given on the command line"


_MORGAN = "Morgan, Bayraktar, Keaveny, J Biomech 36:897-904, 2003"
LAWS = {
    "femoral-neck": Law(6850.0, 1.49, "apparent", (0.26, 0.75), _MORGAN),
    "trochanter": Law(15010.0, 2.18, "apparent", (0.14, 0.28), _MORGAN),
    "tibia": Law(15520.0, 1.93, "apparent", (0.09, 0.41), _MORGAN),
    "vertebra": Law(4730.0, 1.56, "apparent", (0.11, 0.35), _MORGAN),
    "trabecular": Law(8920.0, 1.83, "apparent", (0.09, 0.75), _MORGAN),
    "cortical": Law(3891.0, 2.39, "apparent", (1.75, 1.95), "Snyder, Schneider, J Orthop Res 9:422-431, 1991"),
    # a = 3790 (strain rate)^0.06, here for 0.01 per second
    "carter-hayes": Law(
        3790.0 * 0.01**0.06, 3.0, "apparent", (0.07, 2.0), "Carter, Hayes, J Bone Joint Surg Am 59:954-962, 1977"
    ),
    "keller": Law(10500.0, 2.29, "ash", (0.03, 1.22), "Keller, J Biomech 27:1159-1168, 1994"),
}
"""Laws by name. The first four are for trabecular bone of one site, ``trabecular`` is for these
sites together. ``cortical`` is for the tibia. The last two cover trabecular and cortical bone.
The constants and ranges have not been compared with the papers yet."""


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

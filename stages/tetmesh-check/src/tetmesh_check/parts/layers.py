"""Prism layers on walls: number, heights and material."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from tetmesh_check.parts.algebra import Definition, read_expression
from tetmesh_check.quality import Values

MAX_COUNT = 50
"""Maximum number of layers; a larger number is taken for a mistake. With a ratio of 1.1, 50 layers
are (1.1^50 - 1) / 0.1 = 1,164 times as thick as the first."""


@dataclass(frozen=True)
class Layers:
    """The value of ``--layers``."""

    wall: Definition
    """The expression of the wall; its text is the whole option."""
    material: str
    """Name of the material that gets the layers; empty if the wall has only one."""
    count: int
    first: float
    """Height of the first layer, mm."""
    ratio: float
    """Height of each layer over that of the layer before it."""

    @property
    def depths(self) -> Values:
        """Distance of each layer's inner side from the wall, mm, shape ``(count,)``."""
        return np.cumsum(self.first * self.ratio ** np.arange(self.count))

    @property
    def told(self) -> str:
        """The option as given."""
        return f"--layers {self.wall.text}"


def read_layers(text: str) -> Layers:
    """Parse ``MATERIAL:WALL=N,MM,RATIO``; raise ``ValueError`` if it is malformed."""
    given, _, numbers = text.rpartition("=")
    material, colon, expression = given.rpartition(":")
    try:
        count, first, ratio = (float(word) for word in numbers.split(","))
    except ValueError:
        count = first = ratio = math.nan
    if not given or (colon and not material.strip()) or math.isnan(count + first + ratio):
        raise ValueError(f"'{text}' is not WALL=N,MM,RATIO or MATERIAL:WALL=N,MM,RATIO")
    if count not in range(1, MAX_COUNT + 1):
        raise ValueError(f"'{text}': the number of layers must be a whole number from 1 to {MAX_COUNT}")
    if not (0.0 < first < math.inf and 0.0 < ratio < math.inf):
        raise ValueError(f"'{text}': the first height (mm) and the ratio must be above 0 and finite")
    return Layers(Definition("layers", text, read_expression(expression)), material.strip(), int(count), first, ratio)

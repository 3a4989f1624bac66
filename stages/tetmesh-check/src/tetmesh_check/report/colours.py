"""Colours of materials: the same in pictures and on the page."""

from __future__ import annotations

import colorsys

import numpy as np
from numpy.typing import NDArray

_GOLDEN = 0.6180339887
"""Step from hue to hue: by the golden section no two of any few in a row are alike."""
_FIRST_HUE = 0.08
_LIGHTNESS = (0.62, 0.48, 0.74)
"""In turn, because there are more materials than hues that can be told apart."""
_SATURATION = 0.55


def region_colours(count: int) -> NDArray[np.uint8]:
    """Colours of materials by their numbers, bytes, shape ``(count, 3)``; neighbours in number differ in hue.

    Parameters
    ----------
    count
        How many, the outside included.
    """
    colours = [
        colorsys.hls_to_rgb((_FIRST_HUE + number * _GOLDEN) % 1.0, _LIGHTNESS[number % len(_LIGHTNESS)], _SATURATION)
        for number in range(count)
    ]
    shades: NDArray[np.uint8] = np.round(255.0 * np.array(colours).reshape(-1, 3)).astype(np.uint8)
    return shades

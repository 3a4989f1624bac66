"""Figures printed in section 6 of Kim, Chen and Hansen (2012).

Machine of the paper: Intel Xeon X5650 (one thread) and NVIDIA Tesla C2070.
"""

from __future__ import annotations

TABLE_1 = {
    "heart": ((0.92114, 0.249245), (0.92079, 0.117757)),
    "lungs": ((0.912578, 0.217819), (0.913214, 0.324375)),
    "ribcage": ((0.914975, 0.186664), (0.914975, 0.186664)),
}
"""Mean and minimum radius ratio, CPU and GPU. The paper prints one pair twice for the ribcage."""

TABLE_2 = {
    "lungs": (835.26, 74153, 107.64, 74129),
    "heart": (3150.38, 80125, 245.77, 80594),
    "ribcage": (9460.29, 468877, 269.12, 468623),
}
"""Seconds and particles on the CPU, then on the GPU."""

TABLE_3 = {
    60000: (213.22, 57456, 34.75, 56844),
    90000: (444.62, 81432, 48.82, 80208),
    120000: (756.8, 103913, 66.35, 103716),
    150000: (1360.87, 131145, 98.26, 133792),
    180000: (1571.96, 145958, 100.76, 146754),
    210000: (2354.04, 170805, 141.4, 175775),
    240000: (2860.53, 185035, 160.28, 194354),
    270000: (3455.14, 200925, 172.31, 208866),
    300000: (4042.60, 225054, 183.98, 237921),
}
"""Seconds and remaining particles on the CPU, then on the GPU, by number of seeds."""

TABLE_4 = [
    (3798.74, 317809, 160.17, 323762),
    (5526.21, 377681, 200.6, 384531),
    (5952.6, 398838, 212.19, 405097),
    (8805.9, 428885, 265.8, 431491),
    (9460.29, 464265, 269.12, 468623),
    (11356.3, 493697, 285.51, 494477),
    (19750.2, 530565, 445.49, 530717),
]
"""Seconds and particles on the CPU, then on the GPU.

The rows go from epsilon 8 to 0.01; the last one has refinement level 7.
"""


def organ(name: str) -> str:
    """Return the printed organ with which to compare an object."""
    for word, found in (
        ("heart", "heart"),
        ("lungs", "lungs"),
        ("ribcage", "ribcage"),
        ("labels 2", "lungs"),
        ("labels 1", "ribcage"),
    ):
        if word in name:
            return found
    raise KeyError(name)


def quality(name: str) -> list[str]:
    """Return the two printed columns of Table 1."""
    return [f"{mean:.3f} / {smallest:.2f}" for mean, smallest in TABLE_1[organ(name)]]


def times(name: str) -> list[str]:
    """Return the three printed columns of Table 2."""
    cpu, _, gpu, _ = TABLE_2[organ(name)]
    return [f"{cpu:,.0f}", f"{gpu:.0f}", f"{cpu / gpu:.1f}"]


def lost(seeds: int) -> list[float]:
    """Return the percentages of the seeds of Table 3 that were deleted, CPU and GPU."""
    _, cpu, _, gpu = TABLE_3[seeds]
    return [100 * (1 - left / seeds) for left in (cpu, gpu)]

"""Volumes of the recipes: simple shapes in NumPy, written as NRRD files or TIFF slices.

    python volumes.py torso          # writes torso.nrrd
    python volumes.py torso --small  # a small part of it, for tests

The shapes have the sizes of the organs, in mm. The axes follow LPS: x points to the left, y to the
back, z to the head. No volume contains data of a person.
"""

from __future__ import annotations

import argparse
import gzip
import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

Values = NDArray[Any]


@dataclass(frozen=True)
class Grid:
    """Voxel centres in a box."""

    voxel: float
    """Voxel spacing, mm."""
    low: tuple[float, float, float]
    """Lowest coordinates of the box, mm."""
    high: tuple[float, float, float]
    """Highest coordinates of the box, mm."""

    def axes(self) -> tuple[Values, Values, Values]:
        """Return the coordinates, mm, as arrays that broadcast to the grid."""
        x, y, z = (np.arange(a, b, self.voxel, dtype=np.float32) for a, b in zip(self.low, self.high, strict=True))
        return x[:, None, None], y[None, :, None], z[None, None, :]

    def write(self, path: Path, values: Values) -> None:
        """Write a volume with the axes x, y and z as an NRRD file."""
        kind = {"uint8": "uint8", "int16": "int16"}[values.dtype.name]
        vectors = " ".join(f"({','.join(str(self.voxel * (i == k)) for k in range(3))})" for i in range(3))
        header = (
            f"NRRD0004\ntype: {kind}\ndimension: 3\nsizes: {' '.join(map(str, values.shape))}\n"
            f"space: left-posterior-superior\nspace directions: {vectors}\n"
            f"space origin: ({','.join(map(str, self.low))})\nendian: little\nencoding: gzip\n\n"
        )
        path.write_bytes(header.encode() + gzip.compress(values.tobytes(order="F"), 1, mtime=0))


def ball(axes: Sequence[Values], centre: Sequence[float], radii: Sequence[float], power: float = 2.0) -> Values:
    """Return the approximate distance from an ellipsoid, or from a cylinder for two axes.

    A larger power makes the shape more like a box.
    """
    parts = (np.abs((a - c) / r) ** power for a, c, r in zip(axes, centre, radii, strict=True))
    distance: Values = (sum(parts) ** (1.0 / power) - 1.0) * min(radii)
    return distance


def rod(axes: Sequence[Values], start: Sequence[float], end: Sequence[float], radii: tuple[float, float]) -> Values:
    """Return the approximate distance from a rod with round ends and different radii there."""
    direction = np.subtract(end, start)
    away = [a - s for a, s in zip(axes, start, strict=True)]
    along = np.clip(sum(d * a for d, a in zip(direction, away, strict=True)) / (direction @ direction), 0.0, 1.0)
    distance: Values = np.sqrt(sum((a - d * along) ** 2 for d, a in zip(direction, away, strict=True)))
    distance -= radii[0] + (radii[1] - radii[0]) * along
    return distance


def join(a: Values, b: Values, width: float) -> Values:
    """Return the union of two shapes with a fillet of this width, mm."""
    blend = np.clip(0.5 + 0.5 * (b - a) / width, 0.0, 1.0)
    return b + (a - b) * blend - width * blend * (1.0 - blend)


def waves(axes: Sequence[Values], length: float, count: int, seed: int) -> Values:
    """Return a random field with mean 0 and standard deviation 1: plane waves of one length, mm."""
    random = np.random.default_rng(seed)
    directions = random.normal(size=(count, 3))
    directions *= 2.0 * np.pi / length / np.linalg.norm(directions, axis=1)[:, None]
    phases = random.uniform(0.0, 2.0 * np.pi, count)
    x, y, z = axes
    # cos(a + b + c) as the real part of a product of exponentials of single coordinates
    total: Values = np.zeros(np.broadcast_shapes(x.shape, y.shape, z.shape), np.float32)
    for (a, b, c), phase in zip(directions, phases, strict=True):
        total += (np.exp(1j * (a * x + phase)) * np.exp(1j * b * y) * np.exp(1j * c * z)).real
    total *= np.sqrt(2.0 / count)
    return total


def blurred(values: Values, times: int) -> Values:
    """Return the values after some passes of the filter (1, 2, 1) / 4 along each axis."""
    for _ in range(times):
        for axis in range(3):
            wide = np.pad(values, [(1, 1) if axis == k else (0, 0) for k in range(3)], mode="edge")
            low, middle, high = (np.take(wide, range(k, k + values.shape[axis]), axis) for k in range(3))
            values = 0.25 * (low + 2.0 * middle + high)
    return values


def torso(small: bool) -> None:
    """Write torso.nrrd, the labels of seven tissues of a chest that the border cuts.

    1 fat, 2 muscle, 3 bone, 4 lungs, 5 heart, 6 blood, 7 liver.
    """
    grid = Grid(3.0, (-30, -120, -60), (90, 0, 0)) if small else Grid(3.0, (-186, -126, -162), (187, 127, 163))
    axes = x, y, z = grid.axes()
    width = 1.0 + 0.05 * np.cos(np.pi * z / 160.0)
    cage = ball(axes, (0, 4, -60), (126, 80, 190), 2.4)
    stripe = (z - 0.45 * y) % 34.0 - 17.0
    ribs = (np.hypot(cage / 6.0, stripe / 8.0) < 1.0) & (np.abs(z - 0.45 * y - 15) < 85)
    sternum = ball(axes, (0, -74, 25), (17, 8, 80), 3.0)
    spine = np.minimum(ball((x, y), (0, 62), (20, 17)), ball((x, y), (0, 82), (8, 14))) + 0.0 * z
    # the axis of the heart points to the left, to the front and down
    u, v = 0.68 * x - 0.48 * y - 0.55 * z - 24.0, 0.58 * x + 0.81 * y + 3.0
    w = 0.45 * x - 0.33 * y + 0.83 * z + 4.0
    heart = ball((u, v, w), (0, 0, 0), (60, 42, 44))
    left, right = ball((u, v, w), (-6, 10, 3), (40, 17, 19)), ball((u, v, w), (-10, -19, -2), (40, 11, 24))
    aorta = np.minimum(
        rod(axes, (-2, 0, 30), (-6, -6, 88), (14, 13)), rod(axes, (16, 36, 84), (14, 36, -200), (11, 10))
    )
    aorta = join(aorta, rod(axes, (-6, -6, 88), (16, 36, 84), (13, 11)), 6.0)
    dome = z + 42.0 - 34.0 * np.exp(-(((np.abs(x) - 62.0) / 46.0) ** 2) - ((y - 4.0) / 60.0) ** 2) - 8.0 * (x < 0)
    middle = ball((x, y), (2, 20), (24, 50)) + 0.0 * z
    lungs = (cage < -10) & (dome > 0) & (middle > 0) & (heart > 8) & (spine > 7) & (aorta > 7) & (sternum > 6)
    liver = (cage < -12) & (dome < -10) & (ball(axes, (-44, -8, -84), (84, 70, 60)) < 0)
    labels = np.zeros(cage.shape, np.uint8)
    for number, inside in enumerate(
        (
            ball((x / width, y / width), (0, 0), (164, 106), 2.5) < 0,
            ball((x / width, y / width), (0, 0), (150, 94), 2.5) < 0,
            ribs | (sternum < 0) | (spine < 0),
            lungs,
            heart < 0,
            (aorta < 0) & (heart > -12) | (left < 0) | (right < 0),
            liver,
        ),
        start=1,
    ):
        labels[np.broadcast_to(inside, labels.shape)] = number
    grid.write(Path("torso.nrrd"), labels)


def heart(small: bool) -> None:
    """Write heart.nrrd, the labels of two ventricles that the upper border cuts at their base.

    1 blood of the left ventricle, 2 muscle, 3 blood of the right ventricle.
    """
    shrink = 0.6 if small else 1.0
    grid = Grid(1.0, (-46 * shrink, -36 * shrink, -72 * shrink), (62 * shrink, 37 * shrink, 20 * shrink))
    axes = tuple(axis / shrink for axis in grid.axes())
    left, right = ball(axes, (0, 0, 0), (20, 20, 56)), ball(axes, (22, 0, 0), (28, 24, 50))
    wall = ball(axes, (0, 0, 0), (31, 31, 67))
    muscle = join(wall, ball(axes, (22, 0, 0), (33, 29, 55)), 6.0)
    labels = np.zeros(muscle.shape, np.uint8)
    labels[muscle < 0] = 2
    labels[(right < 0) & (wall > 0)] = 3
    labels[left < 0] = 1
    grid.write(Path("heart.nrrd"), labels)


def femur(small: bool) -> None:
    """Write femur-ct.nrrd, a CT in Hounsfield units, and femur-label.nrrd: the upper left femur.

    The origin is the centre of the femoral head. The lower border cuts the shaft.
    """
    grid = Grid(1.5, (-33, -36, -40 if small else -150), (78, 40, 33))
    axes = x, y, z = grid.axes()
    bone = join(ball(axes, (0, 0, 0), (23, 23, 23)), rod(axes, (0, 0, 0), (36, 3, -32), (14, 17)), 8.0)
    shaft = rod(axes, (40, 4, -34), (38, 2, -220), (17, 13))
    bone = join(bone, join(shaft, rod(axes, (46, 8, -26), (50, 10, -10), (17, 13)), 10.0), 14.0)
    bone = join(bone, ball(axes, (26, 16, -64), (10, 9, 12)), 10.0)
    # cortical bone gets thicker along the shaft, down to the marrow cavity
    thick = 2.0 + 4.5 / (1.0 + np.exp((z + 62.0) / 10.0)) * (x > 8)
    arch = rod(axes, (-4, -2, 16), (28, 2, -50), (5, 4))
    spongy = 180.0 + 320.0 / (1.0 + np.exp(arch / 4.0)) + 160.0 * np.exp(-((x**2 + y**2 + z**2) / 15.0**2))
    spongy = spongy + 25.0 * waves(axes, 9.0, 30, 1)
    canal = 1.0 / (1.0 + np.exp((z + 70.0) / 8.0))
    scan = np.where(bone < 0, (1.0 - canal) * spongy - 60.0 * canal, 40.0)
    scan = np.where((bone < 0) & (bone > -thick), 1350.0, scan)
    noise = np.random.default_rng(1).normal(0.0, 15.0, bone.shape)
    grid.write(Path("femur-ct.nrrd"), (blurred(scan, 2) + noise).round().astype(np.int16))
    grid.write(Path("femur-label.nrrd"), (bone < 0).astype(np.uint8))


def head(small: bool) -> None:
    """Write head.nrrd, the labels of a head that the lower border cuts at the neck.

    1 white matter, 2 grey matter, 3 cerebrospinal fluid, 4 bone, 5 scalp, 6 eyes.
    """
    grid = Grid(2.0, (-90, -120, -44 if small else -110), (91, -40 if small else 115, 0 if small else 111))
    axes = x, _, z = grid.axes()
    scalp = join(ball(axes, (0, 0, 4), (78, 98, 98)), rod(axes, (0, 20, -60), (0, 30, -140), (56, 54)), 30.0)
    scalp = join(scalp, ball(axes, (0, -60, -55), (46, 44, 60)), 30.0)
    scalp = join(scalp, ball(axes, (0, -102, -34), (11, 14, 18)), 10.0)
    for side in (-1, 1):
        scalp = join(scalp, ball(axes, (side * 80, 14, -22), (6, 16, 26)), 5.0)
    skull, inner = ball(axes, (0, 4, 8), (70, 88, 86)), ball(axes, (0, 4, 8), (63, 81, 79))
    folds = np.abs(waves(axes, 34.0, 40, 3))
    fissure = np.exp(-((x / 3.0) ** 2)) * (z > -10)
    brain = ball(axes, (0, 4, 8), (60, 78, 76))
    cortex = brain + 8.0 * np.exp(-((folds / 0.22) ** 2)) + 30.0 * fissure
    white = brain + 4.5 + 12.0 * np.exp(-((folds / 0.5) ** 2)) + 30.0 * np.exp(-((x / 7.0) ** 2)) * (z > -4)
    eyes = np.minimum(*(ball(axes, (side * 31, -78, -20), (12, 12, 12)) for side in (-1, 1)))
    labels = np.zeros(scalp.shape, np.uint8)
    for number, distance in ((5, scalp), (4, skull), (3, inner), (2, cortex), (1, white)):
        labels[(distance < 0) & (scalp < 0)] = number
    labels[(eyes < 0) & (skull > 2)] = 6
    grid.write(Path("head.nrrd"), labels)


def aneurysm(_: bool) -> None:
    """Write aneurysm.nrrd, the label of an artery that forks below an aneurysm. No small one."""
    grid = Grid(0.25, (-13, -6, -15), (13.1, 6.6, 12))
    axes = grid.axes()
    lumen = rod(axes, (0, 0, -20), (0, 0, 0), (1.8, 1.6))
    for side in (-1, 1):
        lumen = join(lumen, rod(axes, (0, 0, 0), (side * 18, 0, 6), (1.5, 1.3)), 1.2)
    sac = join(ball(axes, (0.4, 0.4, 5.4), (4.2, 3.7, 4.2)), ball(axes, (2.6, 1.0, 8.8), (1.7, 1.6, 1.6)), 1.0)
    grid.write(Path("aneurysm.nrrd"), (join(lumen, sac, 1.2) < 0).astype(np.uint8))


def trabecular(small: bool) -> None:
    """Write the folder trabecular of TIFF slices: a cube of spongy bone, grey values 0 to 255."""
    side = 1.2 if small else 3.0  # of the square section
    grid = Grid(0.025, (0, 0, 0), (side, side, 3.0))
    field = waves(grid.axes(), 0.85, 60, 5)
    noise = np.random.default_rng(1).normal(0.0, 6.0, field.shape)
    grey = 110.0 + 70.0 * np.tanh(4.0 * (field - 0.62)) + noise
    folder = Path("trabecular")
    folder.mkdir(exist_ok=True)
    for number, section in enumerate(np.moveaxis(np.clip(grey, 0, 255).astype(np.uint8), 2, 0)):
        Image.fromarray(section.T).save(folder / f"slice{number:03}.tif")


def tooth(small: bool) -> None:
    """Write tooth.nrrd, a scan of a molar: pulp 150, dentine 1700, enamel 2800, else 0."""
    shrink = 0.7 if small else 1.0
    grid = Grid(0.15, (-6 * shrink, -5.5 * shrink, -15.8 * shrink), (6 * shrink, 5.6 * shrink, 5.7 * shrink))
    axes = _, _, z = tuple(axis / shrink for axis in grid.axes())
    crown = ball(axes, (0, 0, 0), (5.4, 4.9, 4.0), 2.8)
    pulp = ball(axes, (0, 0, -0.8), (2.3, 1.9, 1.5), 2.5)
    for a, b in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
        crown = join(crown, ball(axes, (2.7 * a, 2.4 * b, 3.0), (1.9, 1.8, 2.1)), 1.0)
    core = crown + 0.9 + 0.08 * (z + 3.0)
    for tip in ((-3.2, -2.2, -14), (-3.0, 2.4, -13), (3.0, 0, -14.4)):
        foot = (0.75 * tip[0], 0.75 * tip[1], -3.0)
        crown, core = (join(shape, rod(axes, foot, tip, (2.2, 0.9)), 1.5) for shape in (crown, core))
        pulp = join(
            pulp, rod(axes, (0.4 * tip[0], 0.4 * tip[1], -1.4), (0.93 * tip[0], 0.93 * tip[1], -12.6), (0.6, 0.3)), 0.8
        )
    scan = np.where(crown < 0, np.where((core < 0) | (z < -3.2), 1700.0, 2800.0), 0.0)
    scan = np.where(pulp < 0, 150.0, scan)
    noise = np.random.default_rng(1).normal(0.0, 25.0, scan.shape)
    grid.write(Path("tooth.nrrd"), (blurred(scan, 2) + noise).round().astype(np.int16))


RECIPES: dict[str, Callable[[bool], None]] = {
    recipe.__name__: recipe for recipe in (torso, heart, femur, head, aneurysm, trabecular, tooth)
}


def main() -> None:
    """Write the volumes of a recipe to the current folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recipe", choices=RECIPES)
    small = os.environ.get("RECIPE_SMALL") == "yes"
    parser.add_argument("--small", action="store_true", default=small, help="write a small part (RECIPE_SMALL=yes)")
    arguments = parser.parse_args()
    RECIPES[arguments.recipe](arguments.small)


if __name__ == "__main__":
    main()

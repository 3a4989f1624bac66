"""Surfaces of many materials with known properties, and their files."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pyvista as pv
from test_solve import block

from tetmesh_check.quality import OUTWARD_FACES


@dataclass(frozen=True)
class Made:
    """A complex; ``names`` are those of all materials except the outside."""

    points: np.ndarray
    triangles: np.ndarray
    inside: np.ndarray
    outside: np.ndarray
    names: tuple[str, ...]

    def save(self, path: Path, **arrays: np.ndarray) -> Path:
        """Write the complex as ``reconstruct`` does; ``arrays`` replace arrays of the triangles."""
        faces = np.hstack([np.full((len(self.triangles), 1), 3), self.triangles]).ravel()
        surface = pv.PolyData(self.points, faces)
        given = {"material_inside": self.inside, "material_outside": self.outside, **arrays}
        for name, values in given.items():
            surface.cell_data[name] = values.astype(np.int32)
        table = [{"name": "outside", "labels": []}]
        table += [{"name": name, "labels": [{"layer": 0, "label": k}]} for k, name in enumerate(self.names, 1)]
        meta = json.dumps({"version": 1, "failed_checks": [], "components": len(self.names), "materials": table})
        surface.field_data.set_array(np.frombuffer(meta.encode(), dtype=np.uint8).copy(), "meta")
        surface.save(path)
        return path


def sphere(radius: float, subdivisions: int) -> tuple[np.ndarray, np.ndarray]:
    """Icosphere whose vertices lie on the sphere in double precision."""
    surface = pv.Icosphere(radius=radius, nsub=subdivisions)
    points = np.asarray(surface.points, dtype=np.float64)
    points *= radius / np.linalg.norm(points, axis=1, keepdims=True)
    return points, np.asarray(surface.faces).reshape(-1, 4)[:, 1:].astype(np.int64)


def nested_balls(radii: tuple[float, ...], subdivisions: tuple[int, ...], names: tuple[str, ...]) -> Made:
    """Return concentric balls, the largest first; the innermost is the last material."""
    points, triangles, inside = [], [], []
    shift = 0
    for number, (radius, times) in enumerate(zip(radii, subdivisions, strict=True), 1):
        own, cells = sphere(radius, times)
        points.append(own)
        triangles.append(cells + shift)
        inside.append(np.full(len(cells), number))
        shift += len(own)
    numbers = np.concatenate(inside)
    return Made(np.concatenate(points), np.concatenate(triangles), numbers, numbers - 1, names)


def between(points: np.ndarray, tetrahedra: np.ndarray, regions: np.ndarray, names: tuple[str, ...]) -> Made:
    """Return the faces between tetrahedra of different regions; region 0 is the outside."""
    kept = tetrahedra[regions > 0]
    regions = regions[regions > 0]
    faces = np.concatenate([kept[:, face] for face in OUTWARD_FACES])
    owner = np.tile(np.arange(len(kept)), 4)
    number = np.unique(np.sort(faces, axis=1), axis=0, return_inverse=True)[1].ravel()
    high, low = np.zeros(number.max() + 1, dtype=np.int64), np.full(number.max() + 1, 1 << 30)
    np.maximum.at(high, number, regions[owner])
    np.minimum.at(low, number, regions[owner])
    low[np.bincount(number) == 1] = 0
    shown = (regions[owner] == high[number]) & (high[number] != low[number])
    used, local = np.unique(faces[shown], return_inverse=True)
    return Made(points[used], local.reshape(-1, 3), high[number][shown], low[number][shown], names)


def cells_of_a_block(counts: tuple[int, int, int], material: object, names: tuple[str, ...], size: float = 1.0) -> Made:
    """Return a block of cubes; ``material`` maps cube centres, in units of cubes, to materials."""
    points, tetrahedra = block(counts, size)
    # the centre of a tetrahedron determines its cube
    at = np.floor(points[tetrahedra].mean(axis=1) / size) + 0.5
    return between(points, tetrahedra, np.asarray(material(*at.T)).astype(np.int64), names)  # type: ignore[operator]


def sectors_of_a_ball(radius: float, times: int) -> Made:
    """Return three sectors of a ball, of 120 degrees each around the z axis.

    One junction curve is inside the ball, and three are on its surface. They meet at two junction
    points.
    """
    angles = np.radians(60.0 * np.arange(6))
    rim = np.stack([np.cos(angles), np.sin(angles), np.zeros(6)], 1)
    points = np.vstack([[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [0.0, 0.0, 0.0], rim])
    north, south, middle = 0, 1, 2
    cells, inside, outside = [], [], []
    for k in range(6):
        here, after = 3 + k, 3 + (k + 1) % 6
        cells += [(north, here, after), (south, after, here)]
        inside += 2 * [1 + k // 2]
        outside += 2 * [0]
    for k in range(3):
        # the wall between sector k and the previous sector; its triangles are counter-clockwise as
        # seen from the previous sector
        pair = (1 + k, 1 + (k - 1) % 3)
        for wall in ((middle, 3 + 2 * k, north), (middle, south, 3 + 2 * k)):
            turned = wall if pair[0] > pair[1] else wall[::-1]
            cells.append(turned)
            inside.append(max(pair))
            outside.append(min(pair))
    triangles = np.array(cells)
    for _ in range(times):
        points, triangles = split(points, triangles)
    # map the hexagonal bipyramid to the ball, along rays from the centre
    length = np.linalg.norm(points, axis=1)
    turn = np.arctan2(points[:, 1], points[:, 0]) % (np.pi / 3) - np.pi / 6
    gauge = np.hypot(points[:, 0], points[:, 1]) * np.cos(turn) / np.cos(np.pi / 6) + np.abs(points[:, 2])
    points = radius * points * np.divide(gauge, length, out=np.zeros(len(points)), where=length > 0)[:, None]
    return Made(points, triangles, np.tile(inside, 4**times), np.tile(outside, 4**times), ("one", "two", "three"))


def split(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Split every triangle into four."""
    edges = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    unique, which = np.unique(edges, axis=0, return_inverse=True)
    ab, bc, ca = len(points) + which.reshape(3, -1)
    a, b, c = triangles.T
    parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
    return np.concatenate([points, points[unique].mean(axis=1)]), np.concatenate([np.stack(p, 1) for p in parts])

"""Slices of a volume as pictures, with the outline of a surface.

Positions on a slice are in mm from its left upper corner. In LPS, slices are shown in radiological
convention: the right of the patient is on the left of the picture.
"""

from __future__ import annotations

import base64
import io
from collections import OrderedDict
from collections.abc import Sequence
from typing import Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray
from PIL import Image

from tetmesh_check.report.colours import Entry
from tetmesh_check.report.page.scan import Scan, world_letters
from tetmesh_check.report.page.slices import path_of, shades_of

PLANES = ("axial", "coronal", "sagittal")
ACROSS = {"axial": 2, "coronal": 1, "sagittal": 0}
"""The world axis across each plane."""
OUTLINE_UNITS = 1000.0
"""Units of an outline along the longest side of a slice. Positions are rounded to 0.1 units."""
PAINTED = np.array([255, 0, 140], dtype=np.float64)
"""Colour of painted voxels, which differs from the colours of labels."""
PAINT_SHARE = 0.55
"""Share of this colour in painted voxels. The volume below remains visible."""
KEPT_OUTLINES = 200
"""Maximum number of cached outlines, for slices that are shown again."""


class Plane:
    """Slices of an upright volume across one axis of the world."""

    def __init__(self, scan: Scan, name: str) -> None:
        self.scan = scan
        self.name = name
        self.axis = ACROSS[name]
        self.right, self.down = (axis for axis in range(3) if axis != self.axis)
        # in LPS, y points to the back, which is at the bottom of an axial slice
        self.is_down = self.axis == 2 and scan.anatomical
        self.count = scan.values.shape[self.axis]
        grid = np.array(scan.values.shape)[[self.right, self.down]]
        self.extent: NDArray[Any] = grid * scan.spacing[[self.right, self.down]]

    @property
    def letters(self) -> list[str]:
        """The directions to the left, right, top and bottom of the picture."""
        names = world_letters(self.scan.anatomical)
        across, along = names[self.right], names[self.down]
        vertical = [along[1], along[0]] if self.is_down else [along[0], along[1]]
        return [across[1], across[0], *vertical]

    @property
    def title(self) -> str:
        """The name of the plane."""
        return self.name.capitalize() if self.scan.anatomical else f"Across {'xyz'[self.axis]}"

    def to_plane(self, index: NDArray[Any]) -> NDArray[Any]:
        """Convert fractional indices of voxels, shape (n, 3), to positions on the slice, (n, 2)."""
        found: NDArray[Any] = (index[:, [self.right, self.down]] + 0.5) * self.scan.spacing[[self.right, self.down]]
        if not self.is_down:
            found[:, 1] = self.extent[1] - found[:, 1]
        return found

    def to_world(self, position: Sequence[float], layer: int) -> NDArray[Any]:
        """Convert a position on a slice to the world."""
        x, y = position
        index = np.zeros(3)
        index[self.axis] = layer
        index[self.right] = x / self.scan.spacing[self.right] - 0.5
        index[self.down] = (y if self.is_down else self.extent[1] - y) / self.scan.spacing[self.down] - 0.5
        return np.asarray(self.scan.origin + self.scan.step @ index)

    def layer_of(self, world: Sequence[float]) -> int:
        """Return the slice nearest to a position in the world."""
        index = self.scan.to_index(np.array([world]))[0, self.axis]
        return int(np.clip(round(float(index)), 0, self.count - 1))

    def cut(self, values: NDArray[Any], layer: int) -> NDArray[Any]:
        """Return the values on a slice; the first axis points to the right, the second down."""
        # np.take would copy volumes whose axes are not in the order of C
        found: NDArray[Any] = np.moveaxis(values, self.axis, 0)[layer]
        return found if self.is_down else found[:, ::-1]


class Slices:
    """The three planes of a volume, with a surface."""

    def __init__(self, scan: Scan, key: list[Entry]) -> None:
        self.scan = scan
        self.planes = {name: Plane(scan, name) for name in PLANES}
        self._shades = shades_of(scan, key)
        self._index: NDArray[Any] | None = None
        self._triangles: NDArray[Any] | None = None
        self._outlines: OrderedDict[tuple[str, int], str] = OrderedDict()
        levels = self._shades.values
        self.range = (float(levels[0]), float(levels[-1]))
        """The values that are black and white at the start."""

    def show_surface(self, surface: pv.PolyData | None) -> None:
        """Set the surface whose outline is drawn."""
        self._outlines.clear()
        self._index = None if surface is None else self.scan.to_index(np.asarray(surface.points, dtype=float))
        self._triangles = None if surface is None else surface.regular_faces

    def picture(self, name: str, layer: int, window: float, level: float, paint: NDArray[Any] | None) -> str:
        """Return a slice as the address of a picture, one pixel per voxel.

        Parameters
        ----------
        name, layer
            The plane and the number of the slice.
        window, level
            Width and centre of the values between black and white; not for labels.
        paint
            Painted voxels, as flags.
        """
        plane = self.planes[name]
        cut = plane.cut(self.scan.values, layer)
        if self.scan.labels:
            picture = self._shades.image(cut)
        else:
            grey = (np.nan_to_num(cut.astype(np.float32)) - (level - 0.5 * window)) / max(window, 1e-30)
            picture = Image.fromarray(np.round(255.0 * np.clip(grey, 0.0, 1.0)).astype(np.uint8).T)
        if paint is not None:
            flags = plane.cut(paint, layer).T.astype(bool)
            colours = np.array(picture.convert("RGB"), dtype=np.float64)
            colours[flags] += PAINT_SHARE * (PAINTED - colours[flags])
            picture = Image.fromarray(colours.astype(np.uint8))
        return _address(picture)

    def outline(self, name: str, layer: int) -> str:
        """Return the outline of the surface on a slice as an SVG path; see ``outline_scale``."""
        if self._index is None or self._triangles is None:
            return ""
        if (name, layer) not in self._outlines:
            plane = self.planes[name]
            flat = plane.to_plane(self._index) * (OUTLINE_UNITS / plane.extent.max())
            crossed = self._crossed(self._index[:, plane.axis], layer)
            surface = pv.PolyData.from_regular_faces(np.column_stack([flat, self._index[:, plane.axis]]), crossed)
            self._outlines[name, layer] = path_of(_polygons(surface, layer)) if len(crossed) else ""
            if len(self._outlines) > KEPT_OUTLINES:
                self._outlines.popitem(last=False)
        return self._outlines[name, layer]

    def _crossed(self, heights: NDArray[Any], layer: int) -> NDArray[Any]:
        """Return the triangles that the plane of a slice cuts."""
        assert self._triangles is not None
        # like VTK, count vertices on the plane as above
        is_above = heights[self._triangles] >= layer
        found: NDArray[Any] = self._triangles[is_above.any(axis=1) & ~is_above.all(axis=1)]
        return found

    def outline_scale(self, name: str) -> float:
        """Return the factor from the units of an outline to mm."""
        return float(self.planes[name].extent.max()) / OUTLINE_UNITS / 10.0


def _address(picture: Image.Image) -> str:
    """Return a picture as a data address with a PNG, at the fastest compression."""
    stream = io.BytesIO()
    picture.save(stream, "PNG", compress_level=1)
    return f"data:image/png;base64,{base64.b64encode(stream.getvalue()).decode('ascii')}"


def _polygons(surface: pv.PolyData, layer: int) -> list[NDArray[Any]]:
    """Return the polygons in which a plane perpendicular to z cuts a surface."""
    lines = surface.contour([layer], scalars=surface.points[:, 2])
    if lines.n_cells == 0:
        return []
    polygons = lines.strip(join=True, max_length=surface.n_cells)
    cells, found = np.asarray(polygons.lines), []
    points, start = np.asarray(polygons.points)[:, :2], 0
    while start < len(cells):
        count = int(cells[start])
        found.append(points[cells[start + 1 : start + 1 + count]])
        start += 1 + count
    return found

"""Paints a region. Each dab fills a ball, so a region also extends across the slice."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from tetmesh_check.report.page.scan import Scan

if TYPE_CHECKING:
    from isoparticles.viewer.session import Session


class Paint:
    """Painted voxels on the grid of a volume."""

    def __init__(self, scan: Scan) -> None:
        self.scan = scan
        self._flags: NDArray[np.uint8] | None = None

    @property
    def flags(self) -> NDArray[np.uint8]:
        """1 at painted voxels; made on first use, because most sessions do not paint."""
        if self._flags is None:
            self._flags = np.zeros(self.scan.values.shape, dtype=np.uint8)
        return self._flags

    @property
    def count(self) -> int:
        """The number of painted voxels."""
        return 0 if self._flags is None else int(np.count_nonzero(self._flags))

    def clear(self) -> None:
        """Remove the paint."""
        self._flags = None

    def dab(self, position: NDArray[Any], radius: float) -> None:
        """Paint the voxels within a radius of a position, and at least the nearest."""
        scan, flags = self.scan, self.flags
        centre = scan.to_index(np.asarray(position, dtype=float)[None])[0]
        reach = radius / scan.spacing
        last = np.array(flags.shape) - 1
        low = np.clip(np.floor(centre - reach), 0, last).astype(int)
        high = np.clip(np.ceil(centre + reach), 0, last).astype(int)
        grid = np.stack(np.meshgrid(*(np.arange(a, b + 1) for a, b in zip(low, high, strict=True)), indexing="ij"), -1)
        is_near = np.linalg.norm((grid - centre) @ scan.step.T, axis=-1) <= radius
        flags[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))] |= is_near.astype(np.uint8)
        flags[tuple(np.clip(np.rint(centre), 0, last).astype(int))] = 1

    def centre(self) -> NDArray[Any]:
        """Return the world position of the painted voxel nearest to their mean."""
        index = np.argwhere(self.flags)
        middle = index[np.linalg.norm(index - index.mean(axis=0), axis=1).argmin()]
        return np.asarray(self.scan.origin + self.scan.step @ middle)

    def write(self, session: Session) -> str:
        """Write the painted part as a volume.

        Returns
        -------
        str
            Its name in the folder of the case; its path for a mesh in memory.
        """
        index = np.argwhere(self.flags)
        low = np.maximum(index.min(axis=0) - 1, 0)
        high = np.minimum(index.max(axis=0) + 1, np.array(self.flags.shape) - 1)
        part = self.flags[tuple(slice(a, b + 1) for a, b in zip(low, high, strict=True))]
        image = pv.ImageData(dimensions=part.shape, spacing=tuple(self.scan.spacing))
        image.origin = tuple(self.scan.origin + self.scan.step @ low)
        image.direction_matrix = self.scan.step / self.scan.spacing
        image.point_data["region"] = part.flatten(order="F")
        folder = Path(tempfile.mkdtemp(prefix="isoparticles-")) if session.folder is None else session.folder
        number = 1
        while (folder / f"{session.mesh.name}.region-{number}.vti").exists():
            number += 1
        path = folder / f"{session.mesh.name}.region-{number}.vti"
        image.save(path)
        return str(path) if session.folder is None else path.name

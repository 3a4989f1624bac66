"""The results of the stages."""

from __future__ import annotations

import json
from functools import cached_property
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from isoparticles import _native

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    import pyvista

ARRAYS = {
    "distfield": ("signed_distance",),
    "materials": ("material", "interface_distance"),
    "sizefield": ("sizing",),
    "seeds": ("positions", "normals", "sizes", "energies"),
    "particles": ("positions", "normals", "sizes", "energies"),
}
"""Arrays of each kind of result."""


class Result:
    """The result of a stage. Its arrays are read-only."""

    KINDS: ClassVar[tuple[str, ...]] = ()
    report: dict[str, Any] | None
    """The report that the program writes with ``--report``; None for results of ``load`` and
    ``Surface.of``."""
    failed_checks: list[str]
    """The checks that failed, in words. Distance fields do not store them in their files."""

    def __init__(self, data: _native.Data, failed_checks: list[str] | None = None, report: str | None = None) -> None:
        if not isinstance(data, _native.Data) or data.kind not in self.KINDS:
            raise TypeError(f"{type(self).__name__}: made by the functions of isoparticles, not by its class")
        self._data = data
        if failed_checks is None and data.kind == "surface":
            # surfaces of other programs have no metadata
            failed_checks = (self.meta or {}).get("failed_checks")
        self.failed_checks = failed_checks or []
        self.report = None if report is None else json.loads(report)

    @property
    def name(self) -> str:
        """The file name in the histories of later results."""
        return self._data.name

    @property
    def kind(self) -> str:
        """The kind of the file."""
        return self._data.kind

    @property
    def meta(self) -> Any:
        """The metadata in the file."""
        return json.loads(self._data.meta)

    @property
    def history(self) -> Any:
        """The history in the file, which says how the result and its inputs were made."""
        return json.loads(self._data.history)

    @property
    def space(self) -> str | None:
        """The world frame of the positions: ``lps``, ``ras``, or None if it is not anatomical."""
        return self._data.space

    @cached_property
    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """All arrays by name."""
        return MappingProxyType({name: self._array(name) for name in ARRAYS[self.kind]})

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the file that the program of the stage writes.

        Raises
        ------
        FileExistsError
            If the file exists and ``overwrite`` is false.
        """
        refuse_existing([Path(path)], overwrite)
        self._data.write(path)

    def to_pyvista(self) -> pyvista.DataSet:
        """Copy the result to a data set of PyVista."""
        raise NotImplementedError

    def _array(self, name: str) -> NDArray[Any]:
        dtype, shape, values = self._data.array(name)
        # NumPy does not write to the memory of bytes
        array: NDArray[Any] = np.frombuffer(values, dtype=dtype)
        is_grid = self.kind in ("distfield", "materials", "sizefield")
        return array.reshape(tuple(shape), order="F" if is_grid else "C")

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r}: {self._told()}{self._verdict()}>"

    def _told(self) -> str:
        return self.kind

    def _verdict(self) -> str:
        return f"; failed checks: {'; '.join(self.failed_checks)}" if self.failed_checks else ""


class _Field(Result):
    """Values on a grid."""

    @property
    def shape(self) -> tuple[int, int, int]:
        """The number of voxels along x, y and z."""
        x, y, z = self._grid[0]
        return x, y, z

    @property
    def spacing(self) -> NDArray[np.float64]:
        """The distance between voxel centres along each axis, shape (3,), mm."""
        return _frozen(self._grid[1])

    @property
    def origin(self) -> NDArray[np.float64]:
        """The world position of the centre of the first voxel, shape (3,), mm."""
        return _frozen(self._grid[2])

    @property
    def direction(self) -> NDArray[np.float64]:
        """The unit vectors of the axes in the world frame, one per column, shape (3, 3)."""
        return _frozen(np.transpose(self._grid[3]))

    @property
    def array(self) -> NDArray[Any]:
        """The values, shape (nx, ny, nz). The first axis is x."""
        return self.arrays[ARRAYS[self.kind][0]]

    @property
    def _grid(self) -> tuple[list[int], list[float], list[float], list[list[float]]]:
        grid = self._data.grid
        assert grid is not None
        return grid

    def to_pyvista(self) -> pyvista.ImageData:
        """Copy the field to an image with point data."""
        import pyvista

        image = pyvista.ImageData(dimensions=self.shape, spacing=tuple(self.spacing), origin=tuple(self.origin))
        image.direction_matrix = self.direction
        for name, values in self.arrays.items():
            image.point_data[name] = values.flatten(order="F")
        return image

    def _told(self) -> str:
        size = " x ".join(str(n) for n in self.shape)
        return f"{size} voxels of {' x '.join(f'{length:.4g}' for length in self.spacing)} mm"


class DistanceField(_Field):
    """The signed distance of one object in mm, negative inside, or the indicators of materials.

    For several materials, and for one object that ends at planes (``border="flat"``, ``cut``),
    ``array`` contains the number of the material at each voxel, and
    ``arrays["interface_distance"]`` the distance from the nearest interface in mm.
    """

    KINDS = ("distfield", "materials")

    @property
    def materials(self) -> list[str]:
        """The names of the materials by number, starting with the outside; empty for one object.

        The names of planes follow if there are any; one object is then the material ``object``.
        """
        return self._data.materials

    def _told(self) -> str:
        return super()._told() + (f", materials {', '.join(self.materials)}" if self.materials else "")


class SizeField(_Field):
    """The target edge length h in mm."""

    KINDS = ("sizefield",)


class Particles(Result):
    """Seeds or settled particles."""

    KINDS = ("seeds", "particles")

    @property
    def positions(self) -> NDArray[np.float64]:
        """The world positions, shape (n, 3), mm."""
        return self.arrays["positions"]

    @property
    def normals(self) -> NDArray[np.float64]:
        """The outward unit normals in the world frame, shape (n, 3); undefined on junctions."""
        return self.arrays["normals"]

    @property
    def sizes(self) -> NDArray[np.float64]:
        """The target edge length h at each particle, shape (n,), mm."""
        return self.arrays["sizes"]

    def __len__(self) -> int:
        return len(self.positions)

    def to_pyvista(self) -> pyvista.PolyData:
        """Copy the particles to points with the arrays ``normals``, ``sizes`` and ``energies``."""
        import pyvista

        points = pyvista.PolyData(self.positions.copy())
        for name, values in self.arrays.items():
            if name != "positions":
                points.point_data[name] = values.copy()
        return points

    def _told(self) -> str:
        return f"{len(self)} {self.kind}"


class Surface(Result):
    """Triangles in world coordinates, counter-clockwise as seen from outside."""

    KINDS = ("surface",)

    @cached_property
    def vertices(self) -> NDArray[np.float64]:
        """The world positions of the vertices, shape (n, 3), mm."""
        return self._array("vertices")

    @cached_property
    def triangles(self) -> NDArray[np.int64]:
        """The vertex numbers of the triangles, shape (m, 3)."""
        return self._array("triangles")

    @cached_property
    def arrays(self) -> Mapping[str, NDArray[Any]]:
        """All arrays on vertices (n values) and triangles (m values) by name."""
        return MappingProxyType({**self.point_arrays, **self.cell_arrays})

    @cached_property
    def point_arrays(self) -> Mapping[str, NDArray[Any]]:
        """The arrays on vertices by name."""
        return MappingProxyType({name: self._array(f"point:{name}") for name in self._data.array_names[0]})

    @cached_property
    def cell_arrays(self) -> Mapping[str, NDArray[Any]]:
        """The arrays on triangles by name."""
        return MappingProxyType({name: self._array(f"cell:{name}") for name in self._data.array_names[1]})

    @property
    def materials(self) -> list[str]:
        """The names of the materials, starting with the outside; empty for one object.

        An object that ends at planes is the material ``object``. ``cell_arrays["cap"]`` contains
        the number of the plane of each triangle, from 1 (0 elsewhere), and ``meta["caps"]`` the
        names of the planes.
        """
        return self._data.materials

    def save(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write the file that ``reconstruct`` writes.

        If a check failed, also write the simplices that caused the failure, with the extension
        ``.offending.vtp``. Otherwise, remove such a file of an earlier result.

        Raises
        ------
        FileExistsError
            If a file exists and ``overwrite`` is false.
        """
        offending = Path(path).with_suffix(".offending.vtp")
        refuse_existing([Path(path), offending], overwrite)
        super().save(path, overwrite=True)
        if not self.failed_checks:
            offending.unlink(missing_ok=True)

    def of(self, material: str) -> Surface:
        """Return the closed surface of one material. Normals point outward.

        Raises
        ------
        KeyError
            If there is no such material.
        """
        return Surface(self._data.of_material(material))

    def to_pyvista(self) -> pyvista.PolyData:
        """Copy the triangles and all arrays."""
        import pyvista

        corners: Any = self.triangles.copy()
        surface: pyvista.PolyData = pyvista.PolyData.from_regular_faces(self.vertices.copy(), corners)
        for name, values in self.point_arrays.items():
            surface.point_data[name] = values.copy()
        for name, values in self.cell_arrays.items():
            surface.cell_data[name] = values.copy()
        return surface

    def _told(self) -> str:
        return f"{len(self.vertices)} vertices, {len(self.triangles)} triangles"


ENDINGS = {
    "distfield": "distfield.vti",
    "sizefield": "sizefield.vti",
    "seed": "seeds.bin",
    "particles": "particles.bin",
    "reconstruct": "surface.vtp",
}
"""Names of the files of a case, without the name of the case."""


def refuse_existing(paths: Iterable[Path], overwrite: bool) -> None:
    """Raise a FileExistsError if a file exists, unless ``overwrite`` is true."""
    there = [str(path) for path in paths if path.exists()]
    if there and not overwrite:
        raise FileExistsError(f"{', '.join(there)}: exists; pass overwrite=True to replace it")


def expect(wanted: type[Result], **given: object) -> None:
    """Raise a TypeError unless all keyword arguments are results of the wanted class."""
    for name, value in given.items():
        if not isinstance(value, wanted):
            raise TypeError(f"{name} must be a {wanted.__name__}, not {type(value).__name__}")


def _frozen(values: Any) -> NDArray[np.float64]:
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array

"""The process of HXT: ``python -m tetmesh_check.tets.hxt_worker JOB RESULT``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from tetmesh_check.tets.worker import serve

_ALGORITHMS = {"hxt": 10, "delaunay": 1}
"""Numbers of Gmsh's option ``Mesh.Algorithm3D``."""
_TRIANGLE, _TETRAHEDRON = 2, 4
"""Gmsh's numbers of the kinds of cells."""


def write_structured_field(path: Path, values: Any, origin: Any, spacing: float) -> None:
    """Write edge lengths on a regular grid in the binary form of Gmsh's field ``Structured``.

    Parameters
    ----------
    path
        The file.
    values
        Edge lengths, mm, shape ``(nx, ny, nz)``.
    origin
        Position of the first node, mm.
    spacing
        From a node to the next, mm.
    """
    with path.open("wb") as stream:
        for numbers, kind in ((origin, np.float64), ([spacing] * 3, np.float64), (values.shape, np.int32)):
            stream.write(np.asarray(numbers, dtype=kind).tobytes())
        stream.write(np.ascontiguousarray(values, dtype=np.float64).tobytes())


def _set_options(gmsh: Any, settings: dict[str, Any], extends: bool) -> None:
    for name, value in {
        "General.Terminal": 1,
        # One thread gives the same bytes however many the machine has. With more, the result
        # depends on their number even with Mesh.Reproducible, and Gmsh failed to read the
        # background field on a surface of several bodies.
        "General.NumThreads": 1,
        "Mesh.Algorithm3D": _ALGORITHMS[settings["algorithm"]],
        "Mesh.OptimizeThreshold": settings["optimize_threshold"],
        # The background field alone says how large the tetrahedra of one object are. Where sheets
        # of many materials meet, triangles may be far smaller than it: what stands on them is to be
        # as small, and to grow from there. The chest of thorax_labels at 3 mm has 284 scaled
        # Jacobians below 0.05 in place of 748 by that, and 0.1 % more vertices.
        "Mesh.MeshSizeExtendFromBoundary": int(extends),
        "Mesh.MeshSizeFromPoints": 0,
        "Mesh.MeshSizeFromCurvature": 0,
        # a node keeps its number, so that the surface's come first and in their order
        "Mesh.Renumber": 0,
    }.items():
        gmsh.option.setNumber(name, value)


def _add_volumes(gmsh: Any, arrays: dict[str, Any]) -> list[int]:
    """Add a discrete surface for each component; return the tags of the bodies."""
    points, triangles, labels = arrays["points"], arrays["triangles"], arrays["labels"]
    order = np.argsort(labels, kind="stable")
    loops = []
    for part in np.split(order, np.cumsum(np.bincount(labels))[:-1]):
        surface = gmsh.model.addDiscreteEntity(2)
        used = np.unique(triangles[part])
        gmsh.model.mesh.addNodes(2, surface, used + 1, points[used].ravel())
        gmsh.model.mesh.addElementsByType(surface, _TRIANGLE, [], (triangles[part] + 1).ravel())
        loops.append(gmsh.model.geo.addSurfaceLoop([surface]))
    body = arrays["bodies"]
    # the loop around the body first, then those of its cavities
    volumes = [
        gmsh.model.geo.addVolume([loops[outer], *(loops[k] for k in np.flatnonzero(body == outer) if k != outer)])
        for outer in np.unique(body)
    ]
    gmsh.model.geo.synchronize()
    return volumes


def _add_regions(gmsh: Any, arrays: dict[str, Any]) -> list[int]:
    """Add a discrete surface for each interface sheet; return the tags of the volumes.

    Sheets share the vertices on their rims: each is handed over once, by the first sheet that has
    it. Gmsh identifies a volume by its sheets, and no two volumes have the same sheets.
    """
    points, triangles, sheet, bounds = arrays["points"], arrays["triangles"], arrays["sheet"], arrays["bounds"]
    order = np.argsort(sheet, kind="stable")
    parts = np.split(order, np.cumsum(np.bincount(sheet))[:-1])
    surfaces = [gmsh.model.addDiscreteEntity(2) for _ in parts]
    new = np.ones(len(points), dtype=bool)
    for surface, part in zip(surfaces, parts, strict=True):
        used = np.unique(triangles[part])
        used = used[new[used]]
        new[used] = False
        if len(used):
            gmsh.model.mesh.addNodes(2, surface, used + 1, points[used].ravel())
    for surface, part in zip(surfaces, parts, strict=True):
        gmsh.model.mesh.addElementsByType(surface, _TRIANGLE, [], (triangles[part] + 1).ravel())
    volumes = []
    for volume in range(int(bounds.max()) + 1):
        around = np.flatnonzero((bounds == volume).any(axis=1))
        loop = gmsh.model.geo.addSurfaceLoop([surfaces[k] for k in around])
        volumes.append(gmsh.model.geo.addVolume([loop]))
    gmsh.model.geo.synchronize()
    return volumes


def fill(gmsh: Any, arrays: dict[str, Any], settings: dict[str, Any]) -> tuple[Any, Any]:
    """Fill the surface.

    Parameters
    ----------
    gmsh
        The library.
    arrays
        ``points, triangles``; ``labels`` (component of each triangle); ``bodies`` (for each
        component the number of the one round its body), or for a complex ``sheet`` (that of each
        triangle) and ``bounds`` (the two volumes of each sheet, below 0 for none); ``sizing,
        sizing_origin, sizing_spacing`` (edge lengths on a grid).
    settings
        The values of :class:`.HxtSettings`.

    Returns
    -------
    tuple
        Points, mm, those of the surface first, and tetrahedra.
    """
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    is_complex = "sheet" in arrays
    _set_options(gmsh, settings, is_complex)
    volumes = (_add_regions if is_complex else _add_volumes)(gmsh, arrays)

    file = Path("sizing.bin").absolute()
    write_structured_field(file, arrays["sizing"], arrays["sizing_origin"], float(arrays["sizing_spacing"]))
    fields = gmsh.model.mesh.field
    background = fields.add("Structured")
    fields.setString(background, "FileName", str(file))
    fields.setNumber(background, "TextFormat", 0)
    fields.setAsBackgroundMesh(background)

    gmsh.model.mesh.generate(3)

    empty = sum(len(gmsh.model.mesh.getElementsByType(_TETRAHEDRON, tag)[0]) == 0 for tag in volumes)
    if empty:
        raise SystemExit(f"{empty} of {len(volumes)} bodies were not filled")
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    _, corners = gmsh.model.mesh.getElementsByType(_TETRAHEDRON)
    used, tetrahedra = np.unique(corners, return_inverse=True)
    place = np.empty(int(tags.max()) + 1, dtype=np.int64)
    place[tags] = np.arange(len(tags))
    return coordinates.reshape(-1, 3)[place[used]], tetrahedra.reshape(-1, 4)


if __name__ == "__main__":
    serve("gmsh", fill)

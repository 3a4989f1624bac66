"""HXT, the parallel Delaunay tetrahedralizer of Gmsh.

Marot, Pellerin and Remacle, "One machine, one minute, three billion tetrahedra" (2019), and the
optimization of Marot and Remacle, "Quality tetrahedral mesh generation with HXT" (2020). Gmsh is
GPL-2.0-or-later and an optional package. Only the child process imports it: ``python -m
tetmesh_check.tets.hxt FOLDER``.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tetmesh_check.quality import Cells, Labels
from tetmesh_check.tets.worker import Job, Raw, Runner, Worker, scale_of, serve
from tetmesh_check.topology import members_of

if TYPE_CHECKING:
    from isoparticles._native import GridField

    from tetmesh_check.surface import Surface

OPTIMIZE_THRESHOLD = 0.4
"""HXT improves the tetrahedra whose quality (1 is regular) is below this. A heart of 54,859
vertices: 0.35 takes 1.5 s and gives a minimum dihedral angle of 15.4 degrees; 0.4 takes 2.2 s and
gives 17.0 degrees; 0.45 takes 7 s and 0.5 takes 43 s without a larger angle (measured without
:data:`LENGTH_FACTOR`)."""

LENGTH_FACTOR = 0.66
"""Factor of the edge lengths for HXT, which drops new vertices closer than this length to another.
Without the factor, edges are 1.36 to 1.41 times as long as the target; with it, 1.00 to 1.02 times
(medians of four surfaces)."""

MAX_GRID_NODES = 4_000_000
"""Maximum number of nodes of the grid of edge lengths along the world axes: 32 MB."""

_ALGORITHMS = {"hxt": 10, "delaunay": 1}
"""Numbers of Gmsh's option ``Mesh.Algorithm3D``."""
_TRIANGLE, _TETRAHEDRON = 2, 4
"""Gmsh's numbers of the kinds of cells."""

WORKER = Worker(
    name="HXT",
    module="tetmesh_check.tets.hxt",
    library="gmsh",
    when_it_fails="try --method ftetwild, a larger --tet-size-factor, or a machine with more memory",
    when_it_is_missing="install it with stages/tetmesh-check/setup-env.sh (make env), which also says which system "
    "libraries it lacks, or use --method ftetwild",
    shown={
        "vertices": r"mesh\.nvert: (\d+)",
        "tetrahedra to improve": r"Improving +(\d+) tet",
    },
)
_OF_MATERIALS = replace(WORKER, when_it_fails="try a larger or smaller --tet-size-factor, or mesh fewer materials")
"""The same for many materials."""
_WORKERS = {"hxt": _OF_MATERIALS, "delaunay": replace(_OF_MATERIALS, name="Gmsh's Delaunay")}


def hxt_job(surface: Surface, sheets: tuple[Cells, Labels], field: GridField, size_factor: float) -> Job:
    """Describe the volumes of a surface and the edge lengths in them for Gmsh.

    Parameters
    ----------
    surface
        A checked surface.
    sheets
        The two volumes of each sheet, below 0 for none, shape ``(s, 2)``, and the sheet of each
        triangle.
    field
        Edge lengths in the bounding box of the surface, mm.
    size_factor
        Factor of the edge lengths.
    """
    scale = scale_of(surface.points)
    lengths, origin, spacing = field.world_grid(surface.points, MAX_GRID_NODES)
    return {
        "scale": scale,
        "points": scale * surface.points,
        "triangles": surface.triangles,
        "bounds": sheets[0],
        "sheet": sheets[1],
        "lengths": scale * (LENGTH_FACTOR * (size_factor * lengths)),
        "origin": scale * np.array(origin),
        "spacing": scale * spacing,
        "algorithm": "hxt",
        "extends": surface.sides is not None,
    }


def fill_by_hxt(job: Job, runner: Runner) -> Raw:
    """Fill all volumes of a surface with tetrahedra that keep and share its triangles.

    Parameters
    ----------
    job
        See :func:`hxt_job`. For many materials, ``algorithm`` may be ``delaunay``, the older
        algorithm of Gmsh. It is slower, but fills some surfaces that HXT cannot fill.
    runner
        Runs Gmsh, and raises the errors.
    """
    worker, nodes = _WORKERS[job["algorithm"]] if job["extends"] else WORKER, job["lengths"].size
    return runner.run(
        worker, job, optimize_threshold=OPTIMIZE_THRESHOLD, length_factor=LENGTH_FACTOR, sizing_nodes=nodes
    )


def _set_options(gmsh: Any, job: Job) -> None:
    for name, value in {
        "General.Terminal": 1,
        # One thread gives the same bytes however many the machine has. With more, the result
        # depends on their number even with Mesh.Reproducible, and Gmsh failed to read the
        # background field on a surface of several bodies.
        "General.NumThreads": 1,
        "Mesh.Algorithm3D": _ALGORITHMS[job["algorithm"]],
        "Mesh.OptimizeThreshold": OPTIMIZE_THRESHOLD,
        # For one object, only the background field determines the size of the tetrahedra. Where
        # interfaces of many materials meet, triangles may be much smaller. Tetrahedra on them must
        # be as small, and grow from there. With this, the scaled Jacobians below 0.05 in
        # thorax_labels at 3 mm decrease from 748 to 284, with 0.1 % more vertices.
        "Mesh.MeshSizeExtendFromBoundary": int(job["extends"]),
        "Mesh.MeshSizeFromPoints": 0,
        "Mesh.MeshSizeFromCurvature": 0,
        # nodes keep their numbers, so those of the surface come first and in order
        "Mesh.Renumber": 0,
    }.items():
        gmsh.option.setNumber(name, value)


def _set_edge_lengths(gmsh: Any, lengths: Any, origin: Any, spacing: float) -> None:
    """Write edge lengths on a grid for Gmsh's field ``Structured``, in its binary form."""
    file = Path("sizing.bin").absolute()
    with file.open("wb") as stream:
        np.array([*origin, spacing, spacing, spacing]).tofile(stream)
        np.array(lengths.shape, dtype=np.int32).tofile(stream)
        lengths.tofile(stream)
    fields = gmsh.model.mesh.field
    background = fields.add("Structured")
    fields.setString(background, "FileName", str(file))
    fields.setNumber(background, "TextFormat", 0)
    fields.setAsBackgroundMesh(background)


def _add_volumes(gmsh: Any, job: Job) -> list[int]:
    """Add a discrete surface for each sheet; return the tags of the volumes.

    Sheets share the vertices along their edges, so the first one gets all vertices. Gmsh identifies
    a volume by its sheets, and no two volumes have the same sheets.
    """
    points, triangles, sheet, bounds = (job[name] for name in ("points", "triangles", "sheet", "bounds"))
    surfaces = [gmsh.model.addDiscreteEntity(2) for _ in bounds]
    gmsh.model.mesh.addNodes(2, surfaces[0], np.arange(1, len(points) + 1), points.ravel())
    for surface, members in zip(surfaces, members_of(sheet, len(bounds)), strict=True):
        gmsh.model.mesh.addElementsByType(surface, _TRIANGLE, [], (triangles[members] + 1).ravel())
    volumes = []
    for volume in range(int(bounds.max()) + 1):
        around = np.flatnonzero((bounds == volume).any(axis=1))
        loop = gmsh.model.geo.addSurfaceLoop([surfaces[k] for k in around])
        volumes.append(gmsh.model.geo.addVolume([loop]))
    gmsh.model.geo.synchronize()
    return volumes


def _fill(gmsh: Any, job: Job) -> tuple[Any, Any]:
    """Fill the surface; its points come first."""
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    _set_options(gmsh, job)
    volumes = _add_volumes(gmsh, job)

    _set_edge_lengths(gmsh, job["lengths"], job["origin"], job["spacing"])
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
    serve("gmsh", _fill)

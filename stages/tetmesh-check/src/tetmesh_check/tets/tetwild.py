"""fTetWild: fills any surface, within an envelope of it.

``python -m tetmesh_check.tets.tetwild FOLDER`` is its child process.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

import numpy as np

from tetmesh_check.quality import Cells, Points, Values
from tetmesh_check.tets.worker import Job, Raw, Runner, Worker, scale_of, serve

if TYPE_CHECKING:
    from tetmesh_check.surface import Surface

MAX_BACKGROUND_NODES = 200_000
"""Maximum number of nodes of the background mesh. They cost little compared with the tetrahedra."""
_COARSE_FRACTION = 0.05
"""Minimum edge length outside the object, relative to the diagonal of its bounding box. The default
of fTetWild."""
_LOG_LEVEL = 3
"""fTetWild's warnings; below that it also writes debugging meshes into the working folder."""

WORKER = Worker(
    name="fTetWild",
    module="tetmesh_check.tets.tetwild",
    library="pytetwild",
    when_it_fails="try a larger --tet-size-factor or a larger --envelope, or a machine with more memory",
    when_it_is_missing="the environment is not whole: make it again with stages/tetmesh-check/setup-env.sh",
    shown={
        "pass": re.compile(r"/+ pass (\d+) /+"),
        "tetrahedra": re.compile(r"#t = (\d+)"),
        "largest energy": re.compile(r"max_energy = ([0-9.eE+-]+)"),
    },
    when_it_is_empty="the envelope may be larger than the object: try a smaller --envelope",
)


def fill_by_tetwild(
    surface: Surface,
    background: tuple[Points, Cells, Values, int],
    settings: dict[str, Any],
    envelope: float,
    runner: Runner,
) -> Raw:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    surface
        A checked surface.
    background
        Mesh with the edge lengths over the object: points, tetrahedra, edge lengths (mm), and the
        voxels from one node to the next.
    settings
        Arguments of pytetwild: ``stop_energy`` (optimization stops at this largest AMIPS energy; 3
        is regular, larger is worse), ``num_opt_iter`` (largest number of passes), ``num_threads``.
    envelope
        Largest distance of the new boundary from the surface, mm.
    runner
        Runs fTetWild, and raises the errors.
    """
    scale, diagonal = scale_of(surface.points), surface.bounding_box_diagonal
    points, tetrahedra, lengths, stride = background
    epsilon = envelope / diagonal
    job = {
        "scale": scale,
        "vertices": scale * surface.points,
        "faces": surface.triangles.astype(np.int32),
        "bg_vertices": scale * points,
        "bg_tets": tetrahedra.astype(np.int32),
        "bg_values": scale * lengths,
        # fTetWild first meshes the whole box at this length, then refines to the background. A
        # large length saves work on tetrahedra outside the object, which are removed.
        "edge_length_abs": scale * min(max(float(lengths.max()), _COARSE_FRACTION * diagonal), diagonal),
        "epsilon": epsilon,
        **settings,
    }
    raw = runner.run(WORKER, job)
    last = WORKER.shown_in(runner.log.read_text(encoding="utf-8", errors="replace"))
    raw.summary.update(
        passes=int(last["pass"]) + 1 if "pass" in last else 0,
        last_max_energy=float(last["largest energy"]) if "largest energy" in last else None,
        epsilon_relative=epsilon,
        stop_energy=settings["stop_energy"],
        background_nodes=len(points),
        background_tetrahedra=len(tetrahedra),
        background_stride_voxels=stride,
    )
    return raw


def _fill(pytetwild: Any, job: Job) -> tuple[Any, Any]:
    points, tetrahedra = pytetwild.tetrahedralize(
        **job, simplify=False, loglevel=_LOG_LEVEL, quiet=False, vtk_ordering=True
    )
    return points, tetrahedra


if __name__ == "__main__":
    serve("pytetwild", _fill)

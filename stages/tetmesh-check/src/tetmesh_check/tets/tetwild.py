"""fTetWild: fills any surface, and keeps samples of its boundary within an envelope.

``python -m tetmesh_check.tets.tetwild FOLDER`` is its child process.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from tetmesh_check.tets.worker import Job, Raw, Runner, Worker, scale_of, serve

if TYPE_CHECKING:
    from isoparticles._native import GridField

    from tetmesh_check.surface import Surface

MAX_BACKGROUND_NODES = 200_000
"""Maximum number of nodes of the background mesh. They cost little compared with the tetrahedra."""
_COARSE_FRACTION = 0.05
"""Minimum edge length outside the object, relative to the diagonal of its bounding box. The default
of fTetWild."""
_LOG_LEVEL = 3
"""Warnings and errors. At lower levels, fTetWild also writes debugging meshes to the working
folder."""

WORKER = Worker(
    name="fTetWild",
    module="tetmesh_check.tets.tetwild",
    library="pytetwild",
    when_it_fails="try a larger --tet-size-factor or a larger --envelope, or a machine with more memory",
    when_it_is_missing="the environment is incomplete; recreate it with stages/tetmesh-check/setup-env.sh",
    shown={
        "pass": r"/+ pass (\d+) /+",
        "tetrahedra": r"#t = (\d+)",
        "largest energy": r"max_energy = ([0-9.eE+-]+)",
    },
    when_it_is_empty="the envelope may be larger than the object: try a smaller --envelope",
)


def tetwild_job(surface: Surface, field: GridField, size_factor: float) -> Job:
    """Return the arguments of pytetwild for a surface and the edge lengths in it.

    Parameters
    ----------
    surface
        A checked surface.
    field
        Edge lengths in the object, mm.
    size_factor
        Factor of the edge lengths.
    """
    scale, diagonal = scale_of(surface.points), surface.bounding_box_diagonal
    points, tetrahedra, lengths, stride = field.background(surface.points, surface.triangles, MAX_BACKGROUND_NODES)
    lengths = size_factor * lengths
    return {
        "scale": scale,
        "vertices": scale * surface.points,
        "faces": surface.triangles.astype(np.int32),
        "bg_vertices": scale * points,
        "bg_tets": tetrahedra.astype(np.int32),
        "bg_values": scale * lengths,
        "stride": stride,
        # fTetWild first meshes the whole box at this length, then refines to the background. A
        # large length saves work on tetrahedra outside the object, which are removed.
        "edge_length_abs": scale * min(max(float(lengths.max()), _COARSE_FRACTION * diagonal), diagonal),
    }


def fill_by_tetwild(job: Job, runner: Runner) -> Raw:
    """Fill a surface with tetrahedra.

    Parameters
    ----------
    job
        See :func:`tetwild_job`, with more arguments of pytetwild: ``epsilon`` (maximum distance of
        the new boundary from the surface, relative to the diagonal of the bounding box),
        ``stop_energy`` (optimization stops at this maximum AMIPS energy; 3 is regular, larger is
        worse), ``num_opt_iter`` (maximum number of passes) and ``num_threads``.
    runner
        Runs fTetWild, and raises the errors.
    """
    raw = runner.run(WORKER, job)
    last = WORKER.shown_in(runner.said())
    raw.summary.update(
        passes=int(last["pass"]) + 1 if "pass" in last else 0,
        last_max_energy=float(last["largest energy"]) if "largest energy" in last else None,
        epsilon_relative=job["epsilon"],
        stop_energy=job["stop_energy"],
        background_nodes=len(job["bg_vertices"]),
        background_tetrahedra=len(job["bg_tets"]),
        background_stride_voxels=job["stride"],
    )
    return raw


def _fill(pytetwild: Any, job: Job) -> Any:
    del job["stride"]
    return pytetwild.tetrahedralize(**job, simplify=False, loglevel=_LOG_LEVEL, quiet=False, vtk_ordering=True)


if __name__ == "__main__":
    serve("pytetwild", _fill)

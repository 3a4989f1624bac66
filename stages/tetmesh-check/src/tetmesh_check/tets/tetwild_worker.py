"""The process of fTetWild: ``python -m tetmesh_check.tets.tetwild_worker JOB RESULT``."""

from __future__ import annotations

from typing import Any

from tetmesh_check.tets.worker import serve

_LOG_LEVEL = 3
"""fTetWild's warnings; below that it also writes debugging meshes into the working folder."""


def fill(pytetwild: Any, arrays: dict[str, Any], settings: dict[str, Any]) -> tuple[Any, Any]:
    """Fill the surface.

    Parameters
    ----------
    pytetwild
        The library.
    arrays
        ``points, triangles`` and ``background_points, background_tetrahedra, background_values``.
    settings
        The values of :class:`.TetwildSettings`.

    Returns
    -------
    tuple
        Points, mm, and tetrahedra.
    """
    points, tetrahedra = pytetwild.tetrahedralize(
        arrays["points"],
        arrays["triangles"],
        edge_length_abs=settings["edge_length"],
        epsilon=settings["epsilon"],
        simplify=False,
        stop_energy=settings["stop_energy"],
        num_opt_iter=settings["max_passes"],
        num_threads=settings["threads"],
        loglevel=_LOG_LEVEL,
        quiet=False,
        vtk_ordering=True,
        bg_vertices=arrays["background_points"],
        bg_tets=arrays["background_tetrahedra"],
        bg_values=arrays["background_values"],
    )
    return points, tetrahedra


if __name__ == "__main__":
    serve("pytetwild", fill)

"""The process of TetGen: ``python -m tetmesh_check.tets.tetgen_worker JOB RESULT``."""

from __future__ import annotations

from typing import Any

import numpy as np

from tetmesh_check.tets.worker import serve

_OPTIMIZATION = 4
"""Level of the optimization at the end."""


def fill(tetgen: Any, arrays: dict[str, Any], settings: dict[str, Any]) -> tuple[Any, Any]:
    """Fill the surface.

    Parameters
    ----------
    tetgen
        The library.
    arrays
        ``points, triangles``, and ``cavities``, a point in each.
    settings
        The values of :class:`.TetgenSettings`.

    Returns
    -------
    tuple
        Points, mm, and tetrahedra.
    """
    job = tetgen.TetGen(arrays["points"], arrays["triangles"].astype(np.int32))
    for point in arrays["cavities"]:
        job.add_hole(point.tolist())
    # p: fill a surface; Y: leave its triangles as they are; q: shape; a: volume; O: optimize
    switches = f"pYq{settings['max_radius_edge_ratio']:g}/{settings['min_dihedral']:g}a{settings['max_volume']:.15f}O{_OPTIMIZATION}"
    print(f"switches {switches}", flush=True)
    points, tetrahedra = job.tetrahedralize(switches=switches)[:2]
    return np.asarray(points), np.asarray(tetrahedra)


if __name__ == "__main__":
    serve("tetgen", fill)

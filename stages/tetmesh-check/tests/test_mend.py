"""Tests of the driver of mending. The Rust module ``tetrahedra`` tests the mending itself."""

from __future__ import annotations

import numpy as np
from complexes import between
from test_solve import block

from tetmesh_check.checks import Limits
from tetmesh_check.materials import Conformity, Sides, conform
from tetmesh_check.quality import Cells, Points, tetrahedron_quality
from tetmesh_check.tets.fill import mend
from tetmesh_check.tets.worker import Raw


def crooked() -> tuple[Points, Cells, Cells, Sides]:
    """Return a block of two materials, in which inner vertices are moved close to a face."""
    points, cells = block((9, 9, 10), 1.0)
    upper = points[cells].mean(axis=1)[:, 2] > 5.0
    made = between(points, cells, 1 + upper.astype(np.int64), ("lower", "upper"))
    # surface vertices come first
    place = {tuple(position): k for k, position in enumerate(made.points.tolist())}
    order = [place.setdefault(tuple(position), len(place)) for position in points.tolist()]
    moved = np.empty_like(points)
    moved[order] = points
    cells = np.array(order)[cells]
    for x, y, z in ((2.0, 2.0, 2.0), (6.0, 5.0, 4.0), (4.0, 4.0, 7.0)):
        moved[place[x, y, z]] += [0.0, 0.0, 0.9]
    table = [{"name": name} for name in ("outside", *made.names)]
    return moved, cells, made.triangles, Sides(made.inside, made.outside, table)


def test_the_rest_of_the_mesh_stays() -> None:
    points, cells, triangles, sides = crooked()
    below = tetrahedron_quality(points, cells).min_dihedral < 12.0
    mended = mend(Raw(points, cells, {}), triangles, sides, Limits())
    assert mended is not None
    raw, conformity = mended
    results = raw.summary["mended"]
    assert (results["goal_degrees"], results["below_before"], results["below_after"]) == (12.0, below.sum(), 0)
    assert tetrahedron_quality(raw.points, raw.tetrahedra).min_dihedral.min() >= 12.0
    assert len(raw.tetrahedra) == len(cells) - results["tetrahedra_replaced"] + results["tetrahedra_put"]
    assert len(raw.points) == len(points) - results["vertices_taken"] + results["vertices_put"]
    surface = int(triangles.max()) + 1
    np.testing.assert_array_equal(raw.points[:surface], points[:surface])
    anew = conform(len(raw.points), raw.tetrahedra, triangles, sides)
    assert anew.faults == 0
    for field in Conformity._fields:
        np.testing.assert_array_equal(getattr(conformity, field), getattr(anew, field))
    # the new mesh needs no mending
    assert mend(raw, triangles, sides, Limits()) is None

"""Tests of the local repair of tetrahedra, which keeps surfaces, regions and volumes."""

from __future__ import annotations

import numpy as np
import pytest
from complexes import between
from scipy.spatial import Delaunay
from test_solve import block

from tetmesh_check import cavity
from tetmesh_check.cavity import Goal, Part, measure
from tetmesh_check.conform import NOBODY, conform
from tetmesh_check.forced import ForcedSides
from tetmesh_check.materials import Sides
from tetmesh_check.mend import SHARE, mend
from tetmesh_check.quality import Cells, Labels, Points, signed_tetrahedron_volumes, tetrahedron_quality

GOAL = Goal(12.0, 0.05)
_NO = np.empty(0, dtype=np.int64)
NONE = (ForcedSides(_NO, _NO, np.empty(0)), _NO)


def sliver(height: float) -> tuple[Points, Cells]:
    """Return a bipyramid with a flat tetrahedron across its middle.

    The four corners of the middle are alternately above and below z = 0.
    """
    ring = [[1.0, 0.0, height], [0.0, 1.0, -height], [-1.0, 0.0, height], [0.0, -1.0, -height]]
    cells = np.array([[0, 1, 2, 3], [0, 1, 2, 4], [0, 2, 3, 4], [0, 1, 3, 5], [1, 2, 3, 5]])
    points = np.array([*ring, [0.0, 0.0, 1.0], [0.0, 0.0, -1.0]])
    turned = signed_tetrahedron_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    return points, cells


def test_a_sliver_between_vertices_of_the_surface_goes() -> None:
    points, cells = sliver(0.02)
    part = Part(points, cells, np.ones(5, dtype=np.int64), {}, GOAL)
    outside = {tuple(sorted(face)) for face, _ in part.faces(sorted(part.tetrahedra))}
    (worst,) = part.bad()
    assert part.value[worst] < 0.75, "half of the goal"
    assert part.mend(worst)
    assert part.bad() == []
    assert {tuple(sorted(face)) for face, _ in part.faces(sorted(part.tetrahedra))} == outside
    after, used = np.array([part.tetrahedra[k] for k in sorted(part.tetrahedra)]), np.array(part.points)
    volumes = signed_tetrahedron_volumes(used, after)
    assert volumes.min() > 0
    np.testing.assert_allclose(volumes.sum(), signed_tetrahedron_volumes(points, cells).sum())
    np.testing.assert_array_equal(used[: len(points)], points)


def test_what_lies_between_regions_is_not_crossed() -> None:
    points, cells = sliver(0.02)
    # the sliver is a separate region, so its faces are fixed and it cannot be repaired
    part = Part(points, cells, np.array([2, 1, 1, 1, 1]), {}, GOAL)
    (worst,) = part.bad()
    assert not part.mend(worst)
    # on a forced side, the goal is limited by the maximum possible value
    bound = float(tetrahedron_quality(points, cells[:1]).min_dihedral[0])
    regions = np.ones(5, dtype=np.int64)
    assert Part(points, cells, regions, {((0, 1, 2), 1): bound}, GOAL).bad() == []
    assert len(Part(points, cells, regions, {((0, 1, 2), 1): 1.2 * bound}, GOAL).bad()) == 1
    assert len(Part(points, cells, regions, {((0, 1, 2), 2): bound}, GOAL).bad()) == 1
    # the limit of the check still applies if it can be reached
    strict = Goal(12.0, 0.05, 1.05 * bound)
    assert len(Part(points, cells, regions, {((0, 1, 2), 1): 1.08 * bound}, strict).bad()) == 1


def test_on_a_needle_no_more_is_asked_for_than_it_allows() -> None:
    points, cells = sliver(0.02)
    jacobian = float(tetrahedron_quality(points, cells[:1]).scaled_jacobian[0])
    regions, goal = np.ones(5, dtype=np.int64), Goal(1.0, 2.0 * jacobian)
    assert len(Part(points, cells, regions, {}, goal).bad()) == 1
    for share, bad in ((1.0, 0), (1.2, 1)):
        assert len(Part(points, cells, regions, {}, goal, {(0, 1, 2): share * jacobian}).bad()) == bad


def test_values_are_a_half_at_the_limits_of_the_checks_and_1_at_the_goal() -> None:
    points = np.random.default_rng(3).normal(size=(400, 3))
    cells = np.arange(400).reshape(-1, 4)
    quality, found = (
        tetrahedron_quality(points, cells),
        measure([points[cells[:, k]].T for k in range(4)], Goal(12.0, 0.05, 5.0).plain),
    )
    by_angle = np.interp(quality.min_dihedral, [0.0, 5.0, 12.0], [0.0, 0.5, 1.0])
    flat = quality.scaled_jacobian < 0.05
    wanted = np.where(flat, np.minimum(by_angle, 0.5 * quality.scaled_jacobian / 0.05), by_angle)
    positive = quality.volume > 0
    assert 0.3 < positive.mean() < 0.7
    np.testing.assert_allclose(found[positive], wanted[positive], rtol=1e-6)
    assert (found[~positive] <= 0).all()


def test_what_the_checks_still_ask_for_beside_a_forced_side_is_worth_more_than_what_they_do_not() -> None:
    goal = Goal(12.0, 0.05, 5.0)
    # If the surface limits the dihedral angle to 3 degrees, the checks require a scaled Jacobian
    # but no angle. With a bound of 1 degree they require neither, and with 9 degrees both.
    assert goal.beside(3.0) == pytest.approx((2.7, 0.05, 0.0, 0.05))
    assert goal.beside(1.0) == pytest.approx((0.9, 0.9 * np.sqrt(2.0) * np.sin(np.radians(1.0)), 0.0, 0.0))
    assert goal.beside(9.0) == pytest.approx((8.1, 0.05, 5.0, 0.05))
    assert goal.beside(5.2) == pytest.approx((5.0, 0.05, 5.0, 0.05))
    points, cells = sliver(0.02)
    jacobian = float(tetrahedron_quality(points, cells[:1]).scaled_jacobian[0])
    angle = float(tetrahedron_quality(points, cells[:1]).min_dihedral[0])
    regions = np.ones(5, dtype=np.int64)
    # The triangle permits twice the scaled Jacobian of the tetrahedron. `value` is 0.5 at the
    # limits and 1 at the goals, so it must exceed 0.5 only if the angle passes the check.
    for least, low, high in ((0.9 * angle, 0.5, 1.0), (1.1 * angle, 0.0, 0.5)):
        part = Part(points, cells, regions, {}, Goal(1.2 * angle, 4.0 * jacobian, least), {(0, 1, 2): 2.0 * jacobian})
        assert low < part.value[0] < high


@pytest.mark.parametrize(("eased", "left"), [(cavity._EASED, 1), (1.0, 2)])
def test_where_no_worst_becomes_better_what_fails_together_becomes_less(
    eased: float, left: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Four tetrahedra of a convex body with a short edge fail the checks. Moves that improve the
    # worst tetrahedron by MARGIN leave two of them. With `_EASED`, a further move leaves one.
    side = [[0.0, 0.0, -0.04], [0.0, 0.0, 0.04], [1.0, -0.6, 0.0], [1.0, 0.6, 0.0]]
    behind = [[1.37, 0.13, -0.03], [0.5, 0.26, -1.28], [1.47, 0.36, 0.5], [1.45, 0.18, -0.32], [1.11, 0.9, -0.35]]
    points = np.array(side + behind)
    cells = Delaunay(points).simplices.astype(np.int64)
    turned = signed_tetrahedron_volumes(points, cells) < 0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    monkeypatch.setattr(cavity, "_EASED", eased)
    part = Part(points, cells, np.ones(len(cells), dtype=np.int64), {}, Goal(12.0, 0.05, 5.0))
    assert sum(value < 0.5 for value in part.value.values()) == 4
    for _ in range(4):
        for number in part.bad():
            if number in part.tetrahedra:
                part.mend(number)
    assert sum(value < 0.5 for value in part.value.values()) == left
    assert min(part.value.values()) > 0.45
    after = np.array([part.tetrahedra[k] for k in sorted(part.tetrahedra)])
    volumes = signed_tetrahedron_volumes(np.array(part.points), after)
    assert volumes.min() > 0
    np.testing.assert_allclose(volumes.sum(), signed_tetrahedron_volumes(points, cells).sum())


def crooked() -> tuple[Points, Cells, Labels, Cells, Sides]:
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
    return moved, cells, 1 + upper.astype(np.int64), made.triangles, Sides(made.inside, made.outside, table)


def test_the_rest_of_the_mesh_stays() -> None:
    points, cells, regions, triangles, sides = crooked()
    found, quality = conform(cells, triangles, sides), tetrahedron_quality(points, cells)
    assert found.faults == 0
    np.testing.assert_array_equal(found.regions, regions)
    below = quality.min_dihedral < 12.0
    assert 0 < below.sum() < SHARE * len(cells)
    assert quality.volume.min() > 0
    mended = mend((points, cells), found, quality, triangles, NONE, GOAL)
    assert mended is not None
    assert mended.results["below_before"] == below.sum()
    assert mended.results["below_after"] == 0
    after = tetrahedron_quality(mended.points, mended.tetrahedra)
    assert after.min_dihedral.min() >= 12.0
    surface = int(triangles.max()) + 1
    np.testing.assert_array_equal(mended.points[:surface], points[:surface])
    # the updated conformity equals a new computation
    anew = conform(mended.tetrahedra, triangles, sides)
    assert anew.faults == 0
    for name in ("regions", "behind", "before"):
        np.testing.assert_array_equal(getattr(mended.conformity, name), getattr(anew, name))
    for number in (1, 2):
        np.testing.assert_allclose(after.volume[anew.regions == number].sum(), quality.volume[regions == number].sum())
    assert (anew.before == NOBODY).any()
    again = mend((points, cells), found, quality, triangles, NONE, GOAL)
    assert again is not None
    assert again.points.tobytes() == mended.points.tobytes()
    assert again.tetrahedra.tobytes() == mended.tetrahedra.tobytes()


def test_a_mesh_that_is_bad_as_a_whole_stays() -> None:
    points, cells, _, triangles, sides = crooked()
    found, quality = conform(cells, triangles, sides), tetrahedron_quality(points, cells)
    assert (quality.min_dihedral < 50.0).mean() > SHARE
    assert mend((points, cells), found, quality, triangles, NONE, Goal(50.0, 0.05)) is None

"""Tests that a surface that does not bound a volume is refused with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from conftest import Run, ball, merged, reversed_winding
from isoparticles._native import changed_triangles, self_intersections, surface_components, surface_topology

from tetmesh_check.datasets import from_polydata
from tetmesh_check.errors import StageError
from tetmesh_check.surface import check_surface, read_surface
from tetmesh_check.topology import Components, tetrahedron_boundary


def without_one_triangle(surface: pv.PolyData) -> pv.PolyData:
    return pv.PolyData(np.asarray(surface.points), np.asarray(surface.faces)[4:])


def with_nan(surface: pv.PolyData) -> pv.PolyData:
    points = np.array(surface.points)
    points[5, 1] = np.nan
    return pv.PolyData(points, np.asarray(surface.faces))


def with_one_turned_triangle(surface: pv.PolyData) -> pv.PolyData:
    faces = np.array(surface.faces).reshape(-1, 4)
    faces[3] = faces[3, [0, 1, 3, 2]]
    return pv.PolyData(np.asarray(surface.points), faces.ravel())


SHIFTED = ball().translate((9.0, 0.4, 0.3))
BAD = {
    "open": (without_one_triangle(ball()), "3 open edges"),
    "inside_out": (reversed_winding(ball()), "inside out"),
    "one_of_two_inside_out": (merged(ball(), reversed_winding(ball(2.0).translate((30, 0, 0)))), "1 of 2 components"),
    "nested_but_not_a_cavity": (merged(ball(), ball(5.0)), "1 of 2 components"),
    "turned_triangle": (with_one_turned_triangle(ball()), "3 edges whose triangles disagree"),
    "nan": (with_nan(ball()), "1 of 162 vertices"),
    "crossing": (merged(ball(), SHIFTED), "intersects itself"),
    "doubled": (merged(ball(), ball()), "edges with more than two triangles"),
    "quads": (pv.Cube(), "not triangles"),
    "empty": (pv.PolyData(), "is empty"),
}


@pytest.mark.parametrize("name", BAD)
def test_bad_surface_is_refused(name: str, tmp_path: Path) -> None:
    surface, words = BAD[name]
    path = tmp_path / "bad.vtp"
    surface.save(path)
    with pytest.raises(StageError) as caught:
        check_surface(path, read_surface(path))
    assert words in str(caught.value)
    assert "what to do" in str(caught.value)


@pytest.mark.parametrize("name", ["open", "nan", "crossing", "empty"])
def test_bad_surface_leaves_nothing_behind(name: str, tmp_path: Path, run: Run) -> None:
    BAD[name][0].save(tmp_path / "bad.vtp")
    done = run("bad.vtp", "-o", "out.volume.vtu")
    assert done.returncode == 2, done.stderr
    assert "why it matters" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["bad.vtp"]


def test_files_that_are_no_surface(tmp_path: Path) -> None:
    for name, content in (("a.vtp", b"<VTKFile"), ("b.vtp", b""), ("c.xyzzy", b"?"), ("d.vtp", b"\0" * 4000)):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(StageError):
            read_surface(tmp_path / name)
    with pytest.raises(StageError, match="no such file"):
        read_surface(tmp_path / "absent.vtp")
    pv.ImageData(dimensions=(3, 3, 3)).save(tmp_path / "image.vti")
    with pytest.raises(StageError, match="ImageData"):
        read_surface(tmp_path / "image.vti")


def test_truncated_file_is_refused(tmp_path: Path) -> None:
    ball().save(tmp_path / "whole.vtp")
    content = (tmp_path / "whole.vtp").read_bytes()
    (tmp_path / "cut.vtp").write_bytes(content[: len(content) // 2])
    with pytest.raises(StageError):
        check_surface(tmp_path / "cut.vtp", read_surface(tmp_path / "cut.vtp"))


def test_good_surfaces_pass(tmp_path: Path) -> None:
    torus = pv.ParametricTorus(ringradius=6, crosssectionradius=2, u_res=40, v_res=20).clean().triangulate()
    torus = torus if torus.volume > 0 and measure(torus)[1] else reversed_winding(torus)
    shell = merged(ball(), reversed_winding(ball(5.0)))
    path = tmp_path / "good.vtp"
    for surface, components, euler in (
        (ball(), 1, 2),
        (torus, 1, 0),
        (shell, 2, 4),
        (merged(ball(), ball(2).translate((15, 0, 0))), 2, 4),
    ):
        surface.save(path)
        topology = check_surface(path, read_surface(path))[0]["topology"]
        assert (topology["components"], topology["euler_characteristic"]) == (components, euler)


def measure(surface: pv.PolyData) -> tuple[int, bool]:
    triangles = np.asarray(surface.faces).reshape(-1, 4)[:, 1:].astype(np.int64)
    points = np.asarray(surface.points, dtype=np.float64)
    return len(triangles), not len(Components(**surface_components(points, triangles)).inside_out())


def test_vertices_written_once_a_triangle_are_joined(tmp_path: Path) -> None:
    ball().save(tmp_path / "soup.stl")
    surface = read_surface(tmp_path / "soup.stl")
    assert check_surface(tmp_path / "soup.stl", surface)[0]["topology"]["vertices"] == 162
    soup = ball()
    corners = np.asarray(soup.points)[np.asarray(soup.faces).reshape(-1, 4)[:, 1:].ravel()]
    faces = np.arange(len(corners)).reshape(-1, 3)
    pv.PolyData(corners, np.hstack([np.full((len(faces), 1), 3), faces]).ravel()).save(tmp_path / "soup.vtp")
    surface = read_surface(tmp_path / "soup.vtp")
    assert surface.merged_points == 960 - 162
    assert check_surface(tmp_path / "soup.vtp", surface)[0]["topology"]["vertices"] == 162


def test_pinched_vertex_is_counted() -> None:
    points = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1], [-1, 0, 0], [0, -1, 0], [0, 0, -1]])
    one = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [0, 3, 2]])
    other = np.array([[0, 4, 5], [0, 6, 4], [4, 6, 5], [0, 5, 6]])
    topology = surface_topology(len(points), np.concatenate([one, other]))
    assert [topology[key] for key in ("open_edges", "nonmanifold_edges", "nonmanifold_vertices")] == [0, 0, 1]
    assert topology["components"] == 1


def test_crossing_pairs_against_all_pairs() -> None:
    generator = np.random.default_rng(3)
    points = generator.uniform(size=(3 * 60, 3))
    triangles = np.arange(len(points)).reshape(-1, 3)

    def crosses(first: np.ndarray, second: np.ndarray) -> bool:
        for edges, other in ((first, second), (second, first)):
            normal = np.cross(other[1] - other[0], other[2] - other[0])
            for k in range(3):
                p, q = edges[k], edges[(k + 1) % 3]
                t = normal @ (other[0] - p) / (normal @ (q - p))
                u, v = np.linalg.lstsq(
                    np.stack([other[1] - other[0], other[2] - other[0]], 1), p + t * (q - p) - other[0]
                )[0]
                if 0 < t < 1 and u > 0 and v > 0 and u + v < 1:
                    return True
        return False

    truth = {(i, j) for i in range(60) for j in range(i + 1, 60) if crosses(points[triangles[i]], points[triangles[j]])}
    found = {tuple(sorted(pair)) for pair in self_intersections(points, triangles).tolist()}
    assert len(truth) > 20
    assert found == truth


def test_mirrored_overlap_is_found() -> None:
    # the balls are mirror images of each other, so every edge that enters the other ball meets its
    # own mirror image, and no edge crosses the interior of a triangle
    both = merged(ball(), ball().translate((9.0, 0, 0)))
    triangles = np.asarray(both.faces).reshape(-1, 4)[:, 1:].astype(np.int64)
    assert len(self_intersections(np.asarray(both.points), triangles)) > 0


def nested() -> pv.PolyData:
    """Return three hollow balls, one of them in the cavity of another, not sorted by size."""
    return merged(
        ball(3.0).translate((30.0, 0, 0)),
        reversed_winding(ball(2.0).translate((0.3, 0, 0))),
        ball(10.0),
        ball(5.0),
        reversed_winding(ball(8.0)),
        reversed_winding(ball(0.5).translate((30.5, 0, 0))),
    )


def test_which_component_lies_in_which() -> None:
    surface = nested()
    components = Components(**surface_components(*from_polydata(surface)))
    np.testing.assert_array_equal(components.depths, [0, 3, 0, 2, 1, 1])
    np.testing.assert_array_equal(components.parents, [-1, 3, -1, 4, 2, 0])
    np.testing.assert_array_equal(components.sheets()[0], [[body, -1] for body in (0, 2, 1, 2, 1, 0)])
    assert not len(components.inside_out())
    np.testing.assert_array_equal(np.sign(components.volumes), [1, -1, 1, 1, -1, -1])
    turned = Components(**surface_components(*from_polydata(reversed_winding(surface))))
    np.testing.assert_array_equal(turned.inside_out(), range(6))
    np.testing.assert_array_equal(turned.parents, components.parents)


def test_many_components_are_told_apart() -> None:
    places = 3.0 * np.stack(np.meshgrid(*3 * [np.arange(10)], indexing="ij"), -1).reshape(-1, 3)
    small = ball(1.0, 1)
    points = (places[:, None] + np.asarray(small.points)).reshape(-1, 3)
    cavities = np.asarray(small.faces).reshape(-1, 4)[:, [1, 3, 2]]
    triangles = np.concatenate([cavities + k * small.n_points for k in range(len(places))])
    around = ball(60.0, 4)
    points = np.concatenate([points, np.asarray(around.points)])
    triangles = np.concatenate(
        [triangles, np.asarray(around.faces).reshape(-1, 4)[:, 1:] + len(places) * small.n_points]
    )
    components = Components(**surface_components(points, triangles))
    np.testing.assert_array_equal(components.sheets()[0], [[0, -1]] * 1001)
    assert not len(components.inside_out())


def test_changed_triangles_are_counted() -> None:
    points, triangles = from_polydata(ball())
    # the same triangles in a different order, with an extra vertex
    order = np.random.default_rng(1).permutation(len(points))
    place = np.argsort(order)
    same = (np.concatenate([points[order], [[0.0, 0, 0]]]), np.roll(place[triangles], 1, axis=1)[::-1])
    assert changed_triangles(points, triangles, *same) == [0, 0]
    assert changed_triangles(points, triangles, points, triangles[3:]) == [3, 0]
    assert changed_triangles(points, triangles, points, triangles[:, ::-1]) == [320, 320]
    moved = points.copy()
    moved[7, 1] = np.nextafter(moved[7, 1], 1e9)
    around = int((triangles == 7).sum())
    assert changed_triangles(points, triangles, moved, triangles) == [around, around]


def test_boundary_and_bodies_of_tetrahedra() -> None:
    # two tetrahedra that share a face, and a third that shares only an edge with them
    cells = np.array([[0, 1, 2, 3], [0, 2, 1, 4], [0, 1, 5, 6]])
    outside = tetrahedron_boundary(cells)
    assert len(outside.triangles) == 10
    np.testing.assert_array_equal(outside.bodies, [0, 0, 1])
    assert {0, 1, 2} not in [set(triangle) for triangle in outside.triangles.tolist()]
    for triangle, owner in zip(outside.triangles.tolist(), outside.owners, strict=True):
        assert set(triangle) < set(cells[owner].tolist())

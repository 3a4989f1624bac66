"""Tests of prism layers: heights, volumes and faces against analytic truth, and refusals."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import pyvista as pv
from complexes import cells_of_a_block
from conftest import NEEDS_HXT, Run, quiet_context
from scipy.spatial import Delaunay
from test_solve import block
from test_split import NAMES, joined, plates, with_muscle

from tetmesh_check.checks import Check, Limits
from tetmesh_check.cli import main
from tetmesh_check.datasets import text_of, to_polydata
from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.fem.solve import VolumeMesh
from tetmesh_check.layer_measures import describe_layers, loose_faces
from tetmesh_check.layers import Layered, add_layers, refuse_layers
from tetmesh_check.materials import NOBODY
from tetmesh_check.measures import mark
from tetmesh_check.parts.find import find_parts
from tetmesh_check.parts.layers import read_layers
from tetmesh_check.parts.measure import describe_parts
from tetmesh_check.parts.model import Parts
from tetmesh_check.parts.tags import read_tag
from tetmesh_check.prisms import FACES, jacobians
from tetmesh_check.quality import OUTWARD_FACES, Points, signed_tetrahedron_volumes, tetrahedron_quality
from tetmesh_check.surface import Surface
from tetmesh_check.topology import tetrahedron_boundary

Made = tuple[MarkedMesh, Parts, Surface]
ENDS = ("plane:0,0,3.99,0,0,1=top", "plane:0,0,0.01,0,0,-1=bottom")
SIDES_OF_BLOCK = (
    "plane:0.01,0,0,-1,0,0=x0", "plane:5.99,0,0,1,0,0=x1", "plane:0,0.01,0,0,-1,0=y0", "plane:0,5.99,0,0,1,0=y1",
)  # fmt: skip


def one_object(points: Points, cells: np.ndarray, layers: str, *tags: str) -> Made:
    """Return a mesh of one object without layers, with parts by tags."""
    volumes = signed_tetrahedron_volumes(points, cells)
    assert volumes.min() > 0.0
    outside = tetrahedron_boundary(cells)
    surface = Surface(points, outside.triangles, None, 0)
    parts = find_parts(
        surface, None, [read_tag(tag) for tag in tags], layers=[read_layers(text) for text in layers.split()]
    )
    mesh = VolumeMesh(points, cells, volumes, outside)
    return mark(surface, mesh, None, parts, None, quiet_context()), parts, surface


def materials(*layers: str, material: object = plates) -> Made:
    """Return a block of two or three materials without layers."""
    return joined(material, layers=[read_layers(text) for text in layers])  # type: ignore[arg-type]


def tube(rings: int, length: int) -> tuple[Points, np.ndarray]:
    """Return a right prism on a regular polygon of radius 2 with 6 sides for each ring."""
    flat = [np.zeros((1, 2))]
    for ring in range(1, rings + 1):
        angles = 2.0 * np.pi * np.arange(6 * ring) / (6 * ring)
        flat.append(2.0 * ring / rings * np.stack([np.cos(angles), np.sin(angles)], 1))
    plane = np.concatenate(flat)
    a, b, c = np.sort(Delaunay(plane).simplices, axis=1).T.astype(np.int64)
    count = len(plane)
    steps = np.arange(length + 1) * 4.0 / length
    points = np.column_stack([np.tile(plane, (length + 1, 1)), steps.repeat(count)])
    corners = [(a, b, c, c + count), (a, b, b + count, c + count), (a, a + count, b + count, c + count)]
    column = np.concatenate([np.stack(four, 1) for four in corners])
    cells = np.concatenate([column + count * step for step in range(length)])
    inverted = signed_tetrahedron_volumes(points, cells) < 0.0
    cells[inverted] = cells[inverted][:, [0, 2, 1, 3]]
    return points, cells


def layered(made: Made, number: int = 0) -> tuple[MarkedMesh, Layered, dict, dict[str, Check]]:
    """Add the layers of a wall; return the mesh with them, their measures and their checks."""
    mesh, parts, surface = made
    refuse_layers(parts, surface)
    found = add_layers(mesh, parts.walls[number], tetrahedron_quality(mesh.points, mesh.tetrahedra), Limits())
    results, checks = describe_layers(found, mesh, parts.walls[number])
    return found.mesh, found, results, {one.name: one for one in checks}


def prism_volumes(mesh: MarkedMesh) -> np.ndarray:
    """Return the volumes of the prisms by VTK."""
    grid = pv.UnstructuredGrid({pv.CellType.WEDGE: mesh.prisms}, mesh.points)
    return np.asarray(grid.compute_cell_sizes()["Volume"])


def volume_of(mesh: MarkedMesh) -> float:
    return float(signed_tetrahedron_volumes(mesh.points, mesh.tetrahedra).sum() + prism_volumes(mesh).sum())


def sorted_faces(cells: np.ndarray, sides: tuple[tuple[int, ...], ...]) -> list[tuple[int, ...]]:
    return [tuple(sorted(cell[corner] for corner in side)) for cell in cells.tolist() for side in sides]


def assert_sound(mesh: MarkedMesh, made: Made) -> None:
    """Check the elements, that their faces match, and that the wall stays."""
    before, wall = made[0], np.isin(made[0].marks, sorted(made[1].walls[0].members))
    assert jacobians(mesh.points, mesh.prisms).min() > 0.0
    assert prism_volumes(mesh).min() > 0.0
    assert signed_tetrahedron_volumes(mesh.points, mesh.tetrahedra).min() > 0.0
    assert volume_of(mesh) == pytest.approx(volume_of(before), rel=1e-12)
    np.testing.assert_array_equal(mesh.faces[wall], before.faces[wall])
    np.testing.assert_array_equal(mesh.points[mesh.faces[wall]], before.points[before.faces[wall]])
    faces = sorted_faces(mesh.tetrahedra, OUTWARD_FACES) + sorted_faces(mesh.prisms, FACES)
    distinct, counts = np.unique([(*face, -1)[:4] for face in faces], axis=0, return_counts=True)
    assert counts.max() == 2
    outer = [own.nodes.tolist() for own in mesh.faces_of(np.flatnonzero(mesh.outermost))]
    expected = [(*sorted(face), -1)[:4] for own in outer for face in own]
    assert sorted(map(tuple, distinct[counts == 1].tolist())) == sorted(expected)
    assert loose_faces(mesh) == 0
    elements = [*mesh.tetrahedra.tolist(), *mesh.prisms.tolist()]
    for own in mesh.faces_of():
        for face, number in zip(own.nodes.tolist(), own.members.tolist(), strict=True):
            assert set(face) < set(elements[mesh.owners[number]])
            assert mesh.before[number] == NOBODY or set(face) < set(elements[mesh.before[number]])


def test_layers_on_two_plates_have_exact_heights_and_volumes() -> None:
    made = one_object(*block((6, 6, 4)), "top+bottom=3,0.1,1.5", *ENDS)
    mesh, _, results, checks = layered(made)
    assert_sound(mesh, made)
    heights = np.unique(mesh.points[len(made[0].points) :, 2].round(12))
    np.testing.assert_allclose(heights, [0.1, 0.25, 0.475, 3.525, 3.75, 3.9], rtol=1e-12)
    np.testing.assert_allclose(prism_volumes(mesh).reshape(3, -1)[0], 0.05, rtol=1e-12)
    assert results["volume_mm3"] == pytest.approx(2 * 36 * 0.475, rel=1e-12)
    assert results["first_height_mm"]["min"] == pytest.approx(0.1, rel=1e-12)
    assert results["first_height_mm"]["max"] == pytest.approx(0.1, rel=1e-12)
    assert results["thinner"] == []
    assert all(check.passed for check in checks.values())


def test_the_rim_has_outward_quadrilaterals_in_its_planes() -> None:
    made = one_object(*block((6, 6, 4)), "top+bottom=3,0.1,1.5", *ENDS)
    mesh = layered(made)[0]
    assert len(mesh.quads) == 2 * 3 * 24
    assert mesh.point_marks()[mesh.quads].all()
    for own in mesh.faces_of(np.flatnonzero(mesh.marks == 1)):
        at = mesh.points[own.nodes]
        assert np.any([(at[..., axis] == end).all(axis=1) for axis in (0, 1) for end in (0.0, 6.0)], axis=0).all()
        normals = np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])
        assert (np.einsum("ij,ij->i", normals, at.mean(axis=1) - [3.0, 3.0, 2.0]) > 0.0).all()
    (side,) = (part for part in describe_parts(made[1], mesh)["parts"] if part["name"] == "surface")
    assert side["area_mm2"] == pytest.approx(4 * 24.0, rel=1e-12)


def test_faces_without_a_partner_are_counted() -> None:
    mesh = layered(one_object(*block((6, 6, 4)), "top=2,0.1,1", *ENDS))[0]
    count = len(mesh.faces)
    kept = np.arange(len(mesh.marks)) != count
    fewer = replace(mesh, quads=mesh.quads[1:], before=mesh.before[kept], marks=mesh.marks[kept])
    assert loose_faces(fewer) == 1
    assert loose_faces(replace(mesh, elements=mesh.elements[1:], prisms=mesh.prisms[1:])) >= 5
    turned = mesh.prisms.copy()
    turned[0, 3:] = turned[0, [4, 5, 3]]
    assert loose_faces(replace(mesh, prisms=turned)) > 0


def test_folded_prisms_make_layers_thinner(monkeypatch: pytest.MonkeyPatch) -> None:
    def folded(points: Points, prisms: np.ndarray) -> np.ndarray:
        height = points[prisms[:, 3:], 2].max(axis=1) - points[prisms[:, :3], 2].min(axis=1)
        return np.where((height > 0.12) & (points[prisms[:, 0], 0] < 0.5), -1.0, 1.0)[:, None]

    monkeypatch.setattr("tetmesh_check.layers.jacobians", folded)
    made = one_object(*block((6, 6, 4)), "top=2,0.1,1", *ENDS)
    _, found, _, _ = layered(made)
    at = made[0].points[found.nodes, 0]
    assert found.shares[at == 0.0] == pytest.approx(0.8**3)
    assert (found.shares[at >= 3.0] == 1.0).all()


def test_the_rim_slides_in_an_oblique_cap() -> None:
    points, cells = block((6, 6, 4))
    lean = np.array([[1.0, 0.0, 0.4], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    made = one_object(points @ lean.T, cells, "top=2,0.2,1", *ENDS)
    mesh, found, _, _ = layered(made)
    assert_sound(mesh, made)
    assert found.off_plane < 1e-12
    new = mesh.points[len(points) :]
    np.testing.assert_allclose(np.unique(new[:, 2].round(12)), [3.6, 3.8])
    across = (mesh.points[mesh.quads] @ np.linalg.inv(lean).T).reshape(-1, 3)
    on_side = np.min([np.abs(across[:, axis] - end) for axis in (0, 1) for end in (0.0, 6.0)], axis=0)
    assert on_side.max() < 1e-12


def test_nodes_of_a_cap_follow_in_its_plane() -> None:
    made = one_object(*block((6, 6, 4)), "top=3,0.2,1", *ENDS, *SIDES_OF_BLOCK)
    mesh, found, results, _ = layered(made)
    assert_sound(mesh, made)
    assert results["minimum_share"] == 1.0
    row = np.flatnonzero((made[0].points[:, 0] == 0.0) & (made[0].points[:, 2] == 3.0))[1:-1]
    assert len(row) == 5
    assert (mesh.points[row, 2] < 2.95).all()
    np.testing.assert_array_equal(mesh.points[row, 0], 0.0)
    assert found.off_plane < 1e-12


def test_layers_in_a_straight_tube_have_the_volume_of_polygons() -> None:
    made = one_object(*tube(4, 6), "object-top-bottom=5,0.05,1.2", *ENDS)
    mesh, _, results, checks = layered(made)
    assert_sound(mesh, made)
    # a regular polygon with the inradius a has the area 24 tan(pi / 24) a^2
    inradius, thickness = 2.0 * np.cos(np.pi / 24), 0.05 * (1.2**5 - 1.0) / 0.2
    area = 24.0 * np.tan(np.pi / 24) * (inradius**2 - (inradius - thickness) ** 2)
    # the sides meet at 15 degrees, where heights are within 1 %
    assert results["volume_mm3"] == pytest.approx(4.0 * area, rel=0.01)
    assert results["first_height_mm"]["min"] == pytest.approx(0.05, rel=0.01)
    assert results["first_height_mm"]["max"] == pytest.approx(0.05, rel=0.01)
    assert results["scaled_jacobian"]["min"] > 0.5
    assert checks["layer_caps"].value < 1e-12


def test_heights_are_exact_beside_sharp_edges() -> None:
    made = one_object(*tube(2, 6), "object-top-bottom=2,0.1,1", *ENDS)
    mesh, _, results, _ = layered(made)
    inradius = 2.0 * np.cos(np.pi / 12)
    area = 12.0 * np.tan(np.pi / 12) * (inradius**2 - (inradius - 0.2) ** 2)
    assert results["volume_mm3"] == pytest.approx(4.0 * area, rel=1e-12)
    wall = to_polydata(made[0].points, made[0].boundary[made[0].marks == 1])
    first = mesh.points[np.unique(mesh.prisms[: len(mesh.prisms) // 2, :3])]
    away = pv.PolyData(first).compute_implicit_distance(wall)["implicit_distance"]
    np.testing.assert_allclose(np.abs(away), 0.1, rtol=1e-9)


def narrow(middle: float) -> Made:
    """Return a channel between two walls that is 2 mm high, and ``middle`` at x = 4."""
    points, cells = block((16, 4, 4), 0.5)
    height = 2.0 - (2.0 - middle) * np.maximum(0.0, 1.0 - np.abs(points[:, 0] - 4.0) / 2.0)
    points[:, 2] = (points[:, 2] - 1.0) * height / 2.0
    sides = "plane:7.99,0,0,1,0,0=x1", "plane:0.01,0,0,-1,0,0=x0", "plane:0,1.99,0,0,1,0=y1", "plane:0,0.01,0,0,-1,0=y0"
    return one_object(points, cells, "object-(x0+x1+y0+y1)=3,0.1,1.2", *sides)


def test_layers_get_thinner_where_they_do_not_fit() -> None:
    made = narrow(0.5)
    mesh, found, results, checks = layered(made)
    assert_sound(mesh, made)
    quality = tetrahedron_quality(mesh.points, mesh.tetrahedra)
    assert quality.min_dihedral.min() >= 5.0
    # 2 x 0.364 mm of layers do not fit into 0.5 mm
    assert 0.1 < results["minimum_share"] < 0.5 / (2 * 0.364)
    assert results["thickness_mm"] == pytest.approx(0.364)
    assert abs(results["thinner"][0]["place_mm"][0] - 4.0) <= 1.0
    assert results["thinner"][0]["share"] == results["minimum_share"]
    far = np.abs(made[0].points[found.nodes, 0] - 4.0) > 3.0
    np.testing.assert_array_equal(found.shares[far], 1.0)
    assert results["first_height_mm"]["min"] == pytest.approx(0.1, rel=0.02)
    # all layers stay, with their ratio
    size = len(mesh.prisms) // 3
    columns = mesh.points[mesh.prisms].reshape(3, size, 2, 3, 3)
    heights = np.linalg.norm(columns[:, :, 0] - columns[:, :, 1], axis=-1)
    np.testing.assert_allclose(heights[1:] / heights[:-1], 1.2, rtol=1e-6)
    # the thickness rises by at most a quarter of the way along an edge
    at, thickness = mesh.points[found.nodes], 0.364 * found.shares
    ends = np.searchsorted(found.nodes, mesh.prisms[:size, 3:][:, [[0, 1], [1, 2], [2, 0]]]).reshape(-1, 2).T
    lengths = np.linalg.norm(at[ends[0]] - at[ends[1]], axis=1)
    assert (np.abs(thickness[ends[0]] - thickness[ends[1]]) <= 0.25 * lengths + 1e-12).all()
    assert checks["layer_thickness"].passed


def test_layers_below_a_tenth_fail_the_check() -> None:
    made = narrow(0.1)
    mesh, _, results, checks = layered(made)
    assert_sound(mesh, made)
    assert results["minimum_share"] < 0.1
    assert not checks["layer_thickness"].passed
    assert checks["layer_thickness"].required
    assert "thinner than 10 %" in checks["layer_thickness"].words


def test_layers_in_one_material_leave_the_other_one() -> None:
    made = materials("cartilage:bone/cartilage=2,0.1,1.5")
    mesh, _, results, _ = layered(made)
    assert_sound(mesh, made)
    before, count = made[0], len(made[0].elements)
    bone = before.regions == 1
    np.testing.assert_array_equal(mesh.elements[bone], before.elements[bone])
    np.testing.assert_array_equal(mesh.points[mesh.elements[bone]], before.points[before.elements[bone]])
    assert set(mesh.regions[count:].tolist()) == {2}
    assert results["volume_mm3"] == pytest.approx(36 * 0.25, rel=1e-12)
    np.testing.assert_allclose(np.unique(mesh.points[len(before.points) :, 2].round(12)), [2.1, 2.25])
    interface = np.flatnonzero(np.isin(mesh.marks, sorted(made[1].walls[0].members)))
    # the cartilage, the higher material, is behind the triangles
    np.testing.assert_array_equal(mesh.owners[interface], count + np.arange(72))
    assert (mesh.before[interface] < count).all()
    outer = {mesh.parts[mark] for mark in np.unique(mesh.marks[len(mesh.faces) :]).tolist()}
    assert outer == {"cartilage_to_outside"}


def test_both_sides_of_an_interface_have_layers() -> None:
    made = materials("cartilage:bone/cartilage=2,0.1,1.5", "bone:bone/cartilage=1,0.2,1")
    one = layered(made)[0]
    mesh, _, results, _ = layered((one, *made[1:]), 1)
    assert_sound(mesh, made)
    assert results["volume_mm3"] == pytest.approx(36 * 0.2, rel=1e-12)
    interface = np.isin(mesh.marks, sorted(made[1].walls[0].members))
    count = len(mesh.elements)
    assert mesh.owners[interface].min() >= count
    assert mesh.before[interface].min() >= count + 144
    assert np.bincount(mesh.regions[count:]).tolist() == [0, 72, 144]


def test_a_wall_turns_around_a_corner_between_materials() -> None:
    made = materials("cartilage:cartilage/bone+cartilage/muscle=2,0.1,1", material=with_muscle)
    mesh, _, results, _ = layered(made)
    assert_sound(mesh, made)
    # the walls are 4 mm and 2 mm wide and meet at a right angle
    assert results["volume_mm3"] == pytest.approx(6.0 * (4 * 2 - 3.8 * 1.8), rel=1e-12)
    assert results["first_height_mm"]["max"] == pytest.approx(0.1, rel=1e-12)


@pytest.mark.parametrize(
    ("layers", "words"),
    [
        (["bone:bone/cartilage=2,0.1,1"], r"the wall ends inside the mesh at \(2, .*add the other interfaces of bone"),
        (["bone:bone/cartilage=2,0.1,1", "bone:bone/muscle=2,0.1,1"], "the wall ends inside the mesh"),
        (["bone/cartilage=2,0.1,1"], "several materials: bone, cartilage.*--layers cartilage:bone/cartilage=2"),
        (["muscle:bone/cartilage=2,0.1,1"], "muscle is not a material beside this wall.*use bone or cartilage"),
        (["skin:bone/cartilage=2,0.1,1"], "skin is not a material"),
        (["bone:bone/skin=2,0.1,1"], "'skin' is not a material"),
        (["bone:wall=2,0.1,1"], "'wall' is not the name of a part"),
        (["bone-bone=2,0.1,1"], "the wall has no triangle"),
        (["bone:bone=4,1,1"], "4 layers are 4 mm thick, and bone has no room"),
    ],
)
def test_walls_that_cannot_have_layers_are_refused(layers: list[str], words: str) -> None:
    with pytest.raises(StageError, match=f"(?s){words}") as caught:
        refuse_layers(*materials(*layers, material=with_muscle)[1:])
    assert all((caught.value.what, caught.value.why, caught.value.next))


def test_a_wall_that_ends_on_a_smooth_boundary_is_refused() -> None:
    made = one_object(*block((6, 6, 4)), "spot=2,0.1,1", "ball:3,3,4,1.9=spot")
    with pytest.raises(StageError, match=r"no direction at .*, 4\) mm"):
        refuse_layers(*made[1:])


def test_walls_that_touch_are_refused() -> None:
    made = one_object(*block((6, 6, 4)), "top=2,0.1,1 x0=2,0.1,1", *ENDS, *SIDES_OF_BLOCK)
    with pytest.raises(StageError, match=r"--layers x0=2,0.1,1: it touches another wall .* at \(0, 0, 4\) mm"):
        refuse_layers(*made[1:])


def test_tetrahedra_that_lost_the_wall_are_refused() -> None:
    mesh, parts, _ = one_object(*block((6, 6, 4)), "top=2,0.1,1", *ENDS)
    lost = replace(mesh, owners=np.where(mesh.marks == 2, NOBODY, mesh.owners), marks=5 - mesh.marks)
    with pytest.raises(StageError, match="lost triangles of the wall"):
        add_layers(lost, parts.walls[0], tetrahedron_quality(mesh.points, mesh.tetrahedra), Limits())


def test_layers_that_fit_nowhere_are_refused_with_their_place() -> None:
    mesh, parts, _ = one_object(*block((6, 6, 4)), "top=2,0.1,1", *ENDS)
    inverted = mesh.elements.copy()
    on_top = np.flatnonzero((mesh.points[inverted, 2] == 4.0).sum(axis=1) == 3)[0]
    quality = tetrahedron_quality(mesh.points, mesh.tetrahedra)
    inverted[on_top] = inverted[on_top][[0, 2, 1, 3]]
    with pytest.raises(StageError, match=r"no layers fit at .* not even of 1 % of their thickness"):
        add_layers(replace(mesh, elements=inverted), parts.walls[0], quality, Limits())


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--layers", "bone:bone/cartilage=2,0,1"], "the ratio must be above 0 and finite"),
        (["--layers", "bone:bone/cartilage=2,0.1,-1"], "the ratio must be above 0 and finite"),
        (["--layers", "bone:bone/cartilage=2,0.1,0"], "the ratio must be above 0 and finite"),
        (["--layers", "bone:bone/cartilage=0,0.1,1"], "must be a whole number from 1 to 50"),
        (["--layers", "bone:bone/cartilage=2.5,0.1,1"], "must be a whole number from 1 to 50"),
        (["--layers", "bone:bone/cartilage=2,0.1"], "is not WALL=N,MM,RATIO"),
        (["--layers", "bone:bone/cartilage=2,inf,1"], "the ratio must be above 0 and finite"),
        (["--layers", ":bone/cartilage=2,0.1,1"], "is not WALL=N,MM,RATIO"),
        (["--layers", "bone:bone/=2,0.1,1"], "ends where a name is expected"),
        (["--layers", "skin:bone/cartilage=2,0.1,1"], "there is no material 'skin'"),
        (["--layers", "bone:wall=2,0.1,1"], "'wall' is not the name of a part"),
        (["--layers", "bone=2,0.1,1", "--order", "2", "--distfield", "f.vti"], "with --order 2"),
        (["--layers", "bone=2,0.1,1", "--split", "bone/cartilage"], "with --split or --gap"),
        (["--layers", "bone=2,0.1,1", "--export", "inp,carp"], "--export carp"),
        (["--layers", "bone=2,0.1,1", "--for", "simvascular"], "--for simvascular"),
        (["--layers", "bone=2,0.1,1", "--for", "fenicsx"], "with --for fenicsx"),
    ],
)
def test_wrong_options_are_refused_before_the_tetrahedra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str], words: list[str], told: str
) -> None:
    cells_of_a_block((4, 4, 4), plates, NAMES[:2]).save(tmp_path / "s.surface.vtp")
    monkeypatch.chdir(tmp_path)
    try:
        code = main(["s.surface.vtp", "-o", "s.volume.vtu", "--solve", "no", "-q", *words])
    except SystemExit as error:
        code = error.code
    errors = capfd.readouterr().err
    assert code == 2
    assert told in errors
    assert "why it matters" in errors
    assert "what to do" in errors
    assert [path.name for path in tmp_path.iterdir()] == ["s.surface.vtp"]


BENT_PIPE = """
import gmsh
import numpy as np
gmsh.initialize()
occ = gmsh.model.occ
bend = occ.addTorus(0, 0, 0, 12, 3, angle=np.pi / 2)
corner = 12 * np.sqrt(0.5)
occ.fuse([(3, bend)], [(3, occ.addCylinder(corner, corner, 0, 6, 6, 0, 2.2))])
occ.synchronize()
for bound in ("Min", "Max"):
    gmsh.option.setNumber(f"Mesh.MeshSize{bound}", 1.2)
gmsh.model.mesh.generate(2)
tags, at, _ = gmsh.model.mesh.getNodes()
triangles = gmsh.model.mesh.getElementsByType(2)[1]
used, corners = np.unique(triangles, return_inverse=True)
points = at.reshape(-1, 3)[np.argsort(tags)][np.searchsorted(np.sort(tags), used)]
np.savez("pipe.npz", points=points, triangles=corners.reshape(-1, 3))
"""
"""A pipe that bends by 90 degrees, with a branch: three planar ends."""
CAPS = {
    "inlet": ("plane:0,0.001,0,0,-1,0", [0.0, -1.0, 0.0], 0.0),
    "outlet": ("plane:0.001,0,0,-1,0,0", [-1.0, 0.0, 0.0], 0.0),
    "branch": ("plane:14.48,14.48,0,1,1,0", [0.5**0.5, 0.5**0.5, 0.0], 12.0 + 72.0**0.5),
}


@NEEDS_HXT
def test_a_bent_pipe_has_five_layers_and_three_flat_caps(tmp_path: Path, run: Run) -> None:
    subprocess.run([sys.executable, "-c", BENT_PIPE], cwd=tmp_path, check=True, capture_output=True)
    with np.load(tmp_path / "pipe.npz") as pipe:
        surface = to_polydata(pipe["points"], pipe["triangles"].astype(np.int64))
    surface.save(tmp_path / "p.vtp")
    tags = [word for name, (shape, *_) in CAPS.items() for word in ("--tag", f"{shape}={name}")]
    words = ["p.vtp", "-o", "p.volume.vtu", "--method", "hxt", "--report", "r.json", "--export", "vtp", "-q"]
    words += ["--set", "wall=object-inlet-outlet-branch", "--layers", "wall=5,0.05,1.2", "--pictures", "pictures"]
    done = run(*words, *tags, "--solve", "no")
    assert done.returncode == 0, done.stderr
    results = json.loads((tmp_path / "r.json").read_text())["results"]
    (row,) = results["layers"]["walls"]
    assert {one["verdict"] for one in results["checks"]} == {"pass"}
    assert row["minimum_share"] == 1.0
    assert row["first_height_mm"]["min"] == pytest.approx(0.05, rel=0.1)
    assert row["first_height_mm"]["percentiles"]["p5"] == pytest.approx(0.05, rel=0.02)
    assert row["first_height_mm"]["max"] == pytest.approx(0.05, rel=0.05)

    grid = pv.read(tmp_path / "p.volume.vtu")
    points, prisms = np.asarray(grid.points), np.asarray(grid.cells_dict[pv.CellType.WEDGE])
    assert (
        len(prisms)
        == row["prisms"]
        == 5 * next(part["triangles"] for part in results["boundary"]["parts"] if part["name"] == "surface")
    )
    assert jacobians(points, prisms).min() > 0.0
    assert np.asarray(grid.cell_quality("jacobian")["jacobian"])[grid.celltypes == pv.CellType.WEDGE].min() > 0.0
    assert grid.compute_cell_sizes()["Volume"].sum() == pytest.approx(surface.volume, rel=1e-12)
    np.testing.assert_allclose(results["layers"]["volume"]["with_mm3"], surface.volume, rtol=1e-12)
    # the first height, measured by VTK
    first = np.unique(prisms[: len(prisms) // 5, :3])
    skin = pv.read(tmp_path / "p.boundary.vtp")
    wall = skin.extract_cells(skin.cell_data["wall"] == 1).extract_surface(algorithm="dataset_surface")
    away = np.abs(pv.PolyData(points[first]).compute_implicit_distance(wall)["implicit_distance"])
    # where the branch begins, a node cannot have the exact distance from all adjacent triangles
    assert away.min() > 0.94 * 0.05
    assert (np.abs(away / 0.05 - 1.0) < 0.02).mean() > 0.9
    names = {name: int(mark) for mark, name in json.loads(text_of(skin, "parts") or "").items()}
    for name, (_, normal, offset) in CAPS.items():
        cap = skin.extract_cells(skin.cell_data["mark"] == names[name])
        np.testing.assert_allclose(np.asarray(cap.points) @ normal, offset, atol=1e-9)
        assert set(cap.celltypes) == {pv.CellType.TRIANGLE, pv.CellType.QUAD}
    assert len(list((tmp_path / "pictures").iterdir())) == len(results["pictures"]["drawn"])

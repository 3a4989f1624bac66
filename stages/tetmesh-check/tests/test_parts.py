"""Tests of parts, tags and sets: exact areas, normals and members, and refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import isoparticles as iso
import numpy as np
import pytest
import pyvista as pv
from complexes import Made, cells_of_a_block
from conftest import NEEDS_HXT, Run, ball
from test_solve import block

from tetmesh_check.datasets import add_text, from_polydata
from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import object_mesh
from tetmesh_check.fields import read_sizing_field
from tetmesh_check.materials import Planes, Sides, read_planes
from tetmesh_check.parts.algebra import read_definition, read_definitions, read_expression
from tetmesh_check.parts.caps import Border, border_of
from tetmesh_check.parts.find import find_parts
from tetmesh_check.parts.measure import describe_parts
from tetmesh_check.parts.model import Parts
from tetmesh_check.parts.names import check_early
from tetmesh_check.parts.tags import read_tag
from tetmesh_check.surface import Surface, read_surface
from tetmesh_check.topology import tetrahedron_boundary

SIZE = np.array([4.0, 3.0, 5.0])
"""The block of :func:`two_halves`, mm."""
FAR = 100.0
"""Position of a face of the volume that does not cut the block."""
CUT = Border(np.eye(3), np.array([0.0, FAR, -FAR, FAR, -FAR, SIZE[2]]), np.ones(3))
"""The faces x0 and z1 of the volume cut the block."""
TURN = np.array([[0.8, 0.6, 0.0], [-0.48, 0.64, 0.6], [0.36, -0.48, 0.8]])
"""A rotation matrix."""


def surface_of(made: Made) -> Surface:
    table = [{"name": name, "labels": []} for name in ("outside", *made.names)]
    return Surface(made.points, made.triangles, None, 0, None, Sides(made.inside, made.outside, table))


def two_halves(names: tuple[str, str] = ("blood", "wall")) -> Surface:
    """A block of two materials: the first for z < 2, the second above."""
    return surface_of(cells_of_a_block((4, 3, 5), lambda x, y, z: np.where(z < 2.0, 1, 2), names))  # noqa: ARG005


def legs() -> Surface:
    """Return a comb with two legs, 1 and 2 mm wide, that end at x = 0."""
    made = cells_of_a_block((3, 5, 2), lambda x, y, z: np.where((x > 1) | (y < 1) | (y > 3), 1, 0), ("comb",))  # noqa: ARG005
    return surface_of(made)


def ended(surface: Surface, *names: str) -> Surface:
    """Return the surface with the planes x = 0 (number 0), z = 5 (1) and z = -50 (2)."""
    x, _, z = np.moveaxis(surface.points[surface.triangles], 2, 0)
    numbers = np.where((x == 0.0).all(axis=1), 0, np.where((z == SIZE[2]).all(axis=1), 1, -1))
    return replace(surface, planes=Planes(numbers, list(names)))


def block_surface(flag: float | None = 0.0) -> Surface:
    """The same block as one object; triangles at x = ``flag`` have the flag of a cap."""
    points, cells = block((4, 3, 5))
    triangles = tetrahedron_boundary(cells).triangles
    caps = None if flag is None else (points[triangles][..., 0] == flag).all(axis=1)
    return Surface(points, triangles, None, 0, caps)


def areas_of(surface: Surface, parts: Parts) -> dict[str, float]:
    corners = surface.points[surface.triangles]
    areas = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return {row.name: float(areas[parts.marks == row.number].sum()) for row in parts.rows}


def members(parts: Parts, name: str) -> list[str]:
    union = next(union for union in parts.unions if union.name == name)
    return [row.name for row in parts.rows if row.number in union.members]


def described(surface: Surface, parts: Parts, space: str | None = None) -> dict[str, dict[str, object]]:
    """Return the report of the parts of one object, by name."""
    points, cells = block((4, 3, 5))
    outside = tetrahedron_boundary(cells)
    mesh = object_mesh(
        points, cells, np.ones(len(cells), np.int64), outside, parts.on(surface, points, outside.triangles)
    )
    found = describe_parts(parts, replace(mesh, space=space))
    return {row["name"]: row for row in (*found["parts"], *found["sets"])}


def test_each_material_has_caps_of_exact_area() -> None:
    surface = two_halves()
    parts = find_parts(surface, CUT)
    assert areas_of(surface, parts) == pytest.approx({
        "blood_to_outside": 4 * 3 + 2 * 4 * 2 + 3 * 2,
        "wall_to_outside": 2 * 4 * 3 + 3 * 3,
        "wall_to_blood": 4 * 3,
        "blood_cap_x0_1": 3 * 2,
        "wall_cap_x0_1": 3 * 3,
        "wall_cap_z1_1": 4 * 3,
    })  # fmt: skip
    kinds = {row.name: row.kind for row in parts.rows}
    assert kinds["wall_to_blood"] == "interface"
    assert kinds["blood_to_outside"] == "skin"
    assert kinds["wall_cap_z1_1"] == "cap"
    # every triangle belongs to exactly one part
    assert set(parts.marks.tolist()) == {row.number for row in parts.rows}


def test_caps_are_found_on_a_turned_volume() -> None:
    surface = two_halves()
    turned = replace(surface, points=surface.points @ TURN + [5.0, -7.0, 11.0])
    border = Border(TURN, CUT.positions + np.repeat(TURN @ [5.0, -7.0, 11.0], 2), CUT.spacing)
    np.testing.assert_array_equal(find_parts(turned, border).marks, find_parts(surface, CUT).marks)


def test_separate_caps_of_one_side_are_numbered_by_area() -> None:
    border = CUT._replace(positions=np.array([0.0, FAR, -FAR, FAR, -FAR, FAR]))
    surface = legs()
    found = areas_of(surface, find_parts(surface, border))
    assert (found["comb_cap_x0_1"], found["comb_cap_x0_2"]) == pytest.approx((4.0, 2.0))


def test_planes_make_caps_of_exact_area_with_their_names() -> None:
    surface = ended(two_halves(), "inlet", "x0", "below")
    # caps come from the planes, not from the faces of the volume
    for border in (None, CUT):
        parts = find_parts(surface, border)
        assert areas_of(surface, parts) == pytest.approx({
            "blood_to_outside": 4 * 3 + 2 * 4 * 2 + 3 * 2,
            "wall_to_outside": 2 * 4 * 3 + 3 * 3,
            "wall_to_blood": 4 * 3,
            "blood_cap_inlet_1": 3 * 2,
            "wall_cap_inlet_1": 3 * 3,
            "wall_cap_x0_1": 4 * 3,
        })  # fmt: skip
        assert {row.name for row in parts.rows if row.kind == "cap"} == {
            "blood_cap_inlet_1", "wall_cap_inlet_1", "wall_cap_x0_1"
        }  # fmt: skip


def test_separate_caps_of_one_plane_are_numbered_by_area() -> None:
    surface = ended(legs(), "inlet", "x0")
    found = areas_of(surface, find_parts(surface))
    assert (found["comb_cap_inlet_1"], found["comb_cap_inlet_2"]) == pytest.approx((4.0, 2.0))
    assert set(found) == {"comb_to_outside", "comb_cap_inlet_1", "comb_cap_inlet_2"}


def test_oblique_triangles_of_a_plane_belong_to_its_cap() -> None:
    # with planes, the number of a triangle decides, not its angle and position
    surface = ended(two_halves(), "inlet", "x0")
    turned = replace(surface, points=surface.points @ TURN)
    np.testing.assert_array_equal(find_parts(turned, CUT).marks, find_parts(surface).marks)


def test_sets_contain_the_caps_of_planes() -> None:
    lines = ["ends = caps & wall/outside", "skin = blood/outside - caps", "top = wall_cap_x0_1", "closed = wall"]
    parts = find_parts(ended(two_halves(), "inlet", "x0"), CUT, (), list(map(read_definition, lines)))
    assert members(parts, "ends") == ["wall_cap_inlet_1", "wall_cap_x0_1"]
    assert members(parts, "skin") == ["blood_to_outside"]
    assert members(parts, "top") == ["wall_cap_x0_1"]
    assert members(parts, "closed") == ["wall_to_outside", "wall_to_blood", "wall_cap_inlet_1", "wall_cap_x0_1"]


def test_names_of_planes_are_plain_in_parts() -> None:
    parts = find_parts(ended(two_halves(), "pulmonary artery", "2"))
    assert [row.name for row in parts.rows if row.is_cap] == [
        "blood_cap_pulmonary_artery_1", "wall_cap_pulmonary_artery_1", "wall_cap_2_1"
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("meta", "names"),
    [
        ('{"caps": ["inlet", "x0", "x1"]}', ["inlet", "x0", "x1"]),
        ('{"caps": ["inlet"]}', ["inlet", "2"]),
        ('{"version": 1}', ["1", "2"]),
        ('{"caps": 5}', ["1", "2"]),
        ("[]", ["1", "2"]),
        ("not JSON", ["1", "2"]),
        (None, ["1", "2"]),
    ],
)
def test_planes_without_a_name_are_named_by_their_number(meta: str | None, names: list[str]) -> None:
    surface = pv.Triangle() + pv.Triangle() + pv.Triangle()
    assert read_planes(surface) is None
    surface.cell_data["cap"] = np.array([0, 2, 1], dtype=np.uint16)
    if meta is not None:
        add_text(surface, "meta", meta)
    planes = read_planes(surface)
    assert planes is not None
    assert planes.names == names
    np.testing.assert_array_equal(planes.of_triangles, [-1, 1, 0])


def test_planes_are_read_with_the_triangles_that_remain(tmp_path: Path) -> None:
    made = cells_of_a_block((4, 3, 5), lambda x, y, z: np.where(z < 2.0, 1, 2), ("blood", "wall"))  # noqa: ARG005
    numbers = (made.points[made.triangles][..., 0] == 0.0).all(axis=1).astype(np.int64)
    # vertex 0 twice, and a triangle of no area between both
    sliver = [[made.triangles[0, 0], len(made.points), made.triangles[0, 1]]]
    doubled = replace(
        made,
        points=np.vstack([made.points, made.points[made.triangles[0, 0]]]),
        triangles=np.vstack([sliver, made.triangles]),
        inside=np.append(1, made.inside),
        outside=np.append(0, made.outside),
    )
    surface = read_surface(doubled.save(tmp_path / "s.vtp", cap=np.append(1, numbers)))
    assert surface.planes is not None
    assert surface.cap is None
    np.testing.assert_array_equal(surface.planes.of_triangles, numbers - 1)
    found = areas_of(surface, find_parts(surface))
    assert (found["blood_cap_1_1"], found["wall_cap_1_1"]) == pytest.approx((6.0, 9.0))


def test_the_flags_of_one_object_are_no_planes(tmp_path: Path) -> None:
    own = block_surface()
    assert own.cap is not None
    file = pv.PolyData.from_regular_faces(own.points, own.triangles)
    file.cell_data["cap"] = own.cap.astype(np.uint8)
    file.save(tmp_path / "s.vtp")
    surface = read_surface(tmp_path / "s.vtp")
    assert surface.planes is None
    np.testing.assert_array_equal(surface.cap, own.cap)
    assert [row.name for row in find_parts(surface, CUT).rows] == ["surface", "cap_x0_1"]


def test_centres_and_normals_of_the_parts_of_one_object() -> None:
    surface = block_surface()
    parts = find_parts(surface, CUT._replace(positions=np.array([0.0, FAR, -FAR, FAR, -FAR, FAR])))
    found = described(surface, parts)
    cap = found["cap_x0_1"]
    assert (cap["kind"], cap["between"]) == ("cap", ["object", "outside"])
    assert cap["area_mm2"] == pytest.approx(15.0)
    np.testing.assert_allclose(cap["centre_mm"], [0.0, 1.5, 2.5])  # type: ignore[arg-type]
    np.testing.assert_allclose(cap["normal"], [-1.0, 0.0, 0.0], atol=1e-12)  # type: ignore[arg-type]
    np.testing.assert_allclose(found["surface"]["normal"], [1.0, 0.0, 0.0], atol=1e-12)  # type: ignore[arg-type]
    shown = described(surface, parts, "ras")["cap_x0_1"]
    np.testing.assert_allclose(shown["normal"], [1.0, 0.0, 0.0], atol=1e-12)  # type: ignore[arg-type]
    np.testing.assert_allclose(shown["centre_mm"], [0.0, -1.5, 2.5])  # type: ignore[arg-type]


def test_a_closed_set_has_no_normal() -> None:
    surface = block_surface()
    found = described(surface, find_parts(surface, CUT, (), [read_definition("whole = *")]))
    assert found["whole"]["normal"] is None
    assert found["whole"]["area_mm2"] == pytest.approx(2 * (12 + 15 + 20))


def test_a_flat_side_without_flags_is_no_cap() -> None:
    # distfield crops one object without room, so its flat sides may lie on faces of the grid
    assert [row.name for row in find_parts(block_surface(FAR), CUT).rows] == ["surface"]
    assert [row.name for row in find_parts(block_surface(None), CUT).rows] == ["surface"]
    assert [row.name for row in find_parts(block_surface(), CUT).rows] == ["surface", "cap_x0_1"]


def test_half_a_ball_has_a_cap_of_its_circle() -> None:
    half = pv.Sphere(radius=10.0, theta_resolution=60, phi_resolution=30).clip_closed_surface("z", origin=(0, 0, 0.01))
    points, triangles = from_polydata(half.triangulate())
    flags = (np.abs(points[triangles][..., 2] - 0.01) < 1e-6).all(axis=1)
    surface = Surface(points, triangles, None, 0, flags)
    found = areas_of(surface, find_parts(surface, CUT._replace(positions=np.array([-FAR, FAR, -FAR, FAR, 0.01, FAR]))))
    # a regular polygon of 60 corners in a circle of radius 10
    assert found["cap_z0_1"] == pytest.approx(0.5 * 60 * 100 * np.sin(2 * np.pi / 60), rel=5e-3)


def test_faces_of_the_volume_come_from_the_size_field(tmp_path: Path) -> None:
    grid = pv.ImageData(dimensions=(20, 30, 40), spacing=(1.0, 2.0, 3.0), origin=(5.0, 6.0, 7.0))
    grid.direction_matrix = TURN.T
    grid["sizing"] = np.ones(grid.n_points, dtype=np.float32)
    made = {"tool": "distfield", "parameters": {"margin": 5, "border": "cap"}, "inputs": []}
    add_text(grid, "history", json.dumps({"tool": "sizefield", "inputs": [{"history": made}]}))
    grid.save(tmp_path / "s.vti")
    *_, border = read_sizing_field(tmp_path / "s.vti")
    assert border is not None
    # half a voxel before the first voxel, and half a voxel behind the last one
    ends = np.array([[4.5, 14.5], [4.5, 24.5], [4.5, 34.5]]) * [[1.0], [2.0], [3.0]]
    np.testing.assert_allclose(border.positions.reshape(3, 2), ends + (TURN @ [5.0, 6.0, 7.0])[:, None])
    assert border_of(grid, {"tool": "distfield", "parameters": {"margin": 5, "border": "open"}}) is None
    assert border_of(grid, None) is None


def test_caps_of_a_meshed_tube_have_its_area(tmp_path: Path) -> None:
    x, y, _ = np.meshgrid(*[np.arange(n) for n in (24, 24, 16)], indexing="ij")
    radius = np.hypot(x - 11.5, y - 11.5)
    labels = np.where(radius < 5.0, 1, np.where(radius < 9.0, 2, 0)).astype(np.uint8)
    field = iso.distance_field(labels, materials={"lumen": 1, "wall": 2}, scale=0.0)
    h = iso.size_field(field, uniform=1.5)
    settled = iso.settle(iso.seed(field, h), field, h, backend="cpu")
    h.save(tmp_path / "h.vti")
    iso.reconstruct(settled, field, h).save(tmp_path / "s.vtp")
    *_, border = read_sizing_field(tmp_path / "h.vti")
    surface = read_surface(tmp_path / "s.vtp")
    found = areas_of(surface, find_parts(surface, border))
    voxels = {name: float((labels[..., 0] == label).sum()) for label, name in ((1, "lumen"), (2, "wall"))}
    for name, area in voxels.items():
        for side in ("z0", "z1"):
            assert found[f"{name}_cap_{side}_1"] == pytest.approx(area, rel=0.06)


def test_parts_survive_a_moved_boundary() -> None:
    surface = two_halves()
    one = replace(surface, sides=None, triangles=surface.triangles[surface.sides.outside == 0])  # type: ignore[union-attr]
    parts = find_parts(one, None, [read_tag("ball:2,1.5,0,1.2=spot"), read_tag("plane:0,0,3,0,0,1=top")])
    np.testing.assert_array_equal(parts.on(one, one.points, one.triangles[::-1]), parts.marks[::-1])
    moved = parts.on(one, one.points + 1e-6, one.triangles)
    np.testing.assert_array_equal(moved, parts.marks)


def values(text: str) -> set[int]:
    """Evaluate an expression over some sets of numbers."""
    known = {("a",): {1, 2}, ("b",): {2, 3}, ("c",): {3}, ("a", "b"): {7}, ("*",): {1, 2, 3, 7}, ("left ear",): {9}}
    return set(read_expression(text).evaluate(lambda operand: frozenset(known[operand])))


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a", {1, 2}),
        ("a+c", {1, 2, 3}),
        ("a - b", {1}),
        ("a - b + c", {1, 3}),
        ("a - (b + c)", {1}),
        ("a + b & c", {1, 2, 3}),
        ("(a + b) & c", {3}),
        ("* - a/b", {1, 2, 3}),
        ("a/b+c", {3, 7}),
        ("'left ear' + \"c\"", {3, 9}),
    ],
)
def test_expressions_have_the_usual_precedence(text: str, expected: set[int]) -> None:
    assert values(text) == expected


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("a", "is not NAME = EXPRESSION"),
        ("1a = b", "'1a' is not a name"),
        ("a b = c", "'a b' is not a name"),
        ("s = ", "ends where a name is expected"),
        ("s = a +", "ends where a name is expected"),
        ("s = a / (b)", "'(' stands where a name is expected"),
        ("s = (a", "a parenthesis is not closed"),
        ("s = a b", "'b' stands where + - or & is expected"),
        ("s = a | b", "'|' is not part of an expression"),
    ],
)
def test_malformed_sets_are_refused(line: str, told: str, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=told.replace("(", r"\(").replace("+", r"\+").replace("|", r"\|")):
        read_definition(line)
    (tmp_path / "sets.txt").write_text(f"# sets\n\n{line} # a comment\n")
    with pytest.raises(StageError, match=r"sets\.txt, line 3"):
        read_definitions(tmp_path / "sets.txt")


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("ball:1,2,3,4", "is not ball"),
        ("cube:1,2,3,4=a", "is not ball"),
        ("ball:1,2,3=a", "needs the numbers X,Y,Z,RADIUS"),
        ("ball:1,2,3,nan=a", "needs the numbers"),
        ("ball:1,2,3,0=a", "the radius must be above 0"),
        ("plane:0,0,0,0,0,0=a", "the normal must not be 0,0,0"),
        ("ball:1,2,3,4=a-b", "'a-b' is not a name"),
        ("ball:1,2,3,4 & =a", "ends where a name is expected"),
    ],
)
def test_malformed_tags_are_refused(text: str, told: str) -> None:
    with pytest.raises(ValueError, match=told):
        read_tag(text)


def test_sets_of_materials_interfaces_and_caps() -> None:
    lines = [
        "endo = wall/blood", "epi = wall/outside - caps", "inlets = caps & blood", "skin_of_all = outside - caps",
        "of_wall = wall", "both = endo + inlets", "rest = * - of_wall",
    ]  # fmt: skip
    parts = find_parts(two_halves(), CUT, (), list(map(read_definition, lines)))
    assert members(parts, "endo") == ["wall_to_blood"]
    assert members(parts, "epi") == ["wall_to_outside"]
    assert members(parts, "inlets") == ["blood_cap_x0_1"]
    assert members(parts, "skin_of_all") == ["blood_to_outside", "wall_to_outside"]
    assert members(parts, "of_wall") == ["wall_to_outside", "wall_to_blood", "wall_cap_x0_1", "wall_cap_z1_1"]
    assert members(parts, "both") == ["wall_to_blood", "blood_cap_x0_1"]
    assert members(parts, "rest") == ["blood_to_outside", "blood_cap_x0_1"]


def test_materials_with_blanks_are_quoted_or_plain() -> None:
    lines = ["e = 'left ear'/head", "f = left_ear/head"]
    parts = find_parts(two_halves(("left ear", "head")), None, (), list(map(read_definition, lines)))
    assert members(parts, "e") == members(parts, "f") == ["head_to_left_ear"]


def test_a_tag_of_one_part_gives_it_its_name() -> None:
    surface = two_halves()
    # half of the side z = 0 and nothing else
    parts = find_parts(surface, None, [read_tag("ball:0,1.5,-100,100.02=spot")])
    assert [(row.name, row.kind) for row in parts.rows if row.tags] == [("spot", "tag")]
    assert parts.unions == []
    tagged = surface.points[surface.triangles[parts.marks == parts.rows[-1].number]]
    assert (tagged[..., 2] == 0.0).all()
    everything = find_parts(surface, None, [read_tag("ball:0,1.5,-100,100.02=spot")], [read_definition("s = spot")])
    assert members(everything, "s") == ["spot"]


def test_a_tag_across_parts_is_a_set_of_pieces() -> None:
    parts = find_parts(two_halves(), CUT, [read_tag("plane:0,0,4,0,0,1=top")])
    assert members(parts, "top") == ["wall_cap_z1_1", "top_on_wall_to_outside", "top_on_wall_cap_x0_1"]
    surface = two_halves()
    found = areas_of(surface, parts)
    assert found["top_on_wall_cap_x0_1"] == pytest.approx(3.0)
    assert found["top_on_wall_to_outside"] == pytest.approx(4 + 4 + 3)
    # caps and interfaces contain the triangles of tags
    more = find_parts(surface, CUT, [read_tag("plane:0,0,4,0,0,1=top")], [read_definition("c = caps & top")])
    assert members(more, "c") == ["wall_cap_z1_1", "top_on_wall_cap_x0_1"]


def test_pieces_do_not_take_the_name_of_another_tag() -> None:
    name = "top_on_wall_to_outside"
    tags = [read_tag("plane:0,0,4,0,0,1=top"), read_tag(f"plane:0,0,1,0,0,-1={name}")]
    parts = find_parts(two_halves(), CUT, tags)
    assert members(parts, "top") == ["wall_cap_z1_1", f"{name}_2", "top_on_wall_cap_x0_1"]
    assert not set(members(parts, "top")) & set(members(parts, name))


def test_tags_apply_to_interfaces_on_request() -> None:
    surface, line = two_halves(), "plane:2,0,0,1,0,0 & wall/blood = half"
    parts = find_parts(surface, None, [read_tag(line)])
    assert areas_of(surface, parts)["half"] == pytest.approx(6.0)
    assert areas_of(surface, parts)["wall_to_blood"] == pytest.approx(6.0)


def test_tags_may_overlap() -> None:
    surface = block_surface(None)
    tags = [read_tag("plane:0,0,3,0,0,1=top"), read_tag("plane:2,0,0,1,0,0=right")]
    parts = find_parts(surface, None, tags)
    found = areas_of(surface, parts)
    assert sum(found.values()) == pytest.approx(2 * (12 + 15 + 20))
    area = {name: sum(found[part] for part in members(parts, name)) for name in ("top", "right")}
    assert area == pytest.approx({"top": 12 + 2 * 2 * (4 + 3), "right": 15 + 2 * 2 * (3 + 5)})
    assert "top_right_on_surface" in found


@pytest.mark.parametrize(
    ("tags", "sets", "told"),
    [
        ([], ["s = walls/blood"], "'walls' is not a material"),
        ([], ["s = lv"], "'lv' is not the name of a part"),
        ([], ["s = blood/blood"], "'blood/blood' is not an interface"),
        ([], ["s = t", "t = caps"], "'t' is not the name of a part"),
        ([], ["s = caps & wall/blood"], "set 's = caps & wall/blood' is empty"),
        ([], ["wall = caps"], "the name 'wall' of a set is already taken"),
        ([], ["Wall_to_Blood = caps"], "is already taken"),
        ([], ["caps = wall"], "is already taken"),
        ([], ["region_1 = wall"], "is already taken"),
        ([], ["s = caps", "S = wall"], "is already taken"),
        (["ball:1,1,0,1=s"], ["s = caps"], "is already taken"),
        (["ball:1,1,0,1=blood_cap_x0_1"], [], "the name 'blood_cap_x0_1' of a tag is already taken"),
        (["ball:50,1,0,1=s"], [], "meets no triangle"),
        (["ball:2,1,0,1 & wall/blood=s"], [], "meets no triangle"),
        (["ball:2,1,0,1 & foo=s"], [], "'foo' is not the name of a part"),
    ],
)
def test_wrong_names_are_refused(tags: list[str], sets: list[str], told: str) -> None:
    with pytest.raises(StageError) as caught:
        find_parts(two_halves(), CUT, list(map(read_tag, tags)), list(map(read_definition, sets)))
    assert told in caught.value.what
    assert caught.value.why
    assert caught.value.next


def test_wrong_sets_are_refused_before_the_tetrahedra(tmp_path: Path, run: Run) -> None:
    ball(9.0, 2).save(tmp_path / "s.vtp")
    words = ["s.vtp", "-o", "v.volume.vtu", "-q"]
    for more, told in (
        (["--set", "inlet = caps"], "set 'inlet = caps' is empty"),
        (["--set", "inlet"], "'inlet' is not NAME = EXPRESSION"),
        (["--set", "top = *", "--for", "simnibs"], "--set, --sets, --split or --gap with --for simnibs"),
    ):
        done = run(*words, *more)
        assert done.returncode == 2
        assert told in done.stderr
        assert "what to do" in done.stderr
        assert [path.name for path in tmp_path.iterdir()] == ["s.vtp"]


@pytest.mark.parametrize(
    ("materials", "given", "told"),
    [
        (["outside", "lv", "wall"], "endo=lv/walls", "'walls' is not a material"),
        (["outside", "lv", "wall"], "lv=caps", "is already taken"),
        ([], "endo=lv/wall", "'lv' is not a material"),
    ],
)
def test_sets_are_checked_before_there_is_a_surface(materials: list[str], given: str, told: str) -> None:
    with pytest.raises(StageError, match=told):
        check_early([], [read_definition(given)], materials)


def test_names_of_parts_are_accepted_before_there_is_a_surface(run: Run) -> None:
    check_early([], [read_definition("endo=lv/wall")], None)
    known = json.dumps({"materials": ["outside", "lv", "wall"], "volume": True})
    words = ["s.vtp", "-o", "s.volume.vtu", "--set", "rim = wall/outside - lv_cap_x0_1 + wall/walls"]
    checked = run("--check-options", known, *words)
    assert checked.returncode == 2
    assert "'walls' is not a material" in checked.stderr


@NEEDS_HXT
def test_the_report_and_the_history_name_parts_and_sets(tmp_path: Path, run: Run) -> None:
    ball(9.0, 3).save(tmp_path / "s.vtp")
    (tmp_path / "sets.txt").write_text("lower = object - upper  # the rest\n")
    words = ["--tag", "plane:0,0,0,0,0,1=upper", "--sets", "sets.txt", "--set", "all_of_it = lower + upper"]
    more = ["--method", "hxt", "--solve", "no", "-q", "--report", "r.json"]
    done = run("s.vtp", "-o", "v.volume.vtu", *words, *more)
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    parts = {row["name"]: row for row in report["results"]["boundary"]["parts"]}
    whole = sum(row["area_mm2"] for row in parts.values())
    assert whole == pytest.approx(4 * np.pi * 81, rel=0.02)
    assert parts["upper"]["area_mm2"] == pytest.approx(0.5 * whole, rel=0.03)
    np.testing.assert_allclose(parts["upper"]["normal"], [0.0, 0.0, 1.0], atol=0.02)
    sets = {row["name"]: row["parts"] for row in report["results"]["boundary"]["sets"]}
    assert sets == {"lower": ["surface"], "all_of_it": ["surface", "upper"]}
    assert report["parameters"]["tags"] == {"upper": "plane:0,0,0,0,0,1"}
    assert report["parameters"]["sets"]["lower"] == "object - upper"

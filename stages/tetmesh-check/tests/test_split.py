"""Tests of split interfaces: their nodes, their parts, their contact pairs, and refusals."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import meshio
import numpy as np
import pytest
from complexes import between, cells_of_a_block
from conftest import NEEDS_HXT, Run, quiet_context, write_sizing
from febio import owner_of, read_febio
from isoparticles._native import surface_topology
from test_solve import block

from tetmesh_check.errors import StageError
from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.fem.solve import VolumeMesh
from tetmesh_check.materials import NOBODY, Sides, conform
from tetmesh_check.measures import mark, separate
from tetmesh_check.parts.algebra import read_definition
from tetmesh_check.parts.find import find_parts
from tetmesh_check.parts.model import Parts
from tetmesh_check.parts.names import check_early
from tetmesh_check.parts.splits import Split, read_gap, read_split
from tetmesh_check.parts.tags import read_tag
from tetmesh_check.quality import Points, signed_tetrahedron_volumes, triangle_quality
from tetmesh_check.split import split
from tetmesh_check.surface import Surface
from tetmesh_check.topology import tetrahedron_boundary

Material = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
NAMES = ("bone", "cartilage", "muscle")
EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Corners beside the nodes 4 to 9 of a quadratic tetrahedron."""


def plates(_x: np.ndarray, _y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """Two plates: bone for z < 2, cartilage above."""
    return np.where(z < 2, 1, 2)


def with_muscle(x: np.ndarray, _y: np.ndarray, z: np.ndarray) -> np.ndarray:
    """The same plates for x > 2, and muscle beside both."""
    return np.where(x < 2, 3, np.where(z < 2, 1, 2))


def surface_and_mesh(
    material: Material, counts: tuple[int, int, int] = (6, 6, 4), warp: Callable[[Points], Points] = lambda at: at
) -> tuple[Surface, VolumeMesh]:
    """Return a block of 1 mm tetrahedra, moved by ``warp``, and the interfaces of its materials."""
    points, cells = block(counts)
    regions = np.asarray(material(*(np.floor(points[cells].mean(axis=1)) + 0.5).T))
    made = between(points, cells, regions, NAMES)
    number = {tuple(at): index for index, at in enumerate(points.tolist())}
    triangles = np.array([number[tuple(at)] for at in made.points.tolist()])[made.triangles]
    table = [{"name": name} for name in ("outside", *NAMES)]
    points = warp(points)
    surface = Surface(points, triangles, None, 0, None, Sides(made.inside, made.outside, table))
    volumes = signed_tetrahedron_volumes(points, cells)
    return surface, VolumeMesh(points, cells, volumes, tetrahedron_boundary(cells))


def joined(
    material: Material, *splits: Split, warp: Callable[[Points], Points] = lambda at: at, **more: list
) -> tuple[MarkedMesh, Parts, Surface]:
    """Return a block that is not split yet, and its parts."""
    surface, mesh = surface_and_mesh(material, warp=warp)
    assert surface.sides is not None
    found = conform(len(mesh.points), mesh.tetrahedra, surface.triangles, surface.sides)
    parts = find_parts(surface, None, more.get("tags", []), more.get("sets", []), splits, more.get("layers", []))
    return mark(surface, mesh, found, parts, None, quiet_context()), parts, surface


def corners_of(mesh: MarkedMesh, name: str) -> np.ndarray:
    """Return the corners of the triangles of a part or set."""
    (own,) = (own for own in mesh.named_sets if own.name == name)
    return mesh.boundary[own.members]


def test_two_plates_come_apart() -> None:
    mesh, parts, _ = joined(plates, read_split("bone/cartilage"))
    apart = split(mesh, parts)
    np.testing.assert_array_equal(apart.points[apart.elements], mesh.points[mesh.elements])
    np.testing.assert_array_equal(apart.points[: len(mesh.points)], mesh.points)
    assert len(apart.points) == len(mesh.points) + 7 * 7
    assert tetrahedron_boundary(apart.tetrahedra).bodies.max() == 1
    bone, cartilage = (corners_of(apart, name) for name in ("bone_to_cartilage", "cartilage_to_bone"))
    assert not np.intersect1d(bone, cartilage).size
    for corners, region, up in ((bone, 1, 1.0), (cartilage, 2, -1.0)):
        assert np.isin(corners, apart.elements[apart.regions == region]).all()
        assert triangle_quality(apart.points, corners).area.sum() == pytest.approx(36.0)
        at = apart.points[corners]
        np.testing.assert_array_equal(np.sign(np.cross(at[:, 1] - at[:, 0], at[:, 2] - at[:, 0])[:, 2]), up)
        own = np.unique(corners)
        np.testing.assert_array_equal(apart.points[own][:, 2], 2.0)
    for region in (1, 2):
        # each plate is a ball
        skin = tetrahedron_boundary(apart.tetrahedra[apart.regions == region]).triangles
        assert surface_topology(len(apart.points), skin)["euler_characteristic"] == 2


def test_every_triangle_is_a_face_of_its_owner() -> None:
    mesh, parts, _ = joined(with_muscle, read_split("bone/cartilage"), read_split("bone/muscle"))
    apart = split(mesh, parts)
    owned = np.sort(apart.tetrahedra[apart.owners], axis=1)
    for corners, nodes in zip(apart.boundary.tolist(), owned.tolist(), strict=True):
        assert set(corners) < set(nodes)
    skin = tetrahedron_boundary(apart.tetrahedra).triangles
    np.testing.assert_array_equal(
        np.unique(np.sort(skin, axis=1), axis=0), np.unique(np.sort(apart.boundary[apart.outermost], axis=1), axis=0)
    )


def test_nodes_that_a_third_material_holds_stay_shared() -> None:
    mesh, parts, _ = joined(with_muscle, read_split("bone/cartilage"))
    apart = split(mesh, parts)
    bone, cartilage = (corners_of(apart, name) for name in ("bone_to_cartilage", "cartilage_to_bone"))
    shared = np.intersect1d(bone, cartilage)
    np.testing.assert_array_equal(apart.points[shared][:, 0], 2.0)
    assert len(shared) == 7
    assert len(apart.points) == len(mesh.points) + 4 * 7
    assert tetrahedron_boundary(apart.tetrahedra).bodies.max() == 0


def test_all_interfaces_of_three_materials_can_be_split() -> None:
    mesh, parts, _ = joined(with_muscle, *map(read_split, ("bone/cartilage", "muscle/bone", "cartilage/muscle")))
    apart = split(mesh, parts)
    assert tetrahedron_boundary(apart.tetrahedra).bodies.max() == 2
    nodes = [np.unique(apart.elements[apart.regions == region]) for region in (1, 2, 3)]
    assert sum(map(len, nodes)) == len(apart.points)


def test_nodes_on_edges_are_doubled_too() -> None:
    mesh, parts, _ = joined(with_muscle, read_split("bone/cartilage"))

    def nodes(cells: np.ndarray, edges: tuple[tuple[int, int], ...]) -> np.ndarray:
        return np.stack([np.sort(cells[:, list(edge)], axis=1) for edge in edges], 1)

    every = nodes(mesh.elements, EDGES)
    unique, which = np.unique(every.reshape(-1, 2), axis=0, return_inverse=True)
    number = {tuple(edge): len(mesh.points) + k for k, edge in enumerate(unique.tolist())}
    middles = [[number[tuple(edge)] for edge in row] for row in nodes(mesh.faces, ((0, 1), (1, 2), (0, 2))).tolist()]
    curved = replace(
        mesh,
        points=np.concatenate([mesh.points, mesh.points[unique].mean(axis=1)]),
        elements=np.column_stack([mesh.elements, len(mesh.points) + which.reshape(-1, 6)]),
        faces=np.column_stack([mesh.faces, np.array(middles)]),
    )
    apart, straight = split(curved, parts), split(mesh, parts)
    np.testing.assert_array_equal(apart.points[apart.elements], curved.points[curved.elements])
    for cells, edges in ((apart.elements, EDGES), (apart.faces, ((0, 1), (1, 2), (0, 2)))):
        at = apart.points[cells]
        first = 4 if cells is apart.elements else 3
        for k, (start, end) in enumerate(edges):
            np.testing.assert_allclose(at[:, first + k], 0.5 * (at[:, start] + at[:, end]))
    # a rectangle of 4 x 6 squares has 4 x 7 + 6 x 5 sides and 24 diagonals; 6 sides are in muscle
    assert len(apart.points) - len(curved.points) == len(straight.points) - len(mesh.points) + 28 + 30 + 24 - 6
    sides = [np.isin(apart.marks, marks) for marks in (parts.splits[0].first, parts.splits[0].second)]
    assert len(np.intersect1d(*(apart.faces[on] for on in sides))) == 7 + 6


def test_tags_and_sets_have_sides() -> None:
    mesh, parts, _ = joined(
        plates,
        read_split("cartilage/bone"),
        tags=[read_tag("ball:0,0,2,2 & bone/cartilage=spot")],
        sets=[read_definition("both = bone/cartilage"), read_definition("own = bone & bone/cartilage")],
    )
    apart = split(mesh, parts)
    (sides,) = parts.splits
    named = {own.number: own.name for own in parts.rows}
    assert [named[mark] for mark in sides.first] == ["cartilage_to_bone", "spot"]
    assert [named[mark] for mark in sides.second] == ["bone_to_cartilage", "bone_spot"]
    (pair,) = apart.contacts
    assert pair == ("cartilage_to_bone_side", "bone_to_cartilage_side")
    assert all(len(corners_of(apart, name)) == 72 for name in pair)
    assert len(corners_of(apart, "both")) == 2 * 72
    own = corners_of(apart, "own")
    assert len(own) == 72
    assert np.isin(own, apart.elements[apart.regions == 1]).all()


def test_a_side_never_takes_the_name_of_a_tag() -> None:
    tag = read_tag("ball:2,0,2,2.5 & (bone/cartilage + bone/muscle)=bone_to_cartilage")
    _, parts, _ = joined(with_muscle, read_split("bone/cartilage"), tags=[tag])
    (union,) = (own for own in parts.unions if own.name == tag.name)
    names = [row.name for row in parts.rows]
    assert {row.number for row in parts.rows if tag.name in row.within} == union.members
    assert tag.name not in names
    assert "bone_to_cartilage_2" in names


def test_points_without_fibres_get_no_coordinates() -> None:
    mesh, parts, _ = joined(plates, read_split("bone/cartilage"))
    for muscle in (1, 2):
        known = np.unique(mesh.elements[mesh.regions == muscle])
        values = np.full(len(mesh.points), np.nan)
        values[known] = mesh.points[known, 2]
        fibre = np.where((mesh.regions == muscle)[:, None], [1.0, 0.0, 0.0], 0.0)
        apart = split(replace(mesh, fields={"fibre": fibre}, point_fields={"transmural": values}), parts)
        found = apart.point_fields["transmural"]
        own = np.unique(apart.elements[apart.regions == muscle])
        np.testing.assert_array_equal(np.flatnonzero(~np.isnan(found)), own)
        np.testing.assert_array_equal(found[own], apart.points[own, 2])


def test_points_without_tetrahedra_keep_their_numbers() -> None:
    mesh, parts, _ = joined(plates, read_split("bone/cartilage"))
    apart = split(replace(mesh, points=np.vstack([mesh.points, [9.0, 9.0, 9.0]])), parts)
    np.testing.assert_array_equal(apart.points[apart.elements], mesh.points[mesh.elements])
    assert apart.elements.max() == len(apart.points) - 1


def test_contact_pairs_are_read_back(tmp_path: Path) -> None:
    mesh, parts, _ = joined(plates, read_split("bone/cartilage"))
    apart = split(mesh, parts)
    for kind in ("inp", "feb"):
        export(apart, tmp_path / "b.volume.vtu", "b", kind)
    again = meshio.read(tmp_path / "b.volume.inp")
    np.testing.assert_array_equal(again.points, apart.points)
    np.testing.assert_array_equal(again.cells_dict["tetra"], apart.elements)
    lines = (tmp_path / "b.volume.inp").read_text().splitlines()
    pair = lines[lines.index("*CONTACT PAIR, INTERACTION=CONTACT_1, TYPE=SURFACE TO SURFACE") + 1].split(", ")
    assert pair == ["CARTILAGE_TO_BONE", "BONE_TO_CARTILAGE"]
    assert all(f"*SURFACE, NAME={name}, TYPE=ELEMENT" in lines for name in pair)
    assert "*SURFACE INTERACTION, NAME=CONTACT_1" in lines

    febio = read_febio(tmp_path / "b.volume.feb")
    np.testing.assert_array_equal(febio.points, apart.points)
    (sides,) = febio.contacts
    assert sides == ("cartilage_to_bone", "bone_to_cartilage")
    assert [owner_of(febio, side) for side in sides] == ["cartilage", "bone"]
    first, second = (febio.surfaces[side] for side in sides)
    assert not np.intersect1d(first, second).size
    np.testing.assert_array_equal(febio.points[first].mean(axis=1), febio.points[second].mean(axis=1))


def test_an_interface_that_lost_tetrahedra_is_not_split(capfd: pytest.CaptureFixture[str]) -> None:
    mesh, parts, _ = joined(plates, read_split("bone/cartilage"))
    lost = replace(mesh, before=np.where(np.arange(len(mesh.before)) == np.argmax(mesh.before), NOBODY, mesh.before))
    assert split(lost, parts) is lost
    separate(None, lost, None, parts, quiet_context())  # type: ignore[arg-type]
    assert "no interface is split" in capfd.readouterr().err


def test_nothing_is_written_about_contact_without_a_split(tmp_path: Path) -> None:
    mesh, parts, _ = joined(plates)
    assert split(mesh, parts) is mesh
    for kind in ("inp", "feb"):
        export(mesh, tmp_path / "b.volume.vtu", "b", kind)
        assert "contact" not in (tmp_path / f"b.volume.{kind}").read_text().lower().replace("to_contact", "")


@pytest.mark.parametrize(
    ("splits", "told"),
    [
        ([read_split("bone/cartilag")], "--split bone/cartilag: 'cartilag' is not a material"),
        ([read_gap("bones/cartilage=0.2")], "--gap bones/cartilage=0.2: 'bones' is not a material"),
        ([read_split("bone/outside")], "'outside' is not a material"),
        ([read_split("bone/muscle")], "'bone/muscle' is not an interface"),
        ([read_split("bone/cartilage"), read_gap("cartilage/bone=1")], "the interface is given twice"),
    ],
)
def test_wrong_interfaces_are_refused(splits: list[Split], told: str) -> None:
    with pytest.raises(StageError) as caught:
        joined(plates, *splits)
    assert told in caught.value.what
    assert caught.value.why
    assert "outside" not in caught.value.next


def test_interfaces_are_checked_before_there_is_a_surface() -> None:
    materials = ["outside", "bone", "cartilage"]
    check_early([], [], materials, splits=[read_split("bone/cartilage")])
    with pytest.raises(StageError, match="'cartilag' is not a material"):
        check_early([], [], materials, splits=[read_gap("bone/cartilag=1")])
    with pytest.raises(StageError, match="the surface is that of one object"):
        check_early([], [], [], splits=[read_split("bone/cartilage")])


@pytest.mark.parametrize("text", ["bone", "bone+cartilage", "bone/cartilage/x", "/bone"])
def test_what_is_no_interface_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match="'"):
        read_split(text)


@NEEDS_HXT
def test_the_program_splits_linear_meshes(tmp_path: Path, run: Run) -> None:
    made = cells_of_a_block((4, 4, 4), plates, NAMES[:2])
    made.save(tmp_path / "s.surface.vtp")
    write_sizing(tmp_path / "h.vti", lambda world: np.full(len(world), 1.0), 8)
    words = ("s.surface.vtp", "--sizefield", "h.vti", "-o", "s.volume.vtu", "--solve", "no", "-q")
    done = run(*words, "--split", "bone/cartilage", "--export", "carp", "--report", "r.json")
    assert done.returncode == 0, done.stderr
    report = json.loads((tmp_path / "r.json").read_text())
    (found,) = report["results"]["split"]["interfaces"]
    assert found["doubled_nodes"] == 25
    assert found["shared_nodes_mm"] == []
    assert report["parameters"]["splits"] == ["--split bone/cartilage"]
    areas = {row["name"]: row["area_mm2"] for row in report["results"]["boundary"]["parts"]}
    assert areas["bone_to_cartilage"] == areas["cartilage_to_bone"] == pytest.approx(16.0)
    sides = [
        np.loadtxt(tmp_path / f"s.volume.{name}.vtx", skiprows=2) for name in ("bone_to_cartilage", "cartilage_to_bone")
    ]
    assert [len(nodes) for nodes in sides] == [25, 25]
    assert not np.intersect1d(*sides).size

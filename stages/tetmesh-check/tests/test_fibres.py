"""Tests of fibres and coordinates: a half-ellipsoid with a known solution, files and refusals."""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import isoparticles as iso
import meshio
import numpy as np
import pytest
import pyvista as pv
from complexes import nested_balls
from conftest import NEEDS_HXT, Run, quiet_context, tetrahedra
from scipy.spatial import Delaunay
from scipy.spatial.transform import Rotation
from test_solve import block

from tetmesh_check.errors import StageError
from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh, object_mesh
from tetmesh_check.fibres.arguments import Angles, FibreArguments
from tetmesh_check.fibres.mapping import map_fibres
from tetmesh_check.fibres.rule import Harmonic, between, bislerp, directions, frames
from tetmesh_check.parts.algebra import Members
from tetmesh_check.quality import OUTWARD_FACES
from tetmesh_check.topology import tetrahedron_boundary

INNER, OUTER, FOCUS = 0.55, 0.85, 30.0
"""Confocal ellipsoids lambda = INNER and OUTER, and the distance of the foci from the centre, mm:
a wall of 7 to 11 mm around a cavity of 17 x 17 x 35 mm."""
ENDO, EPI, BASE = 1, 2, 3
SETS: dict[str, Members] = {"endo": frozenset([ENDO]), "epi": frozenset([EPI]), "base": frozenset([BASE])}
HELIX: Angles = (60.0, -60.0)


class Place(NamedTuple):
    """Positions in prolate spheroidal coordinates around the z axis."""

    depth: np.ndarray
    """lambda."""
    polar: np.ndarray
    """mu, 0 at the apex and pi/2 at the base."""
    turn: np.ndarray
    """Angle about the axis."""

    @property
    def points(self) -> np.ndarray:
        out, up = np.sinh(self.depth) * np.sin(self.polar), -np.cosh(self.depth) * np.cos(self.polar)
        return FOCUS * np.stack([out * np.cos(self.turn), out * np.sin(self.turn), up], axis=1)

    @property
    def transmural(self) -> np.ndarray:
        """Solution of Laplace's equation, 0 at INNER and 1 at OUTER, with no flow through z = 0."""
        low, high = (np.log(np.tanh(end / 2)) for end in (INNER, OUTER))
        return np.asarray((np.log(np.tanh(self.depth / 2)) - low) / (high - low))

    @property
    def axes(self) -> tuple[np.ndarray, np.ndarray]:
        """The circumferential and the longitudinal unit vector."""
        out, up = np.sinh(self.depth) * np.cos(self.polar), np.cosh(self.depth) * np.sin(self.polar)
        cosine, sine = np.cos(self.turn), np.sin(self.turn)
        longitudinal = np.stack([out * cosine, out * sine, up], axis=1)
        circumferential = np.stack([-sine, cosine, np.zeros_like(sine)], axis=1)
        return circumferential, longitudinal / np.linalg.norm(longitudinal, axis=1, keepdims=True)


def place_of(points: np.ndarray) -> Place:
    """Return the inverse of :attr:`Place.points`."""
    x, y, z = points.T / FOCUS
    below, above = np.hypot(np.hypot(x, y), z + 1), np.hypot(np.hypot(x, y), z - 1)
    return Place(np.arccosh((below + above) / 2), np.arccos(np.clip((above - below) / 2, -1, 1)), np.arctan2(y, x))


def half_ellipsoid(layers: int) -> MarkedMesh:
    """Return the wall between both ellipsoids below z = 0, with exact boundary marks."""
    rings = [np.linspace(0.0, 2.0 * np.pi, 6 * k, endpoint=False) for k in range(1, 3 * layers + 1)]
    disc = np.concatenate([[[0.0, 0.0]], *(k * np.stack([np.cos(a), np.sin(a)], 1) for k, a in enumerate(rings, 1))])
    a, b, c = np.sort(Delaunay(disc).simplices, axis=1).astype(np.int64).T
    count = len(disc)
    # a prism is three tetrahedra, whose diagonals fit those of its neighbours
    prism = [(a, b, c, c + count), (a, b, b + count, c + count), (a, a + count, b + count, c + count)]
    one = np.concatenate([np.stack(corners, axis=1) for corners in prism])
    cells = np.concatenate([one + k * count for k in range(layers)])
    layer, flat = np.repeat(np.arange(layers + 1), count), np.tile(disc, (layers + 1, 1))
    radius = np.hypot(*flat.T) / (3 * layers)
    points = Place(
        INNER + (OUTER - INNER) * layer / layers, np.pi / 2 * radius, np.arctan2(flat[:, 1], flat[:, 0])
    ).points
    turned = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0.0
    cells[turned] = cells[turned][:, [0, 2, 1, 3]]
    outside = tetrahedron_boundary(cells)
    on = [(layer[outside.triangles] == end).all(axis=1) for end in (0, layers)]
    marks = np.select(on, [ENDO, EPI], BASE)
    return object_mesh(points, cells, np.ones(len(cells), dtype=np.int64), outside, marks)


def mapped(mesh: MarkedMesh, sets: dict[str, Members] = SETS, sheet: Angles = (0.0, 0.0)) -> MarkedMesh:
    return map_fibres(FibreArguments("object", (), None, HELIX, sheet), sets, mesh, quiet_context())


def assert_orthonormal(mesh: MarkedMesh) -> None:
    matrices = np.stack([mesh.fields[name] for name in ("fibre", "sheet_normal", "sheet")], axis=2)
    squares = matrices.swapaxes(1, 2) @ matrices
    np.testing.assert_allclose(squares, np.broadcast_to(np.eye(3), squares.shape), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(matrices), 1.0, atol=1e-12)


def angle_between(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """Return the angles between vectors whose signs do not count, degrees."""
    products = np.abs(np.einsum("ij,ij->i", first, second))
    return np.asarray(np.degrees(np.arccos(np.clip(products, 0.0, 1.0))))


def helix_of(mesh: MarkedMesh) -> tuple[np.ndarray, Place]:
    """Return the helix angle of each element, degrees, and the place of its centroid."""
    place = place_of(mesh.points[mesh.tetrahedra].mean(axis=1))
    circumferential, longitudinal = (np.einsum("ij,ij->i", mesh.fields["fibre"], axis) for axis in place.axes)
    angle = np.degrees(np.arctan2(longitudinal, circumferential))
    return (angle + 90.0) % 180.0 - 90.0, place


# --- one ventricle --------------------------------------------------------------------------------


def test_the_helix_angle_is_linear_and_converges() -> None:
    errors = []
    for layers in (3, 6):
        helix, place = helix_of(mapped(half_ellipsoid(layers)))
        error = np.abs(helix - (60.0 - 120.0 * place.transmural))
        # the circumferential direction is undefined on the axis
        errors.append(error[place.polar > np.radians(20.0)])
    mean, largest = [float(error.mean()) for error in errors], [float(error.max()) for error in errors]
    assert mean[1] < mean[0] / 3 < 0.5 / 3, str(mean)
    assert largest[1] < largest[0] / 2 < 5.0 / 2, str(largest)


def test_fibres_are_right_handed_inside_and_left_handed_outside() -> None:
    helix, place = helix_of(mapped(half_ellipsoid(6)))
    away = place.polar > np.radians(20.0)
    inside, outside = helix[away & (place.transmural < 0.1)], helix[away & (place.transmural > 0.9)]
    assert (inside > 46.0).all()
    assert (inside < 61.0).all()
    assert (outside > -61.0).all()
    assert (outside < -46.0).all()


def test_the_vectors_are_orthonormal_and_the_sheet_has_its_angle() -> None:
    found = mapped(half_ellipsoid(3), sheet=(-65.0, 25.0))
    assert_orthonormal(found)
    plain = mapped(half_ellipsoid(3))
    np.testing.assert_allclose(plain.fields["fibre"], found.fields["fibre"], atol=1e-12)
    transmural = found.point_fields["transmural"][found.tetrahedra].mean(axis=1)
    angles = angle_between(found.fields["sheet"], plain.fields["sheet"])
    np.testing.assert_allclose(angles, np.abs(-65.0 + 90.0 * transmural), atol=1e-4)


def test_coordinates_are_those_of_the_ellipsoids() -> None:
    mean = {}
    for layers in (3, 6):
        found = mapped(half_ellipsoid(layers))
        place = place_of(found.points)
        np.testing.assert_allclose(found.point_fields["transmural"], place.transmural, atol=0.1 / layers**2)
        turn = found.point_fields["rotational"] - np.degrees(place.turn)
        off_axis = place.polar > 1e-6
        np.testing.assert_allclose((turn[off_axis] + 180.0) % 360.0, 180.0, atol=1e-6)
        apicobasal = found.point_fields["apicobasal"]
        at_base = np.isclose(place.polar, np.pi / 2)
        np.testing.assert_allclose(apicobasal[at_base], 1.0, atol=1e-12)
        assert apicobasal[np.linalg.norm(found.points - [0, 0, -FOCUS * np.cosh(OUTER)], axis=1).argmin()] == 0.0
        outer = np.isclose(place.depth, OUTER)
        rings = np.round(place.polar[outer], 6)
        along = [apicobasal[outer][rings == ring] for ring in np.unique(rings)]
        assert all(low.max() < high.min() for low, high in pairwise(along))
        # the length of the outer ellipse
        polar = np.linspace(0.0, np.pi / 2, 2001)
        speed = np.hypot(np.sinh(OUTER) * np.cos(polar), np.cosh(OUTER) * np.sin(polar))
        length = np.concatenate([[0.0], np.cumsum(speed[1:] + speed[:-1])])
        error = apicobasal[outer] - np.interp(place.polar[outer], polar, length / length[-1])
        mean[layers] = float(np.abs(error).mean())
    assert max(mean.values()) < 0.02, str(mean)


def test_vectors_and_coordinates_are_in_the_frame_of_the_output() -> None:
    mesh = half_ellipsoid(2)
    lps, ras = mapped(replace(mesh, space="lps")), mapped(replace(mesh, space="ras"))
    signs = np.array([-1.0, -1.0, 1.0])
    for name in ("fibre", "sheet", "sheet_normal"):
        assert angle_between(signs * lps.fields[name], ras.fields[name]).max() < 1e-4
    np.testing.assert_allclose(ras.point_fields["apicobasal"], lps.point_fields["apicobasal"], atol=1e-8)


def test_a_given_apex_is_the_nearest_point_off_the_base() -> None:
    mesh, context = half_ellipsoid(2), quiet_context()
    for place in ((30.0, 0.0, -20.0), (30.0, 0.0, 0.0)):
        map_fibres(FibreArguments("object", (), place, HELIX, HELIX), SETS, mesh, context)
        points = mesh.points[mesh.points[:, 2] < -1e-9]
        nearest = points[np.linalg.norm(points - place, axis=1).argmin()]
        np.testing.assert_allclose(context.results["fibres"]["apex_mm"], nearest)


def test_separate_pieces_get_no_fibres() -> None:
    mesh = half_ellipsoid(2)
    points = np.concatenate([mesh.points, 1e3 + np.vstack([np.zeros(3), np.eye(3)])])
    cells = np.vstack([mesh.elements, len(mesh.points) + np.arange(4)])
    regions = np.ones(len(cells), dtype=np.int64)
    found = mapped(replace(mesh, points=points, elements=cells, regions=regions))
    np.testing.assert_array_equal(found.fields["fibre"][-1], 0.0)
    assert np.linalg.norm(found.fields["fibre"][:-1], axis=1).min() > 0.999
    assert np.isnan(found.point_fields["transmural"][-4:]).all()


def with_flap(jitter: float) -> MarkedMesh:
    """Return a half-ellipsoid with a flap of five tetrahedra on its base."""
    mesh, random = half_ellipsoid(2), np.random.default_rng(1)
    on_base = np.flatnonzero(mesh.marks == BASE)
    corners = mesh.boundary[on_base[0]]
    first = len(mesh.points)
    tip = mesh.points[corners].mean(axis=0) + np.array([0.0, 0.0, 3.0])
    # the first tetrahedron shares nodes with the wall; the four others do not
    points = np.vstack([mesh.points, tip, tip + np.eye(3), tip + 1.0 + np.eye(3)])
    points[first:] += jitter * random.standard_normal((7, 3))
    chain = [[*corners, first], *([first + k, first + k + 1, first + k + 2, first + k + 3] for k in range(4))]
    cells = np.vstack([mesh.elements, np.array(chain)])
    flat = np.linalg.det(points[cells[:, 1:]] - points[cells[:, :1]]) < 0.0
    cells[flat] = cells[flat][:, [0, 2, 1, 3]]
    outside = tetrahedron_boundary(cells)
    kept = {tuple(sorted(face)): mark for face, mark in zip(mesh.boundary.tolist(), mesh.marks.tolist(), strict=True)}
    marks = np.array([kept.get(tuple(sorted(face)), BASE) for face in outside.triangles.tolist()])
    return object_mesh(points, cells, np.ones(len(cells), dtype=np.int64), outside, marks)


@pytest.mark.parametrize("jitter", [0.0, 0.1])
def test_a_flap_on_the_base_gets_arbitrary_fibres_and_a_warning(
    jitter: float, capfd: pytest.CaptureFixture[str]
) -> None:
    mesh, context = with_flap(jitter), quiet_context()
    found = map_fibres(FibreArguments("object", (), None, HELIX, HELIX), SETS, mesh, context)
    assert_orthonormal(found)
    assert context.results["fibres"]["arbitrary"] > 0
    assert "get arbitrary fibres" in capfd.readouterr().err
    assert not np.isnan(found.point_fields["apicobasal"]).any()
    np.testing.assert_array_equal(found.point_fields["apicobasal"][np.unique(mesh.boundary[mesh.marks == BASE])], 1.0)


def test_a_muscle_without_tetrahedra_is_left_to_the_checks(capfd: pytest.CaptureFixture[str]) -> None:
    mesh = replace(half_ellipsoid(2), materials=[{"name": "outside"}, {"name": "wall"}])
    assert map_fibres(FibreArguments("wall", (), None, HELIX, HELIX), SETS, mesh, quiet_context()) is mesh
    assert "wall has no tetrahedra" in capfd.readouterr().err


def test_a_boundary_on_a_smaller_piece_only_is_refused() -> None:
    mesh = half_ellipsoid(2)
    with pytest.raises(
        StageError, match=r"piece of object \(\d+ of \d+ tetrahedra\) has no triangle of --endo-rv"
    ) as caught:
        mapped(mesh, {**SETS, "endo_rv": frozenset([9])})
    assert "remove small pieces from the labels" in caught.value.next


def test_inverted_tetrahedra_are_refused() -> None:
    mesh = half_ellipsoid(2)
    elements = mesh.elements.copy()
    elements[7] = elements[7][[0, 2, 1, 3]]
    with pytest.raises(StageError, match="Laplace's equation cannot be solved"):
        mapped(replace(mesh, elements=elements))


# --- the rule -------------------------------------------------------------------------------------


def test_interpolation_ignores_signs_and_is_even() -> None:
    first = Rotation.from_euler("xyz", [[10.0, 20.0, 30.0]] * 3, degrees=True)
    turn = Rotation.from_rotvec(np.radians([[0.0, 0.0, 40.0]] * 3))
    flips = Rotation.from_quat([[0.0, 0.0, 0.0, 1.0], [1.0, 0.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0]])
    half = bislerp(first * flips, first * turn, np.array([0.5, 0.5, 0.5])).as_matrix()
    exact = (first * Rotation.from_rotvec(np.radians([[0.0, 0.0, 20.0]] * 3))).as_matrix()
    for column in range(3):
        assert angle_between(half[:, :, column], exact[:, :, column]).max() < 1e-4
    for share, end in ((0.0, first), (1.0, first * turn)):
        found = bislerp(first * flips, first * turn, np.full(3, share)).as_matrix()
        assert angle_between(found[:, :, 0], end.as_matrix()[:, :, 0]).max() < 1e-4


def test_parallel_gradients_give_a_frame() -> None:
    up = np.array([[0.0, 0.0, 2.0], [0.0, 0.0, 0.0], [0.0, 3.0, 0.0]])
    matrices = frames(up, np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])).as_matrix()
    np.testing.assert_allclose(matrices.swapaxes(1, 2) @ matrices, np.broadcast_to(np.eye(3), (3, 3, 3)), atol=1e-12)


def test_free_walls_and_septum_have_the_angles_of_their_surfaces() -> None:
    share = np.linspace(0.0, 1.0, 21)
    x, up = np.tile([1.0, 0.0, 0.0], (21, 1)), np.tile([0.0, 0.0, 1.0], (21, 1))
    zero = Harmonic(0.0 * share, 0.0 * x)

    def helix(epi: Harmonic, rv: Harmonic | None, outward: float) -> np.ndarray:
        """Return helix angles in the frame whose transmural axis is ``outward`` times x."""
        left, right = (np.stack([between(ends, epi.values), 0.0 * share]) for ends in (HELIX, (30.0, -20.0)))
        fibre, _, _ = directions(up, epi, rv, left, right)
        angle = np.degrees(np.arctan2(fibre[:, 2], outward * fibre[:, 1]))
        return np.asarray((angle + 90.0) % 180.0 - 90.0)

    # the cavity is at x = 0 in the wall of the left ventricle, and at x = 1 in that of the right
    left = helix(Harmonic(share, x), zero, 1.0)
    right = helix(Harmonic(1.0 - share, -x), Harmonic(share, x), -1.0)
    np.testing.assert_allclose(left, 60.0 - 120.0 * share, atol=1e-6)
    np.testing.assert_allclose(right, -20.0 + 50.0 * share, atol=1e-6)
    septum = helix(zero, Harmonic(share, x), 1.0)
    np.testing.assert_allclose(septum, 60.0 - 90.0 * share, atol=1e-6)
    np.testing.assert_allclose(helix(Harmonic(share, x), None, 1.0), left, atol=1e-12)


def two_ventricles(size: int) -> tuple[MarkedMesh, dict[str, Members]]:
    """Return a box of 8 x 5 x 4 with two cavities that are open at the top, z = 4."""
    points, cells = block((8 * size, 5 * size, 4 * size), 1.0 / size)
    x, y, z = points[cells].mean(axis=1).T
    in_cavity = (z > 1.0) & (abs(y - 2.5) < 1.5) & ((abs(x - 2.5) < 1.5) | (abs(x - 6.0) < 1.0))
    used, local = np.unique(cells[~in_cavity], return_inverse=True)
    points, cells = points[used], local.reshape(-1, 4)
    outside = tetrahedron_boundary(cells)
    x, y, z = points[outside.triangles].mean(axis=1).T
    is_outer = np.isclose(x % 8, 0) | np.isclose(y % 5, 0) | np.isclose(z, 0)
    marks = np.select([np.isclose(z, 4), is_outer, x < 4.5], [BASE, EPI, ENDO], 4)
    mesh = object_mesh(points, cells, np.ones(len(cells), dtype=np.int64), outside, marks)
    return mesh, {**SETS, "endo_rv": frozenset([4])}


def test_fibres_of_two_ventricles_turn_steadily() -> None:
    mesh, sets = two_ventricles(4)
    apex = (4.0, 2.5, 0.0)
    given = FibreArguments("object", (), apex, HELIX, (0.0, 0.0), apex_rv=apex)
    found = map_fibres(given, sets, mesh, quiet_context())
    assert_orthonormal(found)
    centres, fibre = mesh.points[mesh.tetrahedra].mean(axis=1), found.fields["fibre"]
    angle = np.degrees(np.arctan2(fibre[:, 2], fibre[:, 1]))
    # the left wall, the septum and the right wall; x grows towards the cavity in the left wall only
    for start, tolerance in ((0.0, 2.0), (4.0, 8.0), (7.0, 2.0)):
        x, y, z = centres.T
        own = (abs(y - 2.5) < 0.5) & (abs(z - 3.0) < 0.5) & (x > start) & (x < start + 1.0)
        error = (angle[own] - (60.0 - 120.0 * (x[own] - start)) + 90.0) % 180.0 - 90.0
        assert np.abs(error).max() < tolerance, start
    faces = np.sort(np.concatenate([mesh.tetrahedra[:, list(face)] for face in OUTWARD_FACES]), axis=1)
    order = np.lexsort(faces.T)
    inner = (faces[order][1:] == faces[order][:-1]).all(axis=1)
    first, second = (np.tile(fibre, (4, 1))[order[side]][inner] for side in (slice(-1), slice(1, None)))
    # fibres must jump somewhere, such as on the lines where the ventricles meet
    assert (angle_between(first, second) > 45.0).mean() < 0.003


def test_the_apex_of_the_right_ventricle_is_below_its_cavity() -> None:
    mesh, sets = two_ventricles(2)
    context = quiet_context()
    map_fibres(FibreArguments("object", (), None, HELIX, HELIX), sets, mesh, context)
    x, y, z = context.results["fibres"]["apex_rv_mm"]
    assert 5.0 <= x <= 7.0
    assert 1.0 <= y <= 4.0
    assert z == 0.0


def test_the_right_ventricle_has_a_rotational_coordinate() -> None:
    mesh, sets = two_ventricles(2)
    given = FibreArguments("object", (), None, HELIX, HELIX, apex_rv=(6.0, 2.5, 0.0))
    found = map_fibres(given, sets, mesh, quiet_context()).point_fields
    assert "rotational_rv" not in mapped(half_ellipsoid(2)).point_fields
    # the axis of the right cavity is the line x = 6, y = 2.5
    x, y = mesh.points[:, 0] - 6.0, mesh.points[:, 1] - 2.5
    off_axis = np.hypot(x, y) > 0.1
    turn = found["rotational_rv"] - np.degrees(np.arctan2(y, x))
    np.testing.assert_allclose((turn[off_axis] + 180.0) % 360.0, 180.0, atol=1e-6)


def test_a_base_of_the_left_ventricle_alone_gives_fibres_everywhere() -> None:
    mesh, sets = two_ventricles(2)
    is_right = (mesh.marks == BASE) & (mesh.points[mesh.boundary].mean(axis=1)[:, 0] > 3.5)
    found = mapped(replace(mesh, marks=np.where(is_right, 9, mesh.marks)), sets)
    assert_orthonormal(found)


def test_the_transventricular_coordinate_names_the_ventricle() -> None:
    mesh, sets = two_ventricles(4)
    found = mapped(mesh, sets).point_fields
    assert "transventricular" not in mapped(half_ellipsoid(2)).point_fields
    side, (x, y, z) = found["transventricular"], mesh.points.T
    for name, value in (("endo", -1.0), ("endo_rv", 1.0)):
        own = np.unique(mesh.boundary[np.isin(mesh.marks, sorted(sets[name]))])
        np.testing.assert_allclose(side[own], value, atol=1e-12)
    # the septum, a slab far from its edges, and the free walls
    septum = (abs(y - 2.5) < 0.3) & (z > 3.0) & (x > 4.0) & (x < 5.0)
    np.testing.assert_allclose(side[septum], 2.0 * (x[septum] - 4.0) - 1.0, atol=0.02)
    assert (side[x < 3.5] < 0.0).all()
    assert (side[x > 5.5] > 0.0).all()


def test_helix_angles_are_reported_by_depth() -> None:
    context = quiet_context()
    map_fibres(FibreArguments("object", (), None, HELIX, (0.0, 0.0)), SETS, half_ellipsoid(6), context)
    (layers,) = context.results["fibres"]["helix_by_depth"].values()
    assert [layer["depth"] for layer in layers] == pytest.approx([0.1, 0.3, 0.5, 0.7, 0.9])
    for layer in layers:
        assert layer["mean"] == pytest.approx(60.0 - 120.0 * layer["depth"], abs=6.0)
        assert layer["p5"] < layer["mean"] < layer["p95"]
    mesh, sets = two_ventricles(4)
    arguments = FibreArguments("object", (), (4.0, 2.5, 0.0), HELIX, (0.0, 0.0), (90.0, -20.0))
    map_fibres(arguments, sets, mesh, context)
    walls = context.results["fibres"]["helix_by_depth"]
    assert list(walls) == ["left free wall", "septum", "right free wall"]
    for wall, (inner, outer) in zip(walls, (HELIX, (60.0, -90.0), (90.0, -20.0)), strict=True):
        for layer in walls[wall]:
            expected = inner + (outer - inner) * layer["depth"]
            assert (layer["mean"] - expected + 90.0) % 180.0 - 90.0 == pytest.approx(0.0, abs=15.0), wall


# --- outflow tracts -------------------------------------------------------------------------------

OUTFLOW = 5


def half_open(layers: int) -> tuple[MarkedMesh, dict[str, Members]]:
    """Return a half-ellipsoid whose base is an outflow tract where x > 0."""
    mesh = half_ellipsoid(layers)
    is_outflow = (mesh.marks == BASE) & (mesh.points[mesh.boundary].mean(axis=1)[:, 0] > 0.0)
    mesh = replace(mesh, marks=np.where(is_outflow, OUTFLOW, mesh.marks))
    return mesh, {**SETS, "outflow": frozenset([OUTFLOW])}


def test_fibres_turn_to_the_angles_of_the_outflow_tract() -> None:
    mean = []
    for layers in (3, 6):
        mesh, sets = half_open(layers)
        helix, place = helix_of(mapped(mesh, sets))
        at_valve = np.isin(mesh.tetrahedra, np.unique(mesh.boundary[mesh.marks == OUTFLOW])).sum(axis=1) > 2
        # the longitudinal direction jumps where the valves meet, at x = 0
        at_valve &= mesh.points[mesh.tetrahedra].mean(axis=1)[:, 0] > 10.0
        error = (helix - (90.0 - 90.0 * place.transmural) + 90.0) % 180.0 - 90.0
        mean.append(float(np.abs(error[at_valve]).mean()))
        # the opposite wall has the angles of the ventricle
        plain, _ = helix_of(mapped(half_ellipsoid(layers)))
        opposite = (np.abs(place.turn) > np.radians(150.0)) & (place.polar > np.radians(20.0))
        assert np.abs(helix - plain)[opposite].max() < 6.0
    assert mean[1] < mean[0] / 1.6 < 3.0 / 1.6, str(mean)


def test_the_apicobasal_coordinate_leads_to_all_valves() -> None:
    for layers in (3, 6):
        mesh, sets = half_open(layers)
        found = mapped(mesh, sets).point_fields["apicobasal"]
        np.testing.assert_allclose(found[np.isclose(mesh.points[:, 2], 0.0)], 1.0, atol=1e-12)
        apart = found - mapped(half_ellipsoid(layers)).point_fields["apicobasal"]
        assert np.abs(apart).max() < 0.1


# --- files ----------------------------------------------------------------------------------------


def two_materials() -> MarkedMesh:
    """Return a half-ellipsoid of which the quarter x > 0 is another region."""
    mesh = mapped(half_ellipsoid(2))
    regions = np.where(mesh.points[mesh.tetrahedra].mean(axis=1)[:, 0] > 0.0, 2, 1)
    fields = {name: np.where((regions == 1)[:, None], values, 0.0) for name, values in mesh.fields.items()}
    table = [{"region": k, "name": name, "material": name, "labels": [k]} for k, name in ((1, "wall"), (2, "rest"))]
    parts = {ENDO: "endo", EPI: "epi", BASE: "base"}
    return replace(mesh, regions=regions, fields=fields, table=table, parts=parts)


def test_opencarp_reads_two_directions_per_element(tmp_path: Path) -> None:
    mesh = two_materials()
    export(mesh, tmp_path / "b.volume.vtu", "b", "carp")
    count, *rows = (tmp_path / "b.volume.lon").read_text().splitlines()
    assert count == "2"
    assert len(rows) == len(mesh.elements)
    for row, fibre, sheet in zip(rows, mesh.fields["fibre"], mesh.fields["sheet"], strict=True):
        numbers = [float(word) for word in row.split()]
        assert numbers == pytest.approx([*fibre, *sheet], abs=1e-8)
    assert {row for row, region in zip(rows, mesh.regions, strict=True) if region == 2} == {"0 0 0 0 0 0"}


def test_febio_gets_the_axes_of_each_element_with_fibres(tmp_path: Path) -> None:
    mesh = two_materials()
    export(mesh, tmp_path / "b.volume.vtu", "b", "feb")
    root = ElementTree.parse(tmp_path / "b.volume.feb").getroot()
    assert [child.tag for child in root][-2:] == ["MeshDomains", "MeshData"]
    (data,) = root.iterfind("MeshData/ElementData")
    assert data.attrib == {"type": "mat_axis", "elem_set": "wall"}
    (part,) = (own for own in root.iterfind("Mesh/Elements") if own.get("name") == "wall")
    assert [one.get("lid") for one in data] == [str(k) for k in range(1, len(part) + 1)]
    own = mesh.regions == 1
    for tag, field in (("a", "fibre"), ("d", "sheet")):
        found = np.array([[float(x) for x in (axis.text or "").split(",")] for axis in data.iterfind(f"elem/{tag}")])
        np.testing.assert_allclose(found, mesh.fields[field][own], atol=1e-8)


def test_legacy_vtk_has_vectors_and_coordinates(tmp_path: Path) -> None:
    mesh = mapped(half_ellipsoid(2))
    export(mesh, tmp_path / "b.volume.vtu", "b", "vtk")
    grid = pv.read(tmp_path / "b.volume.vtk")
    for name in ("fibre", "sheet", "sheet_normal"):
        np.testing.assert_array_equal(grid.cell_data[name], mesh.fields[name])
    for name in ("apicobasal", "transmural", "rotational"):
        np.testing.assert_array_equal(grid.point_data[name], mesh.point_fields[name])


@pytest.mark.parametrize("kind", ["msh", "med", "xdmf"])
def test_meshio_reads_vectors_and_coordinates(tmp_path: Path, kind: str) -> None:
    mesh = mapped(half_ellipsoid(2))
    coordinates = {**mesh.point_fields, "rotational": np.where(mesh.points[:, 0] > 0.0, np.nan, 1.0)}
    mesh = replace(mesh, point_fields=coordinates)
    export(mesh, tmp_path / "b.volume.vtu", "b", kind)
    found = meshio.read(tmp_path / f"b.volume.{kind}")
    for name in ("fibre", "sheet", "sheet_normal"):
        np.testing.assert_allclose(found.cell_data_dict[name]["tetra"], mesh.fields[name])
    for name, values in mesh.point_fields.items() if kind != "msh" else ():
        np.testing.assert_allclose(found.point_data[name], values)


@pytest.mark.parametrize("kind", ["msh", "med"])
@NEEDS_HXT
def test_gmsh_shows_fibres_as_views(tmp_path: Path, kind: str) -> None:
    mesh = mapped(half_ellipsoid(2))
    export(mesh, tmp_path / "b.volume.vtu", "b", kind)
    words = [sys.executable, "-c", GMSH, str(tmp_path / f"b.volume.{kind}")]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if "no MED" in done.stdout:
        pytest.skip("this Gmsh does not read MED")
    assert done.returncode == 0, done.stdout + done.stderr
    views = json.loads(done.stdout.splitlines()[-1])
    coordinates = mesh.point_fields if kind == "med" else {}
    assert set(views) == {*mesh.fields, *coordinates}
    for name, values in mesh.fields.items():
        # centroids and vectors, which do not depend on the order of the elements
        rows = np.hstack([mesh.points[mesh.tetrahedra].mean(axis=1), values])
        assert_same_rows(rows, np.array(views[name]))
    for name, values in coordinates.items():
        assert_same_rows(np.column_stack([mesh.points, values]), np.array(views[name]))


GMSH = """
import gmsh, json, sys
import numpy as np
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
try:
    gmsh.open(sys.argv[1])
except Exception:
    if sys.argv[1].endswith(".med"):
        print("no MED")
        sys.exit(0)
    raise
tags, at, _ = gmsh.model.mesh.getNodes()
place = dict(zip(tags.tolist(), at.reshape(-1, 3)))
found = {}
for view in gmsh.view.getTags():
    index = gmsh.view.getIndex(view)
    name = gmsh.option.getString(f"View[{index}].Name")
    kind, of, values, _, count = gmsh.view.getHomogeneousModelData(view, 0)
    rows = []
    for tag, own in zip(of, values.reshape(-1, count)):
        if kind == "NodeData":
            rows.append([*place[tag], *own])
        else:
            shape, nodes, _, _ = gmsh.model.mesh.getElement(tag)
            if shape == 4:
                rows.append([*np.mean([place[node] for node in nodes], axis=0), *own])
    found[name] = np.array(rows).tolist()
print(json.dumps(found))
"""


def assert_same_rows(first: np.ndarray, second: np.ndarray) -> None:
    """Assert that rows, which start with a place, are the same in any order."""
    orders = [np.lexsort(np.round(rows[:, :3], 6).T) for rows in (first, second)]
    np.testing.assert_allclose(first[orders[0]], second[orders[1]], atol=1e-8)


# --- the command line -----------------------------------------------------------------------------

HOLLOW = ["--tag", "ball:0,0,0,8=inner", "--tag", "plane:0,0,-0.01,0,0,1=lid"]
FIBRES = ["--fibres", "object", "--endo", "inner - lid", "--epi", "outside - inner - lid", "--base", "lid"]


def hollow_half_ball() -> pv.PolyData:
    """Return the surface of a half ball of radius 10 with a cavity of radius 6, below z = 0."""
    angles = np.linspace(0.0, np.pi / 2, 13)
    outline = [10.0 * np.stack([np.sin(a), -np.cos(a)]) for a in angles]
    outline += [np.array([x, 0.0]) for x in (8.0,)]
    outline += [6.0 * np.stack([np.sin(a), -np.cos(a)]) for a in angles[::-1]]
    turns = np.linspace(0.0, 2.0 * np.pi, 36, endpoint=False)
    inner = outline[1:-1]
    rings = [np.stack([r * np.cos(turns), r * np.sin(turns), np.full(36, z)], 1) for r, z in inner]
    points = np.concatenate([[[0.0, 0.0, -10.0]], *rings, [[0.0, 0.0, -6.0]]])
    here, after = np.arange(36), np.roll(np.arange(36), -1)
    triangles = [np.stack([np.zeros(36, dtype=int), 1 + after, 1 + here], 1)]
    for k in range(len(inner) - 1):
        low, high = 1 + 36 * k, 37 + 36 * k
        triangles += [np.stack([low + here, low + after, high + here], 1)]
        triangles += [np.stack([low + after, high + after, high + here], 1)]
    last = 1 + 36 * (len(inner) - 1)
    triangles += [np.stack([last + here, last + after, np.full(36, len(points) - 1)], 1)]
    return from_triangles(points, np.concatenate(triangles))


def from_triangles(points: np.ndarray, triangles: np.ndarray) -> pv.PolyData:
    return pv.PolyData(points, np.hstack([np.full((len(triangles), 1), 3), triangles]).ravel())


@NEEDS_HXT
def test_a_hollow_half_ball_gets_fibres_from_the_command_line(tmp_path: Path, run: Run) -> None:
    hollow_half_ball().save(tmp_path / "s.vtp")
    words = ["s.vtp", "-o", "v.volume.vtu", "--method", "hxt", "--solve", "no", "-q", "--report", "r.json"]
    done = run(*words, *HOLLOW, *FIBRES, "--helix", "60,-60", "--sheet", "0,0", "--export", "carp,feb")
    assert done.returncode == 0, done.stderr
    points, cells, grid = tetrahedra(tmp_path / "v.volume.vtu")
    fibre, centres = np.asarray(grid.cell_data["fibre"]), points[cells].mean(axis=1)
    radius = np.linalg.norm(centres, axis=1)
    # Laplace's equation between concentric spheres
    transmural = (1 / 6 - 1 / radius) / (1 / 6 - 1 / 10)
    around = np.stack([-centres[:, 1], centres[:, 0], np.zeros(len(cells))], axis=1)
    around /= np.linalg.norm(around, axis=1, keepdims=True)
    up = np.cross(centres / radius[:, None], around)
    helix = np.degrees(np.arctan2((fibre * up).sum(axis=1), (fibre * around).sum(axis=1)))
    error = (helix - (60.0 - 120.0 * transmural) + 90.0) % 180.0 - 90.0
    assert np.abs(error[centres[:, 2] > -7.0]).mean() < 3.0
    assert len((tmp_path / "v.volume.lon").read_text().splitlines()) == 1 + len(cells)
    report = json.loads((tmp_path / "r.json").read_text())
    assert report["results"]["fibres"]["tetrahedra"] == len(cells)
    given = report["parameters"]["fibres"]
    assert given["sets"]["endo"] == "inner - lid"
    # there is no right ventricle and no outflow tract
    assert set(given) == {"material", "sets", "apex", "helix", "sheet"}


@NEEDS_HXT
def test_a_wall_around_blood_gets_fibres_between_caps(tmp_path: Path, run: Run) -> None:
    x, y, z = np.meshgrid(*[np.arange(n) for n in (26, 26, 22)], indexing="ij")
    radius = np.linalg.norm([x - 12.5, y - 12.5, (z - 21.5) / 1.6], axis=0)
    labels = np.where(radius < 6.0, 1, np.where(radius < 10.5, 2, 0)).astype(np.uint8)
    field = iso.distance_field(labels, materials={"blood": 1, "wall": 2}, scale=0.0)
    h = iso.size_field(field, uniform=2.0)
    h.save(tmp_path / "h.vti")
    iso.reconstruct(iso.settle(iso.seed(field, h), field, h, backend="cpu"), field, h).save(tmp_path / "s.vtp")
    words = ["s.vtp", "--sizefield", "h.vti", "-o", "v.volume.vtu", "--solve", "no", "-q", "--for", "opencarp"]
    sets = ["--set", "endo = wall/blood", "--fibres", "wall", "--endo", "endo", "--base", "caps"]
    done = run(*words, *sets, "--epi", "wall/outside - caps")
    assert done.returncode in (0, 1), done.stderr
    points, cells, grid = tetrahedra(tmp_path / "v.volume.vtu")
    fibre, is_wall = np.asarray(grid.cell_data["fibre"]), np.asarray(grid.cell_data["region"]) == 2
    np.testing.assert_allclose(np.linalg.norm(fibre, axis=1), is_wall.astype(float), atol=1e-12)
    lon = np.loadtxt((tmp_path / "v.volume.lon").read_text().splitlines()[1:])
    np.testing.assert_allclose(lon[:, :3], fibre, atol=1e-8)
    known = ~np.isnan(grid.point_data["apicobasal"])
    np.testing.assert_array_equal(np.unique(cells[is_wall]), np.flatnonzero(known))
    height = points[known, 2]
    assert np.corrcoef(np.asarray(grid.point_data["apicobasal"])[known], height)[0, 1] > 0.95

    # a split interface gives the same fibres, whichever side an expression names
    more = ["--fibres", "wall", "--endo", "blood - caps", "--base", "caps", "--split", "wall/blood", "--force"]
    done = run(*words, *more, "--epi", "wall/outside - caps")
    assert done.returncode in (0, 1), done.stderr
    apart = tetrahedra(tmp_path / "v.volume.vtu")[2]
    np.testing.assert_array_equal(apart.cell_data["fibre"], fibre)
    assert apart.n_points > len(points)


WRONG = [
    (["--endo", "inner", "--helix", "60,-60"], "--endo, --helix without --fibres"),
    (FIBRES[:6], "--fibres without --base"),
    ([*FIBRES, "--helix", "60"], "'60' is not ENDO,EPI in degrees"),
    ([*FIBRES, "--helix", "100,-60"], "'100,-60' is not ENDO,EPI in degrees"),
    ([*FIBRES, "--helix-rv", "90,-25"], "--helix-rv without --endo-rv"),
    ([*FIBRES, "--helix-outflow", "90,0"], "--helix-outflow without --outflow"),
    ([*FIBRES, "--helix-outflow-rv", "90,0"], "--helix-outflow-rv without --endo-rv"),
    ([*FIBRES, "--apex-rv", "0,0,-10"], "--apex-rv without --endo-rv"),
    ([*FIBRES, "--outflow", "lid"], "--outflow lid and --base share lid"),
    ([*FIBRES, "--apex", "1,2"], "'1,2' is not X,Y,Z"),
    ([*FIBRES[:3], "inner -", *FIBRES[4:]], "'inner -' ends where a name is expected"),
    ([*FIBRES[:3], "iner", *FIBRES[4:]], "--endo iner: 'iner' is not the name of a part"),
    ([*FIBRES[:3], "inner & caps", *FIBRES[4:]], "--endo inner & caps does not touch object"),
    ([*FIBRES[:5], "outside - lid", *FIBRES[6:]], "--epi outside - lid and --endo share inner"),
    (["--fibres", "wall", *FIBRES[2:]], "--fibres wall: there is no such material"),
    ([*FIBRES, "--apex", "90,0,0"], "--apex 90,0,0 is "),
]


@pytest.mark.parametrize(("words", "text"), WRONG)
def test_wrong_input_is_refused_before_anything_is_filled(
    tmp_path: Path, run: Run, words: list[str], text: str
) -> None:
    hollow_half_ball().save(tmp_path / "s.vtp")
    done = run("s.vtp", "-o", "v.vtu", *HOLLOW, *words)
    assert done.returncode == 2
    assert text in done.stderr
    assert "why it matters" in done.stderr
    assert "what to do" in done.stderr
    assert [path.name for path in tmp_path.iterdir()] == ["s.vtp"]


def test_a_boundary_of_another_material_is_refused(tmp_path: Path, run: Run) -> None:
    nested_balls((9.0, 6.0, 3.0), (2, 2, 1), ("skin", "wall", "blood")).save(tmp_path / "s.vtp")
    words = ["--fibres", "wall", "--endo", "wall/blood", "--epi", "skin/outside", "--base", "wall/skin"]
    done = run("s.vtp", "-o", "v.vtu", *words)
    assert done.returncode == 2
    assert "--epi skin/outside does not touch wall" in done.stderr
    assert "the parts of its boundary are wall_to_skin, blood_to_wall" in done.stderr
    known = json.dumps({"materials": ["outside", "skin", "wall", "blood"], "volume": True})
    early = run("--check-options", known, "s.vtp", "-o", "v.vtu", *words[:3], "walls/blood", *words[4:])
    assert early.returncode == 2
    assert "--endo walls/blood: 'walls' is not a material" in early.stderr


def test_the_apex_must_be_near_the_muscle_in_a_large_surface(tmp_path: Path, run: Run) -> None:
    nested_balls((90.0, 6.0, 3.0), (2, 2, 1), ("skin", "wall", "blood")).save(tmp_path / "s.vtp")
    words = ["--tag", "plane:0,0,3,0,0,1 & wall/skin=lid", "--fibres", "wall", "--endo", "wall/blood", "--base", "lid"]
    done = run("s.vtp", "-o", "v.vtu", *words, "--epi", "wall/skin - lid", "--apex", "0,0,-15")
    assert done.returncode == 2
    assert "--apex 0,0,-15 is 9 mm from the boundary of wall" in done.stderr

"""Maps fibres and coordinates onto the tetrahedra of a muscle, by Laplace's equation.

Inputs are the sets of boundary triangles of the options. Outputs are the cell fields ``fibre``,
``sheet`` and ``sheet_normal`` (:mod:`.rule`), and the point fields ``apicobasal``, ``transmural``,
``rotational`` and, for two ventricles, ``rotational_rv`` and ``transventricular``, after the
universal ventricular coordinates of Bayer et al. (Med Image Anal 45:83-93, 2018). Outflow tracts,
and an apex for each ventricle, follow Doste et al. (Int J Numer Meth Biomed Engng 35:e3185, 2019).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from isoparticles._native import Context
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree
from skfem import MeshTet, condense
from skfem.models.poisson import laplace

from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.fem.assembly import linear_elements
from tetmesh_check.fem.forward import FLOW
from tetmesh_check.fem.solver import solve
from tetmesh_check.fibres.arguments import WHY, FibreArguments
from tetmesh_check.fibres.measures import helix_by_depth
from tetmesh_check.fibres.rule import Harmonic, between, directions, is_level, unit, ventricle_share
from tetmesh_check.parts.algebra import Members
from tetmesh_check.parts.names import option_name
from tetmesh_check.quality import Labels, Points, Values, signed_tetrahedron_volumes, triangle_quality

_UNSOLVED = (
    "--fibres: Laplace's equation cannot be solved",
    "some tetrahedra are inverted or flat",
    "improve the surface; without --fibres, the report lists these tetrahedra",
)


class _Muscle(NamedTuple):
    """Connected tetrahedra of the muscle, as a mesh of its own."""

    cells: Labels
    """Its tetrahedra in the whole mesh."""
    points: Labels
    """Its points in the whole mesh."""
    basis: Any
    """Linear elements on it."""
    matrix: Any
    """Matrix of Laplace's equation."""
    nodes: dict[str, Labels]
    """Its points on each boundary that it touches."""
    centres: dict[str, Points]
    """Centre of each of these boundaries, mm."""


def _muscle(mesh: MarkedMesh, own: Labels, members: Mapping[str, Members]) -> _Muscle:
    """Return the largest connected piece of some tetrahedra, in the frame of the output."""
    if signed_tetrahedron_volumes(mesh.points, mesh.tetrahedra[own]).min() <= 0.0:
        raise StageError(*_UNSOLVED)
    points, local = np.unique(mesh.tetrahedra[own], return_inverse=True)
    corners = np.ascontiguousarray(local.reshape(-1, 4).T)
    basis = linear_elements(MeshTet(np.ascontiguousarray(mesh.shown[points].T), corners))
    matrix = laplace.assemble(basis)
    piece = connected_components(matrix, directed=False)[1][corners[0]]
    kept = piece == np.bincount(piece).argmax()
    if not kept.all():
        return _muscle(mesh, own[kept], members)
    nodes, centres = {}, {}
    for name, marks in members.items():
        triangles = mesh.boundary[np.isin(mesh.marks, sorted(marks))]
        triangles = triangles[np.isin(triangles, points).all(axis=1)]
        if not len(triangles):
            continue
        nodes[name] = np.searchsorted(points, np.unique(triangles))
        areas = triangle_quality(mesh.shown, triangles).area
        centres[name] = np.average(mesh.shown[triangles].mean(axis=1), axis=0, weights=areas)
    return _Muscle(own, points, basis, matrix, nodes, centres)


def _solve(muscle: _Muscle, ends: Sequence[tuple[Labels, float]], load: Values | float = 0.0) -> Values:
    """Return the solution of Laplace's equation with given values at some points, and a load."""
    values = np.zeros(len(muscle.points))
    for nodes, value in ends:
        values[nodes] = value
    fixed = np.unique(np.concatenate([nodes for nodes, _ in ends]))
    matrix, right_side, _, free = condense(muscle.matrix, load + np.zeros_like(values), x=values, D=fixed)
    values[free], figures = solve(matrix, right_side, math.inf)
    if not figures["multigrid"]["converged"]:
        raise StageError(*_UNSOLVED)
    return values


def _harmonic(muscle: _Muscle, values: Values) -> Harmonic:
    """Return values and gradients at the centroids.

    The gradients are means of those at the points. These are nearer to the exact ones than the
    gradient of a linear element, which is zero if all its points are on one boundary.
    """
    corners, volumes = muscle.basis.mesh.t, muscle.basis.dx[:, 0]
    around = np.bincount(corners.ravel(), np.tile(volumes, 4))
    gradients = [
        (np.bincount(corners.ravel(), np.tile(volumes * component, 4)) / around)[corners].mean(axis=0)
        for component in muscle.basis.interpolate(values).grad[:, :, 0]
    ]
    return Harmonic(values[corners].mean(axis=0), np.column_stack(gradients))


def _points_on(muscle: _Muscle, *names: str) -> Labels:
    """Return the points on the named boundaries. Boundaries that are not given are skipped."""
    return np.concatenate([muscle.nodes[name] for name in names if name in muscle.nodes])


def _apicobasal(muscle: _Muscle, up: Points, apex: Labels, base: Labels) -> Values:
    """Return the distance from the apex over the sum of the distances from apex and base.

    Distances are lengths along the apicobasal directions, in the least-squares sense: the gradient
    of a distance is the unit vector of the direction. The harmonic function itself is no
    coordinate, because it depends on the size of the tetrahedra at the apex, a single point.
    """
    load = FLOW.assemble(muscle.basis, current=unit(up).T[:, :, None])
    below, above = (
        np.maximum(_solve(muscle, [(nodes, 0.0)], sign * load), 0.0) for nodes, sign in ((apex, 1.0), (base, -1.0))
    )
    # both distances can be 0 at the base
    from_base = np.divide(above, below + above, out=np.zeros_like(above), where=above > 0.0)
    return np.asarray(1.0 - from_base)


def _along(muscle: _Muscle, apex: Labels) -> tuple[Points, Values]:
    """Return apicobasal gradients, and the weight of the ventricles in the angles (Doste et al.).

    The weight is harmonic: 0 at ``outflow``, and 1 at ``base`` and at points that are closer to the
    apex than to ``outflow``. In the paper, it is 1 at the apex only. The effect of a single point
    depends on the size of the tetrahedra.
    """
    base, outflow = muscle.nodes["base"], muscle.nodes.get("outflow")
    up = _harmonic(muscle, _solve(muscle, [(base, 1.0), (apex, 0.0)])).gradients
    if outflow is None:
        return up, np.ones(len(up))
    out = _harmonic(muscle, _solve(muscle, [(outflow, 1.0), (apex, 0.0)])).gradients
    near = np.flatnonzero(_apicobasal(muscle, out, apex, outflow) < 0.5)
    share = _harmonic(muscle, _solve(muscle, [(outflow, 0.0), (base, 1.0), (near, 1.0)])).values
    return share[:, None] * up + (1.0 - share[:, None]) * out, share


def _along_both(
    muscle: _Muscle, mesh: MarkedMesh, members: Mapping[str, Members], apices: Sequence[Labels], right: Values
) -> tuple[Points, Values]:
    """Return the results of :func:`_along` in two ventricles, each with its own apex.

    Each ventricle is solved alone, because the flow from the base to an apex would otherwise cross
    from one ventricle to the other. The domains overlap where the share of the right ventricle is
    1/4 to 3/4; there, directions and weights change linearly with the share. Without a base in its
    domain, a ventricle takes the solution of the whole muscle.
    """
    weight = np.clip(2.0 * right - 0.5, 0.0, 1.0)
    along, share = np.zeros((len(right), 3)), np.zeros(len(right))
    total = np.zeros(len(right))
    for apex, own in zip(apices, (1.0 - weight, weight), strict=True):
        part = _muscle(mesh, muscle.cells[own > 0.0], members)
        if "base" not in part.nodes or not np.isin(muscle.points[apex], part.points).all():
            part = muscle
        here = np.searchsorted(muscle.cells, part.cells)
        found, found_share = _along(part, np.searchsorted(part.points, muscle.points[apex]))
        along[here] += own[here][:, None] * np.where(is_level(found)[:, None], 0.0, unit(found))
        share[here] += own[here] * found_share
        total[here] += own[here]
    return along, share / np.maximum(total, 1e-300)


def _angles(arguments: FibreArguments, epi: Values, share: Values) -> list[Values]:
    """Return helix and sheet angles of the left and the right ventricle, shape ``(2, m)`` each."""
    sheet, outflow = between(arguments.sheet, epi), arguments.helix_outflow
    ends = ((arguments.helix, outflow), (arguments.helix_rv or arguments.helix, arguments.helix_outflow_rv or outflow))
    return [np.stack([share * between(helix, epi) + (1.0 - share) * between(out, epi), sheet]) for helix, out in ends]


def _rotational(muscle: _Muscle, apex: Points, top: Points, zero: Points | None) -> Values:
    """Return angles about the axis from the apex to ``top``, degrees, -180 to 180.

    ``zero`` is the direction of 0. Without it, 0 is along the x axis, or the y axis if x is nearly
    parallel to the axis.
    """
    axis = top - apex
    axis /= np.linalg.norm(axis)
    zero = np.eye(3)[int(abs(axis[0]) > 0.9)] if zero is None else zero
    zero = zero - (zero @ axis) * axis
    out = muscle.basis.mesh.p.T - apex
    return np.asarray(np.degrees(np.arctan2(out @ np.cross(axis, zero), out @ zero)))


def map_fibres(
    arguments: FibreArguments, members: Mapping[str, Members], mesh: MarkedMesh, context: Context
) -> MarkedMesh:
    """Return the mesh with the fields of the module's description.

    Vectors are zero and coordinates NaN outside the largest connected piece of the muscle.

    Parameters
    ----------
    arguments
        The options.
    members
        See :func:`.find_boundaries`.
    mesh
        Straight tetrahedra.
    context
        For the results and warnings.

    Raises
    ------
    StageError
        If a boundary has no triangle there.
    """
    number = next((row["region"] for row in mesh.table if row["material"] == arguments.material), None)
    own = np.flatnonzero(np.ones(len(mesh.regions), dtype=bool) if mesh.materials is None else mesh.regions == number)
    if not len(own):
        context.warn(f"{arguments.material} has no tetrahedra, so there are no fibres")
        return mesh
    muscle = _muscle(mesh, own, members)
    if missing := [option_name(name) for name in members if name not in muscle.nodes]:
        raise StageError(
            f"the largest connected piece of {arguments.material} ({len(muscle.cells)} of {len(own)} tetrahedra) has no "
            f"triangle of {' and '.join(missing)}",
            WHY,
            "remove small pieces from the labels, or choose another set",
        )
    apices = _apices(muscle, arguments)
    along, share = _along(muscle, apices[0])
    coordinates = _coordinates(muscle, along, apices)
    epi, rv = _harmonic(muscle, coordinates["transmural"]), None
    if "endo_rv" in muscle.nodes:
        ends = [(_points_on(muscle, "endo", "epi"), 0.0), (muscle.nodes["endo_rv"], 1.0)]
        rv = _harmonic(muscle, _solve(muscle, ends))
        along, share = _along_both(muscle, mesh, members, apices, ventricle_share(epi, rv))
    vectors = directions(along, epi, rv, *_angles(arguments, epi.values, share))
    named = zip(("fibre", "sheet", "sheet_normal"), vectors, strict=True)
    fields = {name: _spread(found, muscle.cells, len(mesh.regions), 0.0) for name, found in named}
    at_points = {name: _spread(found, muscle.points, len(mesh.points), np.nan) for name, found in coordinates.items()}
    counts = (len(own), len(muscle.cells), int(is_level(along).sum()))
    _report(arguments, [muscle.basis.mesh.p.T[apex[0]] for apex in apices], counts, context)
    context.results["fibres"]["helix_by_depth"] = helix_by_depth(vectors[0], along, epi, rv)
    return replace(mesh, fields=mesh.fields | fields, point_fields=at_points)


def _coordinates(muscle: _Muscle, along: Points, apices: Sequence[Labels]) -> dict[str, Values]:
    """Return the coordinates of the points by name; ``along`` belongs to the left apex."""
    nodes, centres, (apex, *others) = muscle.nodes, muscle.centres, [muscle.basis.mesh.p.T[own[0]] for own in apices]
    to_right = centres["endo_rv"] - apex if others else None
    found = {
        "apicobasal": _apicobasal(muscle, along, apices[0], _points_on(muscle, "base", "outflow")),
        "transmural": _solve(muscle, [(_points_on(muscle, "endo", "endo_rv"), 0.0), (nodes["epi"], 1.0)]),
        "rotational": _rotational(muscle, apex, centres["base"], to_right),
    }
    for right in others:
        from_left = centres["endo_rv"] - centres["endo"]
        found["rotational_rv"] = _rotational(muscle, right, centres["endo_rv"], from_left)
        found["transventricular"] = _solve(muscle, [(nodes["endo"], -1.0), (nodes["endo_rv"], 1.0)])
    return found


def _spread(values: Values, where: Labels, count: int, rest: float) -> Values:
    """Return values of some tetrahedra or points, and ``rest`` for the others."""
    found = np.full((count, *values.shape[1:]), rest)
    found[where] = values
    return found


def _apices(muscle: _Muscle, arguments: FibreArguments) -> list[Labels]:
    """Return the point at the apex of each ventricle, shape ``(1,)``; see the arguments."""
    points, epi, base = muscle.basis.mesh.p.T, muscle.nodes["epi"], _points_on(muscle, "base", "outflow")

    def nearest(wanted: Points | tuple[float, ...], among: Labels) -> Labels:
        return np.asarray(among[[np.linalg.norm(points[among] - wanted, axis=1).argmin()]])

    def lowest(name: str) -> Labels:
        away, _ = KDTree(points[base]).query(points[muscle.nodes[name]])
        return np.asarray(muscle.nodes[name][[away.argmax()]])

    off_base = np.setdiff1d(np.arange(len(points)), base)
    found = [lowest("epi") if arguments.apex is None else nearest(arguments.apex, off_base)]
    if "endo_rv" in muscle.nodes:
        right = arguments.apex_rv
        found.append(nearest(points[lowest("endo_rv")[0]], epi) if right is None else nearest(right, off_base))
    return found


def _report(arguments: FibreArguments, apices: list[Points], counts: tuple[int, int, int], context: Context) -> None:
    """Add the fibres to the report; warn of tetrahedra without them, and of arbitrary ones."""
    total, connected, level = counts
    if lost := total - connected:
        context.warn(f"{lost} tetrahedra of {arguments.material} are not connected to the rest and get no fibres")
    if level:
        context.warn(
            f"{level} tetrahedra of {arguments.material} get arbitrary fibres, because no direction there leads from "
            "the apex to the base, as in a flap with all its points on --base; check --base"
        )
    context.results["fibres"] = {
        **arguments.parameters(),
        **{name: apex.tolist() for name, apex in zip(("apex_mm", "apex_rv_mm"), apices, strict=False)},
        "tetrahedra": connected,
        "not_connected": lost,
        "arbitrary": level,
    }
    places = " and ".join(f"({', '.join(f'{x:.4g}' for x in apex)})" for apex in apices)
    context.closing.append(("fibres", f"{connected:,} tetrahedra, apex at {places}"))

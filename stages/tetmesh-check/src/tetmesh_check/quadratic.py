"""Tetrahedra with ten nodes: those amid the edges of the surface lie on F = 0, and the map of every element can be inverted everywhere.

The Jacobian determinant of a quadratic tetrahedron is a cubic polynomial. It is nowhere below the smallest of its 20 Bezier coefficients,
and their mean is six times the volume (Johnen, Remacle, Geuzaine 2013, Geometrical validity of curvilinear finite elements, J. Comput.
Phys. 233). Where a node on the surface would press that bound too far down, it is drawn back toward the middle of its edge.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import combinations_with_replacement, product
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.checks import Check, verdict
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.quality import Cells, Points, Values, signed_tetrahedron_volumes, summarize
from tetmesh_check.regions import CAP, SURFACE
from tetmesh_check.spline import DistanceField

EDGES = ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3))
"""Edges of a tetrahedron in the order in which VTK, Abaqus, FEBio and XDMF have its nodes 5 to 10."""
FACE_EDGES = ((0, 1), (1, 2), (2, 0))
"""Edges of a triangle in the order of its nodes 4 to 6."""
LEAST_JACOBIAN = 0.1
"""Smallest bound of the Jacobian over that of the straight tetrahedron to which a node on the surface may press an element: where Gmsh's own
optimisation of high-order meshes begins to work (Mesh.HighOrderThresholdMin)."""
LONGEST_MOVE = 0.25
"""How far a node may go from the middle of its edge, over the edge: the height of an arc that turns by 106 degrees. More is another sheet."""
HALVINGS = 5
"""How often a node is drawn back by half before it goes to the middle of its edge: what is left then is 3 % of an arc's height."""
_BLOCK = 1 << 13


def _gathering() -> NDArray[np.float64]:
    """From the 64 determinants of columns of three of the four matrices to the mean over each unordered choice, shape ``(64, 20)``."""
    unordered = {triple: k for k, triple in enumerate(combinations_with_replacement(range(4), 3))}
    matrix = np.zeros((64, len(unordered)))
    for row, triple in enumerate(product(range(4), repeat=3)):
        matrix[row, unordered[tuple(sorted(triple))]] = 1.0  # type: ignore[index]
    mean: NDArray[np.float64] = matrix / matrix.sum(axis=0)
    return mean


_GATHERING = _gathering()


def jacobian_coefficients(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bezier coefficients of the Jacobian determinant of quadratic tetrahedra, mm^3, shape ``(m, 20)``.

    Parameters
    ----------
    nodes
        Positions of their nodes in VTK order, mm, shape ``(m, 10, 3)``.
    """
    found = np.empty((len(nodes), 20))
    for start in range(0, len(nodes), _BLOCK):
        found[start : start + _BLOCK] = _coefficients(nodes[start : start + _BLOCK])
    return found


def _coefficients(nodes: NDArray[np.float64]) -> NDArray[np.float64]:
    # x = sum of c_ij l_i l_j over barycentric coordinates l; the derivative along l_i - l_0 is 2 sum of (c_ik - c_0k) l_k
    control = np.empty((len(nodes), 4, 4, 3))
    for i in range(4):
        control[:, i, i] = nodes[:, i]
    for edge, (i, j) in enumerate(EDGES):
        control[:, i, j] = control[:, j, i] = 2.0 * nodes[:, 4 + edge] - 0.5 * (nodes[:, i] + nodes[:, j])
    columns = 2.0 * (control[:, 1:] - control[:, :1])
    crossed = np.cross(columns[:, 1, :, None], columns[:, 2, None, :])
    determinants = np.einsum("max,mbcx->mabc", columns[:, 0], crossed)
    coefficients: NDArray[np.float64] = determinants.reshape(len(nodes), 64) @ _GATHERING
    return coefficients


@dataclass(frozen=True)
class Quadratic:
    """The mesh, and how its nodes came to lie where they do."""

    mesh: MarkedMesh
    jacobian: Values
    """Smallest Bezier coefficient of each element's Jacobian over that of the straight tetrahedron, shape ``(m,)``; 1 where it is straight."""
    results: dict[str, Any]
    """For the report."""

    def checks(self) -> list[Check]:
        """Judge the elements."""
        folded, off = self.results["folded"], self.results["not_on_surface"]
        return [
            verdict(
                "quadratic_jacobian",
                folded == 0,
                folded,
                0,
                f"{folded} quadratic tetrahedra may have a Jacobian that is not positive everywhere",
            ),
            verdict(
                "nodes_on_surface",
                off == 0,
                off,
                0,
                f"{off} of {self.results['surface_nodes']} mid-edge nodes of the surface do not lie on F = 0: "
                f"{self.results['drawn_back']} were moved back so that no element folds, {self.results['too_far']} are too "
                "far from it",
                required=False,
            ),
        ]


def _mid_edges(tetrahedra: Cells, faces: Cells, first: int) -> tuple[Cells, Cells, Cells]:
    """The edges (pairs of vertices, ascending), and the number of each edge of tetrahedra and faces; nodes count from ``first``."""

    def keys(cells: Cells, edges: tuple[tuple[int, int], ...]) -> NDArray[np.int64]:
        pairs = np.sort(cells[:, np.array(edges)], axis=2)
        return pairs[..., 0] * first + pairs[..., 1]

    of_cells = keys(tetrahedra, EDGES)
    unique, numbers = np.unique(of_cells, return_inverse=True)
    of_faces = np.searchsorted(unique, keys(faces, FACE_EDGES))
    return np.column_stack([unique // first, unique % first]), numbers.reshape(of_cells.shape), of_faces


def _distances(field: DistanceField, points: Points) -> Values:
    """First-order distance from F = 0, mm."""
    value, gradient = field.at(points)
    distances: Values = np.abs(value) / np.maximum(np.linalg.norm(gradient, axis=1), 1e-12)
    return distances


def make_quadratic(mesh: MarkedMesh, field: DistanceField) -> Quadratic:
    """Put a node amid each edge: on F = 0 on the surface, in the middle elsewhere and on the flat caps.

    Parameters
    ----------
    mesh
        Linear tetrahedra of one object.
    field
        F.
    """
    count = len(mesh.points)
    ends, of_cells, of_faces = _mid_edges(mesh.tetrahedra, mesh.boundary, count)
    chords = mesh.points[ends].mean(axis=1)
    wanted = np.zeros(len(ends), dtype=bool)
    wanted[of_faces[mesh.marks == SURFACE]] = True
    wanted[of_faces[mesh.marks == CAP]] = False
    lengths = np.linalg.norm(mesh.points[ends[:, 0]] - mesh.points[ends[:, 1]], axis=1)
    target = chords.copy()
    arrived = np.zeros(len(ends), dtype=bool)
    target[wanted], arrived[wanted] = field.project(chords[wanted], LONGEST_MOVE * lengths[wanted])

    share = np.where(arrived, 1.0, 0.0)
    jacobian = np.ones(len(mesh.tetrahedra))
    straight = 6.0 * signed_tetrahedron_volumes(mesh.points, mesh.tetrahedra)
    volume = straight / 6.0
    look = np.flatnonzero(arrived[of_cells].any(axis=1) & (straight > 0.0))
    while len(look):
        middle = chords + share[:, None] * (target - chords)
        nodes = np.concatenate([mesh.points[mesh.tetrahedra[look]], middle[of_cells[look]]], axis=1)
        coefficients = jacobian_coefficients(nodes)
        jacobian[look] = coefficients.min(axis=1) / straight[look]
        volume[look] = coefficients.mean(axis=1) / 6.0
        pressed = look[jacobian[look] < LEAST_JACOBIAN]
        moved = np.zeros(len(ends), dtype=bool)
        moved[of_cells[pressed]] = True
        moved &= share > 0.0
        share[moved] *= 0.5
        share[share < 0.5**HALVINGS] = 0.0
        look = np.flatnonzero(moved[of_cells].any(axis=1) & (straight > 0.0))
    middle = chords + share[:, None] * (target - chords)

    on_surface = np.unique(mesh.boundary[mesh.marks == SURFACE])
    results = {
        "nodes": count + len(ends),
        "surface_nodes": int(wanted.sum()),
        "not_on_surface": int((wanted & (share < 1.0)).sum()),
        "drawn_back": int((arrived & (share < 1.0)).sum()),
        "too_far": int((wanted & ~arrived).sum()),
        "distance_mm": {
            "vertices": summarize(_distances(field, mesh.points[on_surface])),
            "middles_of_edges": summarize(_distances(field, chords[wanted])),
            "mid_edge_nodes": summarize(_distances(field, middle[wanted])),
        },
        "volume_mm3": float(volume.sum()),
        "volume_change_percent": float(100.0 * (volume.sum() / (straight.sum() / 6.0) - 1.0)),
        "jacobian": summarize(jacobian, np.linspace(0.0, 1.0, 51)),
        "folded": int(((straight <= 0.0) | (jacobian <= 0.0)).sum()),
    }
    curved = replace(
        mesh,
        points=np.concatenate([mesh.points, middle]),
        middle=of_cells + count,
        boundary_middle=of_faces + count,
    )
    return Quadratic(curved, jacobian, results)

"""Measures the parts of the boundary and the sets for the report."""

from __future__ import annotations

from typing import Any

import numpy as np

from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.parts.model import Parts
from tetmesh_check.quality import Labels, Points, centres_of

MIN_FLATNESS = 0.1
"""Minimum length of the mean normal of a part: 1 if it is flat, 0.5 if it is half a sphere. Below
it, the part is nearly closed or a tube, and its mean normal is noise."""


def _measured(members: Labels, vectors: Points, centres: Points, triangles: int) -> dict[str, Any]:
    """Return measures of some faces. Faces with indices below ``triangles`` are triangles."""
    areas = np.linalg.norm(vectors[members], axis=1)
    area, total = float(areas.sum()), vectors[members].sum(axis=0)
    length = float(np.linalg.norm(total))
    return {
        "triangles": int((members < triangles).sum()),
        **({"quadrilaterals": quads} if (quads := int((members >= triangles).sum())) else {}),
        "area_mm2": area,
        "centre_mm": (areas @ centres[members] / area).tolist() if area else None,
        "normal": (total / length).tolist() if area and length > MIN_FLATNESS * area else None,
    }


def describe_parts(parts: Parts, mesh: MarkedMesh) -> dict[str, Any]:
    """Return the parts and the sets with area, centre and mean normal, weighted by area.

    Centres and normals are in the world frame of the output. A normal points away from the material
    behind the part; it is ``None`` for closed parts and tubes.

    Parameters
    ----------
    parts
        The parts.
    mesh
        The mesh with their marks.
    """
    # half the cross product of the diagonals of a quadrilateral; a triangle repeats a node
    corners = mesh.shown[np.concatenate([mesh.boundary[:, [0, 1, 2, 2]], mesh.quads])]
    vectors = 0.5 * np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    centres = np.concatenate([centres_of(mesh.shown, mesh.boundary), centres_of(mesh.shown, mesh.quads)])
    order = np.argsort(mesh.marks, kind="stable")
    ends = np.searchsorted(mesh.marks[order], [part.number + offset for part in parts.rows for offset in (0, 1)])
    own = {part.number: order[ends[2 * k] : ends[2 * k + 1]] for k, part in enumerate(parts.rows)}
    names = {part.number: part.name for part in parts.rows}
    return {
        "parts": [
            {
                "number": part.number,
                "name": part.name,
                "kind": part.kind,
                "between": [parts.names[part.inside], parts.names[part.outside]],
                **_measured(own[part.number], vectors, centres, len(mesh.faces)),
            }
            for part in parts.rows
        ],
        "sets": [
            {
                "name": union.name,
                "expression": union.text,
                "parts": [names[number] for number in sorted(union.members)],
                **_measured(
                    np.concatenate([own[number] for number in sorted(union.members)]),
                    vectors,
                    centres,
                    len(mesh.faces),
                ),
            }
            for union in parts.unions
        ],
    }

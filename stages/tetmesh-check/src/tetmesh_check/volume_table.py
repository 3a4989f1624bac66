"""One table of volumes by material: of voxels, F, surface mesh and tetrahedra."""

from __future__ import annotations

import json
from typing import Any

import pyvista as pv

from tetmesh_check.datasets import text_of

COLUMNS = ("voxels_mm3", "field_mm3", "mesh_mm3", "tetrahedra_mm3")
"""Keys of a row, in the order in which the volumes are made."""


def told_volumes(surface: pv.PolyData) -> list[dict[str, Any]]:
    """Read the rows that ``reconstruct`` leaves in the note of a surface, if any.

    Parameters
    ----------
    surface
        The file as read.
    """
    try:
        rows = json.loads(text_of(surface, "meta") or "{}")["volumes"]
        return [{"name": str(row["name"]), **{key: row.get(key) for key in COLUMNS}} for row in rows]
    except (ValueError, KeyError, TypeError, AttributeError):
        return []


def with_changes(row: dict[str, Any]) -> dict[str, Any]:
    """Add ``change_percent``: each volume against the first that is known.

    Parameters
    ----------
    row
        The volumes of an object or a material, mm^3; ``None`` where one is not known.
    """
    known = {key: float(row[key]) for key in COLUMNS if row.get(key) is not None}
    first, *others = known
    changes = {key: 100.0 * (known[key] / known[first] - 1.0) for key in others} if known[first] > 0.0 else {}
    return {**row, "change_percent": changes}


def volume_table(told: list[dict[str, Any]], tetrahedra: dict[str, float]) -> list[dict[str, Any]]:
    """Complete the rows of a surface with the volumes of its tetrahedra.

    Parameters
    ----------
    told
        Those of :func:`told_volumes`.
    tetrahedra
        Volume by material, mm^3; the one value of an object whatever its name.
    """
    alone = next(iter(tetrahedra.values())) if len(told) == len(tetrahedra) == 1 else None
    return [with_changes({**row, "tetrahedra_mm3": tetrahedra.get(row["name"], alone)}) for row in told]

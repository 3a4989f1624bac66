"""The report of a mesh."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

FAULTS = (
    "open_edges",
    "non_manifold_edges",
    "non_manifold_vertices",
    "badly_oriented_edges",
    "inward_components",
    "self_intersections",
    "zero_area_triangles",
    "repeated_triangles",
    "turned_triangles",
    "distant_vertices",
    "poor_triangles",
    "missing_segments",
    "spurious_junction_edges",
)
"""Counts in the report of ``reconstruct`` that are 0 for a valid surface."""


class Quality(NamedTuple):
    """The shape of the triangles."""

    triangles: int
    """The number of triangles."""
    radius_ratio_min: float
    """The minimum radius ratio: twice the inradius over the circumradius, 1 if equilateral."""
    radius_ratio_mean: float
    """The mean radius ratio."""
    angle_min: float
    """The minimum angle in degrees."""
    angle_max: float
    """The maximum angle in degrees."""
    edge_length_min: float
    """The minimum edge length in mm."""
    edge_length_mean: float
    """The mean edge length in mm."""
    edge_length_max: float
    """The maximum edge length in mm."""


class Volume(NamedTuple):
    """The volume of an object or a material in mm^3."""

    name: str
    """The name of the material, or ``object``."""
    voxels_mm3: float | None
    """The volume of its voxels; None if the image contains no labels."""
    field_mm3: float | None
    """The volume in the distance field, after a scale has removed details."""
    mesh_mm3: float | None
    """The volume inside the surface."""


class Report(NamedTuple):
    """The findings of the stages."""

    failed_checks: list[str]
    """The failed checks of all stages, in words."""
    warnings: list[str]
    """The warnings of all stages."""
    faults: dict[str, int]
    """The number of faults of the surface by kind, such as ``open_edges``; 0 if it is valid."""
    quality: Quality
    """The shape of the triangles."""
    volumes: list[Volume]
    """The volume of each material before and after each stage."""
    voxels_changed: int
    """The number of voxels whose centre a scale has moved to another material."""
    stages: dict[str, dict[str, Any]]
    """The reports of the programs, by their names."""


def read_report(stages: Mapping[str, dict[str, Any]]) -> Report:
    """Read the reports of the stages."""
    distance, surface = (stages[name]["results"] for name in ("distfield", "reconstruct"))
    check = surface["check"]
    scaled = (distance.get("meta") or {}).get("scale_changes") or distance
    volumes = ({"voxels_mm3": None, "field_mm3": None, "mesh_mm3": None} | row for row in surface["volumes"])
    return Report(
        failed_checks=[check for report in stages.values() for check in report["failed_checks"]],
        warnings=[warning for report in stages.values() for warning in report["warnings"]],
        faults={name: check[name] for name in FAULTS},
        quality=Quality(**{name: check["quality"][name] for name in Quality._fields}),
        volumes=[Volume(**row) for row in volumes],
        voxels_changed=scaled.get("voxels_changed", 0),
        stages=dict(stages),
    )

"""The run for the surface of one object."""

from __future__ import annotations

from typing import Any

import numpy as np

from tetmesh_check.checks import Check, object_checks, shape_checks
from tetmesh_check.distance import distances_both_ways, summarize_distances
from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import MarkedMesh, object_mesh
from tetmesh_check.export.vtk import write_quadratic
from tetmesh_check.fem.forward import resolve_source
from tetmesh_check.fem.solve import VolumeMesh
from tetmesh_check.quadratic import make_quadratic
from tetmesh_check.quality import (
    Labels,
    TetrahedronQuality,
    centres_of,
    summarize_all,
    triangle_quality,
)
from tetmesh_check.regions import CAP, boundary_marks, check_labels, meshed_labels, regions_of, share_outside
from tetmesh_check.subject import Subject
from tetmesh_check.surface import check_surface
from tetmesh_check.tets.fill import Task, fill
from tetmesh_check.topology import changed_triangles, measure_topology, tetrahedron_boundary
from tetmesh_check.volume_table import volume_table

MAX_SHARE_OUTSIDE = 0.05
"""Share of the tetrahedra outside the label volume above which there is a warning."""
ENVELOPE_FRACTION = 0.05
"""Default envelope, relative to the edge length that 95 % of the surface exceeds. It is small
enough to keep thin walls apart."""


class OneObject(Subject):
    """One object and its outside."""

    def check_surface(self) -> None:
        """Refuse a surface that is not closed, and labels that do not belong to it."""
        resolve_source(self.arguments.forward, None)
        surface, labels = self.inputs.surface, self.inputs.labels
        with self.context.step("check surface"):
            self.topology, self.components = check_surface(self.arguments.surface, surface)
            quality = triangle_quality(surface.points, surface.triangles)
            self.volume = float(self.components.volumes.sum())
            self.context.results["surface"] = {
                "topology": self.topology.as_dict(),
                "merged_points": surface.merged_points,
                "area_mm2": float(quality.area.sum()),
                "volume_mm3": self.volume,
                "bounding_box_diagonal_mm": surface.bounding_box_diagonal,
                "quality": summarize_all(quality),
            }
            if labels is not None:
                check_labels(surface.points, labels, meshed_labels(surface.history))

    def fill(self) -> None:
        """Fill the surface within the envelope."""
        arguments, surface, parameters = self.arguments, self.inputs.surface, self.context.parameters
        field, at_surface = self.inputs.edge_lengths(self.context)
        envelope = arguments.envelope
        if envelope is None:
            envelope = ENVELOPE_FRACTION * float(np.percentile(at_surface, 5))
        if envelope >= 0.1 * surface.bounding_box_diagonal:
            raise StageError(
                f"--envelope {envelope:g} mm is more than a tenth of the object "
                f"({surface.bounding_box_diagonal:.4g} mm across)",
                "the tetrahedra could differ from the object by that much",
                "choose a smaller envelope, or omit --envelope",
            )
        parameters["envelope"] = envelope
        parameters["max_distance"] = arguments.limits.distance(envelope)
        task = Task(
            surface=surface,
            components=self.components,
            field=field,
            tet_size_factor=arguments.tet_size_factor,
            method=arguments.method,
            envelope=envelope,
            stop_energy=arguments.stop_energy,
            max_passes=arguments.max_passes,
            max_seconds=arguments.max_seconds,
            limits=arguments.limits,
            log=arguments.log,
            keep_vertices=self.inputs.field is not None,
        )
        self.filled = fill(task, self.context)

    def measure(self) -> tuple[VolumeMesh, TetrahedronQuality]:
        """Measure the tetrahedra, and the distances of their boundary from the surface."""
        surface, results = self.inputs.surface, self.context.results
        points, tetrahedra, quality = self.filled.points, self.filled.tetrahedra, self.filled.quality
        with self.context.step("measure quality"):
            outside = tetrahedron_boundary(tetrahedra)
            self.mesh = mesh = VolumeMesh(points, tetrahedra, quality.volume, outside)
            topology = measure_topology(points, outside.triangles)
            missing, added = changed_triangles((surface.points, surface.triangles), (points, outside.triangles))
            used = len(np.unique(outside.triangles))
            results["volume"] = {
                **self.measured(mesh, quality),
                "boundary_kept": missing == added == 0,
                "boundary_triangles": {"missing": missing, "added": added},
                "boundary_topology": {**topology.as_dict(), "unused_vertices": 0, "vertices": used},
            }
            results["volumes"] = volume_table(surface.volumes, {"object": float(quality.volume.sum())})
        with self.context.step("measure distances"):
            ours, theirs = (points, outside.triangles), (surface.points, surface.triangles)
            to_surface, to_boundary = distances_both_ways(ours, theirs)
            results["distance_mm"] = {
                "boundary_to_surface": summarize_distances(to_surface),
                "surface_to_boundary": summarize_distances(to_boundary),
            }
        return mesh, quality

    def _regions(self, mesh: VolumeMesh) -> Labels:
        """Find the label of each tetrahedron; all 1 without a label volume."""
        labels = self.inputs.labels
        if labels is None:
            return np.ones(len(mesh.tetrahedra), dtype=np.int64)
        with self.context.step("regions"):
            centres = centres_of(mesh.points, mesh.tetrahedra)
            outside = share_outside(centres, labels)
            regions = regions_of(centres, labels, meshed_labels(self.inputs.surface.history))
        if outside > MAX_SHARE_OUTSIDE:
            self.context.warn(
                f"{100.0 * outside:.3g} % of the tetrahedra lie outside the label volume and get the region of "
                "the nearest voxel; check that the label volume belongs to this case (--labels-volume)"
            )
        self.context.results["regions"] = {
            str(label): {
                "tetrahedra": int((regions == label).sum()),
                "volume_mm3": float(mesh.volumes[regions == label].sum()),
                "voxels_mm3": float((labels.values == label).sum() * labels.voxel_volume),
            }
            for label in np.unique(regions).tolist()
        }
        return regions

    def mark(self) -> MarkedMesh:
        """Find the regions, and the triangles of the boundary that are caps."""
        mesh = self.mesh
        regions = self._regions(mesh)
        surface, outside = self.inputs.surface, mesh.boundary
        marks = boundary_marks(surface, mesh.points, outside.triangles)
        areas = triangle_quality(mesh.points, outside.triangles).area
        self.context.results["boundary"] = {
            name: {"triangles": int(own.sum()), "area_mm2": float(areas[own].sum())}
            for name, own in (("surface", marks != CAP), ("cap", marks == CAP))
        }
        known = None if self.inputs.labels is not None else meshed_labels(surface.history) or []
        return object_mesh(mesh.points, mesh.tetrahedra, regions, outside, marks, known)

    def checks(self) -> list[Check]:
        """Judge the tetrahedra against the surface."""
        results, limits = self.context.results, self.arguments.limits
        region = {
            "volume_mm3": results["volume"]["volume_mm3"],
            "surface_volume_mm3": self.volume,
            "parts": results["volume"]["bodies"],
            "surface_parts": int((self.components.volumes > 0).sum()),
        }
        return [
            *shape_checks(self.filled.quality, limits, {}),
            *object_checks(results, region, limits, self.context.parameters["max_distance"]),
        ]

    def curve(self, marked: MarkedMesh) -> tuple[MarkedMesh, list[Check]]:
        """Put a node on each edge, and write this mesh, with ``--order 2``."""
        if self.inputs.field is None:
            return super().curve(marked)
        path = self.arguments.quadratic
        with self.context.step("quadratic"):
            curved = make_quadratic(marked, self.inputs.field)
            write_quadratic(path, curved.mesh, curved.jacobian, self.context.history())
        found: dict[str, Any] = {"file": path.name, **curved.results}
        self.context.results["quadratic"] = found
        nodes, middles = (found["distance_mm"][key].get("max", 0.0) for key in ("mid_edge_nodes", "middles_of_edges"))
        told = (
            f"{found['nodes']:,} nodes, minimum Jacobian {float(curved.jacobian.min()):.2f}; surface nodes are at most "
            f"{nodes:.2g} mm from F = 0 (edge midpoints: {middles:.2g} mm)"
        )
        self.context.closing.append(("quadratic", told))
        return curved.mesh, curved.checks()

"""The common part of runs for one object and for many materials."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import Any

import numpy as np
from isoparticles._native import GridField

from tetmesh_check.arguments import Arguments
from tetmesh_check.checks import Check, poor_tetrahedra
from tetmesh_check.context import Context
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.fem.forward import Forward
from tetmesh_check.fem.solve import VolumeMesh
from tetmesh_check.labels import LabelVolume
from tetmesh_check.quality import TetrahedronQuality, Values, centres_of, summarize, summarize_all, triangle_quality
from tetmesh_check.sizing import SizingField, uniform_sizing_field
from tetmesh_check.surface import Surface


@dataclass(frozen=True)
class Inputs:
    """The files of a run, as read."""

    surface: Surface
    sizing: SizingField | None
    field: GridField | None
    """F, for quadratic tetrahedra."""
    labels: LabelVolume | None

    def edge_lengths(self, context: Context) -> tuple[SizingField, Values]:
        """Return the edge lengths everywhere, and those at the surface, mm."""
        surface = self.surface
        if self.sizing is not None:
            at_surface = self.sizing.at(surface.points)
            bins = np.linspace(0.0, float(at_surface.max()), 51)
            at = summarize(at_surface, bins)
            context.results["sizing"] = {"voxel_mm": self.sizing.grid.voxel, "at_surface": at}
            return self.sizing, at_surface
        lengths = triangle_quality(surface.points, surface.triangles).edge_length
        median = float(np.median(lengths))
        context.warn(
            f"no --sizefield was given: all tetrahedra get the median edge length of the surface, {median:.4g} mm"
        )
        return uniform_sizing_field(surface, median), lengths


class Subject(ABC):
    """The steps that differ between one object and many materials.

    Parameters
    ----------
    arguments, inputs, context
        Of the run.
    """

    def __init__(self, arguments: Arguments, inputs: Inputs, context: Context) -> None:
        self.arguments = arguments
        self.inputs = inputs
        self.context = context

    many = False
    """Whether there are several materials."""

    @abstractmethod
    def check_surface(self) -> None:
        """Refuse an invalid surface or arguments; report the surface."""

    @abstractmethod
    def fill(self) -> None:
        """Make the tetrahedra."""

    @abstractmethod
    def measure(self) -> tuple[VolumeMesh, TetrahedronQuality]:
        """Measure the tetrahedra; results of the volume."""

    @abstractmethod
    def mark(self) -> MarkedMesh:
        """Find regions and parts of the boundary; report the boundary."""

    @abstractmethod
    def checks(self) -> list[Check]:
        """Judge the measurements."""

    def curve(self, marked: MarkedMesh) -> tuple[MarkedMesh, list[Check]]:
        """Return the mesh to export, quadratic with ``order=2``, and its checks."""
        return marked, []

    def currents(self) -> Forward | None:
        """Return the problem of currents, if there is one."""
        return None

    def measured(self, mesh: VolumeMesh, quality: TetrahedronQuality) -> dict[str, Any]:
        """Return the measures of the volume that one object and many materials have in common."""
        points, tetrahedra = mesh.points, mesh.tetrahedra
        found = {
            "points": len(points),
            "tetrahedra": len(tetrahedra),
            "bodies": int(mesh.boundary.bodies.max()) + 1,
            "volume_mm3": float(quality.volume.sum()),
            "quality": summarize_all(quality),
            "boundary_quality": summarize_all(triangle_quality(points, mesh.boundary.triangles)),
            "poor_tetrahedra": poor_tetrahedra(points, tetrahedra, quality, self.arguments.limits),
        }
        if self.inputs.sizing is not None:
            wanted = self.arguments.tet_size_factor * self.inputs.sizing.at(centres_of(points, tetrahedra))
            found["edge_length_over_target"] = summarize(quality.edge_length / wanted, np.linspace(0.0, 3.0, 61))
        return found

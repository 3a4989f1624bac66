"""The run for a surface of many materials."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from tetmesh_check.arguments import Arguments
from tetmesh_check.checks import Check, complex_checks, shape_checks, smallest_elsewhere
from tetmesh_check.complex import Complex, check_complex, describe_complex
from tetmesh_check.conform import outside_of
from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import MarkedMesh, materials_mesh
from tetmesh_check.fem.forward import Forward, RegionMesh, Source, resolve_source
from tetmesh_check.fem.solve import VolumeMesh
from tetmesh_check.forced import find_forced, list_forced
from tetmesh_check.materials import NOTHING
from tetmesh_check.quality import (
    TetrahedronQuality,
    summarize_all,
)
from tetmesh_check.subject import Subject
from tetmesh_check.tets.materials_fill import ComplexTask, FilledComplex, fill_complex, refuse_method
from tetmesh_check.topology import members_of, tetrahedron_boundary
from tetmesh_check.volume_table import volume_table


def _part(quality: TetrahedronQuality, own: Any) -> TetrahedronQuality:
    return TetrahedronQuality(**{field.name: getattr(quality, field.name)[own] for field in fields(quality)})


def _regions(checked: Complex, filled: FilledComplex) -> list[dict[str, Any]]:
    """Measure each region: its volume against that of the surface, its parts, its tetrahedra."""
    listed = []
    members = members_of(filled.conformity.regions, len(checked.sides.table))
    for number in checked.sides.present:
        own = members[number]
        wanted = checked.shells.materials == number
        entry: dict[str, Any] = {
            "number": number,
            "name": checked.sides.names[number],
            "tetrahedra": len(own),
            "parts": len(np.unique(filled.conformity.parts[own])),
            "surface_parts": int(wanted.sum()),
            "volume_mm3": float(filled.quality.volume[own].sum()),
            "surface_volume_mm3": float(checked.shells.sizes[wanted].sum()),
        }
        if len(own):
            entry["quality"] = summarize_all(_part(filled.quality, own))
            entry["forced"] = int(filled.forced["min_dihedral"][own].sum())
        listed.append(entry)
    return listed


def refuse_arguments(arguments: Arguments) -> None:
    """Refuse what is for one object only, by name.

    Parameters
    ----------
    arguments
        The arguments.
    """
    refuse_method(arguments.method)
    if arguments.order != 1:
        raise StageError(
            f"--order {arguments.order} supports the surface of one object only, and this one has several materials",
            "the midpoints of junction edges would have to lie on the zero sets of several fields",
            "omit --order",
        )
    if arguments.labels_volume is not None:
        raise StageError(
            "--labels-volume supports the surface of one object only, and this one has several materials",
            "the triangles already define the region of each tetrahedron",
            "omit --labels-volume",
        )


class ManyMaterials(Subject):
    """Materials that share the triangles between them."""

    many = True

    def check_surface(self) -> None:
        """Refuse a surface that bounds no volumes; find triangles that force poor tetrahedra."""
        arguments, context, surface = self.arguments, self.context, self.inputs.surface
        assert surface.sides is not None, "the caller looked"
        self.field, _ = self.inputs.edge_lengths(context)
        refuse_arguments(arguments)
        self.source: Source | None = resolve_source(arguments.forward, surface.sides)
        with context.step("check surface"):
            self.checked = check_complex(arguments.surface, surface)
            counts = context.results["complex"] = describe_complex(self.checked)
        context.verbose(
            f"{len(self.checked.sides.present)} materials, {len(counts['interfaces'])} interfaces, "
            f"{counts['junction_edges']} junction edges, {len(self.checked.shells.materials)} volumes"
        )
        with context.step("find forced tetrahedra"):
            self.sides, self.needles = find_forced(self.checked, arguments.limits, context)

    def fill(self) -> None:
        """Fill all volumes at once."""
        arguments = self.arguments
        self.task = ComplexTask(
            checked=self.checked,
            sides=self.sides,
            needles=self.needles,
            field=self.field,
            tet_size_factor=arguments.tet_size_factor,
            method=arguments.method,
            max_seconds=arguments.max_seconds,
            limits=arguments.limits,
            log=arguments.log,
        )
        self.filled = fill_complex(self.task, self.context)

    def measure(self) -> tuple[VolumeMesh, TetrahedronQuality]:
        """Measure the tetrahedra, as a whole and by region, and what became of the interfaces."""
        checked, filled, results = self.checked, self.filled, self.context.results
        found, quality = filled.conformity, filled.quality
        with self.context.step("measure quality"):
            triangles, tetrahedra = checked.surface.triangles, filled.tetrahedra
            outside = outside_of(found, triangles) if found.faults == 0 else tetrahedron_boundary(tetrahedra)
            mesh = VolumeMesh(filled.points, tetrahedra, quality.volume, outside)
            results["volume"] = {
                **self.measured(mesh, quality),
                "interfaces_kept": found.missing == found.added == 0,
                "interface_triangles": {"missing": found.missing, "added": found.added},
                "crowded_faces": found.crowded,
                "undecided_tetrahedra": found.undecided,
                "forced_by_surface": list_forced(self.sides, "possible_degrees", checked, found, quality),
                "forced_by_triangle": list_forced(self.needles, "possible_scaled_jacobian", checked, found, quality),
                "smallest_elsewhere": smallest_elsewhere(quality, filled.forced),
                "regions": _regions(checked, filled),
            }
            filling = {entry["name"]: entry["volume_mm3"] for entry in results["volume"]["regions"]}
            results["volumes"] = volume_table(checked.surface.volumes, filling)
        return mesh, quality

    def mark(self) -> MarkedMesh:
        """Name the regions and the interfaces."""
        outermost = self.checked.sides.outside == NOTHING
        area = float(self.checked.quality.area[outermost].sum())
        self.context.results["boundary"] = {"surface": {"triangles": int(outermost.sum()), "area_mm2": area}}
        filled, triangles = self.filled, self.checked.surface.triangles
        return materials_mesh(filled.points, filled.tetrahedra, filled.conformity, triangles, self.checked.sides)

    def checks(self) -> list[Check]:
        """Judge the tetrahedra, and whether each region is that of the surface."""
        filled, context = self.filled, self.context
        interfaces = len(context.results["complex"]["interfaces"])
        context.closing.append(("materials", f"{len(self.checked.sides.present)}, {interfaces} interfaces"))
        limits = self.arguments.limits
        return [
            *shape_checks(filled.quality, limits, filled.forced),
            *complex_checks(context.results["volume"], limits),
        ]

    def currents(self) -> Forward | None:
        """Return the problem of currents if there is a source and all tetrahedra have materials."""
        found, sides = self.filled.conformity, self.checked.sides
        if self.source is None or found.faults:
            return None
        pairs, which = sides.pairs()
        names = [sides.pair_name((a, b)) for a, b in pairs.tolist()]
        triangles = self.checked.surface.triangles
        mesh = RegionMesh(found.regions, sides.names, triangles, found.behind, found.before, which, names)
        return Forward(self.source, mesh)

"""The run for a surface of many materials."""

from __future__ import annotations

from dataclasses import fields
from typing import Any

import numpy as np

from tetmesh_check.arguments import Arguments
from tetmesh_check.checks import (
    REMEDY,
    Check,
    Forced,
    Limits,
    counted,
    percent,
    shape_checks,
    smallest_elsewhere,
    verdict,
)
from tetmesh_check.complex import Complex, check_complex, describe_complex
from tetmesh_check.conform import NOBODY, outside_of
from tetmesh_check.context import Context
from tetmesh_check.errors import StageError
from tetmesh_check.export.mesh import RESERVED, MarkedMesh, Materials, plain_names
from tetmesh_check.fem.forward import Forward, RegionMesh, Source, resolve_source
from tetmesh_check.fem.solve import VolumeMesh
from tetmesh_check.forced import INSIDE, ForcedSides, forced_sides, largest_jacobians
from tetmesh_check.materials import NOTHING, Sides
from tetmesh_check.quality import (
    Cells,
    Labels,
    TetrahedronQuality,
    Values,
    centres_of,
    summarize_all,
)
from tetmesh_check.subject import Subject
from tetmesh_check.surface import Surface
from tetmesh_check.tets.materials_fill import ComplexTask, FilledComplex, fill_complex, on_needles, refuse_method
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
            entry["forced"] = int(filled.forced.dihedral[own].sum())
        listed.append(entry)
    return listed


def _sides(checked: Complex, limits: Limits, context: Context) -> ForcedSides:
    """Find the sides of triangles on which no tetrahedron reaches the limit of the dihedral angle.

    Warn if there are any.
    """
    sides, surface = checked.sides, checked.surface
    found = forced_sides(surface.points, surface.triangles, limits.min_dihedral)
    material = np.where(found.side == INSIDE, sides.inside[found.facet], sides.outside[found.facet])
    found, material = found.where(material != NOTHING), material[material != NOTHING]
    if len(found.facet):
        sharpest = int(found.bound.argmin())
        x, y, z = surface.points[surface.triangles[found.facet[sharpest]]].mean(axis=0)
        context.warn(
            f"on {counted(len(found.facet), 'triangle')}, no tetrahedron can reach the minimum dihedral angle of "
            f"{limits.min_dihedral:g} degrees (--min-dihedral), because other triangles meet them at a smaller angle "
            f"or lie close in front of them. The worst place allows {found.bound[sharpest]:.3g} degrees, in "
            f"{sides.names[material[sharpest]]} at ({x:.6g}, {y:.6g}, {z:.6g}) mm (all places: forced_by_surface in "
            f"the report); {REMEDY}"
        )
    return found


def _needles(checked: Complex, limits: Limits, context: Context) -> tuple[Labels, Values]:
    """Find the triangles on which no tetrahedron reaches both limits of shape.

    Also return the largest scaled Jacobian that each allows. Warn if there are any.
    """
    surface = checked.surface
    possible = largest_jacobians(surface.points, surface.triangles, limits.min_dihedral)
    found = np.flatnonzero(possible < limits.min_scaled_jacobian)
    if len(found):
        sharpest = found[int(possible[found].argmin())]
        x, y, z = surface.points[surface.triangles[sharpest]].mean(axis=0)
        context.warn(
            f"on {counted(len(found), 'triangle')} with a small angle, no tetrahedron can reach both a dihedral angle "
            f"of {limits.min_dihedral:g} degrees and a scaled Jacobian of {limits.min_scaled_jacobian:g} "
            "(--min-dihedral, --min-scaled-jacobian). The worst place allows a scaled Jacobian of "
            f"{possible[sharpest]:.3g}, at ({x:.6g}, {y:.6g}, {z:.6g}) mm (all places: forced_by_triangle in the "
            f"report); {REMEDY}"
        )
    return found, possible[found]


def _on_needles(task: ComplexTask, filled: FilledComplex) -> list[dict[str, Any]]:
    """List the tetrahedra on triangles with a small angle for the report, the sharpest first."""
    surface, (facets, possible) = task.checked.surface, task.needles
    centres = centres_of(surface.points, surface.triangles[facets])
    return [
        {
            "place_mm": centres[k].tolist(),
            "material": task.checked.sides.names[filled.conformity.regions[tetrahedron]],
            "possible_scaled_jacobian": float(possible[k]),
            "min_dihedral": float(filled.quality.min_dihedral[tetrahedron]),
            "min_scaled_jacobian": float(filled.quality.scaled_jacobian[tetrahedron]),
        }
        for tetrahedron, k in zip(*(found.tolist() for found in on_needles(task, filled.conformity)), strict=True)
    ]


def _forced_tetrahedra(sides: ForcedSides, checked: Complex, filled: FilledComplex) -> list[dict[str, Any]]:
    """List the tetrahedra on forced sides of triangles for the report, the sharpest first."""
    centres = centres_of(checked.surface.points, checked.surface.triangles[sides.facet])
    listed = []
    for k in np.argsort(sides.bound, kind="stable").tolist():
        tetrahedron = int(filled.standing[k])
        if tetrahedron == NOBODY:
            continue
        listed.append(
            {
                "place_mm": centres[k].tolist(),
                "material": checked.sides.names[filled.conformity.regions[tetrahedron]],
                "possible_degrees": float(sides.bound[k]),
                "min_dihedral": float(filled.quality.min_dihedral[tetrahedron]),
                "min_scaled_jacobian": float(filled.quality.scaled_jacobian[tetrahedron]),
            }
        )
    return listed


def interface_names(names: list[str], pairs: Cells) -> list[str]:
    """Names of interfaces in sets and groups, none that of a region.

    Parameters
    ----------
    names
        Names of the regions by number.
    pairs
        Numbers of the inside and of the outside of each interface.
    """
    return plain_names([f"{names[a]}_to_{names[b]}" for a, b in pairs.tolist()], [*RESERVED, *names])


def mark_materials(sides: Sides, surface: Surface, filled: FilledComplex) -> MarkedMesh:
    """Name the regions and the interfaces of a mesh for export.

    Parameters
    ----------
    sides
        The materials of the triangles.
    surface
        The surface, whose vertices come first in the mesh.
    filled
        The tetrahedra.
    """
    names = plain_names(sides.names)
    pairs, which = sides.pairs()
    materials = Materials(
        table=sides.table,
        regions={number: names[number] for number in sides.present},
        pairs=dict(enumerate(interface_names(names, pairs), 1)),
        before=filled.conformity.before,
    )
    return MarkedMesh(
        filled.points,
        filled.tetrahedra,
        filled.conformity.regions,
        surface.triangles,
        filled.conformity.behind,
        which + 1,
        materials,
    )


def complex_checks(
    results: dict[str, Any], quality: TetrahedronQuality, limits: Limits, forced: Forced | None = None
) -> list[Check]:
    """Judge a mesh of many materials.

    Parameters
    ----------
    results
        The measures, as in the report under ``volume``.
    quality
        Quality of its tetrahedra.
    limits
        The limits.
    forced
        The tetrahedra that the surface forces below a limit of shape; by default none.
    """
    regions = results["regions"]
    changes = {entry["name"]: 100.0 * (entry["volume_mm3"] / entry["surface_volume_mm3"] - 1.0) for entry in regions}
    worst = max(changes, key=lambda name: abs(changes[name]))
    apart = [entry for entry in regions if entry["parts"] != entry["surface_parts"]]
    triangles = results["interface_triangles"]
    return [
        *shape_checks(quality, limits, forced),
        verdict(
            "interfaces_kept",
            results["interfaces_kept"],
            triangles["missing"] + triangles["added"],
            0,
            f"the interfaces between materials lost {counted(triangles['missing'], 'triangle')} of the surface and "
            f"gained {counted(triangles['added'], 'other face')}",
        ),
        verdict(
            "conforming",
            results["crowded_faces"] == results["undecided_tetrahedra"] == 0,
            results["crowded_faces"] + results["undecided_tetrahedra"],
            0,
            f"{counted(results['crowded_faces'], 'face belongs', 'faces belong')} to more than two tetrahedra, "
            f"{counted(results['undecided_tetrahedra'], 'tetrahedron has', 'tetrahedra have')} no material",
        ),
        verdict(
            "region_parts",
            not apart,
            len(apart),
            0,
            f"{len(apart)} of {len(regions)} materials have more or fewer separate parts than in the surface"
            + "".join(
                f"; {entry['name']} has {entry['parts']} instead of {entry['surface_parts']}" for entry in apart[:3]
            ),
        ),
        verdict(
            "volume_change",
            abs(changes[worst]) <= limits.max_volume_change,
            changes[worst],
            limits.max_volume_change,
            "tetrahedra against the surface: the volume changes by "
            + ("0 %" if percent(changes[worst]) == "0 %" else f"at most {percent(changes[worst])} in {worst}")
            + f" (limit {limits.max_volume_change:g} %)",
        ),
    ]


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
            self.sides = _sides(self.checked, arguments.limits, context)
            self.needles = _needles(self.checked, arguments.limits, context)

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
                "forced_by_surface": _forced_tetrahedra(self.sides, checked, filled),
                "forced_by_triangle": _on_needles(self.task, filled),
                "smallest_elsewhere": {
                    "min_dihedral": smallest_elsewhere(quality.min_dihedral, filled.forced.dihedral),
                    "scaled_jacobian": smallest_elsewhere(quality.scaled_jacobian, filled.forced.jacobian),
                },
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
        return mark_materials(self.checked.sides, self.checked.surface, self.filled)

    def checks(self) -> list[Check]:
        """Judge the tetrahedra, and whether each region is that of the surface."""
        filled, context = self.filled, self.context
        interfaces = len(context.results["complex"]["interfaces"])
        context.closing.append(("materials", f"{len(self.checked.sides.present)}, {interfaces} interfaces"))
        return complex_checks(context.results["volume"], filled.quality, self.arguments.limits, filled.forced)

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

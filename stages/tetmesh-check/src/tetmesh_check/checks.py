"""Checks of a volume mesh: value, limit and verdict in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from isoparticles._native import Context
from numpy.typing import NDArray

from tetmesh_check.numerals import plain
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, centres_of
from tetmesh_check.topology import NOT_MANIFOLD

FIT_BUT_FOR = "fit but for "
"""Beginning of the warning that names accepted elements; the verdict and the page repeat it."""
REMEDY = (
    "to remove them, set a scale (SCALE, or SIZE or VERTICES without SCALE=0) or use smaller edges (SIZE, MIN_SIZE, "
    "more VERTICES); to accept them, use --accept-forced (ACCEPT_FORCED=yes)"
)
"""Remedies for elements that the triangles of the surface force below a limit."""
_NO_PERCENT = 5e-4
"""Changes below this, percent, are rounding errors and print as 0 %."""
_NO_DISTANCE = 1e-6
"""Distances below this share of their limit are rounding errors and print as 0 mm."""
SURFACE_CHANGES = {False: 5.0, True: 2.0}
"""Maximum change of volume from the voxels to the surface, percent, without a scale (``False``) and
with one (``True``).

``distfield`` warns of changes of F above the same limits (``VOLUME_LIMITS``,
``SCALED_VOLUME_LIMITS``)."""
_MOST_NAMES = 3
"""Most materials that a message names."""
SHAPE = {
    "min_dihedral": ("min_dihedral", "dihedral angle", " degrees"),
    "scaled_jacobian": ("min_scaled_jacobian", "scaled Jacobian", ""),
}
"""Measures of shape that have a limit: name of the limit and of its check, words, and unit."""
OfShape = dict[str, NDArray[np.bool_]]
"""For each measure in :data:`SHAPE`, a mask of tetrahedra, shape ``(m,)``."""
_REQUIRED = {
    "positive_volumes": "{value} of {total} tetrahedra are inverted or flat",
    "interfaces_kept": "the interfaces between materials lost {missing} of the surface and gained {added}",
    "conforming": "{crowded} to more than two tetrahedra, {undecided} no material",
    "region_parts": "{value} of {total} materials have more or fewer separate parts than in the surface{apart}",
    "volume_change": "tetrahedra against the surface: the volume changes by {told} (limit {limit:g} %){between}",
    "bodies": "the tetrahedra form {told}; the surface encloses {limit}",
    "boundary_distance": "the maximum distance from the boundary of the tetrahedra to the surface is {told}",
    "surface_distance": "the maximum distance from the surface to the boundary of the tetrahedra is {told}",
    "quadratic_jacobian": "{value} quadratic tetrahedra may have a Jacobian that is not positive everywhere",
    "gap_width": "{gap}: the distance between the sides is {told}, {off} % off (limit {limit:g} %)",
    "prism_jacobian": "{value} of {total} prisms may have a Jacobian that is not positive everywhere",
    "layer_faces": "{value} faces at the layers belong neither to two elements nor to one element and the boundary",
    "layer_caps": "nodes beside the layers are up to {told} mm off the planes of their caps",
    "layer_volume": "the layers change the volume by {told} (limit {limit:g} %)",
    "layer_thickness": (
        "{value} of {total} wall nodes have layers thinner than {least:g} % of the requested thickness "
        "(places: layers in the report)"
    ),
    "current_conserved": (
        "the currents into and out of a material differ by at most {value:.2g} of the maximum current (limit {limit:g})"
    ),
    "solve_converged": "conjugate gradients solved {told}",
}
"""Messages of the checks whose failure makes a mesh unfit."""
_DOUBTS = {
    "boundary_manifold": "{value} edges and vertices of the boundary are not manifold{but}",
    "euler_characteristic": "the Euler characteristic of the boundary is {value}, that of the surface {limit}{but}",
    "surface_volume": "surface against {base}: the volume changes by {told} (limit {limit:g} %)",
    "first_height": (
        "the first heights of full layers are {told} mm, up to {off} % off the requested height (limit {limit:g} %)"
    ),
    "nodes_on_surface": (
        "{value} of {surface_nodes} mid-edge nodes of the surface do not lie on {zero}: {drawn_back} were moved back "
        "so that no element folds, {not_reached} could not be moved onto it"
    ),
}
"""Messages of the checks whose failure is only a warning."""
_EXACT = ("bodies", "euler_characteristic")
"""Checks whose value must equal the limit. The absolute value of others must not exceed it."""


@dataclass(frozen=True)
class Limits:
    """Limits of a fit mesh."""

    min_dihedral: float = 5.0
    """Minimum dihedral angle, degrees. The condition number of the stiffness matrix grows with the
    inverse of its sine."""
    min_scaled_jacobian: float = 0.05
    """Minimum scaled Jacobian."""
    max_volume_change: float = 1.0
    """Maximum difference between the volume of the tetrahedra and that inside the surface,
    percent."""
    max_distance: float | None = None
    """Maximum distance between the boundary of the tetrahedra and the surface, in both directions,
    mm; default twice the envelope."""
    accept_forced: bool = False
    """Whether tetrahedra below a limit of shape pass where the surface forces them below it."""

    def distance(self, envelope: float) -> float:
        """Return the maximum distance for an envelope, mm."""
        return self.max_distance if self.max_distance is not None else 2.0 * envelope


@dataclass(frozen=True)
class Check:
    """The result of one check."""

    name: str
    """Short name. It is the same in all versions."""
    passed: bool
    """Whether the mesh is fit in this respect."""
    required: bool
    """Whether a failure makes the mesh unfit (exit code 1) or is only a warning."""
    value: float
    """The measured value."""
    limit: float
    """The limit of the value."""
    words: str
    """The message."""
    accepted: int = 0
    """Elements beyond the limit that pass because the user accepts them."""

    @property
    def verdict(self) -> str:
        """One of pass, warning and fail."""
        if self.passed:
            return "warning" if self.accepted else "pass"
        return "fail" if self.required else "warning"


def check(name: str, value: float, limit: float = 0, **told: Any) -> Check:
    """Compare a value with its limit, and return the result.

    Parameters
    ----------
    name
        Key of :data:`_REQUIRED` or :data:`_DOUBTS`.
    value, limit
        They must be equal for :data:`_EXACT`. For other checks, the limit applies to the absolute
        value.
    told
        Further values in the message of the check.
    """
    passed = value == limit if name in _EXACT else abs(value) <= limit
    words = (_REQUIRED | _DOUBTS)[name].format(value=value, limit=limit, **told)
    return Check(name, bool(passed), name in _REQUIRED, float(value), float(limit), words)


def below_limits(quality: TetrahedronQuality, limits: Limits) -> OfShape:
    """Find the tetrahedra below each limit of shape."""
    return {measure: getattr(quality, measure) < getattr(limits, name) for measure, (name, *_) in SHAPE.items()}


def well_shaped(quality: TetrahedronQuality, limits: Limits) -> bool:
    """Whether every tetrahedron is positive and within the limits of shape."""
    return bool(quality.volume.min() > 0) and not np.any([*below_limits(quality, limits).values()])


def smallest_elsewhere(quality: TetrahedronQuality, forced: OfShape) -> dict[str, float]:
    """Return each minimum without the forced tetrahedra; infinite if all are forced."""
    return {
        measure: float(getattr(quality, measure).min(where=~kept, initial=np.inf)) for measure, kept in forced.items()
    }


def shape_of(quality: TetrahedronQuality, tetrahedron: int) -> dict[str, float]:
    """Return the measures of one tetrahedron that have a limit, by their names in the report."""
    return {name: float(getattr(quality, measure)[tetrahedron]) for measure, (name, *_) in SHAPE.items()}


def poor_tetrahedra(
    points: Points, tetrahedra: Cells, quality: TetrahedronQuality, limits: Limits
) -> list[dict[str, Any]]:
    """List the tetrahedra below a limit of shape for the report, the flattest first.

    Parameters
    ----------
    points
        Positions, mm, shape ``(n, 3)``.
    tetrahedra
        Corners, shape ``(m, 4)``.
    quality
        The measures.
    limits
        The limits.
    """
    poor = np.flatnonzero(np.any([*below_limits(quality, limits).values()], axis=0))
    poor = poor[np.argsort(quality.min_dihedral[poor], kind="stable")]
    centres = centres_of(points, tetrahedra[poor])
    return [
        {"place_mm": place, **shape_of(quality, tetrahedron)}
        for tetrahedron, place in zip(poor.tolist(), centres.tolist(), strict=True)
    ]


def counted(count: int, thing: str, things: str = "") -> str:
    """Write a count with its noun, such as ``3 triangles``.

    Parameters
    ----------
    count
        The count.
    thing
        The noun in the singular.
    things
        The noun in the plural; by default ``thing`` with an ``s``.
    """
    return f"{count} {thing if count == 1 else things or f'{thing}s'}"


def percent(change: float) -> str:
    """Write a change with its sign, and rounding errors as 0 %.

    Parameters
    ----------
    change
        In percent.
    """
    return "0 %" if abs(change) < _NO_PERCENT else f"{'+' if change > 0 else ''}{plain(change)} %"


def shape_checks(quality: TetrahedronQuality, limits: Limits, forced: OfShape) -> list[Check]:
    """Judge the shape of the tetrahedra.

    Parameters
    ----------
    quality
        The measures.
    limits
        The limits.
    forced
        The tetrahedra that the surface forces below each limit; may be empty. They fail unless
        ``accept_forced`` is set.
    """
    checks = [check("positive_volumes", int((quality.volume <= 0).sum()), total=quality.volume.size)]
    for measure, below in below_limits(quality, limits).items():
        name, what, unit = SHAPE[measure]
        smallest, limit = float(getattr(quality, measure).min()), getattr(limits, name)
        count, on_surface = int(below.sum()), int((below & forced.get(measure, False)).sum())
        accepted = on_surface if limits.accept_forced else 0
        poor = counted(count, "tetrahedron is", "tetrahedra are")
        words = f"the minimum {what} is {plain(smallest)}{unit}; {poor} below the limit of {limit:g}"
        if on_surface:
            words += (
                f", {on_surface} of them forced by triangles of the surface (places: forced_by_surface and "
                "forced_by_triangle in the report)"
            )
        if accepted:
            words = f"{FIT_BUT_FOR}{counted(accepted, 'accepted tetrahedron', 'accepted tetrahedra')}: {words}"
        elif on_surface:
            words += f"; {REMEDY}"
        elif count:
            words += " (places: poor_tetrahedra in the report)"
        checks.append(Check(name, count == accepted, True, smallest, limit, words, accepted))
    return checks


def _change(before: float, after: float) -> float:
    """Return the change of a volume, percent."""
    return 100.0 * (after / before - 1.0)


def object_checks(results: dict[str, Any], bodies: int, limits: Limits, max_distance: float) -> list[Check]:
    """Judge the tetrahedra of one object against its surface, apart from their shape.

    Parameters
    ----------
    results
        The measures, as in the report.
    bodies
        Number of bodies that the surface bounds.
    limits
        The limits.
    max_distance
        Maximum distance between boundary and surface, mm.
    """
    volume, surface = results["volume"], results["surface"]
    boundary, wanted = volume["boundary_topology"], surface["topology"]["euler_characteristic"]
    euler, loose = boundary["euler_characteristic"], sum(boundary[key] for key in NOT_MANIFOLD)
    before, after = surface["volume_mm3"], volume["volume_mm3"]
    change, between = _change(before, after), f", from {plain(before)} mm^3 to {plain(after)} mm^3"
    checks = [
        check("volume_change", change, limits.max_volume_change, told=percent(change), between=between),
        check("bodies", volume["bodies"], bodies, told=counted(volume["bodies"], "separate body", "separate bodies")),
    ]
    for start, way in (("boundary", "boundary_to_surface"), ("surface", "surface_to_boundary")):
        distance = results["distance_mm"][way]["max"]
        near = 0.0 if distance < _NO_DISTANCE * max_distance else distance
        told = f"{plain(near)} mm (limit {plain(max_distance)} mm)"
        checks.append(check(f"{start}_distance", distance, max_distance, told=told))
    touching = "; parts of the boundary touch there, which most solvers accept" if loose else ""
    opened = "" if euler == wanted else "; the tetrahedralizer changed the number of handles or gaps"
    checks.append(check("boundary_manifold", loose, but=touching))
    checks.append(check("euler_characteristic", euler, wanted, but=opened))
    return checks


def complex_checks(volume: dict[str, Any], limits: Limits) -> list[Check]:
    """Judge the tetrahedra of many materials against the surface, apart from their shape.

    Parameters
    ----------
    volume
        The measures, as in the report under ``volume``.
    limits
        The limits.
    """
    regions = volume["regions"]
    changes = {entry["name"]: _change(entry["surface_volume_mm3"], entry["volume_mm3"]) for entry in regions}
    worst = max(changes, key=lambda name: abs(changes[name]))
    change = percent(changes[worst])
    told = change if change == "0 %" else f"at most {change} in {worst}"
    parts = [
        f"; {entry['name']} has {entry['parts']} instead of {entry['surface_parts']}"
        for entry in regions
        if entry["parts"] != entry["surface_parts"]
    ]
    missing, added = volume["interface_triangles"].values()
    crowded, undecided = volume["crowded_faces"], volume["undecided_tetrahedra"]
    lost, gained = counted(missing, "triangle"), counted(added, "other face")
    faces = counted(crowded, "face belongs", "faces belong")
    tetrahedra = counted(undecided, "tetrahedron has", "tetrahedra have")
    return [
        check("interfaces_kept", missing + added, missing=lost, added=gained),
        check("conforming", crowded + undecided, crowded=faces, undecided=tetrahedra),
        check("region_parts", len(parts), total=len(regions), apart="".join(parts[:3])),
        check("volume_change", changes[worst], limits.max_volume_change, told=told, between=""),
    ]


def surface_volume_checks(rows: Sequence[dict[str, Any]], scaled: bool) -> list[Check]:
    """Compare the volume inside the surface with that of the voxels, or of F.

    Parameters
    ----------
    rows
        The table of volumes, with changes in percent (:func:`.volume_table`).
    scaled
        Whether ``distfield`` used a scale above 0.

    Returns
    -------
    list of Check
        One check, whose failure is only a warning; empty if no volumes are known.
    """
    known = [row for row in rows if "mesh_mm3" in row["change_percent"]]
    changes = {row["name"]: row["change_percent"]["mesh_mm3"] for row in known}
    if not known:
        return []
    names = sorted(changes, key=lambda name: -abs(changes[name]))
    limit = SURFACE_CHANGES[scaled]
    above = [name for name in names if abs(changes[name]) > limit]
    told = ", ".join(f"{percent(changes[name])} in {name}" for name in above[:_MOST_NAMES] or names[:1])
    if len(known) == 1:
        told = percent(changes[names[0]])
    elif not above:
        told = f"at most {told}"
    elif len(above) > _MOST_NAMES:
        told += f" and more than the limit in {len(above) - _MOST_NAMES} more materials"
    base = "F" if all(row["voxels_mm3"] is None for row in known) else "the voxels"
    return [check("surface_volume", changes[names[0]], limit, base=base, told=told)]


def conclude(checks: list[Check], quality: TetrahedronQuality, context: Context) -> list[str]:
    """Add the checks to the report and the shapes to the closing table; print the warnings.

    Parameters
    ----------
    checks
        All checks.
    quality
        Shapes of the tetrahedra.
    context
        The context of the run.

    Returns
    -------
    list of str
        The messages of the required checks that failed.
    """
    context.results["checks"] = [{**asdict(check), "verdict": check.verdict} for check in checks]
    shapes = [
        ("tetrahedra", f"{len(quality.volume):,}"),
        ("radius ratio", f"mean {quality.radius_ratio.mean():.3f}, minimum {quality.radius_ratio.min():.3f}"),
        ("dihedral angle", f"{quality.min_dihedral.min():.1f} to {quality.max_dihedral.max():.1f} degrees"),
    ]
    context.closing.extend(shapes)
    for check in checks:
        if check.verdict == "warning":
            context.warn(check.words)
    return [check.words for check in checks if check.verdict == "fail"]

"""Checks of a volume mesh: value, limit and verdict in words."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tetmesh_check.context import Context
from tetmesh_check.numerals import plain
from tetmesh_check.quality import Cells, Points, TetrahedronQuality, Values, centres_of
from tetmesh_check.topology import Topology

FIT_BUT_FOR = "fit but for "
"""Beginning of the warning that names accepted elements; the verdict and the page repeat it."""
REMEDY = (
    "to remove them, set a scale (SCALE, or SIZE or VERTICES without SCALE=0) or use smaller edges (SIZE, MIN_SIZE, "
    "more VERTICES); to accept them, use --accept-forced (ACCEPT_FORCED=yes)"
)
"""Remedies for elements that the triangles of the surface force below a limit."""
FORCED_LISTS = "forced_by_surface and forced_by_triangle"
"""Lists of the report that give the places of forced tetrahedra."""
_NO_PERCENT = 5e-4
"""Changes below this, percent, are rounding errors and print as 0 %."""
_NO_DISTANCE = 1e-6
"""Distances below this share of their limit are rounding errors and print as 0 mm."""


SURFACE_CHANGES = {False: 5.0, True: 2.0}
"""Largest change of the volume of the surface against the voxels, percent, without a scale and with
one.

``distfield`` warns of changes of F above the same limits (``VOLUME_LIMITS``,
``SCALED_VOLUME_LIMITS``)."""
_MOST_NAMES = 3
"""Most materials that a message names."""


@dataclass(frozen=True)
class Limits:
    """Limits of a fit mesh."""

    min_dihedral: float = 5.0
    """Smallest dihedral angle, degrees. The condition number of the stiffness matrix grows with the
    inverse of its sine."""
    min_scaled_jacobian: float = 0.05
    """Smallest scaled Jacobian."""
    max_volume_change: float = 1.0
    """Largest difference between the volume of the tetrahedra and that inside the surface,
    percent."""
    max_distance: float | None = None
    """Largest distance between the boundary of the tetrahedra and the surface, either way, mm;
    default twice the envelope."""
    accept_forced: bool = False
    """Whether tetrahedra below a limit of shape pass where the surface forces them below it."""

    def distance(self, envelope: float) -> float:
        """Give the largest distance for an envelope, mm."""
        return self.max_distance if self.max_distance is not None else 2.0 * envelope


@dataclass(frozen=True)
class Check:
    """One verdict."""

    name: str
    """Short name, stable from version to version."""
    passed: bool
    """Whether the mesh is fit in this respect."""
    required: bool
    """Whether a failure makes the mesh unfit (exit code 1) or is only worth a warning."""
    value: float
    """The measured value."""
    limit: float
    """The limit of the value."""
    words: str
    """The verdict as a sentence."""
    accepted: int = 0
    """Elements beyond the limit that pass because the user accepts them."""

    @property
    def doubtful(self) -> bool:
        """Whether it is worth a warning, and no failure."""
        return self.accepted > 0 if self.passed else not self.required

    def as_dict(self) -> dict[str, Any]:
        """Write the check for the report, with ``verdict`` one of pass, warning, fail."""
        verdict = "warning" if self.doubtful else "pass" if self.passed else "fail"
        return {**asdict(self), "verdict": verdict}


@dataclass(frozen=True)
class Measurements:
    """The input of the checks."""

    quality: TetrahedronQuality
    surface_volume: float
    """Volume inside the input surface, mm^3."""
    surface_bodies: int
    """Components of the input surface that bound a body from outside (cavities not counted)."""
    surface_topology: Topology
    boundary_topology: Topology
    bodies: int
    """Face-connected components of the tetrahedra."""
    boundary_distance: float
    """Largest distance of the boundary from the surface, mm."""
    surface_distance: float
    """Largest distance of the surface from the boundary, mm."""
    envelope: float
    """The envelope, mm: how far fTetWild may move the boundary."""


@dataclass(frozen=True)
class Forced:
    """Tetrahedra that the surface keeps from a limit of shape, whoever makes them."""

    dihedral: NDArray[np.bool_]
    """Which cannot reach the smallest dihedral angle, shape ``(m,)``."""
    jacobian: NDArray[np.bool_]
    """Which cannot reach the smallest scaled Jacobian, shape ``(m,)``."""

    @classmethod
    def none(cls, count: int) -> Forced:
        """Return no forced tetrahedra for a mesh with this number of tetrahedra."""
        nobody = np.zeros(count, dtype=np.bool_)
        return cls(nobody, nobody)


def smallest_elsewhere(values: NDArray[np.float64], forced: NDArray[np.bool_]) -> float:
    """Smallest value of the tetrahedra that are not forced, infinite where all are.

    Parameters
    ----------
    values
        One number a tetrahedron.
    forced
        Which are forced.
    """
    return float(values.min(where=~forced, initial=np.inf))


def well_shaped(quality: TetrahedronQuality, limits: Limits) -> bool:
    """Whether every tetrahedron is positive and within the limits of shape.

    Parameters
    ----------
    quality
        The measures.
    limits
        What is demanded.
    """
    return bool(
        quality.volume.min() > 0
        and quality.min_dihedral.min() >= limits.min_dihedral
        and quality.scaled_jacobian.min() >= limits.min_scaled_jacobian
    )


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
        What is demanded.
    """
    below = (quality.min_dihedral < limits.min_dihedral) | (quality.scaled_jacobian < limits.min_scaled_jacobian)
    poor = np.flatnonzero(below)
    poor = poor[np.argsort(quality.min_dihedral[poor], kind="stable")]
    centres = centres_of(points, tetrahedra[poor])
    return [
        {
            "place_mm": place.tolist(),
            "min_dihedral": float(quality.min_dihedral[tetrahedron]),
            "min_scaled_jacobian": float(quality.scaled_jacobian[tetrahedron]),
        }
        for tetrahedron, place in zip(poor, centres, strict=True)
    ]


def counted(count: int, thing: str, things: str = "") -> str:
    """Write a number of things.

    Parameters
    ----------
    count
        How many.
    thing
        What one of them is called.
    things
        What several are called; without it ``thing`` with an ``s``.
    """
    return f"{count} {thing if count == 1 else things or f'{thing}s'}"


def percent(change: float) -> str:
    """Write a change with its sign; rounding errors as 0 %.

    Parameters
    ----------
    change
        In percent.
    """
    return "0 %" if abs(change) < _NO_PERCENT else f"{'+' if change > 0 else ''}{plain(change)} %"


def verdict(name: str, passed: bool, value: float, limit: float, words: str, required: bool = True) -> Check:
    """Make a check; the arguments are its fields."""
    return Check(name, bool(passed), required, float(value), float(limit), words)


def _distance(start: str, way: str, value: float, limit: float) -> Check:
    """Compare a maximum distance, mm, with its limit."""
    told = f"{plain(0.0 if value < _NO_DISTANCE * limit else value)} mm (limit {plain(limit)} mm)"
    return verdict(f"{start}_distance", value <= limit, value, limit, f"the maximum distance from {way} is {told}")


def shape_checks(quality: TetrahedronQuality, limits: Limits, forced: Forced | None = None) -> list[Check]:
    """Judge the shape of the tetrahedra.

    Parameters
    ----------
    quality
        The measures.
    limits
        What is demanded.
    forced
        Which the surface keeps from it; without it none. They fail unless the limits accept them.
    """
    forced = forced or Forced.none(quality.volume.size)
    not_positive = int((quality.volume <= 0).sum())

    def judged(name: str, what: str, values: Values, kept: NDArray[np.bool_], limit: float, unit: str) -> Check:
        below = values < limit
        count, on_surface = int(below.sum()), int((below & kept).sum())
        poor = counted(count, "tetrahedron is", "tetrahedra are")
        words = f"the minimum {what} is {plain(float(values.min()))}{unit}; {poor} below the limit of {limit:g}"
        if on_surface:
            words += f", {on_surface} of them forced by triangles of the surface (places: {FORCED_LISTS} in the report)"
        accepted = on_surface if limits.accept_forced else 0
        if accepted:
            words = f"{FIT_BUT_FOR}{counted(accepted, 'accepted tetrahedron', 'accepted tetrahedra')}: {words}"
        elif on_surface:
            words += f"; {REMEDY}"
        elif count:
            words += " (places: poor_tetrahedra in the report)"
        return Check(name, count == accepted, True, float(values.min()), limit, words, accepted)

    return [
        verdict(
            "positive_volumes",
            not_positive == 0,
            not_positive,
            0,
            f"{not_positive} of {quality.volume.size} tetrahedra are inverted or flat",
        ),
        judged(
            "min_dihedral", "dihedral angle", quality.min_dihedral, forced.dihedral, limits.min_dihedral, " degrees"
        ),
        judged(
            "min_scaled_jacobian",
            "scaled Jacobian",
            quality.scaled_jacobian,
            forced.jacobian,
            limits.min_scaled_jacobian,
            "",
        ),
    ]


def run_checks(measured: Measurements, limits: Limits) -> list[Check]:
    """Judge the tetrahedra of one object against its surface."""
    quality = measured.quality
    volume = float(quality.volume.sum())
    change = 100.0 * (volume / measured.surface_volume - 1.0)
    max_distance = limits.distance(measured.envelope)
    boundary = measured.boundary_topology
    same_euler = boundary.euler_characteristic == measured.surface_topology.euler_characteristic
    loose = (
        boundary.open_edges + boundary.nonmanifold_edges + boundary.badly_oriented_edges + boundary.nonmanifold_vertices
    )

    return [
        *shape_checks(quality, limits),
        verdict(
            "volume_change",
            np.abs(change) <= limits.max_volume_change,
            change,
            limits.max_volume_change,
            f"tetrahedra against the surface: the volume changes by {percent(change)} (limit "
            f"{limits.max_volume_change:g} %), from {plain(measured.surface_volume)} mm^3 to {plain(volume)} mm^3",
        ),
        verdict(
            "bodies",
            measured.bodies == measured.surface_bodies,
            measured.bodies,
            measured.surface_bodies,
            f"the tetrahedra form {counted(measured.bodies, 'separate body', 'separate bodies')}; the surface encloses "
            f"{measured.surface_bodies}",
        ),
        _distance(
            "boundary", "the boundary of the tetrahedra to the surface", measured.boundary_distance, max_distance
        ),
        _distance("surface", "the surface to the boundary of the tetrahedra", measured.surface_distance, max_distance),
        verdict(
            "boundary_manifold",
            loose == 0,
            loose,
            0,
            f"{loose} edges and vertices of the boundary are not manifold"
            + ("; parts of the boundary touch there, which most solvers accept" if loose else ""),
            required=False,
        ),
        verdict(
            "euler_characteristic",
            same_euler,
            boundary.euler_characteristic,
            measured.surface_topology.euler_characteristic,
            f"the Euler characteristic of the boundary is {boundary.euler_characteristic}, that of the surface "
            f"{measured.surface_topology.euler_characteristic}"
            + ("" if same_euler else "; the tetrahedralizer opened or closed handles or gaps"),
            required=False,
        ),
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
        One check, which is only worth a warning; none if no volumes are known.
    """
    known = [row for row in rows if "mesh_mm3" in row["change_percent"]]
    if not known:
        return []
    changes = {row["name"]: row["change_percent"]["mesh_mm3"] for row in known}
    names = sorted(changes, key=lambda name: -abs(changes[name]))
    limit = SURFACE_CHANGES[scaled]
    above = [name for name in names if abs(changes[name]) > limit]
    if len(known) == 1:
        told = f"the volume changes by {percent(changes[names[0]])}"
    else:
        listed = ", ".join(
            f"{percent(changes[name])} in {name}" for name in (above or names)[: max(1, min(len(above), _MOST_NAMES))]
        )
        told = f"the volume changes by {'' if above else 'at most '}{listed}"
        if len(above) > _MOST_NAMES:
            told += f" and more than the limit in {len(above) - _MOST_NAMES} more materials"
    base = "F" if all(row["voxels_mm3"] is None for row in known) else "the voxels"
    worst = changes[names[0]]
    words = f"surface against {base}: {told} (limit {limit:g} %)"
    return [verdict("surface_volume", not above, worst, limit, words, required=False)]


def conclude(checks: list[Check], quality: TetrahedronQuality, context: Context) -> list[str]:
    """Report the verdicts and the shapes; warn about doubtful checks.

    Parameters
    ----------
    checks
        All verdicts.
    quality
        Shapes of the tetrahedra.
    context
        The frame of the run.

    Returns
    -------
    list of str
        The required checks that failed, in words.
    """
    context.results["checks"] = [check.as_dict() for check in checks]
    context.closing += [
        ("tetrahedra", f"{len(quality.volume):,}"),
        ("radius ratio", f"mean {quality.radius_ratio.mean():.3f}, minimum {quality.radius_ratio.min():.3f}"),
        ("dihedral angle", f"{quality.min_dihedral.min():.1f} to {quality.max_dihedral.max():.1f} degrees"),
    ]
    for check in checks:
        if check.doubtful:
            context.warn(check.words)
    return [check.words for check in checks if check.required and not check.passed]

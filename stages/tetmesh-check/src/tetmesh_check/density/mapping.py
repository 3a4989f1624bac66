"""Maps a scan onto elements: reads it, finds the mean of each element, and applies the law.

The mean is exact for voxels of constant value (``common/field/src/overlap.rs``), so the mass of the
elements is that of the voxels inside them.
"""

from __future__ import annotations

from dataclasses import asdict, replace
from typing import Any, NamedTuple

import numpy as np
from isoparticles import _native
from isoparticles._native import Context
from numpy.typing import NDArray

from tetmesh_check.density.arguments import DensityArguments
from tetmesh_check.errors import StageError
from tetmesh_check.export.cards import cards_of
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.quality import Labels, Points, Values, summarize
from tetmesh_check.regions import share_outside
from tetmesh_check.surface import Surface
from tetmesh_check.volumes import InputVolume, read_volume

MARGIN = 0.1
"""Voxels are kept up to this distance from the surface, relative to its diagonal. The envelope,
which limits how far the surface moves, is smaller."""
MIN_MODULUS = 0.01
"""Minimum E, N/mm^2. Densities of fat and marrow can be negative after calibration, and a solver
needs a positive E. Compact bone is a million times stiffer, so that these elements bear no load."""
MAX_SHARE = 0.05
"""Share of elements at the minimum E above which there is a warning."""
WHOLE = 0.98
"""Share of a tetrahedron in the volume above which all of it counts as inside. Triangles of a cap
may reach beyond the border of the volume: shares are at least 0.989 for `ribs` with MIN_SIZE=2."""


def _chosen(surface: Surface, material: str | None) -> Points:
    """Return the vertices of the object, or of the material."""
    if surface.sides is None or material is None:
        return surface.points
    number = surface.sides.names.index(material)
    own = (surface.sides.inside == number) | (surface.sides.outside == number)
    return np.asarray(surface.points[np.unique(surface.triangles[own])])


class DensityScan(NamedTuple):
    """A scan near the object or the material, and how it becomes stiffness."""

    arguments: DensityArguments
    volume: InputVolume
    """Grey values as 32-bit numbers."""


def read_density(arguments: DensityArguments, surface: Surface, context: Context) -> DensityScan:
    """Read the scan, and check that it fits the surface.

    Parameters
    ----------
    arguments
        The options of the density.
    surface
        The surface, in LPS if it has an anatomical frame.
    context
        For the history.

    Raises
    ------
    StageError
        If the volume cannot belong to the surface, or has no positive density there.
    """
    path = arguments.path
    volume = read_volume(path)
    context.add_input(path, None)
    if surface.space is not None and not volume.anatomical:
        raise StageError(
            f"{path}: has no anatomical frame (LPS or RAS), and the surface has one",
            "their positions cannot be compared",
            "give the scan in a format with a frame, such as NRRD or NIfTI",
        )
    points = _chosen(surface, arguments.material)
    if (outside := share_outside(points, volume)) > 0.5:
        raise StageError(
            f"{path}: {100.0 * outside:.3g} % of the surface lies outside this volume",
            "it belongs to another case, or its position in the world differs",
            "give the scan that the case was made from, or one that is registered to it",
        )
    near = _near(volume, points)
    bad = int((~np.isfinite(near.values)).sum())
    if bad:
        raise StageError(f"{path}: {bad} voxels are not finite", "they have no density", "replace these voxels")
    highest = arguments.calibration.slope * float(near.values.max()) + arguments.calibration.intercept
    if highest <= 0.0:
        raise StageError(
            f"{path}: the maximum density near the surface is {highest:.4g} g/cm^3 after calibration",
            "a density must be positive",
            "check the sign and the units of --calibrate",
        )
    return DensityScan(arguments, near)


def _near(volume: InputVolume, points: Points) -> InputVolume:
    """Return the voxels of the bounding box of some points, with a margin."""
    margin = MARGIN * float(np.linalg.norm(np.ptp(points, axis=0)))
    low, high = points.min(axis=0) - margin, points.max(axis=0) + margin
    corners = np.stack(np.meshgrid(*np.column_stack([low, high]), indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.linalg.solve(volume.step, (corners - volume.origin).T).T
    last = np.array(volume.values.shape) - 1
    first = np.clip(np.floor(index.min(axis=0)), 0, last).astype(np.int64)
    end = np.clip(np.ceil(index.max(axis=0)), 0, last).astype(np.int64) + 1
    values = volume.values[tuple(map(slice, first, end))].astype(np.float32)
    return replace(volume, values=values, origin=volume.origin + volume.step @ first)


def _means(scan: DensityScan, mesh: MarkedMesh, own: Labels, context: Context) -> Values:
    """Return the density of elements, g/cm^3."""
    arguments, volume = scan
    step, origin = volume.step.T.tolist(), tuple(volume.origin)
    means, shares = _native.tetrahedron_means(volume.values, step, origin, mesh.points, mesh.tetrahedra[own])
    none, partly = int((shares == 0.0).sum()), int(((shares > 0.0) & (shares < WHOLE)).sum())
    context.results["density"]["partly_outside"] = partly
    if none:
        raise StageError(
            f"{arguments.path}: {none} of {len(own)} tetrahedra lie outside this volume",
            "they have no density",
            "give a scan that contains the whole object",
        )
    if partly:
        context.warn(f"{partly} tetrahedra lie partly outside the volume of --density: the part inside counts")
    return np.asarray(arguments.calibration.slope * means + arguments.calibration.intercept)


def _modulus(arguments: DensityArguments, density: Values, context: Context) -> Values:
    """Return E of each element, N/mm^2, at least :data:`MIN_MODULUS`."""
    law, count = arguments.law, len(density)
    modulus = law.a * np.maximum(density, 0.0) ** law.b
    clamped: NDArray[np.bool_] = modulus < MIN_MODULUS
    context.results["density"]["at_minimum_modulus"] = int(clamped.sum())
    if clamped.mean() > MAX_SHARE:
        context.warn(
            f"{int(clamped.sum())} of {count} tetrahedra have a density near or below 0 and get the minimum E, "
            f"{MIN_MODULUS} N/mm^2; check --calibrate"
        )
    return np.maximum(modulus, MIN_MODULUS)


def map_density(scan: DensityScan, mesh: MarkedMesh, volumes: Values, context: Context) -> MarkedMesh:
    """Return the mesh with the fields ``density`` and ``E``, and material cards.

    Parameters
    ----------
    scan
        The scan.
    mesh
        Straight tetrahedra.
    volumes
        Their volumes, mm^3.
    context
        For the results and warnings.

    Raises
    ------
    StageError
        If a tetrahedron lies outside the scan, or the mass is not positive.
    """
    arguments = scan.arguments
    number = next((row["region"] for row in mesh.table if row["material"] == arguments.material), None)
    own = np.flatnonzero(np.ones(len(mesh.regions), dtype=bool) if number is None else mesh.regions == number)
    results: dict[str, Any] = {
        "file": arguments.path.name,
        "calibration": {**asdict(arguments.calibration), "rms_residual": arguments.calibration.residual},
        "law": asdict(arguments.law),
    }
    context.results["density"] = results
    density = _means(scan, mesh, own, context)
    mass = 1e-3 * float(density @ volumes[own])
    if mass <= 0.0:
        raise StageError(
            f"{arguments.path}: the mass of the tetrahedra is {mass:.4g} g after calibration",
            "a mass must be positive",
            "check the sign and the units of --calibrate",
        )
    modulus = _modulus(arguments, density, context)
    fields = {"density": np.full(len(mesh.regions), np.nan), "E": np.full(len(mesh.regions), np.nan)}
    fields["density"][own], fields["E"][own] = density, modulus
    cards = cards_of(mesh, own, (density, modulus, volumes[own]), arguments.bins)
    results |= {
        "mass_g": mass,
        "mean_density": 1e3 * mass / float(volumes[own].sum()),
        "density_g_per_cm3": summarize(density),
        "modulus_mpa": summarize(modulus),
        "bins": {"requested": arguments.bins, "cards": len(cards)},
    }
    told = (
        f"{mass:.4g} g, mean {results['mean_density']:.4g} g/cm^3; E {modulus.min():.4g} to {modulus.max():.4g} N/mm^2"
    )
    context.closing.append(("density", told))
    return replace(mesh, fields=fields, cards=cards)

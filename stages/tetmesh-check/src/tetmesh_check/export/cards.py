"""Material cards: sets of elements that share one stiffness and one density."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tetmesh_check.export.mesh import Card, MarkedMesh, plain_names
from tetmesh_check.quality import Labels, Values

_CONSISTENT = {"mm": (1.0, 1e-9), "m": (1e6, 1e3), "um": (1.0, 1e-15)}
"""Factors of E in N/mm^2 and of the density in g/cm^3, by unit of length, for consistent units:
mm, t, s, N/mm^2; m, kg, s, N/m^2; um, kg, s, uN/um^2."""

MIN_DENSITY = 1e-3
"""Minimum density of a card, g/cm^3, that of air: solvers refuse 0, and densities of fat and marrow
can be negative after calibration."""


def cards_of(mesh: MarkedMesh, own: Labels, values: tuple[Values, Values, Values], bins: int) -> list[Card]:
    """Group the elements of each region by bins of E of equal width, without empty bins.

    E and the density of a card are means by volume, so that the mass of each card is kept, except
    where the mean density is below :data:`MIN_DENSITY`.

    Parameters
    ----------
    mesh
        The mesh.
    own
        The elements with a density, ascending.
    values
        Their density (g/cm^3), E (N/mm^2) and volume (mm^3).
    bins
        Number of bins.
    """
    density, modulus, volume = values
    low, width = float(modulus.min()), float(np.ptp(modulus)) / bins
    regions = mesh.region_sets
    group = np.minimum((modulus - low) / (width or 1.0), bins - 1).astype(np.int64)
    for number, region in enumerate(regions[1:], 1):
        group[mesh.regions[own] == region.number] += bins * number
    counts, volumes = np.bincount(group), np.maximum(np.bincount(group, volume), 1e-300)
    means = np.column_stack([np.bincount(group, volume * of) / volumes for of in (modulus, density)]).tolist()
    # numbers of 16 bits are sorted six times faster than those of 64 bits
    order = np.argsort(group.astype(np.min_scalar_type(len(counts))), kind="stable")
    ends = np.cumsum(counts)
    found = []
    for number in np.flatnonzero(counts).tolist():
        region, members = regions[number // bins], own[order[ends[number] - counts[number] : ends[number]]]
        name, (stiffness, mean_density) = f"{region.name}_E{number % bins + 1}", means[number]
        found.append(Card(region.number, name, members, stiffness, max(mean_density, MIN_DENSITY)))
    taken = [own.name for own in (*mesh.region_sets, *mesh.named_sets)]
    names = plain_names([card.name for card in found], taken)
    return [card._replace(name=name) for card, name in zip(found, names, strict=True)]


def in_units(mesh: MarkedMesh, unit: str) -> MarkedMesh:
    """Return the mesh with the cards in units that are consistent with that of length.

    Parameters
    ----------
    mesh
        The mesh, with E in N/mm^2 and density in g/cm^3.
    unit
        mm, m or um.
    """
    stiffness, mass = _CONSISTENT[unit]
    cards = [card._replace(modulus=stiffness * card.modulus, density=mass * card.density) for card in mesh.cards]
    return replace(mesh, cards=cards)

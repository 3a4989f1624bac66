"""Surface meshes of medical volumes, in one call or stage by stage.

:func:`mesh` goes from an image to a surface. The stages :func:`distance_field`, :func:`size_field`,
:func:`seed`, :func:`settle` and :func:`reconstruct` do the same step by step, and :func:`fill`
makes tetrahedra. Lengths are in mm. The options are those of the programs, with underscores. For an
image in a file that the programs read, a saved result equals theirs, byte for byte.

The command ``isoparticles``, which runs all stages from a volume to tetrahedra, is in
``isoparticles.command``.

All functions raise :class:`Error` if an input or an option is invalid, and TypeError or ValueError
if an argument is unknown or cannot be converted. Ctrl-C stops a running function. A result that
fails a check is returned, with the checks in ``failed_checks``.

An array is copied once, whatever its type and the order of its axes. Stages do not copy the voxels
of their inputs. In addition to them, :func:`distance_field` and :func:`size_field` need 14 bytes
per voxel while they run, :func:`seed` 11, :func:`settle` 8 and :func:`reconstruct` 13 (measured for
balls of 4 to 8 million float32 voxels with few particles).

Examples
--------
>>> import numpy as np
>>> import isoparticles as iso
>>> x, y, z = np.mgrid[:20, :20, :20] - 9.5
>>> ball = x**2 + y**2 + z**2 < 6**2
>>> result = iso.mesh(ball, spacing=(1, 1, 1), labels=[1], size=2)
>>> result.failed_checks
[]
>>> result.surface.is_manifold
True
"""

from importlib import import_module

_HOMES = {
    "mesh": "_api",
    **dict.fromkeys(("distance_field", "load", "reconstruct", "seed", "settle", "size_field"), "_stages"),
    **dict.fromkeys(("Error", "MeshWarning"), "_errors"),
    **dict.fromkeys(("Tetrahedra", "fill"), "_fill"),
    "Mesh": "_mesh",
    **dict.fromkeys(("Quality", "Report", "Volume"), "_report"),
    **dict.fromkeys(("DistanceField", "Particles", "SizeField", "Surface"), "_results"),
    "view": "viewer",
}
"""Modules of the public names. They are imported on first use, so the command starts fast."""

__all__ = [
    "DistanceField",
    "Error",
    "Mesh",
    "MeshWarning",
    "Particles",
    "Quality",
    "Report",
    "SizeField",
    "Surface",
    "Tetrahedra",
    "Volume",
    "distance_field",
    "fill",
    "load",
    "mesh",
    "reconstruct",
    "seed",
    "settle",
    "size_field",
    "view",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(f"{__name__}.{_HOMES[name]}"), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})

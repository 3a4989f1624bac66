"""Advice for checks that fail or warn."""

from __future__ import annotations

from tetmesh_check.checks import REMEDY

_SHAPE = (
    "increase the minimum edge length (MIN_SIZE), or use the other tetrahedralizer (TETMESH_OPTIONS='--method hxt' or "
    "'--method ftetwild')"
)
_WORST = "the 3-D view shows the worst tetrahedra ('worst 1 %')"
_DISTANCE = (
    "use a smaller envelope (TETMESH_OPTIONS='--envelope MM'), or keep the surface unchanged with "
    "TETMESH_OPTIONS='--method hxt'"
)
ADVICE: dict[str, str] = {
    "positive_volumes": f"solvers reject these tetrahedra; {_SHAPE}",
    "min_dihedral": f"{_SHAPE}; {_WORST}",
    "min_scaled_jacobian": f"{_SHAPE}; {_WORST}",
    "volume_change": _DISTANCE,
    "bodies": ("bodies were joined or lost; use smaller edges (SIZE or MAX_SIZE), or TETMESH_OPTIONS='--method hxt'"),
    "boundary_distance": _DISTANCE,
    "surface_distance": _DISTANCE,
    "boundary_manifold": (
        "most solvers accept this; if yours does not, smaller edges separate the parts that touch (MIN_SIZE)"
    ),
    "euler_characteristic": (
        "compare the surface with the boundary; TETMESH_OPTIONS='--method hxt' keeps the triangles of the surface, and "
        "so its handles"
    ),
    "interfaces_kept": (
        "the log of the tetrahedralizer names the lost triangles; use smaller edges there (MIN_SIZE), or another "
        "--tet-size-factor"
    ),
    "conforming": (
        "see the log of the tetrahedralizer; use smaller edges (SIZE, MIN_SIZE), or another --tet-size-factor"
    ),
    "region_parts": "parts of a material were joined or lost; use smaller edges where they are thin (MIN_SIZE)",
    "current_conserved": "the solver stopped too early; check the minimum dihedral angles above",
    "solve_converged": "check the minimum dihedral angles above; flat tetrahedra slow down solvers",
}
"""By the name of the check in the report of ``tetmesh-check``."""
_THIN = "use smaller edges where walls are thin (MIN_SIZE), or RECONSTRUCT_OPTIONS='--method tight-cocone'"
_REPORT = "this is an error of the program; please report it with the volume"
_WORDS: tuple[tuple[str, str], ...] = (
    ("components and cavities", f"parts were lost or joined; {_REPORT}"),
    ("voxel centres changed side", _REPORT),
    (
        "components where the isosurface has",
        "use smaller edges (SIZE, MIN_SIZE), or remove small parts first (DISTFIELD_OPTIONS='--keep largest')",
    ),
    (
        "radius ratio below",
        "use a smaller gradient of the edge length (DELTA=0.3) or smaller edges there (MIN_SIZE); the 3-D view shows "
        "the worst triangles ('worst 1 %')",
    ),
    ("deviation of more than", "use smaller edges (MIN_SIZE); RECONSTRUCT_OPTIONS='--max-vertex-distance' sets the limit"),
    (
        "wrong side of the mesh",
        "use smaller edges (SIZE, MIN_SIZE); a mesh cannot represent features smaller than two edges",
    ),
    ("intersecting triangles", _THIN),
    ("manifold", _THIN),
    ("open edges", _THIN),
    ("zero area", _THIN),
    ("different components", _THIN),
)
"""By words in the failed checks of the other stages; the first match applies."""


def advice_for(name: str, words: str) -> str:
    """Say what to do about a check.

    Parameters
    ----------
    name
        Its name in the report of ``tetmesh-check``; empty for those of other stages.
    words
        What is said of it.
    """
    lowered = words.lower()
    if "forced by" in lowered:
        return REMEDY
    if name in ADVICE:
        return ADVICE[name]
    return next(
        (advice for word, advice in _WORDS if word in lowered), "see the report of the stage and docs/user/size.md"
    )

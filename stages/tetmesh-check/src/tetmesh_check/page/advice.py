"""What to do about a check that failed, or one that warns."""

from __future__ import annotations

from tetmesh_check.checks import REMEDY

_SHAPE = "raise the smallest edge length (MIN_SIZE), or try the other tetrahedralizer (TETMESH_OPTIONS='--method hxt' or 'ftetwild')"
_DISTANCE = "narrow the envelope (TETMESH_OPTIONS='--envelope MM'), or keep the surface as it is with '--method hxt'"
ADVICE: dict[str, str] = {
    "positive_volumes": "no solver takes these: " + _SHAPE,
    "min_dihedral": _SHAPE + "; see where they are with 'worst 1 %' in the 3-D view",
    "min_scaled_jacobian": _SHAPE + "; see where they are with 'worst 1 %' in the 3-D view",
    "volume_change": _DISTANCE,
    "bodies": "sheets that touch were joined or a body was lost: smaller edges (SIZE or MAX_SIZE), or '--method hxt'",
    "boundary_distance": _DISTANCE,
    "surface_distance": _DISTANCE,
    "boundary_manifold": "most solvers accept it; where yours does not, smaller edges part the sheets (MIN_SIZE)",
    "euler_characteristic": "compare surface and boundary there; '--method hxt' keeps the surface's triangles and with them its handles",
    "interfaces_kept": "the tetrahedralizer's log says which triangles it lost; smaller edges there (MIN_SIZE), or another --tet-size-factor",
    "conforming": "the tetrahedralizer's log says more; smaller edges (SIZE, MIN_SIZE), or another --tet-size-factor",
    "region_parts": "parts of a material were joined or lost: smaller edges where they are thin (MIN_SIZE)",
    "current_conserved": "the solver ended too early: look at the smallest dihedral angles above",
    "solve_converged": "look at the smallest dihedral angles above: flat tetrahedra are what solvers stumble over",
}
"""By the name of the check in the report of ``tetmesh-check``."""
_THIN = "smaller edges where walls are thin (MIN_SIZE), or RECONSTRUCT_OPTIONS='--method tight-cocone'"
_WORDS: tuple[tuple[str, str], ...] = (
    ("components and cavities", "parts vanished or joined: please report the volume as a bug"),
    ("voxel centres changed side", "please report the volume as a bug"),
    ("components where the isosurface has", "smaller edges (SIZE, MIN_SIZE), or drop small parts first (DISTFIELD_OPTIONS='--keep largest')"),
    ("radius ratio below", "see 'worst 1 %' in the 3-D view; a gentler grading (DELTA=0.3) or smaller edges there (MIN_SIZE) help"),
    ("farther than", "smaller edges (MIN_SIZE); RECONSTRUCT_OPTIONS='--max-vertex-distance' says what is allowed"),
    ("wrong side of the mesh", "smaller edges (SIZE, MIN_SIZE): features below two edges cannot be kept"),
    ("that cross", _THIN),
    ("manifold", _THIN),
    ("open edges", _THIN),
    ("without area", _THIN),
    ("different components", _THIN),
)  # fmt: skip
"""By a word in what the other stages say of a failed check, the first that fits."""


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
    return next((advice for word, advice in _WORDS if word in lowered), "see the stage's report, and docs/user/size.md")

"""Lists places to inspect: failed checks, warnings, poor triangles, lost parts, thin walls."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv
from numpy.typing import NDArray

from isoparticles import _native
from isoparticles.viewer.session import size_at

if TYPE_CHECKING:
    from isoparticles._mesh import Mesh
    from tetmesh_check.report.page.case import Case

MOST = 12
"""Maximum number of places of one kind in the list."""
APART = 4.0
"""Minimum distance of two places of one kind, in edge lengths."""
STEPS = 8
"""Number of samples of F along the inward normal, up to the depth h. A thin wall is missed only if
the space behind it is narrower than the distance h / 8 of the samples."""
POOR = 0.5
"""Triangles with at least this radius ratio are not listed, except the worst one if all have it. A
right isosceles triangle has 0.83."""
NUMBER = r"-?\d+(?:\.\d+)?"
FIELDS = ("distfield", "sizefield")
"""Stages whose reports concern the volume and the fields, not the triangles."""
POSITION = re.compile(rf"({NUMBER}), ({NUMBER}),? (?:and )?({NUMBER})")
"""A position in a message."""
REASONS = (
    "",
    "open edge",
    "edge of more than two triangles",
    "edge between inconsistently oriented triangles",
    "pinched vertex",
    "vertex too far from F = 0",
    "voxel centre on the wrong side",
    "repeated triangle",
    "triangle of zero area",
    "crossing triangles",
    "triangle below the minimum radius ratio",
    "triangle whose normal opposes grad F",
    "missing segment of a junction curve",
    "poor triangle forced by junction curves",
    "edge shared by several interfaces",
)
"""Names of the values of ``reason``; see docs/user/outputs.md."""
EVENTS = {
    "broken": "part that the scale split",
    "gone": "part that the scale removed",
    "joined": "parts that the scale merged",
    "shortened": "thin end that the scale removed",
    "filled": "gap that the scale filled",
    "wrong": "wrong topology",
    "missing": "missing component",
    "undecided": "detail below a tenth of a voxel",
}
"""Names for the kinds of entries in the reports of the stages."""


@dataclass(frozen=True)
class Place:
    """One entry of the list. An entry without a position is only a text."""

    kind: str
    text: str
    position: tuple[float, float, float] | None = None
    h: float | None = None
    """Present edge length there, mm."""


def places_to_inspect(mesh: Mesh, case: Case | None, folder: Path | None) -> list[Place]:
    """List the places of a mesh: failed checks first.

    Parameters
    ----------
    mesh
        The present mesh.
    case
        The status and the reports of its case.
    folder
        The folder of the case, with the offending simplices; None if the reports describe another
        mesh than ``mesh``. The list then contains only their entries about the volume and the
        fields.
    """
    found: list[Place] = []
    if case is None or folder is None:
        found += [_of_text("failed check", words, mesh) for words in mesh.failed_checks]
    else:
        found += [_of_text("failed check", f"{stage}: {words}", mesh) for stage, words in case.failures]
        found += _offending(folder / f"{mesh.name}.surface.offending.vtp", mesh)
    if case is not None:
        is_told = {stage: folder is not None or stage in FIELDS for stage in case.reports}
        warnings = [(stage, words) for stage, words in case.warnings if is_told.get(stage)]
        found += [_of_text("warning", f"{stage}: {words}", mesh) for stage, words in warnings]
        for stage, report in case.reports.items():
            found += _of_report(stage, report.get("results"), mesh) if is_told[stage] else []
    return [*found, *worst_triangles(mesh), *thin_walls(mesh)]


def _place(kind: str, text: str, position: Any, mesh: Mesh) -> Place:
    x, y, z = (float(value) for value in position)
    return Place(kind, text, (x, y, z), size_at(mesh, (x, y, z)))


def _of_text(kind: str, text: str, mesh: Mesh) -> Place:
    """Make a place of a message, with the first position in it that lies near the mesh."""
    low, high = mesh.result.vertices.min(axis=0), mesh.result.vertices.max(axis=0)
    margin = 0.5 * (high - low).max()
    for match in POSITION.finditer(text):
        position = np.array([float(number) for number in match.groups()])
        if ((position >= low - margin) & (position <= high + margin)).all():
            return _place(kind, text, position, mesh)
    return Place(kind, text)


def _of_report(stage: str, results: Any, mesh: Mesh) -> list[Place]:
    """Make places of the positions in a report."""
    counts: dict[str, int] = {}
    found = []
    for kind, position, about in positions(results):
        counts[kind] = counts.get(kind, 0) + 1
        if counts[kind] <= MOST:
            name = EVENTS.get(kind, kind.replace("_", " "))
            volume = about.get("volume")
            more = f", {volume:.3g} mm^3" if isinstance(volume, (int, float)) else ""
            found.append(_place(name, f"{stage}: {name}{more}", position, mesh))
    return found


def positions(data: Any, key: str = "") -> Iterator[tuple[str, list[float], dict[str, Any]]]:
    """Yield the kind, the position and the entry of all positions in a report."""
    if isinstance(data, dict):
        place: Any = data.get("place")
        if _is_position(place):
            yield str(data.get("kind", key)), list(place), data
        for name, value in data.items():
            if name == "missing" and isinstance(value, list):
                yield from (("missing", list(one), {}) for one in value if _is_position(one))
            elif name != "place":
                yield from positions(value, name)
    elif isinstance(data, list):
        for value in data:
            yield from positions(value, key)


def _is_position(value: Any) -> bool:
    return isinstance(value, list) and len(value) == 3 and all(isinstance(x, (int, float)) for x in value)


def _offending(path: Path, mesh: Mesh) -> list[Place]:
    """List the simplices that fail a check, at most ``MOST`` for each reason."""
    if not path.is_file():
        return []
    offending = pv.read(path)
    reasons = np.asarray(offending.cell_data["reason"], dtype=int)
    centres = np.asarray(offending.cell_centers().points)
    found = []
    for reason in np.unique(reasons).tolist():
        kind = REASONS[reason] if reason < len(REASONS) else f"reason {reason}"
        own = centres[reasons == reason]
        for i, position in enumerate(apart(own, own_sizes(own, mesh)), 1):
            where = ", ".join(f"{x:.1f}" for x in position)
            found.append(_place(kind, f"{i} of {len(own)}, at {where}", position, mesh))
    return found


def worst_triangles(mesh: Mesh) -> list[Place]:
    """List the triangles with the smallest radius ratios, at a distance from each other."""
    ratios = np.asarray(mesh.result.cell_arrays["radius_ratio"])
    order = np.argsort(ratios)[: 50 * MOST]
    order = order[ratios[order] < POOR]
    if len(order) == 0:
        order = np.argsort(ratios)[:1]
    centres = mesh.result.vertices[mesh.result.triangles[order]].mean(axis=1)
    ratio_at = {tuple(centre): ratio for centre, ratio in zip(centres.tolist(), ratios[order].tolist(), strict=True)}
    return [
        _place("worst triangle", f"radius ratio {ratio_at[tuple(position.tolist())]:.3f}", position, mesh)
        for position in apart(centres, own_sizes(centres, mesh))
    ]


def thin_walls(mesh: Mesh) -> list[Place]:
    """List the vertices where h exceeds the thickness of the object along the inward normal.

    F at ``position - s normal`` is negative inside. If it is positive for some s below h, the
    object is thinner than h there. Surfaces of many materials have no such F.
    """
    points, sizes = mesh.result.point_arrays, mesh.result.point_arrays.get("h")
    if mesh.field.materials or sizes is None or "normal" not in points:
        return []
    vertices, normals = mesh.result.vertices, np.asarray(points["normal"], dtype=float)
    depths = np.linspace(0.0, 1.0, STEPS + 1)[1:, None] * np.asarray(sizes)[None, :]
    field = mesh.field
    grid = _native.GridField(
        np.asarray(field.array, dtype=np.float32),
        _three(field.spacing),
        _three(field.origin),
        field.direction.T.tolist(),
    )
    is_outside = np.array([grid.trilinear(vertices - depth[:, None] * normals) > 0.0 for depth in depths])
    thickness = np.where(is_outside.any(axis=0), depths[is_outside.argmax(axis=0), np.arange(len(vertices))], np.inf)
    thin = np.flatnonzero(np.isfinite(thickness))
    thin = thin[np.argsort(thickness[thin] / np.asarray(sizes)[thin])]
    chosen = vertices[thin]
    walls = {
        tuple(p): (t, h) for p, t, h in zip(chosen.tolist(), thickness[thin], np.asarray(sizes)[thin], strict=True)
    }
    found = []
    for position in apart(chosen, np.asarray(sizes)[thin]):
        thick, h = walls[tuple(position.tolist())]
        text = f"about {thick:.3g} mm thick, h = {h:.3g} mm"
        found.append(_place("thin wall", text, position, mesh))
    return found


def _three(values: NDArray[Any]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def own_sizes(positions: NDArray[Any], mesh: Mesh) -> NDArray[Any]:
    """Return h at some positions."""
    return np.array([size_at(mesh, position) for position in positions.tolist()])


def apart(positions: NDArray[Any], sizes: NDArray[Any]) -> NDArray[Any]:
    """Return at most ``MOST`` of the first positions, at least ``APART`` edge lengths apart."""
    chosen: list[NDArray[Any]] = []
    for position, size in zip(positions, sizes, strict=True):
        if all(np.linalg.norm(position - other) >= APART * size for other in chosen):
            chosen.append(position)
        if len(chosen) == MOST:
            break
    return np.array(chosen).reshape(-1, 3)

"""Opens what the page shows: a finished case, a volume without results, or a mesh in memory."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyvista as pv

from isoparticles._errors import Error
from tetmesh_check.report.colours import Entry, key_of
from tetmesh_check.report.page.case import Case, dig, read_case
from tetmesh_check.report.page.scan import Scan, read_scan

if TYPE_CHECKING:
    from isoparticles._mesh import Mesh

FLIP = np.array([-1.0, -1.0, 1.0])
"""Signs between LPS and RAS."""
MAX_LABELS = 250
"""An integer volume without names of labels counts as a label map if it has at most so many
different values. An 8-bit scan that uses all values has 256, the largest atlases about 200."""

MARGIN = 0.3
"""Margin of the slices around the mesh, relative to its longest side."""


@dataclass
class Shown:
    """What the page shows."""

    name: str
    out: Path
    """The folder that contains the folders of cases."""
    folder: Path | None = None
    """The folder of the case; None for a mesh in memory."""
    volume: Path | None = None
    mesh: Mesh | None = None
    scan: Scan | None = None
    """The volume in the world frame of the mesh, with the axes of the array along x, y and z."""
    key: list[Entry] = field(default_factory=list)
    """Names and colours of labels and materials."""
    case: Case | None = None
    notes: list[str] = field(default_factory=list)
    """Problems that do not prevent the page."""

    @property
    def is_volume(self) -> bool:
        """Whether there is a volume from which a surface can be made."""
        return self.volume is not None


def open_case(word: str, out: Path, name: str | None = None) -> Shown:
    """Open a case by its name, its folder or its volume; ``name`` is that of the volume's results.

    Raises
    ------
    Error
        If there is no such case or volume, or if it cannot be read.
    """
    from isoparticles._mesh import Mesh

    path = Path(word)
    for folder in (path, out / word):
        found = sorted(folder.glob("*.status.json")) if folder.is_dir() else []
        if len(found) == 1:
            return open_results(found[0])
        # Mesh.save writes no status
        saved = sorted(folder.glob("*.surface.vtp")) if folder.is_dir() and not found else []
        if len(saved) == 1:
            return of_mesh(Mesh.open(folder, saved[0].name.removesuffix(".surface.vtp")), folder=folder)
    if path.name.endswith(".status.json") and path.is_file():
        return open_results(path)
    if not path.exists():
        known = sorted(one.parent.name for one in out.glob("*/*.status.json"))
        listed = f" (there are {', '.join(known[:8])}{', ...' if len(known) > 8 else ''})" if known else ""
        raise Error(
            f"{word}: neither a case in {out}{listed} nor a file",
            "the page shows the results of a case, or a volume",
            "give the name of a case with --out, its folder, or the path of a volume",
        )
    return open_volume(path, out, name)


def open_volume(path: Path, out: Path, name: str | None = None) -> Shown:
    """Open a volume, and the results of its case if there are any."""
    from isoparticles import _native

    name = name or _native.case_name(path)
    status = out / name / f"{name}.status.json"
    surfaces = (out / name / f"{name}.surface{failed}.vtp" for failed in ("", ".failed"))
    if status.is_file() and any(surface.is_file() for surface in surfaces):
        return open_results(status)
    scan = _read(path, None, {})
    return Shown(name, out, out / name, path, None, scan, labels_of(scan))


def open_results(status: Path) -> Shown:
    """Open the folder of a finished case."""
    from isoparticles._mesh import Mesh

    case = read_case(status)
    folder = status.parent
    shown = Shown(case.name, folder.parent, folder, _volume_of(case), None, None, [], case)
    try:
        shown.mesh = Mesh.open(folder, case.name)
    except Error as error:
        if shown.volume is None:
            raise
        shown.notes.append(f"No surface: {error.what}.")
    _add_scan(shown)
    return shown


def of_mesh(mesh: Mesh, image: str | os.PathLike[str] | None = None, folder: Path | None = None) -> Shown:
    """Show a mesh in memory, in front of an image file or of its distance field."""
    volume = None if image is None else Path(image)
    scan = _read(volume, None, {}) if volume else scan_of_field(mesh)
    shown = Shown(mesh.name, folder.parent if folder else Path("out"), folder, None, mesh, scan)
    shown.scan = _near(_in_world(scan, mesh), mesh)
    if scan.labels:
        shown.key = labels_of(scan)
    return shown


def folder_file(shown: Shown, ending: str) -> Path:
    """Return a file of the case, or that of a stage with a failed check."""
    assert shown.folder is not None
    path = shown.folder / f"{shown.name}.{ending}"
    failed = path.with_suffix(f".failed{path.suffix}")
    return failed if failed.exists() and not path.exists() else path


def _volume_of(case: Case) -> Path | None:
    """Return the volume of a case; None for a phantom, or if the file no longer exists."""
    paths = [Path(entry["path"]) for entry in case.inputs if entry["role"] == "volume"]
    return paths[0] if paths and paths[0].exists() else None


def _add_scan(shown: Shown) -> None:
    """Read the volume of a case, or show its distance field instead."""
    case = shown.case
    assert case is not None
    source = dig(case.reports, "distfield", "results", "meta", "source")
    is_labels = bool({"LABELS", "MATERIALS"} & set(case.parameters)) if source is None else source == "labels"
    is_labels = is_labels or bool(dig(case.reports, "distfield", "parameters", "materials"))
    if shown.volume is not None:
        try:
            shown.scan = _read(shown.volume, is_labels, dig(case.reports, "distfield", "parameters") or {})
        except Error as error:
            shown.notes.append(f"The volume cannot be shown: {error.what}. The slices show the distance field.")
    elif shown.mesh is not None:
        shown.notes.append("The volume of the case was not found. The slices show the distance field.")
    # the table of materials is in the field data of the file
    is_many = shown.mesh is not None and bool(shown.mesh.result.materials)
    surface: Any = pv.read(folder_file(shown, "surface.vtp")) if is_many else None
    if shown.scan is None and shown.mesh is not None:
        shown.scan = scan_of_field(shown.mesh)
    shown.key = key_of(case, shown.scan, surface)
    if shown.scan is not None and shown.mesh is not None:
        shown.scan = _near(_in_world(shown.scan, shown.mesh), shown.mesh)


def _read(path: Path, is_labels: bool | None, reading: dict[str, object]) -> Scan:
    """Read a volume. If ``is_labels`` is None, the data type, names and values decide."""
    scan = read_scan(path, bool(is_labels), reading)
    if is_labels is None and np.issubdtype(scan.values.dtype, np.integer):
        scan = replace(scan, labels=bool(scan.names) or len(np.unique(scan.values)) <= MAX_LABELS)
    return scan.upright()


def labels_of(scan: Scan) -> list[Entry]:
    """Return the names and colours of the labels of a volume; empty for a scan."""
    if not scan.labels:
        return []
    nothing = Case("", "", "passed", "", [], {}, None, [], [])
    return key_of(nothing, scan, None)


def scan_of_field(mesh: Mesh) -> Scan:
    """Return the distance field, or the materials, as a volume."""
    field = mesh.field
    values = field.array
    return Scan(
        values,
        field.direction * field.spacing,
        np.array(field.origin),
        field.space == "lps",
        dict(enumerate(field.materials)),
        labels=bool(field.materials),
    ).upright()


def _in_world(scan: Scan, mesh: Mesh) -> Scan:
    """Convert a volume from LPS to the world frame of the mesh."""
    if not scan.anatomical or mesh.field.space != "ras":
        return scan
    turned = replace(scan, step=FLIP[:, None] * scan.step, origin=FLIP * scan.origin)
    return replace(turned, anatomical=False).upright()


def _near(scan: Scan, mesh: Mesh) -> Scan:
    """Return the part of a volume around a mesh, or the whole volume if they do not overlap."""
    index = scan.to_index(mesh.result.vertices)
    last = np.array(scan.values.shape) - 1
    is_apart = (index.max(axis=0) < 0).any() or (index.min(axis=0) > last).any()
    return scan if is_apart else scan.around(index, MARGIN)


def centre_of(shown: Shown) -> Sequence[float]:
    """Return the position at which the page starts: the centre of the surface or of the volume."""
    if shown.mesh is not None:
        vertices = shown.mesh.result.vertices
        middle: list[float] = (0.5 * (vertices.min(axis=0) + vertices.max(axis=0))).tolist()
        return middle
    assert shown.scan is not None
    last = 0.5 * (np.array(shown.scan.values.shape) - 1)
    centre: list[float] = (shown.scan.origin + shown.scan.step @ last).tolist()
    return centre

"""Write one ball in every input format, mesh each file, and compare the meshes.

    make formats                     # installs the packages of formats-requirements.txt
    tests/formats.py --bin target/release --work out/formats [--only WORD ...] [--data DATA]

`format_writers.py` writes the files with other programs. The mesh of each file must equal that of
the NRRD file to 1e-4 mm in world coordinates. For formats without a pose, world coordinates are
voxel indices times the spacing. RAS output must differ from LPS only by the signs of x and y.
Folders of twelve overlapping masks, made from the torso phantom and from `thorax_labels` in DATA,
must give one conforming mesh that passes all checks. The numbers of reassigned voxels must equal
those counted with NumPy. With --large, only the times to read 512^3 voxels are measured. The exit
code is 1 if anything differs.
"""

from __future__ import annotations

import argparse
import gzip
import importlib
import json
import shutil
import subprocess
import sys
import time
import zlib
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pydicom
import pyvista
import SimpleITK as sitk  # noqa: N813
import tifffile
import zarr
from format_writers import WRITERS, Ball, Written, chosen, written

TOLERANCE = 1e-4
"""Maximum difference of the vertices in mm. Spacings and directions in float32, as in NIfTI, cause
3e-6 mm."""
EDGE = 3.0
"""Edge length of the ball in mm: 270 vertices."""
SCALED = ["--scale-for-size", "4"]
"""Scale of the twelve masks, for edges of 4 mm. At scale 0, thin remainders of masks between others
would force poor triangles."""
LARGE = Ball(size=(512, 512, 512), centre=(250.0, 260.0, 245.0), radius=170.0, noise=12.0)
"""The ball for the times of reading. Normal noise with a standard deviation of 12 has an entropy of
log2(12 sqrt(2 pi e)) = 5.6 bits per voxel, as in CT scans. Without noise, there would be almost
nothing to decompress."""
MOST_TIMES = 2.0
"""Maximum time to read a compressed volume, in units of the time to decompress it."""


class FailedError(Exception):
    """The failure of a program, with its error message."""


@dataclass(frozen=True)
class Programs:
    """Runs the stages in a folder of programs."""

    folder: Path

    def run(self, program: str, *words: str | Path) -> None:
        """Run a program. If it fails, raise an error with its message."""
        call = [str(self.folder / program), *map(str, words), "--force"]
        done = subprocess.run(call, capture_output=True, text=True, check=False)
        if done.returncode != 0:
            lines = done.stderr.strip().splitlines()
            first = next((line for line in lines if "error" in line.lower()), lines[0] if lines else "")
            raise FailedError(f"{program}, exit code {done.returncode}: {first}")

    def settled(self, field: Path, sizes: list[str]) -> tuple[Path, Path]:
        """Return the size field and the settled particles of a distance field."""
        size, seeds, particles = (field.with_name(name) for name in ("size.vti", "seeds.bin", "particles.bin"))
        self.run("sizefield", field, "-o", size, *sizes)
        self.run("seed", field, size, "-o", seeds)
        self.run("particles", seeds, "--distfield", field, "--sizefield", size, "-o", particles, "--backend", "cpu")
        return size, particles

    def surface(self, field: Path, sizes: list[str], name: str = "surface.vtp", *options: str) -> pyvista.PolyData:
        """Return the surface of a distance field."""
        size, particles = self.settled(field, sizes)
        surface = field.with_name(name)
        self.run("reconstruct", particles, "--distfield", field, "--sizefield", size, "-o", surface, *options)
        return pyvista.read(surface)


def meshed(programs: Programs, file: Written | str, kind: str, work: Path) -> tuple[pyvista.PolyData, float]:
    """Return the surface of a file and the seconds that reading took."""
    if isinstance(file, str):
        raise FailedError(file)
    field, report = work / "field.vti", work / "distfield.json"
    if file.array is None:
        selection = ["--iso", "0"] if kind == "scan" else ["--labels", file.label]
        programs.run("distfield", file.path, *selection, *spacing_of(file), "-o", field, "--report", report)
        seconds = read_seconds(report)
    else:
        seconds = field_by_package(file, kind, field)
    return programs.surface(field, ["--uniform", str(EDGE)]), seconds


def read_seconds(report: Path) -> float:
    """Return the time of the step that reads the volume."""
    steps = json.loads(report.read_text())["steps"]
    return sum(step["seconds"] for step in steps if step["name"] == "read")


def spacing_of(file: Written) -> list[str]:
    """Return the option for a file without a spacing."""
    return ["--spacing", ",".join(map(str, file.spacing))] if file.spacing else []


def read_by_package(file: Written) -> tuple[Any, float]:
    """Return a file as the Python package reads it, and the seconds that reading took."""
    try:
        images = importlib.import_module("isoparticles._images")
    except ImportError as error:
        raise FailedError(f"the Python package: {error}") from error
    start = time.perf_counter()
    try:
        image = images.source(file.path, file.spacing, dataset=file.array)
    except Exception as error:
        raise FailedError(str(error).splitlines()[0]) from error
    return image, time.perf_counter() - start


def field_by_package(file: Written, kind: str, field: Path) -> float:
    """Compute the distance field of a file that the Python package reads; return the read time."""
    _, seconds = read_by_package(file)
    iso = importlib.import_module("isoparticles")
    selection = {"iso": 0.0} if kind == "scan" else {"labels": [1]}
    iso.distance_field(file.path, spacing=file.spacing, dataset=file.array, **selection).save(field)
    return seconds


def difference(found: pyvista.PolyData, reference: pyvista.PolyData, matrix: np.ndarray) -> float:
    """Return the largest difference between the vertices of a mesh and those of the reference.

    The matrix transforms the reference. The triangles must be the same, except for orientation.
    """
    moved = reference.points @ matrix[:3, :3].T + matrix[:3, 3]
    same = found.n_points == reference.n_points and found.n_cells == reference.n_cells
    if not same or (np.sort(found.regular_faces) != np.sort(reference.regular_faces)).any():
        return float("inf")
    return float(np.abs(found.points - moved).max())


def from_sphere(found: pyvista.PolyData, ball: Ball) -> float:
    """Return the largest distance of a vertex from the sphere."""
    centre = (ball.lps @ [*ball.centre, 1.0])[:3]
    return float(np.abs(np.linalg.norm(found.points - centre, axis=1) - ball.radius).max())


def compare(programs: Programs, work: Path, only: list[str]) -> bool:
    """Mesh the ball of each file, and print the table; return whether all meshes agree."""
    ball = Ball()
    references: dict[str, pyvista.PolyData] = {}
    voxel = max(ball.spacing)
    fits = True
    print(f"Vertices must agree to {TOLERANCE:g} mm; those of contours must lie within {voxel} mm of the sphere.\n")
    print("| format | written by | of | vertices | difference, mm | read, ms |\n|---|---|---|---|---|---|", flush=True)
    rows = [(writer, kind) for writer in WRITERS[:1] + chosen(only) for kind in writer.kinds]
    for number, (writer, kind) in enumerate(dict.fromkeys(rows)):
        here = work / f"{number:02}-{kind}"
        cells = ["", "", ""]
        try:
            file = written(writer, here / "input", ball, kind)
            surface, seconds = meshed(programs, file, kind, here)
            reference = references.setdefault(kind, surface)
            if file.drawn:
                off, limit = from_sphere(surface, file.drawn), voxel
            else:
                off, limit = difference(surface, reference, file.matrix @ np.linalg.inv(ball.lps)), TOLERANCE
            fits &= off <= limit
            cells = [f"{surface.n_points}", f"{off:.1e}{'' if off <= limit else ' FAILED'}", f"{1000 * seconds:.1f}"]
        except FailedError as error:
            fits = False
            cells[1] = f"FAILED: {error}"
        print(f"| {writer.name} | {writer.program} | {kind} | {' | '.join(cells)} |", flush=True)
    return fits


def check_spaces(programs: Programs, work: Path) -> bool:
    """Return whether RAS and LPS differ only by the signs of x and y, in each surface format."""
    file = written(WRITERS[0], work / "space" / "input", Ball(), "scan")
    field = work / "space" / "field.vti"
    programs.run("distfield", file.path, "--iso", "0", "-o", field)
    fits = True
    for ending in ("vtp", "ply", "stl", "obj", "vtk"):
        try:
            meshes = [
                programs.surface(field, ["--uniform", str(EDGE)], f"{space}.{ending}", "--space", space)
                for space in ("lps", "ras")
            ]
        except FailedError as error:
            print(f"RAS and LPS, .{ending}: FAILED: {error}")
            return False
        lps, ras = meshes
        same = np.array_equal(ras.points, lps.points * [-1, -1, 1]) and np.array_equal(ras.faces, lps.faces)
        print(f"RAS and LPS, .{ending}: {'only the signs of x and y differ' if same else 'FAILED'}", flush=True)
        fits &= same
    return fits


def twelve_masks(labels: np.ndarray) -> dict[str, np.ndarray]:
    """Return twelve overlapping masks: both sides of organs, both ends of the body, and balls."""
    inside = np.argwhere(labels > 0)
    low, high = inside.min(axis=0), inside.max(axis=0)
    at = np.stack(np.meshgrid(*map(np.arange, labels.shape), indexing="ij", sparse=False))
    share = (at - low[:, None, None, None]) / (high - low)[:, None, None, None]
    counts = Counter(labels[labels > 0].tolist())
    organs = sorted(counts, key=lambda label: counts[label])[:-1]
    masks = {}
    for label in organs:
        masks[f"organ_{label}_right"] = (labels == label) & (share[0] < 0.53)
        masks[f"organ_{label}_left"] = (labels == label) & (share[0] > 0.47)
    masks["body_lower"] = (labels > 0) & (share[2] < 0.55)
    masks["body_upper"] = (labels > 0) & (share[2] > 0.45)
    width = (high - low)[0]
    for number in range(12 - len(masks)):
        centre = low + (high - low) * [0.3 + 0.1 * number, 0.45, 0.35 + 0.05 * number]
        ball = np.linalg.norm(at - centre[:, None, None, None], axis=0) < 0.09 * width
        masks[f"ball_{number}"] = ball & (labels > 0)
    return masks


def reassigned(masks: dict[str, np.ndarray]) -> Counter[tuple[str, str]]:
    """Count the voxels that the smallest of overlapping masks keeps and each other mask loses."""
    names = sorted(masks, key=lambda name: int(masks[name].sum()))
    pairs: Counter[tuple[str, str]] = Counter()
    free = np.ones(next(iter(masks.values())).shape, dtype=bool)
    for rank, kept in enumerate(names):
        own = masks[kept] & free
        free &= ~own
        pairs.update({(kept, lost): int((own & masks[lost]).sum()) for lost in names[rank + 1 :]})
    return +pairs


def check_masks(programs: Programs, work: Path, name: str, volume: Path, step: int) -> bool:
    """Mesh twelve masks made from a label map; return whether the mesh and its report are right."""
    image = sitk.ReadImage(str(volume))[::step, ::step, ::step]
    masks = twelve_masks(sitk.GetArrayFromImage(image).T)
    here = work / name
    (here / "masks").mkdir(parents=True)
    for mask, voxels in masks.items():
        file = sitk.GetImageFromArray(np.ascontiguousarray(voxels.T.astype(np.uint8)))
        file.CopyInformation(image)
        sitk.WriteImage(file, here / "masks" / f"{mask}.nii.gz")
    field, report = here / "field.vti", here / "distfield.json"
    try:
        programs.run("distfield", here / "masks", "--material", "all", *SCALED, "-o", field, "--report", report)
        surface = programs.surface(field, ["--uniform", SCALED[1]])
    except FailedError as error:
        print(f"twelve masks of {name}: FAILED: {error}")
        return False
    reported = {
        (pair["kept"], pair["lost"]): pair["voxels"] for pair in json.loads(report.read_text())["results"]["overlaps"]
    }
    counted = reassigned(masks)
    verdict = f"equal NumPy's in all {len(counted)} pairs" if reported == counted else "FAILED: differ from NumPy's"
    print(
        f"twelve masks of {name}: one conforming mesh, {surface.n_points} vertices, all checks passed; "
        f"{counted.total()} reassigned voxels {verdict}",
        flush=True,
    )
    return reported == counted


def files_of(path: Path) -> list[Path]:
    """Return the file, or the files in the folder."""
    return sorted(file for file in path.rglob("*") if file.is_file()) if path.is_dir() else [path]


def inflated(path: Path, after: bytes = b"") -> None:
    """Decompress the zlib or gzip stream that starts after some bytes."""
    data = path.read_bytes()
    start = data.index(after) + len(after)
    zlib.decompress(data[start:], wbits=zlib.MAX_WBITS | 32)


DECODERS: dict[str, tuple[bool, Callable[[Path], object]]] = {
    "NRRD, gzip": (True, lambda path: inflated(path, b"\n\n")),
    ".nii.gz": (True, lambda path: gzip.decompress(path.read_bytes())),
    ".mgz": (True, lambda path: gzip.decompress(path.read_bytes())),
    "MetaImage": (True, lambda path: inflated(path, b"ElementDataFile = LOCAL\n")),
    ".vti": (True, pyvista.read),
    "JPEG": (True, lambda path: [pydicom.dcmread(file).pixel_array for file in files_of(path)]),
    "TIFF, a folder": (True, lambda path: [tifffile.imread(file) for file in files_of(path)]),
    "HDF5": (True, lambda path: h5py.File(path)["group/ball"][...]),
    ".mat 5": (True, lambda path: zlib.decompress(path.read_bytes()[136:])),
    "Zarr": (True, lambda path: zarr.open(path)["s0"][...]),
    "": (False, lambda path: [file.read_bytes() for file in files_of(path)]),
}
"""By a part of the name of a format: whether it is compressed, and a function that reads it,
with zlib or the library of the program that wrote it."""


def seconds_of(action: Callable[[], object]) -> float:
    """Return the shortest of three times."""
    times = []
    for _ in range(3):
        start = time.perf_counter()
        action()
        times.append(time.perf_counter() - start)
    return min(times)


def read_times(programs: Programs, work: Path, only: list[str]) -> bool:
    """Print the times to read the large scan; return whether none exceeds ``MOST_TIMES``."""
    fits = True
    print("| format | written by | MB | only decompress, s | read, s | ratio |\n|---|---|---|---|---|---|", flush=True)
    for writer in [writer for writer in chosen(only) if writer.is_large]:
        folder = work / "large"
        try:
            file = written(writer, folder, LARGE, "scan")
            if isinstance(file, str):
                raise FailedError(file)
            is_compressed, decode = next(found for name, found in DECODERS.items() if name in writer.name)
            size = sum(part.stat().st_size for part in files_of(file.path)) / 1e6
            alone = seconds_of(lambda: decode(file.path))  # noqa: B023 - called at once
            taken = min(read_alone(programs, file, folder) for _ in range(3))
            is_slow = is_compressed and taken > MOST_TIMES * alone
            fits &= not is_slow
            text = f"{size:.0f} | {alone:.2f} | {taken:.2f} | {taken / alone:.2f}{' FAILED' if is_slow else ''}"
        except FailedError as error:
            fits = False
            text = f" | | | FAILED: {error}"
        print(f"| {writer.name} | {writer.program} | {text} |", flush=True)
        shutil.rmtree(folder)
    return fits


def read_alone(programs: Programs, file: Written, folder: Path) -> float:
    """Return the time to read a file."""
    if file.array is not None:
        return read_by_package(file)[1]
    report = folder / "convert.json"
    programs.run(
        "isoparticles-volume", "convert", file.path, *spacing_of(file), "-o", folder / "c.vti", "--report", report
    )
    return read_seconds(report)


def main() -> int:
    """Run the checks; return 1 if one of them fails."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--bin", type=Path, default=Path("target/release"), help="folder of the programs")
    parser.add_argument(
        "--work", type=Path, default=Path("out/formats"), help="folder for files; its content is deleted"
    )
    parser.add_argument("--data", type=Path, help="folder of thorax_labels.nrrd")
    parser.add_argument("--only", nargs="+", default=[], metavar="WORD", help="formats or programs with such a word")
    parser.add_argument("--large", action="store_true", help="measure the times to read 512^3 voxels, nothing else")
    arguments = parser.parse_args()
    work, programs = arguments.work.resolve(), Programs(arguments.bin.resolve())
    shutil.rmtree(work, ignore_errors=True)
    work.mkdir(parents=True)
    if arguments.large:
        return int(not read_times(programs, work, arguments.only))
    fits = compare(programs, work, arguments.only)
    if not arguments.only:
        print()
        fits &= check_spaces(programs, work)
        torso = work / "torso.nrrd"
        programs.run("phantom", "torso", "--kind", "label", "--size", "134,65,89", "--spacing", "2.6", "-o", torso)
        fits &= check_masks(programs, work, "the torso phantom", torso, 1)
        thorax = arguments.data / "thorax_labels.nrrd" if arguments.data else None
        if thorax and thorax.exists():
            fits &= check_masks(programs, work, "thorax_labels", thorax, 2)
        else:
            print("twelve masks of thorax_labels: skipped, --data has no such file")
    return int(not fits)


if __name__ == "__main__":
    sys.exit(main())

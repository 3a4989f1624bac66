"""Compare meshes of many materials with CGAL's Mesh_3, Cleaver and VTK's surface nets.

    materials_peers.py NAME=VOLUME;DISTFIELD OPTIONS;SIZEFIELD OPTIONS ... [--cleaver PYTHON]
        [--mesh-3 PROGRAM]

Run it with the Python of `make env` (`make bench-materials-peers` does). VOLUME is a file, or the
arguments of `phantom` that make one. $NAME inserts an environment variable. Our programs run all
stages from labels to tetrahedra. Mesh_3 (mesh_3.cpp in this folder) and Cleaver (cleaver.py) get
the same labels, padded with one layer of background voxels. Their edge length is adjusted in up to
four attempts, until their number of interface triangles differs from ours by at most a quarter. The
time is that of the last attempt. In the rows with "protected", Mesh_3 preserves the voxel edges
along which three or more materials meet. For surface nets, the grid determines the triangles.
tests/check_materials.py, which shares no code with any of the programs, measures every mesh.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pyvista as pv

ROOT = Path(__file__).resolve().parents[3]
sys.path.insert(0, str(ROOT / "tests"))
from check_materials import look, materials_of, note  # noqa: E402

TRIES = 4
CLOSE = 0.25


@dataclass
class Peer:
    """A mesh that another program makes from the labels."""

    points: np.ndarray
    """In units of voxels of the padded grid; 0 is the centre of the first voxel."""
    tetrahedra: np.ndarray
    regions: np.ndarray
    seconds: float
    memory: int


class FailedError(Exception):
    """A program made no mesh; the message gives the reason."""


def timed(command: list[str], limit: float) -> float:
    """Run a program and return its time in seconds."""
    started = time.monotonic()
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as process:
        try:
            process.wait(limit)
        except subprocess.TimeoutExpired as error:
            process.kill()
            raise FailedError(f"no result in {limit:.0f} s") from error
        told = process.stderr.read().decode().strip().splitlines() if process.stderr else []
    if process.returncode not in (0, 1):
        raise FailedError(f"exit code {process.returncode}: {told[0] if told else ''}")
    return time.monotonic() - started


def interfaces(points: np.ndarray, tetrahedra: np.ndarray, regions: np.ndarray) -> tuple[np.ndarray, ...]:
    """Return the triangles between materials, and the numbers of the materials on both sides.

    The triangles face outward from the material with the higher number.
    """
    corners = points[tetrahedra]
    turned = (
        np.einsum(
            "ij,ij->i",
            np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]),
            corners[:, 3] - corners[:, 0],
        )
        < 0
    )
    cells = tetrahedra.copy()
    cells[turned] = cells[turned][:, [1, 0, 2, 3]]
    faces = np.concatenate([cells[:, list(face)] for face in ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))])
    inside = np.tile(regions, 4)
    order = np.lexsort(np.sort(faces, axis=1).T)
    faces, inside = faces[order], inside[order]
    key = np.sort(faces, axis=1)
    with_next = np.append((key[1:] == key[:-1]).all(axis=1), False)
    with_last = np.append(False, with_next[:-1])
    other = np.where(with_next, np.append(inside[1:], 0), np.where(with_last, np.append(0, inside[:-1]), 0))
    # keep each triangle once, with the higher material number inside
    kept = inside > other
    return faces[kept], inside[kept], other[kept]


def row(name: str, program: str, figures: dict[str, Any] | None, seconds: str, memory: str, why: str = "") -> None:
    """Print one row."""
    if figures is None:
        print(f"| {name} | {program} | {why} |" + " |" * 11, flush=True)
        return
    tetrahedra, dihedral = "-", "-"
    if "tetrahedra" in figures:
        tetrahedra = f"{figures['tetrahedra']:,}"
        dihedral = f"{figures['dihedral_smallest']:.1f} / {figures['dihedral_1_percent']:.1f}"
    columns = [
        name,
        program,
        f"{figures['triangles']:,}",
        f"{figures['radius_ratio_mean']:.3f} / {figures['radius_ratio_smallest']:.3f}",
        f"{figures['angle_smallest']:.0f} to {figures['angle_largest']:.0f}",
        f"{figures['turn_rms']:.1f}",
        tetrahedra,
        dihedral,
        f"{figures['voxels_changed_percent']:.3f}",
        str(len(figures["components_lost"])),
        f"{figures['junctions_kept_percent']:.1f} / {figures['junctions_spurious_percent']:.1f}",
        str(figures["unbalanced_edges"]),
        seconds,
        memory,
    ]
    print("| " + " | ".join(columns) + " |", flush=True)


@dataclass
class Case:
    """A label map, and the options common to all its rows."""

    name: str
    volume: str
    distfield: list[str]
    sizefield: list[str]
    arguments: argparse.Namespace

    def file(self, ending: str) -> Path:
        """Return the path of a file of the case."""
        return Path(self.arguments.work) / f"{self.name}.{ending}"

    def ours(self) -> tuple[pv.PolyData, pv.UnstructuredGrid, float, int]:
        """Run all stages; return surface, tetrahedra, seconds and peak memory."""
        programs = Path(self.arguments.bin)
        fields = ["--distfield", str(self.file("f.vti")), "--sizefield", str(self.file("s.vti"))]
        steps = [
            [programs / "distfield", self.volume, *self.distfield, "-o", self.file("f.vti")],
            [programs / "sizefield", self.file("f.vti"), *self.sizefield, "-o", self.file("s.vti")],
            [programs / "seed", self.file("f.vti"), self.file("s.vti"), "-o", self.file("seeds.bin")],
            [programs / "particles", self.file("seeds.bin"), *fields, "-o", self.file("p.bin"), "--backend", "cpu"],
            [programs / "reconstruct", self.file("p.bin"), *fields, "-o", self.file("m.vtp")],
            [self.arguments.tetmesh_check, self.file("m.vtp"), *fields[2:], "-o", self.file("m.vtu"), "--solve", "no"],
        ]
        seconds, memory = 0.0, 0
        report = self.file("json")
        for step in steps:
            command = [str(word) for word in step]
            seconds += timed([*command, "--force", "-q", "--report", str(report)], self.arguments.limit)
            memory = max(memory, json.loads(report.read_text())["peak_memory_bytes"])
        return pv.read(self.file("m.vtp")), pv.read(self.file("m.vtu")), seconds, memory

    def labels(self) -> pv.ImageData:
        """Return the label map, as converted by `isoparticles-volume`."""
        path = self.file("labels.vti")
        program = Path(self.arguments.bin) / "isoparticles-volume"
        subprocess.run([program, "convert", self.volume, "-o", path, "--force", "-q"], check=True)
        return pv.read(path)


def by_cleaver(case: Case, materials: np.ndarray, length: float) -> Peer:
    """Mesh with Cleaver, with `length` (in voxels) as the lattice spacing."""
    job, result = case.file("cleaver.job.npz"), case.file("cleaver.npz")
    result.unlink(missing_ok=True)
    np.savez(job, materials=materials, sampling=1.0 / length)
    script = Path(__file__).with_name("cleaver.py")
    timed([case.arguments.cleaver, str(script), str(job), str(result)], case.arguments.limit)
    with np.load(result) as made:
        regions = made["regions"]
        # Cleaver pads the image with an additional region
        regions = np.where(regions > materials.max(), 0, regions)
        return Peer(
            made["points"], made["tetrahedra"].astype(np.int64), regions, float(made["seconds"]), int(made["bytes"])
        )


def junctions_of(materials: np.ndarray) -> list[np.ndarray]:
    """Return the voxel edges where three or more materials meet, as polylines, in voxels."""
    edges: list[tuple[tuple[float, ...], tuple[float, ...]]] = []
    for axis in range(3):
        first, second = (other for other in range(3) if other != axis)
        four = [np.roll(materials, (-a, -b), (first, second)) for a in (0, 1) for b in (0, 1)]
        stacked = np.sort(np.stack(four), axis=0)
        several = (np.diff(stacked, axis=0) != 0).sum(axis=0) >= 2
        for place in np.argwhere(several):
            middle = place.astype(np.float64)
            middle[[first, second]] += 0.5
            half = np.zeros(3)
            half[axis] = 0.5
            edges.append((tuple(middle - half), tuple(middle + half)))
    near: dict[tuple[float, ...], list[int]] = {}
    for number, ends in enumerate(edges):
        for end in ends:
            near.setdefault(end, []).append(number)
    left = set(range(len(edges)))
    lines = []
    # trace open lines first, from end points and crossings, and then closed lines
    starts = [point for point, of in near.items() if len(of) != 2] + list(near)
    for start in starts:
        for first_edge in near[start]:
            if first_edge not in left:
                continue
            line, edge = [start], first_edge
            while True:
                left.discard(edge)
                a, b = edges[edge]
                line.append(b if a == line[-1] else a)
                following = [other for other in near[line[-1]] if other in left]
                if len(near[line[-1]]) != 2 or not following:
                    break
                edge = following[0]
            lines.append(np.array(line))
    return lines


def by_mesh_3(case: Case, materials: np.ndarray, length: float, protect: bool) -> Peer:
    """Mesh with CGAL's Mesh_3; lengths are in voxels."""
    raw, lines, out = case.file("labels.raw"), case.file("junctions.txt"), case.file("mesh_3.txt")
    materials.astype(np.uint8).ravel(order="F").tofile(raw)
    polylines = junctions_of(materials) if protect else []
    lines.write_text(
        "".join(f"{len(line)}\n" + "".join("{:g} {:g} {:g}\n".format(*p) for p in line) for line in polylines)
    )
    out.unlink(missing_ok=True)
    size = [str(count) for count in materials.shape]
    command = [case.arguments.mesh_3, str(raw), *size, "1", "1", "1", repr(length), str(lines), str(out)]
    seconds = timed(command, case.arguments.limit)
    numbers = np.fromstring(out.read_text(), sep=" ")
    points, cells, memory = numbers[:3].astype(np.int64).tolist()
    rows = numbers[3 + 3 * points :].astype(np.int64).reshape(cells, 5)
    return Peer(numbers[3 : 3 + 3 * points].reshape(-1, 3), rows[:, :4], rows[:, 4], seconds, 1024 * memory)


def peer_rows(case: Case, labels: pv.ImageData, table: str, materials: np.ndarray, ours: int, length: float) -> None:
    """Print the rows of the other programs."""
    padded = np.pad(materials, 1)
    matrix = np.asarray(labels.direction_matrix).reshape(3, 3) * np.asarray(labels.spacing)

    def world(points: np.ndarray) -> np.ndarray:
        return (points - 1.0) @ matrix.T + np.asarray(labels.origin)

    def surface_of(points: np.ndarray, triangles: np.ndarray, inside: np.ndarray, outside: np.ndarray) -> pv.PolyData:
        surface = pv.PolyData.from_regular_faces(world(points), triangles)
        surface.cell_data["material_inside"], surface.cell_data["material_outside"] = inside, outside
        surface.field_data["meta"] = np.frombuffer(table.encode(), dtype=np.uint8)
        return surface

    programs = {}
    if case.arguments.mesh_3:
        programs["CGAL Mesh_3, protected"] = lambda at: by_mesh_3(case, padded, at, True)
        programs["CGAL Mesh_3"] = lambda at: by_mesh_3(case, padded, at, False)
    if case.arguments.cleaver:
        programs["Cleaver 2"] = lambda at: by_cleaver(case, padded, at)
    for program, made_by in programs.items():
        at = length
        try:
            for _ in range(TRIES):
                peer = made_by(at)
                faces = interfaces(peer.points, peer.tetrahedra, peer.regions)
                if abs(len(faces[0]) / ours - 1.0) <= CLOSE:
                    break
                at *= float(np.sqrt(len(faces[0]) / ours))
        except FailedError as reason:
            row(case.name, program, None, "", "", str(reason))
            continue
        own = peer.regions > 0
        grid = pv.UnstructuredGrid({pv.CellType.TETRA: peer.tetrahedra[own]}, world(peer.points))
        figures = look(surface_of(peer.points, *faces), labels, grid)
        row(case.name, program, figures, f"{peer.seconds:.1f}", f"{peer.memory / 2**20:,.0f}")

    image = pv.ImageData(dimensions=padded.shape)
    image["material"] = padded.ravel(order="F").astype(np.int16)
    started = time.monotonic()
    nets = image.contour_labels(output_mesh_type="triangles", scalars="material", boundary_style="all")
    seconds = time.monotonic() - started
    sides = np.asarray(nets.cell_data["boundary_labels"]).astype(np.int64)
    high, low = sides.max(axis=1), sides.min(axis=1)
    triangles = nets.regular_faces.astype(np.int64)
    turned = sides[:, 0] != high
    triangles[turned] = triangles[turned][:, ::-1]
    figures = look(surface_of(np.asarray(nets.points, dtype=np.float64), triangles, high, low), labels, None)
    row(case.name, "surface nets (VTK), smoothed", figures, f"{seconds:.1f}", "-")


def main() -> None:
    """Read the command line and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="+", metavar="CASE")
    parser.add_argument("--bin", type=Path, default=Path("target/release"), help="folder of the stage programs")
    parser.add_argument("--tetmesh-check", type=Path, default=Path(".venv/bin/tetmesh-check"))
    parser.add_argument("--work", type=Path, default=Path("out/materials-peers"), help="folder for the files")
    parser.add_argument("--cleaver", metavar="PYTHON", help="an interpreter with cleaver.lock")
    parser.add_argument("--mesh-3", metavar="PROGRAM", help="mesh_3.cpp, compiled")
    parser.add_argument("--limit", type=float, default=600.0, metavar="SECONDS", help="how long a program may take")
    arguments = parser.parse_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    print(
        "| labels | program | interface triangles | radius ratio, mean / smallest | angles, degrees | turn between neighbours, rms, degrees"
        " | tetrahedra | dihedral angle, smallest / 1 % | voxels changed, % | components lost | junctions kept / spurious, %"
        " | unbalanced edges | s | MiB |\n" + "|---" * 14 + "|"
    )
    for text in arguments.cases:
        name, _, rest = text.partition("=")
        volume, distfield, sizefield = [*os.path.expandvars(rest).split(";"), "", ""][:3]
        if not Path(volume).exists():
            words, volume = volume.split(), str(arguments.work / f"{name}.nrrd")
            subprocess.run([arguments.bin / "phantom", *words, "-o", volume, "--force"], check=True)
        case = Case(name, volume, distfield.split(), sizefield.split(), arguments)
        labels = case.labels()
        surface, tetrahedra, seconds, memory = case.ours()
        figures = look(surface, labels, tetrahedra)
        row(name, "isoparticles", figures, f"{seconds:.1f}", f"{memory / 2**20:,.0f}")
        meta = note(surface, "meta")
        sides = surface.points[surface.regular_faces]
        mean = float(np.linalg.norm(sides - np.roll(sides, 1, axis=1), axis=2).mean())
        materials = materials_of(labels, meta["materials"])
        table = json.dumps({"materials": meta["materials"]})
        peer_rows(case, labels, table, materials, len(surface.regular_faces), mean / float(min(labels.spacing)))


if __name__ == "__main__":
    main()

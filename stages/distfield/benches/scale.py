"""Meshes volumes at several vertex counts and prints a table of the results.

    scale.py @solid.txt @thin.txt [--vertices 1000 5000 20000 75000] [--backend gpu]
        [--no-distances] [--tetrahedra .venv/bin/tetmesh-check]
        [--peers .venv-bench-scale/bin/python]

CASE is NAME=VOLUME;DISTFIELD OPTIONS[;SIZEFIELD OPTIONS]. @FILE inserts the lines of a file (for
example solid.txt and thin.txt in this folder), except lines that start with #. $NAME inserts an
environment variable (DATA is the folder of the real volumes). Each vertex count is passed to
distfield as --scale-for-vertices and to sizefield as --vertices. Run the script with the Python of
`make env`; with --no-distances, any Python 3.11 suffices.

A row for isoparticles shows one run from the volume to the checked surface. "components" is the
number of components of the mesh. The brackets contain the number of components of the voxels before
and after smoothing, and the number of changes of each kind. "s" is the time from the volume to the
surface in seconds and, in brackets, from the smoothed field to the surface. With --tetrahedra,
tetmesh-check fills the surface with tetrahedra and runs all its default checks; the column contains
the number of tetrahedra and the exit code.

Rows for other remeshers (--programs) require --peers PYTHON, an interpreter with the packages in
peers.lock, which `make bench-scale` creates. Each program remeshes the marching-cubes surface of
the same smoothed field to the same number of vertices, to within 3 %. The time is that of marching
cubes and the last try. The angles, ratios and volumes of these meshes are computed here; those of
isoparticles come from the report. "crossing" is the number of pairs of intersecting triangles. For
marching cubes and surface nets, the grid determines the number of vertices.

If the options of a case include --scale, as in @remeshers.txt, that scale applies to all vertex
counts, and distances are measured from the zero set of the field at that scale.

With --as-given, scale and edge length come from the options of the case (@peers.txt: `make
bench-peers`), and the peers start from the label map: VTK reads it, the mask of the label is
blurred by a Gaussian with a standard deviation of half the scale, and marching cubes runs at level
0.5. The time is then measured from the volume to the triangles and includes only the last try. For
isoparticles, it includes reading and writing, and is followed by the time of each stage.

"distance" is the distance of vertices and triangle centroids from the surface at scale 0, which
keeps every voxel centre on its side: mean, 99th percentile and maximum, mm. "lost" is the distance
of the surface at scale 0 from the smoothed surface: 99th percentile and maximum, mm; it is large
where parts vanished. "volume" is the relative difference between the volume of the mesh and that of
the voxels, %.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import numpy as np
    import pyvista as pv


class RefusedError(Exception):
    """A stage failed without output. The message is the error of the stage."""


@dataclass
class Case:
    """A surface in a volume, with the programs, the working folder and the options of a run."""

    name: str
    volume: str
    distfield: list[str]
    sizefield: list[str]
    programs: Path
    work: Path
    backend: str
    distances: bool
    tetmesh_check: Path | None
    peers: Path | None
    programs_beside: list[str]
    limit: float
    as_given: bool

    def run(
        self, key: str, program: str, *arguments: str, program_file: Path | None = None
    ) -> tuple[int, dict[str, Any]]:
        """Runs a stage. Returns its exit code and its report."""
        report = self.work / f"{self.name}.{key}.{program}.json"
        command = [str(program_file or self.programs / program), *arguments, "--force", "-q", "--report", str(report)]
        done = subprocess.run(command, check=False, stderr=subprocess.PIPE, text=True)
        if done.returncode not in (0, 1):
            raise RefusedError(f"{program}: {done.stderr.strip().splitlines()[0]}")
        return done.returncode, json.loads(report.read_text(encoding="utf-8"))

    def file(self, key: str, ending: str) -> str:
        """Returns the path of an output file of a run."""
        return str(self.work / f"{self.name}.{key}.{ending}")

    def exact(self) -> pv.ImageData:
        """Returns the distance field for the case's options, at scale 0 unless they set --scale."""
        path = self.file("exact", "distfield.vti")
        if not Path(path).exists():
            self.run("exact", "distfield", self.volume, *self.distfield, "-o", path)
        import pyvista as pv

        return pv.read(path)


def sample(field: pv.ImageData, points: np.ndarray) -> np.ndarray:
    """Interpolates a distance field (mm) trilinearly at points in world coordinates."""
    import numpy as np
    from scipy.ndimage import map_coordinates

    directions = np.array(field.direction_matrix)
    index = (points - np.array(field.origin)) @ np.linalg.inv(directions).T / np.array(field.spacing)
    values = np.asarray(field["signed_distance"]).reshape(field.dimensions[::-1])
    return map_coordinates(values, index[:, ::-1].T, order=1, mode="nearest")


def exact_surface(field: pv.ImageData) -> np.ndarray:
    """Returns the vertices of the zero set of a distance field, in world coordinates."""
    import numpy as np

    contour = field.contour([0.0], scalars="signed_distance")
    return np.asarray(contour.points)


def distances(case: Case, surface: str, distfield: str) -> tuple[str, str]:
    """Returns two texts: the columns "distance" and "lost" of the table (mm)."""
    import numpy as np
    import pyvista as pv

    exact, mesh = case.exact(), pv.read(surface)
    points = np.concatenate([np.asarray(mesh.points), np.asarray(mesh.cell_centers().points)])
    away = np.abs(sample(exact, points))
    lost = np.abs(sample(pv.read(distfield), exact_surface(exact)))
    told = f"{np.mean(away):.2f}, {np.quantile(away, 0.99):.2f}, {np.max(away):.2f}"
    return told, f"{np.quantile(lost, 0.99):.2f}, {np.max(lost):.2f}"


@dataclass
class Mesh:
    """Measurements of a mesh for one row of the table."""

    vertices: int
    ratio_mean: float
    ratio_least: float
    angle_least: float
    angle_largest: float
    volume: float
    components: int
    is_closed: bool


def measured(points: np.ndarray, triangles: np.ndarray) -> Mesh:
    """Measures a mesh made by another program. The radius ratio is 2 * inradius / circumradius."""
    import numpy as np
    from scipy.sparse import coo_matrix
    from scipy.sparse.csgraph import connected_components

    points = points - points.mean(axis=0)
    corners = points[triangles]
    sides = np.linalg.norm(corners[:, [1, 2, 0]] - corners[:, [2, 0, 1]], axis=2)
    a, b, c = sides.T
    ratio = (b + c - a) * (c + a - b) * (a + b - c) / np.maximum(a * b * c, 1e-300)
    cosines = (b**2 + c**2 - a**2) / (2 * b * c), (c**2 + a**2 - b**2) / (2 * c * a), (a**2 + b**2 - c**2) / (2 * a * b)
    angles = np.degrees(np.arccos(np.clip(cosines, -1.0, 1.0)))
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6.0
    used = np.unique(triangles)
    pairs = (triangles[:, [0, 1]].ravel(), triangles[:, [1, 2]].ravel())
    graph = coo_matrix((np.ones(len(pairs[0])), pairs), shape=(len(points), len(points)))
    _, labels = connected_components(graph, directed=False)
    sides_of = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, shared = np.unique(sides_of, axis=0, return_counts=True)
    return Mesh(
        len(points),
        ratio.mean(),
        ratio.min(),
        angles.min(),
        angles.max(),
        abs(volume),
        len(np.unique(labels[used])),
        bool((shared == 2).all()),
    )


def line(case: Case, vertices: int, program: str, mesh: Mesh, before: float, cells: dict[str, str]) -> str:
    """Returns one row of the table."""
    columns = [
        case.name,
        f"{vertices:,}" if vertices else "as given",
        program,
        cells["scale"],
        f"{mesh.vertices:,}" + (f" ({100 * (mesh.vertices / vertices - 1):+.1f} %)" if vertices else ""),
        cells["code"],
        f"{mesh.ratio_mean:.3f} / {mesh.ratio_least:.2f}",
        f"{mesh.angle_least:.0f} to {mesh.angle_largest:.0f}",
        cells["away"],
        cells["lost"],
        f"{100 * (mesh.volume / before - 1):+.2f}",
        f"{mesh.components}{cells['told']}",
        cells["crossing"],
        cells["tetrahedra"],
        cells["seconds"],
        cells["memory"],
    ]
    return "| " + " | ".join(columns) + " |"


def row(case: Case, vertices: int) -> tuple[str, float, int]:
    """Returns the row of isoparticles, the volume of the voxels (mm^3) and the vertex count.

    With 0 vertices, scale and edge length come from the options of the case.
    """
    key = str(vertices)
    sizes_for = ["--vertices", key] if vertices else []
    scale_for = ["--scale-for-vertices", key] if vertices and "--scale" not in case.distfield else []
    distfield, sizefield, seeds = (case.file(key, f"{e}") for e in ("distfield.vti", "sizefield.vti", "seeds.bin"))
    particles, surface = case.file(key, "particles.bin"), case.file(key, "surface.vtp")
    fields = ["--distfield", distfield, "--sizefield", sizefield]
    start = time.monotonic()
    reports = [case.run(key, "distfield", case.volume, *case.distfield, *scale_for, "-o", distfield)]
    smoothed = time.monotonic()
    reports += [
        case.run(key, "sizefield", distfield, *sizes_for, *case.sizefield, "-o", sizefield),
        case.run(key, "seed", distfield, sizefield, "-o", seeds),
        case.run(key, "particles", seeds, *fields, "-o", particles, "--backend", case.backend),
        case.run(key, "reconstruct", particles, *fields, "-o", surface),
    ]
    end = time.monotonic()
    meta = reports[0][1]["results"]["meta"]
    checked = reports[4][1]["results"]["check"]
    quality = checked["quality"]
    away, lost = distances(case, surface, distfield) if case.distances else ("-", "-")
    changes = meta.get("scale_changes", {})
    told = ", ".join(f"{count} {kind}" for kind, count in changes.get("counts", {}).items()) or "-"
    before = meta.get("volume_before", meta["volume"])
    mesh = Mesh(
        checked["vertices"],
        quality["radius_ratio_mean"],
        quality["radius_ratio_min"],
        quality["angle_min"],
        quality["angle_max"],
        checked["regions"][0]["volume"],
        len(checked["regions"][0]["components"]),
        checked["open_edges"] == 0,
    )
    stages = ", ".join(f"{report['seconds']:.1f}" for _, report in reports)
    scale = meta.get("scale", 0.0)
    cells = {
        "scale": f"{scale:.2f}",
        "code": str(max(code for code, _ in reports)),
        "away": away,
        "lost": lost,
        "told": f" ({' -> '.join(str(n) for n in changes['components'])} in voxels; {told})" if changes else "",
        "crossing": f"{checked['self_intersections']:,}",
        "tetrahedra": tetrahedra(case, key, surface, sizefield),
        "memory": f"{max(report['peak_memory_bytes'] for _, report in reports) / 2**20:,.0f}",
        "seconds": f"{end - start:.1f} ({stages})" if case.as_given else f"{end - start:.0f} ({end - smoothed:.1f})",
    }
    return line(case, vertices, "isoparticles", mesh, before, cells), before, mesh.vertices


def tetrahedra(case: Case, key: str, surface: str, sizefield: str) -> str:
    """Runs tetmesh-check on a surface; returns its number of tetrahedra and its exit code."""
    if case.tetmesh_check is None:
        return "-"
    volume = case.file(key, "volume.vtu")
    code, report = case.run(
        key, "tetmesh-check", surface, "--sizefield", sizefield, "-o", volume, program_file=case.tetmesh_check
    )
    return f"{report['results']['volume']['tetrahedra']:,}, exit code {code}"


def blurred(case: Case) -> pv.ImageData:
    """Returns one minus the blurred mask of the label, padded by one voxel.

    The standard deviation of the Gaussian is half the scale.
    """
    import numpy as np
    import pyvista as pv
    from scipy.ndimage import gaussian_filter

    label, scale = (float(case.distfield[case.distfield.index(name) + 1]) for name in ("--labels", "--scale"))
    volume = pv.read(case.volume)
    values = np.asarray(volume.active_scalars).reshape(volume.dimensions[::-1])
    sigma = 0.5 * scale / np.array(volume.spacing[::-1])
    indicator = gaussian_filter(np.pad(values == label, 1).astype(np.float32), sigma)
    origin = np.array(volume.origin) - volume.spacing
    made = pv.ImageData(dimensions=indicator.shape[::-1], spacing=volume.spacing, origin=origin)
    # larger outside, like a distance field
    made["outside"] = 1.0 - indicator.ravel()
    return made


def peer_row(case: Case, vertices: int, ours: int, before: float, program: str) -> str:
    """Returns the row of another remesher for the same field, with about `ours` vertices."""
    import numpy as np
    import pyvista as pv
    from isoparticles._native import self_intersections

    key = str(vertices)
    start = time.monotonic()
    field, level = (blurred(case), 0.5) if case.as_given else (pv.read(case.file(key, "distfield.vti")), 0.0)
    contour = nets(field, level) if program == "surface-nets" else field.contour([level], method="flying_edges")
    seconds = time.monotonic() - start
    job, result = case.file(key, "job.npz"), Path(case.file(key, f"{program}.npz"))
    np.savez(job, points=contour.points, triangles=contour.regular_faces, vertices=ours)
    result.unlink(missing_ok=True)
    script = Path(__file__).with_name("remesh_peers.py")
    remesher = "none" if program in AS_THEY_ARE else program
    try:
        command = [str(case.peers), str(script), remesher, job, str(result)]
        code = subprocess.run(command, check=False, capture_output=True, timeout=case.limit).returncode
    except subprocess.TimeoutExpired:
        code = 0
    if not result.is_file():
        why = f"failed with exit code {code}" if code else f"no result in {case.limit:.0f} s"
        return f"| {case.name} | {vertices:,} | {PEERS[program]} | {why} |" + " |" * 12
    with np.load(result) as made:
        points, triangles = made["points"].astype(np.float64), made["triangles"].astype(np.int64)
        seconds += float(made["seconds"])
        memory = int(made["bytes"])
    mesh = measured(points, triangles)
    surface = case.file(key, f"{program}.vtp")
    pv.PolyData.from_regular_faces(points, triangles).save(surface)
    away, lost = distances(case, surface, case.file(key, "distfield.vti")) if case.distances else ("-", "-")
    cells = {
        "scale": "as above",
        "code": str(code) if mesh.is_closed else "not manifold",
        "away": away,
        "lost": lost,
        "told": "",
        "crossing": f"{len(self_intersections(points, triangles)):,}",
        "tetrahedra": "-",
        "memory": f"{memory / 2**20:,.0f}",
        "seconds": f"{seconds:.1f}" if case.as_given else f"({seconds:.1f})",
    }
    return line(case, vertices, PEERS[program], mesh, before, cells)


def nets(field: pv.ImageData, level: float) -> pv.PolyData:
    """Returns VTK's surface nets of the region below a level, with the default smoothing."""
    import numpy as np
    import pyvista as pv

    labels = pv.ImageData(dimensions=field.dimensions, spacing=field.spacing, origin=field.origin)
    labels.direction_matrix = field.direction_matrix
    labels["inside"] = (np.asarray(field.active_scalars) < level).astype(np.int16)
    return labels.contour_labels(output_mesh_type="triangles", scalars="inside")


AS_THEY_ARE = ("marching-cubes", "surface-nets")
"""Methods for which the grid determines the number of vertices."""
PEERS = {
    "marching-cubes": "marching cubes (VTK)",
    "surface-nets": "surface nets (VTK)",
    "botsch": "gpytoolbox remesh_botsch",
    "cgal": "CGAL isotropic remeshing",
    "mmg": "MMGS",
    "pymeshlab": "PyMeshLab isotropic",
    "instant-meshes": "Instant Meshes",
    "acvd": "pyacvd",
}


def main() -> None:
    """Parses the command line and prints the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, fromfile_prefix_chars="@"
    )
    parser.add_argument("cases", nargs="+", metavar="CASE")
    parser.add_argument("--vertices", type=int, nargs="+", default=[1000, 5000, 20_000, 75_000])
    parser.add_argument("--as-given", action="store_true", help="scale and edge length are in the cases' options")
    parser.add_argument("--bin", type=Path, default=Path("target/release"), help="folder of the stage programs")
    parser.add_argument("--work", type=Path, default=Path("out/scale"), help="folder for the files")
    parser.add_argument("--backend", default="cpu", help="of particles: cpu, gpu or auto")
    parser.add_argument("--no-distances", action="store_true", help="without pyvista and the field at scale 0")
    parser.add_argument(
        "--tetrahedra", type=Path, metavar="TETMESH_CHECK", help="fill the surfaces by this program, too"
    )
    parser.add_argument("--peers", type=Path, metavar="PYTHON", help="rows of other remeshers, by this interpreter")
    parser.add_argument(
        "--programs", nargs="+", default=["botsch", "cgal"], choices=PEERS, help="which (default: %(default)s)"
    )
    parser.add_argument("--limit", type=float, default=330.0, metavar="SECONDS", help="how long a remesher may take")
    arguments = parser.parse_intermixed_args()
    arguments.work.mkdir(parents=True, exist_ok=True)
    print(
        "| object | asked for | program | scale, mm | vertices | exit code | radius ratio, mean / smallest | angles, degrees | distance, mm"
        " | lost, mm | volume, % | components | crossing | tetrahedra | s | MiB |\n" + "|---" * 16 + "|"
    )
    # case files contain comment lines
    for text in (text for text in arguments.cases if not text.startswith("#")):
        name, _, rest = text.partition("=")
        volume, distfield, sizefield = [*os.path.expandvars(rest).split(";"), ""][:3]
        case = Case(
            name.replace(" ", "-"),
            volume,
            distfield.split(),
            sizefield.split(),
            arguments.bin,
            arguments.work,
            arguments.backend,
            not arguments.no_distances,
            arguments.tetrahedra,
            arguments.peers,
            arguments.programs,
            arguments.limit,
            arguments.as_given,
        )
        for vertices in [0] if case.as_given else arguments.vertices:
            try:
                told, before, ours = row(case, vertices)
            except RefusedError as reason:
                print(f"| {case.name} | {vertices:,} | isoparticles | {reason} |" + " |" * 12, flush=True)
                continue
            print(told, flush=True)
            for program in case.programs_beside if case.peers else ():
                print(peer_row(case, vertices, ours, before, program), flush=True)


if __name__ == "__main__":
    main()

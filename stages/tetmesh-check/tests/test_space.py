"""The world frame: RAS and LPS differ by the signs of x and y alone, in every file and report."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import meshio
import numpy as np
import pytest
import pyvista as pv
from conftest import NEEDS_HXT, Run, ball, write_nrrd, write_sizing

from tetmesh_check.errors import StageError
from tetmesh_check.space import output_space, space_of
from tetmesh_check.surface import read_surface

SIGNS = np.array([-1.0, -1.0, 1.0])
CENTRE = np.array([2.0, -3.0, 1.0])


def _surface(path: Path, space: str | None, distort: float = 1.0) -> Path:
    """Write a flattened ball beside the origin, in a frame."""
    surface = ball(radius=6.0)
    points = np.asarray(surface.points) * [1.0, 0.8, distort] + CENTRE
    surface.points = points * SIGNS if space == "ras" else points
    if space:
        surface.add_field_data([json.dumps(space.capitalize())], "space")
        history = {"tool": "distfield", "parameters": {"space": space, "file_space": "ras"}, "inputs": []}
        surface.add_field_data([json.dumps(history)], "history")
    surface.save(path)
    return path


def _sizing(path: Path, space: str = "lps") -> Path:
    """Write a size field with different values on both sides of x = 0, in a frame."""
    write_sizing(path, lambda world: np.where(world[:, 0] < 0, 2.0, 3.0))
    grid = pv.read(path)
    if space == "ras":
        grid.origin, grid.direction_matrix = np.array(grid.origin) * SIGNS, np.diag(SIGNS)
    grid.add_field_data([json.dumps({"space": space.capitalize()})], "geometry")
    history = {"tool": "distfield", "parameters": {"space": space}, "inputs": []}
    grid.add_field_data([json.dumps(history)], "history")
    grid.save(path)
    return path


def _xdmf(path: Path) -> Any:
    with h5py.File(path.with_suffix(".h5")) as file:
        return file["points"][:]


def _feb(path: Path) -> Any:
    rows = re.findall(r'<node id="\d+">(.*?)</node>', path.read_text())
    return np.array([row.split(",") for row in rows], dtype=float)


READERS: dict[str, Callable[[Path], Any]] = {
    "volume.vtu": lambda path: pv.read(path).points,
    "volume.vtk": lambda path: pv.read(path).points,
    "boundary.vtp": lambda path: pv.read(path).points,
    "volume.mesh-complete.mesh.vtu": lambda path: pv.read(path).points,
    "volume.mesh-complete.exterior.vtp": lambda path: pv.read(path).points,
    "volume.msh": lambda path: meshio.read(path).points,
    "volume.msh2": lambda path: meshio.gmsh.read(path).points,
    "volume.med": lambda path: meshio.read(path).points,
    "volume.inp": lambda path: meshio.read(path).points,
    "volume.xdmf": _xdmf,
    "volume.feb": _feb,
    "volume.pts": lambda path: np.loadtxt(path, skiprows=1),
}
ALL = "inp,k,bdf,msh,msh2,med,xdmf,vtp,vtk,feb,carp,simvascular"


@NEEDS_HXT
def test_every_file_differs_by_the_signs_of_x_and_y(tmp_path: Path, run: Run) -> None:
    surface, in_ras = _surface(tmp_path / "s.vtp", "lps"), _surface(tmp_path / "r.vtp", "ras")
    sizing, sizing_in_ras = _sizing(tmp_path / "h.vti"), _sizing(tmp_path / "h_ras.vti", "ras")
    usual = ["--method", "hxt", "--min-dihedral", "40", "--solve", "no"]
    runs = {
        "lps": [surface, "--sizefield", sizing],
        "ras": [surface, "--sizefield", sizing, "--space", "ras"],
        "own": [in_ras, "--sizefield", sizing_in_ras],
        "mixed": [in_ras, "--sizefield", sizing],
        "back": [in_ras, "--sizefield", sizing_in_ras, "--space", "lps"],
        "scanner": [surface, "--sizefield", sizing, "--space", "scanner"],
    }
    reports: dict[str, dict[str, Any]] = {}
    for name, words in runs.items():
        more = ["--export", ALL] if name in ("lps", "ras") else []
        done = run(*words, "-o", f"{name}.volume.vtu", "--report", f"{name}.json", *usual, *more)
        assert done.returncode == 1, done.stderr
        reports[name] = json.loads((tmp_path / f"{name}.json").read_text())

    for ending, read in READERS.items():
        lps, ras = (np.asarray(read(tmp_path / f"{name}.{ending}")) for name in ("lps", "ras"))
        assert len(lps) > 50, ending
        assert np.array_equal(ras, lps * SIGNS), ending
    expected, grid = pv.read(tmp_path / "ras.volume.vtu"), pv.read(tmp_path / "lps.volume.vtu")
    assert np.array_equal(expected.cells, grid.cells)
    for name in ("own", "mixed", "scanner", "back"):
        same = grid if name == "back" else expected
        assert np.array_equal(pv.read(tmp_path / f"{name}.volume.vtu").points, same.points), name
        assert reports[name]["parameters"]["space"] == ("lps" if name == "back" else "ras")

    for name in ("inp", "msh", "msh2", "med", "xdmf", "feb"):
        for space in ("lps", "ras"):
            told = f"isoparticles; world frame {space.upper()}".encode()
            assert told in (tmp_path / f"{space}.volume.{name}").read_bytes()
    for name in ("volume.vtu", "volume.vtk", "boundary.vtp", "volume.mesh-complete.mesh.vtu"):
        assert space_of(pv.read(tmp_path / f"ras.{name}"), tmp_path) == "ras"

    lps, ras = (reports[name]["results"] for name in ("lps", "ras"))
    poor = [one["volume"].pop("poor_tetrahedra") for one in (lps, ras)]
    places = [np.array([row["place_mm"] for row in rows]) for rows in poor]
    assert len(places[0]) > 0
    assert np.array_equal(places[1], places[0] * SIGNS)
    for key in ("surface", "volume", "volumes"):
        assert ras[key] == lps[key]
    parts = [one["boundary"]["parts"][0] for one in (lps, ras)]
    assert np.allclose(parts[1]["centre_mm"], parts[0]["centre_mm"] * SIGNS)
    assert parts[1]["area_mm2"] == pytest.approx(parts[0]["area_mm2"])


@NEEDS_HXT
def test_labels_are_found_in_both_frames(tmp_path: Path, run: Run) -> None:
    """``read_volume`` returns every anatomical volume in LPS."""
    values = np.ones((24, 24, 24), dtype=np.uint8)
    values[:12] = 2
    values[:, :12] += 2
    header = {"space": "RAS", "space_directions": "(-1,0,0) (0,-1,0) (0,0,1)", "space_origin": "(10,15,-11)"}
    write_nrrd(tmp_path / "labels.nrrd", values, **header)
    surface = _surface(tmp_path / "s.vtp", "lps")
    found = {}
    for space in ("lps", "ras"):
        words = ["--labels-volume", "labels.nrrd", "--space", space, "--method", "hxt", "--solve", "no"]
        done = run(surface, "-o", f"{space}.vtu", "--report", f"{space}.json", *words)
        assert done.returncode == 0, done.stderr
        grid = pv.read(tmp_path / f"{space}.vtu")
        found[space] = np.asarray(grid.cell_data["region"])
        # as nibabel and others find a voxel: by the inverse of the affine, which is RAS
        affine = np.array([[-1.0, 0, 0, 10], [0, -1, 0, 15], [0, 0, 1, -11], [0, 0, 0, 1]])
        centres = np.asarray(grid.cell_centers().points) * (SIGNS if space == "lps" else 1.0)
        index = np.round((centres - affine[:3, 3]) @ np.linalg.inv(affine[:3, :3]).T).astype(int)
        assert set(found[space]) == {1, 2, 3, 4}
        assert np.array_equal(found[space], values[tuple(index.T)])
    assert np.array_equal(found["lps"], found["ras"])


@pytest.mark.parametrize("ending", ["ply", "stl", "obj", "vtk"])
def test_a_header_states_the_frame(tmp_path: Path, ending: str) -> None:
    path = _surface(tmp_path / f"s.{ending}", None)
    assert read_surface(path).space is None, "another program wrote it"
    told = b"isoparticles reconstruct 0.1.0; world frame RAS, mm"
    content = path.read_bytes()
    content = {
        "ply": content.replace(b"\nelement", b"\ncomment " + told + b"\nelement", 1),
        "stl": told.ljust(80) + content[80:],
        "obj": b"# " + told + b"\n" + content,
        "vtk": re.sub(rb"\n.*\n", b"\n" + told + b"\n", content, count=1),
    }[ending]
    before = np.asarray(pv.read(path).points, dtype=float)
    path.write_bytes(content)
    surface = read_surface(path)
    assert surface.space == "ras"
    assert np.array_equal(np.sort(surface.points[:, 0]), np.sort(np.unique(-before, axis=0)[:, 0]))


def test_a_surface_without_a_frame_is_in_that_of_the_sizes(tmp_path: Path, run: Run) -> None:
    pv.read(_surface(tmp_path / "s.vtp", "ras")).save(tmp_path / "r.stl")
    made = []
    for surface, more in [("s.vtp", []), ("r.stl", []), ("r.stl", ["--space", "lps"])]:
        words = ["--method", "ftetwild", "--solve", "no", "--force", *more]
        done = run(surface, "--sizefield", _sizing(tmp_path / "h.vti", "ras"), "-o", "v.vtu", *words)
        assert done.returncode == 0, done.stderr
        made.append(pv.read(tmp_path / "v.vtu"))
    centre = [np.asarray(grid.points).mean(axis=0) for grid in made]
    assert np.allclose(centre[0], CENTRE * SIGNS, atol=0.3)
    assert np.allclose(centre[1], CENTRE * SIGNS, atol=0.3)
    assert np.allclose(centre[2], CENTRE, atol=0.3)


def test_ras_needs_a_frame(tmp_path: Path, run: Run) -> None:
    done = run(_surface(tmp_path / "s.vtp", None), "-o", "v.vtu", "--space", "ras")
    assert done.returncode == 2
    assert "left and right" in done.stderr
    assert output_space("scanner", None, None) is None
    assert output_space("scanner", "ras", None) == "lps", "an older version"
    with pytest.raises(StageError):
        output_space("ras", None, "ras")

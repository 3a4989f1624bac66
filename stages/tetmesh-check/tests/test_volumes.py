"""Tests of reading volumes, and of our files in other programs."""

from __future__ import annotations

import json
from pathlib import Path

import meshio
import numpy as np
import pytest
import pyvista as pv
import trimesh
from conftest import ball, quiet_context, write_nrrd
from test_regions import marked_block

from tetmesh_check.datasets import from_polydata, text_of
from tetmesh_check.errors import StageError
from tetmesh_check.export.vtk import write_volume
from tetmesh_check.quality import tetrahedron_quality
from tetmesh_check.surface import history_of
from tetmesh_check.volumes import read_label_volume, read_volume

_COMMON = Path(__file__).parents[3] / "common"
_FIXTURES = _COMMON / "volume" / "tests" / "data"
_GOLDEN = _COMMON / "stage" / "tests" / "data" / "golden"
_TOLD = json.loads((_FIXTURES / "expected.json").read_text())["volumes"]
"""Contents of the fixtures according to the programs that made them."""


@pytest.mark.parametrize("name", [name for name in _TOLD if not name.startswith("nrrd/type")][::3])
def test_fixtures_lie_where_the_programs_that_made_them_say(name: str) -> None:
    volume = read_volume(_FIXTURES / name, spacing=_TOLD[name].get("spacing"))
    assert volume.values.dtype.name == _TOLD[name]["type"]
    assert [str(value) for value in volume.values.ravel(order="F").tolist()] == [
        str(volume.values.dtype.type(text).item()) for text in _TOLD[name]["values"]
    ]
    last = np.array(volume.values.shape) - 1
    index = np.vstack([np.zeros(3), np.diag(last)])
    np.testing.assert_allclose(index @ volume.step.T + volume.origin, _TOLD[name]["positions"], atol=1e-5)


def test_names_layers_and_errors(tmp_path: Path) -> None:
    header = {
        "space": "left-posterior-superior", "space_directions": "none (1,0,0) (0,1,0) (0,0,1)", "kinds": "list domain domain domain",
    }  # fmt: skip
    path = write_nrrd(tmp_path / "two.seg.nrrd", np.ones((2, 2, 2, 2), dtype=np.uint8), **header)
    text = path.read_bytes().replace(
        b"kinds", b"Segment0_Name:=left lung\nSegment1_Name:=vessel\nSegment1_Layer:=1\nkinds"
    )
    path.write_bytes(text)
    volume = read_volume(path)
    assert (volume.names, volume.layers, volume.anatomical) == ({1: "left lung"}, 2, True)
    with pytest.raises(StageError, match="2 layers of segments"):
        read_label_volume(path)
    (tmp_path / "empty").mkdir()
    with pytest.raises(StageError, match="is a folder without DICOM files, TIFF files or masks") as refused:
        read_volume(tmp_path / "empty")
    assert "contains the slices" in refused.value.next
    ball().save(tmp_path / "ball.vtp")
    with pytest.raises(StageError, match="is a surface"):
        read_volume(tmp_path / "ball.vtp")


def test_a_folder_has_a_hash(tmp_path: Path) -> None:
    context = quiet_context()
    for name in "ab":
        (tmp_path / name).write_text(name)
        context.add_input(tmp_path, None)
    first, second = context.history()["inputs"]
    assert first["path"] == tmp_path.name
    assert len(first["blake3"]) == 64
    assert first["blake3"] != second["blake3"]


def test_the_volume_mesh_opens_in_meshio_and_pyvista(tmp_path: Path) -> None:
    mesh = marked_block()
    history = {"tool": "tetmesh-check", "note": "größer"}
    path = tmp_path / "b.volume.vtu"
    write_volume(path, mesh, tetrahedron_quality(mesh.points, mesh.tetrahedra)._asdict(), history)
    grid = pv.read(path)
    assert history_of(grid) == history
    assert text_of(grid, "isoparticles_kind") == "volume"
    found = meshio.read(path)
    np.testing.assert_array_equal(found.points, mesh.points)
    np.testing.assert_array_equal(found.cells_dict["tetra"], mesh.tetrahedra)
    np.testing.assert_array_equal(found.cell_data["region"][0], mesh.regions)
    assert bytes(found.field_data["isoparticles_kind"]).decode() == "volume"


def test_files_of_the_first_version_had_strings(tmp_path: Path) -> None:
    surface = ball()
    surface.add_field_data(['{"tool": "reconstruct"}'], "history")
    surface.save(tmp_path / "s.vtp")
    assert history_of(pv.read(tmp_path / "s.vtp")) == {"tool": "reconstruct"}
    assert text_of(surface, "meta") is None


@pytest.mark.parametrize("ending", ["vtp", "ply", "stl", "obj"])
def test_surfaces_of_reconstruct_open_elsewhere(ending: str) -> None:
    path = _GOLDEN / f"surface_{'v2' if ending == 'vtp' else 'v1'}.{ending}"
    surface = pv.read(path)
    points, triangles = from_polydata(surface)
    assert len(triangles) == 4
    if ending == "vtp":
        assert history_of(surface)["tool"] == "sizefield"
        return
    loaded = trimesh.load_mesh(path)
    meshes = [(loaded.vertices, loaded.faces)]
    if ending != "ply":  # meshio 5.3 stops at any PLY with values on its triangles
        again = meshio.read(path)
        meshes.append((again.points, again.cells_dict["triangle"]))
    for vertices, faces in meshes:
        # STL repeats the vertices of every triangle, so corner positions are compared instead of
        # indices
        found = np.sort(np.asarray(vertices)[faces].reshape(4, 9).round(4), axis=0)
        np.testing.assert_allclose(found, np.sort(points[triangles].reshape(4, 9).round(4), axis=0), atol=2e-4)


def test_fields_open_in_pyvista() -> None:
    field = pv.read(_GOLDEN / "field_v2.sizefield.vti")
    assert field.dimensions == (3, 4, 2)
    assert text_of(field, "isoparticles_kind") == "sizefield"
    assert json.loads(text_of(field, "geometry") or "")["space"] == "Lps"
    assert history_of(field)["parameters"]["note"] == "größer"

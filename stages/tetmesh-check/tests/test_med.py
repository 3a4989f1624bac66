"""Tests of MED files, read by meshio and by Gmsh (with Salome's library), if installed."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import meshio
import numpy as np
import pytest
from conftest import NEEDS_HXT, ball
from test_quadratic import of_ball, small_mesh, write_distance
from test_regions import marked_block

from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh
from tetmesh_check.fields import read_distance_field
from tetmesh_check.quality import signed_tetrahedron_volumes
from tetmesh_check.regions import CAP


def curved(folder: Path) -> MarkedMesh:
    return small_mesh(read_distance_field(write_distance(folder / "f.vti", of_ball), ball().points, [])[0])


def test_meshio_finds_the_groups(tmp_path: Path) -> None:
    mesh = marked_block()
    export(mesh, tmp_path / "b.volume.vtu", "b", "med", unit="m")
    again = meshio.read(tmp_path / "b.volume.med")
    np.testing.assert_allclose(again.points, 0.001 * mesh.points)
    np.testing.assert_array_equal(np.sort(again.cells_dict["tetra"], axis=1), np.sort(mesh.tetrahedra, axis=1))
    number = {names[0]: tag for tag, names in again.cell_tags.items()}
    assert set(number) == {"region_2", "region_5", "surface", "cap"}
    tags = again.cell_data_dict["cell_tags"]
    np.testing.assert_array_equal(tags["tetra"] == number["region_5"], mesh.regions == 5)
    np.testing.assert_array_equal(tags["triangle"] == number["cap"], mesh.marks == CAP)


GMSH = """
import gmsh, json
gmsh.initialize(interruptible=False)
gmsh.option.setNumber("General.Terminal", 0)
gmsh.open("b.volume.med")
found = {}
for dimension, tag in gmsh.model.getPhysicalGroups():
    cells = []
    for entity in gmsh.model.getEntitiesForPhysicalGroup(dimension, tag):
        kinds, _, nodes = gmsh.model.mesh.getElements(dimension, entity)
        cells += [[int(kind), len(of)] + of.tolist() for kind, of in zip(kinds, nodes)]
    found[gmsh.model.getPhysicalName(dimension, tag)] = cells
numbers, points, _ = gmsh.model.mesh.getNodes()
qualities = []
for dimension, entity in gmsh.model.getEntities(3):
    for of in gmsh.model.mesh.getElements(3, entity)[1]:
        qualities += gmsh.model.mesh.getElementQualities(of, "minDetJac").tolist()
print(json.dumps([numbers.tolist(), points.tolist(), found, qualities]))
"""


@NEEDS_HXT
@pytest.mark.parametrize("order", [1, 2])
def test_gmsh_reads_groups_and_the_sense_of_every_element(tmp_path: Path, order: int) -> None:
    mesh = marked_block() if order == 1 else curved(tmp_path)
    export(mesh, tmp_path / "b.volume.vtu", "b", "med")
    done = subprocess.run([sys.executable, "-c", GMSH], cwd=tmp_path, capture_output=True, text=True, check=True)
    numbers, points, groups, jacobians = json.loads(done.stdout)
    at = np.empty((max(numbers) + 1, 3))
    at[numbers] = np.reshape(points, (-1, 3))
    names = [part.name for part in mesh.part_sets]
    assert set(groups) == {"region_2", "region_5", *names}
    # A wrong orientation of an element would give negative Jacobians. Mid-edge nodes on the wrong
    # edges would fold the curved elements, with the same effect.
    assert len(jacobians) == len(mesh.tetrahedra)
    assert min(jacobians) > 0.0
    corners, all_nodes = (4, 4) if order == 1 else (4, 10)
    for label in (2, 5):
        cells = np.concatenate([np.reshape(of[2:], (-1, all_nodes)) for of in groups[f"region_{label}"]])[:, :corners]
        own = mesh.tetrahedra[mesh.regions == label]
        volume = signed_tetrahedron_volumes(mesh.points, own).sum()
        assert signed_tetrahedron_volumes(at, cells).sum() == pytest.approx(volume)
    # the boundary is oriented outward: the flux of x / 3 through it is the volume
    flux = 0.0
    for name in names:
        for of in groups[name]:
            a, b, c = (at[np.reshape(of[2:], (-1, 3 if order == 1 else 6))[:, k]] for k in range(3))
            flux += float(np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0)
    assert flux == pytest.approx(signed_tetrahedron_volumes(mesh.points, mesh.tetrahedra).sum())

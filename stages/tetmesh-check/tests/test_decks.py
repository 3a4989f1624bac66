"""Tests of LS-DYNA and Nastran files, with meshio and with the documented column positions."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import meshio
import numpy as np
import pytest
from test_med import curved
from test_regions import marked_block, materials_of_block

from tetmesh_check.export.formats import export
from tetmesh_check.export.mesh import MarkedMesh, numbered_sets


def made(folder: Path, order: int, kind: str) -> tuple[MarkedMesh, Path]:
    """Write a small mesh of this order; return it and its file."""
    mesh = marked_block() if order == 1 else curved(folder)
    export(mesh, folder / "b.volume.vtu", "b", kind)
    return mesh, folder / f"b.volume.{kind}"


def columns(line: str, *widths: int) -> list[str]:
    """Split a line into fields of these widths."""
    ends = np.cumsum([0, *widths])
    assert len(line) == ends[-1]
    return [line[a:b] for a, b in pairwise(ends)]


def keywords(path: Path) -> list[tuple[str, list[str]]]:
    """Return each keyword of an LS-DYNA file and its cards, without comments."""
    lines = [line for line in path.read_text().splitlines() if not line.startswith("$")]
    starts = [i for i, line in enumerate(lines) if line.startswith("*")]
    return [(lines[a][1:], lines[a + 1 : b]) for a, b in zip(starts, [*starts[1:], len(lines)], strict=True)]


def whole(lines: list[str], width: int) -> list[int]:
    """Return the numbers of cards whose fields all have the same width."""
    return [int(field) for line in lines for field in columns(line, *[width] * (len(line) // width))]


@pytest.mark.parametrize("order", [1, 2])
def test_ls_dyna_nodes_parts_and_elements(tmp_path: Path, order: int) -> None:
    mesh, path = made(tmp_path, order, "k")
    found = keywords(path)
    assert [found[0], found[-1]] == [("KEYWORD", []), ("END", [])]
    nodes = [columns(line, 8, 16, 16, 16) for name, cards in found if name == "NODE" for line in cards]
    np.testing.assert_array_equal([int(node[0]) for node in nodes], np.arange(1, len(mesh.points) + 1))
    np.testing.assert_allclose([[float(x) for x in node[1:]] for node in nodes], mesh.points, rtol=1e-9)
    parts = {whole(cards[1:], 10)[0]: cards[0] for name, cards in found if name == "PART"}
    assert parts == {2: "region_2", 5: "region_5"}
    # formulation 10 is the one-point tetrahedron, 16 the ten-node one
    assert [whole(cards, 10) for name, cards in found if name == "SECTION_SOLID"] == [[1, 10 if order == 1 else 16]]
    numbers = np.array([whole(cards, 8) for name, cards in found if name == "ELEMENT_SOLID"]).reshape(len(parts), -1)
    elements = numbers.reshape(-1, 10 if order == 1 else 12)
    order_of = np.argsort(mesh.regions, kind="stable")
    np.testing.assert_array_equal(elements[:, 0] - 1, order_of)
    np.testing.assert_array_equal(elements[:, 1], mesh.regions[order_of])
    expected = mesh.elements[order_of] + 1
    if order == 1:
        expected = np.column_stack([expected, *[expected[:, 3]] * 4])
    np.testing.assert_array_equal(elements[:, 2:], expected)


@pytest.mark.parametrize("order", [1, 2])
def test_ls_dyna_sets_of_the_boundary(tmp_path: Path, order: int) -> None:
    mesh, path = made(tmp_path, order, "k")
    found = keywords(path)
    for part in numbered_sets(mesh)[1]:
        (segments,) = (cards for name, cards in found if name == "SET_SEGMENT_TITLE" and cards[0] == part.name)
        (nodes,) = (cards for name, cards in found if name == "SET_NODE_LIST_TITLE" and cards[0] == part.name)
        assert [int(nodes[1]), int(segments[1])] == [part.number] * 2
        corners = np.reshape(whole(segments[2:], 10), (-1, 4)) - 1
        np.testing.assert_array_equal(corners[:, :3], mesh.boundary[part.members])
        np.testing.assert_array_equal(corners[:, 3], corners[:, 2])
        np.testing.assert_array_equal(np.array(whole(nodes[2:], 10)) - 1, np.unique(mesh.faces[part.members]))
        assert max(map(len, nodes)) <= 80


@pytest.mark.parametrize("order", [1, 2])
def test_meshio_reads_nastran_files(tmp_path: Path, order: int) -> None:
    mesh, path = made(tmp_path, order, "bdf")
    again = meshio.read(path)
    np.testing.assert_allclose(again.points, mesh.points, rtol=1e-9)
    tetrahedron, triangle = ("tetra", "triangle") if order == 1 else ("tetra10", "triangle6")
    by_region, by_mark = np.argsort(mesh.regions, kind="stable"), np.argsort(mesh.marks, kind="stable")
    np.testing.assert_array_equal(again.cells_dict[tetrahedron], mesh.elements[by_region])
    np.testing.assert_array_equal(again.cells_dict[triangle], mesh.faces[by_mark])
    properties = again.cell_data_dict["nastran:ref"]
    np.testing.assert_array_equal(properties[tetrahedron], mesh.regions[by_region])
    np.testing.assert_array_equal(properties[triangle], 10 + mesh.marks[by_mark])
    numbers = np.concatenate(again.cells_id)
    assert len(set(numbers.tolist())) == len(numbers)


def test_nastran_properties_have_names_and_sets(tmp_path: Path) -> None:
    mesh, path = made(tmp_path, 1, "bdf")
    text = path.read_text()
    # OpenFOAM reads the number in columns 17 to 32, and the name between the quotes
    named = {int(line[16:32]): line[33:-1] for line in text.splitlines() if line.startswith("$HMNAME PROP")}
    assert named == {2: "region_2", 5: "region_5", 11: "surface", 12: "cap"}
    kinds = {int(line[8:16]): line[:6] for line in text.splitlines() if line.startswith(("PSOLID", "PSHELL"))}
    assert kinds == {2: "PSOLID", 5: "PSOLID", 11: "PSHELL", 12: "PSHELL"}
    for part in numbered_sets(mesh)[1]:
        (card,) = re.findall(rf"SET1    ({part.number:8d}.*\n(?:\+.*\n)*)", text)
        numbers = whole(card.replace("+       ", "").splitlines(), 8)
        np.testing.assert_array_equal(np.array(numbers[1:]) - 1, np.unique(mesh.boundary[part.members]))
    assert all(len(line) <= 80 for line in text.splitlines())


def test_decks_of_materials_name_regions_and_interfaces(tmp_path: Path) -> None:
    mesh = materials_of_block(("left, lung", "Heart"), (7, 9))
    for kind in ("k", "bdf"):
        export(mesh, tmp_path / "b.volume.vtu", "b", kind)
        text = (tmp_path / f"b.volume.{kind}").read_text()
        assert "$ region 2: Heart, labels 9\n" in text
    titles = [cards[0] for name, cards in keywords(tmp_path / "b.volume.k") if name in ("PART", "SET_SEGMENT_TITLE")]
    assert titles == ["left_lung", "Heart", "inner", "outer"]
    assert '$HMNAME PROP                  11"inner"\n' in (tmp_path / "b.volume.bdf").read_text()


def test_numbers_too_wide_for_a_field_are_replaced(tmp_path: Path) -> None:
    block = marked_block()
    large = np.where(block.regions == 5, 614_454_277, block.regions)
    mesh = replace(block, regions=large, table=[block.table[0], {**block.table[1], "region": 614_454_277}])
    export(mesh, tmp_path / "b.volume.vtu", "b", "bdf")
    assert meshio.read(tmp_path / "b.volume.bdf").cell_data_dict["nastran:ref"]["tetra"].max() == 3
    export(mesh, tmp_path / "b.volume.vtu", "b", "k")
    assert [whole(cards[1:], 10)[0] for name, cards in keywords(tmp_path / "b.volume.k") if name == "PART"] == [2, 3]

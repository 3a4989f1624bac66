"""Reads FEBio 4 files by the rules of ``FEBioMeshSection4.cpp`` and of the manual, strictly."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import numpy as np

NODES = {"tet4": 4, "tet10": 10, "penta6": 6, "tri3": 3, "tri6": 6, "quad4": 4}


class Model(NamedTuple):
    """A model: nodes, domains and surfaces by name, and contact pairs (primary, secondary)."""

    points: np.ndarray
    domains: dict[str, np.ndarray]
    surfaces: dict[str, np.ndarray]
    contacts: list[tuple[str, str]]


def numbers(element: ElementTree.Element, count: int) -> list[int]:
    found = [int(word) for word in (element.text or "").split(",")]
    assert len(found) == count, f"{element.tag} has {len(found)} numbers"
    return found


def read_febio(path: Path) -> Model:
    """Read a file. Assert what FEBio refuses: unknown tags, repeated names, missing surfaces."""
    root = ElementTree.parse(path).getroot()
    assert (root.tag, root.get("version")) == ("febio_spec", "4.0")
    mesh = root.find("Mesh")
    assert mesh is not None
    points: list[list[float]] = []
    domains: dict[str, np.ndarray] = {}
    surfaces: dict[str, np.ndarray] = {}
    pairs: dict[str, tuple[str, str]] = {}
    ids: list[int] = []
    for section in mesh:
        name = section.attrib["name"]
        if section.tag == "Nodes":
            assert [int(node.attrib["id"]) for node in section] == list(range(1, len(section) + 1))
            points += [[float(x) for x in (node.text or "").split(",")] for node in section]
        elif section.tag == "Elements":
            assert name not in domains
            ids += [int(element.attrib["id"]) for element in section]
            domains[name] = np.array([numbers(element, NODES[section.attrib["type"]]) for element in section]) - 1
        elif section.tag == "Surface":
            assert name not in surfaces
            surfaces[name] = np.array([numbers(face, NODES[face.tag]) for face in section]) - 1
        else:
            assert section.tag == "SurfacePair"
            sides = {side.tag: side.text or "" for side in section}
            assert set(sides) == {"primary", "secondary"}
            assert set(sides.values()) <= set(surfaces), "FEBio needs the surfaces before their pair"
            pairs[name] = sides["primary"], sides["secondary"]
    assert len(set(ids)) == len(ids)
    materials = {material.get("name") for material in root.iterfind("Material/material")}
    parts = {domain.attrib["name"]: domain.get("mat") for domain in root.iterfind("MeshDomains/SolidDomain")}
    assert set(parts) == set(domains)
    assert set(parts.values()) == materials
    contacts = list(root.iterfind("Contact/contact"))
    assert {contact.get("type") for contact in contacts} <= {"sliding-elastic"}
    return Model(np.array(points), domains, surfaces, [pairs[contact.attrib["surface_pair"]] for contact in contacts])


def owner_of(model: Model, surface: str) -> str:
    """Return the only domain with the faces of a surface; assert that they point outward."""
    faces = model.surfaces[surface]
    (owner,) = (name for name, elements in model.domains.items() if np.isin(faces, elements).all())
    elements = model.domains[owner]
    for face in faces:
        (own,) = elements[np.isin(elements, face).sum(axis=1) == len(face)]
        a, b, c = model.points[face[:3]]
        assert np.cross(b - a, c - a) @ (model.points[own[:4]].mean(axis=0) - a) < 0.0
    return owner

"""Tests of the advice for failed checks: each message has advice with the right variable."""

from __future__ import annotations

import pytest

from tetmesh_check.report.page.templates import advice_for

UNKNOWN = advice_for("an unknown message")
SEVERAL = {"MATERIALS": "all", "SIZE": "2"}


@pytest.mark.parametrize(
    "message",
    [
        "3 open edges (edges of only one triangle)",
        "2 non-manifold edges (edges of more than two triangles)",
        "2 non-manifold vertices (vertices with more than one fan of triangles)",
        "5 pairs of intersecting triangles",
        "4 triangles of zero area",
        "4 triangles join different components of F = 0",
        "3 triangles with a radius ratio below 0.3 (minimum 0.1210)",
        "7 vertices with a deviation of more than 0.0001 voxel from the interface (maximum 0.2)",
        "9 voxel centres on the wrong side of the mesh",
        "2 components of F = 0 are missing, the first at (1, 2, 3) mm",
        "2 missing components of materials",
        "2 components do not exist in F = 0",
        "at (1, 2, 3) mm: 2 components with Euler characteristic 0 where F = 0 has 1 with 2",
        "3 edges of more than two triangles away from junction curves",
        "3 segments of junction curves that are not edges between their materials",
        "the mesh has no triangles",
        "a coordinate is not finite, or a triangle refers to a vertex that does not exist",
        "the normals point inward: the volume is -3.000000",
        "the volume changed by -34 %: much of it is one voxel thick or less, or specks (--keep drops them)",
        "12 materials whose volume the scale changed by more than 10 %: 'label_1' -24 %, 'label_12' -28 %",
        "components and cavities: 1 and 2 in the input, 2 and 2 in F",
        "5 voxel centres changed sides",
        "indicators have the wrong sign at voxel centres: 'lung'",
    ],
)
def test_messages_of_other_stages_have_advice(message: str) -> None:
    for parameters in ({}, SEVERAL):
        advice = advice_for(message, parameters)
        assert advice not in ("", UNKNOWN)
        assert "{" not in advice


def test_advice_names_the_variable_that_is_set() -> None:
    message = "5 pairs of intersecting triangles"
    assert advice_for(message).endswith("a smaller MIN_SIZE, or RECONSTRUCT_OPTIONS='--method tight-cocone'")
    assert advice_for(message, {"VERTICES": "900"}).count("more VERTICES") == 1
    assert advice_for(message, SEVERAL).endswith(
        "use a smaller SIZE, or smaller edges on one material (SIZEFIELD_OPTIONS='--size NAME=MM')"
    )


def test_advice_has_no_size_beside_a_number_of_vertices() -> None:
    for message in (
        "5 pairs of intersecting triangles",
        "surface against the voxels: the volume changes by 3 %",
        "2 materials have more or fewer separate parts",
    ):
        assert "--size NAME=MM" in advice_for(message, SEVERAL)
        assert "--size" not in advice_for(message, {"MATERIALS": "all", "VERTICES": "900"})


def test_open_edges_of_an_open_border_are_capped() -> None:
    message = "3 open edges (edges of only one triangle)"
    assert "BORDER=cap" in advice_for(message, {"BORDER": "open"})
    assert "BORDER" not in advice_for(message, {"BORDER": "cap"})


def test_a_message_with_advice_gets_no_other() -> None:
    assert (
        advice_for("2 poor triangles forced by the junction curves: --accept-forced (ACCEPT_FORCED=yes) accepts them")
        == ""
    )

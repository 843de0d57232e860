"""Meshes as inputs of FEBio: the XML read back by another parser holds the same mesh."""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tpmscad.meshing.febio_files import FEBIO_KINDS, write_feb
from tpmscad.meshing.mesh_arrays import MeshArrays

TETRA = np.array([[0, 1, 2, 3]])
CORNERS = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 2]])


def numbers(text: str | None) -> list[int]:
    return [int(word) for word in str(text).split(",")]


@pytest.mark.parametrize("order", [1, 2])
def test_the_file_holds_the_mesh(order: int, tmp_path: Path) -> None:
    points, cells, facets = CORNERS, TETRA, TETRA[:, [0, 2, 1]]
    kinds = ("tetra", "triangle")
    if order == 2:
        edges = [(0, 1), (1, 2), (2, 0), (0, 3), (1, 3), (2, 3)]
        points = np.concatenate([points, [CORNERS[list(edge)].mean(axis=0) for edge in edges]])
        cells, facets, kinds = np.arange(10)[None], np.array([[0, 2, 1, 6, 5, 4]]), ("tetra10", "triangle6")
    groups = {"cap Z-": np.array([0])}
    mesh = MeshArrays(
        points, {kinds[0]: cells}, {kinds[1]: facets}, {"a & b": np.array([0])}, groups, {}, name="<part>"
    )
    write_feb(mesh, tmp_path / "part.feb")
    root = ElementTree.parse(tmp_path / "part.feb").getroot()
    read = np.array([[float(x) for x in str(node.text).split(",")] for node in root.iterfind("Mesh/Nodes/node")])
    np.testing.assert_array_equal(read, points)
    (elements,) = root.iterfind("Mesh/Elements")
    assert elements.get("type") == FEBIO_KINDS[kinds[0]]
    assert [numbers(each.text) for each in elements] == (cells + 1).tolist()
    (surface,) = root.iterfind("Mesh/Surface")
    assert (surface.get("name"), surface[0].tag) == ("cap Z-", FEBIO_KINDS[kinds[1]])
    assert numbers(surface[0].text) == (facets[0] + 1).tolist()
    sets = {each.get("name"): numbers(each.text) for each in root.iterfind("Mesh/NodeSet")}
    assert sets["cap Z-"] == sorted((facets[0] + 1).tolist())
    domains = [each.get("name") for each in root.iterfind("MeshDomains/SolidDomain")]
    assert domains == [elements.get("name")]
    assert [each.get("name") for each in root.iterfind("Mesh/ElementSet")] == ["a & b"]

"""Laws of meshes of level sets that pass exactly through nodes of the octree."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.levelset.level_set_fit import mesh_level_set
from tpmscad.levelset.quadmesh import octree

LO, HI = np.array([0.0, 0.0, 0.0]), np.array([5.0, 6.0, 7.0])


@pytest.mark.parametrize("slope", [(1, 1, 1), (1, -1, 1), (2, 1, 1), (1, 1, 0)], ids=str)
def test_no_side_is_without_length_and_no_polygon_folded(slope: tuple[int, int, int]) -> None:
    x, y, z = (fields.coordinate(a) for a in "xyz")
    a, b, c = slope
    field = extend_linearly(a * x + b * y + c * z - float(0.5 * np.dot(slope, HI + 1) // 1), LO, HI)
    tree = octree.uniform_octree(LO, HI, np.array((5, 6, 7)))
    nodes = np.stack(np.meshgrid(*[np.arange(n + 1.0) for n in (5, 6, 7)], indexing="ij"), axis=-1)
    assert (field(nodes) == 0).sum() > 10
    mesh, bad = mesh_level_set(tree, field)
    length = np.linalg.norm(mesh.vertices[mesh.side_ends[:, 0]] - mesh.vertices[mesh.side_ends[:, 1]], axis=1)
    assert length.min() > 0.01
    assert not len(bad)

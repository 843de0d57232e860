"""Laws of meshes of symmetric level sets: they do not depend on the last digits of the field."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.fields.field import Field
from tpmscad.levelset.level_set_fit import mesh_level_set
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.refinement import find_coarse_leaves
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import simplify_mesh

LO = np.zeros(3)

ON_NODES = ("schwarz_p", 0.0, 1.0, 6)
"""A level set that passes through nodes of the octree."""

UNSTABLE = ("schwarz_p", 0.3, 1.2, 4)
"""A mesh whose symmetric shape is an unstable equilibrium of the smoothing."""

SYMMETRIC = [("gyroid", 0.2, 1.0, 5), ("iwp", 0.0, 1.0, 5), ("schwarz_p", -0.34, 1.0, 5)]
"""Level sets with many collapses of equal score. Name, level, edge of the box in periods, leaves along it."""


def field_with_noise(name: str, level: float, run: int) -> Field:
    """The field, in runs above 0 changed by up to two units in the last place of 1."""
    noise = fields.expression(f"4e-16*sin({run}e3*x + 3e3*y + 2e3*z)")
    field = fields.tpms(name, 1.0) + level
    return field + noise if run else field * 1.0


def tree_and_mesh(case: tuple[str, float, float, int], run: int) -> tuple[octree.Octree, Field, QuadMesh, np.ndarray]:
    name, level, edge, leaves = case
    field = field_with_noise(name, level, run)
    tree = octree.uniform_octree(LO, np.full(3, edge), np.array((leaves,) * 3))
    return tree, field, *mesh_level_set(tree, field)


def test_the_noise_changes_values() -> None:
    points = np.random.default_rng(0).random((1000, 3))
    plain, noisy = field_with_noise("gyroid", 0.2, 0)(points), field_with_noise("gyroid", 0.2, 1)(points)
    assert 0.1 < (plain != noisy).mean() < 0.9
    assert np.abs(plain - noisy).max() < 1e-14


@pytest.mark.parametrize("case", [ON_NODES, UNSTABLE, *SYMMETRIC], ids=str)
def test_noise_changes_no_polygon_of_a_mesh_and_moves_no_vertex(case: tuple[str, float, float, int]) -> None:
    (_, _, plain, bad), *others = (tree_and_mesh(case, run) for run in range(3))
    for _, _, noisy, also_bad in others:
        assert np.array_equal(noisy.corners, plain.corners)
        assert np.abs(noisy.vertices - plain.vertices).max() < 1e-9
        assert np.array_equal(also_bad, bad)


@pytest.mark.parametrize("case", SYMMETRIC, ids=str)
def test_noise_changes_no_collapse(case: tuple[str, float, float, int]) -> None:
    plain, *others = (
        simplify_mesh(mesh, field, tree.lo, tree.hi).mesh()[0]
        for tree, field, mesh, _ in (tree_and_mesh(case, run) for run in range(3))
    )
    assert all(np.array_equal(noisy.corners, plain.corners) for noisy in others)


def test_noise_hides_no_crossing() -> None:
    name, level, edge, leaves = ON_NODES
    tree = octree.uniform_octree(LO, np.full(3, edge), np.array((leaves,) * 3))
    found = [find_coarse_leaves(tree, field_with_noise(name, level, run), None) for run in range(3)]
    assert all(np.array_equal(flags, found[0]) for flags in found)


def test_values_that_grow_without_limit_elsewhere_leave_the_mesh_as_it_is() -> None:
    tree = octree.uniform_octree(LO, np.array([40.0, 4.0, 4.0]), np.array((20, 2, 2)))
    mesh, bad = mesh_level_set(tree, fields.expression("exp(x - 2.5) - 1"))
    assert np.abs(mesh.vertices[:, 0] - 2.5).max() < 1e-9
    assert np.isin(mesh.leaf, np.flatnonzero(tree.origin[:, 0] == 1)).all()
    assert not len(bad)

"""A ball cut by the box, fitted on an octree with uniform leaves or with some of them split."""

from __future__ import annotations

from functools import cache

import numpy as np

from tpmscad import fields
from tpmscad.levelset.boundary_level_sets import sample_level_set
from tpmscad.levelset.level_set_fit import FitRequest, LevelSetFit, fit_level_set, mesh_level_set
from tpmscad.levelset.quadmesh import octree

LO, HI, TOL = np.array([0.0, 0.0, 0.0]), np.array([10.0, 11.0, 9.0]), 0.01
CENTRE, RADIUS = (2.1, 5.3, 4.2), 3.6
BALL = fields.sphere(CENTRE, RADIUS)


@cache
def ball_fit(
    counts: tuple[int, int, int] = (6, 7, 5), share: float = 0.0, radius: float = RADIUS, spacing: float = 0.7
) -> LevelSetFit:
    """A fraction `share` of the leaves is split."""
    field, tree = fields.sphere(CENTRE, radius), octree.uniform_octree(LO, HI, np.array(counts))
    tree = octree.split_leaves(tree, np.random.default_rng(3).random(len(tree.size)) < share)
    request = FitRequest(field, TOL, sample_level_set(field, LO, HI, spacing))
    return fit_level_set(request, tree, mesh_level_set(tree, field)[0])

"""A ball that the box cuts, laid out and fitted on uniform leaves or on some that are split."""

from __future__ import annotations

from functools import cache

import numpy as np

from tpmscad import fields
from tpmscad.patches.levelset.layer import Layer, fitted, laid
from tpmscad.patches.levelset.layout import octree
from tpmscad.patches.levelset.samples import samples_of

LO, HI, TOL = np.array([0.0, 0.0, 0.0]), np.array([10.0, 11.0, 9.0]), 0.01
CENTRE, RADIUS = (2.1, 5.3, 4.2), 3.6
BALL = fields.sphere(CENTRE, RADIUS)


@cache
def ball_layer(
    counts: tuple[int, int, int] = (6, 7, 5), share: float = 0.0, radius: float = RADIUS, spacing: float = 0.7
) -> tuple[Layer, np.ndarray]:
    """The layer and the samples it was held against; `share` of its leaves are split."""
    field, tree = fields.sphere(CENTRE, radius), octree.uniform(LO, HI, np.array(counts))
    tree = octree.split(tree, np.random.default_rng(3).random(len(tree.size)) < share)
    samples = samples_of(field, LO, HI, spacing)
    return fitted(field, tree, laid(tree, field)[0], TOL, samples), samples

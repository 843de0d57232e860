"""Local thickness of a solid, or of the void around it, by the shrinking-ball method on oriented samples of its surface.

The largest empty ball tangent to the surface at a sample is found by shrinking: a ball that contains another sample shrinks until
it touches that sample (Ma, Bae and Choi, "3D medial axis point approximation using nearest neighbors and the normal field", The
Visual Computer, 2012).
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray

MAX_SHRINKS = 60
"""Shrinking steps; about ten suffice, and a ball that still shrinks is as good as its last contact."""


def shrink_tangent_balls(
    points: Array, normals: Array, max_radius: float, sample_indices: IntArray, tree: cKDTree
) -> tuple[Array, IntArray]:
    """Radius of the largest empty inner ball at each of the chosen samples, and the other sample it touches: (n,), (n,).

    The contact is -1 if the ball of `max_radius` is empty. Normals point outwards; `tree` holds all points.
    """
    radius = np.full(len(sample_indices), max_radius)
    contact = np.full(len(sample_indices), -1)
    active = np.arange(len(sample_indices))
    for _ in range(MAX_SHRINKS):
        p, n = points[sample_indices[active]], normals[sample_indices[active]]
        _, nearest = tree.query(p - radius[active, None] * n)
        chord = p - points[nearest]
        height = (chord * n).sum(axis=1)
        square = (chord * chord).sum(axis=1)
        with np.errstate(divide="ignore", invalid="ignore"):
            smaller = np.where(height > 1e-9 * np.sqrt(square), square / (2.0 * height), np.inf)
        shrinks = (nearest != sample_indices[active]) & (smaller < (1.0 - 1e-9) * radius[active])
        active, nearest, smaller = active[shrinks], nearest[shrinks], smaller[shrinks]
        if not len(active):
            break
        radius[active], contact[active] = smaller, nearest
    return radius, contact

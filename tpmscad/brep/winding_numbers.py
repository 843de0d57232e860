"""Winding numbers of closed triangle meshes about points: 1 inside, 0 outside."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray

PAIRS_PER_BATCH = 2_000_000
"""Pairs of a point and a triangle that are evaluated at once: some 200 MB."""


def winding_numbers(vertices: Array, triangles: IntArray, points: Array) -> Array:
    """Winding numbers (n,) of a closed mesh of vertices (k, 3) and outward triangles (m, 3) about points (n, 3).

    They are the sums of the solid angles of the triangles over 4 pi, by the formula of A. van Oosterom and J. Strackee (IEEE
    Transactions on Biomedical Engineering 30, 1983), and integers but for round-off.
    """
    step = max(1, PAIRS_PER_BATCH // max(1, len(triangles)))
    found = [_sum_angles(vertices[triangles], points[i : i + step]) for i in range(0, len(points), step)]
    return np.concatenate([np.zeros(0), *found]) / (2.0 * np.pi)


def _sum_angles(corners: Array, points: Array) -> Array:
    """Halves of the solid angles of triangles (m, 3, 3), summed at each of points (n, 3): (n,)."""
    a, b, c = np.moveaxis(corners - points[:, None, None], 2, 0)
    la, lb, lc = (np.linalg.norm(x, axis=2) for x in (a, b, c))
    volume = np.einsum("nmi,nmi->nm", a, np.cross(b, c))
    ab, bc, ca = (np.einsum("nmi,nmi->nm", x, y) for x, y in ((a, b), (b, c), (c, a)))
    return np.asarray(np.arctan2(volume, la * lb * lc + ab * lc + bc * la + ca * lb).sum(axis=1))

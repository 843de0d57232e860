"""Winding numbers of closed triangle meshes about points: 1 inside, 0 outside."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.loops import pair_with_intervals

TURN = np.linalg.qr(np.array([[0.83, 0.31, -0.47], [-0.22, 0.91, 0.36], [0.51, -0.27, 0.78]]))[0]
"""A rotation to a general position: rays then meet no edge of a mesh that is aligned with the axes."""


def winding_numbers(vertices: Array, triangles: IntArray, points: Array) -> IntArray:
    """Winding numbers (n,) of a closed mesh of vertices (k, 3) and outward triangles (m, 3) about points (n, 3).

    A ray from each point counts the triangles that it leaves the mesh through less those that it enters by.
    """
    corners, points = (vertices @ TURN)[triangles], points @ TURN
    low, high = corners.min(axis=1), corners.max(axis=1)
    t, i = pair_with_intervals(points[:, 1], low[:, 1], high[:, 1])
    near = (points[i, 0] >= low[t, 0]) & (points[i, 0] <= high[t, 0]) & (points[i, 2] <= high[t, 2])
    t, i = t[near], i[near]
    arm = corners[t] - points[i, None]
    (ax, bx, cx), (ay, by, cy), height = np.moveaxis(arm, 2, 0).swapaxes(1, 2)
    shares = np.stack([bx * cy - cx * by, cx * ay - ax * cy, ax * by - bx * ay])
    met = (shares > 0).all(axis=0) | (shares < 0).all(axis=0)
    area = shares.sum(axis=0)
    above = met & (np.sign(area) * (shares * height).sum(axis=0) > 0)
    return np.rint(np.bincount(i[above], np.sign(area[above]), minlength=len(points))).astype(np.int64)

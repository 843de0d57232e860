"""Triangles that form one smooth face: those joined by sides at which they hardly bend."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.linked_items import label_linked


def label_smooth_groups(points: Array, triangles: IntArray, degrees: float) -> IntArray:
    """The smooth group of each triangle (m,), numbered from 0: neighbours of one group bend by at most an angle.

    Sides with another number of triangles than two part groups.
    """
    a, b, c = (points[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    normals = np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)
    sides = np.sort(np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]]), axis=1)
    _, which, count = np.unique(sides, axis=0, return_inverse=True, return_counts=True)
    order = np.argsort(which.ravel(), kind="stable")
    one, other = order[np.repeat(count == 2, count)].reshape(-1, 2).T % len(triangles)
    smooth = np.einsum("nd,nd->n", normals[one], normals[other]) >= np.cos(np.radians(degrees))
    return label_linked(len(triangles), np.column_stack([one[smooth], other[smooth]]))

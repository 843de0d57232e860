"""The corners of an octree's leaves, and the minimal faces and edges between them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.octree import Array, Ints, Octree

FACE_AXES = ((1, 2), (2, 0), (0, 1))
"""In-plane axes (b, c) of a face normal to axis a, so that (a, b, c) is right-handed."""


class Nodes:
    """The corners of leaves: which finest nodes they are, and the field's values there."""

    def __init__(self, tree: Octree, field: Field) -> None:
        self.shape = tree.shape + 1
        corner = (tree.origin[:, None] + tree.size[:, None, None] * _UNIT).reshape(-1, 3)
        self.ids = np.unique(self.flat(corner))
        self.present = np.zeros(int(np.prod(self.shape)), bool)
        self.present[self.ids] = True
        self.values = field(tree.points(self.position(self.ids)))

    def flat(self, position: Ints) -> Ints:
        return (position[..., 0] * self.shape[1] + position[..., 1]) * self.shape[2] + position[..., 2]

    def position(self, flat: Ints) -> Ints:
        return np.stack(np.unravel_index(flat, tuple(self.shape)), axis=-1)

    def value(self, flat: Ints) -> Array:
        return self.values[np.searchsorted(self.ids, flat)]


_UNIT = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """Minimal faces: the lowest node, normal axis, size, and the leaves below and above (-1 outside the box)."""

    origin: Ints
    axis: Ints
    size: Ints
    below: Ints
    above: Ints


def minimal_faces(tree: Octree, nodes: Nodes) -> Faces:
    rows = []
    for axis, (b, c) in enumerate(FACE_AXES):
        for upper in (0, 1):
            origin = tree.origin.copy()
            origin[:, axis] += upper * tree.size
            centre = origin.copy()
            centre[:, b] += tree.size // 2
            centre[:, c] += tree.size // 2
            whole = (tree.size == 1) | ~nodes.present[nodes.flat(centre)]
            rows.append(np.column_stack([origin, np.full(len(origin), axis), tree.size])[whole])
    faces = np.unique(np.concatenate(rows), axis=0)
    origin, axis, size = faces[:, :3], faces[:, 3], faces[:, 4]
    sides = []
    for shift in (-1, 0):
        cell = origin.copy()
        cell[np.arange(len(cell)), axis] += shift
        sides.append(leaf_at(tree, cell))
    return Faces(origin, axis, size, sides[0], sides[1])


def leaf_at(tree: Octree, cell: Ints) -> Ints:
    """The leaf of finest cells (..., 3), -1 outside the box."""
    outside = ((cell < 0) | (cell >= tree.shape)).any(axis=-1)
    i, j, k = np.moveaxis(np.clip(cell, 0, tree.shape - 1), -1, 0)
    return np.where(outside, -1, tree.leaf[i, j, k])


def edge_length(nodes: Nodes, start: Ints, axis: Ints) -> Ints:
    """The length of the minimal edge from each node along an axis: up to the next node that is present."""
    length = np.zeros(len(start), np.int64)
    step = 1
    rows = np.arange(len(start))
    while (length == 0).any():
        at = start.copy()
        at[rows, axis] = np.minimum(at[rows, axis] + step, nodes.shape[axis] - 1)
        found = (length == 0) & nodes.present[nodes.flat(at)]
        length[found] = step
        step *= 2
    return length

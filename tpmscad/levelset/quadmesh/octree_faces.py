"""The corners of an octree's leaves, and the minimal faces and edges between them.

Pairs of the edges that a level set crosses, on the minimal faces of an octree.

An ambiguous face is decided by the sign at its centre, which the cells on both sides see alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.octree import Octree

FACE_AXES = ((1, 2), (2, 0), (0, 1))
"""In-plane axes (b, c) of a face normal to axis a, so that (a, b, c) is right-handed."""


class OctreeNodes:
    """The corners of leaves: which finest nodes they are, and the field's values there."""

    def __init__(self, tree: Octree, field: Field) -> None:
        self.shape = tree.shape + 1
        corner = (tree.origin[:, None] + tree.size[:, None, None] * _CORNER_OFFSETS).reshape(-1, 3)
        self.ids = np.unique(self.flat(corner))
        self.present = np.zeros(int(np.prod(self.shape)), bool)
        self.present[self.ids] = True
        self.values = field(tree.points(self.position(self.ids)))

    def flat(self, position: IntArray) -> IntArray:
        return (position[..., 0] * self.shape[1] + position[..., 1]) * self.shape[2] + position[..., 2]

    def position(self, flat: IntArray) -> IntArray:
        return np.stack(np.unravel_index(flat, tuple(self.shape)), axis=-1)

    def value(self, flat: IntArray) -> Array:
        return self.values[np.searchsorted(self.ids, flat)]


_CORNER_OFFSETS = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])


@dataclass(frozen=True, slots=True, eq=False)
class MinimalFaces:
    """Minimal faces: the lowest node, normal axis, size, and the leaves below and above (-1 outside the box)."""

    origin: IntArray
    axis: IntArray
    size: IntArray
    below: IntArray
    above: IntArray


def find_minimal_faces(tree: Octree, nodes: OctreeNodes) -> MinimalFaces:
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
        sides.append(find_leaves(tree, cell))
    return MinimalFaces(origin, axis, size, sides[0], sides[1])


def find_leaves(tree: Octree, cell: IntArray) -> IntArray:
    """The leaf of finest cells (..., 3), -1 outside the box."""
    outside = ((cell < 0) | (cell >= tree.shape)).any(axis=-1)
    i, j, k = np.moveaxis(np.clip(cell, 0, tree.shape - 1), -1, 0)
    return np.where(outside, -1, tree.leaf[i, j, k])


def minimal_edge_lengths(nodes: OctreeNodes, start: IntArray, axis: IntArray) -> IntArray:
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


HALF_PLANE_OF_DIRECTION = {(2, 1): 0, (1, -1): 1, (2, -1): 2, (1, 1): 3}
"""The half-plane that a face lies in: (1 for b or 2 for c, direction)."""


@dataclass(frozen=True, slots=True, eq=False)
class CrossedEdgePairs:
    """Pairs of crossed edges on minimal faces: edge keys, half-planes round each edge and leaves (L, 2) each, plane (L,)."""

    edge: IntArray
    half_plane: IntArray
    cell: IntArray
    plane: IntArray


def pair_crossed_edges(tree: Octree, nodes: OctreeNodes, field: Field, faces: MinimalFaces) -> CrossedEdgePairs:
    count = len(faces.axis)
    ring = np.empty((count, 8, 3), np.int64)
    for axis, (b, c) in enumerate(FACE_AXES):
        at = np.flatnonzero(faces.axis == axis)
        corner = np.repeat(faces.origin[at][:, None], 4, axis=1)
        size = faces.size[at][:, None]
        corner[:, :, b] += size * np.array([0, 1, 1, 0])
        corner[:, :, c] += size * np.array([0, 0, 1, 1])
        ring[at, 0::2] = corner
        ring[at, 1::2] = (corner + np.roll(corner, -1, axis=1)) // 2
    flat = nodes.flat(ring)
    hanging = nodes.present[flat[:, 1::2]] & (faces.size > 1)[:, None]
    solid = np.empty((count, 8), bool)
    solid[:, 0::2] = nodes.value(flat[:, 0::2]) <= 0
    solid[:, 1::2] = np.where(
        hanging, nodes.value(np.where(hanging, flat[:, 1::2], flat[:, 0::2])) <= 0, solid[:, 0::2]
    )
    crossed = solid != np.roll(solid, -1, axis=1)

    busy = np.flatnonzero(crossed.any(axis=1))
    solid, crossed, hanging, flat = solid[busy], crossed[busy], hanging[busy], flat[busy]
    axis = faces.axis[busy]
    centre = solid[:, 0].copy()
    many = np.flatnonzero(crossed.sum(axis=1) > 2)
    middle = (ring[busy[many], 0] + ring[busy[many], 4]) / 2
    centre[many] = field(tree.points(middle)) <= 0

    # the edge in slot j: between ring nodes j and j + 1, or between the corners where the middle is no node
    begin = flat.copy()
    begin[:, 1::2] = np.where(hanging, flat[:, 1::2], flat[:, 0::2])
    key_node = np.minimum(begin, np.roll(flat, -1, axis=1))
    key_node[:, 0::2] = np.minimum(flat[:, 0::2], flat[:, 1::2])
    in_plane = np.array(FACE_AXES)[axis]
    slot_axis = in_plane[:, [0, 0, 1, 1, 0, 0, 1, 1]]
    key = 3 * key_node + slot_axis

    starts = crossed & (np.roll(solid, -1, axis=1) != centre[:, None])
    f, j = np.nonzero(starts)
    partner = np.full(len(f), -1)
    for ahead in range(1, 8):
        k = (j + ahead) % 8
        partner = np.where((partner < 0) & crossed[f, k], k, partner)
    slots = np.stack([j, partner], axis=1)
    # inward directions of the four sides of a face: +c, -b, -c, +b, with (b, c) the face's own axes
    half_plane = np.empty((len(f), 2), np.int64)
    for end in (0, 1):
        side = slots[:, end] // 2
        inward_axis = in_plane[f, np.array([1, 0, 1, 0])[side]]
        direction = np.array([1, -1, -1, 1])[side]
        position = (inward_axis - slot_axis[f, slots[:, end]]) % 3  # 1: b, 2: c of the edge
        table = np.array(
            [
                [-1, -1],
                [HALF_PLANE_OF_DIRECTION[1, -1], HALF_PLANE_OF_DIRECTION[1, 1]],
                [HALF_PLANE_OF_DIRECTION[2, -1], HALF_PLANE_OF_DIRECTION[2, 1]],
            ]
        )
        half_plane[:, end] = table[position, (direction > 0).astype(int)]
    below, above = faces.below[busy][f], faces.above[busy][f]
    plane = np.where(below < 0, 2 * axis[f], np.where(above < 0, 2 * axis[f] + 1, -1))
    return CrossedEdgePairs(key[f[:, None], slots], half_plane, np.stack([below, above], axis=1), plane)

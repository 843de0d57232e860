"""Minimal faces and edges of an octree, and the segments of the level set on them.

A face or edge of a leaf is minimal if no neighbouring leaf subdivides it. Where the level set crosses a minimal face, the crossed
edges of the face are joined in pairs: each pair is one segment of the level set's trace on the face (as in marching squares). A
face with four or more crossed edges is ambiguous. The sign of the field at its centre decides, which both neighbouring leaves see
alike; so the segments of all faces fit together.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.octree import CHILD_OFFSETS, Octree

FACE_AXES = ((1, 2), (2, 0), (0, 1))
"""In-plane axes (b, c) of a face normal to axis a, so that (a, b, c) is right-handed."""

HALF_PLANE_OF_INWARD_AXIS = np.array([[-1, -1], [1, 3], [2, 0]])
"""Number of the half-plane round an edge that contains a face: row 1 or 2 if the face extends along the edge's axis b or c,
column 0 or 1 if it extends in the negative or positive direction."""

ROUND_OFF_FRACTION = 1e-12
"""Values below this fraction of the greatest one nearby, in the leaves at a node, are round-off of zero: their sign must not
decide on the mesh."""


class OctreeNodes:
    """The corners of an octree's leaves (nodes) with the field's values; nodes are named by flat index on the finest grid.

    `ids` (n,) are the sorted flat indices of the nodes, `values` (n,) the field, zero where it is round-off of zero. `of_leaf`
    (N, 8) are the places of the leaves' corners among the nodes.
    """

    def __init__(self, tree: Octree, field: Field) -> None:
        self.shape = tree.shape + 1
        flat = self.flat_index((tree.origin[:, None] + tree.size[:, None, None] * CHILD_OFFSETS).reshape(-1, 3))
        self.ids = np.unique(flat)
        values = field(tree.points(self.grid_index(self.ids)))
        node = np.searchsorted(self.ids, flat)
        self.of_leaf = node.reshape(-1, 8)
        greatest = np.zeros(len(values))
        np.maximum.at(greatest, node, np.abs(values[node]).reshape(-1, 8).max(axis=1).repeat(8))
        self.values = np.where(np.abs(values) <= ROUND_OFF_FRACTION * greatest, 0.0, values)

    def flat_index(self, position: IntArray) -> IntArray:
        """Flat indices (...) of grid positions (..., 3)."""
        return (position[..., 0] * self.shape[1] + position[..., 1]) * self.shape[2] + position[..., 2]

    def grid_index(self, flat: IntArray) -> IntArray:
        """Grid positions (..., 3) of flat indices (...)."""
        return np.stack(np.unravel_index(flat, tuple(self.shape)), axis=-1)

    def contains(self, flat: IntArray) -> BoolArray:
        """Whether the grid positions of these flat indices are nodes."""
        place = np.searchsorted(self.ids, flat)
        return np.asarray(self.ids[np.minimum(place, len(self.ids) - 1)] == flat)

    def value_at(self, flat: IntArray) -> Array:
        """Field values at the nodes of these flat indices."""
        return self.values[np.searchsorted(self.ids, flat)]


@dataclass(frozen=True, slots=True, eq=False)
class MinimalFaces:
    """Minimal faces: lowest node (F, 3), normal axis (F,), size (F,), and the leaves below and above (F,), -1 outside the box."""

    origin: IntArray
    axis: IntArray
    size: IntArray
    below: IntArray
    above: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class CrossedEdgePairs:
    """Pairs of crossed edges on minimal faces, one row for each segment of the level set's trace.

    `edge` (L, 2): keys of the two edges, 3 * flat index of the lower node + axis. `half_plane` (L, 2): number of the half-plane
    round each edge that contains the face. `cell` (L, 2): leaves below and above, -1 outside. `plane` (L,): face of the box, 2 *
    axis + upper, or -1 inside.
    """

    edge: IntArray
    half_plane: IntArray
    cell: IntArray
    plane: IntArray


def find_minimal_faces(tree: Octree, nodes: OctreeNodes) -> MinimalFaces:
    """The minimal faces that the level set may cross: the faces of leaves near it without a node at their centre."""
    near = _find_leaves_near_level_set(tree, nodes)
    leaf_origin, leaf_size = tree.origin[near], tree.size[near]
    keys, leaves = [], []
    for axis, (b, c) in enumerate(FACE_AXES):
        for upper in (0, 1):
            origin = leaf_origin.copy()
            origin[:, axis] += upper * leaf_size
            centre = origin.copy()
            centre[:, b] += leaf_size // 2
            centre[:, c] += leaf_size // 2
            minimal = np.flatnonzero((leaf_size == 1) | ~nodes.contains(nodes.flat_index(centre)))
            keys.append(3 * nodes.flat_index(origin[minimal]) + axis)
            leaves.append(minimal)
    key, first = np.unique(np.concatenate(keys), return_index=True)
    axis, size = key % 3, leaf_size[np.concatenate(leaves)[first]]
    origin = nodes.grid_index(key // 3)
    sides = []
    for shift in (-1, 0):
        cell = origin.copy()
        cell[np.arange(len(cell)), axis] += shift
        sides.append(find_leaves(tree, cell))
    return MinimalFaces(origin, axis, size, sides[0], sides[1])


def _find_leaves_near_level_set(tree: Octree, nodes: OctreeNodes) -> IntArray:
    """Leaves with corners in solid and void, and larger ones at their corners, whose faces may be crossed at hanging nodes.

    A crossed minimal edge belongs to a leaf of the first kind, and begins or ends at a corner of every leaf that it bounds.
    """
    solid = nodes.values[nodes.of_leaf] <= 0
    mixed = np.asarray(solid.any(axis=1) & ~solid.all(axis=1))
    is_corner = np.zeros(len(nodes.ids), bool)
    is_corner[nodes.of_leaf[mixed]] = True
    return np.flatnonzero(mixed | ((tree.size > 1) & is_corner[nodes.of_leaf].any(axis=1)))


def find_leaves(tree: Octree, cell: IntArray) -> IntArray:
    """Leaf numbers (...) of finest cells (..., 3), -1 outside the box."""
    outside = ((cell < 0) | (cell >= tree.shape)).any(axis=-1)
    return np.where(outside, -1, tree.leaves_at(np.clip(cell, 0, tree.shape - 1)))


def minimal_edge_lengths(nodes: OctreeNodes, start: IntArray, axis: IntArray) -> IntArray:
    """Lengths (n,) of the minimal edges that begin at grid positions (n, 3) and run along `axis` (n,) to the next node."""
    length = np.zeros(len(start), np.int64)
    step = 1
    rows = np.arange(len(start))
    while (length == 0).any():
        end = start.copy()
        end[rows, axis] = np.minimum(end[rows, axis] + step, nodes.shape[axis] - 1)
        reached = (length == 0) & nodes.contains(nodes.flat_index(end))
        length[reached] = step
        step *= 2
    return length


def pair_crossed_edges(tree: Octree, nodes: OctreeNodes, field: Field, faces: MinimalFaces) -> CrossedEdgePairs:
    """The segments of {field = 0} on minimal faces, each as the pair of crossed edges that it joins."""
    ring = _face_rings(faces)
    flat = nodes.flat_index(ring)
    hanging = nodes.contains(flat[:, 1::2]) & (faces.size > 1)[:, None]
    solid = _ring_signs(nodes, flat, hanging)
    crossed = solid != np.roll(solid, -1, axis=1)

    rows = np.flatnonzero(crossed.any(axis=1))
    ring, flat, hanging, solid, crossed = ring[rows], flat[rows], hanging[rows], solid[rows], crossed[rows]
    axis = faces.axis[rows]
    in_plane = np.array(FACE_AXES)[axis]
    edge_axis = in_plane[:, [0, 0, 1, 1, 0, 0, 1, 1]]
    key = 3 * _lower_edge_nodes(flat, hanging) + edge_axis

    centre = _centre_signs(tree, field, ring, np.abs(nodes.value_at(flat[:, ::2])).max(axis=1), solid, crossed)
    face, slots = _pair_slots(solid, crossed, centre)
    half_plane = _half_planes(in_plane[face], edge_axis[face[:, None], slots], slots)
    below, above = faces.below[rows][face], faces.above[rows][face]
    plane = np.where(below < 0, 2 * axis[face], np.where(above < 0, 2 * axis[face] + 1, -1))
    return CrossedEdgePairs(key[face[:, None], slots], half_plane, np.stack([below, above], axis=1), plane)


def _face_rings(faces: MinimalFaces) -> IntArray:
    """Grid positions (F, 8, 3) round each face: its corners at even, the midpoints of its sides at odd places."""
    ring = np.empty((len(faces.axis), 8, 3), np.int64)
    for axis, (b, c) in enumerate(FACE_AXES):
        rows = np.flatnonzero(faces.axis == axis)
        corner = np.repeat(faces.origin[rows][:, None], 4, axis=1)
        size = faces.size[rows][:, None]
        corner[:, :, b] += size * np.array([0, 1, 1, 0])
        corner[:, :, c] += size * np.array([0, 0, 1, 1])
        ring[rows, 0::2] = corner
        ring[rows, 1::2] = (corner + np.roll(corner, -1, axis=1)) // 2
    return ring


def _ring_signs(nodes: OctreeNodes, flat: IntArray, hanging: BoolArray) -> BoolArray:
    """Whether each ring position (F, 8) is solid; a midpoint that is no hanging node (F, 4) repeats the corner before it."""
    solid = np.empty(flat.shape, bool)
    solid[:, 0::2] = nodes.value_at(flat[:, 0::2]) <= 0
    at_middle = nodes.value_at(np.where(hanging, flat[:, 1::2], flat[:, 0::2])) <= 0
    solid[:, 1::2] = np.where(hanging, at_middle, solid[:, 0::2])
    return solid


def _centre_signs(
    tree: Octree, field: Field, ring: IntArray, greatest: Array, solid: BoolArray, crossed: BoolArray
) -> BoolArray:
    """Whether the centre of each face (F,) counts as solid: by the field for ambiguous faces, else by the first corner.

    `greatest` (F,): the largest absolute value at the corners.
    """
    centre = solid[:, 0].copy()
    ambiguous = np.flatnonzero(crossed.sum(axis=1) > 2)
    middle = (ring[ambiguous, 0] + ring[ambiguous, 4]) / 2
    centre[ambiguous] = field(tree.points(middle)) <= ROUND_OFF_FRACTION * greatest[ambiguous]
    return centre


def _lower_edge_nodes(flat: IntArray, hanging: BoolArray) -> IntArray:
    """Flat index (F, 8) of the lower end of the edge in each slot.

    Slot j lies between ring positions j and j + 1; without a hanging node the whole side of the face is the edge of both its
    slots.
    """
    begin = flat.copy()
    begin[:, 1::2] = np.where(hanging, flat[:, 1::2], flat[:, 0::2])
    lower = np.minimum(begin, np.roll(flat, -1, axis=1))
    lower[:, 0::2] = np.minimum(flat[:, 0::2], flat[:, 1::2])
    return lower


def _pair_slots(solid: BoolArray, crossed: BoolArray, centre: BoolArray) -> tuple[IntArray, IntArray]:
    """Pairs of crossed slots: the face (L,) and the two slots (L, 2).

    A pair starts at a crossed slot behind which the ring differs from the centre, and ends at the next crossed slot.
    """
    starts = crossed & (np.roll(solid, -1, axis=1) != centre[:, None])
    face, first = np.nonzero(starts)
    partner = np.full(len(face), -1)
    for steps in range(1, 8):
        slot = (first + steps) % 8
        partner = np.where((partner < 0) & crossed[face, slot], slot, partner)
    return face, np.stack([first, partner], axis=1)


def _half_planes(in_plane: IntArray, edge_axis: IntArray, slots: IntArray) -> IntArray:
    """Number (L, 2) of the half-plane round each edge that contains the face with in-plane axes (L, 2)."""
    # inward directions of the four sides of a face: +c, -b, -c, +b, with (b, c) the face's own axes
    side = slots // 2
    inward_axis = np.take_along_axis(in_plane, np.array([1, 0, 1, 0])[side], axis=1)
    upwards = np.array([1, 0, 0, 1])[side]
    axis_of_edge = (inward_axis - edge_axis) % 3  # 1: the edge's axis b, 2: its axis c
    return HALF_PLANE_OF_INWARD_AXIS[axis_of_edge, upwards]

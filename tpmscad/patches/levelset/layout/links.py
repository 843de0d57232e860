"""Pairs of the edges that a level set crosses, on the minimal faces of an octree.

An ambiguous face is decided by the sign at its centre, which the cells on both sides see alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.nodes import FACE_AXES, Faces, Nodes
from tpmscad.patches.levelset.layout.octree import Ints, Octree

HALF_PLANE = {(2, 1): 0, (1, -1): 1, (2, -1): 2, (1, 1): 3}
"""The half-plane that a face lies in: (1 for b or 2 for c, direction)."""


@dataclass(frozen=True, slots=True, eq=False)
class Links:
    """Pairs of crossed edges on minimal faces: edge keys, half-planes round each edge and leaves (L, 2) each, plane (L,)."""

    edge: Ints
    half_plane: Ints
    cell: Ints
    plane: Ints


def links_of(tree: Octree, nodes: Nodes, field: Field, faces: Faces) -> Links:
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
        table = np.array([[-1, -1], [HALF_PLANE[1, -1], HALF_PLANE[1, 1]], [HALF_PLANE[2, -1], HALF_PLANE[2, 1]]])
        half_plane[:, end] = table[position, (direction > 0).astype(int)]
    below, above = faces.below[busy][f], faces.above[busy][f]
    plane = np.where(below < 0, 2 * axis[f], np.where(above < 0, 2 * axis[f] + 1, -1))
    return Links(key[f[:, None], slots], half_plane, np.stack([below, above], axis=1), plane)

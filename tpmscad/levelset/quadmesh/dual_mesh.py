"""The dual mesh of a level set on an octree: a closed two-manifold by construction, quadrilaterals but for 2:1 transitions.

Manifold dual marching cubes on a polyhedral complex. On each minimal face the crossed edges are paired (an ambiguous face by the
sign at its centre, which both cells see alike), pairs chain into cycles round each cell, and each cycle is one dual vertex. A
face on the box carries a vertex for each of its pairs, a crossed edge of the box itself one more. Each crossed minimal edge is
one polygon: of four corners, or of three where one cell spans two quadrants round the edge.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.octree_faces import (
    FACE_AXES,
    CrossedEdgePairs,
    OctreeNodes,
    find_leaves,
    find_minimal_faces,
    minimal_edge_lengths,
    pair_crossed_edges,
)
from tpmscad.levelset.quadmesh.vectors import next_corner

__all__ = ["FACE_AXES", "QuadMesh", "build_dual_mesh"]

QUADRANT_SIGNS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
"""Signs along (b, c) of the four quadrants round an edge along a, counter-clockwise; half-plane k lies between k and k + 1."""

NODE_SNAP_FRACTION = 1e-6
SNAPPED_CROSSING_FRACTIONS = np.array([0.06, 0.04, 0.024])
"""An edge's end this near (in its lengths) to its crossing is a node on the surface. Vertices round it would all start there, and
sides without length never grow: so they start as if it were crossed at these parts of edges along x, y and z, which are unlike
lest they lead back to it."""


@dataclass(frozen=True, slots=True, eq=False)
class QuadMesh:
    """Polygons of a level set in a box.

    vertices (V, 3), `start` where the tree put them; `fixed` (V, 3) marks coordinates that lie on the box; `cell` (V,) is a leaf
    the vertex came from, `size` its size in model units. corners (Q, 4): vertices, counter-clockwise seen from outside, -1 last
    in triangles; sides (Q, 4): the side from corner i to the next, sides shared by two polygons have one number, those on the
    box belong to one.
    `side_ends` (S, 2); `side_plane` (S,): 2 * axis + (1 on the upper side), or -1 inside.
    """

    vertices: Array
    start: Array
    fixed: BoolArray
    cell: IntArray
    size: Array
    corners: IntArray
    sides: IntArray
    side_ends: IntArray
    side_plane: IntArray


def build_dual_mesh(tree: Octree, field: Field) -> QuadMesh:
    """The dual mesh of {field = 0}; vertices near the surface, not on it."""
    nodes = OctreeNodes(tree, field)
    face = find_minimal_faces(tree, nodes)
    links = pair_crossed_edges(tree, nodes, field, face)
    return _assemble_polygons(tree, nodes, links)


def _assemble_polygons(tree: Octree, nodes: OctreeNodes, links: CrossedEdgePairs) -> QuadMesh:
    keys, edge = np.unique(links.edge, return_inverse=True)
    edge = edge.reshape(-1, 2)
    n_links, n_edges, n_leaves = len(edge), len(keys), len(tree.size)

    # dual vertices: cycles of (cell, crossed edge); a link on the box is a cell of its own
    cell = np.where(links.cell < 0, n_leaves + np.arange(n_links)[:, None], links.cell)
    pair = (cell[:, :, None] * n_edges + edge[:, None, :]).reshape(-1, 2)
    names, index = np.unique(pair, return_inverse=True)
    index = index.reshape(-1, 2)
    graph = coo_array((np.ones(len(index), bool), (index[:, 0], index[:, 1])), shape=(len(names),) * 2)
    n_vertices, vertex_of = connected_components(graph, directed=False)

    axis = keys % 3
    start = nodes.position(keys // 3)
    ring_link = np.full((n_edges, 4), -1)
    ring_link[edge.ravel(), links.half_plane.ravel()] = np.repeat(np.arange(n_links), 2)
    corner, leaf = np.full((n_edges, 4), -1), np.empty((n_edges, 4), np.int64)
    others = np.array(FACE_AXES)[axis]
    rows = np.arange(n_edges)
    for q, (sb, sc) in enumerate(QUADRANT_SIGNS):
        at = start.copy()
        at[rows, others[:, 0]] -= sb < 0
        at[rows, others[:, 1]] -= sc < 0
        leaf[:, q] = find_leaves(tree, at)
    for q in range(4):
        beside = np.where(ring_link[:, q] >= 0, ring_link[:, q], ring_link[:, q - 1])
        name = np.where(leaf[:, q] >= 0, leaf[:, q], n_leaves + beside) * n_edges + rows
        known = (leaf[:, q] >= 0) | (beside >= 0)
        corner[known, q] = vertex_of[np.searchsorted(names, name[known])]
    on_box_edge = np.flatnonzero((corner < 0).any(axis=1))
    corner[corner < 0] = n_vertices + np.arange(len(on_box_edge))

    # crossing points, from which vertices start
    upper = start.copy()
    length = minimal_edge_lengths(nodes, start, axis)
    upper[rows, axis] += length
    f0, f1 = nodes.value(nodes.flat(start)), nodes.value(nodes.flat(upper))
    share, beside = f0 / (f0 - f1), SNAPPED_CROSSING_FRACTIONS[axis]
    off = np.where(share < NODE_SNAP_FRACTION, beside, np.where(share > 1 - NODE_SNAP_FRACTION, 1 - beside, share))
    crossing = tree.points(start + off[:, None] * (upper - start))
    of_pair = names % n_edges
    vertices = np.zeros((n_vertices + len(on_box_edge), 3))
    np.add.at(vertices, vertex_of, crossing[of_pair])
    vertices[:n_vertices] /= np.bincount(vertex_of)[:, None]
    vertices[n_vertices:] = tree.points(start + share[:, None] * (upper - start))[on_box_edge]

    fixed = np.zeros(vertices.shape, bool)
    owner = np.full(len(vertices), -1)
    owner[vertex_of] = names // n_edges
    on_face = np.flatnonzero(owner >= n_leaves)
    link = owner[on_face] - n_leaves
    fixed[on_face, links.plane[link] // 2] = True
    owner[on_face] = links.cell[link].max(axis=1)
    owner[n_vertices:] = leaf[on_box_edge].max(axis=1)
    fixed[n_vertices:] = True
    fixed[n_vertices + np.arange(len(on_box_edge)), axis[on_box_edge]] = False
    bounds = np.stack([tree.lo, tree.hi])
    nearest = (np.abs(vertices - tree.hi) < np.abs(vertices - tree.lo)).astype(int)
    vertices = np.where(fixed, np.take_along_axis(bounds, nearest, axis=0), vertices)

    # sides: links, and runs along the box between two outer quadrants
    outside = leaf < 0
    along_box = outside & np.roll(outside, -1, axis=1)
    side = np.where(along_box, n_links + np.cumsum(along_box.ravel()).reshape(-1, 4) - 1, ring_link)
    n_sides = n_links + int(along_box.sum())
    present = side >= 0
    order = np.argsort(~present, axis=1, kind="stable")
    side, corner = np.take_along_axis(side, order, 1), np.take_along_axis(corner, order, 1)
    corner[side < 0] = -1
    turned = f0 > 0
    side, corner = _reverse_polygons(side, corner, turned)

    ends = np.full((n_sides, 2), -1)
    q, i = np.nonzero(side >= 0)
    number, first = np.unique(side[q, i], return_index=True)
    ends[number] = np.stack([corner[q, i], next_corner(corner)[q, i]], axis=1)[first]
    plane = np.full(n_sides, -1)
    e, k = np.nonzero(along_box)
    # half-plane k is normal to b (k even: it lies along c) or to c; the outer quadrants lie beyond the box's face
    number = n_links + np.arange(len(e))
    plane[number] = _box_plane(tree, start[e], others[e], k)
    size = tree.size[owner][:, None] * tree.step
    return QuadMesh(vertices, vertices, fixed, owner, size.min(axis=1), corner, side, ends, plane)


def _box_plane(tree: Octree, start: IntArray, others: IntArray, k: IntArray) -> IntArray:
    """The face of the box in which the run between outer quadrants k and k + 1 lies."""
    axis = np.where(k % 2 == 1, others[:, 0], others[:, 1])  # half-plane k points straight out of the box: along b or c
    return 2 * axis + (start[np.arange(len(k)), axis] == tree.shape[axis])


def _reverse_polygons(side: IntArray, corner: IntArray, turned: BoolArray) -> tuple[IntArray, IntArray]:
    """The polygons run the other way round where `turned`; the first corner stays."""
    three = side[:, 3] < 0
    side, corner = side.copy(), corner.copy()
    quads, triangles = np.flatnonzero(turned & ~three), np.flatnonzero(turned & three)
    corner[quads] = corner[quads][:, [0, 3, 2, 1]]
    side[quads] = side[quads][:, [3, 2, 1, 0]]
    corner[triangles] = corner[triangles][:, [0, 2, 1, 3]]
    side[triangles] = side[triangles][:, [2, 1, 0, 3]]
    return side, corner

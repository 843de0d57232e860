"""Dual mesh of a level set on an octree: a manifold quad-dominant mesh, with triangles only at 2:1 transitions.

The method is manifold dual marching cubes (Nielson, "Dual marching cubes", 2004; Schaefer, Ju and Warren, "Manifold dual
contouring", 2007) on the polyhedral cells that the leaves of a 2:1 balanced octree are:

1. The level set's trace on each minimal face is a set of segments, each of which joins two crossed edges (`octree_faces`).
2. In each leaf the segments chain into closed cycles. Each cycle is one dual vertex.
3. Each crossed minimal edge is one polygon, whose corners are the dual vertices of the leaves round it: a quadrilateral, or a
   triangle where one leaf fills two of the four quadrants round the edge.

On the box a segment on a boundary face carries a vertex of its own, and a crossed edge of the box one more, so that the mesh ends
on the box.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.linked_items import label_linked
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

QUADRANT_SIGNS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
"""Signs along (b, c) of the four quadrants round an edge along a, counter-clockwise; half-plane k lies between quadrants k and k
+ 1."""

NODE_SNAP_FRACTION = 1e-6
"""A crossing closer than this fraction of the edge to one of its ends lies at that octree node."""

SNAPPED_CROSSING_FRACTIONS = np.array([0.06, 0.04, 0.024])
"""Fractions of an edge along x, y and z at which a crossing at a node is placed instead. All vertices round the node would
otherwise start at the same point, and sides of zero length never grow. The three fractions differ, as equal ones can average to
the node."""


@dataclass(frozen=True, slots=True, eq=False)
class QuadMesh:
    """Quad-dominant mesh of a level set in a box.

    Throughout this package polygons are rows (Q, 4) of vertex numbers, counter-clockwise as seen from the void; triangles are
    padded with -1 in the last place.
    """

    vertices: Array
    """Positions (V, 3)."""
    start_positions: Array
    """Positions (V, 3) before smoothing: they identify a vertex across meshes of related octrees."""
    fixed: BoolArray
    """Coordinates (V, 3) that lie on the box and stay there: one in a face of the box, two on an edge."""
    leaf: IntArray
    """A leaf (V,) that the vertex comes from."""
    size: Array
    """Length scale (V,) in model units: the shortest edge of that leaf, or after simplification the shortest side if longer."""
    corners: IntArray
    """Polygons (Q, 4)."""
    sides: IntArray
    """Sides (Q, 4) of polygons: side i runs from corner i to the next. Two polygons share an inner side; one has a side on the
    box."""
    side_ends: IntArray
    """Vertices (S, 2) of sides."""
    side_plane: IntArray
    """Face of the box in which a side (S,) lies: 2 * axis, + 1 for the upper face; -1 inside the box."""


@dataclass(frozen=True, slots=True, eq=False)
class _CrossedEdges:
    """Crossed minimal edges (E,), with their surroundings in the order of `QUADRANT_SIGNS`.

    `key` as in CrossedEdgePairs; grid positions `start`, `end` (E, 3); `axis` and in-plane axes `others` (E, 2); `values` (2, E)
    at the ends; `leaf` (E, 4) in the quadrants, -1 outside the box; `pair` (E, 4) on the half-planes, -1 for none.
    """

    key: IntArray
    axis: IntArray
    others: IntArray
    start: IntArray
    end: IntArray
    values: Array
    leaf: IntArray
    pair: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class _DualVertices:
    """Cycles of (cell, crossed edge) incidences: sorted `names` (I,) = cell * E + edge, the vertex (I,) of each, their number.

    A segment on the box is a cell of its own, numbered after the leaves.
    """

    names: IntArray
    vertex_of: IntArray
    count: int


def build_dual_mesh(tree: Octree, field: Field) -> QuadMesh:
    """Dual mesh of {field = 0}, its vertices near the level set but not on it."""
    nodes = OctreeNodes(tree, field)
    pairs = pair_crossed_edges(tree, nodes, field, find_minimal_faces(tree, nodes))
    edges, edge_of_pair = _collect_crossed_edges(tree, nodes, pairs)
    cycles = _find_cycles(tree, pairs, edge_of_pair, len(edges.key))
    corner, box_edges = _polygon_corners(tree, edges, cycles)
    vertices = _average_crossings(tree, edges, cycles, box_edges)
    vertices, fixed, leaf = _constrain_to_box(tree, pairs, edges, cycles, box_edges, vertices)
    side, corner, ends, plane = _number_sides(tree, edges, corner, len(edge_of_pair))
    size = tree.size[leaf][:, None] * tree.cell_edges
    return QuadMesh(vertices, vertices, fixed, leaf, size.min(axis=1), corner, side, ends, plane)


def _collect_crossed_edges(tree: Octree, nodes: OctreeNodes, pairs: CrossedEdgePairs) -> tuple[_CrossedEdges, IntArray]:
    """The distinct edges of the pairs, and their numbers (L, 2) in each pair."""
    key, edge = np.unique(pairs.edge, return_inverse=True)
    edge = edge.reshape(-1, 2)
    axis, start = key % 3, nodes.grid_index(key // 3)
    others, rows = np.array(FACE_AXES)[axis], np.arange(len(key))
    pair = np.full((len(key), 4), -1)
    pair[edge.ravel(), pairs.half_plane.ravel()] = np.repeat(np.arange(len(edge)), 2)
    leaf = np.empty((len(key), 4), np.int64)
    for q, (sign_b, sign_c) in enumerate(QUADRANT_SIGNS):
        cell = start.copy()
        cell[rows, others[:, 0]] -= sign_b < 0
        cell[rows, others[:, 1]] -= sign_c < 0
        leaf[:, q] = find_leaves(tree, cell)
    end = start.copy()
    end[rows, axis] += minimal_edge_lengths(nodes, start, axis)
    values = np.stack([nodes.value_at(nodes.flat_index(start)), nodes.value_at(nodes.flat_index(end))])
    return _CrossedEdges(key, axis, others, start, end, values, leaf, pair), edge


def _find_cycles(tree: Octree, pairs: CrossedEdgePairs, edge: IntArray, n_edges: int) -> _DualVertices:
    """The cycles of segments round each leaf, as connected components of (cell, crossed edge) incidences."""
    cell = np.where(pairs.cell < 0, len(tree.size) + np.arange(len(edge))[:, None], pairs.cell)
    incidence = (cell[:, :, None] * n_edges + edge[:, None, :]).reshape(-1, 2)
    names, index = np.unique(incidence, return_inverse=True)
    vertex_of = label_linked(len(names), index.reshape(-1, 2))
    return _DualVertices(names, vertex_of, 1 + int(vertex_of.max(initial=-1)))


def _polygon_corners(tree: Octree, edges: _CrossedEdges, cycles: _DualVertices) -> tuple[IntArray, IntArray]:
    """Vertex (E, 4) in each quadrant round the crossed edges, and the edges that lie on edges of the box.

    The quadrant between two boundary faces, beyond an edge of the box, has an additional vertex.
    """
    n_edges, n_leaves = len(edges.key), len(tree.size)
    corner = np.full((n_edges, 4), -1)
    for q in range(4):
        pair = np.where(edges.pair[:, q] >= 0, edges.pair[:, q], edges.pair[:, q - 1])
        name = np.where(edges.leaf[:, q] >= 0, edges.leaf[:, q], n_leaves + pair) * n_edges + np.arange(n_edges)
        known = (edges.leaf[:, q] >= 0) | (pair >= 0)
        corner[known, q] = cycles.vertex_of[np.searchsorted(cycles.names, name[known])]
    box_edges = np.flatnonzero((corner < 0).any(axis=1))
    corner[corner < 0] = cycles.count + np.arange(len(box_edges))
    return corner, box_edges


def _average_crossings(tree: Octree, edges: _CrossedEdges, cycles: _DualVertices, box_edges: IntArray) -> Array:
    """Positions (V, 3): means of the crossings along each cycle, and the crossings of the edges of the box."""
    at_start, at_end = edges.values
    fraction, snapped = at_start / (at_start - at_end), SNAPPED_CROSSING_FRACTIONS[edges.axis]
    off_nodes = np.where(
        fraction < NODE_SNAP_FRACTION, snapped, np.where(fraction > 1 - NODE_SNAP_FRACTION, 1 - snapped, fraction)
    )
    crossing = tree.points(edges.start + off_nodes[:, None] * (edges.end - edges.start))
    vertices = np.zeros((cycles.count + len(box_edges), 3))
    np.add.at(vertices, cycles.vertex_of, crossing[cycles.names % len(edges.key)])
    vertices[: cycles.count] /= np.bincount(cycles.vertex_of)[:, None]
    vertices[cycles.count :] = tree.points(edges.start + fraction[:, None] * (edges.end - edges.start))[box_edges]
    return vertices


def _constrain_to_box(
    tree: Octree,
    pairs: CrossedEdgePairs,
    edges: _CrossedEdges,
    cycles: _DualVertices,
    box_edges: IntArray,
    vertices: Array,
) -> tuple[Array, BoolArray, IntArray]:
    """Positions with fixed coordinates exactly on the box, the fixed coordinates (V, 3) and a leaf (V,) of each vertex."""
    n_leaves = len(tree.size)
    fixed = np.zeros(vertices.shape, bool)
    leaf = np.full(len(vertices), -1)
    leaf[cycles.vertex_of] = cycles.names // len(edges.key)
    on_face = np.flatnonzero(leaf >= n_leaves)
    pair = leaf[on_face] - n_leaves
    fixed[on_face, pairs.plane[pair] // 2] = True
    leaf[on_face] = pairs.cell[pair].max(axis=1)
    leaf[cycles.count :] = edges.leaf[box_edges].max(axis=1)
    fixed[cycles.count :] = True
    fixed[cycles.count + np.arange(len(box_edges)), edges.axis[box_edges]] = False
    bounds = np.stack([tree.lo, tree.hi])
    nearest = (np.abs(vertices - tree.hi) < np.abs(vertices - tree.lo)).astype(int)
    return np.where(fixed, np.take_along_axis(bounds, nearest, axis=0), vertices), fixed, leaf


def _number_sides(
    tree: Octree, edges: _CrossedEdges, corner: IntArray, n_pairs: int
) -> tuple[IntArray, IntArray, IntArray, IntArray]:
    """Sides and corners (Q, 4) of the polygons, and ends (S, 2) and planes (S,) of the sides.

    A side is a segment of the trace, or lies in a face of the box between two quadrants outside it.
    """
    outside = edges.leaf < 0
    along_box = outside & np.roll(outside, -1, axis=1)
    side = np.where(along_box, n_pairs + np.cumsum(along_box.ravel()).reshape(-1, 4) - 1, edges.pair)
    n_sides = n_pairs + int(along_box.sum())
    order = np.argsort(side < 0, axis=1, kind="stable")
    side, corner = np.take_along_axis(side, order, 1), np.take_along_axis(corner, order, 1)
    corner[side < 0] = -1
    side, corner = _reverse_polygons(side, corner, edges.values[0] > 0)

    ends = np.full((n_sides, 2), -1)
    q, i = np.nonzero(side >= 0)
    number, first = np.unique(side[q, i], return_index=True)
    ends[number] = np.stack([corner[q, i], next_corner(corner)[q, i]], axis=1)[first]
    plane = np.full(n_sides, -1)
    e, k = np.nonzero(along_box)
    plane[n_pairs + np.arange(len(e))] = _box_plane(tree, edges.start[e], edges.others[e], k)
    return side, corner, ends, plane


def _box_plane(tree: Octree, start: IntArray, others: IntArray, k: IntArray) -> IntArray:
    """Face of the box, 2 * axis + upper, between the outer quadrants k and k + 1 of edges."""
    axis = np.where(k % 2 == 1, others[:, 0], others[:, 1])  # half-plane k points straight out of the box: along b or c
    return 2 * axis + (start[np.arange(len(k)), axis] == tree.shape[axis])


def _reverse_polygons(side: IntArray, corner: IntArray, turned: BoolArray) -> tuple[IntArray, IntArray]:
    """Polygons with the orientation reversed where `turned` (Q,); the first corner stays first."""
    triangular = side[:, 3] < 0
    side, corner = side.copy(), corner.copy()
    quads, triangles = np.flatnonzero(turned & ~triangular), np.flatnonzero(turned & triangular)
    corner[quads] = corner[quads][:, [0, 3, 2, 1]]
    side[quads] = side[quads][:, [3, 2, 1, 0]]
    corner[triangles] = corner[triangles][:, [0, 2, 1, 3]]
    side[triangles] = side[triangles][:, [2, 1, 0, 3]]
    return side, corner

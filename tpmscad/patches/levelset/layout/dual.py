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

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask, Octree

FACE_AXES = ((1, 2), (2, 0), (0, 1))
"""In-plane axes (b, c) of a face normal to axis a, so that (a, b, c) is right-handed."""

QUADRANTS = ((1, 1), (-1, 1), (-1, -1), (1, -1))
"""Signs along (b, c) of the four quadrants round an edge along a, counter-clockwise; half-plane k lies between k and k + 1."""

HALF_PLANE = {(2, 1): 0, (1, -1): 1, (2, -1): 2, (1, 1): 3}
"""The half-plane that a face lies in: (1 for b or 2 for c, direction)."""

AT = 1e-6
BESIDE = np.array([0.06, 0.04, 0.024])
"""An edge's end this near (in its lengths) to its crossing is a node on the surface. Vertices round it would all start there, and
sides without length never grow: so they start as if it were crossed at these parts of edges along x, y and z, which are unlike
lest they lead back to it."""


@dataclass(frozen=True, slots=True, eq=False)
class Mesh:
    """Polygons of a level set in a box.

    vertices (V, 3), `start` where the tree put them; `fixed` (V, 3) marks coordinates that lie on the box; `cell` (V,) is a leaf
    the vertex came from, `size` its size in model units. corners (Q, 4): vertices, counter-clockwise seen from outside, -1 last
    in triangles; sides (Q, 4): the side from corner i to the next, sides shared by two polygons have one number, those on the
    box belong to one.
    `side_ends` (S, 2); `side_plane` (S,): 2 * axis + (1 on the upper side), or -1 inside.
    """

    vertices: Array
    start: Array
    fixed: Mask
    cell: Ints
    size: Array
    corners: Ints
    sides: Ints
    side_ends: Ints
    side_plane: Ints


def dual_mesh(tree: Octree, field: Field) -> Mesh:
    """The dual mesh of {field = 0}; vertices near the surface, not on it."""
    nodes = _Nodes(tree, field)
    face = _minimal_faces(tree, nodes)
    links = _links(tree, nodes, field, face)
    return _polygons(tree, nodes, links)


class _Nodes:
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
class _Faces:
    """Minimal faces: the lowest node, normal axis, size, and the leaves below and above (-1 outside the box)."""

    origin: Ints
    axis: Ints
    size: Ints
    below: Ints
    above: Ints


def _minimal_faces(tree: Octree, nodes: _Nodes) -> _Faces:
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
        sides.append(_leaf_at(tree, cell))
    return _Faces(origin, axis, size, sides[0], sides[1])


def _leaf_at(tree: Octree, cell: Ints) -> Ints:
    """The leaf of finest cells (..., 3), -1 outside the box."""
    outside = ((cell < 0) | (cell >= tree.shape)).any(axis=-1)
    i, j, k = np.moveaxis(np.clip(cell, 0, tree.shape - 1), -1, 0)
    return np.where(outside, -1, tree.leaf[i, j, k])


@dataclass(frozen=True, slots=True, eq=False)
class _Links:
    """Pairs of crossed edges on minimal faces: edge keys, half-planes round each edge and leaves (L, 2) each, plane (L,)."""

    edge: Ints
    half_plane: Ints
    cell: Ints
    plane: Ints


def _links(tree: Octree, nodes: _Nodes, field: Field, faces: _Faces) -> _Links:
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
    return _Links(key[f[:, None], slots], half_plane, np.stack([below, above], axis=1), plane)


def _polygons(tree: Octree, nodes: _Nodes, links: _Links) -> Mesh:
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
    for q, (sb, sc) in enumerate(QUADRANTS):
        at = start.copy()
        at[rows, others[:, 0]] -= sb < 0
        at[rows, others[:, 1]] -= sc < 0
        leaf[:, q] = _leaf_at(tree, at)
    for q in range(4):
        beside = np.where(ring_link[:, q] >= 0, ring_link[:, q], ring_link[:, q - 1])
        name = np.where(leaf[:, q] >= 0, leaf[:, q], n_leaves + beside) * n_edges + rows
        known = (leaf[:, q] >= 0) | (beside >= 0)
        corner[known, q] = vertex_of[np.searchsorted(names, name[known])]
    on_box_edge = np.flatnonzero((corner < 0).any(axis=1))
    corner[corner < 0] = n_vertices + np.arange(len(on_box_edge))

    # crossing points, from which vertices start
    upper = start.copy()
    length = _edge_length(nodes, start, axis)
    upper[rows, axis] += length
    f0, f1 = nodes.value(nodes.flat(start)), nodes.value(nodes.flat(upper))
    share, beside = f0 / (f0 - f1), BESIDE[axis]
    off = np.where(share < AT, beside, np.where(share > 1 - AT, 1 - beside, share))
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
    side, corner = _reversed(side, corner, turned)

    ends = np.full((n_sides, 2), -1)
    following = np.where(np.roll(corner, -1, axis=1) < 0, corner[:, :1], np.roll(corner, -1, axis=1))
    q, i = np.nonzero(side >= 0)
    number, first = np.unique(side[q, i], return_index=True)
    ends[number] = np.stack([corner[q, i], following[q, i]], axis=1)[first]
    plane = np.full(n_sides, -1)
    e, k = np.nonzero(along_box)
    # half-plane k is normal to b (k even: it lies along c) or to c; the outer quadrants lie beyond the box's face
    number = n_links + np.arange(len(e))
    plane[number] = _box_plane(tree, start[e], others[e], k)
    size = tree.size[owner][:, None] * tree.step
    return Mesh(vertices, vertices, fixed, owner, size.min(axis=1), corner, side, ends, plane)


def _box_plane(tree: Octree, start: Ints, others: Ints, k: Ints) -> Ints:
    """The face of the box in which the run between outer quadrants k and k + 1 lies."""
    axis = np.where(k % 2 == 1, others[:, 0], others[:, 1])  # half-plane k points straight out of the box: along b or c
    return 2 * axis + (start[np.arange(len(k)), axis] == tree.shape[axis])


def _reversed(side: Ints, corner: Ints, turned: Mask) -> tuple[Ints, Ints]:
    """The polygons run the other way round where `turned`; the first corner stays."""
    three = side[:, 3] < 0
    side, corner = side.copy(), corner.copy()
    quads, triangles = np.flatnonzero(turned & ~three), np.flatnonzero(turned & three)
    corner[quads] = corner[quads][:, [0, 3, 2, 1]]
    side[quads] = side[quads][:, [3, 2, 1, 0]]
    corner[triangles] = corner[triangles][:, [0, 2, 1, 3]]
    side[triangles] = side[triangles][:, [2, 1, 0, 3]]
    return side, corner


def _edge_length(nodes: _Nodes, start: Ints, axis: Ints) -> Ints:
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

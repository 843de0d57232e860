"""Classification of the edges of two networks that cut each other: the pieces of edges inside the other solid.

A hit decides the pieces before and behind it. All pieces that meet in a vertex are on the same side, but for contacts, vertices
that lie on the other network. Components without a hit are told by a ray from one of their points, the edges of a network of its
own.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.orthogonal_projection import project_to_surface
from tpmscad.errors import TrimmingError, format_point
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import line_segment
from tpmscad.trimming.classify.propagation import InsideVotes
from tpmscad.trimming.intersect.edge_face import intersect_edges_with_faces
from tpmscad.trimming.intersect.network_hits import Hits, Network, evaluate_faces, outward_normals
from tpmscad.trimming.operands.edge_uses import evaluate_edges
from tpmscad.trimming.operands.network_tables import (
    are_in_regions,
    find_overlapping_boxes,
    tabulate_faces,
    tabulate_segments,
)
from tpmscad.trimming.operands.patch_polynomials import SENSE, find_starts

RAY_DIRECTIONS = np.array([[0.61, 0.37, 0.70], [-0.43, 0.81, 0.40], [0.29, -0.52, -0.80], [0.05, 0.17, 0.98]])
"""Directions of rays towards the middle of a network, but for signs; tried one after another while a ray touches a face or meets
an edge."""

NEAREST_FACES, NEAREST_CELLS = 64, 8
"""Faces by the distance of their boxes, and cells of them by that of their middles, among which the nearest one is looked for."""

SHORT_RAY_SIZES = 2.0
"""Length of the first ray in each direction, in sizes of a face: the first face that it meets decides, and few faces are near."""

RAY_CLEARANCE = 1e-6
"""Distance, relative to the size of the networks, by which a ray must clear the edges of the faces it pierces."""


@dataclass(frozen=True, slots=True, eq=False)
class EdgeSplits:
    """S points that split edges of a network, by edge and parameter: `edge`, `t`, `vertex` (S,), numbered over both networks.

    `leaves` (S,): 1 if the edge, along its curve, leaves the other solid there, -1 if it enters, 0 if this is not known.
    """

    edge: IntArray
    t: Array
    vertex: IntArray
    leaves: IntArray


def sort_splits(hits: Hits, first_vertex: int, edge: IntArray, t: Array, vertex: IntArray) -> EdgeSplits:
    """The splits at hits, whose vertices are numbered from `first_vertex`, and at other points (n,)."""
    n = len(edge)
    edges, parameters = np.concatenate([hits.edge, edge]), np.concatenate([hits.t, t])
    vertices = np.concatenate([first_vertex + np.arange(len(hits.edge)), vertex])
    leaves = np.concatenate([np.where(hits.leaves, 1, -1), np.zeros(n, np.int64)])
    order = np.lexsort((parameters, edges))
    return EdgeSplits(edges[order], parameters[order], vertices[order], leaves[order])


@dataclass(frozen=True, slots=True, eq=False)
class EdgePieces:
    """M pieces of edges, in the order of edges and parameters: those of edge i are first[i] to first[i + 1] - 1."""

    segment: IntArray
    span: Array
    start: IntArray
    end: IntArray
    first: IntArray


def split_network_edges(network: Network, splits: EdgeSplits, number: IntArray) -> EdgePieces:
    """The network's edges split; number (V,): the numbers of its own vertices over both networks."""
    e = network.brep.edges
    n, edge = len(e), splits.edge
    cuts = np.bincount(edge, minlength=n)
    first = find_starts(cuts + 1)
    owner = np.repeat(np.arange(n), cuts + 1)
    after = np.arange(len(edge)) + 1 + edge  # the piece behind each split
    span = np.empty((len(owner), 2))
    start, end = np.empty(len(owner), np.int64), np.empty(len(owner), np.int64)
    span[first[:-1], 0], span[first[1:] - 1, 1] = e.span.T
    start[first[:-1]], end[first[1:] - 1] = number[e.start], number[e.end]
    span[after, 0], span[after - 1, 1] = splits.t, splits.t
    start[after], end[after - 1] = splits.vertex, splits.vertex
    return EdgePieces(owner, span, start, end, first)


def classify_pieces(
    network: Network, other: Network, splits: EdgeSplits, pieces: EdgePieces, number: IntArray, left_out: IntArray
) -> BoolArray:
    """Pieces of the network's edges inside the other solid (M,); TrimmingError if hits contradict each other.

    number (n,): vertices of the network that do not lie on the other one. left_out: pieces that lie in its faces, not told.
    """
    m = len(pieces.segment)
    piece = np.concatenate([np.arange(m), np.arange(m)])
    vertex = np.concatenate([pieces.start, pieces.end])
    own = np.isin(vertex, number)
    used, item = np.unique(vertex[own], return_inverse=True)
    votes = InsideVotes.of_links(m + len(used), np.column_stack([piece[own], m + item.ravel()]))
    before = pieces.first[splits.edge] + np.arange(len(splits.edge)) - np.searchsorted(splits.edge, splits.edge)
    told = np.flatnonzero(splits.leaves)
    for p, leaves in zip(before[told].tolist(), splits.leaves[told].tolist(), strict=True):
        votes.add(p, leaves > 0)
        votes.add(p + 1, leaves < 0)
    torn = votes.find_contradiction()
    if torn is not None:
        e = int(pieces.segment[torn]) if torn < m else 0
        at = format_point(network.brep.vertices[network.brep.edges.start[e]])
        raise TrimmingError(f"crossings disagree on whether one network near {at} is inside the other")
    undecided = votes.undecided_components()
    if len(undecided):
        first = np.full(len(votes.count), m)
        candidates = np.setdiff1d(np.arange(m), left_out)
        np.minimum.at(first, votes.component[candidates], candidates)
        undecided = undecided[first[undecided] < m]
        one = first[undecided]
        (points,) = evaluate_edges(network.brep, pieces.segment[one], pieces.span[one].mean(axis=1))
        votes.count[undecided, 1] = points_in_network(other, points)
    return votes.inside()[:m]


def points_in_network(network: Network, points: Array) -> BoolArray:
    """Points (n, 3) inside the solid of a network, by the side of the face that a ray from each meets first."""
    result = np.zeros(len(points), bool)
    if not len(points):
        return result
    is_open = np.isfinite(network.covered).all()
    low, high = network.low.min(axis=0), network.high.max(axis=0)
    if is_open:  # points on the other operand are in its box
        low, high = (
            np.minimum(network.covered[0], points.min(axis=0)),
            np.maximum(network.covered[1], points.max(axis=0)),
        )
    left = np.flatnonzero(((points >= low) & (points <= high)).all(axis=1))
    size = float(np.linalg.norm(high - low))
    reach = SHORT_RAY_SIZES * float(np.median((network.high - network.low).max(axis=1)))
    directions = RAY_DIRECTIONS / np.linalg.norm(RAY_DIRECTIONS, axis=1, keepdims=True)
    for direction, is_short in product(directions, (True, False)):
        if not len(left):
            return result
        n = len(left)
        direction = np.copysign(direction, 0.5 * (low + high) - points[left])
        way = np.where(direction > 0, high - points[left], low - points[left]) / direction
        length = way.min(axis=1) + (0.0 if is_open else RAY_CLEARANCE * size)
        if is_short:
            length = np.minimum(length, reach)
        rays = tuple(line_segment(p, p + t * d) for p, t, d in zip(points[left], length, direction, strict=True))
        edges = tabulate_segments(rays, np.arange(n), Motion.identity(n), np.tile([0.0, 1.0], (n, 1)))
        near = np.unique(find_overlapping_boxes(edges.low, edges.high, network.low, network.high, 0.0)[:, 1])
        faces = tabulate_faces(network.brep, near)
        pairs = find_overlapping_boxes(edges.low, edges.high, faces.low, faces.high, 0.0)
        hits = intersect_edges_with_faces(edges, faces, pairs)
        ray, face = pairs[hits.pair, 0], pairs[hits.pair, 1]
        uv = np.ascontiguousarray(hits.uv)
        inside = are_in_regions(faces.regions, face, uv)
        doubtful = np.zeros(len(ray), bool)
        for step in (-1.0, 1.0):  # a crossing next to a loop is one of the face beside as well, or of neither
            for axis in (0, 1):
                moved = uv.copy()
                moved[:, axis] += step * RAY_CLEARANCE * size
                doubtful |= are_in_regions(faces.regions, face, moved) != inside
        rows = np.flatnonzero(inside | doubtful)
        rows = rows[np.lexsort((hits.t[rows], ray[rows]))]
        met, first = np.unique(ray[rows], return_index=True)
        nearest = rows[first]
        rise = np.einsum("nd,nd->n", outward_normals(faces, face[nearest], uv[nearest]), direction[met])
        result[left[met]] = rise > 0
        undecided = np.full(n, is_open or is_short)
        undecided[met] = doubtful[nearest]
        undecided[pairs[hits.touching_pair, 0]] = True
        left = left[undecided]
    if len(left) and not is_open:
        raise TrimmingError(
            f"whether {format_point(points[left[0]])} is inside a network could not be told by rays from it"
        )
    for i in left.tolist():
        result[i] = _is_behind_nearest_face(network, points[i])
    return result


def _is_behind_nearest_face(network: Network, point: Array) -> bool:
    """Whether a point (3,) lies on the inner side of the face nearest to it, which decides where no ray meets one."""
    gap = np.maximum(np.maximum(network.low - point, point - network.high), 0.0)
    near = np.sort(np.argsort(np.linalg.norm(gap, axis=1))[:NEAREST_FACES])
    faces = tabulate_faces(network.brep, near)
    owner = np.repeat(np.arange(len(faces.low)), np.diff(faces.cells.first))
    first = np.argsort(np.linalg.norm(faces.cells.centre - point, axis=1))[:NEAREST_CELLS]
    best, inside = np.inf, False
    for cell in first.tolist():
        f = np.array([owner[cell]])
        own = slice(faces.cells.first[f[0]], faces.cells.first[f[0] + 1])
        low = (faces.cells.middle[own] - faces.cells.half[own]).min(axis=0)
        high = (faces.cells.middle[own] + faces.cells.half[own]).max(axis=0)

        def jet(u: Array, v: Array, rows: IntArray, f: IntArray = f) -> tuple[Array, ...]:
            found = evaluate_faces(faces.patches, f[rows * 0], np.column_stack([u, v]))
            return found[:, 0], found[:, 1], found[:, 2]

        start = faces.cells.middle[[cell]]
        u, v = project_to_surface(jet, point[None], start[:, 0], start[:, 1], np.column_stack([low, high]).tolist())
        foot, along_u, along_v = (column[0] for column in jet(u, v, np.zeros(1, np.int64)))
        distance = float(np.linalg.norm(point - foot))
        if distance < best:
            best = distance
            inside = bool(faces.patches.layout[f[0], SENSE] * np.cross(along_u, along_v) @ (point - foot) < 0)
    return inside

"""The points in which the edges of one network pierce the faces of another: where the networks' common curves begin and end.

A hit is a vertex of both networks. The edge has two faces, and in each of them one curve begins or ends at the hit: of each pair
of faces, then, as many curves begin as end. A hit next to a vertex, or next to an edge of the other network, is refused, for
the order of what meets there is round-off: another placement resolves it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, TrimmingError, format_point
from tpmscad.trimming.intersect.edge_face import intersect_edges_with_faces
from tpmscad.trimming.operands.edge_uses import UseSegments, divide_uses, evaluate_edges, evaluate_use_parameters
from tpmscad.trimming.operands.network_tables import (
    NetworkEdges,
    NetworkFaces,
    bound_faces,
    find_overlapping_boxes,
    is_in_region,
    tabulate_edges,
    tabulate_faces,
)
from tpmscad.trimming.operands.patch_polynomials import SENSE, PatchPolynomials, evaluate_face

EVERYWHERE = np.array([[-np.inf] * 3, [np.inf] * 3])
"""What a closed network covers."""

SNAP_TOLS = 2.0
"""Distance in tolerances of a hit from a vertex or an edge below which it is refused: kernels take both for one point."""

CELL_FRACTION = 0.5
"""Length of the cells of large faces, in sizes of the other network's faces."""

POLYGON_DOUBT = 0.1
"""Distance from a polygon's segment, in lengths of it, below which the loop itself decides on which side a point is: a segment
of a quarter circle divided by `SEGMENTS_PER_USE` bulges by an 80th part of that."""

MIN_GRAZING_SINE = 1e-6
"""Sine of the angle between a curve and the edge it ends at, below which the side it goes to is round-off."""

NEAREST_STEPS = 20
"""Newton steps to the nearest point of a loop."""

SLOPE_STEP = 1e-5
"""Step, relative to the span of an edge, of the central differences for the direction of a loop."""


@dataclass(frozen=True, slots=True, eq=False)
class Network:
    """An operand: its boundary representation, and tables of the faces and edges near the other operand.

    `uses` (E, 2): the edge uses of each edge, -1 for a second one that an open edge lacks.
    `low`, `high` (F, 3): corners of boxes that contain the faces. `segments`: of the loops of the faces in the tables. `covered`
    (2, 3): the corners of the vertices' box of the other operand, beyond which faces may be missing, infinite if they close.
    """

    brep: Brep
    faces: NetworkFaces
    edges: NetworkEdges
    uses: IntArray
    low: Array
    high: Array
    segments: UseSegments
    covered: Array


@dataclass(frozen=True, slots=True, eq=False)
class Hits:
    """H points in which edges of one network pierce faces of the other, by edge and parameter.

    `edge`, `t`: on the one; `face`, `uv` (H, 2): on the other; `point` (H, 3); `leaves` (H,): whether the edge, in the direction
    of its curve, leaves the other solid there.
    """

    edge: IntArray
    t: Array
    face: IntArray
    uv: Array
    point: Array
    leaves: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class CurveEnds:
    """E ends of curves, by pair of faces: those of pair k are `start[k]` to `start[k + 1] - 1`.

    `pairs` (n, 2): faces of the first and the second network. `parameters` (E, 4): on both faces. `enters` (E,): whether a
    curve begins there, directed so that the second solid is on its left, seen from outside on the first network. `vertex`
    (E,): numbered over those of the first network, the second's, the hits of the first one's edges, then those of the second's.
    """

    pairs: IntArray
    start: IntArray
    parameters: Array
    enters: BoolArray
    vertex: IntArray


def prepare_networks(first: Brep, second: Brep, margin: float, *, is_cover: bool = False) -> tuple[Network, Network]:
    """The operands of a cut, with tables of what comes nearer to the other operand than `margin`, model units.

    is_cover: whether the second one may be open, where it then covers the box of the first.
    InvalidRequest if an operand is not closed that must be.
    """
    boxes = bound_faces(first), bound_faces(second)
    pairs = find_overlapping_boxes(*boxes[0], *boxes[1], margin)
    covered = np.stack([first.vertices.min(axis=0), first.vertices.max(axis=0)])
    sizes = [CELL_FRACTION * float(np.median(np.max(high - low, axis=1))) for low, high in boxes]
    one = _prepare(first, np.unique(pairs[:, 0]), boxes[0], EVERYWHERE, sizes[1])
    return one, _prepare(second, np.unique(pairs[:, 1]), boxes[1], covered if is_cover else EVERYWHERE, sizes[0])


def _prepare(brep: Brep, near: IntArray, boxes: tuple[Array, Array], covered: Array, cell_size: float) -> Network:
    """An operand with tables of the faces `near` (n,) and their edges."""
    count = np.bincount(brep.uses.edge, minlength=len(brep.edges))
    unmatched = connectivity.find_unmatched_edges(brep)
    if not (count == 1).any():
        covered = EVERYWHERE
    if np.isfinite(covered).all():
        unmatched = unmatched[count[unmatched] != 1]
    if len(unmatched):
        at = format_point(brep.vertices[brep.edges.start[unmatched[0]]])
        raise InvalidRequest(
            f"{len(unmatched)} edges do not join two faces, the first at {at}: only closed networks can be cut"
        )
    first_use = np.argsort(brep.uses.edge, kind="stable")
    uses = np.full((len(brep.edges), 2), -1)
    start = np.cumsum(count) - count
    for column in (0, 1):
        rows = np.flatnonzero(count > column)
        uses[rows, column] = first_use[start[rows] + column]
    edges = np.unique(brep.uses.edge[np.isin(brep.face_of_use, near)])
    return Network(
        brep,
        tabulate_faces(brep, near, cell_size),
        tabulate_edges(brep, edges),
        uses,
        *boxes,
        divide_uses(brep, near),
        covered,
    )


@dataclass(frozen=True, slots=True, eq=False)
class Piercings:
    """P points in which edges of one network pierce the surfaces of the other's faces, columns as in `Hits`.

    `inside` (P,): in the face's loops, at the distance `border` (P,) from them, model units; `slope` (P, 3): of the edge.
    """

    edge: IntArray
    t: Array
    face: IntArray
    uv: Array
    point: Array
    slope: Array
    inside: BoolArray
    border: Array


def find_piercings(one: Network, other: Network, tol: float, left_out: IntArray) -> Piercings:
    """The points in which the edges of one network pierce the surfaces of the other's faces.

    left_out (n, 2): edges and faces that are not asked, since they lie in one plane. TrimmingError if an edge touches a face.
    """
    edges, faces = one.edges, other.faces
    pairs = find_overlapping_boxes(edges.low, edges.high, faces.low, faces.high, SNAP_TOLS * tol)
    n_faces = len(other.brep.faces)
    pairs = np.ascontiguousarray(pairs[~np.isin(pairs @ [n_faces, 1], left_out @ [n_faces, 1])])
    found = intersect_edges_with_faces(edges, faces, pairs)
    edge, face = pairs[found.pair, 0], pairs[found.pair, 1]
    if len(found.touching):
        at = format_point(found.touching[0])
        raise TrimmingError(f"an edge of one network touches a face of the other, or lies in it, at {at}")
    inside, border = locate_in_faces(other, face, found.uv)
    point, slope = evaluate_edges(one.brep, edge, found.t, (0, 1))
    return Piercings(edge, found.t, face, found.uv, point, slope, inside, border)


def select_hits(one: Network, other: Network, found: Piercings, resolved: BoolArray, tol: float) -> Hits:
    """The hits among piercings, without those (P,) that are resolved otherwise.

    TrimmingError if one of them lies next to a vertex or an edge.
    """
    e, snap = one.brep.edges, SNAP_TOLS * tol
    near = ~resolved & (found.border < snap)
    if near.any():
        at = format_point(found.point[np.flatnonzero(near)[0]])
        raise TrimmingError(f"an edge of one network meets an edge of the other within {snap:.2g} at {at}")
    inside = found.inside & ~resolved
    ends = one.brep.vertices[np.column_stack([e.start[found.edge], e.end[found.edge]])]
    near = inside & (np.linalg.norm(ends - found.point[:, None], axis=2) < snap).any(axis=1)
    if near.any():
        at = format_point(found.point[np.flatnonzero(near)[0]])
        raise TrimmingError(f"a vertex of one network lies within {snap:.2g} of a face of the other at {at}")
    span = e.span[found.edge]
    rows = np.flatnonzero(inside & (found.t > span[:, 0]) & (found.t < span[:, 1]))
    rows = rows[np.lexsort((found.t[rows], found.edge[rows]))]
    face, uv = found.face[rows], found.uv[rows]
    leaves = np.einsum("nk,nk->n", outward_normals(other.faces, face, uv), found.slope[rows]) > 0
    return Hits(found.edge[rows], found.t[rows], face, uv, found.point[rows], leaves)


def outward_normals(faces: NetworkFaces, face: IntArray, uv: Array) -> Array:
    """Normals (n, 3) out of the solid, not normalised."""
    jets = evaluate_faces(faces.patches, face, uv)
    return faces.patches.layout[face, SENSE][:, None] * np.cross(jets[:, 1], jets[:, 2])


@njit_cached
def evaluate_faces(patches: PatchPolynomials, face: IntArray, uv: Array) -> Array:  # pragma: no cover - compiled
    """S, S_u and S_v (n, 3, 3) of the faces (n,) named at (u, v) (n, 2)."""
    result = np.empty((len(face), 3, 3))
    for i in range(len(face)):
        evaluate_face(patches, face[i], uv[i, 0], uv[i, 1], result[i])
    return result


@njit_cached
def _locate_in_polygons(faces: NetworkFaces, face: IntArray, uv: Array) -> tuple[BoolArray, IntArray, Array]:
    """Of points (n, 2): whether they lie in the polygons, the nearest segment, and its distance in units of its length."""
    n = len(face)
    inside, nearest, fraction = np.empty(n, np.bool_), np.empty(n, np.int64), np.empty((n, 2))
    jet = np.empty((3, 3))
    for i in range(n):
        f = face[i]
        inside[i] = is_in_region(faces.regions, f, uv[i, 0], uv[i, 1])
        evaluate_face(faces.patches, f, uv[i, 0], uv[i, 1], jet)
        best = np.inf
        for k in range(faces.regions.first[f], faces.regions.first[f + 1]):
            du = faces.regions.segments[k, 1, 0] - faces.regions.segments[k, 0, 0]
            dv = faces.regions.segments[k, 1, 1] - faces.regions.segments[k, 0, 1]
            au, av = uv[i, 0] - faces.regions.segments[k, 0, 0], uv[i, 1] - faces.regions.segments[k, 0, 1]
            # lengths in space, by the first fundamental form at the point
            along, square = 0.0, 0.0
            for d in range(3):
                t = jet[1, d] * du + jet[2, d] * dv
                a = jet[1, d] * au + jet[2, d] * av
                along += t * a
                square += t * t
            x = min(max(along / max(square, 1e-300), 0.0), 1.0)
            apart = 0.0
            for d in range(3):
                apart += (jet[1, d] * (au - x * du) + jet[2, d] * (av - x * dv)) ** 2
            if apart < best:
                best = apart
                nearest[i] = k
                fraction[i, 0], fraction[i, 1] = np.sqrt(apart), np.sqrt(square)
    return inside, nearest, fraction


def locate_in_faces(network: Network, face: IntArray, uv: Array) -> tuple[BoolArray, Array]:
    """Whether points (n, 2) lie in the loops of faces (n,), and their distances from the loops in space, to first order."""
    faces, brep = network.faces, network.brep
    inside, nearest, apart = _locate_in_polygons(faces, face, uv)
    distance = apart[:, 0].copy()
    use, begin, length = network.segments
    doubtful = np.flatnonzero((apart[:, 0] < POLYGON_DOUBT * apart[:, 1]) & (length[nearest] < 1.0))
    if not len(doubtful):
        return inside, distance
    segment = nearest[doubtful]
    k, uv = use[segment], uv[doubtful]
    metric = evaluate_faces(faces.patches, face[doubtful], np.ascontiguousarray(uv))[:, 1:]
    sense = brep.uses.sense[k]
    low, high = brep.edges.span[brep.uses.edge[k]].T
    x = begin[segment] + 0.5 * length[segment]
    t, step = low + (high - low) * np.where(sense > 0, x, 1.0 - x), SLOPE_STEP * (high - low)
    slope, moving = np.empty((len(k), 2)), np.arange(len(k))
    for _ in range(NEAREST_STEPS):
        own, h = k[moving], step[moving]
        at, before, after = (evaluate_use_parameters(brep, own, t[moving] + d * h) for d in (0.0, -1.0, 1.0))
        slope[moving] = (after - before) / (2 * h)[:, None]
        along, arm = (np.einsum("nd,ndx->nx", d, metric[moving]) for d in (slope[moving], at - uv[moving]))
        change = np.einsum("nx,nx->n", arm, along) / np.einsum("nx,nx->n", along, along)
        t[moving] = np.clip(t[moving] - change, low[moving], high[moving])
        moving = moving[np.abs(change) >= h**2]
        if not len(moving):
            break
    within = np.flatnonzero((low < t) & (t < high))  # else the nearest point is a vertex, which polygons hold exactly
    arm = uv[within] - evaluate_use_parameters(brep, k[within], t[within])
    slope = slope[within]
    inside[doubtful[within]] = sense[within] * (slope[:, 0] * arm[:, 1] - slope[:, 1] * arm[:, 0]) > 0
    distance[doubtful[within]] = np.linalg.norm(np.einsum("nd,ndx->nx", arm, metric[within]), axis=1)
    return inside, distance


class EndRows(NamedTuple):
    """Ends of curves in any order: faces (E,), (u, v) (E, 2) on both, whether a curve begins (E,), and vertices (E,)."""

    first: IntArray
    second: IntArray
    on_first: Array
    on_second: Array
    enters: BoolArray
    vertex: IntArray


def collect_curve_ends(
    first: Network, second: Network, hits: tuple[Hits, Hits], at_contacts: EndRows, tol: float
) -> CurveEnds:
    """The ends of curves at all hits and at contacts, and all pairs of faces whose boxes overlap."""
    parts = [at_contacts]
    offset = len(first.brep.vertices) + len(second.brep.vertices)
    for side, (one, other, own) in enumerate(((first, second, hits[0]), (second, first, hits[1]))):
        n = len(own.edge)
        for column in (0, 1):
            use = one.uses[own.edge, column]
            if not n:
                continue
            if (use < 0).any():
                at = format_point(own.point[np.flatnonzero(use < 0)[0]])
                raise TrimmingError(f"a network that should cover another one ends inside it at {at}")
            face = one.brep.face_of_use[use]
            uv = evaluate_use_parameters(one.brep, use, own.t)
            jet, opposite = (
                evaluate_faces(one.faces.patches, face, uv),
                evaluate_faces(other.faces.patches, own.face, own.uv),
            )
            mine, theirs = np.cross(jet[:, 1], jet[:, 2]), np.cross(opposite[:, 1], opposite[:, 2])
            along = np.cross(mine, theirs) * (one.brep.faces.sense[face] * other.brep.faces.sense[own.face])[:, None]
            along *= 1 if side == 0 else -1
            slope = evaluate_edges(one.brep, own.edge, own.t, (1,))[0] * one.brep.uses.sense[use][:, None]
            into = np.cross(mine, slope)
            turn = np.einsum("nk,nk->n", along, into)
            sine = np.abs(turn) / (np.linalg.norm(along, axis=1) * np.linalg.norm(into, axis=1))
            if not (sine > MIN_GRAZING_SINE).all():
                at = format_point(own.point[np.flatnonzero(~(sine > MIN_GRAZING_SINE))[0]])
                raise TrimmingError(f"a common curve of two networks runs along an edge at {at}")
            enters, vertex = turn > 0, offset + np.arange(n)
            if side == 0:
                parts.append(EndRows(face, own.face, uv, own.uv, enters, vertex))
            else:
                parts.append(EndRows(own.face, face, own.uv, uv, enters, vertex))
        offset += n
    boxes = (first.faces.low, first.faces.high, second.faces.low, second.faces.high)
    pairs = find_overlapping_boxes(*boxes, SNAP_TOLS * tol)
    f, g, uv, sr, enters, vertex = (np.concatenate(column) for column in zip(*parts, strict=True))
    n_second = len(second.brep.faces)
    key, keys = f * n_second + g, pairs[:, 0] * n_second + pairs[:, 1]
    row = np.searchsorted(keys, key)
    if len(key) and not np.array_equal(keys[np.minimum(row, len(keys) - 1)], key):
        raise TrimmingError("an edge pierces a face whose box its own faces do not meet")
    order = np.argsort(row, kind="stable")
    start = np.searchsorted(row[order], np.arange(len(pairs) + 1))
    parameters = np.ascontiguousarray(np.concatenate([uv, sr], axis=1)[order])
    return CurveEnds(pairs, start.astype(np.int64), parameters, enters[order], vertex[order])

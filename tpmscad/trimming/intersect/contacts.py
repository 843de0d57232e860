"""Coincidences of the second network with planes of the first: its vertices and edges that lie on these, resolved exactly.

Lattices are often cut where their symmetry is: a plane of the body passes through corners of patches, holds sides of them, or
its border crosses an edge. A *contact* is such a vertex of the second network on a face, an edge or a vertex of the first one, or
a point in which edges of both cross. It is a vertex of both networks. The faces round it are sectors of their tangent planes
there; where the line of two planes runs into the sectors of both faces, a common curve of the faces begins or ends. An edge that
lies in a face is a common curve itself: each face beside it is inside or outside.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import TrimmingError, format_point
from tpmscad.index_ranges import list_preceding, repeat_rows
from tpmscad.splines.bspline import is_segment
from tpmscad.trimming.intersect.network_hits import (
    SNAP_TOLS,
    EndRows,
    Network,
    Piercings,
    evaluate_faces,
    locate_in_faces,
)
from tpmscad.trimming.operands.edge_uses import evaluate_edges, evaluate_use_parameters, project_onto_planes
from tpmscad.trimming.operands.patch_polynomials import PLANAR, SENSE

MIN_SINE = 1e-6
"""Sine of an angle below which two directions are one, or a direction lies in a plane."""

CONTACT_SNAPS = 4.0
"""Distance from a contact, in snapping distances, within which the piercings of its edges are found."""

MIN_APART_COSINE = 0.999
"""Cosine of the angle within which a curve of two faces is the edge that lies in one of them: beside corners at which patches are
singular, normals are inaccurate."""

PATH_FRACTIONS = np.linspace(0.0, 1.0, 17)
"""Fractions of an edge at which it is sampled as a curve of two faces."""

EDGE_FRACTIONS = np.array([0.0, 0.21, 0.5, 0.83, 1.0])
"""Fractions of an edge at which it must lie in a plane, to lie in it."""


@dataclass(frozen=True, slots=True, eq=False)
class Contacts:
    """C contacts, and the edges of the second network that lie in planes of the first.

    `point` (C, 3). On the second network `vertex` (C,), or -1 where an edge crosses at `edge`, `t` (C,). On the first network
    `first_vertex` (C,), or `first_edge`, `first_t` (C,), each -1 elsewhere; `faces`: the faces there. `coplanar` (n, 2): edges
    of the second network, and faces of the first one in whose planes they lie.
    """

    point: Array
    vertex: IntArray
    edge: IntArray
    t: Array
    first_vertex: IntArray
    first_edge: IntArray
    first_t: Array
    faces: tuple[tuple[int, ...], ...]
    coplanar: IntArray

    def __len__(self) -> int:
        return len(self.point)


@dataclass(frozen=True, slots=True, eq=False)
class _Sectors(ArrayTable):
    """S sectors of faces round points: from direction `start` counter-clockwise about `normal` to `end`, NaN for all of a plane.

    `owner` (S,): the number of the point. `face` (S,); `outward` (S, 3): the normal out of the solid; `uv` (S, 2): the point on
    the face; `edges` (S, 2): those in the directions start and end.
    """

    owner: IntArray
    face: IntArray
    normal: Array
    outward: Array
    uv: Array
    start: Array
    end: Array
    edges: IntArray

    def locate(self, direction: Array) -> IntArray:
        """Of directions (S, 3) in the tangent planes: 1 within the sector, 0 along a side of it, -1 beyond."""
        angle, whole = (
            np.arctan2(_dot(self.normal, np.cross(self.start, d)), _dot(self.start, d)) % (2 * np.pi)
            for d in (direction, self.end)
        )
        beside = (np.minimum(angle, 2 * np.pi - angle) < MIN_SINE) | (np.abs(angle - whole) < MIN_SINE)
        return np.where(np.isnan(whole), 1, np.where(beside, 0, np.where(angle < whole, 1, -1)))


def _dot(a: Array, b: Array) -> Array:
    """Scalar products (n,) of vectors (n, 3)."""
    return np.asarray(np.einsum("nd,nd->n", a, b))


def find_coplanar_edges(first: Network, second: Network, tol: float) -> IntArray:
    """Edges of the second network, and planar faces of the first in whose planes they lie: (n, 2)."""
    e, snap = second.brep.edges, SNAP_TOLS * tol
    near = np.flatnonzero(np.diff(second.edges.first_piece))
    found = [np.zeros((0, 2), np.int64)]
    ends = second.brep.vertices[np.column_stack([e.start[near], e.end[near]])]
    for g in _planar_faces(first):
        origin, normal = _plane_of(first.brep, g)
        rows = near[(np.abs((ends - origin) @ normal) < snap).all(axis=1)]
        if len(rows):
            points = _sample_edges(second.brep, rows, EDGE_FRACTIONS)[0]
            rows = rows[(np.abs((points - origin) @ normal) < snap).all(axis=1)]
            found.append(np.column_stack([rows, np.full(len(rows), g)]))
    return np.concatenate(found)


def find_contacts(first: Network, second: Network, piercings: Piercings, coplanar: IntArray, tol: float) -> Contacts:
    """All contacts; `piercings`: of the second network's edges with the first one's faces.

    TrimmingError where one lies on a curved edge.
    """
    snap = SNAP_TOLS * tol
    e, vertices = second.brep.edges, second.brep.vertices
    near = np.flatnonzero(np.diff(second.edges.first_piece))
    used = np.unique(np.concatenate([e.start[near], e.end[near]]))
    rows: list[tuple[Array, int, int, float, int]] = []
    for g in _planar_faces(first):
        origin, normal = _plane_of(first.brep, g)
        own = used[np.abs((vertices[used] - origin) @ normal) < snap]
        rows += [(vertices[v], int(v), -1, 0.0, g) for v in own.tolist()]
    found = piercings
    planar = first.faces.patches.layout[found.face, PLANAR] == 1
    ends = vertices[np.column_stack([e.start[found.edge], e.end[found.edge]])]
    inner = (np.linalg.norm(ends - found.point[:, None], axis=2) >= snap).all(axis=1)
    for i in np.flatnonzero(planar & inner & (found.border < snap)).tolist():
        rows.append((found.point[i], -1, int(found.edge[i]), float(found.t[i]), int(found.face[i])))
    none = np.zeros(0, np.int64)
    nothing = Contacts(np.zeros((0, 3)), none, none, np.zeros(0), none, none, np.zeros(0), (), coplanar)
    if not rows:
        return nothing
    points = np.array([row[0] for row in rows])
    face = np.array([row[4] for row in rows])
    uv = project_onto_planes(first.brep, face, points)
    inside, border = locate_in_faces(first, face, uv)
    made: list[tuple[Array, int, int, float, int, int, float, tuple[int, ...]]] = []
    known: dict[tuple[int, int], list[int]] = {}
    for i in np.flatnonzero(inside | (border < snap)).tolist():
        point, vertex, edge, t, g = rows[i]
        place = (-1, -1, 0.0, (g,)) if border[i] >= snap else _find_on_border(first.brep, g, point, snap)
        of_own = known.setdefault((vertex, edge), [])
        same = [k for k in of_own if np.linalg.norm(made[k][0] - point) < CONTACT_SNAPS * snap]
        if not same:
            of_own.append(len(made))
            made.append((point, vertex, edge, t, *place))
        elif len(place[3]) > len(made[same[0]][7]):
            made[same[0]] = (point, vertex, edge, t, *place)
    if not made:
        return nothing
    point, vertex, edge, t, on_vertex, on_edge, on_t, faces = zip(*made, strict=True)
    return Contacts(
        np.array(point),
        np.array(vertex),
        np.array(edge),
        np.array(t, float),
        np.array(on_vertex),
        np.array(on_edge),
        np.array(on_t, float),
        faces,
        coplanar,
    )


def find_resolved(
    first: Network, second: Network, piercings: tuple[Piercings, Piercings], contacts: Contacts, tol: float
) -> tuple[BoolArray, BoolArray]:
    """The piercings of the first network's edges, and of the second's, that contacts stand for: (P,), (Q,)."""
    of_first, of_second = piercings
    result = np.zeros(len(of_first.edge), bool), np.zeros(len(of_second.edge), bool)
    if not len(contacts):
        return result
    tree, reach = cKDTree(contacts.point), CONTACT_SNAPS * SNAP_TOLS * tol
    e = first.brep.edges
    for i, near in enumerate(tree.query_ball_point(of_first.point, reach)):
        edge = int(of_first.edge[i])
        ends = int(e.start[edge]), int(e.end[edge])
        result[0][i] = any(contacts.first_edge[c] == edge or contacts.first_vertex[c] in ends for c in near)
    e = second.brep.edges
    for i, near in enumerate(tree.query_ball_point(of_second.point, reach)):
        edge, face = int(of_second.edge[i]), int(of_second.face[i])
        ends = int(e.start[edge]), int(e.end[edge])
        result[1][i] = any(
            (contacts.edge[c] == edge or contacts.vertex[c] in ends) and face in contacts.faces[c] for c in near
        )
    return result


def _planar_faces(network: Network) -> list[int]:
    """The planar faces that are in the tables."""
    near = np.diff(network.faces.cells.first) > 0
    return np.flatnonzero(near & (network.faces.patches.layout[:, PLANAR] == 1)).tolist()


def _plane_of(brep: Brep, face: int) -> tuple[Array, Array]:
    """A point of a planar face, and its normal out of the solid."""
    carrier = brep.carriers[brep.faces.carrier[face]]
    motion = brep.faces.motion[face]
    return motion.apply(carrier.origin), motion.apply_to_vectors(brep.faces.sense[face] * carrier.normal)


def _find_on_border(brep: Brep, face: int, point: Array, snap: float) -> tuple[int, int, float, tuple[int, ...]]:
    """The vertex, or the straight edge and the parameter on it, of a face's border where a point lies, and the faces there."""
    faces, uses, e = brep.faces, brep.uses, brep.edges
    own = np.arange(faces.use_start[faces.loop_start[face]], faces.use_start[faces.loop_start[face + 1]])
    face_of_use = brep.face_of_use
    edges = np.unique(uses.edge[own])
    for w in np.unique(np.concatenate([e.start[edges], e.end[edges]])).tolist():
        if np.linalg.norm(brep.vertices[w] - point) < snap:
            there = (e.start[uses.edge] == w) | (e.end[uses.edge] == w)
            return w, -1, 0.0, tuple(np.unique(face_of_use[there]).tolist())
    for k in edges.tolist():
        a, b = brep.vertices[e.start[k]], brep.vertices[e.end[k]]
        if not is_segment(brep.curves[e.curve[k]]):
            continue
        x = float((point - a) @ (b - a) / ((b - a) @ (b - a)))
        if 0.0 < x < 1.0 and np.linalg.norm(a + x * (b - a) - point) < 2 * snap:
            low, high = e.span[k]
            return -1, k, float(low + x * (high - low)), tuple(np.unique(face_of_use[uses.edge == k]).tolist())
    raise TrimmingError(f"an edge of one network meets an edge of the other within {snap:.2g} at {format_point(point)}")


def collect_contact_ends(first: Network, second: Network, contacts: Contacts, number: IntArray) -> EndRows:
    """The ends of curves at contacts, whose vertices have the numbers (C,).

    TrimmingError where faces are tangent, or a curve runs along an edge that does not lie in the face.
    """
    at_vertex, at_edge = contacts.vertex >= 0, contacts.vertex < 0
    theirs = _Sectors.concatenate(
        [
            _sectors_at_vertices(second, np.flatnonzero(at_vertex), contacts.vertex[at_vertex]),
            _sectors_at_edges(second, np.flatnonzero(at_edge), contacts.edge[at_edge], contacts.t[at_edge]),
        ]
    )
    at_vertex, at_edge = contacts.first_vertex >= 0, contacts.first_edge >= 0
    in_face = ~(at_vertex | at_edge)
    ours = _Sectors.concatenate(
        [
            _sectors_at_vertices(first, np.flatnonzero(at_vertex), contacts.first_vertex[at_vertex]),
            _sectors_at_edges(first, np.flatnonzero(at_edge), contacts.first_edge[at_edge], contacts.first_t[at_edge]),
            _sectors_in_faces(first, np.flatnonzero(in_face), contacts),
        ]
    )
    count = np.bincount(ours.owner, minlength=len(contacts))
    order, begin = np.argsort(ours.owner, kind="stable"), np.cumsum(count) - count
    row, step = repeat_rows(count[theirs.owner])
    f, g = theirs[row], ours[order[begin[theirs.owner[row]] + step]]
    along = np.cross(g.outward, f.outward)
    length = np.linalg.norm(along, axis=1)
    if (length < MIN_SINE).any():
        at = format_point(contacts.point[f.owner[np.argmin(length)]])
        raise TrimmingError(f"two faces are tangent where they meet near {at}")
    factors = np.array([len(first.brep.faces), 1])
    lies = [np.isin(f.edges[:, i] * factors[0] + g.face, contacts.coplanar @ factors) for i in (0, 1)]
    found = []
    for sign in (1.0, -1.0):
        direction = sign * along / length[:, None]
        runs_along = [
            own & (_dot(side, direction) > MIN_APART_COSINE) for own, side in zip(lies, (f.start, f.end), strict=True)
        ]
        on_theirs, on_ours = f.locate(direction), g.locate(direction)
        meets = (on_theirs >= 0) & (on_ours >= 0) & ~(runs_along[0] | runs_along[1])
        unclear = meets & ((on_theirs == 0) | (on_ours == 0))
        if unclear.any():
            at = format_point(contacts.point[f.owner[np.argmax(unclear)]])
            raise TrimmingError(f"a common curve of two networks runs along an edge at {at}")
        found.append(np.flatnonzero(meets))
    rows, enters = np.concatenate(found), np.repeat([True, False], [len(own) for own in found])
    f, g = f[rows], g[rows]
    return EndRows(g.face, f.face, g.uv, f.uv, enters, number[f.owner])


def _sample_edges(brep: Brep, edges: IntArray, fractions: Array) -> tuple[Array, Array, Array]:
    """Points and derivatives (n, m, 3) of edges (n,) at fractions (m,) of their spans, and the parameters (n, m)."""
    low, high = brep.edges.span[edges].T
    t = low[:, None] + (high - low)[:, None] * fractions
    found = evaluate_edges(brep, np.repeat(edges, len(fractions)), t.ravel(), (0, 1))
    points, slope = (values.reshape(len(edges), len(fractions), 3) for values in found)
    return points, slope, t


def sample_edges_in_planes(first: Network, second: Network, coplanar: IntArray) -> tuple[IntArray, Array]:
    """Pairs of faces (n, 2) that have an edge of the second one in common, in the plane of the first, and its points (n, m, 10).

    coplanar: as in `Contacts`. Columns of points: position, (u, v) on both faces, unit tangent.
    """
    brep = second.brep
    edge, g = np.repeat(coplanar, 2, axis=0).T
    use = second.uses[coplanar[:, 0]].ravel()
    edge, g, use = edge[use >= 0], g[use >= 0], use[use >= 0]
    n, m = len(use), len(PATH_FRACTIONS)
    if not n:
        return np.zeros((0, 2), np.int64), np.zeros((0, m, 10))
    points, slope, t = _sample_edges(brep, edge, PATH_FRACTIONS)
    points, slope, t = points.reshape(-1, 3), slope.reshape(-1, 3), t.ravel()
    on_first = project_onto_planes(first.brep, np.repeat(g, m), points)
    on_second = evaluate_use_parameters(brep, np.repeat(use, m), t)
    tangent = slope / np.linalg.norm(slope, axis=1, keepdims=True)
    paths = np.concatenate([points, on_first, on_second, tangent], axis=1).reshape(n, m, 10)
    return np.column_stack([g, brep.face_of_use[use]]), paths


def _sectors_at_vertices(network: Network, owner: IntArray, vertex: IntArray) -> _Sectors:
    """The sectors of the faces round vertices (n,); owner (n,): the numbers of these points."""
    uses, e = network.brep.uses, network.brep.edges
    ahead = uses.sense > 0
    begins = np.where(ahead, e.start[uses.edge], e.end[uses.edge])
    order = np.argsort(begins, kind="stable")
    low, high = np.searchsorted(begins[order], np.stack([vertex, vertex + 1]))
    row, step = repeat_rows(high - low)
    use = order[low[row] + step]
    arrived = list_preceding(network.brep.faces.use_start)[use]
    span = e.span[uses.edge]
    t, last = np.where(ahead, span[:, 0], span[:, 1])[use], np.where(ahead, span[:, 1], span[:, 0])[arrived]
    edges = np.column_stack([uses.edge[use], uses.edge[arrived]])
    sides = _directions(network.brep, use, t), -_directions(network.brep, arrived, last)
    return _make_sectors(network, owner[row], use, t, *sides, edges)


def _sectors_at_edges(network: Network, owner: IntArray, edge: IntArray, t: Array) -> _Sectors:
    """The half planes of the faces beside edges (n,) at parameters of them (n,)."""
    use = network.uses[edge].ravel()
    row = np.repeat(np.arange(len(edge)), 2)[use >= 0]
    use = use[use >= 0]
    ahead = _directions(network.brep, use, t[row])
    edges = np.column_stack([edge[row], edge[row]])
    return _make_sectors(network, owner[row], use, t[row], ahead, -ahead, edges)


def _sectors_in_faces(network: Network, owner: IntArray, contacts: Contacts) -> _Sectors:
    """All directions on planar faces about contacts in them."""
    face = np.array([contacts.faces[c][0] for c in owner.tolist()], np.int64)
    outward = np.array([_plane_of(network.brep, g)[1] for g in face.tolist()]).reshape(-1, 3)
    uv, nothing = project_onto_planes(network.brep, face, contacts.point[owner]), np.full((len(owner), 3), np.nan)
    return _Sectors(owner, face, outward, outward, uv, nothing, nothing, np.full((len(owner), 2), -1))


def _directions(brep: Brep, use: IntArray, t: Array) -> Array:
    """Unit tangents (n, 3) of uses (n,) at parameters of their edges (n,)."""
    slope = evaluate_edges(brep, brep.uses.edge[use], t, (1,))[0] * brep.uses.sense[use][:, None]
    return np.asarray(slope / np.linalg.norm(slope, axis=1, keepdims=True))


def _make_sectors(
    network: Network, owner: IntArray, use: IntArray, t: Array, start: Array, end: Array, edges: IntArray
) -> _Sectors:
    """Sectors on the faces of uses (n,) at parameters of their edges (n,)."""
    patches, face = network.faces.patches, network.brep.face_of_use[use]
    known = np.flatnonzero(
        np.diff(network.faces.cells.first)[face] > 0
    )  # others are far from all faces of the first network
    owner, use, edges, face = owner[known], use[known], edges[known], face[known]
    t, start, end = t[known], start[known], end[known]
    uv = evaluate_use_parameters(network.brep, use, t)
    jet = evaluate_faces(patches, face, np.ascontiguousarray(uv))
    normal = np.cross(jet[:, 1], jet[:, 2])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    return _Sectors(owner, face, normal, patches.layout[face, SENSE][:, None] * normal, uv, start, end, edges)


@dataclass(frozen=True, slots=True, eq=False)
class EdgesInFaces:
    """Pieces of the second network's edges that lie in faces of the first one.

    `piece`, `use`, `inside` (n,): of each edge use of such a piece, whether the face beside it is inside the first solid.
    `arc_piece`, `arc_face`, `arc_sense` (m,): the pieces that bound the part of a face that is in the second solid, +1 if that is
    on their left, seen from outside on the first network.
    """

    piece: IntArray
    use: IntArray
    inside: BoolArray
    arc_piece: IntArray
    arc_face: IntArray
    arc_sense: IntArray


_NONE = np.zeros(0, np.int64)
NO_EDGES_IN_FACES = EdgesInFaces(_NONE, _NONE, np.zeros(0, bool), _NONE, _NONE, _NONE)


def find_edges_in_faces(
    first: Network, second: Network, contacts: Contacts, first_piece: IntArray, span: Array
) -> EdgesInFaces:
    """Of the pieces of the second network's edges, those that lie in faces; pieces as in `EdgePieces`.

    TrimmingError where a face beside such a piece is tangent to the plane, or two of them meet in it from within.
    """
    count = np.diff(first_piece)[contacts.coplanar[:, 0]]
    row, step = repeat_rows(count)
    e, g = contacts.coplanar[row].T
    piece = first_piece[e] + step
    t = span[piece].mean(axis=1)
    brep = second.brep
    (point,) = evaluate_edges(brep, e, t)
    inside, _ = locate_in_faces(first, g, project_onto_planes(first.brep, g, point))
    e, g, piece = e[inside], g[inside], piece[inside]
    t, point = t[inside], point[inside]
    n = len(e)
    sides = _sectors_at_edges(second, np.arange(n), e, t)
    use = second.uses[e].ravel()
    use = use[use >= 0]
    outward = np.array([_plane_of(first.brep, k)[1] for k in g.tolist()]).reshape(-1, 3)
    into = np.cross(sides.normal, sides.start)
    rise = _dot(into, outward[sides.owner])
    if (np.abs(rise) < MIN_SINE).any():
        at = format_point(point[sides.owner[np.argmin(np.abs(rise))]])
        raise TrimmingError(f"two faces are tangent where they meet near {at}")
    is_in = rise < 0
    n_in, n_sides = np.bincount(sides.owner[is_in], minlength=n), np.bincount(sides.owner, minlength=n)
    # where the second solid is, seen from outside on the first: left or right of the edge along its curve
    along = sides.start * brep.uses.sense[use][:, None]
    left = np.sign(-_dot(sides.outward, np.cross(outward[sides.owner], along))).astype(np.int64)
    least, greatest = np.full(n, 2), np.full(n, -2)
    np.minimum.at(least, sides.owner, left)
    np.maximum.at(greatest, sides.owner, left)
    bounds = (n_in == 1) & (n_sides <= 2)
    last = np.searchsorted(sides.owner, np.arange(n), side="right") - 1
    from_within = (n_in == 2) & (_dot(sides.outward[last - 1], into[last]) > 0) if n else np.zeros(0, bool)
    unclear = (bounds & ((least != greatest) | (least == 0))) | from_within
    if unclear.any():
        at = format_point(point[np.argmax(unclear)])
        raise TrimmingError(f"an edge of one network touches a face of the other near {at}")
    return EdgesInFaces(piece[sides.owner], use, is_in, piece[bounds], g[bounds], least[bounds])

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
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import TrimmingError, format_point
from tpmscad.splines.bspline import is_segment
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.intersect.network_hits import (
    SNAP_TOLS,
    Network,
    Piercings,
    evaluate_faces,
    locate_in_faces,
)
from tpmscad.trimming.operands.network_tables import PLANAR, SENSE, evaluate_use_parameters, list_spline_curves

MIN_SINE = 1e-6
"""Sine of an angle below which two directions are one, or a direction lies in a plane."""

CONTACT_SNAPS = 4.0
"""Distance from a contact, in snapping distances, within which the piercings of its edges are found."""

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
class _Sector:
    """The sector of a face round a point: from direction `start` counter-clockwise about `normal` to `end`; None: all of it.

    `outward`: the normal out of the solid. `uv`: the point on the face. `edges`: those in the directions start and end.
    """

    face: int
    normal: Array
    outward: Array
    uv: Array
    start: Array | None
    end: Array | None
    edges: tuple[int, int]

    def locate(self, direction: Array) -> int:
        """Of a direction in the tangent plane: 1 within the sector, 0 along `start`, 2 along `end`, -1 beyond."""
        if self.start is None or self.end is None:
            return 1
        angle, whole = (
            float(np.arctan2(self.normal @ np.cross(self.start, d), self.start @ d)) % (2 * np.pi)
            for d in (direction, self.end)
        )
        if min(angle, 2 * np.pi - angle) < MIN_SINE:
            return 0
        if abs(angle - whole) < MIN_SINE:
            return 2
        return 1 if angle < whole else -1


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
            points = _points_on_edges(second.brep, rows, EDGE_FRACTIONS)
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
    if not rows:
        none = np.zeros(0, np.int64)
        return Contacts(np.zeros((0, 3)), none, none, np.zeros(0), none, none, np.zeros(0), (), coplanar)
    points = np.array([row[0] for row in rows])
    face = np.array([row[4] for row in rows])
    uv = _plane_parameters(first.brep, face, points)
    inside, border = locate_in_faces(first, face, uv)
    made: list[tuple[Array, int, int, float, int, int, float, tuple[int, ...]]] = []
    for i in np.flatnonzero(inside | (border < snap)).tolist():
        point, vertex, edge, t, g = rows[i]
        place = (-1, -1, 0.0, (g,)) if border[i] >= snap else _find_on_border(first.brep, g, point, snap)
        same = [
            k
            for k, other in enumerate(made)
            if other[1:3] == (vertex, edge) and np.linalg.norm(other[0] - point) < CONTACT_SNAPS * snap
        ]
        if not same:
            made.append((point, vertex, edge, t, *place))
        elif len(place[3]) > len(made[same[0]][7]):
            made[same[0]] = (point, vertex, edge, t, *place)
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


def _plane_parameters(brep: Brep, face: IntArray, points: Array) -> Array:
    """(u, v) (n, 2) of points (n, 3) on the planar faces (n,)."""
    result = np.empty((len(face), 2))
    for g in np.unique(face).tolist():
        own = face == g
        carrier = brep.carriers[brep.faces.carrier[g]]
        result[own] = carrier.parameters(brep.faces.motion[g].apply_inverse(points[own]))
    return result


def _points_on_edges(brep: Brep, edges: IntArray, fractions: Array) -> Array:
    """Points (n, m, 3) of edges (n,) at fractions (m,) of their spans."""
    low, high = brep.edges.span[edges].T
    t = (low[:, None] + (high - low)[:, None] * fractions).ravel()
    row = np.repeat(edges, len(fractions))
    local = evaluate_curves(list_spline_curves(brep), brep.edges.curve[row], t)[0]
    return brep.edges.motion[row].apply(local).reshape(len(edges), len(fractions), 3)


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


@dataclass(frozen=True, slots=True, eq=False)
class ContactEnds:
    """E ends of curves at contacts: the faces (E, 2), parameters (E, 4) on both, whether a curve begins, and the contact (E,)."""

    faces: IntArray
    parameters: Array
    enters: BoolArray
    contact: IntArray


def collect_contact_ends(first: Network, second: Network, contacts: Contacts) -> ContactEnds:
    """The ends of curves at contacts; TrimmingError where faces are tangent, or a curve runs along an edge that is no contact."""
    around = _Surroundings(first), _Surroundings(second)
    coplanar = {(int(e), int(g)) for e, g in contacts.coplanar}
    rows: list[tuple[int, int, Array, bool, int]] = []
    for c in range(len(contacts)):
        at, point = format_point(contacts.point[c]), contacts.point[c]
        if contacts.vertex[c] >= 0:
            theirs = around[1].at_vertex(int(contacts.vertex[c]))
        else:
            theirs = around[1].at_edge(int(contacts.edge[c]), float(contacts.t[c]))
        if contacts.first_vertex[c] >= 0:
            ours = around[0].at_vertex(int(contacts.first_vertex[c]))
        elif contacts.first_edge[c] >= 0:
            ours = around[0].at_edge(int(contacts.first_edge[c]), float(contacts.first_t[c]))
        else:
            ours = [around[0].in_face(contacts.faces[c][0], point)]
        for f in theirs:
            for g in ours:
                along = np.cross(g.outward, f.outward)
                length = float(np.linalg.norm(along))
                if length < MIN_SINE:
                    raise TrimmingError(f"two faces are tangent where they meet near {at}")
                for sign in (1.0, -1.0):
                    direction = sign * along / length
                    on_theirs, on_ours = f.locate(direction), g.locate(direction)
                    if on_theirs < 0 or on_ours < 0:
                        continue
                    if on_theirs == 1 and on_ours == 1:
                        rows.append((g.face, f.face, np.concatenate([g.uv, f.uv]), sign > 0, c))
                    elif on_ours != 1 or (f.edges[on_theirs // 2], g.face) not in coplanar:
                        raise TrimmingError(f"a common curve of two networks runs along an edge at {at}")
    if not rows:
        return ContactEnds(np.zeros((0, 2), np.int64), np.zeros((0, 4)), np.zeros(0, bool), np.zeros(0, np.int64))
    g, f, parameters, enters, contact = zip(*rows, strict=True)
    return ContactEnds(np.column_stack([g, f]), np.array(parameters), np.array(enters), np.array(contact))


class _Surroundings:
    """The faces of a network round its points."""

    def __init__(self, network: Network) -> None:
        self.network, brep = network, network.brep
        uses, e, start = brep.uses, brep.edges, brep.faces.use_start
        self.first = np.where(uses.sense > 0, e.start[uses.edge], e.end[uses.edge])
        self.before = np.arange(-1, len(uses) - 1)
        self.before[start[:-1]] = start[1:] - 1
        self.order = np.argsort(self.first, kind="stable")
        self.sorted = self.first[self.order]
        self.face = brep.face_of_use

    def at_vertex(self, vertex: int) -> list[_Sector]:
        """The sectors of the faces round a vertex."""
        low, high = np.searchsorted(self.sorted, [vertex, vertex + 1])
        result = []
        for k in self.order[low:high].tolist():
            span = self._span(k)
            arrived = int(self.before[k])
            leaving, back = self._direction(k, span[0]), -self._direction(arrived, self._span(arrived)[1])
            edges = int(self.network.brep.uses.edge[k]), int(self.network.brep.uses.edge[arrived])
            result.append(self._sector(k, span[0], leaving, back, edges))
        return result

    def at_edge(self, edge: int, t: float) -> list[_Sector]:
        """The half planes of the faces beside an edge at a parameter of it."""
        result = []
        for k in self.network.uses[edge].tolist():
            if k >= 0:
                ahead = self._direction(k, t)
                result.append(self._sector(k, t, ahead, -ahead, (edge, edge)))
        return result

    def in_face(self, face: int, point: Array) -> _Sector:
        """All directions on a planar face about a point of it."""
        brep = self.network.brep
        _, outward = _plane_of(brep, face)
        uv = _plane_parameters(brep, np.array([face]), point[None])[0]
        return _Sector(face, outward, outward, uv, None, None, (-1, -1))

    def _span(self, use: int) -> tuple[float, float]:
        """The parameters of its edge at which a use begins and ends."""
        uses, span = self.network.brep.uses, self.network.brep.edges.span
        low, high = span[uses.edge[use]].tolist()
        return (low, high) if uses.sense[use] > 0 else (high, low)

    def _direction(self, use: int, t: float) -> Array:
        """The unit tangent of a use at a parameter of its edge."""
        brep = self.network.brep
        edge = int(brep.uses.edge[use])
        curve = list_spline_curves(brep)[brep.edges.curve[edge]]
        slope = brep.edges.motion[edge].apply_to_vectors(curve(np.array([t]), 1)[0]) * brep.uses.sense[use]
        return np.asarray(slope / np.linalg.norm(slope))

    def _sector(self, use: int, t: float, start: Array, end: Array, edges: tuple[int, int]) -> _Sector:
        face = int(self.face[use])
        uv = evaluate_use_parameters(self.network.brep, np.array([use]), np.array([t]))[0]
        normal = self.normal(face, uv)
        sense = int(self.network.faces.patches.layout[face, SENSE])
        return _Sector(face, normal, sense * normal, uv, start, end, edges)

    def normal(self, face: int, uv: Array) -> Array:
        """The unit vector along S_u x S_v of a face."""
        jet = evaluate_faces(self.network.faces.patches, np.array([face]), np.ascontiguousarray(uv[None]))[0]
        normal = np.cross(jet[1], jet[2])
        return np.asarray(normal / np.linalg.norm(normal))


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
    brep, around = second.brep, _Surroundings(second)
    curves = list_spline_curves(brep)
    sides: list[tuple[int, int, bool]] = []
    arcs: list[tuple[int, int, int]] = []
    for e, g in contacts.coplanar.tolist():
        _, outward = _plane_of(first.brep, g)
        for piece in range(first_piece[e], first_piece[e + 1]):
            t = float(span[piece].mean())
            point = brep.edges.motion[e].apply(curves[brep.edges.curve[e]](np.array([t])))
            inside, _ = locate_in_faces(first, np.array([g]), _plane_parameters(first.brep, np.array([g]), point))
            if not inside[0]:
                continue
            beside = []
            for sector in around.at_edge(e, t):
                assert sector.start is not None
                into = np.cross(sector.normal, sector.start)
                rise = float(into @ outward)
                if abs(rise) < MIN_SINE:
                    at = format_point(point[0])
                    raise TrimmingError(f"two faces are tangent where they meet near {at}")
                beside.append((rise < 0, into, sector))
            uses = [k for k in second.uses[e].tolist() if k >= 0]
            sides += [(piece, k, is_in) for k, (is_in, _, _) in zip(uses, beside, strict=True)]
            if len({is_in for is_in, _, _ in beside}) == 2 or (len(beside) == 1 and beside[0][0]):
                tau = around._direction(uses[0], t) * brep.uses.sense[uses[0]]  # along the edge
                left = np.cross(outward, tau)
                signs = {int(np.sign(-(sector.outward @ left))) for _, _, sector in beside}
                if len(signs) > 1 or 0 in signs:
                    raise TrimmingError(
                        f"an edge of one network touches a face of the other near {format_point(point[0])}"
                    )
                arcs.append((piece, g, signs.pop()))
            elif all(is_in for is_in, _, _ in beside) and len(beside) == 2:
                (_, _, one), (_, into, _) = beside
                if one.outward @ into > 0:
                    raise TrimmingError(
                        f"an edge of one network touches a face of the other near {format_point(point[0])}"
                    )
    piece, use, inside_of = zip(*sides, strict=True) if sides else ((), (), ())
    arc_piece, arc_face, arc_sense = zip(*arcs, strict=True) if arcs else ((), (), ())
    integers = (np.array(column, np.int64) for column in (arc_piece, arc_face, arc_sense))
    return EdgesInFaces(np.array(piece, np.int64), np.array(use, np.int64), np.array(inside_of, bool), *integers)

"""Faces of cylinders and cones joined across gaps, on whose sides the solid ends in discs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, drop_unused_geometry, select_faces
from tpmscad.brep.carriers import Plane
from tpmscad.brep.conics import TWO_PI
from tpmscad.brep.loops import follow_paths
from tpmscad.errors import TrimmingError, format_point
from tpmscad.index_ranges import list_following, list_preceding
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, line_segment

DEVIATION_SITES = 9
"""Points of an edge at which its distance from the face that it now bounds is measured."""

EITHER_SIDE = 4.0
"""Of that distance, that the tolerance of the edge covers: at a vertex two ends may be off to either side."""


def bridge_gaps(brep: Brep, centers: Array, tol: float) -> Brep:
    """The boundary representation with faces joined across gaps between two discs each, of centres (g, 2, 3) within tol.

    The discs of a gap end one cylinder or cone, and arcs at the same angles bound both. The faces at two such arcs become one, on
    the carrier of the first; between their ends run new edges, straight lines. TrimmingError if a disc is not there as it was, or
    the faces of a gap are farther than tol from one surface.
    """
    if not len(centers):
        return brep
    discs = _find_discs(brep, centers, tol)
    joint = _JoinedFaces(brep)
    for (lower, upper), (low, high) in zip(discs.tolist(), centers, strict=True):
        joint.join(joint.list_arcs(lower, low), joint.list_arcs(upper, high))
    return joint.rebuild(discs.ravel(), tol)


def _find_discs(brep: Brep, centers: Array, tol: float) -> IntArray:
    """The planar faces (g, 2) that have their origins at centres (g, 2, 3)."""
    origins = {c: each.origin for c, each in enumerate(brep.carriers) if isinstance(each, Plane)}
    flat = np.flatnonzero(np.isin(brep.faces.carrier, list(origins)))
    placed = brep.faces.motion[flat].apply(
        np.array([origins[c] for c in brep.faces.carrier[flat].tolist()]).reshape(-1, 3)
    )
    distance, found = cKDTree(placed).query(centers) if len(flat) else (np.full(centers.shape[:2], np.inf), None)
    if (distance > tol).any():
        at = format_point(centers[distance.max(axis=1).argmax(), 0], 5)
        raise TrimmingError(f"the disc near {at} in which a part of a strut ends lies in another strut")
    return np.asarray(flat[found])


@dataclass(slots=True)
class _JoinedFaces:
    """The loops of a boundary representation while faces are joined: the use after each one, and what is new.

    parent: the face that each was joined to, with the shift from its parameters; lines: new edges by their vertices; new_uses:
    edge, sense, pcurve and face of each.
    """

    brep: Brep
    following: list[int] = field(init=False)
    preceding: IntArray = field(init=False)
    face_of_use: IntArray = field(init=False)
    partner: IntArray = field(init=False)
    parent: dict[int, tuple[int, Array]] = field(default_factory=dict)
    removed: list[int] = field(default_factory=list)
    lines: dict[tuple[int, int], int] = field(default_factory=dict)
    new_uses: list[tuple[int, int, BSplineCurve, int]] = field(default_factory=list)

    def __post_init__(self) -> None:
        uses, starts = self.brep.uses, self.brep.faces.use_start
        self.following, self.preceding = list_following(starts).tolist(), list_preceding(starts)
        self.face_of_use = self.brep.face_of_use
        both = np.argsort(uses.edge, kind="stable").reshape(-1, 2)  # the uses of each edge
        self.partner = np.empty(len(uses), np.int64)
        self.partner[both], self.partner[both[:, ::-1]] = both[:, ::-1], both

    def list_arcs(self, disc: int, center: Array) -> list[tuple[int, Array]]:
        """The uses of the edges of a disc by the faces beside it, with unit vectors from the centre to their middles."""
        arcs = self.partner[np.flatnonzero(self.face_of_use == disc)].tolist()
        arms = [self._evaluate(int(self.brep.uses.edge[use]), np.array([0.5]))[0] - center for use in arcs]
        return [(use, arm / np.linalg.norm(arm)) for use, arm in zip(arcs, arms, strict=True)]

    def _evaluate(self, edge: int, fractions: Array) -> Array:
        """Points of an edge at fractions (n,) of its span."""
        edges = self.brep.edges
        low, high = edges.span[edge]
        return edges.motion[edge].apply(self.brep.curves[edges.curve[edge]](low + fractions * (high - low)))

    def join(self, lower: Sequence[tuple[int, Array]], upper: Sequence[tuple[int, Array]]) -> None:
        """Join the faces at the arcs of two discs."""
        for arc, arm in lower:
            self._join_at(arc, max(upper, key=lambda other: float(other[1] @ arm))[0])

    def _join_at(self, arc: int, other: int) -> None:
        """Join the face of an arc and that of the other arc, which runs the other way."""
        face, joined = int(self.face_of_use[arc]), int(self.face_of_use[other])
        (start, end), (far_end, far_start) = self._list_ends(arc), self._list_ends(other)
        far = [
            self._locate(face, vertex, near)
            for (vertex, _), (_, near) in zip((far_start, far_end), (start, end), strict=True)
        ]
        self.parent[joined] = face, far[0] - far_start[1]
        ways = [
            self._add_line(start, (far_start[0], far[0]), 1, face),
            self._add_line(end, (far_end[0], far[1]), -1, face),
        ]
        after, after_other = self.following[arc], self.following[other]
        self.following[self.preceding[arc]], self.following[self.preceding[other]] = ways
        self.following += [after_other, after]
        self.removed += [arc, other]

    def _list_ends(self, use: int) -> list[tuple[int, Array]]:
        """The vertices at the start and the end of a use, with the parameters there."""
        uses, edges = self.brep.uses, self.brep.edges
        edge, sense, curve = int(uses.edge[use]), int(uses.sense[use]), self.brep.pcurves[uses.pcurve[use]]
        ends = list(zip((int(edges.start[edge]), int(edges.end[edge])), curve(edges.span[edge]), strict=True))
        return ends[::sense]

    def _locate(self, face: int, vertex: int, near: Array) -> Array:
        """The parameters of a vertex on the carrier of a face, in the turn of others nearby."""
        motion = self.brep.faces.motion[face]
        carrier = self.brep.carriers[self.brep.faces.carrier[face]]
        found = np.array(carrier.parameters((self.brep.vertices[vertex] - motion.translation) @ motion.rotation))
        found[0] += TWO_PI * np.round((near[0] - found[0]) / TWO_PI)
        return found

    def _add_line(self, start: tuple[int, Array], end: tuple[int, Array], sense: int, face: int) -> int:
        """The number of a new use of the line between two vertices."""
        length = float(np.linalg.norm(self.brep.vertices[end[0]] - self.brep.vertices[start[0]]))
        edge = self.lines.setdefault((start[0], end[0]), len(self.brep.edges) + len(self.lines))
        self.new_uses.append((edge, sense, line_segment(start[1], end[1], (0.0, length)), face))
        return len(self.brep.uses) + len(self.new_uses) - 1

    def rebuild(self, discs: IntArray, tol: float) -> Brep:
        """The boundary representation without the discs."""
        brep, n = self.brep, len(self.brep.faces)
        root, shift = np.arange(n), np.zeros((n, 2))
        for face in self.parent:
            at = face
            while at in self.parent:
                at, step = self.parent[at]
                shift[face] += step
            root[face] = at
        ends = np.array(list(self.lines), np.int64).reshape(-1, 2)
        added = Edges(
            len(brep.curves) + np.arange(len(self.lines)),
            Motion.identity(len(self.lines)),
            np.array([[0.0, np.linalg.norm(brep.vertices[j] - brep.vertices[i])] for i, j in self.lines]),
            ends[:, 0],
            ends[:, 1],
            np.zeros(len(self.lines)),
        )
        lines = [
            line_segment(brep.vertices[i], brep.vertices[j], span)
            for (i, j), span in zip(self.lines, added.span.tolist(), strict=True)
        ]
        edges = Edges(
            np.concatenate([brep.edges.curve, added.curve]),
            Motion.concatenate([brep.edges.motion, added.motion]),
            np.concatenate([brep.edges.span, added.span]),
            np.concatenate([brep.edges.start, added.start]),
            np.concatenate([brep.edges.end, added.end]),
            np.concatenate([brep.edges.deviation, added.deviation]),
        )
        owner = np.concatenate([self.face_of_use, [face for *_, face in self.new_uses]]).astype(np.int64)
        pcurves = [*brep.pcurves, *(curve for _, _, curve, _ in self.new_uses)]
        edge = np.concatenate([brep.uses.edge, [edge for edge, *_ in self.new_uses]]).astype(np.int64)
        sense = np.concatenate([brep.uses.sense, [sense for _, sense, *_ in self.new_uses]]).astype(np.int64)
        pcurve = np.concatenate([brep.uses.pcurve, len(brep.pcurves) + np.arange(len(self.new_uses))])
        kept = ~np.isin(owner, discs)
        kept[self.removed] = False
        bridged = replace(brep, curves=(*brep.curves, *lines), edges=edges)
        moved_or_new = (root != np.arange(n))[owner] | (np.arange(len(owner)) >= len(brep.uses))
        for use in np.flatnonzero(kept & moved_or_new).tolist():
            old, face = pcurves[pcurve[use]], int(owner[use])
            moved = BSplineCurve(old.poles + shift[face], old.knots, old.degree)
            pcurve[use] = len(pcurves)
            pcurves.append(moved)
            miss = _measure_deviation(bridged, int(edge[use]), int(root[face]), moved)
            if miss > tol:
                at = format_point(
                    edges.motion[edge[use]].apply(bridged.curves[edges.curve[edge[use]]](old.domain[0])), 5
                )
                raise TrimmingError(f"parts of a strut near {at} are {miss:.2g} off each other")
            edges.deviation[edge[use]] = max(edges.deviation[edge[use]], EITHER_SIDE * miss)
        rows = np.flatnonzero(kept)
        number = np.full(len(owner), -1)
        number[rows] = np.arange(len(rows))
        order, starts = follow_paths(number[np.array(self.following)[rows]])
        face_of_loop = root[owner[rows[order[starts[:-1]]]]]
        by_face = np.argsort(face_of_loop, kind="stable")
        remaining = np.setdiff1d(np.unique(root), discs)
        lengths = np.diff(starts)[by_face]
        uses = rows[np.concatenate([order[starts[k] : starts[k + 1]] for k in by_face.tolist()])]
        faces = brep.faces
        return drop_unused_geometry(
            select_faces(
                replace(
                    bridged,
                    pcurves=tuple(pcurves),
                    uses=EdgeUses(edge[uses], sense[uses], pcurve[uses]),
                    faces=Faces(
                        faces.carrier[remaining],
                        faces.motion[remaining],
                        faces.sense[remaining],
                        faces.tag[remaining],
                        np.concatenate([[0], np.cumsum(np.bincount(face_of_loop, minlength=n)[remaining])]),
                        np.concatenate([[0], np.cumsum(lengths)]),
                    ),
                ),
                np.arange(len(remaining)),
            )
        )


def _measure_deviation(brep: Brep, edge: int, face: int, pcurve: BSplineCurve) -> float:
    """The greatest distance between an edge and the image of a pcurve on a face, at equal parameters."""
    low, high = brep.edges.span[edge].tolist()
    t = np.linspace(low, high, DEVIATION_SITES)
    on_face = brep.faces.motion[face].apply(brep.carriers[brep.faces.carrier[face]](*pcurve(t).T))
    on_edge = brep.edges.motion[edge].apply(brep.curves[brep.edges.curve[edge]](t))
    return float(np.linalg.norm(on_face - on_edge, axis=1).max())

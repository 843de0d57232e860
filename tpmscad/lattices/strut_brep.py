"""Round struts of one diameter on a graph as a boundary representation: cylinders, balls and the planes of a box, exactly.

The faces of each strut (`strut_facets`) are joined at edges with the same ends and middle. Nodes in a side of the box, and struts
along it, are cut by the side; the edges that are then used once bound the planar faces. No face is intersected with another: what
must hold for that is checked by `find_contact`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.carriers import Carrier, EdgeCurve, Plane
from tpmscad.brep.loops import chain_faces
from tpmscad.lattices.strut_ends import IN_PLANE
from tpmscad.lattices.strut_facets import (
    CAP,
    ON_SIDE,
    SAME_POINT,
    SURFACE,
    Facet,
    Side,
    bound_ball,
    bound_cylinder,
    choose_cuts,
    exchange_opposite_splits,
    exchange_splits,
    make_strut_ends,
    reverse_side,
)
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, line_segment

PATH_POINTS = 17
"""Points of an edge in the polygon that stands for it where planar faces are nested."""


def build_strut_brep(
    points: Array,
    struts: IntArray,
    radius: float,
    node_radius: float,
    box: tuple[Array, Array] | None = None,
) -> Brep:
    """The boundary of struts (m, 2) between points (n, 3), with balls at the nodes; cut by the sides of a box that they lie in.

    node_radius: at least `radius`. The struts must not touch each other but in common nodes, see `find_contact`; a node that is
    not in a side must be clear of it.
    """
    ends = make_strut_ends(points, struts, radius, node_radius, box)
    facets: list[Facet] = []
    cuts = [choose_cuts(ends[s]) for s in range(len(struts))]
    exchange_splits(ends, cuts, radius, node_radius)
    if box is not None:
        exchange_opposite_splits(ends, cuts, radius, node_radius, box)
    for pair, cut in zip(ends, cuts, strict=True):
        facets += bound_cylinder(pair, cut, points, struts, radius)
        for end in pair:
            facets += bound_ball(end, cut, radius, node_radius)
    brep = _assemble(facets, radius)
    if box is None:
        return brep
    return _close_sides(brep, facets, points, struts, radius, node_radius, box)


class _PointPool:
    """Points that are one within a distance, numbered."""

    def __init__(self, points: Array, tol: float) -> None:
        pairs = cKDTree(points).query_pairs(tol, output_type="ndarray")
        graph = coo_matrix((np.ones(len(pairs)), (pairs[:, 0], pairs[:, 1])), shape=(len(points),) * 2)
        _, self.number = connected_components(graph, directed=False)
        _, first = np.unique(self.number, return_index=True)
        self.points = points[first]


def _assemble(facets: Sequence[Facet], radius: float) -> Brep:
    """The faces on common edges and vertices: sides of faces with the same ends and middle are one edge."""
    sides = [side for facet in facets for loop in facet.loops for side in loop]
    pool = _PointPool(np.concatenate([side.ends() for side in sides]), SAME_POINT * radius)
    numbers = pool.number.reshape(-1, 3)
    known: dict[tuple[int, int, int], int] = {}
    edge_of, sense_of = [], []
    rows: list[tuple[Side, int, int]] = []
    for side, (start, middle, end) in zip(sides, numbers.tolist(), strict=True):
        key = min(start, end), max(start, end), middle
        if key not in known:
            known[key] = len(rows)
            rows.append((side, start, end))
        edge_of.append(known[key])
        sense_of.append(side.sense if rows[known[key]][1] == start else -side.sense)
    curves = tuple(side.curve for side, _, _ in rows)
    used, ends = np.unique(np.array([(a, b) for _, a, b in rows]), return_inverse=True)
    start, end = ends.reshape(-1, 2).T
    return _with_matched_pcurves(facets, sides, edge_of, sense_of, rows, curves, pool.points[used], start, end)


def _with_matched_pcurves(
    facets: Sequence[Facet],
    sides: Sequence[Side],
    edge_of: Sequence[int],
    sense_of: Sequence[int],
    rows: Sequence[tuple[Side, int, int]],
    curves: tuple[EdgeCurve, ...],
    vertices: Array,
    start: IntArray,
    end: IntArray,
) -> Brep:
    """The boundary representation, with every pcurve on the span of its edge's curve."""
    pcurves: list[BSplineCurve] = []
    number, deviation = [], np.zeros(len(rows))
    carriers: list[Carrier] = []
    carrier_of, known = [], {}
    loop_start, use_start, at = [0], [0], 0
    for facet in facets:
        if id(facet.carrier) not in known:
            known[id(facet.carrier)] = len(carriers)
            carriers.append(facet.carrier)
        carrier_of.append(known[id(facet.carrier)])
        for loop in facet.loops:
            for side in loop:
                row = rows[edge_of[at]][0]
                if side.pcurve is None:
                    number.append(-1)
                else:
                    number.append(len(pcurves))
                    pcurves.append(_on_span(side.pcurve, row.span, same_way=sense_of[at] == side.sense))
                    t = np.linspace(*row.span, 9)
                    off = np.linalg.norm(facet.carrier(*pcurves[-1](t).T) - row.curve(t), axis=1).max()
                    deviation[edge_of[at]] = max(deviation[edge_of[at]], off)
                at += 1
            use_start.append(at)
        loop_start.append(len(use_start) - 1)
    n, m = len(facets), len(rows)
    tags = np.array([[SURFACE, CAP].index(facet.tag) for facet in facets], np.int64)
    return Brep(
        tuple(carriers),
        curves,
        tuple(pcurves),
        vertices,
        Edges(np.arange(m), Motion.identity(m), np.array([side.span for side, _, _ in rows]), start, end, deviation),
        EdgeUses(np.array(edge_of), np.array(sense_of), np.array(number)),
        Faces(
            np.array(carrier_of),
            Motion.identity(n),
            np.array([facet.sense for facet in facets]),
            tags,
            np.array(loop_start),
            np.array(use_start),
        ),
        (SURFACE, CAP),
    )


def _on_span(curve: BSplineCurve, span: tuple[float, float], *, same_way: bool) -> BSplineCurve:
    """The curve with its parameter moved, and reversed if it runs the other way, to another span of the same length."""
    low, high = curve.domain
    relative = (curve.knots - low) / (high - low)
    poles = curve.poles
    if not same_way:
        relative, poles = 1.0 - relative[::-1], poles[::-1].copy()
    return BSplineCurve(poles, span[0] + (span[1] - span[0]) * relative, curve.degree)


def _close_sides(
    open_brep: Brep,
    facets: Sequence[Facet],
    points: Array,
    struts: IntArray,
    radius: float,
    node_radius: float,
    box: tuple[Array, Array],
) -> Brep:
    """The boundary representation with the planar faces in the sides of the box, bounded by the edges that are used once."""
    sides = [side for facet in facets for loop in facet.loops for side in loop]
    uses = open_brep.uses
    once = np.flatnonzero(np.bincount(uses.edge, minlength=len(open_brep.edges)) == 1)
    of_edge = {int(uses.edge[k]): k for k in range(len(uses))}
    lo, hi = box
    tol = SAME_POINT * radius
    open_sides = [reverse_side(sides[of_edge[e]]) for e in once.tolist()]
    lines = _find_lines(points, struts, radius, node_radius, box)
    caps: list[Facet] = []
    for axis in range(3):
        for bound, sign in ((lo, -1), (hi, +1)):
            normal = sign * np.eye(3)[axis]
            x_axis = np.eye(3)[(axis + 1) % 3]
            plane = Plane(bound[axis] * np.eye(3)[axis], x_axis, normal)
            own = [
                Side(side.curve, side.span, side.sense, None)
                for side in open_sides
                if (np.abs(side.ends()[:, axis] - bound[axis]) <= tol).all()
            ]
            for start, end in lines:
                if abs(start[axis] - bound[axis]) > tol or abs(end[axis] - bound[axis]) > tol:
                    continue
                length = float(np.linalg.norm(end - start))
                inwards = np.sign(0.5 * (lo + hi) - start) * (np.abs(end - start) <= tol) * (np.arange(3) != axis)
                sense = 1 if np.cross(normal, end - start) @ inwards > 0 else -1
                own.append(Side(line_segment(start, end, (0.0, length)), (0.0, length), sense, None))
            caps += _chain_caps(plane, own, tol)
    return _assemble([*facets, *caps], radius)


def _chain_caps(plane: Plane, sides: Sequence[Side], tol: float) -> Iterator[Facet]:
    """The planar faces on the left of directed sides."""
    if not sides:
        return
    pool = _PointPool(np.concatenate([side.ends() for side in sides]), tol)
    ends = pool.number.reshape(-1, 3)
    ends = np.array([row if side.sense > 0 else row[::-1] for row, side in zip(ends, sides, strict=True)])
    paths = [plane.parameters(side.curve(np.linspace(*side.span, PATH_POINTS)[:: side.sense])) for side in sides]
    for face in chain_faces(ends[:, 0], ends[:, 2], paths):
        yield Facet(plane, 1, CAP, [[sides[i] for i in loop] for loop in face])


def _find_lines(
    points: Array, struts: IntArray, radius: float, node_radius: float, box: tuple[Array, Array]
) -> list[tuple[Array, Array]]:
    """The parts of the edges of the box that lie in the solid, from start to end."""
    lo, hi = box
    tol = ON_SIDE * float((hi - lo).max())
    corners = np.stack([lo, hi])
    neighbours: list[list[int]] = [[] for _ in points]
    for a, b in struts.tolist():
        neighbours[a].append(b)
        neighbours[b].append(a)
    lines = []
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for i, j in np.ndindex(2, 2):
            on = np.flatnonzero(
                (np.abs(points[:, first] - corners[i, first]) <= tol)
                & (np.abs(points[:, second] - corners[j, second]) <= tol)
            )
            spans = []
            for node in on.tolist():
                if not neighbours[node]:
                    continue
                ways = points[neighbours[node]] - points[node]
                ways = ways / np.linalg.norm(ways, axis=1)[:, None]
                reach = []
                for sign in (-1, +1):
                    cosine = sign * ways[:, axis]
                    along = np.flatnonzero(cosine > 1 - IN_PLANE)
                    if len(along):
                        reach.append(points[neighbours[node][along[0]], axis])
                        continue
                    sine = np.sqrt(1 - cosine[cosine > 0] ** 2)
                    far = max([node_radius, *(radius / sine)])
                    reach.append(float(np.clip(points[node, axis] + sign * far, lo[axis], hi[axis])))
                spans.append(tuple(reach))
            for low, high in _unite_spans(spans):
                start = np.zeros(3)
                start[[first, second]] = corners[i, first], corners[j, second]
                end = start.copy()
                start[axis], end[axis] = low, high
                lines.append((start, end))
    return lines


def _unite_spans(spans: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    united: list[tuple[float, float]] = []
    for low, high in sorted(spans):
        if united and low <= united[-1][1]:
            united[-1] = united[-1][0], max(high, united[-1][1])
        else:
            united.append((low, high))
    return united

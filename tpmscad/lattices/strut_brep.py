"""Round struts on a graph as a boundary representation: cylinders, cones, balls and the planes of a box, exactly.

The faces of each strut, which are those of its class (`strut_classes`), are joined at edges with the same ends and middle. Nodes
in a side of the box, and struts along it, are cut by the side; the edges that are then used once bound the planar faces. No face
is intersected with another: what must hold for that is checked by `find_contact`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, select_faces
from tpmscad.brep.carriers import Carrier, Plane
from tpmscad.brep.linked_items import label_linked
from tpmscad.brep.loops import chain_faces
from tpmscad.errors import TrimmingError
from tpmscad.index_ranges import expand_ranges
from tpmscad.lattices.strut_classes import find_sides, group_facets
from tpmscad.lattices.strut_facets import SAME_POINT, Side
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, line_segment

CAP, SURFACE = "cap", "surface"
"""Tags of faces in the sides of the box, and of all others."""

SAME_VERTEX = 1e-5
"""In the least radii: distance up to which vertices are one, and edges between them are left out. Where more than three struts
meet in a point, coordinates of single precision take it apart by a tenth of that.
"""

VERTEX_MARGIN = 6.0
"""Of the distance of an edge's ends from its vertices, that its tolerance covers: two ends lie on either side of a vertex, and
with 1.05 the kernel refused 12 of 890 faces, with 3 one of these once it was cut.
"""

PATH_POINTS = 17
"""Points of an edge in the polygon that stands for it where planar faces are nested."""


def build_strut_brep(
    points: Array,
    struts: IntArray,
    radii: Array,
    balls: Array,
    box: tuple[Array, Array] | None = None,
) -> Brep:
    """The boundary of struts (m, 2) between points (n, 3), with balls at the nodes; cut by the sides of a box that they lie in.

    radii (n,): of the ends of all struts at each point; balls (n,): at least those. The struts must not touch each other but in
    common nodes, see `find_contact`; a node that is not in a side must be clear of it.
    """
    label, classes = group_facets(points, struts, radii, balls, box)
    facets = [facet for own in classes for facet in own]
    first_facet = np.cumsum([0, *map(len, classes)])
    first_side = np.cumsum([0, *(len(facet.loop) for facet in facets)])
    strut, facet = expand_ranges(first_facet[label], first_facet[label + 1])
    face, kind = expand_ranges(first_side[facet], first_side[facet + 1])
    sides = [side for each in facets for side in each.loop]
    corner, tol = points[struts[strut, 0]], SAME_POINT * float(radii.min())
    if box is not None:
        ends = np.array([side.ends()[::2] for side in sides])[kind] + corner[face][:, None]
        in_corners = np.unique(struts[find_sides(points, box).sum(axis=1)[struts] == 3])
        sides += _find_lines(ends, points[in_corners], box, tol)
    n_lines = len(sides) - int(first_side[-1])
    joined, kept = _join_sides(
        sides,
        np.concatenate([kind, first_side[-1] + np.arange(n_lines)]),
        np.concatenate([corner[face], np.zeros((n_lines, 3))]),
        SAME_VERTEX * float(radii.min()),
    )
    face = face[kept[: len(face)]]
    caps = [] if box is None else list(_close_sides(joined, len(face), box, tol))
    pcurves, pcurve, deviation = _match_pcurves(joined, [each.carrier for each in facets], facet[face])
    loops = [loop for _, of_plane in caps for loop in of_plane]
    uses = np.array([use for loop in loops for use in loop], np.int64).reshape(-1, 2)
    first = joined.first
    curves, curve = np.unique(joined.kind[first], return_inverse=True)
    carriers = list(
        {id(carrier): carrier for carrier in (*(each.carrier for each in facets), *(cap[0] for cap in caps))}.values()
    )
    number = {id(carrier): i for i, carrier in enumerate(carriers)}
    on_facets = np.array([number[id(each.carrier)] for each in facets])
    found = Brep(
        tuple(carriers),
        tuple(sides[k].curve for k in curves.tolist()),
        pcurves,
        joined.vertices,
        Edges(
            curve,
            Motion.translations(joined.move[first]),
            np.array([side.span for side in sides])[joined.kind[first]],
            joined.start[first],
            joined.end[first],
            deviation,
        ),
        EdgeUses(
            np.concatenate([joined.edge[: len(face)], uses[:, 0]]),
            np.concatenate([joined.sense[: len(face)], uses[:, 1]]),
            np.concatenate([pcurve, np.full(len(uses), -1)]),
        ),
        Faces(
            np.concatenate([on_facets[facet], np.array([number[id(plane)] for plane, _ in caps], np.int64)]),
            Motion.translations(np.concatenate([corner, np.zeros((len(caps), 3))])),
            np.ones(len(facet) + len(caps), np.int64),
            np.repeat([0, 1], [len(facet), len(caps)]),
            np.cumsum([0, *[1] * len(facet), *(len(of_plane) for _, of_plane in caps)]),
            np.cumsum(
                np.concatenate([[0], np.bincount(face, minlength=len(facet)), [len(loop) for loop in loops]])
            ).astype(np.int64),
        ),
        (SURFACE, CAP),
    )
    return _drop_slits(found)


def _drop_slits(brep: Brep) -> Brep:
    """Without faces whose loops run along all their edges forth and back: slits between borders that are one."""
    n_edges, face = len(brep.edges), brep.face_of_use
    key, use = np.unique(face * n_edges + brep.uses.edge, return_inverse=True)
    net = np.bincount(use.ravel(), weights=brep.uses.sense)
    wide = np.unique(key[net != 0] // max(n_edges, 1))
    return brep if len(wide) == len(brep.faces) else select_faces(brep, wide)


class _PointPool:
    """Points that are one within a distance, numbered."""

    def __init__(self, points: Array, tol: float) -> None:
        self.number = label_linked(len(points), cKDTree(points).query_pairs(tol, output_type="ndarray"))
        _, first = np.unique(self.number, return_index=True)
        self.points = points[first]


@dataclass(frozen=True, slots=True, eq=False)
class _JoinedSides:
    """Sides (k,) of faces on common edges: those with the same ends and middle are one edge.

    kind (k,): rows of `sides`; move (k, 3): their translations. ends (k, 3, 3): start, middle and end of the curves. start, end
    (k,): their vertices, rows of `vertices`. edge, sense (k,): the edges, and the senses along these; along (k,): whether the
    curve runs as the edge does. first (e,): the side whose curve is that of the edge.
    """

    sides: Sequence[Side]
    kind: IntArray
    move: Array
    ends: Array
    vertices: Array
    start: IntArray
    end: IntArray
    edge: IntArray
    along: BoolArray
    sense: IntArray
    first: IntArray


def _join_sides(sides: Sequence[Side], kind: IntArray, move: Array, tol: float) -> tuple[_JoinedSides, BoolArray]:
    """The sides but those whose ends and middle are one point, and which (k,) these are not."""
    ends = np.array([side.ends() for side in sides])[kind] + move[:, None]
    pool = _PointPool(ends.reshape(-1, 3), tol)
    numbers = pool.number.reshape(-1, 3)
    kept = (numbers != numbers[:, :1]).any(axis=1)
    kind, move, ends = kind[kept], move[kept], ends[kept]
    start, middle, end = numbers[kept].T
    keys = np.column_stack([np.minimum(start, end), np.maximum(start, end), middle])
    _, first, edge = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    rank = np.argsort(np.argsort(first))
    first, edge = np.sort(first), rank[edge.ravel()]
    along = start[first[edge]] == start
    sense = np.array([side.sense for side in sides])[kind] * np.where(along, 1, -1)
    used, vertex = np.unique(np.stack([start, end]), return_inverse=True)
    start, end = vertex.reshape(2, -1)
    return _JoinedSides(sides, kind, move, ends, pool.points[used], start, end, edge, along, sense, first), kept


def _match_pcurves(
    joined: _JoinedSides, carriers: Sequence[Carrier], facet: IntArray
) -> tuple[tuple[BSplineCurve, ...], IntArray, Array]:
    """Pcurves on the spans of edges, the number of that of each use (k,) by a facet, and the deviations of edges.

    Planes have none: their number is -1.
    """
    n = len(facet)
    source = joined.first[joined.edge[:n]]
    keys = np.column_stack([joined.kind[:n], joined.kind[source], joined.along[:n]])
    _, chosen, number = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    pcurves: list[BSplineCurve] = []
    off, numbers = np.zeros(len(chosen)), np.full(len(chosen), -1)
    for i, k in enumerate(chosen.tolist()):
        own, row = joined.sides[joined.kind[k]], joined.sides[joined.kind[source[k]]]
        if own.pcurve is None:
            continue
        numbers[i] = len(pcurves)
        pcurves.append(_on_span(own.pcurve, row.span, same_way=bool(joined.along[k])))
        t = np.linspace(row.span[0], row.span[1], 9)
        shift = joined.move[k] - joined.move[source[k]]
        miss = carriers[facet[k]](*pcurves[-1](t).T) + shift - row.curve(t)
        off[i] = float(np.linalg.norm(miss, axis=1).max())
    first = joined.first
    at_ends = joined.vertices[np.stack([joined.start[first], joined.end[first]], axis=1)] - joined.ends[first][:, ::2]
    deviation = VERTEX_MARGIN * np.linalg.norm(at_ends, axis=2).max(axis=1)
    np.maximum.at(deviation, joined.edge[:n], off[number.ravel()])
    return tuple(pcurves), numbers[number.ravel()], deviation


def _on_span(curve: BSplineCurve, span: tuple[float, float], *, same_way: bool) -> BSplineCurve:
    """The curve with its parameter moved, and reversed if it runs the other way, to another span of the same length."""
    low, high = curve.domain
    relative = (curve.knots - low) / (high - low)
    poles = curve.poles
    if not same_way:
        relative, poles = 1.0 - relative[::-1], poles[::-1].copy()
    return BSplineCurve(poles, span[0] + (span[1] - span[0]) * relative, curve.degree)


def _close_sides(
    joined: _JoinedSides, n: int, box: tuple[Array, Array], tol: float
) -> Iterator[tuple[Plane, list[list[tuple[int, int]]]]]:
    """The planar faces in the sides of the box, with loops of edges and senses: on the left of the edges that are used once.

    The first n sides are those of other faces; the others are lines along the edges of the box.
    """
    lo, hi = box
    once = np.flatnonzero(np.bincount(joined.edge[:n], minlength=len(joined.first)) == 1)
    is_open = np.zeros(len(joined.first), bool)
    is_open[once] = True
    borders = np.flatnonzero(is_open[joined.edge[:n]])
    paths: dict[int, Array] = {}
    for axis, (bound, sign) in product(range(3), ((lo, -1), (hi, +1))):
        normal = sign * np.eye(3)[axis]
        plane = Plane(bound[axis] * np.eye(3)[axis], np.eye(3)[(axis + 1) % 3], normal)
        rows = np.concatenate([borders, np.arange(n, len(joined.kind))])
        rows = rows[(np.abs(joined.ends[rows, :, axis] - bound[axis]) <= tol).all(axis=1)]
        if not len(rows):
            continue
        middle = 0.5 * (lo + hi)
        backwards, lines = [], []
        for k in rows.tolist():
            side = joined.sides[joined.kind[k]]
            if joined.kind[k] not in paths:
                paths[joined.kind[k]] = side.curve(np.linspace(side.span[0], side.span[1], PATH_POINTS))
            path = plane.parameters(paths[joined.kind[k]] + joined.move[k])
            if k < n:
                back = side.sense > 0
            else:
                step = joined.ends[k, 2] - joined.ends[k, 0]
                inwards = np.sign(middle - joined.ends[k, 0]) * (np.abs(step) <= tol) * (np.arange(3) != axis)
                back = not np.cross(normal, step) @ inwards > 0
            backwards.append(back)
            lines.append(path[::-1] if back else path)
        turned = np.array(backwards)
        start, end = (
            np.where(turned, a[rows], b[rows]) for a, b in ((joined.end, joined.start), (joined.start, joined.end))
        )
        sense = np.where(turned, -1, 1) * np.where(joined.along[rows], 1, -1)
        uses = list(zip(joined.edge[rows].tolist(), sense.tolist(), strict=True))
        for face in chain_faces(start, end, lines):
            yield plane, [[uses[i] for i in loop] for loop in face]


def _find_lines(ends: Array, corners: Array, box: tuple[Array, Array], tol: float) -> list[Side]:
    """The parts of the edges of the box that lie in the solid, given ends (k, 2, 3) of sides of faces, and its own corners there.

    An edge of the box enters and leaves the solid in turn, in vertices of faces, which it has nowhere else.
    """
    points, lines = np.concatenate([ends.reshape(-1, 3), corners]), list[Side]()
    at = np.abs(points[:, None] - np.stack(box)) <= tol
    for axis in range(3):
        first, second = (axis + 1) % 3, (axis + 2) % 3
        for i, j in np.ndindex(2, 2):
            met = np.sort(points[at[:, i, first] & at[:, j, second], axis])
            met = met[np.diff(met, prepend=-np.inf) > tol]
            if len(met) % 2:
                raise TrimmingError("an edge of the box touches struts without a way out")
            for low, high in met.reshape(-1, 2).tolist():
                start = np.zeros(3)
                start[[first, second]] = box[i][first], box[j][second]
                end = start.copy()
                start[axis], end[axis] = low, high
                lines.append(Side(line_segment(start, end, (0.0, high - low)), (0.0, high - low), 1, None))
    return lines

"""Splitting of closed faces, so that no edge bounds a face twice.

A boundary representation has no seams. A face with a seam is cut opposite to it along u = const (on a torus also v = const).
Edges that the cut intersects are split there in all faces. The pieces of the cut inside the face become edges: lines on cylinders
and cones, circles on spheres and tori. The half-edges on each side are then chained into loops, and holes are assigned to the
outer loops around them.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, ConicalSurface, CylindricalSurface, EdgeCurve, Plane, Quadric
from tpmscad.brep.conics import TWO_PI
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.loops import point_in_polygon, signed_area
from tpmscad.kernel.body_import.unrolled_faces import (
    ANGLE_TOL,
    ImportedBody,
    ImportedEdge,
    ImportedFace,
    ImportedUse,
    loop_polygon,
    pole_direction,
    sample_use,
)
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace
from tpmscad.splines.bspline import isoparametric_curve, line_segment


def split_into_faces(body: ImportedBody, face: ImportedFace, uses: list[ImportedUse]) -> list[ImportedFace]:
    """Faces bounded by half-edges with continuous (u, v); each region lies to the left of its half-edges."""
    tips = [sample_use(body, face, use)[[0, -1]] for use in uses]

    def gap(last: int, following: int) -> float:
        return _use_gap(body, face, uses[following], tips[last][1], tips[following][0])

    loops = chain_loops([_use_vertices(body, use) for use in uses], gap)
    polygons = [loop_polygon(body, face, tuple(uses[i] for i in loop)) for loop in loops]
    return [replace(face, loops=tuple(tuple(uses[k] for k in loops[i]) for i in of)) for of in nest_loops(polygons)]


def nest_loops(polygons: Sequence[Array]) -> list[list[int]]:
    """For each face the polygons (n, 2) of its outer loop, which runs counter-clockwise, and of its holes, by their numbers."""
    areas = np.array([signed_area(p) for p in polygons])
    outer = [i for i in np.argsort(areas).tolist() if areas[i] > 0]
    loops_of_face: dict[int, list[int]] = {i: [i] for i in outer}
    for hole in np.flatnonzero(areas <= 0).tolist():
        around = [i for i in outer if point_in_polygon(polygons[i], polygons[hole][0])]
        if not around:
            raise UnsupportedFace("has a hole outside every outer loop after it was cut")
        loops_of_face[around[0]].append(hole)
    return list(loops_of_face.values())


def chain_loops(ends: Sequence[tuple[Hashable, Hashable]], gap: Callable[[int, int], float]) -> list[list[int]]:
    """Loops of half-edges, by their numbers, chained by their start and end vertices.

    Of several successors the one with the least gap follows, `gap(last, following)`, which is infinite if it cannot follow.
    """
    waiting = list(range(len(ends)))
    loops = []
    while waiting:
        loop = [waiting.pop(0)]
        while True:
            last = loop[-1]
            options = {i: gap(last, i) for i in [*waiting, loop[0]] if ends[i][0] == ends[last][1]}
            best = min(options, key=options.__getitem__, default=None)
            if best is None or not np.isfinite(options[best]):
                raise UnsupportedFace("has a boundary that does not close")
            if best == loop[0]:
                break
            loop.append(best)
            waiting.remove(best)
        loops.append(loop)
    return loops


def _use_vertices(body: ImportedBody, use: ImportedUse) -> tuple[int, int]:
    """Start and end vertex of a half-edge."""
    edge = body.edges[use.edge]
    return (edge.start, edge.end) if use.sense > 0 else (edge.end, edge.start)


def _use_gap(body: ImportedBody, face: ImportedFace, use: ImportedUse, end: Array, begin: Array) -> float:
    """Distance in (u, v) from the end of one half-edge to the start of another.

    Along a pole it is the step in the direction that keeps the face on the left, or infinity.
    """
    u_sense = pole_direction(body, face, use)
    if not u_sense:
        return float(np.abs(begin - end).max())
    step = (begin[0] - end[0]) * u_sense
    return float(step) if step > ANGLE_TOL else np.inf


MIN_CUT_CLEARANCE = 0.05
"""Radians between a cut and the nearest vertex or turning point of an edge; the cut is shifted for it if possible."""

MAX_CUT_SHIFT = 0.8
"""Radians by which a cut may be shifted from its default position."""


@dataclass(frozen=True, slots=True)
class _CutCrossing:
    """Intersection of the cut with the boundary: its place along the cut, and an edge with parameter or a vertex at a pole."""

    cut_parameter: float
    edge: int
    edge_parameter: float
    vertex: int


def split_closed_faces(body: ImportedBody) -> ImportedBody:
    """The body with every face that has a seam cut in two, tori twice."""
    index = 0
    while index < len(body.faces):
        axis = _seam_axis(body.faces[index])
        if axis is None:
            index += 1
        else:
            body = _split_face(body, index, axis)
    return body


def _seam_axis(face: ImportedFace) -> int | None:
    """The parameter, 0 or 1, in which the face is closed; None if it has no seam."""
    if isinstance(face.carrier, Plane):
        return None
    uses = [use for loop in face.loops for use in loop]
    for edge, count in Counter(use.edge for use in uses).items():
        if count == 2:
            first, second = (use.mid_parameters for use in uses if use.edge == edge)
            assert first is not None
            assert second is not None
            apart = np.abs(first - second)
            for axis, period in enumerate(face.carrier.period):
                if period and apart[axis] > 0.5 * period:
                    return axis
            raise UnsupportedFace("has an edge that bounds it twice without being a seam")
    return None


def _split_face(body: ImportedBody, index: int, axis: int) -> ImportedBody:
    """The body with one face cut along the isoparametric line of one parameter."""
    face = body.faces[index]
    at = _choose_cut(body, face, axis)
    crossings = _find_crossings(body, face, axis, at)
    body, vertex_of = _split_edges(body, crossings)
    face = body.faces[index]
    ends = sorted((c.cut_parameter, c.vertex if c.edge < 0 else vertex_of[c.edge, c.edge_parameter]) for c in crossings)
    if len(ends) % 2 or not ends:
        raise UnsupportedFace("meets the cut opposite to its seam an odd number of times")
    carrier = face.carrier
    assert not isinstance(carrier, Plane)
    edges, new = list(body.edges), []
    for (low, start), (high, end) in zip(ends[0::2], ends[1::2], strict=True):
        new.append((len(edges), np.array([at, 0.5 * (low + high)] if axis == 0 else [0.5 * (low + high), at])))
        edges.append(ImportedEdge(_isoparametric_curve(carrier, axis, at, low, high), (low, high), start, end))
    body = replace(body, edges=tuple(edges))
    parts: list[ImportedFace] = []
    for below in (True, False):
        # Left of the cut is lower u for a cut along increasing v, and higher v for one along increasing u.
        along = 1 if below == (axis == 0) else -1
        uses = [ImportedUse(e, along, near) for e, near in new]
        uses += [
            u
            for loop in face.loops
            for u in loop
            if u.mid_parameters is not None and (u.mid_parameters[axis] < at) == below
        ]
        parts += split_into_faces(body, face, uses)
    return replace(body, faces=(*body.faces[:index], *parts, *body.faces[index + 1 :]))


def _choose_cut(body: ImportedBody, face: ImportedFace, axis: int) -> float:
    """Parameter of the cut: half a period from the seam, shifted if a vertex is close.

    A cut through a vertex is allowed, a cut close to one is not, nor one along an edge.
    """
    traces = [sample_use(body, face, use)[:, axis] for loop in face.loops for use in loop]
    values = np.concatenate(traces)
    middle = 0.5 * (values.min() + values.max())
    vertices = np.concatenate([t[[0, -1]] for t in traces])
    turns = np.concatenate([t[1:-1][np.diff(t)[1:] * np.diff(t)[:-1] < 0] for t in traces])
    turns = np.concatenate([turns, [t[0] for t in traces if np.ptp(t) < VERTEX_HIT_TOL]])
    assert not isinstance(face.carrier, Plane)
    turn = face.carrier.period[axis] / TWO_PI
    aside = MAX_CUT_SHIFT * turn * np.linspace(-1.0, 1.0, 41)
    places = middle + aside[np.argsort(np.abs(aside), kind="stable")]
    off = np.abs(places[:, None] - np.concatenate([vertices, turns]))
    off[:, : len(vertices)][off[:, : len(vertices)] < VERTEX_HIT_TOL] = np.inf
    clear = off.min(axis=1)
    return float(
        places[int(np.argmax(clear > MIN_CUT_CLEARANCE * turn))]
        if (clear > MIN_CUT_CLEARANCE * turn).any()
        else places[int(np.argmax(clear))]
    )


def _find_crossings(body: ImportedBody, face: ImportedFace, axis: int, at: float) -> list[_CutCrossing]:
    """Points at which the boundary crosses the cut: inside edges, at vertices and at poles."""
    found = []
    for loop in face.loops:
        offs = [_offsets_from_cut(body, face, use, axis, at) for use in loop]
        for i, use in enumerate(loop):
            t, off = offs[i]
            side = np.where(off > 0, 1, -1)
            side[[0, -1]] = side[[1, -2]]  # the ends of edges are treated as vertices

            def distance(s: float, use: ImportedUse = use) -> float:
                return float(sample_use(body, face, use, np.array([s]))[0, axis] - at)

            for k in np.flatnonzero(side[:-1] != side[1:]).tolist():
                there = np.array([distance(t[k]), distance(t[k + 1])])
                nearest = int(np.abs(there).argmin())
                if (
                    np.abs(there[nearest]) < ROUND_OFF_TOL
                ):  # single evaluations differ in the last digits from batched ones
                    root = float(t[k + nearest])
                elif there[0] * there[1] > 0:
                    raise UnsupportedFace("has an edge that ends too close to the cut opposite to its seam")
                else:
                    root = float(brentq(distance, t[k], t[k + 1], xtol=1e-15 * max(1.0, abs(t[k]))))
                along = float(sample_use(body, face, use, np.array([root]))[0, 1 - axis])
                found.append(_CutCrossing(along, use.edge, root, -1))
            before, begin = sample_use(body, face, loop[i - 1])[-1], sample_use(body, face, use)[0]
            last = offs[i - 1][1][-2 if loop[i - 1].sense > 0 else 1]
            first = off[1 if use.sense > 0 else -2]
            on_vertex = abs(begin[axis] - at) < VERTEX_HIT_TOL and last * first < 0
            over_pole = axis == 0 and pole_direction(body, face, use) and (before[0] - at) * (begin[0] - at) < 0
            if on_vertex or over_pole:
                edge = body.edges[use.edge]
                found.append(_CutCrossing(float(begin[1 - axis]), -1, 0.0, edge.start if use.sense > 0 else edge.end))
    return found


def _offsets_from_cut(
    body: ImportedBody, face: ImportedFace, use: ImportedUse, axis: int, at: float
) -> tuple[Array, Array]:
    """Parameters along an edge, and its signed offset from the cut there."""
    t = np.linspace(*body.edges[use.edge].span, 2 * HALF_INTERVALS_PER_EDGE + 1)
    return t, sample_use(body, face, use, t)[:, axis] - at


VERTEX_HIT_TOL = 1e-9
"""Radians within which a cut passes through a vertex."""

ROUND_OFF_TOL = 1e-14
"""Radians (also for v of a torus) of round-off in surface parameters."""

HALF_INTERVALS_PER_EDGE = 32
"""Half the number of intervals per edge in which crossings are sought."""


def _split_edges(
    body: ImportedBody, crossings: list[_CutCrossing]
) -> tuple[ImportedBody, dict[tuple[int, float], int]]:
    """The body with edges split at the crossings in all faces, and the new vertex of each (edge, parameter)."""
    vertices, edges = list(body.vertices), list(body.edges)
    vertex_of: dict[tuple[int, float], int] = {}
    pieces: dict[int, list[int]] = {}
    for e in sorted({c.edge for c in crossings if c.edge >= 0}):
        edge = body.edges[e]
        low, high = edge.span
        cuts: list[float] = []
        at: list[int] = []
        for t in sorted(c.edge_parameter for c in crossings if c.edge == e):
            if not cuts or t - cuts[-1] > ANGLE_TOL * (high - low):  # both half-edges of a seam report it
                cuts.append(t)
                at.append(len(vertices))
                vertices.append(edge.curve(t))
            vertex_of[e, t] = at[-1]
        ends = [edge.start, *at, edge.end]
        spans = [low, *cuts, high]
        pieces[e] = [e, *range(len(edges), len(edges) + len(cuts))]
        edges += [edge] * len(cuts)
        for k, piece in enumerate(pieces[e]):
            edges[piece] = ImportedEdge(edge.curve, (spans[k], spans[k + 1]), ends[k], ends[k + 1])

    def expanded(face: ImportedFace, use: ImportedUse) -> list[ImportedUse]:
        if use.edge not in pieces:
            return [use]
        parts = []
        for piece in pieces[use.edge]:
            near = None
            if use.mid_parameters is not None:
                near = sample_use(body, face, use, np.array([0.5 * sum(edges[piece].span)]))[0]
            parts.append(ImportedUse(piece, use.sense, near))
        return parts if use.sense > 0 else parts[::-1]

    faces = tuple(
        replace(f, loops=tuple(tuple(u for use in loop for u in expanded(f, use)) for loop in f.loops))
        if any(use.edge in pieces for loop in f.loops for use in loop)
        else f
        for f in body.faces
    )
    return replace(body, vertices=tuple(vertices), edges=tuple(edges), faces=faces), vertex_of


def _isoparametric_curve(
    carrier: Quadric | FreeFormSurface, axis: int, at: float, low: float, high: float
) -> EdgeCurve:
    """Isoparametric curve of the carrier where parameter `axis` is `at`, parametrised by the other one."""
    if isinstance(carrier, FreeFormSurface):
        return isoparametric_curve(carrier.spline, axis, at)
    if isinstance(carrier, CylindricalSurface | ConicalSurface):
        return line_segment(carrier(at, low), carrier(at, high), (low, high))
    if axis == 1:
        ring = carrier(0.0, at) - carrier.origin
        height = float(ring @ carrier.axis)
        return Circle(
            carrier.origin + height * carrier.axis, carrier.x_axis, carrier.axis, float(ring @ carrier.x_axis)
        )
    away = np.cos(at) * carrier.x_axis + np.sin(at) * carrier.y_axis
    major = getattr(carrier, "major", 0.0)
    radius = carrier.minor if hasattr(carrier, "minor") else carrier.radius
    return Circle(carrier.origin + major * away, away, np.cross(away, carrier.axis), radius)

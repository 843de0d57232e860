"""What uses laid out in a face's parameters bound: loops chained by vertices, and which of them are holes in which.

Faces that close on themselves are cut opposite their seams, so that a patch complex, which has no seams, can hold them.

The cut runs along u = const (or v = const on a torus). Edges that it crosses get a vertex there, in all faces; the line's pieces
within the face become edges: lines on cylinders and cones, circles on spheres and tori.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import brentq

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, ConicalSurface, CylindricalSurface, EdgeCurve, Plane, Quadric
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
from tpmscad.splines.bspline import line_segment


def split_into_faces(body: ImportedBody, face: ImportedFace, uses: list[ImportedUse]) -> list[ImportedFace]:
    """The faces that uses laid out in (u, v) bound, each region on its uses' left."""
    loops = _chain_loops(body, face, uses)
    polygons = [loop_polygon(body, face, loop) for loop in loops]
    areas = np.array([signed_area(p) for p in polygons])
    outer = [i for i in np.argsort(areas).tolist() if areas[i] > 0]
    held: dict[int, list[int]] = {i: [i] for i in outer}
    for hole in np.flatnonzero(areas <= 0).tolist():
        around = [i for i in outer if point_in_polygon(polygons[i], polygons[hole][0])]
        if not around:
            raise UnsupportedFace("falls apart when it is cut")
        held[around[0]].append(hole)
    return [replace(face, loops=tuple(loops[i] for i in members)) for members in held.values()]


def _chain_loops(body: ImportedBody, face: ImportedFace, uses: list[ImportedUse]) -> list[tuple[ImportedUse, ...]]:
    """The uses chained by their vertices, and where these are not enough by (u, v)."""
    ends = {id(use): sample_use(body, face, use)[[0, -1]] for use in uses}
    waiting = list(uses)
    loops = []
    while waiting:
        loop = [waiting.pop(0)]
        first = _use_vertices(body, loop[0])[0]
        while True:
            vertex, end = _use_vertices(body, loop[-1])[1], ends[id(loop[-1])][1]
            following = [u for u in waiting if _use_vertices(body, u)[0] == vertex]
            options = {id(u): _use_gap(body, face, u, end, ends[id(u)][0]) for u in following}
            closing = _use_gap(body, face, loop[0], end, ends[id(loop[0])][0]) if vertex == first else np.inf
            best = min(following, key=lambda u: options[id(u)], default=None)
            if best is None or closing < options[id(best)]:
                if not np.isfinite(closing):
                    raise UnsupportedFace("has a border that does not close")
                break
            loop.append(best)
            waiting.remove(best)
        loops.append(tuple(loop))
    return loops


def _use_vertices(body: ImportedBody, use: ImportedUse) -> tuple[int, int]:
    edge = body.edges[use.edge]
    return (edge.start, edge.end) if use.sense > 0 else (edge.end, edge.start)


def _use_gap(body: ImportedBody, face: ImportedFace, use: ImportedUse, end: Array, begin: Array) -> float:
    """How far a use begins from where another ends: in (u, v), or along a pole in the way that keeps the face on the left."""
    way = pole_direction(body, face, use)
    if not way:
        return float(np.abs(begin - end).max())
    step = (begin[0] - end[0]) * way
    return float(step) if step > ANGLE_TOL else np.inf


MIN_CUT_CLEARANCE = 0.05
"""Radians that a cut stays away from vertices, and from where edges turn back, if it can: it is moved by up to `ASIDE`."""

MAX_CUT_SHIFT = 0.8


@dataclass(frozen=True, slots=True)
class _CutCrossing:
    """Where the cut meets the border: along the cut, and the edge with its parameter, or the vertex at a pole."""

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
    """The parameter that runs once around the face, if there is one: 0 or 1."""
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
            raise UnsupportedFace("has an edge on both sides of which it lies")
    return None


def _split_face(body: ImportedBody, index: int, axis: int) -> ImportedBody:
    """The body with one face cut along a line of its parameters, where that one is constant."""
    face = body.faces[index]
    at = _choose_cut(body, face, axis)
    crossings = _find_crossings(body, face, axis, at)
    body, vertex_of = _split_edges(body, crossings)
    face = body.faces[index]
    ends = sorted((c.cut_parameter, c.vertex if c.edge < 0 else vertex_of[c.edge, c.edge_parameter]) for c in crossings)
    if len(ends) % 2 or not ends:
        raise UnsupportedFace("is cut by a line an odd number of times")
    carrier = face.carrier
    assert not isinstance(carrier, Plane)
    edges, new = list(body.edges), []
    for (low, start), (high, end) in zip(ends[0::2], ends[1::2], strict=True):
        new.append((len(edges), np.array([at, 0.5 * (low + high)] if axis == 0 else [0.5 * (low + high), at])))
        edges.append(ImportedEdge(_isoparametric_curve(carrier, axis, at, low, high), (low, high), start, end))
    body = replace(body, edges=tuple(edges))
    parts: list[ImportedFace] = []
    for below in (True, False):
        # The line has its left at lower u (upwards along v), but at higher v (upwards along u).
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
    """Where to cut: half way around from the seam, or aside where that is too near to a vertex, unless it hits it."""
    traces = [sample_use(body, face, use)[:, axis] for loop in face.loops for use in loop]
    values = np.concatenate(traces)
    middle = 0.5 * (values.min() + values.max())
    vertices = np.concatenate([t[[0, -1]] for t in traces])
    turns = np.concatenate([t[1:-1][np.diff(t)[1:] * np.diff(t)[:-1] < 0] for t in traces])
    aside = MAX_CUT_SHIFT * np.linspace(-1.0, 1.0, 41)
    places = middle + aside[np.argsort(np.abs(aside), kind="stable")]
    off = np.abs(places[:, None] - np.concatenate([vertices, turns]))
    off[:, : len(vertices)][off[:, : len(vertices)] < VERTEX_HIT_TOL] = np.inf
    clear = off.min(axis=1)
    return float(
        places[int(np.argmax(clear > MIN_CUT_CLEARANCE))]
        if (clear > MIN_CUT_CLEARANCE).any()
        else places[int(np.argmax(clear))]
    )


def _find_crossings(body: ImportedBody, face: ImportedFace, axis: int, at: float) -> list[_CutCrossing]:
    """Where the border passes from one side of the line to the other: within edges, at vertices, at poles."""
    found = []
    for loop in face.loops:
        offs = [_offsets_from_cut(body, face, use, axis, at) for use in loop]
        for i, use in enumerate(loop):
            t, off = offs[i]
            side = np.where(off > 0, 1, -1)
            side[[0, -1]] = side[[1, -2]]  # what happens at the ends is the vertices' affair

            def distance(s: float, use: ImportedUse = use) -> float:
                return float(sample_use(body, face, use, np.array([s]))[0, axis] - at)

            for k in np.flatnonzero(side[:-1] != side[1:]).tolist():
                there = np.array([distance(t[k]), distance(t[k + 1])])
                nearest = int(np.abs(there).argmin())
                if np.abs(there[nearest]) < ROUND_OFF_TOL:  # one by one, points get other last digits than together
                    root = float(t[k + nearest])
                elif there[0] * there[1] > 0:
                    raise UnsupportedFace("is cut by a line too near to where an edge ends")
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
    """Parameters along an edge, and how far beyond the line it is there."""
    t = np.linspace(*body.edges[use.edge].span, 2 * HALF_INTERVALS_PER_EDGE + 1)
    return t, sample_use(body, face, use, t)[:, axis] - at


VERTEX_HIT_TOL = 1e-9
"""Radians within which a cut passes through a vertex."""

ROUND_OFF_TOL = 1e-14
"""Radians (of a torus's v too) that round-off comes to."""

HALF_INTERVALS_PER_EDGE = 32
"""Half the intervals of an edge in which a cut is looked for."""


def _split_edges(
    body: ImportedBody, crossings: list[_CutCrossing]
) -> tuple[ImportedBody, dict[tuple[int, float], int]]:
    """The body with edges split at the crossings, in all faces; the new vertex of each (edge, parameter)."""
    vertices, edges = list(body.vertices), list(body.edges)
    vertex_of: dict[tuple[int, float], int] = {}
    pieces: dict[int, list[int]] = {}
    for e in sorted({c.edge for c in crossings if c.edge >= 0}):
        edge = body.edges[e]
        low, high = edge.span
        cuts: list[float] = []
        at: list[int] = []
        for t in sorted(c.edge_parameter for c in crossings if c.edge == e):
            if not cuts or t - cuts[-1] > ANGLE_TOL * (high - low):  # both sides of a seam find it
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


def _isoparametric_curve(carrier: Quadric, axis: int, at: float, low: float, high: float) -> EdgeCurve:
    """The carrier's curve along which one parameter is `at`, on the other one's interval, with that for its parameter."""
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

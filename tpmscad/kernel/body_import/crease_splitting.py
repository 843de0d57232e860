"""Splitting of the kernel's faces at creases of their surfaces, so that each part lies on a smooth surface.

A crease is a line u = const or v = const of a spline across which the tangent plane turns. The boundary of the face is
intersected with the line in the parameter plane, edges that cross it are split in all faces, and the pieces of the line inside
the face become edges between its parts. The half-edges on each side are chained into loops. Nothing is moved.

A face that is closed, and has a crease at its seam, is split half-way round as well: it has no period.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepTools import BRepTools_WireExplorer
from OCP.Geom2d import Geom2d_Curve
from OCP.TopAbs import TopAbs_EDGE, TopAbs_FORWARD, TopAbs_REVERSED, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Vertex, TopoDS_Wire
from scipy.optimize import brentq

from tpmscad._typing import Array
from tpmscad.brep.free_form_surface import find_smooth_seams
from tpmscad.brep.loops import point_in_polygon
from tpmscad.kernel.body_import.closed_face_splitting import chain_loops, nest_loops
from tpmscad.kernel.body_import.free_form_carriers import CreasedSurface, find_creases, restrict_between
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import ShapeKey, first_vertex, last_vertex, list_subshapes, orientation_sign
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace
from tpmscad.splines.bspline import isoparametric_curve

INTERVALS_PER_EDGE = 64
"""Intervals of an edge in which its crossings with a crease are sought."""

SAME_PARAMETER = 1e-7
"""Of an edge's range, or of the box of a face's parameters: places that are nearer to each other are one."""

Loop = list[TopoDS_Edge]
"""Half-edges of a face, counter-clockwise about S_u x S_v."""


@dataclass(frozen=True, slots=True, eq=False)
class WiredFace:
    """A face of the kernel, or a part of one, with its loops, and the number of the face in the body."""

    face: TopoDS_Face
    loops: list[Loop]
    source: int


def _list_loops(face: TopoDS_Face) -> list[Loop]:
    """Half-edges of a face loop by loop, in order."""
    forward = convert.as_face(face.Oriented(TopAbs_FORWARD))
    loops = []
    for shape in list_subshapes(forward, TopAbs_WIRE):
        wire = convert.as_wire(shape)
        walk, loop = BRepTools_WireExplorer(wire, forward), []
        while walk.More():
            loop.append(walk.Current())
            walk.Next()
        if len(loop) != len(list_subshapes(wire, TopAbs_EDGE)):
            raise UnsupportedFace("has a wire whose edges are not connected in order")
        loops.append(loop)
    return loops


def list_whole_faces(faces: Sequence[TopoDS_Face]) -> list[WiredFace]:
    """The faces as they are."""
    return [WiredFace(face, _list_loops(face), i) for i, face in enumerate(faces)]


def split_at_creases(faces: Sequence[TopoDS_Face], size: float, greatest_turn: float = math.inf) -> list[WiredFace]:
    """The faces with those that have creases replaced by their parts, on splines, in a body of a size.

    greatest_turn: of the normals of a spline along a parameter, radians; faces that turn more are split as well.
    """
    body = list_whole_faces(faces)
    for number, face in enumerate(faces):
        creased = find_creases(face, size, greatest_turn)
        if creased is not None:
            at = next(i for i, part in enumerate(body) if part.source == number)
            body[at : at + 1] = _split_face(body, at, creased, size)
    return body


def _split_face(body: list[WiredFace], index: int, creased: CreasedSurface, size: float) -> list[WiredFace]:
    """The parts of a face; edges of the whole body that cross a crease are split in place."""
    whole = body[index]
    sheet = _Sheet(convert.as_face(whole.face.Oriented(TopAbs_FORWARD)), creased, size)
    parts = [whole.loops]
    for axis in (0, 1):
        for at in _list_cuts(sheet, whole.loops, axis):
            body[index] = WiredFace(whole.face, [loop for part in parts for loop in part], whole.source)
            counts = [len(part) for part in parts]
            lines = [_find_crossings(sheet, part, axis, at) for part in parts]
            _split_edges(body, [crossing for line in lines for crossing in line], size)
            loops = iter(body[index].loops)
            parts = [[next(loops) for _ in range(count)] for count in counts]
            parts = [piece for part in parts for piece in _cut_loops(sheet, part, axis, at)]
    return [WiredFace(_make_part(sheet, part, whole), part, whole.source) for part in parts]


@dataclass(frozen=True, slots=True, eq=False)
class _Sheet:
    """A face to be split, forward, with the creases of its surface; what its edges look like in its parameters."""

    face: TopoDS_Face
    creased: CreasedSurface
    size: float
    traces: dict[tuple[ShapeKey, int], tuple[Array, Array]] = field(default_factory=dict)

    def trace(self, use: TopoDS_Edge) -> tuple[Array, Array]:
        """Parameters (n,) along an edge, ascending, and (u, v) there: (n, 2)."""
        key = ShapeKey(use), orientation_sign(use)
        if key not in self.traces:
            low, high = BRep_Tool.Range_s(use, self.face)
            t = np.linspace(low, high, INTERVALS_PER_EDGE + 1)
            curve = self.curve(use)
            self.traces[key] = t, np.array([_coordinates(curve, s) for s in t.tolist()])
        return self.traces[key]

    def curve(self, use: TopoDS_Edge) -> Geom2d_Curve:
        """The pcurve of a half-edge."""
        return BRep_Tool.CurveOnSurface_s(use, self.face, 0.0, 1.0)

    def polygon(self, loop: Loop) -> Array:
        """(u, v) along a loop: (n, 2)."""
        return np.concatenate([self.trace(use)[1][:: orientation_sign(use)] for use in loop])

    def is_on(self, uv: Array, axis: int, at: float, tol: float) -> Array:
        """Whether points with parameters (n, 2) are within `tol` of the line on which parameter `axis` is `at`: (n,)."""
        spline = self.creased.spline
        ends = np.array(spline.domain)
        inside = np.clip(uv, ends[:, 0], ends[:, 1])
        slope = np.linalg.norm(spline(inside[:, 0], inside[:, 1], int(axis == 0), int(axis == 1)), axis=1)
        apart = np.abs(uv[:, axis] - at)
        return (apart * slope <= tol) & (apart <= 0.1 * np.ptp(ends[axis])) | (
            apart <= SAME_PARAMETER * np.ptp(ends[axis])
        )


def _coordinates(curve: Geom2d_Curve, t: float) -> tuple[float, float]:
    at = curve.Value(t)
    return at.X(), at.Y()


def _list_cuts(sheet: _Sheet, loops: list[Loop], axis: int) -> list[float]:
    """The creases across the face along a parameter, and half the way round if it has a seam with a crease and no other."""
    cuts: list[float] = sheet.creased.inside[axis].tolist()
    if cuts or find_smooth_seams(sheet.creased.spline)[axis]:
        return cuts
    for use in (use for loop in loops for use in loop):
        if BRep_Tool.IsClosed_s(use, sheet.face):
            ends = [sheet.trace(convert.as_edge(use.Oriented(way)))[1] for way in (TopAbs_FORWARD, TopAbs_REVERSED)]
            if abs(ends[0][0, axis] - ends[1][0, axis]) > abs(ends[0][0, 1 - axis] - ends[1][0, 1 - axis]):
                return [0.5 * float(ends[0][0, axis] + ends[1][0, axis])]
    return cuts


@dataclass(frozen=True, slots=True)
class _Crossing:
    """A point in which an edge crosses a crease: the edge, and its parameter."""

    edge: TopoDS_Edge
    t: float


def _snap(sheet: _Sheet, use: TopoDS_Edge) -> float:
    """Distance of an edge from a crease below which it lies on it."""
    return max(CONFUSION_TOLERANCE, 1e-9 * sheet.size, min(float(BRep_Tool.Tolerance_s(use)), 1e-5 * sheet.size))


def _find_crossings(sheet: _Sheet, loops: list[Loop], axis: int, at: float) -> list[_Crossing]:
    """Where edges cross the line on which parameter `axis` is `at`, between their ends."""
    found = []
    for use in (use for loop in loops for use in loop):
        t, uv = sheet.trace(use)
        on = sheet.is_on(uv, axis, at, _snap(sheet, use))
        if on.all():
            continue
        side = np.where(uv[:, axis] > at, 1, -1)
        for end, beside in ((0, 1), (-1, -2)):
            if on[end]:
                side[end] = side[beside]
        curve = sheet.curve(use)
        for k in np.flatnonzero(side[:-1] != side[1:]).tolist():
            ends = uv[[k, k + 1], axis] - at
            if ends[0] * ends[1] < 0:
                root = float(brentq(lambda s, c=curve: _coordinates(c, s)[axis] - at, t[k], t[k + 1]))
            else:
                root = float(t[k + int(np.abs(ends).argmin())])
            found.append(_Crossing(use, root))
    return found


def _split_edges(body: list[WiredFace], crossings: Sequence[_Crossing], size: float) -> None:
    """Split the edges at crossings in all faces of the body, in place."""
    builder = BRep_Builder()
    edges = {ShapeKey(c.edge): convert.as_edge(c.edge.Oriented(TopAbs_FORWARD)) for c in crossings}
    pieces: dict[ShapeKey, list[TopoDS_Edge]] = {}
    for key, edge in edges.items():
        low, high = BRep_Tool.Range_s(edge)
        cuts: list[float] = []
        for t in sorted(c.t for c in crossings if ShapeKey(c.edge) == key):
            if t - (cuts[-1] if cuts else low) > SAME_PARAMETER * (high - low):  # both half-edges of a seam report it
                cuts.append(t)
        vertices = [first_vertex(edge)]
        for t in cuts:
            vertex = vertices[0]
            if not BRep_Tool.Degenerated_s(edge):
                vertex = TopoDS_Vertex()
                point = BRepAdaptor_Curve(edge).Value(t)
                builder.MakeVertex(vertex, point, float(BRep_Tool.Tolerance_s(edge)))
            vertices.append(vertex)
        vertices.append(last_vertex(edge))
        ends = [low, *cuts, high]
        pieces[key] = []
        for k in range(len(cuts) + 1):
            piece = convert.as_edge(edge.EmptyCopied())
            builder.Add(piece, vertices[k].Oriented(TopAbs_FORWARD))
            builder.Add(piece, vertices[k + 1].Oriented(TopAbs_REVERSED))
            builder.Range(piece, ends[k], ends[k + 1])
            pieces[key].append(piece)
    if not pieces:
        return
    for i, wired in enumerate(body):
        if any(ShapeKey(use) in pieces for loop in wired.loops for use in loop):
            loops = [[part for use in loop for part in _expand(use, pieces)] for loop in wired.loops]
            face = convert.as_face(wired.face.Oriented(TopAbs_FORWARD).EmptyCopied())
            body[i] = WiredFace(_add_wires(face, loops, wired.face), loops, wired.source)


def _expand(use: TopoDS_Edge, pieces: dict[ShapeKey, list[TopoDS_Edge]]) -> list[TopoDS_Edge]:
    """The parts of a half-edge in its direction."""
    found = pieces.get(ShapeKey(use))
    if found is None:
        return [use]
    return [convert.as_edge(part.Oriented(use.Orientation())) for part in found[:: orientation_sign(use)]]


def _cut_loops(sheet: _Sheet, loops: list[Loop], axis: int, at: float) -> list[list[Loop]]:
    """The loops of each part of a region that the line on which parameter `axis` is `at` divides; no edge crosses it."""
    uses = [use for loop in loops for use in loop]
    on_line = [bool(sheet.is_on(sheet.trace(use)[1], axis, at, _snap(sheet, use)).all()) for use in uses]
    new = _make_crease_edges(sheet, loops, on_line, axis, at)
    if not new:
        return [loops]
    parts: list[list[Loop]] = []
    for below in (True, False):
        # Left of the line is lower u for one along increasing v, and higher v for one along increasing u.
        along = below == (axis == 0)
        chosen = [convert.as_edge(edge.Oriented(TopAbs_FORWARD if along else TopAbs_REVERSED)) for edge in new]
        for use, on in zip(uses, on_line, strict=True):
            _, uv = sheet.trace(use)
            if on:
                forward = (uv[-1, 1 - axis] > uv[0, 1 - axis]) == (orientation_sign(use) > 0)
                is_below = forward == (axis == 0)
            else:
                off = uv[:, axis] - at
                is_below = bool(off[np.abs(off).argmax()] < 0)
            if is_below == below:
                chosen.append(use)
        parts += _chain(sheet, chosen)
    return parts


def _chain(sheet: _Sheet, uses: list[TopoDS_Edge]) -> list[list[Loop]]:
    """The loops of each face that half-edges bound, which lies to their left."""
    ends = [_list_ends(use) for use in uses]
    tips = [sheet.trace(use)[1][[0, -1]][:: orientation_sign(use)] for use in uses]
    span = np.ptp(np.array(sheet.creased.spline.domain), axis=1)

    def gap(last: int, following: int) -> float:
        return float(np.abs((tips[following][0] - tips[last][1]) / span).max())

    loops = [[uses[i] for i in loop] for loop in chain_loops(ends, gap)]
    return [[loops[i] for i in of] for of in nest_loops([sheet.polygon(loop) for loop in loops])]


def _list_ends(use: TopoDS_Edge) -> tuple[ShapeKey, ShapeKey]:
    """The vertices at the start and the end of a half-edge."""
    start, end = ShapeKey(first_vertex(use)), ShapeKey(last_vertex(use))
    return (start, end) if orientation_sign(use) > 0 else (end, start)


def _make_crease_edges(
    sheet: _Sheet, loops: list[Loop], on_line: list[bool], axis: int, at: float
) -> list[TopoDS_Edge]:
    """Edges of the line on which parameter `axis` is `at` inside a region, directed along the other parameter."""
    nodes: list[tuple[float, TopoDS_Vertex]] = []
    borders: list[tuple[float, float]] = []
    tiny = SAME_PARAMETER * float(np.ptp(sheet.creased.spline.domain[1 - axis]))
    for use, on in zip((use for loop in loops for use in loop), on_line, strict=True):
        _, uv = sheet.trace(use)
        if on:
            low, high = sorted(uv[[0, -1], 1 - axis].tolist())
            borders.append((low, high))
        at_line = sheet.is_on(uv[[0, -1]], axis, at, _snap(sheet, use))
        for end, vertex in ((0, first_vertex(use)), (-1, last_vertex(use))):
            place = float(uv[end, 1 - axis])
            if at_line[end] and not any(
                vertex.IsSame(known) and abs(place - other) <= 1e4 * tiny for other, known in nodes
            ):
                nodes.append((place, vertex))
    nodes.sort(key=lambda node: node[0])
    polygons = [sheet.polygon(loop) for loop in loops]
    builder, result = BRep_Builder(), []
    for (low, start), (high, end) in zip(nodes[:-1], nodes[1:], strict=True):
        middle = 0.5 * (low + high)
        if high - low <= tiny or any(a - tiny <= middle <= b + tiny for a, b in borders):
            continue
        point = np.array([at, middle] if axis == 0 else [middle, at])
        if sum(point_in_polygon(polygon, point) for polygon in polygons) % 2 == 0:
            continue
        edge = TopoDS_Edge()
        builder.MakeEdge(edge, convert.curve(isoparametric_curve(sheet.creased.spline, axis, at)), CONFUSION_TOLERANCE)
        base, along = np.zeros(2), np.zeros(2)
        base[axis], along[1 - axis] = at, 1.0
        builder.UpdateEdge(edge, convert.line_2d(base, base + along), sheet.face, CONFUSION_TOLERANCE)
        builder.Add(edge, start.Oriented(TopAbs_FORWARD))
        builder.Add(edge, end.Oriented(TopAbs_REVERSED))
        builder.Range(edge, low, high)
        result.append(edge)
    return result


def _make_part(sheet: _Sheet, loops: list[Loop], whole: WiredFace) -> TopoDS_Face:
    """A part of a face on the part of its surface between creases."""
    polygon = np.concatenate([sheet.polygon(loop) for loop in loops])
    middle = 0.5 * (polygon.min(axis=0) + polygon.max(axis=0))
    spline = restrict_between(sheet.creased.spline, sheet.creased.creases, middle)
    builder, part = BRep_Builder(), TopoDS_Face()
    builder.MakeFace(part, convert.surface(spline), CONFUSION_TOLERANCE)
    uses = [use for loop in loops for use in loop]
    for i, use in enumerate(uses):
        twins = [other for other in uses if other.IsSame(use)]
        if len(twins) == 1:
            builder.UpdateEdge(use, sheet.curve(use), part, CONFUSION_TOLERANCE)
        elif not any(other.IsSame(use) for other in uses[:i]):
            first, second = (sheet.curve(convert.as_edge(use.Oriented(w))) for w in (TopAbs_FORWARD, TopAbs_REVERSED))
            builder.UpdateEdge(use, first, second, part, CONFUSION_TOLERANCE)
    return _add_wires(part, loops, whole.face)


def _add_wires(face: TopoDS_Face, loops: list[Loop], whole: TopoDS_Face) -> TopoDS_Face:
    """A face, forward and without edges, with loops and the orientation of another one."""
    builder = BRep_Builder()
    for loop in loops:
        wire = TopoDS_Wire()
        builder.MakeWire(wire)
        for use in loop:
            builder.Add(wire, use)
        wire.Closed(True)
        builder.Add(face, wire)
    return convert.as_face(face.Oriented(whole.Orientation()))

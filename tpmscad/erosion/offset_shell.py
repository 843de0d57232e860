"""The offset shell of a body: its sheets, and the rims along which neighbouring sheets join smoothly.

A rim is the offset of a smooth edge, a side of a tube, or an arc between two tubes or between a tube and the sphere of a
corner. At a convex edge the domains of the sheets end without a rim: no point there is as deep as the skin.

An open face is a sheet of its own, without an offset. A face with a skin goes on beyond its edge with an open one, by a strip of
its domain, so that the two sheets cross; where this would make the skin too thick, a tube round the edge ends it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Circle, EdgeCurve
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.brep.loops import signed_area
from tpmscad.erosion.face_regions import build_regions, list_carriers
from tpmscad.erosion.sheets import Sheet, Tube, TubeEnd, make_ball, make_tube, offset_face
from tpmscad.erosion.sites import BORDER_REL_TOL, BodySites, EdgeSite, FaceSite, OpenSite, Site, VertexSite, depth_limit
from tpmscad.errors import NoOffset, TrimmingError, format_point
from tpmscad.splines.adaptive_curve_fit import FIT_DEGREE, fit_adaptively
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, is_segment, isoparametric_curve, line_segment
from tpmscad.splines.knots import knots_within

SMOOTH_SINE = 1e-6
"""Sine of the angle at an edge below which its faces count as tangent."""

BORDER_SAG = 1e-4
"""In skins: how far the polygons round faces may be off their edges: a tenth of the step at which it is seen whether an edge
leaves a vertex, or an edge would leave it across a border and end in nothing."""

OPEN_RIM_COSINE = 0.72
"""Cosine of the angle between the normals of a face with a skin and an open face above which a tube round their edge ends the
skin; below it the offset face goes on to the open face, where the skin is at most 1.45 times as thick."""

RIM_OVERHANG = 0.2
"""Radians by which a tube round the edge of an open face reaches beyond that face, so that the two surfaces cross."""

MITRE_LENGTH, STRIP_INSET = 1.05, 0.05
"""In skins: how far a face goes on beyond an open one, which a thickness of 1.45 needs; what of it lies in the face itself."""

STRIP_SAMPLES, STRIP_PIECES = 33, 4
"""Points along each side of such a strip, and chords between two of them."""

ROUND_OFF = 1e-9
"""In body sizes: height above an open face that is round-off."""

EDGE_FRACTIONS = np.linspace(0.02, 0.98, 9)
"""Places along an edge at which its angle is measured, and at which known curves are compared; the ends may be apexes."""

SAME_REL_TOL = 1e-11
"""In body sizes: distance within which an offset edge is a line or a circle."""

RIM_REL_TOL = 2e-10
"""In body sizes: tolerance of other rims."""

LINE_TOL = 1e-11
"""Of a range of parameters: how far a pcurve may leave a line of constant u or v."""

OPPOSITE = 1e-7
"""1 + cosine of the angle at a vertex between edges that continue each other."""

ARC_SAMPLES = 257
"""Points along an arc of a sphere's border, where it is a polygon."""


@dataclass(frozen=True, slots=True, eq=False)
class SheetEdge:
    """An edge of two sheets: its curve, their pcurves (None on a plane), and how their loops run along it (+1, -1).

    A rim is one along which the sheets join smoothly.
    """

    curve: EdgeCurve
    span: tuple[float, float]
    sheets: tuple[int, int]
    pcurves: tuple[BSplineCurve | None, BSplineCurve | None]
    senses: tuple[int, int]


@dataclass(frozen=True, slots=True, eq=False)
class OffsetShell:
    """All sheets of a body at a skin, their rims, its sites, and the sheet of each site, or -1 (S,)."""

    sheets: tuple[Sheet, ...]
    rims: tuple[SheetEdge, ...]
    sites: BodySites
    sheet_of_site: IntArray
    skin: float
    size: float

    def rim_parameters(self, rim: SheetEdge, t: Array) -> list[Array]:
        """(u, v) (n, 2) on both sheets of a rim at its parameters t (n,)."""
        found = []
        for s, pcurve in zip(rim.sheets, rim.pcurves, strict=True):
            carrier = self.sheets[s].carrier
            found.append(carrier.parameters(rim.curve(t)) if pcurve is None else pcurve(t))  # type: ignore[union-attr]
        return found


@dataclass(frozen=True, slots=True, eq=False)
class _Joint:
    """An edge between two faces: their uses, and the edge's angle.

    `rise`: sine of the angle, positive where the edge is concave. `cosine`: the greatest between the normals.
    """

    edge: int
    uses: tuple[int, int]
    faces: tuple[int, int]
    rise: Array
    cosine: float


def build_offset_shell(
    brep: Brep, free_form: Mapping[int, FreeFormSurface], skin: float, is_open: BoolArray
) -> OffsetShell:
    """The offset shell of a closed body, whose spline carriers are given with their distances; motions are identities.

    is_open (F,): planar faces without a skin, which bound the eroded body themselves.

    Raises TrimmingError where an edge is concave in one part and convex in another, or a sheet cannot be fitted.
    """
    size = float(np.linalg.norm(np.ptp(brep.vertices, axis=0)))
    carriers = list_carriers(brep, free_form)
    curves = [brep.curves[c] for c in brep.edges.curve.tolist()]
    assembly = _Assembly(brep, carriers, curves, skin, size, is_open)
    assembly.add_faces()
    for joint in assembly.joints:
        if is_open[list(joint.faces)].any():
            assembly.add_open_joint(joint)
        else:
            assembly.add_joint(joint)
    assembly.join_tubes()
    closed_uses = ~is_open[brep.face_of_use]
    closed_edges = brep.uses.edge[closed_uses]
    corners = np.unique([brep.edges.start[closed_edges], brep.edges.end[closed_edges]]).tolist()
    sites = BodySites.of([*assembly.sites, *(VertexSite(brep.vertices[v]) for v in corners)], skin, size)
    sheet_of_site = np.full(len(sites.sites), -1)
    for s, sheet in enumerate(assembly.site_sheets):
        sheet_of_site[s] = sheet
    for vertex, ball in assembly.ball_of_vertex.items():
        sheet_of_site[len(assembly.sites) + corners.index(vertex)] = ball
    return OffsetShell(tuple(assembly.sheets), tuple(assembly.rims), sites, sheet_of_site, skin, size)


class _Assembly:
    """Sheets, sites and rims as they are made, one kind after another."""

    def __init__(
        self,
        brep: Brep,
        carriers: list[BodyCarrier],
        curves: list[EdgeCurve],
        skin: float,
        size: float,
        is_open: BoolArray,
    ):
        self.is_open = is_open
        self.brep, self.carriers, self.curves, self.skin, self.size = brep, carriers, curves, skin, size
        self.sheets: list[Sheet] = []
        self.rims: list[SheetEdge] = []
        self.sites: list[Site] = []
        self.site_sheets: list[int] = []
        self.tubes: list[tuple[int, Tube]] = []
        self.ball_of_vertex: dict[int, int] = {}
        self.joints = self._find_joints()

    def _add_sheet(self, sheet: Sheet) -> int:
        self.sheets.append(sheet)
        return len(self.sheets) - 1

    def add_faces(self) -> None:
        """The sheets and sites of all faces."""
        brep = self.brep
        beyond = min(
            BORDER_REL_TOL * self.size, 0.5 * np.sqrt(self.skin * (self.skin - depth_limit(self.skin, self.size)))
        )
        self.sheet_of_face = np.full(len(brep.faces), -1)
        for f, region in enumerate(build_regions(brep, self.carriers, self.curves, BORDER_SAG * self.skin)):
            sense = int(brep.faces.sense[f])
            strips = tuple(self._make_strip(f, joint) for joint in self.joints if self._needs_strip(f, joint))
            depth = 0.0 if self.is_open[f] else self.skin
            sheet = offset_face(self.carriers[f], sense, (region.segments, *strips), depth, self.size, f)
            self.sheet_of_face[f] = -1 if sheet is None else self._add_sheet(sheet)
            between = (self._trace_strip(self.carriers[f], strip) for strip in strips)
            site = FaceSite(replace(region, border=np.concatenate([region.border, *between])), beyond, strips)
            self.sites.append(OpenSite(site, sense, ROUND_OFF * self.size) if self.is_open[f] else site)
            self.site_sheets.append(int(self.sheet_of_face[f]))

    def _needs_strip(self, face: int, joint: _Joint) -> bool:
        """Whether a face goes on beyond an edge, to the plane of an open face beyond it."""
        if face not in joint.faces or (joint.rise >= -SMOOTH_SINE).any():
            return False
        other = joint.faces[1 - joint.faces.index(face)]
        return bool(self.is_open[other]) and (bool(self.is_open[face]) or joint.cosine <= OPEN_RIM_COSINE)

    def _make_strip(self, face: int, joint: _Joint) -> Array:
        """The polygon (n, 2, 2) in (u, v) of the strip by which a face goes on beyond an edge, and at both ends of it."""
        k = joint.faces.index(face)
        use, carrier, curve = joint.uses[k], self.carriers[face], self.curves[joint.edge]
        low, high = self.brep.edges.span[joint.edge].tolist()
        t = np.linspace(low, high, STRIP_SAMPLES)
        points, tangents = curve(t), curve(t, 1)
        tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
        pcurve = self.brep.uses.pcurve[use]
        uv = carrier.parameters(points) if pcurve < 0 else self.brep.pcurves[pcurve](t)
        into = np.cross(carrier.gradient(points), self.brep.uses.sense[use] * tangents)
        frame = np.stack([carrier(uv[:, 0], uv[:, 1], 1, 0), carrier(uv[:, 0], uv[:, 1], 0, 1)], axis=2)
        lean, slant = np.zeros((STRIP_SAMPLES, 1)), np.zeros((STRIP_SAMPLES, 1))
        for end, (vertex, way) in enumerate(zip(self._ends(joint.edge), (-1.0, 1.0), strict=True)):
            for beside in (j for j in self.joints if j is not joint and vertex in self._ends(j.edge)):
                if self._needs_strip(face, beside):
                    lean[-end, 0] = way
                elif face in beside.faces and (np.abs(beside.rise) <= SMOOTH_SINE).all():
                    along = self._leave(beside.edge, vertex)
                    slant[-end, 0] = (along @ tangents[-end]) / -(along @ into[-end])
        sides = []
        for out in (-STRIP_INSET, 1.0):
            move = MITRE_LENGTH * self.skin * (lean * tangents + out * (slant * tangents - into))
            sides.append(uv + np.einsum("nij,nj->ni", np.linalg.pinv(frame), move))
        path = np.concatenate([sides[0], sides[1][::-1], sides[0][:1]])
        return np.stack([path[:-1], path[1:]], axis=1)

    @staticmethod
    def _trace_strip(carrier: BodyCarrier, strip: Array) -> Array:
        """The border (m, 2, 3) of a strip (n, 2, 2) in space: a foot on the side that two strips share belongs to either."""
        fractions = np.linspace(0.0, 1.0, STRIP_PIECES + 1)[:, None]
        uv = strip[:, 0, None] + fractions * (strip[:, 1] - strip[:, 0])[:, None]
        points = carrier(uv[..., 0].ravel(), uv[..., 1].ravel()).reshape(*uv.shape[:2], 3)
        return np.stack([points[:, :-1], points[:, 1:]], axis=2).reshape(-1, 2, 3)

    def _leave(self, edge: int, vertex: int) -> Array:
        """The unit tangent (3,) of an edge at one of its vertices."""
        at = self.brep.edges.span[edge, self._ends(edge).index(vertex)]
        return _unit(self.curves[edge](at, 1))

    def _ends(self, edge: int) -> tuple[int, int]:
        """The vertices of an edge."""
        return int(self.brep.edges.start[edge]), int(self.brep.edges.end[edge])

    def _widen_span(self, joint: _Joint, span: tuple[float, float]) -> tuple[float, float]:
        """The span of a smooth or concave edge, longer where its faces go on beyond open ones at its ends."""
        low, high = span
        speeds = np.linalg.norm(self.curves[joint.edge](np.array(span), 1), axis=1)
        steps = MITRE_LENGTH * self.skin / speeds
        reach = [
            any(self._needs_strip(f, j) for j in self.joints if vertex in self._ends(j.edge) for f in joint.faces)
            for vertex in self._ends(joint.edge)
        ]
        return low - steps[0] * reach[0], high + steps[1] * reach[1]

    def inward(self, face: int, points: Array) -> Array:
        """Inward unit normals (n, 3) of a face at its points (n, 3)."""
        return -int(self.brep.faces.sense[face]) * self.carriers[face].gradient(points)

    def _find_joints(self) -> list[_Joint]:
        """The edges of the body with their angles."""
        brep, owner = self.brep, self.brep.face_of_use
        found = []
        for one, two in np.argsort(brep.uses.edge, kind="stable").reshape(-1, 2).tolist():
            edge = int(brep.uses.edge[one])
            low, high = brep.edges.span[edge]
            t = low + (high - low) * EDGE_FRACTIONS
            points, tangents = self.curves[edge](t), self.curves[edge](t, 1)
            tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
            faces = int(owner[one]), int(owner[two])
            across = np.cross(self.carriers[faces[0]].gradient(points), brep.uses.sense[one] * tangents)
            rise = -(across * self.inward(faces[1], points)).sum(axis=1)
            cosine = (self.inward(faces[0], points) * self.inward(faces[1], points)).sum(axis=1)
            found.append(_Joint(edge, (one, two), faces, rise, float(cosine.max())))
        return found

    def add_joint(self, joint: _Joint) -> None:
        """The rim of a smooth edge, or the tube of a concave one and its rims."""
        brep, edge = self.brep, joint.edge
        span = float(brep.edges.span[edge, 0]), float(brep.edges.span[edge, 1])
        if (joint.rise < -SMOOTH_SINE).all():
            self.sites.append(EdgeSite(self.curves[edge], span))
            self.site_sheets.append(-1)
            return
        sheets = [int(self.sheet_of_face[f]) for f in joint.faces]
        pcurves = [brep.pcurves[p] if p >= 0 else None for p in brep.uses.pcurve[list(joint.uses)].tolist()]
        senses = [int(s) for s in brep.uses.sense[list(joint.uses)]]
        if (np.abs(joint.rise) <= SMOOTH_SINE).all():
            if min(sheets) >= 0:
                curve = self._offset_curve(edge, span, joint.faces[0], pcurves[0], sheets[0])
                wide = self._widen_span(joint, span)
                if wide != span:
                    curve, pcurves, span = _extend(curve, pcurves, span, wide)
                self.rims.append(
                    SheetEdge(curve, span, (sheets[0], sheets[1]), (pcurves[0], pcurves[1]), (senses[0], senses[1]))
                )
            return
        if (joint.rise <= SMOOTH_SINE).any():
            at = self.curves[edge](0.5 * sum(span)).round(6)
            raise NoOffset(f"the edge of the body about {at} is concave in one part only")
        curve = self.curves[edge]

        def inward(t: Array) -> Array:
            return np.stack([self.inward(f, curve(t)) for f in joint.faces])

        wide = self._widen_span(joint, span) if is_segment(curve) else span
        self._add_tube(joint, curve, span, wide, inward, (0, 1))

    def _add_tube(
        self,
        joint: _Joint,
        curve: EdgeCurve,
        span: tuple[float, float],
        wide: tuple[float, float],
        inward: Callable[[Array], Array],
        sides: tuple[int, ...],
    ) -> None:
        """The tube of an edge, its site, and its rims along the faces `sides` (0, 1), whose normals are the first ones.

        wide: the span of the tube, longer than the edge's where the faces go on beyond open ones at its ends.
        """
        brep, edge = self.brep, joint.edge
        ends = int(brep.edges.start[edge]), int(brep.edges.end[edge])
        tube = make_tube(curve, wide, ends, inward, self.skin, self.size)
        number = self._add_sheet(tube.sheet)
        self.tubes.append((number, tube))
        self.sites.append(EdgeSite(curve, span))
        self.site_sheets.append(number)
        for own, k in enumerate(sides):
            face, use = joint.faces[k], joint.uses[k]
            sheet = int(self.sheet_of_face[face])
            if sheet < 0:
                continue
            sense = int(brep.uses.sense[use])
            pcurve = brep.pcurves[brep.uses.pcurve[use]] if brep.uses.pcurve[use] >= 0 else None
            side = self._offset_curve(edge, span, face, pcurve, sheet)
            along_tube = -sense * self.sheets[sheet].sense * tube.sheet.sense
            pcurves: list[BSplineCurve | None] = [pcurve, tube.sides[own]]
            reach = span
            if wide != span:
                side, pcurves, reach = _extend(side, pcurves, span, wide)
            self.rims.append(SheetEdge(side, reach, (sheet, number), (pcurves[0], pcurves[1]), (sense, along_tube)))

    def add_open_joint(self, joint: _Joint) -> None:
        """What an edge of an open face needs: a rim in a concave edge of two of them, a tube where the skin ends in a round.

        Under a concave edge with a face that has a skin the tube goes on from below that face to below the open one.
        """
        brep, edge = self.brep, joint.edge
        span = float(brep.edges.span[edge, 0]), float(brep.edges.span[edge, 1])
        curve = self.curves[edge]
        concave, convex = bool((joint.rise > SMOOTH_SINE).all()), bool((joint.rise < -SMOOTH_SINE).all())
        if self.is_open[list(joint.faces)].all():
            if concave:
                sheets = [int(self.sheet_of_face[f]) for f in joint.faces]
                senses = [int(s) for s in brep.uses.sense[list(joint.uses)]]
                self.rims.append(SheetEdge(curve, span, (sheets[0], sheets[1]), (None, None), (senses[0], senses[1])))
            return
        if convex and joint.cosine <= OPEN_RIM_COSINE:
            return
        if not (convex or concave or (np.abs(joint.rise) <= SMOOTH_SINE).all()):
            at = format_point(curve(0.5 * sum(span)))
            raise NoOffset(f"the edge of an open face about {at} is concave in one part only")
        k = 0 if self.is_open[joint.faces[1]] else 1  # the face with a skin
        face, opened, use = joint.faces[k], joint.faces[1 - k], joint.uses[1 - k]

        def inward(t: Array) -> Array:
            points, tangents = curve(t), curve(t, 1)
            tangents = tangents / np.linalg.norm(tangents, axis=1, keepdims=True)
            into = np.cross(self.carriers[opened].gradient(points), brep.uses.sense[use] * tangents)
            below = self.inward(opened, points)
            along = np.cos(RIM_OVERHANG) * into - np.sin(RIM_OVERHANG) * below
            return np.stack([self.inward(face, points), *([below] if concave else []), along])

        wide = self._widen_span(joint, span) if is_segment(curve) else span
        self._add_tube(joint, curve, span, wide, inward, (k,))

    def _offset_curve(
        self, edge: int, span: tuple[float, float], face: int, pcurve: BSplineCurve | None, sheet: int
    ) -> EdgeCurve:
        """An edge of a face moved inwards by the skin along the face's normals, with the same parameter."""
        curve, carrier = self.curves[edge], self.sheets[sheet].carrier

        if isinstance(carrier, BSplineSurface) and pcurve is not None:
            line = _parameter_line(carrier, pcurve, span)
            if line is not None:
                return line

        def offset_points(t: Array) -> Array:
            return np.asarray(curve(t) + self.skin * self.inward(face, curve(t)))

        return fit_known_or_spline(curve, span, offset_points, self.size)

    def join_tubes(self) -> None:
        """The arcs between tubes that continue each other, and the spheres of corners at which more tubes meet."""
        ends: dict[int, list[tuple[int, TubeEnd]]] = {}
        for number, tube in self.tubes:
            for end in tube.ends:
                ends.setdefault(end.vertex, []).append((number, end))
        for vertex, own in ends.items():
            center = self.brep.vertices[vertex]
            if len(own) == 2 and 1 + own[0][1].leaving @ own[1][1].leaving <= OPPOSITE:
                self._join_pair(center, own)
            elif len(own) > 2:
                chain = _chain_arcs([end.arc(center, 1.0)(np.array([0.0, end.split])) - center for _, end in own])
                if chain is not None:
                    self._add_ball(vertex, center, [(*own[i], 0.0, own[i][1].split, forward) for i, forward in chain])
            elif len(own) == 2 and all(end.split < end.angle for _, end in own):
                pieces = [(*each, each[1].split, each[1].angle, number > 0) for number, each in enumerate(own)]
                self._add_ball(vertex, center, pieces)

    def _join_pair(self, center: Array, own: list[tuple[int, TubeEnd]]) -> None:
        """The rim between two tubes that continue each other."""
        (one, first), (two, second) = own
        arc, angle = first.arc(center, self.skin), first.angle
        swap = np.linalg.norm(second.normals[0] - first.normals[0]) > np.linalg.norm(
            second.normals[1] - first.normals[0]
        )
        parameters = first.parameters, second.parameters[::-1] if swap else second.parameters
        pcurves = [line_segment(p[0], p[1], (0.0, angle)) for p in parameters]
        senses = [_left_sense(self.sheets[s], p) for s, p in zip((one, two), parameters, strict=True)]
        self.rims.append(SheetEdge(arc, (0.0, angle), (one, two), (pcurves[0], pcurves[1]), (senses[0], senses[1])))

    def _add_ball(self, vertex: int, center: Array, pieces: Sequence[tuple[int, TubeEnd, float, float, bool]]) -> None:
        """The sphere of a corner and its rims, along pieces of the arcs in which tubes end there.

        A piece is a tube's sheet and end, the angles of the arc from and to which it goes, and whether it is passed that way. Two
        pieces that leave an open face out are closed beyond it.
        """
        arcs = [end.arc(center, self.skin) for _, end, *_ in pieces]
        starts = [
            arc(np.array([low if ahead else high]))[0] for arc, (*_, low, high, ahead) in zip(arcs, pieces, strict=True)
        ]
        if len(pieces) == 2:
            *_, high, _ = pieces[1]
            starts.append(arcs[1](np.array([high]))[0])
        sphere = make_ball(center, (np.array(starts) - center) / self.skin, self.skin)
        number = len(self.sheets)
        made, border = [], []
        for arc, (_, _, low, high, forward) in zip(arcs, pieces, strict=True):

            def parameters(t: Array, arc: Circle = arc) -> Array:
                return sphere.parameters(arc(t))

            def error(fit: BSplineCurve, t: Array, arc: Circle = arc) -> Array:
                return np.asarray(np.linalg.norm(sphere(*fit(t).T) - arc(t), axis=1))

            pcurve = fit_adaptively(parameters, np.array([low, high]), error, RIM_REL_TOL * self.size)
            if pcurve is None:
                raise TrimmingError(f"the corner at {center.round(6)} has an arc that no spline fits")
            path = parameters(np.linspace(low, high, ARC_SAMPLES))
            made.append(pcurve)
            border.append(path[:-1] if forward else path[:0:-1])
        if len(pieces) == 2:
            ways = (np.array([starts[-1], starts[0]]) - center) / self.skin
            between = Circle(center, ways[0], _unit(np.cross(*ways)), self.skin)
            angle = float(np.arctan2(np.linalg.norm(np.cross(*ways)), ways[0] @ ways[1]))
            border.append(sphere.parameters(between(np.linspace(0.0, angle, ARC_SAMPLES)))[:-1])
        polygon = np.concatenate(border)
        turn = 1 if signed_area(polygon) > 0 else -1
        segments = np.stack([polygon, np.roll(polygon, -1, axis=0)], axis=1)
        self._add_sheet(Sheet(sphere, -1, segments, -1))
        self.ball_of_vertex[vertex] = number
        for arc, pcurve, (sheet, end, low, high, forward) in zip(arcs, made, pieces, strict=True):
            own_line = line_segment(end.place(low), end.place(high), (low, high))
            senses = _left_sense(self.sheets[sheet], end.parameters), turn if forward else -turn
            self.rims.append(SheetEdge(arc, (low, high), (sheet, number), (own_line, pcurve), senses))


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector))


def _left_sense(sheet: Sheet, ends: Array) -> int:
    """+1 if the domain of a sheet lies on the left of a straight side between parameters (2, 2), else -1."""
    step, inward = ends[1] - ends[0], sheet.box().mean(axis=0) - ends.mean(axis=0)
    return 1 if step[0] * inward[1] - step[1] * inward[0] > 0 else -1


def _chain_arcs(arcs: list[Array]) -> list[tuple[int, bool]] | None:
    """Arcs (2, 3) of directions as a closed path, each with whether it runs forward; None if they do not close."""
    left, path = set(range(1, len(arcs))), [(0, True)]
    at = arcs[0][1]
    while left:
        gaps = [(float(np.linalg.norm(arcs[i][f] - at)), i, f) for i in left for f in (0, 1)]
        gap, i, f = min(gaps)
        if gap > 1e-6:
            return None
        path.append((i, f == 0))
        left.remove(i)
        at = arcs[i][1 - f]
    return path if np.linalg.norm(at - arcs[0][0]) <= 1e-6 else None


def _extend(
    curve: EdgeCurve,
    pcurves: Sequence[BSplineCurve | None],
    span: tuple[float, float],
    wide: tuple[float, float],
) -> tuple[EdgeCurve, list[BSplineCurve | None], tuple[float, float]]:
    """A curve and its pcurves on a wider span, as far as those go that are not straight."""
    own = [c for c in (curve, *pcurves) if isinstance(c, BSplineCurve)]
    ends = [c.domain for c in own if not is_segment(c)]
    low = min(span[0], max([wide[0], *(low for low, _ in ends)]))
    high = max(span[1], min([wide[1], *(high for _, high in ends)]))

    def widen(c: EdgeCurve | None) -> EdgeCurve | None:
        if not isinstance(c, BSplineCurve) or not is_segment(c):
            return c
        return line_segment(c(low), c(high), (low, high))

    return widen(curve), [widen(c) for c in pcurves], (low, high)  # type: ignore[return-value, misc]


def _parameter_line(carrier: BSplineSurface, pcurve: BSplineCurve, span: tuple[float, float]) -> BSplineCurve | None:
    """The curve on a fitted sheet along a pcurve, with its parameter, if that is a line of constant u or v."""
    ends = pcurve(np.array(span))
    extent = np.ptp(np.array(carrier.domain), axis=1)
    if not is_segment(pcurve) or not (np.abs(ends[1] - ends[0]) <= LINE_TOL * extent).any():
        return None
    fixed = int((np.abs(ends[1] - ends[0]) / extent).argmin())
    line = isoparametric_curve(carrier, fixed, float(ends[0, fixed]))
    low, high = ends[:, 1 - fixed]
    knots = span[0] + (line.knots - low) * (span[1] - span[0]) / (high - low)
    if high > low:
        return BSplineCurve(line.poles, knots, line.degree)
    return BSplineCurve(line.poles[::-1].copy(), knots[::-1].copy(), line.degree)


def fit_known_or_spline(
    base: EdgeCurve, span: tuple[float, float], sample: Callable[[Array], Array], size: float
) -> EdgeCurve:
    """A curve through sample(t): a line or a circle with the parameter of `base` if it is one, else a spline."""
    t = span[0] + (span[1] - span[0]) * EDGE_FRACTIONS
    points = sample(t)
    known: EdgeCurve | None = None
    if is_segment(base):
        slope = (points[-1] - points[0]) / (t[-1] - t[0])
        first, last = (points[0] + (s - t[0]) * slope for s in span)
        known = line_segment(first, last, span)
    elif isinstance(base, Circle):
        arm = points[0] - base.origin
        height = float(arm @ base.normal)
        radius = float(np.linalg.norm(arm - height * base.normal))
        known = replace(base, origin=base.origin + height * base.normal, radius=radius)
    if known is not None and np.abs(known(t) - points).max() <= SAME_REL_TOL * size:
        return known
    breaks, bends = np.array(span), np.empty(0)
    if isinstance(base, BSplineCurve):
        inner, count = knots_within(base.knots, *span)
        breaks = np.concatenate([breaks[:1], inner, breaks[1:]])
        bends = inner[base.degree - count < FIT_DEGREE - 1]

    def error(fit: BSplineCurve, s: Array) -> Array:
        return np.asarray(np.linalg.norm(fit(s) - sample(s), axis=1))

    fit = fit_adaptively(sample, breaks, error, RIM_REL_TOL * size, bends)
    if fit is None:
        raise NoOffset("the offset of an edge turns too sharply for a spline")
    return fit

"""CAD bodies as boundary representations with faces on planes, cylinders, cones, spheres and tori, or on splines as well.

Planes and quadrics are exact; splines are within 1e-10 of the body's size.
Edges are exact if they are straight or conic; other edges and all pcurves that are not straight are spline fits within 1e-10 of
the body's size, or 2e-9 for pcurves on splines.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.TopAbs import TopAbs_EDGE
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces
from tpmscad.brep.carriers import EdgeCurve, Plane, Quadric
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest, NotQuadric
from tpmscad.kernel.body_import.closed_face_splitting import split_closed_faces
from tpmscad.kernel.body_import.crease_splitting import list_whole_faces, split_at_creases
from tpmscad.kernel.body_import.exact_faces import EXACT, MAX_LEFT_REL, read_exact_body
from tpmscad.kernel.body_import.free_form_carriers import is_c1
from tpmscad.kernel.body_import.gap_closing import MAX_GAP_REL, Allowance
from tpmscad.kernel.body_import.unrolled_faces import ImportedBody, ImportedEdge, unroll_face
from tpmscad.kernel.measure.edge_gaps import measure_accuracy, measure_edge_length
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt.bounding_boxes import box_center, box_diagonal
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import faces_of, solids_of, unwrap
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace, fit_pcurve
from tpmscad.kernel.recognise.face_carriers import EXACT_REL_TOL, recognise_carrier
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve

FACE_TAG = "cap"
"""Tag of the faces unless they are given tags of their own: they close what the body trims."""

MAX_NAMED_FACES = 3
"""Most faces that an error message names."""

BOUNDARY_DISTANCE_TOL = 1e-7
"""In body sizes: mean distance of the boundary from the kernel's, whose edges have tolerances of this order."""


def brep_from_shape(shape: Any, tags: Sequence[str] = ()) -> Brep:
    """Boundary representation of the solids of a TopoDS, build123d or CadQuery shape, placed and closed.

    Faces with a seam are cut in two. `tags` are those of the shape's faces, FACE_TAG of all if there are none. Raises NotQuadric
    if a face is neither plane nor quadric or an edge cannot be represented, and InvalidRequest if there is no solid.
    """
    brep, source = brep_and_source_faces(shape)
    return replace(brep, faces=replace(brep.faces, tag=source), tags=tuple(tags)) if tags else brep


@dataclass(frozen=True, slots=True, eq=False)
class FreeFormBody:
    """The boundary representation of a body, and the distances of its spline carriers, by their numbers.

    `notes`: what was done to close gaps between its faces, in words. `carried`: the largest tolerance of an edge that is off its
    faces, model units; 0 if all lie on them within round-off.
    """

    brep: Brep
    free_form: Mapping[int, FreeFormSurface]
    notes: tuple[str, ...] = ()
    carried: float = 0.0


TOL_PER_CARRIED = 100.0
"""The tolerance of a lattice, in units of what an edge of the body may be off its faces."""


def read_free_form_body(
    shape: Any,
    tags: Sequence[str] = (),
    accuracy: float | None = None,
    tol: float | None = None,
    greatest_turn: float = math.inf,
) -> FreeFormBody:
    """As `brep_from_shape`, with faces on splines as well, split at creases, and gaps between faces closed.

    Planes and quadrics stay; splines are moved so that their edges are on them (`gap_closing`). What is left of a gap is carried
    by the edge as its tolerance, within the file's accuracy, which is the larger of the one that it states, `accuracy`, and the
    tolerances of its edges, and within a hundredth of `tol`, the tolerance of what cuts the body. Raises NotQuadric if a spline
    is not within 1e-10 of the body's size, has poles along both parameters, or if more is left of a gap.
    """
    gap = measure_accuracy([unwrap(shape)])
    allowance = _find_allowance(unwrap(shape), accuracy, tol)
    brep, source, body = _read_faces(shape, True, gap, allowance, greatest_turn)
    carriers = [face.carrier for face in body.faces]
    brep = replace(brep, faces=replace(brep.faces, tag=source), tags=tuple(tags)) if tags else brep
    forms = {i: c for i, c in enumerate(carriers) if isinstance(c, FreeFormSurface)}
    notes = _describe_gaps(body, gap)
    if has_tight_edges(brep):
        return FreeFormBody(brep, forms, notes)
    carried, asked = float(brep.edges.deviation.max()), _find_tight_deviation(brep)
    if tol is not None and carried > tol / TOL_PER_CARRIED:
        raise NotQuadric(
            f"edges of the body are up to {carried:.2g} off its faces, more than a hundredth of tol, "
            f"{tol / TOL_PER_CARRIED:.2g}: give a tol of {TOL_PER_CARRIED * carried:.2g}, or repair the body in the CAD system",
            (),
        )
    told = f"edges of the body meet its faces within {carried:.2g}, asked {asked:.2g}; they carry it as their tolerance"
    return FreeFormBody(brep, forms, (*notes, told), carried)


def has_tight_edges(brep: Brep) -> bool:
    """Whether all edges lie on their faces within round-off, so that none carries a tolerance of its own."""
    return bool(brep.edges.deviation.max(initial=0.0) <= _find_tight_deviation(brep))


def _find_tight_deviation(brep: Brep) -> float:
    size = float(np.linalg.norm(np.ptp(brep.vertices, axis=0)))
    return max(CONFUSION_TOLERANCE, MAX_LEFT_REL * size)


def _find_allowance(shape: Any, accuracy: float | None, tol: float | None) -> Allowance:
    """What edges of a shape may be off its faces."""
    limits = [
        (
            max(float(BRep_Tool.MaxTolerance_s(shape, TopAbs_EDGE)), accuracy or 0.0),
            "the file's own accuracy; repair it",
        ),
        (MAX_GAP_REL * box_diagonal(shape), f"{MAX_GAP_REL:g} of the body's size; repair it"),
    ]
    if tol is not None:
        limits.append((tol / TOL_PER_CARRIED, f"a hundredth of tol, {tol:.3g}; give a greater one, or repair the body"))
    return Allowance(*min(limits))


def _describe_gaps(body: ImportedBody, gap: float) -> tuple[str, ...]:
    """What was done about a gap, in words."""
    if gap <= CONFUSION_TOLERANCE and not body.move:
        return ()
    moved = f", for which free-form faces were moved by up to {body.move:.2g}" if body.move else ""
    return (
        f"the body's edges lay up to {gap:.2g} off its faces; the gaps were closed{moved}; "
        "what the body is inaccurate by is so in the result",
    )


def brep_and_source_faces(shape: Any) -> tuple[Brep, IntArray]:
    """The boundary representation, and for each of its faces the index of the shape's face of which it is a part."""
    return _read_faces(shape, False)[:2]


def _read_faces(
    shape: Any, free_form: bool, gap: float = 0.0, allowance: Allowance = EXACT, greatest_turn: float = math.inf
) -> tuple[Brep, IntArray, ImportedBody]:
    """The boundary representation, the source of each of its faces, and the body from which it was assembled.

    `gap`: distance of the kernel's edges from its surfaces. `allowance`: what edges may be off faces in the result.
    """
    faces = [face for solid in solids_of(shape) for face in faces_of(solid)]
    if not faces:
        raise InvalidRequest("the shape holds no solid: make a solid from its faces first")
    size = box_diagonal(unwrap(shape))
    if not free_form:
        _refuse_free_form(faces, size)
    at = -1
    try:
        parts = split_at_creases(faces, size, greatest_turn) if free_form else list_whole_faces(faces)
        body = read_exact_body(parts, size, free_form, allowance)
        unrolled_faces = []
        for at in range(len(body.faces)):
            unrolled_faces.append(unroll_face(body, body.faces[at]))
        at = -1
        body = split_closed_faces(replace(body, faces=tuple(unrolled_faces)))
        brep = _assemble(body, allowance.length)
    except UnsupportedFace as error:
        of = parts[body.faces[at].source_face].source if at >= 0 else -1
        raise NotQuadric(
            f"{_describe_face(faces, of)} {error}: it needs the Boolean operations of the kernel",
            (of,) if of >= 0 else (),
        ) from None
    part_of = np.array([face.source_face for face in body.faces])
    strips = gap * measure_edge_length(unwrap(shape)) if gap > CONFUSION_TOLERANCE else 0.0
    _check_closed_and_volume(brep, part_of, [part.face for part in parts], size, strips, gap, body.move)
    return brep, np.array([part.source for part in parts])[part_of], body


def _refuse_free_form(faces: list[TopoDS_Face], size: float) -> None:
    """Raise NotQuadric with the unsupported faces, if there are any."""
    reasons = {}
    for i, face in enumerate(faces):
        try:
            recognise_carrier(face, size)
        except UnsupportedFace as reason:
            reasons[i] = f"{_describe_face(faces, i)} {reason}"
    if reasons:
        more = f" and {len(reasons) - MAX_NAMED_FACES} more" if len(reasons) > MAX_NAMED_FACES else ""
        raise NotQuadric("; ".join(list(reasons.values())[:MAX_NAMED_FACES]) + more, tuple(reasons))


def _describe_face(faces: list[TopoDS_Face], index: int) -> str:
    """Number and place of a face, for messages."""
    if index < 0:
        return "a face"
    x, y, z = box_center(faces[index]).tolist()
    return f"face {index} (about {x:.4g}, {y:.4g}, {z:.4g})"


def _widen_carried(off: float) -> float:
    """The tolerance of an edge that is off its faces or vertices by a distance."""
    return off * (CARRIED_MARGIN if off > CONFUSION_TOLERANCE else 1.0)


CARRIED_MARGIN = 1.5
"""Factor on the measured deviation of an edge that is off its faces by more than the kernel's least tolerance: the kernel, which
measures at other places, rejects faces with an edge that it finds farther off than its tolerance."""


def _assemble(body: ImportedBody, allowed: float) -> Brep:
    """Boundary representation of a body without seams, with the measured deviation of every edge from its faces and vertices.

    Pcurves that follow no edge within round-off follow it within `allowed`.
    """
    curves: list[EdgeCurve] = []
    pcurves: list[BSplineCurve] = []
    index: dict[int, int] = {}
    for edge in body.edges:
        if id(edge.curve) not in index:
            index[id(edge.curve)] = len(curves)
            curves.append(edge.curve)
    ends = [np.stack([body.vertices[e.start], body.vertices[e.end]]) - e.curve(np.array(e.span)) for e in body.edges]
    deviation = np.array([_widen_carried(float(np.linalg.norm(miss, axis=1).max())) for miss in ends])
    rows, use_start, loop_start = [], [0], [0]
    for face in body.faces:
        for loop in face.loops:
            for use in loop:
                edge, number = body.edges[use.edge], -1
                if not isinstance(face.carrier, Plane):
                    assert use.mid_parameters is not None
                    number = len(pcurves)
                    tol = _pcurve_tolerance(face.carrier, edge, body.size)
                    pcurves.append(
                        fit_pcurve(face.carrier, edge.curve, edge.span, use.mid_parameters, body.size, tol, allowed)
                    )
                rows.append((use.edge, use.sense, number))
                off = _edge_deviation(body, face.carrier, use.edge, pcurves[number] if number >= 0 else None)
                deviation[use.edge] = max(deviation[use.edge], _widen_carried(off))
            use_start.append(len(rows))
        loop_start.append(len(use_start) - 1)
    edges, n = body.edges, len(body.faces)
    return Brep(
        carriers=tuple(c.spline if isinstance(c, FreeFormSurface) else c for c in (f.carrier for f in body.faces)),
        curves=tuple(curves),
        pcurves=tuple(pcurves),
        vertices=np.array(body.vertices),
        edges=Edges(
            np.array([index[id(e.curve)] for e in edges]),
            Motion.identity(len(edges)),
            np.array([e.span for e in edges]),
            np.array([e.start for e in edges]),
            np.array([e.end for e in edges]),
            deviation,
        ),
        uses=EdgeUses(*np.array(rows).T),
        faces=Faces(
            np.arange(n),
            Motion.identity(n),
            np.array([face.sense for face in body.faces]),
            np.zeros(n, np.int64),
            np.array(loop_start),
            np.array(use_start),
        ),
        tags=(FACE_TAG,),
    )


PCURVE_REL_TOL = 2e-9
"""In body sizes: tolerance of pcurves on splines. Interpolation across the knots of the surface is not better at a few spans."""


def _pcurve_tolerance(carrier: Quadric | FreeFormSurface, edge: ImportedEdge, size: float) -> float:
    """Tolerance of a pcurve; on a spline it is on top of the edge's own distance, which no pcurve can undo."""
    if not isinstance(carrier, FreeFormSurface):
        return EXACT_REL_TOL * size
    points = edge.curve(_sample_edge(carrier, edge))
    return PCURVE_REL_TOL * size + float(np.abs(carrier.distance(points)).max())


DEVIATION_SAMPLES = 33
"""Points per edge at which its deviation is measured, besides those for spans."""

SAMPLES_PER_SPAN = 8
"""Points more for each knot span of the edge's curve and of its surface: between knots the deviation waves."""


def _sample_edge(carrier: BodyCarrier, edge: ImportedEdge) -> Array:
    """Parameters (n,) of an edge at which its distance from a surface is measured."""
    knots = [edge.curve.knots] if isinstance(edge.curve, BSplineCurve) else []
    if isinstance(carrier, FreeFormSurface):
        knots += [carrier.spline.knots_u, carrier.spline.knots_v]
    spans = sum(len(np.unique(k)) - 1 for k in knots)
    return np.linspace(*edge.span, DEVIATION_SAMPLES + SAMPLES_PER_SPAN * spans)


def _edge_deviation(body: ImportedBody, carrier: BodyCarrier, edge: int, along: BSplineCurve | None) -> float:
    """Largest distance of an edge's curve from the surface along its pcurve."""
    t = _sample_edge(carrier, body.edges[edge])
    points: Array = body.edges[edge].curve(t)
    if along is None:
        return float(np.abs(carrier.distance(points)).max())
    return float(np.linalg.norm(carrier(*along(t).T) - points, axis=1).max())


MAX_STRIP_VOLUME = 2e-4
"""Of the volume: the most by which the kernel's may err for gaps along its pcurves."""

FACE_REL_TOL = 1e-3
"""Relative difference of the areas of a face, besides gaps: edges that a file has rounded lie off along their faces, too, which
no gap tells (5e-5 on a loft whose edges were rounded to 1e-4 of its size). A face taken for the rest of its surface is off by
more."""


def _check_closed_and_volume(
    brep: Brep, source: IntArray, faces: list[TopoDS_Face], size: float, strips: float, gap: float, move: float
) -> None:
    """Raise NotQuadric unless the boundary representation is closed and has the kernel's volume, and each face its area.

    `source` (F,): the kernel's face of which a face is a part. `strips`: area of the gaps along the kernel's pcurves, by which
    its volume errs; `gap`: their width; `move`: how far faces were moved. A face that is taken for the rest of its surface has
    another area, or another share in the volume. Faces on surfaces that are not C1 are left out: the kernel's quadrature errs on
    them by up to a tenth, even where they are plane.
    """
    unmatched = connectivity.find_unmatched_edges(brep)
    if len(unmatched):
        at = brep.vertices[brep.edges.start[unmatched[0]]].round(6)
        raise NotQuadric(f"{len(unmatched)} edges of the body do not join two of its faces, the first at {at}", ())
    moments = integral_properties.integrate_faces(brep)
    shares = np.column_stack([moments.area, np.trace(moments.first, axis1=1, axis2=2) / 3.0])
    own = np.stack([np.bincount(source, weights=column, minlength=len(faces)) for column in shares.T], axis=1)
    expected = np.where(np.array([is_c1(face) for face in faces])[:, None], face_moments(faces)[:, :2], own)
    volume, whole = (float(found[:, 1].sum()) for found in (own, expected))
    allowed = (BOUNDARY_DISTANCE_TOL * size + move) * moments.area.sum()
    allowed += min(strips * size / 3.0, MAX_STRIP_VOLUME * abs(whole))
    if not abs(volume - whole) <= allowed:
        raise NotQuadric(
            f"the body's faces bound {volume:.9g}, not {whole:.9g}, when read exactly: "
            "it needs the Boolean operations of the kernel",
            (),
        )
    length = np.array([measure_edge_length(face) for face in faces])
    band = (gap + BOUNDARY_DISTANCE_TOL * size + move) * length + FACE_REL_TOL * expected[:, 0]
    reach = float(np.abs(brep.vertices).max(initial=0.0)) + size  # no point of the body is farther from the origin
    limit = np.stack([band, band * reach / 3.0 + move * expected[:, 0]], axis=1)
    wrong = np.flatnonzero((np.abs(own - expected) > limit).any(axis=1))
    if len(wrong):
        f = int(wrong[0])
        raise NotQuadric(
            f"{_describe_face(faces, f)} has the area {own[f, 0]:.9g}, not {expected[f, 0]:.9g}, when read exactly, or another "
            "share in the volume: it needs the Boolean operations of the kernel",
            tuple(wrong.tolist()),
        )

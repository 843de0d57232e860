"""Four-sided faces of a CAD part as polynomial splines on the unit square.

A face whose sides are lines of parameters of its surface has the surface's own parametrisation: of a polynomial spline the
knots and poles themselves, of any other surface a spline within 1e-9 of the size. A face that closes on itself, as a whole
cylinder does, has its seam as two sides. Any other face is parametrised anew: a bilinearly blended Coons patch of its sides in
the parameter plane fills the region that they bound, so that its image lies on the surface exactly, and a spline is fitted to it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Surface
from OCP.BRepTools import BRepTools, BRepTools_WireExplorer
from OCP.Geom import Geom_RectangularTrimmedSurface
from OCP.TopAbs import TopAbs_FACE, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.kernel.body_import.free_form_carriers import convert_box
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import list_subshapes, orientation_sign, require_shape
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.chart_fit import fit_chart
from tpmscad.splines.knots import map_to_unit_square, turn_surface

N_SIDES = 4

Side = tuple[Any, float, float]
"""A curve in the parameter plane, and the parameters of its start and end."""

CONVERSION_RTOL = 1e-9
"""Of the size: greatest error of the spline of a face that is a whole patch of its surface."""

CHART_RTOL = 1e-6
"""Of the size: greatest error of the spline of a face that is trimmed in another way."""

SIDE_RTOL = 1e-7
"""Of the range of parameters: how far a side may be from a line of parameters, as kernels draw it."""

SIDE_SAMPLES = np.linspace(0.0, 1.0, 9)
"""Places on a side at which it is compared with a line of parameters."""

CHECK_LINES = np.linspace(0.0, 1.0, 41)
"""Parameters of a chart among which the place of the greatest error is sought."""

KINK_ANGLE = 1e-6
"""Relative jump of a derivative at a knot from which on a surface counts as not C1 there."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceSpline:
    """The spline of a face on the unit square, and its greatest measured distance from the face, in model units."""

    spline: BSplineSurface
    error: float


def convert_four_sided(face: Any, name: str) -> FaceSpline:
    """The spline of a face with four sides; `name` is that of the face in messages.

    InvalidRequest if the face has not four sides, if no spline follows it closely enough, or at a knot across which it is not C1.
    """
    face = _single_face(face, name)
    sides = _list_sides(face, name)
    u0, u1, v0, v1 = BRepTools.UVBounds_s(face)
    box = np.array([[u0, u1], [v0, v1]])
    chart = _make_chart(face, sides)
    size = float(np.ptp(chart(SIDE_SAMPLES, SIDE_SAMPLES).reshape(-1, 3), axis=0).max())
    whole = _is_whole(sides, box)
    if whole:
        surface = BRep_Tool.Surface_s(face)
        while isinstance(surface, Geom_RectangularTrimmedSurface):
            surface = surface.BasisSurface()
        limit = CONVERSION_RTOL * size
        spline, error = convert_box(surface, box, 0.1 * limit)
        spline = _start_at_first_side(map_to_unit_square(spline), sides[0], box)
    else:
        limit = CHART_RTOL * size
        spline, error = fit_chart(chart, limit)
    if error > limit:
        _refuse_intricate(spline, None if whole else chart, name, error, limit)
    _require_tangents(spline, name)
    return FaceSpline(spline, error)


def _make_chart(face: TopoDS_Face, sides: list[Side]) -> Any:
    """The Coons patch of the sides on the face's surface: s (n,) and t (m,) -> points (n, m, 3)."""
    surface = BRepAdaptor_Surface(face)
    lower, right, upper, left = sides
    corners = np.stack([_points(side, np.zeros(1))[0] for side in sides])

    def chart(s: Array, t: Array) -> Array:
        a, b = _points(lower, s)[:, None], _points(upper, 1 - s)[:, None]
        c, d = _points(left, 1 - t)[None], _points(right, t)[None]
        u, v = s[:, None, None], t[None, :, None]
        p00, p10, p11, p01 = (corner[None, None] for corner in corners)
        bilinear = (1 - u) * (1 - v) * p00 + u * (1 - v) * p10 + (1 - u) * v * p01 + u * v * p11
        plane = (1 - v) * a + v * b + (1 - u) * c + u * d - bilinear
        points = [surface.Value(x, y).Coord() for x, y in plane.reshape(-1, 2).tolist()]
        return np.array(points).reshape(len(s), len(t), 3)

    return chart


def _is_whole(sides: list[Side], box: Array) -> bool:
    """Whether the sides are those of the box (2, 2) of parameters."""
    tol = SIDE_RTOL * np.ptp(box, axis=1)
    for side in sides:
        points = _points(side, SIDE_SAMPLES)[:, :, None]
        if not (np.abs(points - box) <= tol[:, None]).all(axis=0).any():
            return False
    return True


def _start_at_first_side(spline: BSplineSurface, side: Side, box: Array) -> BSplineSurface:
    """The spline of the box (2, 2) turned so that its first parameter runs along a side, which is at the start of the second."""
    start, end = (_points(side, np.array([float(i)]))[0] for i in (0, 1))
    along = int(np.argmax(np.abs(end - start) / np.ptp(box, axis=1)))
    reverse = [bool(end[i] < start[i]) if i == along else bool(start[i] > box[i].mean()) for i in (0, 1)]
    return turn_surface(spline, reverse[0], reverse[1], swap=along == 1)


def _refuse_intricate(spline: BSplineSurface, chart: Any, name: str, error: float, limit: float) -> None:
    """InvalidRequest for a face that no spline follows, with the place if it is trimmed."""
    place = ""
    if chart is not None:
        points = chart(CHECK_LINES, CHECK_LINES)
        miss = np.linalg.norm(spline.grid(CHECK_LINES, CHECK_LINES) - points, axis=2)
        place = f" near {format_point(points[np.unravel_index(int(np.argmax(miss)), miss.shape)])}"
    raise InvalidRequest(
        f"{name} is too intricate for a map: its spline misses it by {error:.3g}{place}, more than {limit:.3g}; "
        "use a face without creases and with smooth sides, or split it there"
    )


def _require_tangents(spline: BSplineSurface, name: str) -> None:
    """InvalidRequest, with knot and place, where the surface is not C1."""
    for axis in (0, 1):
        along = turn_surface(spline, swap=axis == 1)
        values, counts = np.unique(along.knots_u[along.degree_u + 1 : -along.degree_u - 1], return_counts=True)
        suspects = values[counts >= along.degree_u]
        if not len(suspects):
            continue
        # at a knot the span above is evaluated; that below is the span above of the reversed surface
        above = along.grid(suspects, SIDE_SAMPLES, 1)
        below = -turn_surface(along, reverse_u=True).grid(1 - suspects, SIDE_SAMPLES, 1)
        jump = np.linalg.norm(above - below, axis=2) / np.linalg.norm(above, axis=2).max()
        i, j = np.unravel_index(int(np.argmax(jump)), jump.shape)
        if jump[i, j] > KINK_ANGLE:
            place = along.grid(suspects[i : i + 1], SIDE_SAMPLES[j : j + 1])[0, 0]
            raise InvalidRequest(
                f"{name} is not smooth enough for a map: at its knot {'uv'[axis]} = {suspects[i]:.6g} (of 0 to 1) near "
                f"{format_point(place)} the derivative across it jumps by {jump[i, j]:.3g} of its size; split the face "
                "there, or make its surface C1"
            )


def _single_face(face: Any, name: str) -> TopoDS_Face:
    """The face of a build123d or CadQuery object, a TopoDS face, or a shape or workplane that holds a single one."""
    if hasattr(face, "vals"):  # a CadQuery Workplane
        values = face.vals()
        face = values[0] if len(values) == 1 else face
    faces = list_subshapes(require_shape(face), TopAbs_FACE)
    if len(faces) != 1:
        raise InvalidRequest(f"{name} holds {len(faces)} faces: give one face of the part")
    return convert.as_face(faces[0])


def _list_sides(face: TopoDS_Face, name: str) -> list[Side]:
    """The parameter curves of the four sides around the face, each with the parameters of its start and end."""
    wires = list_subshapes(face, TopAbs_WIRE)
    if len(wires) != 1:
        raise InvalidRequest(f"{name} has {len(wires) - 1} holes: a map needs a face of four sides without a hole")
    sides = []
    explorer = BRepTools_WireExplorer(BRepTools.OuterWire_s(face), face)
    while explorer.More():
        edge = explorer.Current()
        if not BRep_Tool.Degenerated_s(edge):
            curve = BRep_Tool.CurveOnSurface_s(edge, face, 0.0, 1.0)
            low, high = BRep_Tool.Range_s(edge, face)
            sides.append((curve, low, high) if orientation_sign(edge) > 0 else (curve, high, low))
        explorer.Next()
    if len(sides) != N_SIDES:
        raise InvalidRequest(
            f"{name} has {len(sides)} edges: a map needs a face of {N_SIDES} sides; split or join its edges in the CAD system"
        )
    return sides


def _points(side: Side, fractions: Array) -> Array:
    """Points (n, 2) in the parameter plane at fractions (n,) of a side."""
    curve, start, end = side
    points = [curve.Value(float(x)) for x in start + (end - start) * fractions]
    return np.array([(p.X(), p.Y()) for p in points])

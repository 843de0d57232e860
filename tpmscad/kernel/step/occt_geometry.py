"""Surfaces and curves of OCCT shapes as Part 21 entities.

Planes, quadrics, swept surfaces, offset surfaces and B-splines, rational ones included, are written as what they are. Other
surfaces and curves (Bezier, parabola, hyperbola, periodic splines) become B-splines without a period, which represent them
exactly. Offset surfaces breach a WHERE rule of advanced_face (wr1), but readers take them and OCCT writes them too. Frames in
STEP are right-handed: `FaceSurface.flipped` says that the normal of the STEP surface opposes that of OCCT's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve
from OCP.BRepTools import BRepTools
from OCP.Geom import (
    Geom_BezierSurface,
    Geom_BSplineCurve,
    Geom_BSplineSurface,
    Geom_Circle,
    Geom_ConicalSurface,
    Geom_CylindricalSurface,
    Geom_Ellipse,
    Geom_Line,
    Geom_OffsetSurface,
    Geom_Plane,
    Geom_RectangularTrimmedSurface,
    Geom_SphericalSurface,
    Geom_SurfaceOfLinearExtrusion,
    Geom_SurfaceOfRevolution,
    Geom_ToroidalSurface,
    Geom_TrimmedCurve,
)
from OCP.GeomAbs import GeomAbs_BSplineCurve, GeomAbs_Circle, GeomAbs_Ellipse, GeomAbs_Line
from OCP.GeomConvert import GeomConvert
from OCP.gp import gp_Lin
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face

from tpmscad._typing import Array, IntArray
from tpmscad.errors import KernelError
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE, axis_frame
from tpmscad.kernel.occt.seams import turn_seam_aside
from tpmscad.kernel.step.geometry_entities import find_knot_scale, format_placed, write_directions, write_point
from tpmscad.kernel.step.part21 import DataSection, format_real, format_reals, format_references

QUADRICS = (Geom_CylindricalSurface, Geom_ConicalSurface, Geom_SphericalSurface, Geom_ToroidalSurface)


@dataclass(frozen=True, slots=True, eq=False)
class FaceSurface:
    """A surface to be written: OCCT's, its poles (n, 3), and whether the normal in STEP is the opposite one.

    An offset surface has the poles of its basis, `basis`.
    """

    geometry: Any
    poles: Array
    flipped: bool = False
    basis: FaceSurface | None = None


def read_face_surface(face: TopoDS_Face) -> FaceSurface:
    """The surface of a face, placed, as a kind that STEP has. Raises KernelError if there is none."""
    try:
        return _read_surface(BRep_Tool.Surface_s(face), BRepTools.UVBounds_s(face))
    except Exception as error:
        if not type(error).__module__.startswith("OCP"):
            raise
        raise KernelError("write STEP", f"a surface cannot become a B-spline: {error}", face) from error


def _read_surface(geometry: Any, bounds: tuple[float, float, float, float]) -> FaceSurface:
    """A surface as a kind that STEP has; `bounds` are those of a face on it: u0, u1, v0, v1."""
    while isinstance(geometry, Geom_RectangularTrimmedSurface):
        geometry = geometry.BasisSurface()
    if isinstance(geometry, Geom_Plane):
        return FaceSurface(geometry, np.zeros((0, 3)))
    if isinstance(geometry, QUADRICS):
        if not isinstance(geometry, Geom_SphericalSurface):
            geometry = turn_seam_aside(geometry, *bounds[:2])
        return FaceSurface(geometry, np.zeros((0, 3)), not geometry.Position().Direct())
    if isinstance(geometry, Geom_OffsetSurface):
        basis = _read_surface(geometry.BasisSurface(), bounds)
        return FaceSurface(geometry, basis.poles, basis.flipped, basis)
    if isinstance(geometry, (Geom_SurfaceOfLinearExtrusion, Geom_SurfaceOfRevolution)):
        curve = _unwrap_curve(geometry.BasisCurve())
        if isinstance(geometry, Geom_SurfaceOfRevolution) and _crosses_axis(curve, geometry.Axis()):
            curve = GeomConvert.CurveToBSplineCurve_s(Geom_TrimmedCurve(curve, *bounds[2:]))
        if isinstance(curve, Geom_BSplineCurve):
            geometry, curve = geometry.Copy(), _without_period(curve)
            geometry.SetBasisCurve(curve)
            return FaceSurface(geometry, curve_poles(curve))
        if isinstance(curve, (Geom_Line, Geom_Circle, Geom_Ellipse)):
            return FaceSurface(geometry, np.zeros((0, 3)))
    if isinstance(geometry, Geom_BSplineSurface):
        spline = geometry
    elif isinstance(geometry, Geom_BezierSurface):
        spline = GeomConvert.SurfaceToBSplineSurface_s(geometry)
    else:
        spline = GeomConvert.SurfaceToBSplineSurface_s(Geom_RectangularTrimmedSurface(geometry, *bounds))
    spline = _cut_periods(spline, bounds)
    return FaceSurface(spline, surface_poles(spline))


def _crosses_axis(curve: Any, axis: Any) -> bool:
    """Whether a circle or an ellipse may meet the axis that it is turned about.

    The whole curve then sweeps a surface that meets itself in poles; on it OCCT's reader misplaces the pcurves, so that only
    the arc below the face is written.
    """
    if not isinstance(curve, Geom_Circle | Geom_Ellipse):
        return False
    radius = curve.Radius() if isinstance(curve, Geom_Circle) else curve.MajorRadius()
    return bool(gp_Lin(axis).Distance(curve.Location()) <= radius + CONFUSION_TOLERANCE)


def _without_period(curve: Geom_BSplineCurve) -> Geom_BSplineCurve:
    """The curve, a periodic one as a closed curve without a period."""
    if not curve.IsPeriodic():
        return curve
    result = curve.Copy()
    assert isinstance(result, Geom_BSplineCurve)
    result.SetNotPeriodic()
    return result


def _cut_periods(spline: Geom_BSplineSurface, bounds: tuple[float, float, float, float]) -> Geom_BSplineSurface:
    """The surface, or of a periodic one the period in which the face lies, which need not start at OCCT's origin."""
    if not (spline.IsUPeriodic() or spline.IsVPeriodic()):
        return spline
    result = spline.Copy()
    assert isinstance(result, Geom_BSplineSurface)
    whole = result.Bounds()
    u0, u1 = bounds[:2] if result.IsUPeriodic() else whole[:2]
    v0, v1 = bounds[2:] if result.IsVPeriodic() else whole[2:]
    result.Segment(u0, u1, v0, v1)
    if result.IsUPeriodic():
        result.SetUNotPeriodic()
    if result.IsVPeriodic():
        result.SetVNotPeriodic()
    return result


def surface_poles(spline: Geom_BSplineSurface) -> Array:
    """Poles of a B-spline surface, row by row: (n, 3)."""
    rows, columns, grid = spline.NbUPoles(), spline.NbVPoles(), spline.Poles()
    found = [grid.Value(i, j).Coord() for i in range(1, rows + 1) for j in range(1, columns + 1)]
    return np.array(found)


def curve_poles(spline: Geom_BSplineCurve) -> Array:
    """Poles of a B-spline curve: (n, 3)."""
    return np.array([spline.Pole(i).Coord() for i in range(1, spline.NbPoles() + 1)])


def _unwrap_curve(curve: Any) -> Any:
    """The curve under trims."""
    while isinstance(curve, Geom_TrimmedCurve):
        curve = curve.BasisCurve()
    return curve


def read_edge_curve(edge: TopoDS_Edge) -> Any:
    """The placed curve of an edge as a kind that STEP has: line, circle, ellipse or B-spline that is not periodic."""
    adaptor = BRepAdaptor_Curve(edge)
    if not adaptor.Is3DCurve():
        raise KernelError("write STEP", "an edge has no curve in space", edge)
    kind = adaptor.GetType()
    if kind == GeomAbs_Line:
        return Geom_Line(adaptor.Line())
    if kind == GeomAbs_Circle:
        return Geom_Circle(adaptor.Circle())
    if kind == GeomAbs_Ellipse:
        return Geom_Ellipse(adaptor.Ellipse())
    first, last = adaptor.FirstParameter(), adaptor.LastParameter()
    if kind == GeomAbs_BSplineCurve:
        spline = adaptor.BSpline()
        if not spline.IsPeriodic():
            return spline
        spline = spline.Copy()
        if (first, last) != (spline.FirstParameter(), spline.LastParameter()):
            spline.Segment(first, last)
        if spline.IsPeriodic():
            spline.SetNotPeriodic()
        return spline
    curve = adaptor.Curve().Curve().Transformed(adaptor.Trsf())
    try:
        spline = GeomConvert.CurveToBSplineCurve_s(Geom_TrimmedCurve(_unwrap_curve(curve), first, last))
    except Exception as error:
        if not type(error).__module__.startswith("OCP"):
            raise
        raise KernelError("write STEP", f"a {curve.DynamicType().Name()} cannot become a B-spline", edge) from error
    if spline.IsPeriodic():
        spline.SetNotPeriodic()
    return spline


def format_surface(section: DataSection, surface: FaceSurface, points: IntArray) -> str:
    """Text of a surface; `points` are the entity numbers of its poles. What it refers to is written first."""
    geometry = surface.geometry
    if surface.basis is not None:
        basis = section.add(format_surface(section, surface.basis, points))
        offset = -geometry.Offset() if surface.flipped else geometry.Offset()
        return f"OFFSET_SURFACE('',#{basis},{format_real(offset)},.F.)"
    if isinstance(geometry, Geom_BSplineSurface):
        return _format_spline_surface(geometry, points)
    if isinstance(geometry, Geom_SurfaceOfLinearExtrusion):
        swept = section.add(format_curve(section, _unwrap_curve(geometry.BasisCurve()), points))
        (along,) = write_directions(section, np.array([geometry.Direction().Coord()]))
        vector = section.add(f"VECTOR('',#{along},1.)")
        return f"SURFACE_OF_LINEAR_EXTRUSION('',#{swept},#{vector})"
    if isinstance(geometry, Geom_SurfaceOfRevolution):
        swept = section.add(format_curve(section, _unwrap_curve(geometry.BasisCurve()), points))
        origin, along = _write_line(section, geometry.Axis())
        about = section.add(f"AXIS1_PLACEMENT('',#{origin},#{along})")
        return f"SURFACE_OF_REVOLUTION('',#{swept},#{about})"
    origin, x_axis, axis = axis_frame(geometry)
    if isinstance(geometry, Geom_Plane):
        normal = np.cross(x_axis, geometry.Position().YDirection().Coord())
        return format_placed(section, "PLANE", origin, normal, x_axis)
    if isinstance(geometry, Geom_ConicalSurface):  # a STEP cone opens along its axis
        angle = geometry.SemiAngle()
        frame = origin, axis if angle > 0 else -axis, x_axis
        return format_placed(section, "CONICAL_SURFACE", *frame, geometry.RefRadius(), abs(angle))
    frame = origin, axis, x_axis
    if isinstance(geometry, Geom_ToroidalSurface):
        return format_placed(section, "TOROIDAL_SURFACE", *frame, geometry.MajorRadius(), geometry.MinorRadius())
    keyword = "CYLINDRICAL_SURFACE" if isinstance(geometry, Geom_CylindricalSurface) else "SPHERICAL_SURFACE"
    return format_placed(section, keyword, *frame, geometry.Radius())


def format_curve(section: DataSection, curve: Any, points: IntArray) -> str:
    """Text of a curve; `points` are the entity numbers of its poles. What it refers to is written first."""
    if isinstance(curve, Geom_BSplineCurve):
        return _format_spline_curve(curve, points)
    if isinstance(curve, Geom_Line):
        origin, along = _write_line(section, curve.Position())
        vector = section.add(f"VECTOR('',#{along},1.)")
        return f"LINE('',#{origin},#{vector})"
    origin, x_axis, axis = axis_frame(curve)
    if isinstance(curve, Geom_Circle):
        return format_placed(section, "CIRCLE", origin, axis, x_axis, curve.Radius())
    return format_placed(section, "ELLIPSE", origin, axis, x_axis, curve.MajorRadius(), curve.MinorRadius())


def _write_line(section: DataSection, axis: Any) -> tuple[int, int]:
    """Write the origin and the direction of an axis and return their numbers."""
    origin = write_point(section, np.array(axis.Location().Coord()))
    (along,) = write_directions(section, np.array([axis.Direction().Coord()]))
    return origin, along


def _format_spline_surface(spline: Geom_BSplineSurface, points: IntArray) -> str:
    """Text of a B-spline surface, rational or not."""
    rows, columns = spline.NbUPoles(), spline.NbVPoles()
    grid = ",".join(format_references(row) for row in points.reshape(rows, columns).tolist())
    closed = f".{'T' if spline.IsUClosed() else 'F'}.,.{'T' if spline.IsVClosed() else 'F'}."
    head = f"{spline.UDegree()},{spline.VDegree()},({grid}),.UNSPECIFIED.,{closed},.F."
    counts = [
        [spline.UMultiplicity(i) for i in range(1, spline.NbUKnots() + 1)],
        [spline.VMultiplicity(i) for i in range(1, spline.NbVKnots() + 1)],
    ]
    knots_u = np.array([spline.UKnot(i) for i in range(1, spline.NbUKnots() + 1)])
    knots_v = np.array([spline.VKnot(i) for i in range(1, spline.NbVKnots() + 1)])
    poles = np.array([[spline.Pole(i, j).Coord() for j in range(1, columns + 1)] for i in range(1, rows + 1)])
    scale = find_knot_scale(poles, np.ptp(knots_u), np.ptp(knots_v))
    knots = [(scale * knots_u).tolist(), (scale * knots_v).tolist()]
    tail = f"{_format_counts(counts)},{_format_values(knots)},.UNSPECIFIED."
    if not (spline.IsURational() or spline.IsVRational()):
        return f"B_SPLINE_SURFACE_WITH_KNOTS('',{head},{tail})"
    weights = [[spline.Weight(i, j) for j in range(1, columns + 1)] for i in range(1, rows + 1)]
    return (
        f"(BOUNDED_SURFACE()B_SPLINE_SURFACE({head})B_SPLINE_SURFACE_WITH_KNOTS({tail})"
        f"GEOMETRIC_REPRESENTATION_ITEM()RATIONAL_B_SPLINE_SURFACE(({_format_values(weights)}))"
        "REPRESENTATION_ITEM('')SURFACE())"
    )


def _format_spline_curve(spline: Geom_BSplineCurve, points: IntArray) -> str:
    """Text of a B-spline curve, rational or not."""
    closed = "T" if spline.IsClosed() else "F"
    head = f"{spline.Degree()},{format_references(points.tolist())},.UNSPECIFIED.,.{closed}.,.F."
    counts = [spline.Multiplicity(i) for i in range(1, spline.NbKnots() + 1)]
    knots = [spline.Knot(i) for i in range(1, spline.NbKnots() + 1)]
    tail = f"{_format_counts([counts])},{_format_values([knots])},.UNSPECIFIED."
    if not spline.IsRational():
        return f"B_SPLINE_CURVE_WITH_KNOTS('',{head},{tail})"
    weights = [spline.Weight(i) for i in range(1, spline.NbPoles() + 1)]
    return (
        f"(BOUNDED_CURVE()B_SPLINE_CURVE({head})B_SPLINE_CURVE_WITH_KNOTS({tail})CURVE()"
        f"GEOMETRIC_REPRESENTATION_ITEM()RATIONAL_B_SPLINE_CURVE({_format_values([weights])})REPRESENTATION_ITEM(''))"
    )


def _format_counts(rows: list[list[int]]) -> str:
    """Lists of integers."""
    return ",".join(f"({','.join(map(str, row))})" for row in rows)


def _format_values(rows: list[list[float]]) -> str:
    """Lists of reals."""
    return ",".join(f"({','.join(format_reals(row))})" for row in rows)

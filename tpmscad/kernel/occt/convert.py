"""Conversion between arrays and OCCT values; the only module that distinguishes OCCT 7.9 from OCCT 8.

OCCT 8 renamed the containers (TColgp_Array2OfPnt became Array2_gp_Pnt) and dropped the suffix of the casts (TopoDS.Face_s
became TopoDS.Face). Everything else used here is common to both versions. Converting a pole takes about one microsecond in
either direction.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Mapping, Sequence
from functools import lru_cache
from typing import Any

import numpy as np
import OCP
from OCP.BinTools import BinTools
from OCP.BRepBuilderAPI import BRepBuilderAPI_Transform
from OCP.Geom import (
    Geom_BSplineCurve,
    Geom_BSplineSurface,
    Geom_Circle,
    Geom_ConicalSurface,
    Geom_Curve,
    Geom_CylindricalSurface,
    Geom_Ellipse,
    Geom_Line,
    Geom_Plane,
    Geom_SphericalSurface,
    Geom_Surface,
    Geom_ToroidalSurface,
)
from OCP.Geom2d import Geom2d_BSplineCurve, Geom2d_Curve, Geom2d_Line
from OCP.gp import gp_Ax2, gp_Ax3, gp_Dir, gp_Dir2d, gp_Pnt, gp_Pnt2d, gp_Trsf
from OCP.TCollection import TCollection_AsciiString
from OCP.TopoDS import TopoDS, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.brep.carriers import (
    Circle,
    ConicalSurface,
    CylindricalSurface,
    EdgeCurve,
    Ellipse,
    Quadric,
    SphericalSurface,
)
from tpmscad.errors import InvalidRequest
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

try:
    from OCP.collections import Array1_double as RealArray
    from OCP.collections import Array1_gp_Pnt as PointArray
    from OCP.collections import Array1_gp_Pnt2d as PointArray2d
    from OCP.collections import Array1_int as IntArray
    from OCP.collections import Array2_gp_Pnt as PointGrid
    from OCP.collections import DataMap_TCollection_AsciiString_TCollection_AsciiString as StringMap
    from OCP.collections import IndexedDataMap_TopoDS_Shape_List_TopoDS_Shape_TopTools_ShapeMapHasher as ShapeMap
    from OCP.collections import List_TopoDS_Shape as ShapeList
    from OCP.collections import Sequence_TCollection_AsciiString as StringSequence
    from OCP.collections import Sequence_TDF_Label as LabelSequence

    as_edge, as_face, as_vertex = TopoDS.Edge, TopoDS.Face, TopoDS.Vertex
    as_shell, as_solid, as_wire, as_compound = TopoDS.Shell, TopoDS.Solid, TopoDS.Wire, TopoDS.Compound
except ImportError:
    from OCP.Resource import Resource_DataMapOfAsciiStringAsciiString as StringMap
    from OCP.TColgp import TColgp_Array1OfPnt as PointArray
    from OCP.TColgp import TColgp_Array1OfPnt2d as PointArray2d
    from OCP.TColgp import TColgp_Array2OfPnt as PointGrid
    from OCP.TColStd import TColStd_Array1OfInteger as IntArray
    from OCP.TColStd import TColStd_Array1OfReal as RealArray
    from OCP.TColStd import TColStd_SequenceOfAsciiString as StringSequence
    from OCP.TDF import TDF_LabelSequence as LabelSequence
    from OCP.TopTools import TopTools_IndexedDataMapOfShapeListOfShape as ShapeMap
    from OCP.TopTools import TopTools_ListOfShape as ShapeList

    as_edge, as_face, as_vertex = TopoDS.Edge_s, TopoDS.Face_s, TopoDS.Vertex_s
    as_shell, as_solid, as_wire, as_compound = TopoDS.Shell_s, TopoDS.Solid_s, TopoDS.Wire_s, TopoDS.Compound_s


string_sequence, label_sequence, shape_map = StringSequence, LabelSequence, ShapeMap
"""Empty OCCT containers: sequences of strings and of a document's labels, and a map from shapes to lists of their ancestors."""

CONFUSION_TOLERANCE = 1e-7
"""OCCT's smallest useful tolerance (Precision::Confusion), given to every vertex, edge and face unless measured worse."""

OCCT_VERSION: tuple[int, ...] = tuple(int(part) for part in OCP.__version__.split(".")[:3])
"""Version of the OCCT library in use, e.g. (7, 9, 3)."""


def shape_list(shapes: Iterable[Any]) -> Any:
    """OCCT list of the shapes."""
    result = ShapeList()
    for shape in shapes:
        result.Append(shape)
    return result


def real_array(count: int) -> Any:
    """OCCT array of `count` numbers, from index 1."""
    return RealArray(1, count)


def int_array(count: int) -> Any:
    """OCCT array of `count` whole numbers, from index 1."""
    return IntArray(1, count)


def _knots(knots: Array) -> tuple[Any, Any]:
    """Distinct knots and their multiplicities, cached: many curves share them, and OCCT constructors copy them."""
    return _cached_knots(knots.tobytes())


@lru_cache(maxsize=256)
def _cached_knots(knots: bytes) -> tuple[Any, Any]:
    values, counts = np.unique(np.frombuffer(knots), return_counts=True)
    reals, ints = RealArray(1, len(values)), IntArray(1, len(values))
    for i, (value, count) in enumerate(zip(values.tolist(), counts.tolist(), strict=True), 1):
        reals.SetValue(i, value)
        ints.SetValue(i, count)
    return reals, ints


def point_grid(points: Array) -> Any:
    """OCCT grid of the points (U, V, 3)."""
    rows, columns, _ = points.shape
    grid = PointGrid(1, rows, 1, columns)
    for i, row in enumerate(points.tolist(), 1):
        for j, (x, y, z) in enumerate(row, 1):
            grid.SetValue(i, j, gp_Pnt(x, y, z))
    return grid


def surface(value: BSplineSurface) -> Geom_Surface:
    """OCCT B-spline surface with the same parameters, poles and knots."""
    (uk, um), (vk, vm) = _knots(value.knots_u), _knots(value.knots_v)
    return Geom_BSplineSurface(point_grid(value.poles), uk, vk, um, vm, value.degree_u, value.degree_v)


def quadric(value: Quadric) -> Geom_Surface:
    """OCCT elementary surface with the same parameters."""
    frame = gp_Ax3(point(value.origin), direction(value.axis), direction(value.x_axis))
    if isinstance(value, CylindricalSurface):
        return Geom_CylindricalSurface(frame, value.radius)
    if isinstance(value, ConicalSurface):
        return Geom_ConicalSurface(frame, value.angle, value.radius)
    if isinstance(value, SphericalSurface):
        return Geom_SphericalSurface(frame, value.radius)
    return Geom_ToroidalSurface(frame, value.major, value.minor)


def curve(value: EdgeCurve) -> Geom_Curve:
    """OCCT curve in space with the same parameter."""
    if isinstance(value, Circle | Ellipse):
        frame = gp_Ax2(point(value.origin), direction(value.normal), direction(value.x_axis))
        if isinstance(value, Circle):
            return Geom_Circle(frame, value.radius)
        return Geom_Ellipse(frame, value.major, value.minor)
    poles = PointArray(1, len(value.poles))
    for i, (x, y, z) in enumerate(value.poles.tolist(), 1):
        poles.SetValue(i, gp_Pnt(x, y, z))
    return Geom_BSplineCurve(poles, *_knots(value.knots), value.degree)


def curve_2d(value: BSplineCurve) -> Geom2d_Curve:
    """OCCT B-spline curve in a surface's parameter plane."""
    poles = PointArray2d(1, len(value.poles))
    for i, (u, v) in enumerate(value.poles.tolist(), 1):
        poles.SetValue(i, gp_Pnt2d(u, v))
    return Geom2d_BSplineCurve(poles, *_knots(value.knots), value.degree)


def line_2d(start: Array, end: Array) -> Geom2d_Curve:
    """Line through two points of a surface's parameter plane, parametrised by distance from the first."""
    along = end - start
    return Geom2d_Line(gp_Pnt2d(*start.tolist()), gp_Dir2d(*along.tolist()))


def line(start: Array, end: Array) -> Geom_Curve:
    """Line through two points in space, parametrised by distance from the first."""
    return Geom_Line(point(start), direction(end - start))


def plane(origin: Array, x_axis: Array, y_axis: Array) -> Geom_Surface:
    """Plane origin + u x_axis + v y_axis; the axes are orthogonal unit vectors."""
    return Geom_Plane(gp_Ax3(point(origin), direction(np.cross(x_axis, y_axis)), direction(x_axis)))


def point(value: Array) -> gp_Pnt:
    """OCCT point at (3,)."""
    return gp_Pnt(*value.tolist())


def direction(value: Array) -> gp_Dir:
    """OCCT unit vector along (3,)."""
    return gp_Dir(*value.tolist())


def transformation(rows: Sequence[float]) -> gp_Trsf:
    """OCCT transformation for x -> R x + t, given the twelve numbers of [R t] row by row; R may be a reflection."""
    result = gp_Trsf()
    result.SetValues(*rows)
    return result


def _expand_knots(knots: Any, counts: Any) -> Array:
    """Knot vector with every knot repeated by its multiplicity."""
    values = [knots.Value(i) for i in range(knots.Lower(), knots.Upper() + 1)]
    return np.repeat(values, [counts.Value(i) for i in range(counts.Lower(), counts.Upper() + 1)])


def is_plain_spline(geometry: Any) -> bool:
    """Whether a surface is a B-spline that is neither rational nor periodic, of which `surface_from_occt` makes arrays."""
    return isinstance(geometry, Geom_BSplineSurface) and not (
        geometry.IsURational() or geometry.IsVRational() or geometry.IsUPeriodic() or geometry.IsVPeriodic()
    )


def surface_from_occt(geometry: Geom_BSplineSurface) -> BSplineSurface:
    """B-spline surface of an OCCT surface that is neither rational nor periodic."""
    nu, nv = geometry.NbUPoles(), geometry.NbVPoles()
    grid = geometry.Poles()
    poles = np.fromiter(
        (c for i in range(1, nu + 1) for j in range(1, nv + 1) for c in grid.Value(i, j).Coord()), float, 3 * nu * nv
    ).reshape(nu, nv, 3)
    return BSplineSurface(
        poles,
        _expand_knots(geometry.UKnots(), geometry.UMultiplicities()),
        _expand_knots(geometry.VKnots(), geometry.VMultiplicities()),
        geometry.UDegree(),
        geometry.VDegree(),
    )


def curve_from_occt(geometry: Geom_BSplineCurve) -> BSplineCurve:
    """B-spline curve of an OCCT curve that is neither rational nor periodic."""
    poles = np.array([geometry.Pole(i).Coord() for i in range(1, geometry.NbPoles() + 1)])
    return BSplineCurve(poles, _expand_knots(geometry.Knots(), geometry.Multiplicities()), geometry.Degree())


def string_map(entries: Mapping[str, str]) -> Any:
    """OCCT map of the strings."""
    result = StringMap()
    for key, value in entries.items():
        result.Bind(TCollection_AsciiString(key), TCollection_AsciiString(value))
    return result


def axis_frame(value: Any) -> tuple[Array, Array, Array]:
    """Origin, x axis and main axis of an OCCT conic or elementary surface: (3,) each."""
    frame = value.Position()
    origin, x_axis, axis = (np.array(c.Coord()) for c in (frame.Location(), frame.XDirection(), frame.Direction()))
    return origin, x_axis, axis


def matrix_from_occt(motion: gp_Trsf) -> Array:
    """The transformation as [R | t], (3, 4)."""
    return np.array([[motion.Value(i, j) for j in range(1, 5)] for i in range(1, 4)])


def transform_shape(shape: TopoDS_Shape, motion: Motion) -> TopoDS_Shape:
    """Copy of the shape moved by x -> R x + t, with the motion applied to its geometry."""
    rows = np.column_stack([motion.rotation, motion.translation]).ravel().tolist()
    return BRepBuilderAPI_Transform(shape, transformation(rows), True).Shape()


def shape_to_bytes(shape: TopoDS_Shape) -> bytes:
    """The shape in OCCT's binary BREP format with shared faces, edges and vertices, to the last bit."""
    stream = io.BytesIO()
    BinTools.Write_s(shape, stream)
    return stream.getvalue()


def shape_from_bytes(content: bytes) -> TopoDS_Shape:
    """The shape of `shape_to_bytes`."""
    shape = TopoDS_Shape()
    BinTools.Read_s(shape, io.BytesIO(content))
    return shape


def encode_file_name(path: str | os.PathLike[str]) -> bytes:
    """The name of a file as OCCT takes it, whatever the locale; InvalidRequest if it is no UTF-8 text."""
    try:
        name = os.fsencode(path)
        name.decode()
    except UnicodeError:
        raise InvalidRequest(
            f"the kernel cannot open {os.fspath(path)!r}, whose name is no UTF-8 text in this locale: rename it"
        ) from None
    return name

"""What the kernel's check (BRepCheck) rejects in a shape: the first face, where it is, and the status that it gives."""

from __future__ import annotations

from collections.abc import Iterator

from OCP.BRep import BRep_Tool
from OCP.BRepCheck import BRepCheck_Analyzer, BRepCheck_Face, BRepCheck_NoError, BRepCheck_Wire
from OCP.TopAbs import TopAbs_WIRE
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Shape

from tpmscad.errors import format_point
from tpmscad.kernel.measure.shape_sampling import sample_edge
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import box_center
from tpmscad.kernel.occt.exploration import edges_of, faces_of, list_subshapes


def describe_invalid_face(shape: TopoDS_Shape) -> str:
    """The first face that the kernel rejects, with its number, surface, place and status; "" if it rejects none."""
    for number, face in enumerate(faces_of(shape)):
        analyzer = BRepCheck_Analyzer(face)
        if not analyzer.IsValid():
            surface = type(BRep_Tool.Surface_s(face)).__name__.removeprefix("Geom_")
            found = ", ".join(dict.fromkeys(_list_statuses(analyzer, face))) or "no status"
            return f"face {number} ({surface} about {format_point(box_center(face))}) has {found}"
    return ""


def _list_statuses(analyzer: BRepCheck_Analyzer, face: TopoDS_Face) -> Iterator[str]:
    """Names of the errors of a face and its wires, and places of the edges that are rejected.

    OCCT 8's bindings do not convert the lists of errors that the analyzer keeps, so that the tests are run one by one.
    """
    check = BRepCheck_Face(face)
    statuses = [check.IntersectWires(), check.ClassifyWires(), check.OrientationOfWires()]
    for wire in map(convert.as_wire, list_subshapes(face, TopAbs_WIRE)):
        own = BRepCheck_Wire(wire)
        crossing = own.SelfIntersect(face, TopoDS_Edge(), TopoDS_Edge())
        statuses += [own.Closed(), own.Orientation(face), own.Closed2d(face), crossing]
    yield from (s.name.removeprefix("BRepCheck_") for s in statuses if s != BRepCheck_NoError)
    for edge in edges_of(face):
        if not analyzer.IsValid(edge):
            yield f"a rejected edge about {format_point(sample_edge(edge, 2)[1])}"

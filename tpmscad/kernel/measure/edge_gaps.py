"""How far the edges of OCCT shapes lie off the surfaces of their faces.

The tolerance of an edge also covers that its pcurves run at another speed than its curve. A STEP file without pcurves has no such
difference: its accuracy is the distance between curves and surfaces alone.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d, BRepAdaptor_Surface
from OCP.BRepGProp import BRepGProp
from OCP.gp import gp_Pnt, gp_Vec
from OCP.GProp import GProp_GProps
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Shape

from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import edges_of, faces_of

GAP_SAMPLES = 9
"""Points of an edge at which its distance from a face is measured."""


def measure_accuracy(shapes: Iterable[TopoDS_Shape]) -> float:
    """Greatest distance in mm of an edge of the shapes from the surface of a face that it bounds.

    It is not below the kernel's confusion. Edges whose tolerance is the confusion are taken to lie on their faces.
    """
    accuracy = CONFUSION_TOLERANCE
    for face in (face for shape in shapes for face in faces_of(shape)):
        surface = BRepAdaptor_Surface(face, False)
        for edge in edges_of(face):
            if BRep_Tool.Tolerance_s(edge) > CONFUSION_TOLERANCE and not BRep_Tool.Degenerated_s(edge):
                accuracy = max(accuracy, _gap(edge, face, surface))
    return accuracy


def measure_edge_length(shape: TopoDS_Shape) -> float:
    """Total length of the edges of a shape, each counted once, in model units."""
    found = GProp_GProps()
    BRepGProp.LinearProperties_s(shape, found, True)
    return float(found.Mass())


def _gap(edge: TopoDS_Edge, face: TopoDS_Face, surface: BRepAdaptor_Surface) -> float:
    """Greatest distance along the normal, at the points that the pcurve gives."""
    curve, on_surface = BRepAdaptor_Curve(edge), BRepAdaptor_Curve2d(edge, face)
    foot, along_u, along_v = gp_Pnt(), gp_Vec(), gp_Vec()
    gap = 0.0
    for t in np.linspace(curve.FirstParameter(), curve.LastParameter(), GAP_SAMPLES).tolist():
        at = on_surface.Value(t)
        surface.D1(at.X(), at.Y(), foot, along_u, along_v)
        off, normal = gp_Vec(foot, curve.Value(t)), along_u.Crossed(along_v)
        length = normal.Magnitude()
        gap = max(gap, abs(off.Dot(normal)) / length if length > 0.0 else off.Magnitude())
    return gap

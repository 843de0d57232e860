"""The edges at which faces of a solid meet at an angle: number and lengths, the sharpest wedge, and the curves they make."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d
from OCP.GCPnts import GCPnts_AbscissaPoint
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face
from scipy.optimize import minimize_scalar

from tpmscad._typing import Array
from tpmscad.fields.analysis.crease_network import count_curves
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, faces_of, first_vertex, last_vertex, orientation_sign
from tpmscad.kernel.occt.geometry_evaluators import OutwardNormals

MIN_CREASE_DEG = 0.1
"""Angle between the normals of two faces from which their edge is a crease."""

SAMPLES = 9
"""Points of an edge, its ends included, at which the wedge is measured."""

N_SEARCHED = 10
"""Edges with the sharpest samples, on which the least wedge is sought between these."""

N_SIDE_POINTS, IN_SIDE_TOL = 5, 1e-5
"""Points of an edge that lies in a side of a box, and their distances from it, model units, a hundred times OCCT's tolerance."""

LENGTH_TOL = 1e-6
"""Absolute error of a length, model units."""


@dataclass(frozen=True, slots=True)
class SolidCreases:
    """Number of creases, their whole length and the shortest, and the least angle of material at one, in degrees, to 360.

    Of those that do not lie in a side of the box: how many curves they make from corner to corner, and the length.
    """

    count: int
    length: float
    shortest: float
    sharpest_deg: float
    inner_curves: int
    inner_length: float


def measure_creases(solids: Any, box: tuple[Array, Array] | None = None) -> SolidCreases:
    """The creases of solids, by the normals of both faces along each edge; of a box, its corners (3,) are given."""
    uses: dict[ShapeKey, list[tuple[TopoDS_Edge, TopoDS_Face]]] = {}
    for solid in solids:
        for face in faces_of(solid):
            for edge in edges_of(face):
                uses.setdefault(ShapeKey(edge), []).append((edge, face))
    lengths: list[float] = []
    wedges: list[tuple[float, int, _Wedge]] = []
    ends, is_inner = [], []
    vertices: dict[ShapeKey, int] = {}
    steps = np.linspace(0.0, 1.0, SAMPLES)
    for pair in uses.values():
        if len(pair) != 2 or ShapeKey(pair[0][1]) == ShapeKey(pair[1][1]):  # a seam, or the edge of a pole
            continue
        edge = _Wedge(*pair)
        degrees = edge.measure(steps)
        if np.abs(180.0 - degrees).max() < MIN_CREASE_DEG:
            continue
        lengths.append(float(GCPnts_AbscissaPoint.Length_s(edge.curve, LENGTH_TOL)))
        k = int(np.argmin(degrees))
        wedges.append((float(degrees[k]), k, edge))
        keys = [ShapeKey(end(pair[0][0])) for end in (first_vertex, last_vertex)]
        ends.append([vertices.setdefault(key, len(vertices)) for key in keys])
        is_inner.append(box is None or not _is_in_side(edge.curve, *box))
    if not lengths:
        return SolidCreases(0, 0.0, 0.0, 180.0, 0, 0.0)
    wedges.sort(key=lambda wedge: wedge[0])
    sharpest = wedges[0][0]
    for _, k, edge in wedges[:N_SEARCHED]:
        between = float(steps[max(k - 1, 0)]), float(steps[min(k + 1, SAMPLES - 1)])
        found = minimize_scalar(lambda t, of=edge: of.measure(np.array([t]))[0], bounds=between, method="bounded")
        sharpest = min(sharpest, float(found.fun))
    inner = np.array(is_inner)
    return SolidCreases(
        len(lengths),
        sum(lengths),
        min(lengths),
        sharpest,
        count_curves(np.array(ends)[inner]),
        float(np.array(lengths)[inner].sum()),
    )


def _is_in_side(curve: BRepAdaptor_Curve, lo: Array, hi: Array) -> bool:
    """Whether an edge lies in a side of a box."""
    parameters = np.linspace(curve.FirstParameter(), curve.LastParameter(), N_SIDE_POINTS)
    points = np.array([curve.Value(t).Coord() for t in parameters.tolist()])
    return bool((np.abs(points[:, None] - np.stack([lo, hi])) < IN_SIDE_TOL).all(axis=0).any())


class _Wedge:
    """The angle of material along an edge between two faces, given as the edge is used by each."""

    def __init__(self, first: tuple[TopoDS_Edge, TopoDS_Face], second: tuple[TopoDS_Edge, TopoDS_Face]) -> None:
        self.curve = BRepAdaptor_Curve(first[0])
        self._sign = orientation_sign(first[0])
        self._sides = [(BRepAdaptor_Curve2d(edge, face), OutwardNormals(face)) for edge, face in (first, second)]

    def measure(self, fractions: Array) -> Array:
        """The angles (n,) in degrees, to 360, at fractions (n,) of the parameters of the edge."""
        start, end = self.curve.FirstParameter(), self.curve.LastParameter()
        at = (start + fractions * (end - start)).tolist()
        n, m = (normals(np.array([curve.Value(t).Coord() for t in at]))[1] for curve, normals in self._sides)
        across = np.cross(n, m)
        turn = np.degrees(np.arctan2(np.linalg.norm(across, axis=1), (n * m).sum(axis=1)))
        tangent, point = gp_Vec(), gp_Pnt()
        tangents = []
        for parameter in at:
            self.curve.D1(parameter, point, tangent)
            tangents.append(tangent.Coord())
        # the first face lies on the left of its edge, seen from outside: at a convex edge the second normal turns to the right
        convex = (across * np.array(tangents)).sum(axis=1) * self._sign > 0
        return np.where(convex, 180.0 - turn, 180.0 + turn)

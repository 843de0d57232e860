"""The edges at which faces of a solid meet at an angle: number and lengths, the sharpest wedge, and the curves they make."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Curve2d
from OCP.GCPnts import GCPnts_AbscissaPoint
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face
from scipy.optimize import minimize_scalar

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import drop_unused_geometry, sample_edges, select_faces
from tpmscad.brep.face_classes import PARAMETER_RESOLUTION
from tpmscad.fields.analysis.crease_network import count_curves
from tpmscad.kernel.build.solids import BrepSolids, build_faces
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


def measure_creases(solids: BrepSolids | Iterable[Any], box: tuple[Array, Array] | None = None) -> SolidCreases:
    """The creases of solids, by the normals of both faces along each edge; of a box, its corners (3,) are given.

    Of solids that were built from arrays, one edge of each class is measured.
    """
    edges = _list_brep_edges(solids) if isinstance(solids, BrepSolids) else _list_edges(solids)
    steps = np.linspace(0.0, 1.0, SAMPLES)
    wedges = [_Wedge(*pair) for pair in edges.pairs]
    degrees = np.array([wedge.measure(steps) for wedge in wedges]).reshape(-1, SAMPLES)
    sharp = np.flatnonzero(np.abs(180.0 - degrees).max(axis=1) >= MIN_CREASE_DEG)
    if not len(sharp):
        return SolidCreases(0, 0.0, 0.0, 180.0, 0, 0.0)
    lengths = np.zeros(len(wedges))
    lengths[sharp] = [float(GCPnts_AbscissaPoint.Length_s(wedges[i].curve, LENGTH_TOL)) for i in sharp.tolist()]
    sharpest = float(degrees[sharp].min())
    for i in sharp[np.argsort(degrees[sharp].min(axis=1), kind="stable")][:N_SEARCHED].tolist():
        k = int(np.argmin(degrees[i]))
        between = float(steps[max(k - 1, 0)]), float(steps[min(k + 1, SAMPLES - 1)])
        found = minimize_scalar(lambda t, of=wedges[i]: of.measure(np.array([t]))[0], bounds=between, method="bounded")
        sharpest = min(sharpest, float(found.fun))
    crease = np.isin(edges.label, sharp)
    inner = crease.copy()
    if box is not None:
        in_side = np.abs(edges.points[:, :, None] - np.stack(box)) < IN_SIDE_TOL
        inner &= ~in_side.all(axis=1).reshape(len(inner), -1).any(axis=1)
    each = lengths[edges.label]
    return SolidCreases(
        int(crease.sum()),
        float(each[crease].sum()),
        float(lengths[sharp].min()),
        sharpest,
        count_curves(edges.ends[inner]),
        float(each[inner].sum()),
    )


Use = tuple[TopoDS_Edge, TopoDS_Face]


@dataclass(frozen=True, slots=True, eq=False)
class _SharedEdges:
    """Edges between two faces: vertices `ends` (e, 2), `points` (e, k, 3) along them, and their classes `label` (e,).

    pairs: of each class one edge, as both faces use it.
    """

    ends: IntArray
    points: Array
    label: IntArray
    pairs: list[tuple[Use, Use]]


def _list_edges(solids: Iterable[Any]) -> _SharedEdges:
    """The edges of solids, each a class of its own; seams and the edges of poles are left out."""
    uses: dict[ShapeKey, list[Use]] = {}
    for face in (face for solid in solids for face in faces_of(solid)):
        for edge in edges_of(face):
            uses.setdefault(ShapeKey(edge), []).append((edge, face))
    pairs = [(of[0], of[1]) for of in uses.values() if len(of) == 2 and ShapeKey(of[0][1]) != ShapeKey(of[1][1])]
    vertices: dict[ShapeKey, int] = {}
    ends, points = [], []
    for (edge, _), _ in pairs:
        keys = [ShapeKey(end(edge)) for end in (first_vertex, last_vertex)]
        ends.append([vertices.setdefault(key, len(vertices)) for key in keys])
        curve = BRepAdaptor_Curve(edge)
        parameters = np.linspace(curve.FirstParameter(), curve.LastParameter(), N_SIDE_POINTS)
        points.append([curve.Value(t).Coord() for t in parameters.tolist()])
    shape = -1, N_SIDE_POINTS, 3
    return _SharedEdges(np.array(ends).reshape(-1, 2), np.array(points).reshape(shape), np.arange(len(pairs)), pairs)


def _list_brep_edges(built: BrepSolids) -> _SharedEdges:
    """The edges of solids built from arrays; those of a class have the same curve, pcurves and surfaces, turned alike."""
    brep = built.brep
    edges, uses, faces, face = brep.edges, brep.uses, brep.faces, brep.face_of_use
    order = np.lexsort((uses.pcurve, faces.carrier[face], uses.edge))
    pair = order.reshape(-1, 2)
    pair = pair[face[pair[:, 0]] != face[pair[:, 1]]]
    own = uses.edge[pair[:, 0]]
    frames = [faces.motion.rotation[face[pair[:, i]]] for i in range(2)]
    turns = [np.swapaxes(frames[0], 1, 2) @ other for other in (frames[1], edges.motion.rotation[own])]
    keys = [
        edges.curve[own],
        *(np.rint(values / PARAMETER_RESOLUTION) for values in edges.span[own].T),
        *(
            column[pair[:, i]]
            for i in range(2)
            for column in (uses.pcurve, uses.sense, faces.carrier[face], faces.sense[face])
        ),
        *(np.rint(turn.reshape(-1, 9) / PARAMETER_RESOLUTION).T.reshape(9, -1) for turn in turns),
    ]
    _, first, label = np.unique(np.vstack(keys).T.astype(np.int64), axis=0, return_index=True, return_inverse=True)
    chosen, place = np.unique(face[pair[first]], return_inverse=True)
    made = build_faces(drop_unused_geometry(select_faces(brep, chosen)))
    of_face = [[edge for edge in edges_of(each) if not BRep_Tool.Degenerated_s(edge)] for each in made]
    begin = faces.use_start[faces.loop_start]
    pairs = []
    for uses_of, at in zip(pair[first].tolist(), place.reshape(-1, 2).tolist(), strict=True):
        both = [(of_face[f][k - int(begin[face[k]])], made[f]) for k, f in zip(uses_of, at, strict=True)]
        pairs.append((both[0], both[1]))
    points = sample_edges(brep, N_SIDE_POINTS)[own]
    return _SharedEdges(np.column_stack([edges.start, edges.end])[own], points, label.ravel(), pairs)


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

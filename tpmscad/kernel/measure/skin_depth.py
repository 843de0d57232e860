"""Depth of points below the faces of a body that carry a skin, and the thickness of a skin between such faces and inner ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_IN, TopAbs_OUT
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.errors import KernelError
from tpmscad.kernel.measure.shape_sampling import sample_edge, sample_faces, sobol_points
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of

MAX_FACE_POINTS = 300
MAX_EDGE_POINTS = 200
"""Points at which the thickness of a skin is measured, each 0.3 to 1 ms."""

POINTS_ACROSS = 24
"""Points along the diagonal of the faces, from which their spacing follows."""

INSET = 0.02
"""In skins: by how much the points below the faces are deeper than the skin."""

PIECES_PER_EDGE = 4
"""Intervals per edge at whose ends the thickness is measured."""


class SkinDepth:
    """Distances of points from the faces of a solid that carry a skin, and whether the points lie in the solid."""

    def __init__(self, solid: TopoDS_Solid, faces: Sequence[TopoDS_Face]) -> None:
        self.solid = solid
        self.faces = tuple(faces)
        self._measure = BRepExtrema_DistShapeShape()
        self._measure.LoadS2(make_compound(self.faces))
        self._classify = BRepClass3d_SolidClassifier(solid)

    def distances(self, points: Array) -> Array:
        """Distances (n,) of points (n, 3) from the nearest face, without sign."""
        found = np.empty(len(points))
        for i, (x, y, z) in enumerate(points.tolist()):
            self._measure.LoadS1(BRepBuilderAPI_MakeVertex(gp_Pnt(x, y, z)).Vertex())
            if not self._measure.Perform():
                raise KernelError("depth below the skin", f"no foot point for ({x:g}, {y:g}, {z:g})", self.solid)
            found[i] = self._measure.Value()
        return found

    def contains(self, points: Array, boundary: bool = True) -> NDArray[np.bool_]:
        """Whether points (n, 3) lie inside the solid, or on its boundary if `boundary`: (n,)."""
        found = np.empty(len(points), bool)
        for i, (x, y, z) in enumerate(points.tolist()):
            self._classify.Perform(gp_Pnt(x, y, z), CONFUSION_TOLERANCE)
            state = self._classify.State()
            found[i] = state != TopAbs_OUT if boundary else state == TopAbs_IN
        return found

    def __call__(self, points: Array) -> Array:
        """Depths (n,) of points (n, 3), negative outside the solid."""
        return np.where(self.contains(points), 1.0, -1.0) * self.distances(points)


@dataclass(frozen=True, slots=True, eq=False)
class SkinThickness:
    """Thicknesses (n,) of a skin at points (n, 3) of its inner faces, in model units."""

    points: Array
    thickness: Array

    @property
    def least(self) -> float:
        """The least thickness."""
        return float(self.thickness.min(initial=np.inf))

    @property
    def greatest(self) -> float:
        """The greatest thickness."""
        return float(self.thickness.max(initial=0.0))

    def locate(self, value: float) -> str:
        """The place of the thickness nearest to a value, for messages."""
        return ", ".join(f"{c:.4g}" for c in self.points[np.abs(self.thickness - value).argmin()])


def measure_skin_thickness(inner: Sequence[TopoDS_Face], depth: SkinDepth) -> SkinThickness:
    """Thickness of the skin between inner faces and the faces that carry it, on the faces and along their edges.

    inner: faces of the offset body, or what is left of them on the finished solid, without those in open faces.
    """
    if not inner:
        return SkinThickness(np.zeros((0, 3)), np.zeros(0))
    low, high = np.inf, -np.inf
    for face in inner:
        box = enclosing_box(face)
        low, high = np.minimum(low, box[0]), np.maximum(high, box[1])
    on_faces = sample_faces(inner, float(np.linalg.norm(high - low)) / POINTS_ACROSS).points
    edges = {ShapeKey(e): e for face in inner for e in edges_of(face) if not BRep_Tool.Degenerated_s(e)}
    along = np.concatenate([np.zeros((0, 3)), *(sample_edge(edge, PIECES_PER_EDGE) for edge in edges.values())])
    rng = np.random.default_rng(0)
    chosen = [
        points if len(points) <= most else rng.choice(points, most, replace=False)
        for points, most in ((on_faces, MAX_FACE_POINTS), (along, MAX_EDGE_POINTS))
    ]
    points = np.concatenate(chosen)
    return SkinThickness(points, depth.distances(points))


def sample_depths(depth: SkinDepth, skin: float, in_box: int, below_faces: int) -> tuple[Array, Array]:
    """Points (n, 3) inside the solid that tell whether an offset by `skin` misses a part, and their depths (n,).

    `in_box` quasi-random points fill the solid's box and find what is large; up to `below_faces` points lie just deeper than the
    skin below its faces and find what is thin, since every part deeper than the skin comes that near to a face.
    """
    low, high = enclosing_box(depth.solid)
    rng = np.random.default_rng(0)
    anywhere = low + (high - low) * sobol_points(in_box, 3, rng)
    on_faces = sample_faces(depth.faces, float(np.linalg.norm(high - low)) / POINTS_ACROSS)
    below = on_faces.points - (1 + INSET) * skin * on_faces.normals
    if len(below) > below_faces:
        below = rng.choice(below, below_faces, replace=False)
    points = np.concatenate([anywhere, below])
    points = points[depth.contains(points, boundary=False)]
    return points, depth.distances(points)

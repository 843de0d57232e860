"""Depth of points below the faces of a body that carry a skin, and the thickness of a skin between such faces and inner ones."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepExtrema import BRepExtrema_DistShapeShape, BRepExtrema_IsInFace
from OCP.BRepGProp import BRepGProp_Face
from OCP.gp import gp_Pnt, gp_Vec
from OCP.TopAbs import TopAbs_OUT
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.errors import KernelError, format_point
from tpmscad.kernel.measure.shape_sampling import sample_edge, sample_faces, sobol_points
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, faces_of

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
    """Distances of points from the faces of a solid that carry a skin, and whether the points lie in the solid.

    A point whose nearest point is inside a face lies on the side of the face's normal that it is seen from. The kernel's
    classifier is asked only where the nearest point is on an edge, or where not all faces carry a skin: in a solid of splines it
    takes 82 ms a point, a distance 2 to 5 ms.
    """

    def __init__(self, solid: TopoDS_Solid, faces: Sequence[TopoDS_Face]) -> None:
        self.solid = solid
        self.faces = tuple(faces)
        self._measure = BRepExtrema_DistShapeShape()
        self._measure.LoadS2(make_compound(self.faces))
        self._classify = BRepClass3d_SolidClassifier(solid)
        self._is_whole = len(self.faces) == len(faces_of(solid))

    def distances(self, points: Array) -> Array:
        """Distances (n,) of points (n, 3) from the nearest face, without sign."""
        return self.find_feet(points)[0]

    def find_feet(self, points: Array) -> tuple[Array, Array]:
        """The same, and the nearest points (n, 3) of the faces."""
        found = [(self._distance(point), *self._measure.PointOnShape2(1).Coord()) for point in points.tolist()]
        rows = np.array(found).reshape(-1, 4)
        return rows[:, 0], rows[:, 1:]

    def __call__(self, points: Array) -> Array:
        """Depths (n,) of points (n, 3), negative outside the solid."""
        depth = np.empty(len(points))
        for i, point in enumerate(points.tolist()):
            depth[i] = self._distance(point)
            side = self._side_of_foot() if self._is_whole else None
            if side is None:
                self._classify.Perform(gp_Pnt(*point), CONFUSION_TOLERANCE)
                side = -1.0 if self._classify.State() == TopAbs_OUT else 1.0
            depth[i] *= side
        return depth

    def _distance(self, point: list[float]) -> float:
        """Distance of a point; the foot is then known."""
        self._measure.LoadS1(BRepBuilderAPI_MakeVertex(gp_Pnt(*point)).Vertex())
        if not self._measure.Perform():
            raise KernelError("distance from faces", f"no foot point for {format_point(point)}", self.solid)
        return float(self._measure.Value())

    def _side_of_foot(self) -> float | None:
        """1 if the last point is behind the face that holds its foot, -1 if before it, None if the foot is on an edge."""
        if self._measure.SupportTypeShape2(1) != BRepExtrema_IsInFace:
            return None
        foot, normal = gp_Pnt(), gp_Vec()
        face = convert.as_face(self._measure.SupportOnShape2(1))
        BRepGProp_Face(face).Normal(*self._measure.ParOnFaceS2(1), foot, normal)
        return 1.0 if gp_Vec(foot, self._measure.PointOnShape1(1)).Dot(normal) <= 0 else -1.0


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
    on_faces = sample_faces(inner, float(np.linalg.norm(high - low)) / POINTS_ACROSS, exact=True).points
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
    depths = depth(points)
    inside = depths > CONFUSION_TOLERANCE
    return points[inside], depths[inside]

"""The signed distance to a CAD body as a field: its foot points by the kernel, one at a time, a quarter of a millisecond each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRepBuilderAPI import BRepBuilderAPI_MakeVertex
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.BRepExtrema import BRepExtrema_DistShapeShape
from OCP.gp import gp_Pnt
from OCP.TopAbs import TopAbs_IN
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad._typing import Array
from tpmscad.errors import KernelError
from tpmscad.fields.evaluation import FieldJet, stack_points
from tpmscad.fields.field import Field
from tpmscad.kernel.measure.cad_body import read_body
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import faces_of

DIFFERENCE_STEP = 1e-4
"""Model units: nearer to the surface than this the direction to the foot point is taken from points that far off."""


@dataclass(frozen=True, slots=True, eq=False)
class BodyDistance(Field):
    """Signed distance to a solid's faces, or to some of them, negative inside; outside its box by the box's test alone."""

    solid: TopoDS_Solid
    low: Array
    high: Array
    faces: tuple[TopoDS_Face, ...]

    def at(self, x: Array, y: Array, z: Array) -> Array:
        points, shape = stack_points(x, y, z)
        return self._distances(points)[0].reshape(shape)

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        points, shape = stack_points(x, y, z)
        value, feet = self._distances(points)
        near = np.abs(value) < DIFFERENCE_STEP
        slopes = np.empty_like(points)
        slopes[~near] = (points - feet)[~near] / value[~near, None]
        if near.any():
            for axis in range(3):
                step = DIFFERENCE_STEP * np.eye(3)[axis]
                ahead, behind = (self._distances(points[near] + way * step)[0] for way in (1, -1))
                slopes[near, axis] = (ahead - behind) / (2 * DIFFERENCE_STEP)
        gx, gy, gz = (slopes[:, axis].reshape(shape) for axis in range(3))
        return value.reshape(shape), gx, gy, gz

    def _distances(self, points: Array) -> tuple[Array, Array]:
        measure = BRepExtrema_DistShapeShape()
        measure.LoadS2(make_compound(self.faces))
        classify = BRepClass3d_SolidClassifier(self.solid)
        within = np.all((points > self.low) & (points < self.high), axis=1).tolist()
        value, feet = np.empty(len(points)), np.empty((len(points), 3))
        for i, (x, y, z) in enumerate(points.tolist()):
            at = gp_Pnt(x, y, z)
            measure.LoadS1(BRepBuilderAPI_MakeVertex(at).Vertex())
            if not measure.Perform():
                raise KernelError("distance to the body", f"no foot point for ({x:g}, {y:g}, {z:g})", self.solid)
            value[i], feet[i] = measure.Value(), measure.PointOnShape2(1).Coord()
            if within[i]:
                classify.Perform(at, CONFUSION_TOLERANCE)
                if classify.State() == TopAbs_IN:
                    value[i] = -value[i]
        return value, feet


def body_field(shape: Any) -> Field:
    """Signed distance to a CAD body (build123d, CadQuery, TopoDS, or a STEP file's path), negative inside; errors as `infill`.

    Each point takes the kernel about a quarter of a millisecond.
    """
    body = read_body(shape)
    return BodyDistance(body.shape, *enclosing_box(body.shape), tuple(faces_of(body.shape)))

"""Circular edges of a STEP file that run the long way round between their vertices, and how they are turned.

An edge on a circle states two vertices and, by one flag, the way from the first to the second. Some programs write the wrong flag
for mirrored or repeated features: an arc of 4 degrees becomes one of 356. The kernel's reader then cuts the arc where it crosses
the other edges of its face, so that nothing of the fault is left in the shape. The flags are changed before the translation.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np
from OCP.STEPControl import STEPControl_Reader
from OCP.StepGeom import (
    StepGeom_Axis2Placement3d,
    StepGeom_CartesianPoint,
    StepGeom_Circle,
    StepGeom_Curve,
    StepGeom_SurfaceCurve,
)
from OCP.StepShape import StepShape_EdgeCurve, StepShape_FaceSurface, StepShape_VertexPoint
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Face

from tpmscad._typing import Array
from tpmscad.kernel.step.sphere_seams import edges_of_face_entity

MIN_LONG_ANGLE = np.pi + 1e-9
"""Radians: an arc of half a circle is as long in either direction."""


@dataclass(frozen=True, slots=True)
class CircularEdges:
    """Numbers of the entities of circular edges.

    long: arcs of more than half a circle; suspect: those on faces under suspicion; closed: whole circles on such faces.
    """

    long: tuple[int, ...]
    suspect: tuple[int, ...]
    closed: tuple[int, ...]


def find_circular_edges(
    reader: STEPControl_Reader, faces: Iterable[TopoDS_Face], suspects: Iterable[TopoDS_Face]
) -> CircularEdges:
    """The circular edges that a file states for some faces of its translation, and for those of them under suspicion."""
    # `Number` does not find entities in these bindings; the list keeps them alive, and with them their identities
    model = reader.StepModel()
    entities = [model.Value(i) for i in range(1, model.NbEntities() + 1)]
    numbers = {id(entity): i for i, entity in enumerate(entities, 1) if isinstance(entity, StepShape_EdgeCurve)}
    angles, suspected = (_measure_angles(reader, of, numbers) for of in (faces, suspects))
    return CircularEdges(
        tuple(i for i, angle in angles.items() if MIN_LONG_ANGLE < angle < 2.0 * np.pi),
        tuple(i for i, angle in suspected.items() if MIN_LONG_ANGLE < angle < 2.0 * np.pi),
        tuple(i for i, angle in suspected.items() if angle == 2.0 * np.pi),
    )


def turn_arcs(reader: STEPControl_Reader, numbers: Iterable[int]) -> None:
    """Change the sense of circular edges of a file that was read, and not yet translated."""
    model = reader.StepModel()
    for number in numbers:
        edge = model.Value(number)
        edge.SetSameSense(not edge.SameSense())


def _measure_angles(
    reader: STEPControl_Reader, faces: Iterable[TopoDS_Face], numbers: Mapping[int, int]
) -> dict[int, float]:
    """Angles of the circular edges of faces by their numbers, which `numbers` tells of their identities."""
    transfer, angles = reader.WS().TransferReader(), {}
    for face in faces:
        entity = transfer.EntityFromShapeResult(face.Located(TopLoc_Location()), 1)
        for edge in edges_of_face_entity(entity) if isinstance(entity, StepShape_FaceSurface) else ():
            if isinstance(edge, StepShape_EdgeCurve) and (angle := _measure_angle(edge)) is not None:
                angles[numbers[id(edge)]] = angle
    return angles


def _measure_angle(edge: StepShape_EdgeCurve) -> float | None:
    """Angle from the start to the end of an edge on a circle, radians, 2 pi if it is closed; None on other curves."""
    circle, ends = _circle_of(edge.EdgeGeometry()), (edge.EdgeStart(), edge.EdgeEnd())
    if circle is None:
        return None
    if ends[0] is ends[1]:
        return 2.0 * np.pi
    placement = circle.Position().Axis2Placement3d()
    points = [vertex.VertexGeometry() for vertex in ends if isinstance(vertex, StepShape_VertexPoint)]
    if not isinstance(placement, StepGeom_Axis2Placement3d) or len(points) < 2:
        return None
    if not all(isinstance(point, StepGeom_CartesianPoint) for point in points):
        return None
    centre = _coordinates(placement.Location())
    axis = np.array([0.0, 0.0, 1.0])
    if placement.HasAxis():
        axis = np.array([placement.Axis().DirectionRatiosValue(k) for k in (1, 2, 3)])
        axis /= np.linalg.norm(axis)
    first, last = (_coordinates(point) - centre for point in points)
    angle = float(np.arctan2(np.cross(first, last) @ axis, first @ last))
    return (angle if edge.SameSense() else -angle) % (2.0 * np.pi)


def _circle_of(curve: StepGeom_Curve) -> StepGeom_Circle | None:
    """The circle of an edge's geometry, or of the curve in space of a curve on surfaces."""
    while isinstance(curve, StepGeom_SurfaceCurve):
        curve = curve.Curve3d()
    return curve if isinstance(curve, StepGeom_Circle) else None


def _coordinates(point: StepGeom_CartesianPoint) -> Array:
    return np.array([point.CoordinatesValue(k) for k in (1, 2, 3)])

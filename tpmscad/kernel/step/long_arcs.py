"""Circular edges of a STEP file that run the long way round between their vertices, and how they are turned.

An edge on a circle states two vertices and, by one flag, the way from the first to the second. Some programs write the wrong flag
for mirrored or repeated features: an arc of 4 degrees becomes one of 356. The kernel's reader then cuts the arc where it crosses
the other edges of its face, so that nothing of the fault is left in the shape. The flags are changed before the translation.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np
from OCP.STEPControl import STEPControl_Reader
from OCP.StepGeom import (
    StepGeom_Axis2Placement3d,
    StepGeom_CartesianPoint,
    StepGeom_Circle,
    StepGeom_Curve,
    StepGeom_Plane,
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
    """Numbers of the entities of circular edges that may have to be turned, those together that are turned together.

    long: arcs of more than half a circle; those on a face that is not plane belong together, as the two rims of a cylinder.
    suspect: those of them with an arc on a face under suspicion; closed: whole circles on such faces.
    """

    long: tuple[tuple[int, ...], ...]
    suspect: tuple[tuple[int, ...], ...]
    closed: tuple[tuple[int, ...], ...]


def find_circular_edges(
    reader: STEPControl_Reader, faces: Iterable[TopoDS_Face], suspects: Iterable[TopoDS_Face]
) -> CircularEdges:
    """The circular edges that a file states for some faces of its translation, and for those of them under suspicion."""
    # `Number` does not find entities in these bindings; the list keeps them alive, and with them their identities
    model = reader.StepModel()
    entities = [model.Value(i) for i in range(1, model.NbEntities() + 1)]
    numbers = {id(entity): i for i, entity in enumerate(entities, 1) if isinstance(entity, StepShape_EdgeCurve)}
    groups: list[set[int]] = []
    for is_plane, angles in _measure_angles(reader, faces, numbers):
        arcs = {number for number, angle in angles.items() if MIN_LONG_ANGLE < angle < 2.0 * np.pi}
        for found in [{arc} for arc in arcs] if is_plane else [arcs]:
            met = [group for group in groups if group & found]
            groups = [group for group in groups if group not in met] + ([found.union(*met)] if found else [])
    suspected = [angles for _, angles in _measure_angles(reader, suspects, numbers)]
    long = tuple(tuple(sorted(group)) for group in groups)
    return CircularEdges(
        long,
        tuple(group for group in long if any(arc in angles for angles in suspected for arc in group)),
        tuple((i,) for i in sorted({i for of in suspected for i, angle in of.items() if angle == 2.0 * np.pi})),
    )


def turn_arcs(reader: STEPControl_Reader, numbers: Iterable[int]) -> None:
    """Change the sense of circular edges of a file that was read, and not yet translated."""
    model = reader.StepModel()
    for number in numbers:
        edge = model.Value(number)
        edge.SetSameSense(not edge.SameSense())


def _measure_angles(
    reader: STEPControl_Reader, faces: Iterable[TopoDS_Face], numbers: Mapping[int, int]
) -> Iterator[tuple[bool, dict[int, float]]]:
    """Of each face whether it is plane, and the angles of its circular edges by number; `numbers` tells these of identities."""
    transfer = reader.WS().TransferReader()
    for face in faces:
        entity = transfer.EntityFromShapeResult(face.Located(TopLoc_Location()), 1)
        if isinstance(entity, StepShape_FaceSurface):
            edges = [edge for edge in edges_of_face_entity(entity) if isinstance(edge, StepShape_EdgeCurve)]
            angles = {numbers[id(edge)]: _measure_angle(edge) for edge in edges}
            is_plane = isinstance(entity.FaceGeometry(), StepGeom_Plane)
            yield is_plane, {number: angle for number, angle in angles.items() if angle is not None}


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

"""Spheres of a STEP file that have a seam on an edge: they are given a frame whose seam is clear, before they are translated.

A closed curve on a sphere bounds two regions. The kernel's reader decides between them by parameter curves that it makes itself
where the file has none, and chooses the wrong one where edges lie on the seam. It then turns the face round, and with it the
solid, so that its check finds nothing: a quarter of a ball becomes a ball without a quarter. A sphere is the same in any frame.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepAdaptor import BRepAdaptor_Curve, BRepAdaptor_Surface
from OCP.GeomAbs import GeomAbs_Sphere
from OCP.GeomToStep import GeomToStep_MakeDirection
from OCP.gp import gp_Dir
from OCP.STEPControl import STEPControl_Reader
from OCP.StepGeom import (
    StepGeom_Axis2Placement3d,
    StepGeom_SphericalSurface,
    StepGeom_SurfaceCurve,
)
from OCP.StepShape import StepShape_EdgeCurve, StepShape_EdgeLoop, StepShape_FaceSurface
from OCP.TCollection import TCollection_HAsciiString
from OCP.TopLoc import TopLoc_Location
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape

from tpmscad._typing import Array
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.convert import axis_frame
from tpmscad.kernel.occt.exploration import edges_of, faces_of

FRAMES, TURNS = 100, 12
"""Directions of the middle of a seam, and turns about each, that are compared."""

EDGE_SAMPLES = 33
"""Points of each edge that are to keep clear of the seam."""

MIN_SEAM_CLEARANCE = 0.05
"""In radii: distance of edges from the seam and the poles below which another frame is sought."""

Frames = dict[int, tuple[Array, Array]]
"""Axis and x axis of spheres, by the numbers of their entities in the file."""


def find_clear_frames(reader: STEPControl_Reader, shape: TopoDS_Shape) -> Frames:
    """Frames for the spheres of a file, read and translated to `shape`, whose seam or poles lie next to edges of their faces.

    Spheres with parameter curves in the file, with seams among its edges, or without a better frame are left as they are.
    """
    transfer, model = reader.WS().TransferReader(), reader.StepModel()
    entities = [
        (i, model.Value(i)) for i in range(1, model.NbEntities() + 1)
    ]  # `Number` does not find them in these bindings
    number_of = {id(entity): i for i, entity in entities if isinstance(entity, StepGeom_SphericalSurface)}
    borders: dict[int, list[Array]] = {}
    present: dict[int, tuple[Array, Array]] = {}
    for face in faces_of(shape):
        surface = BRepAdaptor_Surface(face, False)
        if surface.GetType() != GeomAbs_Sphere:
            continue
        own = convert.as_face(face.Located(TopLoc_Location()))
        entity = transfer.EntityFromShapeResult(own, 1)
        if not isinstance(entity, StepShape_FaceSurface):
            continue
        sphere = entity.FaceGeometry()
        if id(sphere) not in number_of or not _edges_may_move(entity):
            continue
        centre, x_axis, axis = axis_frame(BRepAdaptor_Surface(own, False).Sphere())
        number = number_of[id(sphere)]
        present[number] = axis, x_axis
        radius = surface.Sphere().Radius()
        borders.setdefault(number, []).append((_sample_border(own) - centre) / radius)
    found: Frames = {}
    for number, parts in borders.items():
        border = np.vstack(parts)
        if not len(border) or _measure_clearance(border, *present[number]) >= MIN_SEAM_CLEARANCE:
            continue
        axis, x_axis, clearance = _choose_frame(border)
        if clearance >= MIN_SEAM_CLEARANCE:
            found[number] = axis, x_axis
    return found


def turn_spheres(reader: STEPControl_Reader, frames: Frames) -> None:
    """Give spheres of a file that was read, and not yet translated, other frames about their centres."""
    model, no_name = reader.StepModel(), TCollection_HAsciiString("")
    for number, frame in frames.items():
        sphere = model.Value(number)
        directions = [GeomToStep_MakeDirection(gp_Dir(*vector.tolist())).Value() for vector in frame]
        placement = StepGeom_Axis2Placement3d()
        placement.Init(no_name, sphere.Position().Location(), True, directions[0], True, directions[1])
        sphere.SetPosition(placement)


def _edges_may_move(face: StepShape_FaceSurface) -> bool:
    """Whether the edges of a face of a file have no parameter curves, and none is used twice, as a seam is."""
    edges = list(edges_of_face_entity(face))
    curves = [edge.EdgeGeometry() for edge in edges if isinstance(edge, StepShape_EdgeCurve)]
    return not any(isinstance(curve, StepGeom_SurfaceCurve) for curve in curves) and len(set(map(id, edges))) == len(
        edges
    )


def edges_of_face_entity(face: StepShape_FaceSurface) -> Iterator[object]:
    """The edges of the loops of a face of a file."""
    for i in range(1, face.NbBounds() + 1):
        loop = face.BoundsValue(i).Bound()
        if isinstance(loop, StepShape_EdgeLoop):
            for k in range(1, loop.NbEdgeList() + 1):
                yield loop.EdgeListValue(k).EdgeElement()


def _sample_border(face: TopoDS_Face) -> Array:
    """Points (n, 3) along the edges of a face that are neither seams nor poles."""
    points: list[tuple[float, float, float]] = []
    for edge in edges_of(face):
        if BRep_Tool.Degenerated_s(edge) or BRep_Tool.IsClosed_s(edge, face):
            continue
        curve = BRepAdaptor_Curve(edge)
        t = np.linspace(curve.FirstParameter(), curve.LastParameter(), EDGE_SAMPLES)
        points += [curve.Value(s).Coord() for s in t.tolist()]
    return np.array(points).reshape(-1, 3)


def _choose_frame(border: Array) -> tuple[Array, Array, float]:
    """Axis and x axis of a sphere whose seam is farthest from points (n, 3) of the unit sphere, and how far it is."""
    best: tuple[Array, Array, float] | None = None
    for x_axis in spread_directions(FRAMES):
        across = np.linalg.svd(x_axis[None])[2][1:]
        for angle in np.pi * np.arange(TURNS) / TURNS:
            axis = np.cos(angle) * across[0] + np.sin(angle) * across[1]
            clearance = _measure_clearance(border, axis, x_axis)
            if best is None or clearance > best[2]:
                best = axis, x_axis, clearance
    assert best is not None
    return best


def _measure_clearance(border: Array, axis: Array, x_axis: Array) -> float:
    """Distance of points (n, 3) of the unit sphere from the half circle through x_axis between the poles, about."""
    to_pole = np.sqrt(np.maximum(2.0 - 2.0 * np.abs(border @ axis), 0.0))
    beside = np.where(border @ x_axis > 0, np.abs(border @ np.cross(axis, x_axis)), to_pole)
    return float(beside.min())


def spread_directions(count: int) -> Array:
    """Unit vectors (count, 3) on a spiral about no direction of symmetry."""
    i = np.arange(count) + 0.5
    z, angle = 1.0 - 2.0 * i / count, np.pi * (1.0 + 5.0**0.5) * i
    r = np.sqrt(1.0 - z * z)
    turn, _ = np.linalg.qr(np.array([[0.59, -0.41, 0.70], [0.23, 0.83, 0.50], [0.77, 0.38, -0.51]]))
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), z]) @ turn.T

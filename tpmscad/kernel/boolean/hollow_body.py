"""Subtraction of voids from a CAD body without intersections: void shells are reversed, and open faces get holes."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder, BRep_Tool
from OCP.BRepClass import BRepClass_FaceClassifier
from OCP.BRepClass3d import BRepClass3d
from OCP.BRepTools import BRepTools_WireExplorer
from OCP.Geom import Geom_ElementarySurface, Geom_Plane
from OCP.TopAbs import TopAbs_IN, TopAbs_SHELL, TopAbs_VERTEX, TopAbs_WIRE
from OCP.TopoDS import TopoDS_Face, TopoDS_Shape, TopoDS_Solid, TopoDS_Wire

from tpmscad.brep.carriers import Plane
from tpmscad.brep.loops import LoopError, nest_loops
from tpmscad.errors import InvalidRequest, KernelError
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.shell_assembly import assemble_solids
from tpmscad.kernel.measure.shape_sampling import find_creases, sample_edge, sample_faces
from tpmscad.kernel.measure.skin_depth import SkinDepth
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_solid
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, faces_of, list_subshapes, orientation_sign, unwrap
from tpmscad.kernel.recognise.face_carriers import evaluate_mid_face

OPERATION = "opening of the skin"

OPENING_TOL = 1e-6
"""Model units: largest distance of a void face from the open face through which the void opens."""

CHORDS_PER_EDGE = 16
"""Chords per edge when loops are nested."""


def subtract_voids(
    body: CadBody, voids: Sequence[TopoDS_Solid], open_faces: Sequence[TopoDS_Face]
) -> tuple[TopoDS_Solid, ...]:
    """The body without the voids, largest first.

    The voids are disjoint solids inside the body that touch its boundary in open faces only. Their shells are reversed, and their
    faces in an open face become holes of it. Raises KernelError if the result is not closed.
    """
    shells = [convert.as_shell(shell.Reversed()) for void in voids for shell in _shells(void)]
    if not open_faces and len(shells) == len(voids):
        return (make_solid([*_shells(body.shape), *shells]),)
    holes: list[list[TopoDS_Face]] = [[] for _ in open_faces]
    planes = [_outward_plane(face) for face in open_faces]
    faces = [f for f in faces_of(body.shape) if not any(f.IsSame(face) for face in open_faces)]
    for void in voids:
        for face in faces_of(void):
            at = next((i for i, o in enumerate(open_faces) if _is_in_opening(face, planes[i], o)), None)
            if at is None:
                faces.append(convert.as_face(face.Reversed()))
            else:
                holes[at].append(face)
    for face, plane, of in zip(open_faces, planes, holes, strict=True):
        faces += _cut_holes(face, plane, of)
    return assemble_solids(faces)[0]


def resolve_open_faces(body: CadBody, faces: Iterable[Any]) -> tuple[TopoDS_Face, ...]:
    """Faces of the body for faces (build123d, CadQuery, TopoDS) or indices in the body's order.

    Raises InvalidRequest if a face does not belong to the body, is not planar, shares an edge with another open face, or joins
    its neighbours smoothly.
    """
    own, found = faces_of(body.shape), []
    for requested in faces:
        shape = unwrap(requested)
        if isinstance(shape, int | np.integer):
            face = own[shape] if 0 <= shape < len(own) else None
        else:
            face = next((f for f in own if isinstance(shape, TopoDS_Face) and f.IsSame(shape)), None)
        if face is None:
            raise InvalidRequest(
                f"open_faces: {requested!r} is no face of {body.name}: pass faces of the same shape object, or indices "
                f"from 0 to {len(own) - 1} in its order"
            )
        if not isinstance(BRep_Tool.Surface_s(face), Geom_Plane):
            raise InvalidRequest(
                f"open_faces: {requested!r} is not planar: keep the skin on it, and drill through it afterwards"
            )
        found.append(face)
    smooth = find_creases(own, float(np.ptp(body.report.bounds, axis=0).max())).smooth_group
    for face in found:
        if np.count_nonzero(smooth == smooth[next(i for i, f in enumerate(own) if f.IsSame(face))]) > 1:
            x, y, z = np.concatenate([sample_edge(edge, 4) for edge in edges_of(face)]).mean(axis=0)
            raise InvalidRequest(
                f"open_faces: the face about ({x:.4g}, {y:.4g}, {z:.4g}) joins another face smoothly, so that the skin has no "
                "edge to end at: open a face with sharp edges, or add the fillets afterwards"
            )
    edges = [ShapeKey(edge) for face in found for edge in edges_of(face)]
    if len(set(edges)) < len(edges):
        raise InvalidRequest("open_faces: two of the faces meet in an edge or are the same: remove one of them")
    return tuple(found)


def find_skin_faces(
    voids: Sequence[TopoDS_Solid], inner: Sequence[CadBody], open_faces: Sequence[TopoDS_Face]
) -> list[TopoDS_Face]:
    """The faces of the voids that lie on the boundary of the offset bodies, without those in open faces.

    On planes and quadrics they are known by their surfaces, since those of a lattice are splines; among splines the distance
    of their vertices and of a point inside them from the offset bodies decides.
    """
    planes = [_outward_plane(face) for face in open_faces]
    free_form = [f for body in inner for f in faces_of(body.shape) if _is_spline(f)]
    near = _NearFaces(SkinDepth(inner[0].shape, free_form)) if free_form else None
    found = []
    for face in (face for void in voids for face in faces_of(void)):
        if any(_is_in_opening(face, plane, of) for plane, of in zip(planes, open_faces, strict=True)):
            continue
        if not _is_spline(face) or (near is not None and near.holds(face)):
            found.append(face)
    return found


class _NearFaces:
    """Whether faces lie on others to OPENING_TOL; vertices that faces share are measured once."""

    def __init__(self, depth: SkinDepth) -> None:
        self.depth = depth
        self._vertices: dict[ShapeKey, bool] = {}

    def holds(self, face: TopoDS_Face) -> bool:
        """Whether all vertices of a face, and a point inside it, lie on the others."""
        if not all(self._is_near(vertex) for vertex in list_subshapes(face, TopAbs_VERTEX)):
            return False
        points = sample_faces([face], np.inf).points[:1]
        return len(points) > 0 and bool(self.depth.distances(points)[0] < OPENING_TOL)

    def _is_near(self, vertex: TopoDS_Shape) -> bool:
        key = ShapeKey(vertex)
        if key not in self._vertices:
            tolerance = max(OPENING_TOL, BRep_Tool.Tolerance_s(convert.as_vertex(vertex)))
            at = np.array([BRep_Tool.Pnt_s(convert.as_vertex(vertex)).Coord()])
            self._vertices[key] = bool(self.depth.distances(at)[0] < tolerance)
        return self._vertices[key]


def count_closed_cavities(body: CadBody, open_faces: Sequence[TopoDS_Face]) -> int:
    """Cavities that the body has of its own and that no open face bounds."""
    outer = BRepClass3d.OuterShell_s(body.shape)
    cavities = [shell for shell in _shells(body.shape) if not shell.IsSame(outer)]
    return sum(not any(f.IsSame(o) for f in faces_of(shell) for o in open_faces) for shell in cavities)


def _is_spline(face: TopoDS_Face) -> bool:
    """Whether the face lies on neither a plane nor a quadric."""
    return not isinstance(BRep_Tool.Surface_s(face), Geom_Plane | Geom_ElementarySurface)


def _shells(solid: TopoDS_Solid) -> list[Any]:
    """Shells of a solid."""
    return [convert.as_shell(shell) for shell in list_subshapes(solid, TopAbs_SHELL)]


def _outward_plane(face: TopoDS_Face) -> Plane:
    """Plane of a planar face with the outward normal."""
    _, point, normal, beside = evaluate_mid_face(face)
    x, out = beside - point, orientation_sign(face) * normal
    return Plane(point, x / np.linalg.norm(x), out / np.linalg.norm(out))


def _is_in_opening(face: TopoDS_Face, plane: Plane, opening: TopoDS_Face) -> bool:
    """True if a void's face lies in the open face."""
    if not isinstance(BRep_Tool.Surface_s(face), Geom_Plane):
        return False
    points = np.concatenate([sample_edge(edge, 2) for edge in edges_of(face)])
    if np.abs(plane.distance(points)).max() > OPENING_TOL:
        return False
    return BRepClass_FaceClassifier(opening, convert.point(points[0]), OPENING_TOL).State() == TopAbs_IN


def _cut_holes(face: TopoDS_Face, plane: Plane, holes: Sequence[TopoDS_Face]) -> Iterator[TopoDS_Face]:
    """Faces that remain of an open face: the rim of the skin, and the lattice's sections inside the holes."""
    wires = [*_wires(face), *(convert.as_wire(wire.Reversed()) for hole in holes for wire in _wires(hole))]
    polygons = []
    for wire in wires:
        walk, points = BRepTools_WireExplorer(wire), []
        while walk.More():
            points.append(sample_edge(walk.Current(), CHORDS_PER_EDGE)[:-1])
            walk.Next()
        polygons.append(plane.parameters(np.concatenate(points)))
    try:
        nested = nest_loops(polygons)
    except LoopError as error:
        raise KernelError(OPERATION, str(error), face) from error
    builder, surface = BRep_Builder(), convert.plane(plane.origin, plane.x_axis, plane.y_axis)
    for loops in nested:
        part = TopoDS_Face()
        builder.MakeFace(part, surface, CONFUSION_TOLERANCE)
        for loop in loops:
            builder.Add(part, wires[loop])
        yield part


def _wires(face: TopoDS_Face) -> list[TopoDS_Wire]:
    """The face's loops, counter-clockwise around it seen from outside."""
    return [convert.as_wire(wire) for wire in list_subshapes(face, TopAbs_WIRE)]

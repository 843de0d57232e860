"""Open faces of a body, the faces of what is deeper than its skin, and the subtraction of voids that only the kernel knows."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import Any

import numpy as np
from OCP.BRep import BRep_Tool
from OCP.BRepClass import BRepClass_FaceClassifier
from OCP.BRepClass3d import BRepClass3d
from OCP.Geom import Geom_Plane
from OCP.TopAbs import TopAbs_OUT, TopAbs_SHELL
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad.brep.carriers import Plane
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import sort_by_volume, subtract_solid
from tpmscad.kernel.measure.shape_sampling import sample_edge
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_solid
from tpmscad.kernel.occt.exploration import ShapeKey, edges_of, faces_of, list_subshapes, orientation_sign, unwrap
from tpmscad.kernel.recognise.face_carriers import evaluate_mid_face

OPENING_TOL = 1e-6
"""Model units: largest distance of a void from the open face through which it opens."""

PARALLEL_REL_TOL = 1e-12
"""1 - cosine of the angle between the normals of open faces in one plane."""


def subtract_voids(
    body: CadBody, voids: Sequence[TopoDS_Solid], open_faces: Sequence[TopoDS_Face]
) -> tuple[TopoDS_Solid, ...]:
    """The body without the voids, largest first.

    The voids are disjoint solids inside the body that touch its boundary in open faces only. Without open faces, and if no void
    holds a piece of its own, their shells are reversed; else the kernel's boolean subtracts them.
    """
    shells = [convert.as_shell(shell.Reversed()) for void in voids for shell in _shells(void)]
    if not open_faces and len(shells) == len(voids):
        return (make_solid([*_shells(body.shape), *shells]),)
    solids: tuple[TopoDS_Solid, ...] = (body.shape,)
    for void in voids:
        solids = sort_by_volume(part for solid in solids for part in subtract_solid(solid, void))
    return solids


def resolve_open_faces(body: CadBody, faces: Iterable[Any], name: str = "open_faces") -> tuple[TopoDS_Face, ...]:
    """Faces of the body for faces (build123d, CadQuery, TopoDS) or indices in the body's order, each once.

    name: of the argument, in messages. Raises InvalidRequest if a face does not belong to the body or is not planar, or if all
    are open.
    """
    own = faces_of(body.shape)
    found: list[TopoDS_Face] = []
    for requested in faces:
        shape = unwrap(requested)
        if isinstance(shape, int | np.integer):
            face = own[shape] if 0 <= shape < len(own) else None
        else:
            face = next((f for f in own if isinstance(shape, TopoDS_Face) and f.IsSame(shape)), None)
        if face is None:
            raise InvalidRequest(
                f"{name}: {requested!r} is no face of {body.name}: pass faces of the same shape object, or indices "
                f"from 0 to {len(own) - 1} in its order"
            )
        if not is_plane(face):
            raise InvalidRequest(
                f"{name}: {requested!r} is not planar: keep the skin on it, and drill through it afterwards"
            )
        if not any(face.IsSame(f) for f in found):
            found.append(face)
    if len(found) == len(own):
        raise InvalidRequest(f"{name}: all {len(own)} faces of {body.name} are open: leave skin and {name} out")
    for one, other in combinations(found, 2):
        shared = {ShapeKey(edge) for edge in edges_of(one)} & {ShapeKey(edge) for edge in edges_of(other)}
        if shared and abs(outward_plane(one).normal @ outward_plane(other).normal) > 1 - PARALLEL_REL_TOL:
            where = format_point(sample_edge(next(iter(shared)).shape, 2)[1])
            raise InvalidRequest(
                f"{name}: two of the faces meet in one plane near {where}: unite them first, with clean() of the part"
            )
    return tuple(found)


def find_skin_faces(parts: Sequence[TopoDS_Solid], open_faces: Sequence[TopoDS_Face]) -> list[TopoDS_Face]:
    """The faces of the parts of a body deeper than its skin, without those in open faces."""
    planes = [outward_plane(face) for face in open_faces]
    return [
        face
        for part in parts
        for face in faces_of(part)
        if not any(_is_in_opening(face, plane, of) for plane, of in zip(planes, open_faces, strict=True))
    ]


def count_closed_cavities(body: CadBody, open_faces: Sequence[TopoDS_Face]) -> int:
    """Cavities that the body has of its own and that no open face bounds."""
    outer = BRepClass3d.OuterShell_s(body.shape)
    cavities = [shell for shell in _shells(body.shape) if not shell.IsSame(outer)]
    return sum(not any(f.IsSame(o) for f in faces_of(shell) for o in open_faces) for shell in cavities)


def is_plane(face: TopoDS_Face) -> bool:
    """Whether the kernel's surface of a face is a plane."""
    return isinstance(BRep_Tool.Surface_s(face), Geom_Plane)


def _shells(solid: TopoDS_Solid) -> list[Any]:
    """Shells of a solid."""
    return [convert.as_shell(shell) for shell in list_subshapes(solid, TopAbs_SHELL)]


def outward_plane(face: TopoDS_Face) -> Plane:
    """Plane of a planar face with the outward normal."""
    _, point, normal, beside = evaluate_mid_face(face)
    x, out = beside - point, orientation_sign(face) * normal
    return Plane(point, x / np.linalg.norm(x), out / np.linalg.norm(out))


def _is_in_opening(face: TopoDS_Face, plane: Plane, opening: TopoDS_Face) -> bool:
    """True if a void's face lies in the open face."""
    if not is_plane(face):
        return False
    points = np.concatenate([sample_edge(edge, 2) for edge in edges_of(face)])
    if np.abs(plane.distance(points)).max() > OPENING_TOL:
        return False
    return BRepClass_FaceClassifier(opening, convert.point(points[0]), OPENING_TOL).State() != TopAbs_OUT

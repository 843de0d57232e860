"""Intersection of a lattice with a CAD body in which OCCT intersects candidate patches only.

No closed block around the body is needed, and no solids are intersected. The general fuse imprints the candidate patches and the
body's faces on each other. A component of lattice faces lies inside or outside the body as a whole, which a few probe points
decide. Of the body's pieces those are retained that run opposite to the retained patches along their common edges. Other patches
keep their edges, so that all faces join by connectivity.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from OCP.BOPTools import BOPTools_AlgoTools3D
from OCP.BRepAlgoAPI import BRepAlgoAPI_BuilderAlgo
from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.gp import gp_Pnt, gp_Pnt2d
from OCP.IntTools import IntTools_Context
from OCP.ShapeFix import ShapeFix_ShapeTolerance
from OCP.TopAbs import TopAbs_IN, TopAbs_ON, TopAbs_VERTEX
from OCP.TopoDS import TopoDS_Face, TopoDS_Solid

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, select_faces
from tpmscad.errors import KernelError
from tpmscad.kernel.boolean.boolean_operations import modified_faces, translate_occt_errors
from tpmscad.kernel.boolean.candidate_patches import classify_patches
from tpmscad.kernel.boolean.shell_assembly import FaceEdgeUses, assemble_solids, edge_uses, face_components
from tpmscad.kernel.build.solids import build_faces
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.exploration import faces_of

OPERATION = "patches split by the body"

MAX_PROBES_PER_COMPONENT = 3
"""Faces per connected component that are classified."""

MAX_VERTEX_TOLERANCE = 1e-3
"""Model units: limit for vertex tolerances, which OCCT sets up to 0.1 where patch edges lie in body faces; a result
that needs more fails the validity check."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalIntersection:
    """Solids, largest first, their total volume, and the number of candidate patches."""

    solids: tuple[TopoDS_Solid, ...]
    volume: float
    candidate_count: int


def intersect_locally(patches: Brep, body: TopoDS_Solid, in_lattice: Callable[[Array], Array]) -> LocalIntersection:
    """Intersection of the lattice's solid with the body.

    in_lattice: signed function of points (n, 3), negative inside the lattice; a larger magnitude is more reliable. It is
    evaluated only on body faces without intersection curves. Raises KernelError if the retained faces are not closed.
    """
    near, inside = classify_patches(patches, body)
    selected = np.flatnonzero(near | inside)
    faces = build_faces(select_faces(patches, selected))
    candidates = [face for face, n in zip(faces, near[selected], strict=True) if n]
    whole = [face for face, n in zip(faces, near[selected], strict=True) if not n]
    with translate_occt_errors(OPERATION, body):
        of_lattice, of_body = _fuse_candidates(candidates, faces_of(BRepBuilderAPI_Copy(body).Shape()))
        lattice = [*whole, *of_lattice]
        uses = edge_uses([*lattice, *of_body])
        imprinted = {e for use in uses[: len(lattice)] for e, _ in use} & {
            e for use in uses[len(lattice) :] for e, _ in use
        }
        inner = _classify_lattice_faces(lattice, len(whole), face_components(uses[: len(lattice)], imprinted), body)
        retained_body = _classify_body_faces(of_body, uses, inner, len(lattice), imprinted, in_lattice)
        retained = [lattice[f] for f in np.flatnonzero(inner).tolist()] + [
            of_body[f] for f in np.flatnonzero(retained_body).tolist()
        ]
        if not retained:
            return LocalIntersection((), 0.0, len(candidates))
        solids, volume = assemble_solids(retained)
        for solid in solids:
            ShapeFix_ShapeTolerance().LimitTolerance(solid, 0.0, MAX_VERTEX_TOLERANCE, TopAbs_VERTEX)
        return LocalIntersection(solids, volume, len(candidates))


def _fuse_candidates(
    patches: Sequence[TopoDS_Face], body: Sequence[TopoDS_Face]
) -> tuple[list[TopoDS_Face], list[TopoDS_Face]]:
    """Pieces of the candidate patches and of the body's faces on common edges, oriented like their originals."""
    fuse = BRepAlgoAPI_BuilderAlgo()
    # OCCT does not intersect the faces of one argument with each other.
    fuse.SetArguments(convert.shape_list([make_compound(patches), make_compound(body)]))
    fuse.SetToFillHistory(True)
    fuse.SetUseOBB(True)
    fuse.Build()
    if not fuse.IsDone() or fuse.Shape().IsNull():
        raise KernelError(OPERATION, "the kernel's general fuse failed")

    def images(faces: Sequence[TopoDS_Face]) -> list[TopoDS_Face]:
        return [
            convert.as_face(image.Oriented(face.Orientation()))
            for face in faces
            for image in modified_faces(fuse, face)
        ]

    return images(patches), images(body)


def _classify_lattice_faces(faces: Sequence[TopoDS_Face], known: int, label: IntArray, body: TopoDS_Solid) -> Array:
    """Mask of the lattice faces inside the body; the first `known` faces are known to be."""
    classifier, context = BRepClass3d_SolidClassifier(body), IntTools_Context()
    inner = np.zeros(len(faces), bool)
    for component in np.unique(label).tolist():
        members = np.flatnonzero(label == component)
        if members[0] < known:
            inner[members] = True
            continue
        states = set()
        for f in members[
            np.linspace(0, len(members) - 1, min(len(members), MAX_PROBES_PER_COMPONENT)).astype(int)
        ].tolist():
            classifier.Perform(_interior_point(faces[f], context), CONFUSION_TOLERANCE)
            if classifier.State() != TopAbs_ON:
                states.add(classifier.State() == TopAbs_IN)
        if len(states) != 1:
            raise KernelError(OPERATION, "a component of the lattice has points inside and outside the body")
        inner[members] = states.pop()
    return inner


def _classify_body_faces(
    faces: Sequence[TopoDS_Face],
    uses: FaceEdgeUses,
    inner: Array,
    first: int,
    imprinted: set[int],
    in_lattice: Callable[[Array], Array],
) -> Array:
    """Mask of the body's pieces inside the lattice: they run opposite to retained patches along common edges."""
    lattice_sense = {e: s for f in np.flatnonzero(inner) for e, s in uses[f] if e in imprinted}
    label = face_components(uses[first:], imprinted)
    context = IntTools_Context()
    inside = np.zeros(len(faces), bool)
    for component in np.unique(label).tolist():
        members = np.flatnonzero(label == component)
        votes = {lattice_sense[e] != s for f in members for e, s in uses[first + f] if e in lattice_sense}
        if len(votes) > 1:
            raise KernelError(
                OPERATION,
                "a face of the body has contradictory orientations along its edges with the lattice",
            )
        if votes:
            inside[members] = votes.pop()
        else:
            values = in_lattice(np.array([_interior_point(faces[f], context).Coord() for f in members.tolist()]))
            inside[members] = values[np.abs(values).argmax()] < 0
    return inside


def _interior_point(face: TopoDS_Face, context: IntTools_Context) -> gp_Pnt:
    """A point inside a trimmed face."""
    point, uv = gp_Pnt(), gp_Pnt2d()
    if BOPTools_AlgoTools3D.PointInFace_s(face, point, uv, context):
        raise KernelError(OPERATION, "the kernel found no interior point of a face", face)
    return point

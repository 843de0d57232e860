"""A lattice trimmed by any body: the kernel intersects the patches that the body's faces may cross, and nothing else.

No closed block around the body is needed, and no solid is classified. The patches' pieces are in or out by one point for all
that hang together; of the body's pieces those are taken that run against the patches along their common edges. Whole patches
keep their edges, so that what the kernel split and what it never saw join by connectivity.
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
"""Pieces asked whether what hangs together with them is in or out."""


MAX_VERTEX_TOLERANCE = 1e-3
"""Model units: where edges of patches lie in faces of the body the kernel gives vertices up to 0.1, and needs far less; whoever
checks the result sees if it needed more."""


@dataclass(frozen=True, slots=True, eq=False)
class LocalIntersection:
    """Solids, largest first, their volume, and how many patches went to the kernel."""

    solids: tuple[TopoDS_Solid, ...]
    volume: float
    candidate_count: int


def intersect_locally(patches: Brep, body: TopoDS_Solid, in_lattice: Callable[[Array], Array]) -> LocalIntersection:
    """The common part of the lattice's solid and the body.

    in_lattice: below 0 at points (n, 3) in the lattice, the farther the surer; asked for faces of the body that it does not
    cross. KernelError where the pieces do not close.
    """
    near, inside = classify_patches(patches, body)
    kept = np.flatnonzero(near | inside)
    own = select_faces(patches, kept)
    faces = build_faces(own)
    first = [face for face, n in zip(faces, near[kept], strict=True) if n]
    whole = [face for face, n in zip(faces, near[kept], strict=True) if not n]
    with translate_occt_errors(OPERATION, body):
        of_lattice, of_body = _fuse_candidates(first, faces_of(BRepBuilderAPI_Copy(body).Shape()))
        lattice = [*whole, *of_lattice]
        uses = edge_uses([*lattice, *of_body])
        seams = {e for use in uses[: len(lattice)] for e, _ in use} & {
            e for use in uses[len(lattice) :] for e, _ in use
        }
        inner = _classify_lattice_faces(lattice, len(whole), face_components(uses[: len(lattice)], seams), body)
        walls = _classify_body_faces(of_body, uses, inner, len(lattice), seams, in_lattice)
        taken = [lattice[f] for f in np.flatnonzero(inner).tolist()] + [
            of_body[f] for f in np.flatnonzero(walls).tolist()
        ]
        if not taken:
            return LocalIntersection((), 0.0, len(first))
        solids, volume = assemble_solids(taken)
        for solid in solids:
            ShapeFix_ShapeTolerance().LimitTolerance(solid, 0.0, MAX_VERTEX_TOLERANCE, TopAbs_VERTEX)
        return LocalIntersection(solids, volume, len(first))


def _fuse_candidates(
    patches: Sequence[TopoDS_Face], body: Sequence[TopoDS_Face]
) -> tuple[list[TopoDS_Face], list[TopoDS_Face]]:
    """The pieces of the patches, and of the body's faces, on common edges, with the sides that these have."""
    fuse = BRepAlgoAPI_BuilderAlgo()
    fuse.SetArguments(
        convert.shape_list([make_compound(patches), make_compound(body)])
    )  # the kernel looks for no crossings within
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
    """Which pieces of the lattice are in the body; the first `known` are."""
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
            raise KernelError(OPERATION, "a piece of the lattice is neither in the body nor out of it")
        inner[members] = states.pop()
    return inner


def _classify_body_faces(
    faces: Sequence[TopoDS_Face],
    uses: FaceEdgeUses,
    inner: Array,
    first: int,
    seams: set[int],
    in_lattice: Callable[[Array], Array],
) -> Array:
    """Which pieces of the body's faces are in the lattice: they run against its pieces in the body."""
    way = {e: s for f in np.flatnonzero(inner) for e, s in uses[f] if e in seams}
    label = face_components(uses[first:], seams)
    context = IntTools_Context()
    taken = np.zeros(len(faces), bool)
    for component in np.unique(label).tolist():
        members = np.flatnonzero(label == component)
        votes = {way[e] != s for f in members for e, s in uses[first + f] if e in way}
        if len(votes) > 1:
            raise KernelError(OPERATION, "a face of the body runs along the lattice both ways")
        if votes:
            taken[members] = votes.pop()
        else:
            values = in_lattice(np.array([_interior_point(faces[f], context).Coord() for f in members.tolist()]))
            taken[members] = values[np.abs(values).argmax()] < 0
    return taken


def _interior_point(face: TopoDS_Face, context: IntTools_Context) -> gp_Pnt:
    point, uv = gp_Pnt(), gp_Pnt2d()
    if BOPTools_AlgoTools3D.PointInFace_s(face, point, uv, context):
        raise KernelError(OPERATION, "the kernel finds no point in a piece of a face", face)
    return point

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

from tpmscad.errors import KernelError
from tpmscad.kernel import convert
from tpmscad.kernel.boolean import guarded
from tpmscad.kernel.build import TOLERANCE, compound, topods_faces
from tpmscad.kernel.nearby import near_and_inside
from tpmscad.kernel.sampling import faces_of
from tpmscad.kernel.shells import Uses, components, edge_uses, solids_from
from tpmscad.patches.complex import Array, Ints, PatchComplex
from tpmscad.patches.selection import selected

CROSSING = "patches split by the body"

WITNESSES = 3
"""Pieces asked whether what hangs together with them is in or out."""


SLACK = 1e-3
"""Model units: where edges of patches lie in faces of the body the kernel gives vertices up to 0.1, and needs far less; whoever
checks the result sees if it needed more."""


@dataclass(frozen=True, slots=True, eq=False)
class Crossed:
    """Solids, largest first, their volume, and how many patches went to the kernel."""

    solids: tuple[TopoDS_Solid, ...]
    volume: float
    patches: int


def crossed(patches: PatchComplex, body: TopoDS_Solid, in_lattice: Callable[[Array], Array]) -> Crossed:
    """The common part of the lattice's solid and the body.

    in_lattice: below 0 at points (n, 3) in the lattice, the farther the surer; asked for faces of the body that it does not
    cross. KernelError where the pieces do not close.
    """
    near, inside = near_and_inside(patches, body)
    kept = np.flatnonzero(near | inside)
    own = selected(patches, kept)
    faces = topods_faces(own)
    first = [face for face, n in zip(faces, near[kept], strict=True) if n]
    whole = [face for face, n in zip(faces, near[kept], strict=True) if not n]
    with guarded(CROSSING, body):
        of_lattice, of_body = _split(first, faces_of(BRepBuilderAPI_Copy(body).Shape()))
        lattice = [*whole, *of_lattice]
        uses = edge_uses([*lattice, *of_body])
        seams = {e for use in uses[: len(lattice)] for e, _ in use} & {
            e for use in uses[len(lattice) :] for e, _ in use
        }
        inner = _inner(lattice, len(whole), components(uses[: len(lattice)], seams), body)
        walls = _walls(of_body, uses, inner, len(lattice), seams, in_lattice)
        taken = [lattice[f] for f in np.flatnonzero(inner).tolist()] + [
            of_body[f] for f in np.flatnonzero(walls).tolist()
        ]
        if not taken:
            return Crossed((), 0.0, len(first))
        solids, volume = solids_from(taken)
        for solid in solids:
            ShapeFix_ShapeTolerance().LimitTolerance(solid, 0.0, SLACK, TopAbs_VERTEX)
        return Crossed(solids, volume, len(first))


def _split(patches: Sequence[TopoDS_Face], body: Sequence[TopoDS_Face]) -> tuple[list[TopoDS_Face], list[TopoDS_Face]]:
    """The pieces of the patches, and of the body's faces, on common edges, with the sides that these have."""
    fuse = BRepAlgoAPI_BuilderAlgo()
    fuse.SetArguments(
        convert.shape_list([compound(patches), compound(body)])
    )  # the kernel looks for no crossings within
    fuse.SetToFillHistory(True)
    fuse.SetUseOBB(True)
    fuse.Build()
    if not fuse.IsDone() or fuse.Shape().IsNull():
        raise KernelError(CROSSING, "the kernel's general fuse failed")

    def pieces(faces: Sequence[TopoDS_Face]) -> list[TopoDS_Face]:
        found = []
        for face in faces:
            images = list(fuse.Modified(face)) or ([] if fuse.IsDeleted(face) else [face])
            found += [convert.as_face(image.Oriented(face.Orientation())) for image in images]
        return found

    return pieces(patches), pieces(body)


def _inner(faces: Sequence[TopoDS_Face], known: int, label: Ints, body: TopoDS_Solid) -> Array:
    """Which pieces of the lattice are in the body; the first `known` are."""
    classifier, context = BRepClass3d_SolidClassifier(body), IntTools_Context()
    inner = np.zeros(len(faces), bool)
    for component in np.unique(label).tolist():
        members = np.flatnonzero(label == component)
        if members[0] < known:
            inner[members] = True
            continue
        states = set()
        for f in members[np.linspace(0, len(members) - 1, min(len(members), WITNESSES)).astype(int)].tolist():
            classifier.Perform(_point_in(faces[f], context), TOLERANCE)
            if classifier.State() != TopAbs_ON:
                states.add(classifier.State() == TopAbs_IN)
        if len(states) != 1:
            raise KernelError(CROSSING, "a piece of the lattice is neither in the body nor out of it")
        inner[members] = states.pop()
    return inner


def _walls(
    faces: Sequence[TopoDS_Face],
    uses: Uses,
    inner: Array,
    first: int,
    seams: set[int],
    in_lattice: Callable[[Array], Array],
) -> Array:
    """Which pieces of the body's faces are in the lattice: they run against its pieces in the body."""
    way = {e: s for f in np.flatnonzero(inner) for e, s in uses[f] if e in seams}
    label = components(uses[first:], seams)
    context = IntTools_Context()
    taken = np.zeros(len(faces), bool)
    for component in np.unique(label).tolist():
        members = np.flatnonzero(label == component)
        votes = {way[e] != s for f in members for e, s in uses[first + f] if e in way}
        if len(votes) > 1:
            raise KernelError(CROSSING, "a face of the body runs along the lattice both ways")
        if votes:
            taken[members] = votes.pop()
        else:
            values = in_lattice(np.array([_point_in(faces[f], context).Coord() for f in members.tolist()]))
            taken[members] = values[np.abs(values).argmax()] < 0
    return taken


def _point_in(face: TopoDS_Face, context: IntTools_Context) -> gp_Pnt:
    point, uv = gp_Pnt(), gp_Pnt2d()
    if BOPTools_AlgoTools3D.PointInFace_s(face, point, uv, context):
        raise KernelError(CROSSING, "the kernel finds no point in a piece of a face", face)
    return point

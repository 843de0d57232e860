"""The body without the voids that a lattice leaves within its skin, in the arrays where all of them are known there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np

from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.erosion.hollowed_body import hollow_body
from tpmscad.errors import KernelError, TrimmingError
from tpmscad.fallbacks import Fallback, Fallbacks
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.boolean.cut_faces import SKIN
from tpmscad.kernel.boolean.hollow_body import find_skin_faces, subtract_voids
from tpmscad.kernel.build.solids import BrepSolids, build_faces, build_solids
from tpmscad.kernel.measure.solid_topology import measure_topology
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.solids.boolean_strategies import BooleanResult, numerical_failures, read_trimming_body


@dataclass(frozen=True, slots=True, eq=False)
class VoidsInBody:
    """A body, the parts of it deeper than the skin, what is left of each part without the lattice, and the open faces.

    parts: none where the voids' faces are tagged already.
    """

    body: CadBody
    parts: Sequence[CadBody]
    voids: Sequence[BooleanResult]
    open_faces: Sequence[Any]


@dataclass(frozen=True, slots=True, eq=False)
class HollowedBody:
    """The solids that are left, their boundary representation if there is one, and their number of closed cavities.

    skin_faces: the kernel's faces on the inner side of the skin.
    """

    built: BrepSolids | OcctSolids
    brep: Brep | None
    closed_cavities: int
    skin_faces: Sequence[Any]


def hollow_in_arrays(request: VoidsInBody) -> HollowedBody:
    """The body's faces and the reversed voids in one boundary representation.

    TrimmingError if the kernel's check rejects it, KernelError if a void is known to the kernel only, NotQuadric if the body is.
    """
    voids = []
    for part, result in zip_longest(request.parts, request.voids):
        if result.brep is None and result.solids:
            raise KernelError("hollowing", "a void was cut by the kernel")
        if result.brep is not None:
            names = set(part.face_labels) if part else ()
            tags = tuple(SKIN if tag in names else tag for tag in result.brep.tags)
            voids.append(replace(result.brep, tags=tags))
    read = read_trimming_body(request.body)
    is_open = np.array([any(f.IsSame(o) for o in request.open_faces) for f in faces_of(request.body.shape)])
    with numerical_failures():
        brep = hollow_body(read.brep, voids, is_open[read.brep.faces.tag])
        built = build_solids(brep)
        if not is_brep_valid(brep, built.known_faces):
            raise TrimmingError("the kernel's check rejects the body within its skin")
    cavities = len(built.nesting.volume) - built.n_solids
    skin = drop_unused_geometry(select_faces(brep, brep.faces_with_tag(SKIN)))
    return HollowedBody(built, brep, cavities, build_faces(skin))


def hollow_in_kernel(request: VoidsInBody) -> HollowedBody:
    """The body's shells and the reversed shells of the voids, or the faces of both where there are openings."""
    voids = [void for result in request.voids for void in result.solids]
    solids = subtract_voids(request.body, voids, request.open_faces)
    skin_faces = find_skin_faces(voids, request.parts, request.open_faces)
    return HollowedBody(OcctSolids(solids), None, measure_topology(solids).betti[2], skin_faces)


HOLLOWING_METHODS = Fallbacks(
    (
        Fallback("in the arrays", hollow_in_arrays, "half a second for a thousand faces"),
        Fallback("in the kernel", hollow_in_kernel, "five times as long"),
    )
)
"""How the voids are taken from the body."""

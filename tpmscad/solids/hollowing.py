"""The body without the voids that a lattice leaves within its skin, in arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import zip_longest
from typing import Any

import numpy as np

from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.erosion.hollowed_body import hollow_body
from tpmscad.errors import TrimmingError
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.boolean.cut_faces import SKIN
from tpmscad.kernel.build.solids import BrepSolids, build_faces, build_solids
from tpmscad.kernel.measure.validity import is_brep_valid
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.solids.boolean_strategies import BooleanResult, numerical_failures, read_trimming_body


@dataclass(frozen=True, slots=True, eq=False)
class HollowedBody:
    """The solids that are left, their boundary representation, and their number of closed cavities.

    skin_faces: the kernel's faces on the inner side of the skin.
    """

    built: BrepSolids
    brep: Brep
    closed_cavities: int
    skin_faces: Sequence[Any]


def subtract_trimmed_voids(
    body: CadBody, parts: Sequence[CadBody], trimmed: Sequence[BooleanResult], open_faces: Sequence[Any]
) -> HollowedBody:
    """The body's faces and the reversed voids in one boundary representation; TrimmingError if the kernel's check rejects it.

    trimmed: what is left without the lattice of each of the `parts` deeper than the skin. parts: none where the faces of the
    voids on the skin are tagged already.
    """
    voids = []
    for part, result in zip_longest(parts, trimmed):
        if result.brep is not None:
            names = set(part.face_labels) if part else ()
            tags = tuple(SKIN if tag in names else tag for tag in result.brep.tags)
            voids.append(replace(result.brep, tags=tags))
    read = read_trimming_body(body)
    is_open = np.array([any(f.IsSame(o) for o in open_faces) for f in faces_of(body.shape)])
    with numerical_failures():
        brep = hollow_body(read.brep, voids, is_open[read.brep.faces.tag])
        built = build_solids(brep)
        if not is_brep_valid(brep, built.known_faces):
            raise TrimmingError("the kernel's check rejects the body within its skin")
    cavities = len(built.nesting.volume) - built.n_solids
    skin = drop_unused_geometry(select_faces(brep, brep.faces_with_tag(SKIN)))
    return HollowedBody(built, brep, cavities, build_faces(skin))

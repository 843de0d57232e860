"""Neighbouring regions of one complex as kernel solids: where two touch they share faces, edges and vertices."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from OCP.TopoDS import TopoDS_Shell, TopoDS_Solid

from tpmscad.kernel import convert
from tpmscad.kernel.build import holds, shell_of, solid_of, topods_faces
from tpmscad.kernel.nesting import nesting
from tpmscad.patches import connectivity
from tpmscad.patches.complex import Ints, PatchComplex


def build_regions(
    complex: PatchComplex, regions: Sequence[PatchComplex], members: Sequence[Ints]
) -> tuple[tuple[TopoDS_Solid, ...], ...]:
    """The solids of each region, largest first. `members[r]` are the faces of `complex` that region r's faces are."""
    faces = topods_faces(complex)
    result = []
    for region, member in zip(regions, members, strict=True):
        own = [
            faces[m] if complex.faces.sense[m] == sense else convert.as_face(faces[m].Reversed())
            for m, sense in zip(member.tolist(), region.faces.sense.tolist(), strict=True)
        ]
        result.append(_solids(region, own))
    return tuple(result)


def _solids(region: PatchComplex, faces: list[Any]) -> tuple[TopoDS_Solid, ...]:
    made: dict[int, TopoDS_Shell] = {}

    def shell(number: int) -> TopoDS_Shell:
        if number not in made:
            made[number] = shell_of(faces[i] for i in shells[number])
        return made[number]

    count, label = connectivity.shells(region)
    shells: list[list[int]] = [[] for _ in range(count)]
    for face, number in enumerate(label.tolist()):
        shells[number].append(face)
    return tuple(
        solid_of([shell(s) for s in piece]) for piece in nesting(region, lambda s, point: holds(shell(s), point)).pieces
    )

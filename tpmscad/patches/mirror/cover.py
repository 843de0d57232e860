"""Lattices of a mirror surface: the piece and its reflections, as many as reach into a box."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.complex import Array, PatchComplex
from tpmscad.patches.sheet import TAGS, TOUCH, Sheet
from tpmscad.patches.weld import weld
from tpmscad.surfaces import MirrorSymmetry

REACH = 1
"""Cells around the box whose tetrahedra are looked at: motions' translations lie in the cell, the tetrahedra near its origin."""


def mirror_covering(
    symmetry: MirrorSymmetry, sheet: Sheet, cells: tuple[int, int, int], phase: Array, *, natural: bool = False
) -> PatchComplex:
    """The offset surfaces' pieces in every tetrahedron with a part inside the box from the origin to `cells`.

    Open; ragged outside unless the box's planes are mirrors: then the pieces end in them. `natural` moves the box as well by
    `phase`, so that they do.
    """
    moved, phase = (phase, 0 * phase) if natural else (0 * phase, phase)
    corners = symmetry.edges.reshape(4, 3)
    origins = np.stack(np.meshgrid(*[np.arange(-REACH - 1, n + REACH + 1) for n in cells], indexing="ij"), axis=-1)
    shifts = origins.reshape(-1, 1, 3) + (phase - np.floor(phase)) + symmetry.translations
    rotation = np.tile(symmetry.rotations, (len(shifts), 1, 1))
    translation = shifts.reshape(-1, 3)
    placed = np.einsum("fij,pj->fpi", rotation, corners) + translation[:, None]
    inside = ((placed.max(axis=1) > TOUCH) & (placed.min(axis=1) < np.array(cells) - TOUCH)).all(axis=1)
    rotation, translation = rotation[inside], translation[inside] + moved
    parts = []
    for layer, outward, tag in ((sheet.lower, -1, "offset-"), (sheet.upper, 1, "offset+")):
        if layer is not None:
            index, _ = layer
            # A reflection turns S_u x S_v against the gradient's image, which it keeps.
            sense = outward * facing(symmetry, sheet, index) * np.rint(np.linalg.det(rotation)).astype(int)
            n = len(rotation)
            parts.append((np.full(n, index), rotation, translation, sense, np.full(n, TAGS.index(tag))))
    carrier, rotation, translation, sense, tags = (np.concatenate(p) for p in zip(*parts, strict=True))
    return weld(sheet.primitives, carrier, rotation, translation, sense, tags, TAGS)


def facing(symmetry: MirrorSymmetry, sheet: Sheet, index: int) -> int:
    """+1 where the primitive's S_u x S_v is along the gradient, else -1."""
    primitive = sheet.primitives[index]
    (u0, u1), (v0, v1) = primitive.domain
    u, v = np.array([(u0 + u1) / 2]), np.array([(v0 + v1) / 2])
    return int(np.sign(primitive.normal(u, v)[0] @ symmetry.waves.gradient(primitive(u, v))[0]))

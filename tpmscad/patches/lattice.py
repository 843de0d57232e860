"""Lattices of a minimal surface as complexes of whole patches, all copies of one or two primitives.

Lengths are in cells (cubic cell edge 1). An offset surface of the other side is the same primitive turned over by the patch's
rotoinversion, so offsets of +d and -d share one primitive. Which patches there are is known from the symmetry group; nothing is
searched for. Two selections: whole cells (`natural`, closed by ruled gap faces along the border), or everything that reaches
into a box (`covering`, open, to be trimmed).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad import surfaces
from tpmscad.patches.border import incidence, unpinched
from tpmscad.patches.complex import Array, Ints, PatchComplex
from tpmscad.patches.mirror.cover import mirror_covering
from tpmscad.patches.sheet import TAGS, TOUCH, Sheet
from tpmscad.patches.weld import WELD, cluster, weld
from tpmscad.splines.bspline import Curve, Surface
from tpmscad.splines.knots import split
from tpmscad.surfaces import MirrorSymmetry, PatchSymmetry

REACH = 2
"""Cells around the box whose patches are looked at: patches of the cell's translation class lie within 1.5 cells of it."""

CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


@dataclass(frozen=True, slots=True, eq=False)
class Placements:
    """Motions of the mid patch, one for each patch of a lattice: rotation (F, 3, 3), translation (F, 3)."""

    rotation: Array
    translation: Array

    def __len__(self) -> int:
        return len(self.rotation)


def whole_cells(name: str, cells: tuple[int, int, int], phase: Array) -> Placements:
    """One patch per class of the block of cells, moved by `phase`; edge-connected, the border touching itself nowhere."""
    motions = surfaces.symmetry(name)
    rotation, translation = motions.cell_rotations, motions.cell_translations
    corners = surfaces.patch(name).jet(*CORNERS.T).position
    middles, corners = (
        np.einsum("fij,sj->fsi", rotation, points) + translation[:, None] for points in (motions.side_middles, corners)
    )
    chosen = np.array(unpinched(incidence(middles, corners), cells))
    return Placements(rotation[chosen[:, 0]], translation[chosen[:, 0]] + chosen[:, 1:] + phase)


def covering(
    symmetry: PatchSymmetry | MirrorSymmetry, sheet: Sheet, cells: tuple[int, int, int], phase: Array
) -> PatchComplex:
    """The offset surfaces, every patch with a part inside the box from the origin to `cells`; open, ragged outside.

    Where a patch's midline lies in a plane of the box (a mirror plane), patches are quartered along their midlines: then
    whole quarters end in the plane and nothing is cut there.
    """
    if isinstance(symmetry, MirrorSymmetry):
        return mirror_covering(symmetry, sheet, cells, phase)
    origin = np.stack(np.meshgrid(*[np.arange(-REACH, n + REACH) for n in cells], indexing="ij"), axis=-1).reshape(
        -1, 3
    )
    placements = translates(symmetry, origin + (phase - np.floor(phase)))
    carrier, rotation, translation, sense, tag = _layer_faces(symmetry, sheet, placements)
    primitives = sheet.primitives
    if _midlines_in_planes(primitives, carrier, rotation, translation, cells):
        primitives = tuple(quarter for primitive in primitives for quarter in quarters(primitive))
        carrier = (4 * carrier[:, None] + np.arange(4)).ravel()
        rotation, translation = np.repeat(rotation, 4, axis=0), np.repeat(translation, 4, axis=0)
        sense, tag = np.repeat(sense, 4), np.repeat(tag, 4)
    inside = np.zeros(len(carrier), bool)
    for index, primitive in enumerate(primitives):
        own = np.flatnonzero(carrier == index)
        poles = primitive.poles.reshape(-1, 3)
        placed = np.einsum("fij,pj->fpi", rotation[own], poles) + translation[own, None]
        inside[own] = ((placed.max(axis=1) > TOUCH) & (placed.min(axis=1) < np.array(cells) - TOUCH)).all(axis=1)
    return weld(primitives, carrier[inside], rotation[inside], translation[inside], sense[inside], tag[inside], TAGS)


def quarters(surface: Surface) -> list[Surface]:
    """The patch cut along both midlines, each quarter on the unit square: sides that meet share their parameter's range."""
    (u0, u1), (v0, v1) = surface.domain
    pieces = [q for half in split(surface, 0, (u0 + u1) / 2) for q in split(half, 1, (v0 + v1) / 2)]
    return [replace(q, knots_u=_unit(q.knots_u), knots_v=_unit(q.knots_v)) for q in pieces]


def _unit(knots: Array) -> Array:
    return (knots - knots[0]) / (knots[-1] - knots[0])


def _midlines_in_planes(
    primitives: tuple[Surface, ...], carrier: Ints, rotation: Array, translation: Array, cells: tuple[int, int, int]
) -> bool:
    t = np.linspace(0.0, 1.0, 5)
    half = np.full(5, 0.5)
    lines = np.stack([[s(half, t), s(t, half)] for s in primitives])[carrier]  # (F, 2, 5, 3)
    placed = np.einsum("fij,flkj->flki", rotation, lines) + translation[:, None, None]
    planes = np.array([np.zeros(3), np.array(cells)])[:, None, None]  # (2, 1, 1, 3)
    return bool((np.abs(placed[None] - planes[:, None]).max(axis=3) < TOUCH).any())


def natural(symmetry: PatchSymmetry, sheet: Sheet, placements: Placements) -> PatchComplex:
    """A closed sheet: both offset surfaces, and a ruled gap face over every open side of the mid patches.

    TPMS2STEP, section 3.6: gaps are bridged after the copying, so that none lies inside the solid.
    """
    if sheet.lower is None or sheet.upper is None:
        raise ValueError("a natural boundary bridges two surfaces; a skeletal solid has one")
    gaps = [_gap(symmetry, sheet, side) for side in range(4)]
    patch, side = open_sides(symmetry, placements)
    carrier, rotation, translation, sense, tag = _layer_faces(symmetry, sheet, placements)
    return weld(
        (*sheet.primitives, *gaps),
        np.concatenate([carrier, len(sheet.primitives) + side]),
        np.concatenate([rotation, placements.rotation[patch]]),
        np.concatenate([translation, placements.translation[patch]]),
        np.concatenate([sense, np.full(len(side), symmetry.handedness)]),
        np.concatenate([tag, np.full(len(side), TAGS.index("gap"))]),
        TAGS,
    )


def ruled(below: Curve, above: Curve) -> Surface:
    """The ruled surface between two borders run the same way: u along them, v from `below` to `above`."""
    if below.degree != above.degree or not np.array_equal(below.knots, above.knots):
        raise ValueError("the two surfaces of a sheet need one spline space")
    poles = np.stack([below.poles, above.poles], axis=1)
    return Surface(poles, above.knots, np.repeat([0.0, 1.0], 2), above.degree, 1)


def open_sides(symmetry: PatchSymmetry, placements: Placements) -> tuple[Ints, Ints]:
    """(patch, side) of the mid patches' sides that no other placed patch shares."""
    middle = np.einsum("fij,sj->fsi", placements.rotation, symmetry.side_middles) + placements.translation[:, None]
    size = float(np.linalg.norm(symmetry.side_middles[0] - symmetry.side_middles[2]))
    label, _ = cluster(middle.reshape(-1, 3), WELD * size)
    alone = np.flatnonzero(np.bincount(label)[label] == 1)
    return alone // 4, alone % 4


def translates(symmetry: PatchSymmetry, by: Array) -> Placements:
    """The cell's patches at each of the translations (n, 3)."""
    n = len(symmetry.cell_rotations)
    return Placements(
        np.tile(symmetry.cell_rotations, (len(by), 1, 1)),
        (by[:, None, :] + symmetry.cell_translations).reshape(-1, 3) if n else np.zeros((0, 3)),
    )


def _layer_motion(symmetry: PatchSymmetry, placements: Placements, turned: bool) -> tuple[Array, Array]:
    if not turned:
        return placements.rotation, placements.translation
    return (
        placements.rotation @ symmetry.swap_rotation,
        placements.rotation @ symmetry.swap_translation + placements.translation,
    )


def _layer_faces(
    symmetry: PatchSymmetry, sheet: Sheet, placements: Placements
) -> tuple[Ints, Array, Array, Ints, Ints]:
    """Carrier, rotation, translation, sense and tag of every offset face.

    The primitive's S_u x S_v lies along +n times the patch's handedness; turning over swaps both n and the mirror's sign, so
    the placed one does too. Outward is +n on the upper surface, -n on the lower.
    """
    parts = []
    for layer, outward, tag in ((sheet.lower, -1, "offset-"), (sheet.upper, 1, "offset+")):
        if layer is not None:
            index, turned = layer
            n = len(placements)
            sense = np.full(n, outward * symmetry.handedness)
            motion = _layer_motion(symmetry, placements, turned)
            parts.append((np.full(n, index), *motion, sense, np.full(n, TAGS.index(tag))))
    carrier, rotation, translation, sense, tags = (np.concatenate(p) for p in zip(*parts, strict=True))
    return carrier, rotation, translation, sense, tags


def _gap(symmetry: PatchSymmetry, sheet: Sheet, side: int) -> Surface:
    """The ruled surface over one side of the mid patch, u along the side, v from the lower to the upper surface."""
    assert sheet.lower is not None
    assert sheet.upper is not None
    return ruled(*(_border(symmetry, sheet.primitives[i], turned, side) for i, turned in (sheet.lower, sheet.upper)))


def _border(symmetry: PatchSymmetry, primitive: Surface, turned: bool, side: int) -> Curve:
    """The placed primitive's border over that side of the mid patch, run counter-clockwise in the mid patch's (u, v)."""
    if not turned:
        return primitive.side(side)
    rotation, translation = symmetry.swap_rotation, symmetry.swap_translation
    moved = symmetry.side_middles @ rotation.T + translation
    own = int(np.argmin(np.linalg.norm(moved - symmetry.side_middles[side], axis=1)))
    # Turning over is a quarter-turn in (u, v), so sides keep running counter-clockwise.
    return primitive.side(own).moved(rotation, translation)

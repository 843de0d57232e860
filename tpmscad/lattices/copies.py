"""Lattices of a mirror surface: the piece and its reflections, as many as reach into a box.

Lattices of a minimal surface as complexes of whole patches, all copies of one or two primitives.

Lengths are in cells (cubic cell edge 1). An offset surface of the other side is the same primitive turned over by the patch's
rotoinversion, so offsets of +d and -d share one primitive. Which patches there are is known from the symmetry group; nothing is
searched for. Two selections: whole cells (`natural`, closed by ruled gap faces along the border), or everything that reaches
into a box (`covering`, open, to be trimmed).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tpmscad import surfaces
from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.welding import WELD_RADIUS_FRACTION, cluster_points, weld_patches
from tpmscad.lattices.cell_block import build_incidence, choose_unpinched_patches
from tpmscad.lattices.offset_surfaces import LATTICE_TAGS, TOUCH_TOL_CELLS, OffsetSurfaces
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.knots import split_surface
from tpmscad.surfaces import MirrorSymmetry, PatchSymmetry

MIRROR_SEARCH_MARGIN_CELLS = 1
"""Cells around the box whose tetrahedra are looked at: motions' translations lie in the cell, the tetrahedra near its origin."""


def cover_box_by_reflection(
    symmetry: MirrorSymmetry, sheet: OffsetSurfaces, cells: tuple[int, int, int], phase: Array, *, natural: bool = False
) -> Brep:
    """The offset surfaces' pieces in every tetrahedron with a part inside the box from the origin to `cells`.

    Open; ragged outside unless the box's planes are mirrors: then the pieces end in them. `natural` moves the box as well by
    `phase`, so that they do.
    """
    moved, phase = (phase, 0 * phase) if natural else (0 * phase, phase)
    corners = symmetry.edges.reshape(4, 3)
    origins = np.stack(
        np.meshgrid(
            *[np.arange(-MIRROR_SEARCH_MARGIN_CELLS - 1, n + MIRROR_SEARCH_MARGIN_CELLS + 1) for n in cells],
            indexing="ij",
        ),
        axis=-1,
    )
    shifts = origins.reshape(-1, 1, 3) + (phase - np.floor(phase)) + symmetry.motions.translation
    motion = Motion(np.tile(symmetry.motions.rotation, (len(shifts), 1, 1)), shifts.reshape(-1, 3))
    placed = motion[:, None].apply(corners)
    inside = ((placed.max(axis=1) > TOUCH_TOL_CELLS) & (placed.min(axis=1) < np.array(cells) - TOUCH_TOL_CELLS)).all(
        axis=1
    )
    motion = Motion(motion.rotation[inside], motion.translation[inside] + moved)
    parts = []
    for layer, outward, tag in ((sheet.lower, -1, "offset-"), (sheet.upper, 1, "offset+")):
        if layer is not None:
            index, _ = layer
            # A reflection turns S_u x S_v against the gradient's image, which it keeps.
            sense = outward * orientation_sign(symmetry, sheet, index) * motion.handedness
            n = len(motion)
            parts.append((np.full(n, index), motion, sense, np.full(n, LATTICE_TAGS.index(tag))))
    return weld_patches(sheet.primitives, *_concatenate_faces(parts), LATTICE_TAGS)


def orientation_sign(symmetry: MirrorSymmetry, sheet: OffsetSurfaces, index: int) -> int:
    """+1 where the primitive's S_u x S_v is along the gradient, else -1."""
    primitive = sheet.primitives[index]
    (u0, u1), (v0, v1) = primitive.domain
    u, v = np.array([(u0 + u1) / 2]), np.array([(v0 + v1) / 2])
    return int(np.sign(primitive.normal(u, v)[0] @ symmetry.waves.gradient(primitive(u, v))[0]))


SEARCH_MARGIN_CELLS = 2
"""Cells around the box whose patches are looked at: patches of the cell's translation class lie within 1.5 cells of it."""

UNIT_SQUARE_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def place_whole_cells(name: str, cells: tuple[int, int, int], phase: Array) -> Motion:
    """One patch per class of the block of cells, moved by `phase`; edge-connected, the border touching itself nowhere."""
    symmetry = surfaces.patch_symmetry(name)
    motion = symmetry.cell_motions
    corners = surfaces.primitive_patch(name).jet(*UNIT_SQUARE_CORNERS.T).position
    middles, corners = (motion[:, None].apply(points) for points in (symmetry.side_middles, corners))
    chosen = np.array(choose_unpinched_patches(build_incidence(middles, corners), cells))
    patch, cell = chosen[:, 0], chosen[:, 1:]
    return Motion(motion.rotation[patch], motion.translation[patch] + cell + phase)


def cover_box(
    symmetry: PatchSymmetry | MirrorSymmetry, sheet: OffsetSurfaces, cells: tuple[int, int, int], phase: Array
) -> Brep:
    """The offset surfaces, every patch with a part inside the box from the origin to `cells`; open, ragged outside.

    Where a patch's midline lies in a plane of the box (a mirror plane), patches are quartered along their midlines: then
    whole quarters end in the plane and nothing is cut there.
    """
    if isinstance(symmetry, MirrorSymmetry):
        return cover_box_by_reflection(symmetry, sheet, cells, phase)
    origin = np.stack(
        np.meshgrid(*[np.arange(-SEARCH_MARGIN_CELLS, n + SEARCH_MARGIN_CELLS) for n in cells], indexing="ij"), axis=-1
    ).reshape(-1, 3)
    placements = translate_cell_patches(symmetry, origin + (phase - np.floor(phase)))
    carrier, motion, sense, tag = _layer_faces(symmetry, sheet, placements)
    primitives = sheet.primitives
    if _midlines_in_planes(primitives, carrier, motion, cells):
        primitives = tuple(quarter for primitive in primitives for quarter in quarter_patch(primitive))
        carrier = (4 * carrier[:, None] + np.arange(4)).ravel()
        motion, sense, tag = motion[np.repeat(np.arange(len(motion)), 4)], np.repeat(sense, 4), np.repeat(tag, 4)
    inside = np.zeros(len(carrier), bool)
    for index, primitive in enumerate(primitives):
        own = np.flatnonzero(carrier == index)
        poles = primitive.poles.reshape(-1, 3)
        placed = motion[own, None].apply(poles)
        inside[own] = (
            (placed.max(axis=1) > TOUCH_TOL_CELLS) & (placed.min(axis=1) < np.array(cells) - TOUCH_TOL_CELLS)
        ).all(axis=1)
    return weld_patches(primitives, carrier[inside], motion[inside], sense[inside], tag[inside], LATTICE_TAGS)


def quarter_patch(surface: BSplineSurface) -> list[BSplineSurface]:
    """The patch cut along both midlines, each quarter on the unit square: sides that meet share their parameter's range."""
    (u0, u1), (v0, v1) = surface.domain
    pieces = [q for half in split_surface(surface, 0, (u0 + u1) / 2) for q in split_surface(half, 1, (v0 + v1) / 2)]
    return [replace(q, knots_u=_rescale_knots(q.knots_u), knots_v=_rescale_knots(q.knots_v)) for q in pieces]


def _rescale_knots(knots: Array) -> Array:
    return (knots - knots[0]) / (knots[-1] - knots[0])


def _midlines_in_planes(
    primitives: tuple[BSplineSurface, ...],
    carrier: IntArray,
    motion: Motion,
    cells: tuple[int, int, int],
) -> bool:
    t = np.linspace(0.0, 1.0, 5)
    half = np.full(5, 0.5)
    lines = np.stack([[s(half, t), s(t, half)] for s in primitives])[carrier]  # (F, 2, 5, 3)
    placed = motion[:, None, None].apply(lines)
    planes = np.array([np.zeros(3), np.array(cells)])[:, None, None]  # (2, 1, 1, 3)
    return bool((np.abs(placed[None] - planes[:, None]).max(axis=3) < TOUCH_TOL_CELLS).any())


def build_natural_lattice(symmetry: PatchSymmetry, sheet: OffsetSurfaces, placements: Motion) -> Brep:
    """A closed sheet: both offset surfaces, and a ruled gap face over every open side of the mid patches.

    TPMS2STEP, section 3.6: gaps are bridged after the copying, so that none lies inside the solid.
    """
    if sheet.lower is None or sheet.upper is None:
        raise ValueError("a natural boundary bridges two surfaces; a skeletal solid has one")
    gaps = [_gap_surface(symmetry, sheet, side) for side in range(4)]
    patch, side = find_open_sides(symmetry, placements)
    carrier, motion, sense, tag = _layer_faces(symmetry, sheet, placements)
    return weld_patches(
        (*sheet.primitives, *gaps),
        np.concatenate([carrier, len(sheet.primitives) + side]),
        Motion.concatenate([motion, placements[patch]]),
        np.concatenate([sense, np.full(len(side), symmetry.handedness)]),
        np.concatenate([tag, np.full(len(side), LATTICE_TAGS.index("gap"))]),
        LATTICE_TAGS,
    )


def ruled_surface(below: BSplineCurve, above: BSplineCurve) -> BSplineSurface:
    """The ruled surface between two borders run the same way: u along them, v from `below` to `above`."""
    if below.degree != above.degree or not np.array_equal(below.knots, above.knots):
        raise ValueError("the two surfaces of a sheet need one spline space")
    poles = np.stack([below.poles, above.poles], axis=1)
    return BSplineSurface(poles, above.knots, np.repeat([0.0, 1.0], 2), above.degree, 1)


def find_open_sides(symmetry: PatchSymmetry, placements: Motion) -> tuple[IntArray, IntArray]:
    """(patch, side) of the mid patches' sides that no other placed patch shares."""
    middle = placements[:, None].apply(symmetry.side_middles)
    size = float(np.linalg.norm(symmetry.side_middles[0] - symmetry.side_middles[2]))
    label, _ = cluster_points(middle.reshape(-1, 3), WELD_RADIUS_FRACTION * size)
    alone = np.flatnonzero(np.bincount(label)[label] == 1)
    return alone // 4, alone % 4


def translate_cell_patches(symmetry: PatchSymmetry, by: Array) -> Motion:
    """The cell's patches at each of the translations (n, 3)."""
    cell = symmetry.cell_motions
    return Motion(np.tile(cell.rotation, (len(by), 1, 1)), (by[:, None, :] + cell.translation).reshape(-1, 3))


def _layer_faces(
    symmetry: PatchSymmetry, sheet: OffsetSurfaces, placements: Motion
) -> tuple[IntArray, Motion, IntArray, IntArray]:
    """Carrier, motion, sense and tag of every offset face.

    The primitive's S_u x S_v lies along +n times the patch's handedness; turning over swaps both n and the mirror's sign, so
    the placed one does too. Outward is +n on the upper surface, -n on the lower.
    """
    parts = []
    for layer, outward, tag in ((sheet.lower, -1, "offset-"), (sheet.upper, 1, "offset+")):
        if layer is not None:
            index, turned = layer
            n = len(placements)
            sense = np.full(n, outward * symmetry.handedness)
            motion = placements @ symmetry.swap if turned else placements
            parts.append((np.full(n, index), motion, sense, np.full(n, LATTICE_TAGS.index(tag))))
    return _concatenate_faces(parts)


def _concatenate_faces(
    parts: Sequence[tuple[IntArray, Motion, IntArray, IntArray]],
) -> tuple[IntArray, Motion, IntArray, IntArray]:
    """Carrier, motion, sense and tag of the faces of several layers, one after another."""
    carrier, motion, sense, tag = zip(*parts, strict=True)
    return np.concatenate(carrier), Motion.concatenate(motion), np.concatenate(sense), np.concatenate(tag)


def _gap_surface(symmetry: PatchSymmetry, sheet: OffsetSurfaces, side: int) -> BSplineSurface:
    """The ruled surface over one side of the mid patch, u along the side, v from the lower to the upper surface."""
    assert sheet.lower is not None
    assert sheet.upper is not None
    return ruled_surface(
        *(_side_curve(symmetry, sheet.primitives[i], turned, side) for i, turned in (sheet.lower, sheet.upper))
    )


def _side_curve(symmetry: PatchSymmetry, primitive: BSplineSurface, turned: bool, side: int) -> BSplineCurve:
    """The placed primitive's border over that side of the mid patch, run counter-clockwise in the mid patch's (u, v)."""
    if not turned:
        return primitive.side(side)
    moved = symmetry.swap.apply(symmetry.side_middles)
    own = int(np.argmin(np.linalg.norm(moved - symmetry.side_middles[side], axis=1)))
    # Turning over is a quarter-turn in (u, v), so sides keep running counter-clockwise.
    return primitive.side(own).moved(symmetry.swap)

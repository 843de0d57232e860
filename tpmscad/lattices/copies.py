"""Whole patches of a lattice: copies of one or two primitives by the symmetry of the surface, proper motions or reflections.

Which patches there are is known from the symmetry group; nothing is searched for by distance. The offset surface at -d is the
one at +d moved by the rotoinversion of the patch, so both share a primitive. There are two selections of patches:

- all that reach into a box (`patches_over_box`, `reflected_pieces_over_box`): open and ragged outside, to be trimmed by it;
- whole cells (`build_natural_lattice`): closed by ruled gap faces along the boundary (TPMS2STEP, section 3.6).

Lengths are in cells (edge of the cubic cell = 1); the box has its lower corner in the origin and a whole number of cells along
each axis; a phase translates the lattice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from tpmscad import surfaces
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.welding import WELD_RADIUS_FRACTION, cluster_points, roll_up
from tpmscad.lattices.cell_block import build_incidence, choose_manifold_block
from tpmscad.lattices.offset_surfaces import TOUCH_TOL_CELLS, OffsetSurfaces, PlacedFaces, place_faces
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.knots import split_surface
from tpmscad.surfaces import MirrorSymmetry, PatchSymmetry

SEARCH_MARGIN_CELLS = 2
"""Cells around the box whose patches are considered: the patches and tetrahedra of a cell lie within 1.5 cells of it."""

COVER_MARGIN_CELLS = 1e-6
"""Distance beyond the box that patches cover: a cut may move them by less."""

UNIT_SQUARE_CORNERS = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]])


def patches_over_box(
    symmetry: PatchSymmetry, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array
) -> Brep:
    """Every copy of the offset surfaces with a part inside the box; open, ragged outside.

    Where the midline of a patch lies in a plane of the box (which is then a mirror plane), all patches are divided into quarters
    along their midlines: whole quarters end in the plane, and nothing needs to be cut there.
    """
    faces = _place_layers(symmetry, offsets, _copies_around_box(symmetry.cell_motions, cells, phase))
    return weld_in_box(offsets.primitives, faces, np.array(cells, float))


def weld_in_box(primitives: Sequence[BSplineSurface], faces: PlacedFaces, size: Array) -> Brep:
    """The faces with a part inside the box [0, size], in quarters if the midline of one lies in a plane of the box."""
    if _midlines_in_box_planes(primitives, faces, size):
        primitives = [quarter for primitive in primitives for quarter in quarter_patch(primitive)]
        faces = faces[np.repeat(np.arange(len(faces.carrier)), 4)]
        faces = replace(faces, carrier=4 * faces.carrier + np.tile(np.arange(4), len(faces.carrier) // 4))
    inside = np.zeros(len(faces.carrier), bool)
    for index, primitive in enumerate(primitives):
        at = np.flatnonzero(faces.carrier == index)
        poles = faces.motion[at, None].apply(primitive.poles.reshape(-1, 3))
        inside[at] = _reaches_into_box(poles + COVER_MARGIN_CELLS, size + 2 * COVER_MARGIN_CELLS)
    return faces[inside].weld(primitives)


def reflected_pieces_over_box(
    symmetry: MirrorSymmetry,
    offsets: OffsetSurfaces,
    cells: tuple[int, int, int],
    phase: Array,
    *,
    natural: bool = False,
) -> Brep:
    """The pieces of the offset surfaces in every tetrahedron with a part inside the box.

    Open, and ragged outside unless the planes of the box are mirrors: then the pieces end in them. With `natural` the phase
    translates the box together with the lattice, so that its planes stay mirrors.
    """
    motion = place_pieces(symmetry, cells, phase, natural=natural)
    parts = []
    for layer in offsets.layers():
        # A reflection reverses S_u x S_v against the image of the gradient, which it keeps.
        direction = layer.outward * orientation_sign(symmetry, offsets.primitives[layer.primitive])
        parts.append(place_faces(layer.primitive, motion, direction * motion.handedness, layer.tag))
    return PlacedFaces.concatenate(parts).weld(offsets.primitives)


def place_pieces(symmetry: MirrorSymmetry, cells: tuple[int, int, int], phase: Array, *, natural: bool) -> Motion:
    """Motions of the piece into every tetrahedron with a part inside the box; with `natural` the box moves with the phase."""
    shift, phase = (phase, 0 * phase) if natural else (0 * phase, phase)
    motion = _copies_around_box(symmetry.motions, cells, phase)
    motion = motion[_reaches_into_box(motion[:, None].apply(symmetry.edges.reshape(4, 3)), np.array(cells))]
    return Motion(motion.rotation, motion.translation + shift)


def orientation_sign(symmetry: MirrorSymmetry, primitive: BSplineSurface) -> int:
    """+1 if S_u x S_v of a primitive points along the gradient of the nodal function, else -1."""
    (u0, u1), (v0, v1) = primitive.domain
    u, v = np.array([(u0 + u1) / 2]), np.array([(v0 + v1) / 2])
    return int(np.sign(primitive.normal(u, v)[0] @ symmetry.waves.gradient(primitive(u, v))[0]))


def place_whole_cells(
    name: str, cells: tuple[int, int, int], phase: Array, closed: tuple[bool, bool, bool] = (False, False, False)
) -> Motion:
    """Motions of the mid patch that make a block of whole cells, one for each class of patches, moved by `phase`.

    The block is connected by edges, and its boundary has no non-manifold vertex. Along a `closed` axis it meets itself.
    """
    symmetry = surfaces.patch_symmetry(name)
    motion = symmetry.cell_motions
    corners = surfaces.primitive_patch(name).jet(*UNIT_SQUARE_CORNERS.T).position
    middles, corners = (motion[:, None].apply(points) for points in (symmetry.side_middles, corners))
    chosen = np.array(choose_manifold_block(build_incidence(middles, corners), cells, closed))
    patch, cell = chosen[:, 0], chosen[:, 1:]
    return Motion(motion.rotation[patch], motion.translation[patch] + cell + phase)


def build_natural_lattice(symmetry: PatchSymmetry, offsets: OffsetSurfaces, placements: Motion) -> Brep:
    """A closed sheet: both offset surfaces on every placement, and a ruled gap face over every open side of the mid patches.

    Gaps are closed after copying, so that none lies inside the solid (TPMS2STEP, section 3.6). Raises ValueError for a skeletal
    solid, which has one surface only.
    """
    if offsets.lower is None or offsets.upper is None:
        raise ValueError("a natural boundary bridges two surfaces; a skeletal solid has one")
    below, above = surfaces_over_mid_patch(symmetry, offsets)
    gaps = [ruled_surface(below.side(side), above.side(side)) for side in range(4)]
    patch, side = find_open_sides(symmetry, placements)
    bridges = place_faces(len(offsets.primitives) + side, placements[patch], symmetry.handedness, "gap")
    faces = PlacedFaces.concatenate([_place_layers(symmetry, offsets, placements), bridges])
    return faces.weld((*offsets.primitives, *gaps))


def find_open_sides(
    symmetry: PatchSymmetry, placements: Motion, periods: Sequence[float] = (0.0, 0.0, 0.0)
) -> tuple[IntArray, IntArray]:
    """Sides of the placed mid patches that no other of them shares, as patch and side numbers: (n,), (n,).

    `periods`, in cells: the translations along the axes that leave a closed lattice as it is; 0 where it ends.
    """
    middle = placements[:, None].apply(symmetry.side_middles)
    size = float(np.linalg.norm(symmetry.side_middles[0] - symmetry.side_middles[2]))
    label, _ = cluster_points(roll_up(middle.reshape(-1, 3), periods), WELD_RADIUS_FRACTION * size)
    alone = np.flatnonzero(np.bincount(label)[label] == 1)
    return alone // 4, alone % 4


def ruled_surface(below: BSplineCurve, above: BSplineCurve) -> BSplineSurface:
    """The ruled surface between two curves of one spline space: u along the curves, v from `below` to `above` on [0, 1]."""
    if below.degree != above.degree or not np.array_equal(below.knots, above.knots):
        raise ValueError("the two surfaces of a sheet need one spline space")
    poles = np.stack([below.poles, above.poles], axis=1)
    return BSplineSurface(poles, above.knots, np.repeat([0.0, 1.0], 2), above.degree, 1)


def quarter_patch(surface: BSplineSurface) -> list[BSplineSurface]:
    """The patch split along both midlines, each quarter reparametrised to the unit square so that adjacent sides agree."""
    (u0, u1), (v0, v1) = surface.domain
    quarters = [q for half in split_surface(surface, 0, (u0 + u1) / 2) for q in split_surface(half, 1, (v0 + v1) / 2)]
    return [replace(q, knots_u=_rescale_knots(q.knots_u), knots_v=_rescale_knots(q.knots_v)) for q in quarters]


def _rescale_knots(knots: Array) -> Array:
    return (knots - knots[0]) / (knots[-1] - knots[0])


def translate_motions(motions: Motion, by: Array) -> Motion:
    """The motions (m,) followed by each translation (n, 3): (n m,), translations outermost."""
    return Motion(np.tile(motions.rotation, (len(by), 1, 1)), (by[:, None, :] + motions.translation).reshape(-1, 3))


def cell_origins(cells: tuple[int, int, int], margin: int) -> IntArray:
    """Lower corners of the cells of the box and of `margin` cells around it: (n, 3)."""
    axes = [np.arange(-margin, n + margin) for n in cells]
    return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)


def _copies_around_box(motions: Motion, cells: tuple[int, int, int], phase: Array) -> Motion:
    """The motions of one cell in every cell of the box and around it, moved by the fractional part of the phase."""
    return translate_motions(motions, cell_origins(cells, SEARCH_MARGIN_CELLS) + (phase - np.floor(phase)))


def _reaches_into_box(points: Array, size: Array) -> BoolArray:
    """Whether the bounding box of each point set (n, m, 3) overlaps the box [0, size]: (n,)."""
    low, high = points.min(axis=1), points.max(axis=1)
    return np.asarray(((high > TOUCH_TOL_CELLS) & (low < size - TOUCH_TOL_CELLS)).all(axis=1))


def _midlines_in_box_planes(primitives: Sequence[BSplineSurface], faces: PlacedFaces, size: Array) -> bool:
    """Whether a midline of some patch lies in a plane of the box [0, size]."""
    t = np.linspace(0.0, 1.0, 5)
    half = np.full(5, 0.5)
    lines = np.stack([[s(half, t), s(t, half)] for s in primitives])[faces.carrier]  # (F, 2, 5, 3)
    placed = faces.motion[:, None, None].apply(lines)
    planes = np.array([np.zeros(3), size])[:, None, None]  # (2, 1, 1, 3)
    return bool((np.abs(placed[None] - planes[:, None]).max(axis=3) < TOUCH_TOL_CELLS).any())


def _place_layers(symmetry: PatchSymmetry, offsets: OffsetSurfaces, placements: Motion) -> PlacedFaces:
    """The faces of both offset surfaces on every placement of the mid patch.

    S_u x S_v of a primitive points along +n times the handedness of the patch. The swap reverses n and, as a mirror, S_u x S_v,
    so the statement holds for the placed primitive too.
    """
    return PlacedFaces.concatenate(
        [
            place_faces(
                layer.primitive,
                placements @ symmetry.swap if layer.swapped else placements,
                layer.outward * symmetry.handedness,
                layer.tag,
            )
            for layer in offsets.layers()
        ]
    )


def _surface_over_mid_patch(symmetry: PatchSymmetry, primitive: BSplineSurface, swapped: bool) -> BSplineSurface:
    """The surface that a layer lays over the mid patch, in the parameters of the mid patch."""
    if not swapped:
        return primitive
    images = symmetry.swap.apply(symmetry.side_middles)
    # The swap is a quarter-turn in (u, v), so sides keep running counter-clockwise.
    original = int(np.argmin(np.linalg.norm(images - symmetry.side_middles[0], axis=1)))
    return primitive.turned(original).moved(symmetry.swap)


def surfaces_over_mid_patch(symmetry: PatchSymmetry, offsets: OffsetSurfaces) -> list[BSplineSurface]:
    """The lower surface and the upper one, as far as they exist, in the parameters of the mid patch: normals join equal ones."""
    return [
        _surface_over_mid_patch(symmetry, offsets.primitives[layer.primitive], layer.swapped)
        for layer in offsets.layers()
    ]

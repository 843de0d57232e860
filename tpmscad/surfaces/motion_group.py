"""The symmetry that makes the whole surface of one patch, derived from the patch itself.

A motion is x -> R x + t in cells. All of them belong to a cubic space group in its standard axes: rotations are signed
permutations and translations multiples of 1/8, so what is computed from points of the patch is rounded to these, exactly, and
refused if it was not within round-off of them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from tpmscad._typing import Array
from tpmscad.surfaces.surface_patch import primitive_patch
from tpmscad.surfaces.surface_records import find_surface

SIDE_MIDDLES = ((0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5))
"""(u, v) in the middle of sides 0..3: v = 0, u = 1, v = 1, u = 0."""

TRANSLATION_DENOMINATOR = 8
"""Translations of the space groups are multiples of 1/GRAIN of the cell."""

MOTION_ROUND_OFF_TOL = 1e-12
"""How far a derived motion may be from the exact one; 1e-15 was measured."""


Motion = tuple[Array, Array]
GridPoint = tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class PatchSymmetry:
    """Motions of the patch, the same for both references; proper unless said otherwise, lengths in cells.

    - `edge_rotation` (4, 3, 3), `edge_translation` (4, 3): onto the neighbour over each side, a half-turn about the normal in
      the side's middle; +offset stays +offset. With s counted along the side, T X(side, s) = X(side, 1 - s).
    - `swap_rotation` (3, 3), `swap_translation` (3,): the rotoinversion of order 4 about the patch's centre, which maps the
      patch onto itself and +offset onto -offset: S X(u, v; d) = X(1 - v, u; -d).
    - `cell_rotations` (n, 3, 3), `cell_translations` (n, 3): one motion for each patch of the cubic cell, whose translations
      are the integer vectors; the n patches hang together by their sides and lie about the cell's middle.
    - `centring` (c, 3): the translations, modulo the integers, that keep the surface's sides.
    - `side_middles` (4, 3): the mid-points of the minimal patch's sides; the nodal patch's lie on the same axes.
    - `handedness`: +1 where du x dv is along the normal, else -1.
    """

    edge_rotation: Array
    edge_translation: Array
    swap_rotation: Array
    swap_translation: Array
    cell_rotations: Array
    cell_translations: Array
    centring: Array
    side_middles: Array
    handedness: int


@cache
def patch_symmetry(name: str) -> PatchSymmetry:
    """The symmetry of a catalogued surface's patch."""
    info = find_surface(name)
    surface = primitive_patch(info.name)
    middle = surface.jet(*np.array(SIDE_MIDDLES).T)
    centre = surface.jet(0.5, 0.5)
    edges = _round_motion(*_motion_about(2 * _outer_products(middle.normal) - np.eye(3), middle.position))
    # S takes du to dv = n x du, dv to -du and n to -n.
    n = centre.normal
    swap = _round_motion(*_motion_about(np.cross(n, np.eye(3)).T - _outer_products(n), centre.position))
    cell = _grow_unit_cell(*edges, np.rint(TRANSLATION_DENOMINATOR * centre.position), info.patches_per_cell)
    for shared in (*edges, *swap, *cell, middle.position, centring := _find_centring(*edges)):
        shared.setflags(write=False)  # every caller gets the same arrays
    handedness = int(np.sign(np.cross(centre.du, centre.dv) @ n))
    return PatchSymmetry(*edges, *swap, *cell, centring, middle.position, handedness)


def _outer_products(n: Array) -> Array:
    return n[..., :, None] * n[..., None, :]


def _motion_about(rotation: Array, fixed: Array) -> Motion:
    return rotation, fixed - np.einsum("...ij,...j->...i", rotation, fixed)


def _round_motion(rotation: Array, translation: Array) -> Motion:
    exact = (
        np.rint(rotation) + 0.0,
        np.rint(TRANSLATION_DENOMINATOR * translation) / TRANSLATION_DENOMINATOR + 0.0,
    )  # + 0.0: no minus zeros
    error = max(np.abs(exact[0] - rotation).max(), np.abs(exact[1] - translation).max())
    if error > MOTION_ROUND_OFF_TOL:
        raise ArithmeticError(f"derived motion is {error:.3g} from any of a cubic space group")
    return exact


def _grow_unit_cell(rotation: Array, translation: Array, centre: Array, count: int) -> Motion:
    """One motion per patch modulo integers, grown side by side from the primitive.

    Each step takes the patch that shares most sides with those taken, which keeps the border short (40, 48, 22 open sides for
    gyroid, Diamond, Schwarz P); ties go to the patch nearest to the middle of those taken, then to the first found. A patch
    is known by its centre, in whole grains.
    """
    around = np.einsum("sij,j->si", rotation, centre) + TRANSLATION_DENOMINATOR * translation
    taken: dict[GridPoint, Motion] = {}
    border: dict[GridPoint, Motion] = {_grid_point(centre): (np.eye(3), np.zeros(3))}
    while border:
        best = _select_most_enclosed(border, taken, around)
        turn, shift = taken[best] = border[best]
        for r, t in zip(rotation, translation, strict=True):
            step = turn @ r, turn @ t + shift
            border.setdefault(_grid_point(step[0] @ centre + TRANSLATION_DENOMINATOR * step[1]), step)
        classes = {_grid_point(np.mod(at, TRANSLATION_DENOMINATOR)) for at in taken}
        border = {
            at: motion
            for at, motion in border.items()
            if _grid_point(np.mod(at, TRANSLATION_DENOMINATOR)) not in classes
        }
    if len(taken) != count:
        raise ArithmeticError(f"the cell has {len(taken)} patches, not {count}")
    rotations, translations = (np.stack(part) for part in zip(*taken.values(), strict=True))
    return rotations, translations - np.floor(np.mean(list(taken), axis=0) / TRANSLATION_DENOMINATOR)


def _select_most_enclosed(border: dict[GridPoint, Motion], taken: dict[GridPoint, Motion], around: Array) -> GridPoint:
    middle = np.mean(list(taken or border), axis=0)

    def rank(item: tuple[GridPoint, Motion]) -> tuple[int, float]:
        at, (turn, shift) = item
        shared = sum(_grid_point(p) in taken for p in around @ turn.T + TRANSLATION_DENOMINATOR * shift)
        return -shared, float(np.linalg.norm(at - middle).round(9))

    return min(border.items(), key=rank)[0]


def _grid_point(grains: Array) -> GridPoint:
    return tuple((grains + 0.0).tolist())


def _find_centring(rotation: Array, translation: Array) -> Array:
    """The pure translations, modulo integers, among all words in the four half-turns: (c, 3)."""
    found: dict[bytes, Motion] = {}
    fresh = [(np.eye(3), np.zeros(3))]
    while fresh:
        r, t = fresh.pop()
        word = np.vstack([r, np.mod(t, 1.0)]) + 0.0  # no minus zeros in the key
        if word.tobytes() not in found:
            found[word.tobytes()] = r, word[3]
            fresh.extend((r @ r1, r @ t1 + t) for r1, t1 in zip(rotation, translation, strict=True))
    pure = [t for r, t in found.values() if np.array_equal(r, np.eye(3))]
    return np.array(sorted(map(tuple, pure)))

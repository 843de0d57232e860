"""The space group that generates the whole surface from one patch, derived from the patch itself.

A motion is x -> R x + t in cells. All motions belong to a cubic space group in its standard axes: rotations are signed
permutation matrices and translations are multiples of 1/8. Motions computed from points of the patch are therefore rounded to
exact ones, and an error is raised if the rounding changes them by more than round-off.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import Annotated

import numpy as np

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import TEXT
from tpmscad.catalogue import find_surface
from tpmscad.rigid_motion import Motion
from tpmscad.surfaces.surface_patch import primitive_patch

SIDE_MIDDLES = ((0.5, 0.0), (1.0, 0.5), (0.5, 1.0), (0.0, 0.5))
"""(u, v) of the midpoints of sides 0..3: v = 0, u = 1, v = 1, u = 0."""

TRANSLATION_DENOMINATOR = 8
"""Translations of the space groups are multiples of one over this number of the cell."""

MOTION_ROUND_OFF_TOL = 1e-12
"""Greatest difference between a derived motion and the exact one, entry by entry."""

GridPoint = tuple[float, ...]
"""Coordinates in multiples of the least translation, as a key of dictionaries."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchSymmetry:
    """Motions of a primitive patch, the same for both references; all but `swap` are proper. Lengths in cells.

    - `edge_motions` (4,): onto the neighbour across each side, a half-turn about the normal at the side's midpoint, which maps
      +offset to +offset. With the parameter s along the side, T X(side, s) = X(side, 1 - s).
    - `swap`, a single motion: the rotoinversion of order 4 about the centre of the patch, which maps the patch onto itself and
      +offset to -offset: S X(u, v; d) = X(1 - v, u; -d).
    - `cell_motions` (n,): one for each patch of the cubic cell, modulo integer translations. The n patches are connected across
      their sides and surround the middle of the cell.
    - `centring` (c, 3): translations modulo the integers that preserve the sides of the surface.
    - `side_middles` (4, 3): midpoints of the minimal patch's sides; those of the nodal patch lie on the same axes.
    - `handedness`: +1 if du x dv is along the normal, else -1.
    """

    edge_motions: Motion
    swap: Motion
    cell_motions: Motion
    centring: Array
    side_middles: Array
    handedness: int


@validate_call()
@cache
def patch_symmetry(name: Annotated[str, TEXT, "Name or alias of a surface with an exact patch."]) -> PatchSymmetry:
    """Return the motions that generate a surface from its primitive patch.

    Returns
    -------
    PatchSymmetry
        The motions; repeated calls return the same object, whose arrays are read-only.

    Raises
    ------
    InvalidRequest
        If the surface is unknown or has no exact patch.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> len(surfaces.patch_symmetry("schwarz_p").cell_motions)
    12
    """
    info = find_surface(name)
    surface = primitive_patch(info.name)
    middle = surface.jet(*np.array(SIDE_MIDDLES).T)
    centre = surface.jet(0.5, 0.5)
    edges = _round_motion(_motion_about(2 * _outer_products(middle.normal) - np.eye(3), middle.position))
    # S maps du to dv = n x du, dv to -du and n to -n
    n = centre.normal
    swap = _round_motion(_motion_about(np.cross(n, np.eye(3)).T - _outer_products(n), centre.position))
    cell = _grow_unit_cell(edges, np.rint(TRANSLATION_DENOMINATOR * centre.position), info.patches_per_cell)
    centring = _find_centring(edges)
    arrays = [array for motion in (edges, swap, cell) for array in (motion.rotation, motion.translation)]
    for shared in (*arrays, middle.position, centring):
        shared.setflags(write=False)  # every caller gets the same arrays
    handedness = int(np.sign(np.cross(centre.du, centre.dv) @ n))
    return PatchSymmetry(edges, swap, cell, centring, middle.position, handedness)


def _outer_products(n: Array) -> Array:
    """Dyads n n^T of vectors (..., 3): (..., 3, 3)."""
    return n[..., :, None] * n[..., None, :]


def _motion_about(rotation: Array, fixed: Array) -> Motion:
    """Rotation about a fixed point."""
    return Motion(rotation, fixed - np.einsum("...ij,...j->...i", rotation, fixed))


def _round_motion(motion: Motion) -> Motion:
    """The motion of a cubic space group nearest to a derived one; ArithmeticError if it differs by more than round-off."""
    exact = Motion(
        np.rint(motion.rotation) + 0.0,
        np.rint(TRANSLATION_DENOMINATOR * motion.translation) / TRANSLATION_DENOMINATOR + 0.0,
    )  # + 0.0: no minus zeros
    error = max(np.abs(exact.rotation - motion.rotation).max(), np.abs(exact.translation - motion.translation).max())
    if error > MOTION_ROUND_OFF_TOL:
        raise ArithmeticError(f"derived motion is {error:.3g} from any of a cubic space group")
    return exact


def _grow_unit_cell(edges: Motion, centre: Array, count: int) -> Motion:
    """One motion per patch modulo integer translations, grown across sides from the primitive patch.

    Each step takes the patch that shares most sides with those taken, which keeps the border short; ties are broken by the
    distance to the mean of those taken, then by order of discovery. A patch is identified by its centre on the grid.
    """
    around = edges.apply_to_vectors(centre) + TRANSLATION_DENOMINATOR * edges.translation
    taken: dict[GridPoint, Motion] = {}
    border: dict[GridPoint, Motion] = {_grid_point(centre): Motion(np.eye(3), np.zeros(3))}
    while border:
        best = _select_most_enclosed(border, taken, around)
        taken[best] = border[best]
        for edge in edges:
            step = border[best] @ edge
            at = step.apply_to_vectors(centre) + TRANSLATION_DENOMINATOR * step.translation
            border.setdefault(_grid_point(at), step)
        classes = {_grid_point(np.mod(at, TRANSLATION_DENOMINATOR)) for at in taken}
        border = {
            at: motion
            for at, motion in border.items()
            if _grid_point(np.mod(at, TRANSLATION_DENOMINATOR)) not in classes
        }
    if len(taken) != count:
        raise ArithmeticError(f"the cell has {len(taken)} patches, not {count}")
    cell = Motion.stack(list(taken.values()))
    shift = np.floor(np.mean(list(taken), axis=0) / TRANSLATION_DENOMINATOR)
    return Motion(cell.rotation, cell.translation - shift)


def _select_most_enclosed(border: dict[GridPoint, Motion], taken: dict[GridPoint, Motion], around: Array) -> GridPoint:
    middle = np.mean(list(taken or border), axis=0)

    def rank(item: tuple[GridPoint, Motion]) -> tuple[int, float]:
        at, motion = item
        neighbours = motion.apply_to_vectors(around) + TRANSLATION_DENOMINATOR * motion.translation
        shared = sum(_grid_point(p) in taken for p in neighbours)
        return -shared, float(np.linalg.norm(at - middle).round(9))

    return min(border.items(), key=rank)[0]


def _grid_point(grains: Array) -> GridPoint:
    return tuple((grains + 0.0).tolist())


def _find_centring(edges: Motion) -> Array:
    """Pure translations modulo the integers in the group generated by the four half-turns: (c, 3)."""
    found: dict[bytes, Motion] = {}
    fresh = [Motion(np.eye(3), np.zeros(3))]
    while fresh:
        word = fresh.pop()
        key = np.vstack([word.rotation, np.mod(word.translation, 1.0)]) + 0.0  # no minus zeros
        if key.tobytes() not in found:
            found[key.tobytes()] = Motion(word.rotation, key[3])
            fresh.extend(word @ edge for edge in edges)
    pure = [word.translation for word in found.values() if np.array_equal(word.rotation, np.eye(3))]
    return np.array(sorted(map(tuple, pure)))

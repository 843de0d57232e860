"""A triangulated body filled with pieces of a periodic solid: whole ones are placed, and only what the body cuts is computed.

The pieces that the boundary of the body, of its skin or of another mesh may touch are one closed block; its boolean with
all of these is that of the library Manifold, which leaves the coordinates of other points as they are. The sides towards
whole pieces are left out of the result, and the surfaces of the whole pieces join it in the same points.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.sections.polygon_regions import Operation
from tpmscad.brep.triangles import closed_mesh
from tpmscad.brep.triangles.closed_mesh import SolidMesh, combine_meshes, label_points
from tpmscad.brep.triangles.repeated_pieces import BETWEEN_PIECES, LATTICE, RepeatedPieces, Scale
from tpmscad.brep.winding_numbers import winding_numbers
from tpmscad.errors import TrimmingError
from tpmscad.memory_limit import require_memory

FIRST_OF_BODY = 1
"""Faces of a filled body from this one on are those of the body, its skin and other meshes."""

VOXELS_PER_CELL = 8
"""Voxels along each edge of a cell, by which pieces near a boundary are found."""

TOUCH_MARGIN_CELLS = 1e-7
"""In cells: a voxel that is nearer to triangles counts as touched by them."""

BYTES_PER_VOXEL = 20
"""Memory taken at the peak for each voxel while pieces are chosen."""

MAX_WAITING = 256
"""Parts of a triangle that wait while others are divided, at most: three for each time that its size is halved, 80 times."""

ROUND_OFF_VOXELS = 1e-7
"""By how much a box may reach into a voxel that it does not meet."""


@dataclass(frozen=True, slots=True, eq=False)
class PieceChoice:
    """The pieces of a periodic solid in a body: whole and cut ones, (x, y, z, P) each, in the cells from `origin` on."""

    origin: IntArray
    whole: BoolArray
    cut: BoolArray


def choose_pieces(
    cell: Array,
    low: Array,
    high: Array,
    body: SolidMesh,
    others: Sequence[SolidMesh] = (),
    margin: float = TOUCH_MARGIN_CELLS,
) -> PieceChoice:
    """The pieces inside a body and no other mesh, and those that a boundary may touch.

    low, high (P, 3): the boxes of the pieces of one cell, which repeat after `cell` (3,). margin: in cells, below half a voxel.
    """
    least, most = low.min(axis=0), high.max(axis=0)
    origin = np.floor((body.points.min(axis=0) - most) / cell).astype(np.int64)
    size = np.floor((body.points.max(axis=0) - least) / cell).astype(np.int64) - origin + 1
    require_memory(
        float(np.prod(size.astype(float))),
        BYTES_PER_VOXEL * VOXELS_PER_CELL**3 + 3.0 * len(low),
        f"{' x '.join(map(str, size.tolist()))} cells around the body",
        "take larger cells, or cut the body into parts",
    )
    pitch, corner = cell / VOXELS_PER_CELL, least + origin * cell
    shape = (size - 1) * VOXELS_PER_CELL + np.ceil((most - least) / pitch).astype(np.int64)
    touched = np.zeros(shape, bool)
    for mesh in (body, *others):
        _mark_touched(touched, (mesh.points[mesh.triangles] - corner) / pitch, margin * VOXELS_PER_CELL)
    label, count = ndimage.label(~touched)
    first = np.zeros(count + 1, np.int64)
    first[label.ravel()[::-1]] = np.arange(label.size)[::-1]
    centres = corner + (np.stack(np.unravel_index(first[1:], touched.shape), axis=1) + 0.5) * pitch
    filled = winding_numbers(body.points, body.triangles, centres) > 0
    for other in others:
        filled &= winding_numbers(other.points, other.triangles, centres) == 0
    inside: BoolArray = np.append(False, filled)[label]
    total = np.pad(touched, [(1, 0)] * 3).astype(np.int32)
    for axis in range(3):
        np.cumsum(total, axis=axis, out=total)
    starts = np.floor((low - least) / pitch + ROUND_OFF_VOXELS).astype(np.int64)
    stops = np.ceil((high - least) / pitch - ROUND_OFF_VOXELS).astype(np.int64)
    whole, cut = np.zeros((*size, len(starts)), bool), np.zeros((*size, len(starts)), bool)
    for piece, ends in enumerate(np.stack([starts, stops], axis=1)):
        count = np.zeros(size, np.int64)
        for which in np.ndindex(2, 2, 2):
            at = _every_cell([int(ends[w, axis]) for axis, w in enumerate(which)], size)
            count += (-1) ** (3 - sum(which)) * total[at]
        cut[..., piece] = count > 0
        whole[..., piece] = (count == 0) & inside[_every_cell(ends[0].tolist(), size)]
    return PieceChoice(origin, whole, cut)


def _every_cell(first: Sequence[int], size: IntArray) -> tuple[slice, ...]:
    """The voxels that lie in each cell as one does in the first."""
    step = VOXELS_PER_CELL
    return tuple(slice(f, f + step * (n - 1) + 1, step) for f, n in zip(first, size.tolist(), strict=True))


@njit_cached
def _mark_touched(touched: BoolArray, corners: Array, margin: float) -> None:
    """Mark the voxels that triangles (m, 3, 3), in voxels, may meet: those of their boxes, after large ones are quartered."""
    first, last = np.empty(3, np.int64), np.empty(3, np.int64)
    due, own, middles = np.empty((MAX_WAITING, 3, 3)), np.empty((3, 3)), np.empty((3, 3))
    for t in range(len(corners)):
        due[0], count = corners[t], 1
        while count > 0:
            count -= 1
            own[:] = due[count]
            large = False
            for axis in range(3):
                low = min(own[0, axis], own[1, axis], own[2, axis])
                high = max(own[0, axis], own[1, axis], own[2, axis])
                large = large or high - low > 1.0
                first[axis] = max(0, int(np.floor(low - margin)))
                last[axis] = min(touched.shape[axis] - 1, int(np.floor(high + margin)))
            if not large:
                touched[first[0] : last[0] + 1, first[1] : last[1] + 1, first[2] : last[2] + 1] = True
                continue
            for k in range(3):
                for axis in range(3):
                    middles[k, axis] = 0.5 * (own[k, axis] + own[(k + 1) % 3, axis])
            for k in range(3):
                due[count, 0], due[count, 1], due[count, 2] = own[k], middles[k], middles[(k + 2) % 3]
                count += 1
            due[count] = middles
            count += 1


def combine_parts(matter: SolidMesh, body: SolidMesh, others: Sequence[tuple[Operation, SolidMesh]] = ()) -> SolidMesh:
    """Matter cut by a body, then united with others or without them, whose faces count from FIRST_OF_BODY."""
    filled = matter
    for operation, mesh in (("intersection", body), *others):
        # what is read anew is cleaned of slivers: operations that Manifold evaluates together left some, joined along an edge
        filled = combine_meshes(operation, [filled, replace(mesh, face=mesh.face + FIRST_OF_BODY)])
    return filled


def fill_mesh(
    pieces: RepeatedPieces,
    choice: PieceChoice,
    body: SolidMesh,
    others: Sequence[tuple[Operation, SolidMesh]] = (),
    scale: Scale | None = None,
    *,
    is_closed: bool = True,
) -> SolidMesh:
    """The body filled with the pieces, then united with others, such as its skin, or without them, one after the other.

    is_closed: whether the pieces are all that fill the body; else the result is open where some are missing. Face 0 is the
    lattice; the faces of the others count from 1. TrimmingError if the result should be closed and is not.
    """
    placed = pieces.place(choice.whole, choice.cut, choice.origin, scale)
    filled = combine_parts(placed.block, body, others)
    mesh = filled.select(filled.face != BETWEEN_PIECES)
    if len(placed.whole):
        # the points that both have are known by their coordinates, bit for bit
        common = placed.common[np.argsort(label_points(placed.points[placed.common]))]
        labels, own = label_points(placed.points[common]), label_points(mesh.points)
        at = np.minimum(np.searchsorted(labels, own), len(labels) - 1) if len(labels) else np.zeros(len(own), np.int64)
        shared = labels[at] == own if len(labels) else np.zeros(len(own), bool)
        number = np.empty(len(own), np.int32)
        number[shared] = common[at[shared]]
        number[~shared] = placed.n_whole + np.arange(int((~shared).sum()))
        joined = number[mesh.triangles]
        # Manifold doubles the ends of an edge in which four triangles meet, and fills what lies between them
        kept = (joined != np.roll(joined, 1, axis=1)).all(axis=1)
        mesh = SolidMesh(
            np.concatenate([placed.points[: placed.n_whole], mesh.points[~shared]]),
            np.concatenate([placed.whole, joined[kept]]),
            np.concatenate([np.full(len(placed.whole), LATTICE, np.int32), mesh.face[kept]]),
        )
    if is_closed and not closed_mesh.is_closed(mesh.triangles):
        raise TrimmingError("the triangles of cut and whole pieces do not close")
    return mesh

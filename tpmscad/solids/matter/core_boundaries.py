"""The boundary of the voids of a core, exactly, for the combinations of `crossing_fields`."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep, copy_brep, join_breps, move_brep, reverse_faces
from tpmscad.errors import InvalidRequest
from tpmscad.fields.kinds.cores import CoreField
from tpmscad.memory_limit import require_memory
from tpmscad.rigid_motion import Motion
from tpmscad.trimming.operands.polyhedra import polyhedron

BYTES_PER_VOID = 60_000
"""Memory taken at the peak for each void of a core that is cut by a body, as measured."""


def bound_voids(core: CoreField, lo: Array, hi: Array) -> Brep:
    """The prisms of the voids that meet the box [lo, hi], which end beyond it; InvalidRequest if there are none."""
    axes, origin = np.array(core.axes), np.array(core.origin)
    corners = np.array([[x, y, z] for x in (lo[0], hi[0]) for y in (lo[1], hi[1]) for z in (lo[2], hi[2])])
    local = (corners - origin) @ axes.T
    low, high = local.min(axis=0), local.max(axis=0)
    margin = 0.5 * core.cell
    prisms = []
    placed = list(core.cells.within(low[:2], high[:2]))
    count = sum(len(moves) for _, moves in placed)
    if not count:
        raise InvalidRequest("no void of the core lies in the domain: check its cell and the domain")
    require_memory(count, BYTES_PER_VOID, f"{count} cells of a core", "use larger cells, or a smaller body")
    for corners, moves in placed:
        if len(moves):
            prism = _extrude(corners, low[2] - margin, high[2] + margin)
            prisms.append(copy_brep(prism, np.column_stack([moves, np.zeros(len(moves))])))
    placement = Motion(axes.T, origin)
    moved = move_brep(join_breps(prisms), placement)
    return moved if placement.handedness > 0 else reverse_faces(moved)


def _extrude(corners: Array, low: float, high: float) -> Brep:
    """The prism over a polygon (n, 2) that is given counter-clockwise."""
    n = len(corners)
    ends = np.concatenate([np.column_stack([corners, np.full(n, end)]) for end in (low, high)])
    following = [(i + 1) % n for i in range(n)]
    sides = [(i, j, j + n, i + n) for i, j in enumerate(following)]
    return polyhedron(ends, [tuple(range(n - 1, -1, -1)), tuple(range(n, 2 * n)), *sides])

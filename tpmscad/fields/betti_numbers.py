"""Betti numbers of the solid of a field in a box, sampled ever finer, and finer still about its necks.

A uniform grid sees a hole in a wall that is thinner than its spacing, and two agree on it. So the field's saddles are looked for
where a phase is narrow, and the grid gets lines through each in a geometric ladder: the shape about a saddle is a cone, and the
same at every size.
"""

from __future__ import annotations

import numpy as np

from tpmscad import topology
from tpmscad._typing import Array
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.fields.saddles import find_saddles
from tpmscad.fields.sample_grid import SampleGrid

INITIAL_LINES, REFINEMENT_RATIO = 96, 1.4
"""Grid lines along the box's longest edge at first, and how many times as many from one grid to the next."""

MAX_NODES = 2**24
"""Nodes of the finest grid: 128 MB."""

NARROW_HALF_WIDTH_SPACINGS = 0.75
"""Half a neck's width, in spacings of the grid, that gets lines of its own."""

SADDLE_LINE_OFFSETS_SPACINGS = 1.5 ** -np.arange(13.0)
"""Lines to each side of a saddle, in spacings: necks of a hundredth of one are seen."""


def compute_betti_numbers(field: Field, lo: Array, hi: Array) -> tuple[int, int, int] | None:
    """Betti numbers of {field < 0} in the box, sampled ever finer until two grids agree; None if none do.

    Of level sets that do not meet, A and B with A or B = the box: b(A and B) = b(A) + b(B) but for one piece (Mayer-Vietoris).
    So walls thinner than any grid are counted right.
    """
    if isinstance(field, MinMaxField):
        first, second = (compute_betti_numbers(f, lo, hi) for f in (field.first, field.second))
        if first is None or second is None:
            return None
        pieces = first[0] + second[0] - (1 if field.sign > 0 else 0)
        return pieces, first[1] + second[1], first[2] + second[2]
    lines = float(INITIAL_LINES)
    last = None
    while True:
        counts = np.maximum(8, np.ceil(lines * (hi - lo) / (hi - lo).max())).astype(int)
        if np.prod(counts + 1.0) > MAX_NODES:
            return None
        found = topology.betti(field.on_grid(*_place_grid_lines(field, lo, hi, counts)))
        now = (found.b0, found.b1, found.b2)
        if now == last:
            return now
        last = now
        lines = REFINEMENT_RATIO * lines


def _place_grid_lines(field: Field, lo: Array, hi: Array, counts: Array) -> list[Array]:
    """Grid lines along each axis: evenly spaced, and about necks; those only where their nodes are not too many."""
    grid = SampleGrid(tuple(lo.tolist()), tuple(hi.tolist()), tuple((counts + 1).tolist()))
    found = find_saddles(field, grid, np.ones(grid.shape, bool), NARROW_HALF_WIDTH_SPACINGS * float(grid.spacing.min()))
    steps = np.concatenate([-SADDLE_LINE_OFFSETS_SPACINGS, [0.0], SADDLE_LINE_OFFSETS_SPACINGS])
    axes = []
    for axis, even in enumerate(grid.axes):
        own = (found.points[:, axis, None] + grid.spacing[axis] * steps).ravel()
        axes.append(np.union1d(even, own[(own > lo[axis]) & (own < hi[axis])]))
    return axes if np.prod([float(len(axis)) for axis in axes]) <= MAX_NODES else list(grid.axes)

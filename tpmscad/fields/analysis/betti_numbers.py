"""Betti numbers of a field's solid in a box by successively refined sampling, with grid lines graded towards its necks.

Uniform grids miss walls that are thinner than their spacing, and two of them can agree on a wrong count. The critical points in
narrow places are therefore located, those of the field and of its restrictions to the faces and edges of the box, and grid lines
are added at geometrically decreasing distances from each: near a saddle the level set is a cone, the same at every scale.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import product
from typing import NamedTuple

import numpy as np

from tpmscad import topology
from tpmscad._typing import Array
from tpmscad.fields.analysis.outermost_extremes import expose_extremes, list_leaves
from tpmscad.fields.analysis.saddles import find_narrow_points
from tpmscad.fields.data.sample_grid import SampleGrid
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.topology.cubical_betti import sum_cells_of_block

Betti = tuple[int, int, int]
"""Components, handles and cavities."""

INITIAL_LINES, REFINEMENT_RATIO = 96, 1.4
"""Grid lines along the longest edge of the first grid, and the factor from one grid to the next."""

MAX_UNIFORM_NODES, MAX_FOREIGN_UNIFORM_NODES = 2**24, 2**23
"""Greatest number of nodes of a uniform grid, 128 MB of values; the second number holds for fields that are not on the tape
entirely. Distances from a level set take 10 us a node, a hundred times as long."""

MAX_GRADED_NODES, MAX_FOREIGN_GRADED_NODES = 3 * 2**24, 3 * 2**20
"""Greatest number of nodes of a grid with lines graded towards necks, 384 MB of values; a blend of two takes 8 s for them."""

SAMPLED_TOGETHER = 2
"""Operands that are sampled together: the two sides of a wall, whose formulas share most; memory bounds the number."""

NARROW_HALF_WIDTH_SPACINGS = 0.75
"""Half width of a neck, in grid spacings, below which grid lines are added through it."""

SADDLE_LINE_OFFSETS_SPACINGS = 2.0 ** -np.arange(8.0)
"""Offsets, in grid spacings, of the lines added on each side of a critical point; they resolve necks of 0.01 spacings. With the
ratio 1.5 there are 13 of them, and 2 to 4 times as many nodes for the same counts."""

LEAST_OFFSET_HALF_WIDTHS = 0.25
"""Least offset of these lines in half widths of the neck. Closer to the critical point the level set is no cone any more; lines
there made 3 to 10 times as many nodes for the same counts."""

FINER_LINES = INITIAL_LINES * REFINEMENT_RATIO**2
"""Grid lines of a third grid, beyond two that agree."""

FINEST_LINES = (4 * INITIAL_LINES, 6 * INITIAL_LINES, 9 * INITIAL_LINES)
"""Grid lines of grids that are sampled near the level set only. Thin rims of rough data need them: where a wall ends in a wedge a
grid shows tunnels that are none, without a neck that would tell."""

BLOCK_CELLS = 48
"""Cells along each edge of a block of such a grid."""

REACH_FACTOR = 2.0
"""In greatest differences of neighbouring samples: a block is left out if all samples in and around it are farther from zero."""


class _Count(NamedTuple):
    """Betti numbers of a grid, and whether the grid has lines through every neck."""

    betti: Betti
    sees_necks: bool


def compute_betti_numbers(
    field: Field,
    lo: Array,
    hi: Array,
    lines: float = INITIAL_LINES,
    n_agreeing: int = 2,
    confirm: Callable[[Betti], bool] = lambda betti: False,
    *,
    crossing: bool = False,
) -> Betti | None:
    """Betti numbers of {field < 0} in the box from the first successive grids that agree; None if too few do.

    A grid counts only if it has lines through every neck found on it: uniform grids can agree on a wrong count. Where no grid
    has, what uniform grids agree on is returned if other evidence confirms it, by `confirm`.

    The operands of a minimum or maximum must be solids whose level sets do not meet. Solids A and B that cover the box then
    satisfy b(A and B) = b(A) + b(B) except for one component (Mayer-Vietoris), so that walls thinner than any grid are counted
    correctly. If level sets are `crossing`, the field is counted as one; acute wedges at their edges may fall apart on any grid.
    """
    field = expose_extremes(field)
    operands = [field] if crossing else list_leaves(field)
    counted: list[Betti] = []
    certain = True
    for first in range(0, len(operands), SAMPLED_TOGETHER):
        for history in _count_operands(operands[first : first + SAMPLED_TOGETHER], lo, hi, lines, n_agreeing):
            if not _agree(history, n_agreeing):
                return None
            counted.append(history[-1].betti)
            certain &= _is_settled(history, n_agreeing)
    total = counted[0] if crossing else _add_betti_numbers(field, iter(counted))
    return total if certain or confirm(total) else None


def count_tunnels_near_surface(
    field: Field, lo: Array, hi: Array, known: Betti, confirm: Callable[[Betti], bool]
) -> Betti | None:
    """The numbers known with as many tunnels as fine grids near the level set show, None if none of these is confirmed.

    b1 = b0 + b2 - X with the Euler characteristic X, a sum over blocks of a grid, to which those without a crossing add nothing.
    Fields that call foreign functions are not counted: they take too long.
    """
    if field.tape.calls_foreign_functions:
        return None
    for lines in FINEST_LINES:
        cells = _divide_box(lo, hi, lines)
        found = known[0], known[0] + known[2] - _sum_blocks(field, lo, hi, cells), known[2]
        if confirm(found):
            return found
        if found == known:  # it is the patches that are wrong: two more grids took 28 of 67 s to say so again
            return None
    return None


def _sum_blocks(field: Field, lo: Array, hi: Array, cells: Array) -> int:
    """The Euler characteristic of {field <= 0} on a grid, of which blocks without a crossing are not sampled."""
    axes = [np.linspace(low, high, n + 1) for low, high, n in zip(lo, hi, cells, strict=True)]
    coarse = [np.linspace(low, high, n) for low, high, n in zip(lo, hi, np.maximum(9, cells // 4), strict=True)]
    known, total = field.on_grid(*coarse), 0
    for first in product(*(range(0, len(axis), BLOCK_CELLS) for axis in axes)):
        own = [axis[start : start + BLOCK_CELLS + 1] for axis, start in zip(axes, first, strict=True)]
        ends = [start + BLOCK_CELLS >= len(axis) for axis, start in zip(axes, first, strict=True)]
        around = tuple(
            slice(max(0, int(np.searchsorted(axis, part[0])) - 2), int(np.searchsorted(axis, part[-1])) + 2)
            for axis, part in zip(coarse, own, strict=True)
        )
        if any(ends) or _may_cross(known[around]):
            inside = field.on_grid(*own) <= 0
            total += sum_cells_of_block(np.pad(inside, [(0, int(end)) for end in ends]))
    return total


def _may_cross(values: Array) -> bool:
    """Whether the level set may pass between samples (nx, ny, nz)."""
    change = sum(float(np.abs(np.diff(values, axis=axis)).max(initial=0.0)) for axis in range(3))
    return bool(values.min() < 0 < values.max() or np.abs(values).min() <= REACH_FACTOR * change)


def _add_betti_numbers(field: Field, counted: Iterator[Betti]) -> Betti:
    """Betti numbers of minima and maxima from those of their operands, in the order of `list_leaves`."""
    if not isinstance(field, MinMaxField):
        return next(counted)
    first, second = _add_betti_numbers(field.first, counted), _add_betti_numbers(field.second, counted)
    return first[0] + second[0] - (1 if field.sign > 0 else 0), first[1] + second[1], first[2] + second[2]


def _count_operands(
    operands: Sequence[Field], lo: Array, hi: Array, lines: float, n_agreeing: int
) -> list[list[_Count]]:
    """The counts of each field on successive grids, until those that see all necks agree or the grids are too large."""
    counts: list[list[_Count]] = [[] for _ in operands]
    while unsettled := [k for k, history in enumerate(counts) if not _is_settled(history, n_agreeing)]:
        cells = _divide_box(lo, hi, lines)
        fields = [operands[k] for k in unsettled]
        if np.prod(cells + 1.0) > min(_limit_nodes(field)[0] for field in fields):
            break
        samples = _sample_on_graded_grids(fields, lo, hi, cells)
        for k, (values, sees_necks) in zip(unsettled, samples, strict=True):
            found = topology.betti(values)
            counts[k].append(_Count((found.b0, found.b1, found.b2), sees_necks))
        lines = REFINEMENT_RATIO * lines
    return counts


def _divide_box(lo: Array, hi: Array, lines: float) -> Array:
    """Numbers of cells (3,) of a grid with so many lines along the longest edge of the box."""
    return np.asarray(np.maximum(8, np.ceil(lines * (hi - lo) / (hi - lo).max())).astype(int))


def _limit_nodes(field: Field) -> tuple[int, int]:
    """The greatest numbers of nodes of a uniform and of a graded grid of a field."""
    if field.tape.calls_foreign_functions:
        return MAX_FOREIGN_UNIFORM_NODES, MAX_FOREIGN_GRADED_NODES
    return MAX_UNIFORM_NODES, MAX_GRADED_NODES


def _is_settled(history: Sequence[_Count], n_agreeing: int) -> bool:
    """Whether the last counts are as many as have to agree, equal, and see all necks."""
    return _agree(history, n_agreeing) and all(count.sees_necks for count in history[-n_agreeing:])


def _agree(history: Sequence[_Count], n_agreeing: int) -> bool:
    """Whether the last counts are as many as have to agree, and equal."""
    return len(history) >= n_agreeing and len({count.betti for count in history[-n_agreeing:]}) == 1


def _sample_on_graded_grids(
    operands: Sequence[Field], lo: Array, hi: Array, counts: Array
) -> Iterator[tuple[Array, bool]]:
    """Values of each field on a uniform grid with lines graded towards the necks, and False if these would be too many."""
    grid = SampleGrid(tuple(lo.tolist()), tuple(hi.tolist()), tuple((counts + 1).tolist()))
    half_width = NARROW_HALF_WIDTH_SPACINGS * float(grid.spacing.min())
    for field, narrow in zip(operands, find_narrow_points(operands, grid, half_width), strict=True):
        values = narrow.grid_values
        axes = [
            _grade_lines(uniform, spacing, narrow.points[:, axis], narrow.half_widths)
            for axis, (uniform, spacing) in enumerate(zip(grid.axes, grid.spacing, strict=True))
        ]
        too_many = np.prod([float(len(axis)) for axis in axes]) > _limit_nodes(field)[1]
        if too_many or not len(narrow.points):
            yield values, not len(narrow.points)
        else:
            yield field.on_grid(*axes), True


def _grade_lines(uniform: Array, spacing: float, narrow: Array, half_widths: Array) -> Array:
    """Uniform grid lines of an axis, and lines at decreasing distances from narrow places (n,) of given half widths (n,)."""
    added = [narrow]
    for offset in spacing * SADDLE_LINE_OFFSETS_SPACINGS:
        wide = narrow[offset >= LEAST_OFFSET_HALF_WIDTHS * half_widths]
        added += [wide - offset, wide + offset]
    lines = np.concatenate(added)
    return np.union1d(uniform, lines[(lines > uniform[0]) & (lines < uniform[-1])])

"""A field whose level sets cross, as a tree of solids that are made one by one and cut by each other.

An operand of the tree is exact (`exact_leaves`), or a minimum or maximum of fields whose level sets do not meet in the box,
such as the two walls of a sheet, which smooth patches bound entirely. Leaves without a surface in the box are solid or void
all over it, and are left out. A part of exact leaves alone is split into them without samples: each is exact by itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import CrossingSurfaces, LevelSetError
from tpmscad.fields.analysis.exact_leaves import NetworkLeaf, find_exact
from tpmscad.fields.analysis.local_leaves import find_meeting_leaves, has_slope_bounds, keeps_sign
from tpmscad.fields.analysis.outermost_extremes import expose_extremes, list_leaves, list_operands
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.fields.kinds.booleans import join_extremes
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.levelset.boundary_level_sets import check_separation, sample_level_set


@dataclass(frozen=True, slots=True, eq=False)
class Combination:
    """The intersection (sign +1) or union (-1) of solids: of fields, each made by itself, and of other combinations."""

    sign: int
    parts: tuple[Combination | Field, ...]


class _LeafSamples:
    """Samples of the level sets of leaves in a box, each taken once."""

    def __init__(self, lo: Array, hi: Array, tol: float, spacing: float) -> None:
        self.lo, self.hi, self.tol, self.spacing = lo, hi, tol, spacing
        self._known: dict[int, tuple[Field, Array]] = {}

    def of(self, leaf: Field) -> Array:
        """Points (n, 3) of the level set of a leaf."""
        if id(leaf) not in self._known:
            extended = extend_linearly(leaf, self.lo, self.hi)
            self._known[id(leaf)] = leaf, sample_level_set(extended, self.lo, self.hi, self.spacing)
        return self._known[id(leaf)][1]

    def cross(self, field: Field) -> bool:
        """Whether level sets of a tree cross, so that some bound its solid in part only; LevelSetError for too thin walls."""
        leaves = list_leaves(field)
        try:
            check_separation(field, leaves, [self.of(leaf) for leaf in leaves], self.tol)
        except CrossingSurfaces:
            return True
        return False


def split_crossing_operands(field: Field, lo: Array, hi: Array, tol: float, spacing: float) -> Combination | Field:
    """The field as a tree of operands, sampled at a spacing; the field itself if no level sets cross.

    LevelSetError if walls are thinner than 2 tol without crossing, or the field has no surface in the box.
    """
    samples = _LeafSamples(lo, hi, tol, spacing)
    kept = _leave_out(expose_extremes(field), samples)
    if isinstance(kept, bool):
        raise LevelSetError("the field has no surface inside the box: check the level and the domain")
    return _split(kept, samples)


def list_fields(tree: Combination | Field) -> tuple[Field, ...]:
    """The operands of a tree, in order."""
    if isinstance(tree, Combination):
        return tuple(field for part in tree.parts for field in list_fields(part))
    return (tree,)


def _leave_out(field: Field, samples: _LeafSamples) -> Field | bool:
    """The tree without the leaves that have no surface in the box; whether it is solid all over the box, if none has."""
    if isinstance(field, MinMaxField):
        first, second = _leave_out(field.first, samples), _leave_out(field.second, samples)
        neutral = field.sign > 0  # solid all over changes no intersection, void all over no union
        if first is neutral:
            return second
        if second is neutral:
            return first
        if isinstance(first, bool) or isinstance(second, bool):
            return not neutral
        return MinMaxField(first, second, field.sign)
    exact = find_exact(field) is not None
    if not keeps_sign(field, samples.lo, samples.hi) if exact else len(samples.of(field)) > 0:
        return field
    return bool(field(0.5 * (samples.lo + samples.hi)) < 0)


def has_meeting_quadrics(field: Field, lo: Array, hi: Array, tol: float) -> bool:
    """Whether a quadric is known to come as near as `tol` to another leaf where both bound the solid in the box.

    By bounds on slopes, without samples; False if a leaf has none. True if there are struts or cores, whose own faces meet.
    """
    tree = expose_extremes(field)
    found = [find_exact(leaf) for leaf in list_leaves(tree)]
    if any(isinstance(leaf, NetworkLeaf) for leaf in found):
        return True
    exact = [leaf is not None for leaf in found]
    return any(exact) and has_slope_bounds(tree, lo, hi) and find_meeting_leaves(tree, lo, hi, tol, exact) is not None


def _split(field: Field, samples: _LeafSamples) -> Combination | Field:
    if not isinstance(field, MinMaxField):
        return field
    exact = all(map(find_exact, list_leaves(field)))
    if not (exact or has_meeting_quadrics(field, samples.lo, samples.hi, samples.tol) or samples.cross(field)):
        return field
    parts = [_split(operand, samples) for operand in list_operands(field)]
    smooth = [part for part in parts if not isinstance(part, Combination) and find_exact(part) is None]
    others = [part for part in parts if isinstance(part, Combination) or find_exact(part) is not None]
    return Combination(field.sign, (*_group(field.sign, smooth, samples), *others))


def _group(sign: int, fields: Sequence[Field], samples: _LeafSamples) -> list[Field]:
    """Fields joined into as few as possible of which none has level sets that cross."""
    groups: list[list[Field]] = []
    for field in fields:
        for group in groups:
            if not samples.cross(join_extremes(sign, [*group, field])):
                group.append(field)
                break
        else:
            groups.append([field])
    return [join_extremes(sign, group) for group in groups]


def widen_box(lo: Array, hi: Array, number: int) -> tuple[Array, Array]:
    """A box around a box, of another size for every number, so that no two solids in such boxes have a side in common."""
    margin = (FIRST_MARGIN + MARGIN_STEP * number) * float((hi - lo).max())
    return lo - margin * MARGIN_RATIOS, hi + margin * MARGIN_RATIOS[::-1]


FIRST_MARGIN, MARGIN_STEP = 0.011, 0.0037
"""In longest edges of the box: margin of the first widened box, and what every other has more."""

MARGIN_RATIOS = np.array([1.0, 0.93, 1.09])
"""Of the margins along the axes, so that edges and corners of the boxes do not lie on common diagonals."""

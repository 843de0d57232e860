"""Trees of periodic fields searched for in a piece of the box and repeated through it.

Which leaves have to be split shows in two periods along each axis, one at either end of the box; those between are split where
either is.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout import octree
from tpmscad.patches.levelset.layout.octree import Array, Ints, Octree

ENDS = 2
"""Periods that are searched along an axis."""

WHOLE = 1e-9
"""Relative: how far a number of periods may be from the box."""


def piece_of(field: Field, lo: Array, hi: Array) -> tuple[Array, Ints]:
    """The upper corner of the piece that is searched, and the number of periods (3,) of the box along axes where it is less; 0
    along the others."""
    periods = field.periods()
    if periods is None or min(periods) <= 0:
        return hi, np.zeros(3, np.int64)
    count = (hi - lo) / np.array(periods)
    number = np.rint(count).astype(np.int64)
    less = (np.abs(count - number) <= WHOLE * count) & (number > ENDS)
    return np.where(less, lo + ENDS * (hi - lo) / np.maximum(number, 1), hi), np.where(less, number, 0)


def repeated_tree(tree: Octree, hi: Array, periods: Ints) -> Octree:
    """The tree of a piece repeated through the box up to `hi`, with so many `periods` along axes where they are not 0.

    The tree's largest leaves must be a whole number to a period; 2:1 balance may split a few leaves more.
    """
    size = tree.size[tree.leaf]
    sources = []
    for n, count in zip(size.shape, periods.tolist(), strict=True):
        one = np.arange(n // ENDS if count else n)
        if count:
            first, last = [one] * (count - 1), [one + len(one)] * (count - 1)
            sources.append((np.concatenate([*first, one + len(one)]), np.concatenate([one, *last])))
        else:
            sources.append((one, one))
    wanted = np.minimum.reduce([size[np.ix_(*choice)] for choice in product(*sources)])
    largest = int(tree.size.max())
    whole = octree.uniform(tree.lo, hi, np.array(wanted.shape) // largest)
    fine = [np.arange(n) for n in wanted.shape]
    while True:
        ratio = wanted.shape[0] // whole.leaf.shape[0]
        of = whole.leaf[np.ix_(*(i // ratio for i in fine))]
        least = np.full(len(whole.size), largest)
        np.minimum.at(least, of.ravel(), wanted.ravel())
        chosen = whole.size * ratio > least
        if not chosen.any():
            return whole
        whole = octree.split(whole, chosen)

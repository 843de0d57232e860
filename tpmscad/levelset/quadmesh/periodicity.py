"""What repeats in the layout of a periodic field: curves and patches that are translates of others by whole periods.

Leaves are a whole number to a period, so layouts repeat where nothing else is near: the box, or leaves split for its sake.
Vertices whose surroundings are translates of each other, RINGS polygons deep, are put in the same place of their periods; then
one curve or patch of all those that are translates is fitted and measured, and the others are it, moved.

Trees of periodic fields searched for in a piece of the box and repeated through it.

Which leaves have to be split shows in two periods along each axis, one at either end of the box; those between are split where
either is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork

MATCHED_RINGS = 3
"""Polygons to each side of a vertex that must be translates of others': so far from the box, sweeps of the relaxation leave
translates a hundredth of a leaf apart."""

TICKS_PER_PERIOD = 1 << 26
"""Places along a period that are told apart: round-off stays far below one, and nothing is laid out that finely."""

TICK_OFFSET = 0.37
"""Ticks begin beside all fractions of a period that leaves end on."""

WHOLE_LEAVES_RTOL = 1e-9
"""Relative: how far a number of leaves may be from a period."""


@dataclass(frozen=True, slots=True, eq=False)
class TranslatedCopies:
    """Curve i is curve `curve[i]` moved by `curve_shift[i]`, (C,) and (C, 3), patches likewise; those that are no copies are
    their own, not moved."""

    curve: IntArray
    curve_shift: Array
    patch: IntArray
    patch_shift: Array

    @property
    def original_curves(self) -> BoolArray:
        """Curves (C,) that are no copies."""
        return np.asarray(self.curve == np.arange(len(self.curve)))

    @property
    def original_patches(self) -> BoolArray:
        """Patches (Q,) that are no copies."""
        return np.asarray(self.patch == np.arange(len(self.patch)))

    def curves_with_copies(self, chosen: BoolArray) -> BoolArray:
        """The chosen curves (C,) and all that are copies of the same."""
        return np.asarray(np.bincount(self.curve, chosen, len(self.curve))[self.curve] > 0)

    def patches_with_copies(self, chosen: BoolArray) -> BoolArray:
        """The chosen patches (Q,) and all that are copies of the same."""
        return np.asarray(np.bincount(self.patch, chosen, len(self.patch))[self.patch] > 0)


def no_copies(curves: int, patches: int) -> TranslatedCopies:
    """Of a net in which nothing repeats."""
    return TranslatedCopies(np.arange(curves), np.zeros((curves, 3)), np.arange(patches), np.zeros((patches, 3)))


def snap_translated_vertices(mesh: QuadMesh, field: Field, tree: Octree) -> QuadMesh:
    """The mesh with the vertices of translated surroundings in the same place of their periods, the innermost one's."""
    period = _find_whole_periods(field, tree)
    if not period.any():
        return mesh
    place, cell = _quantise_positions(mesh.start, tree.lo, period)
    upper = mesh.fixed & (mesh.start > 0.5 * (tree.lo + tree.hi))
    name = _hash_rows(
        np.column_stack([place, mesh.fixed, upper, np.rint(mesh.size / tree.step.min())]).astype(np.uint64)
    )
    valid = mesh.corners >= 0
    for _ in range(MATCHED_RINGS):
        around = np.where(valid, name[mesh.corners], np.uint64(0)).sum(axis=1, dtype=np.uint64)
        total = np.zeros(len(name), np.uint64)
        for k in range(4):
            np.add.at(total, mesh.corners[valid[:, k], k], _splitmix64(around[valid[:, k]]))
        name = _splitmix64(name + _splitmix64(total))
    outside = np.abs(mesh.start - 0.5 * (tree.lo + tree.hi)).max(axis=1)
    first = _first_occurrences(name, np.lexsort([outside, name]))
    shift = (cell - cell[first]) * period
    return replace(mesh, vertices=np.where(first[:, None] == np.arange(len(first))[:, None], mesh.vertices,
                                           mesh.vertices[first] + shift))  # fmt: skip


def find_translated_copies(
    net: PatchNetwork, field: Field, tree: Octree, known: tuple[BoolArray, BoolArray] | None = None
) -> tuple[PatchNetwork, TranslatedCopies]:
    """The net with vertices that are translates of each other exactly so, and its copies.

    `known`: curves (C,) and patches (Q,) that are fitted already, of which copies are made rather than of others.
    """
    period = _find_whole_periods(field, tree)
    if not period.any():
        return net, no_copies(len(net.ends), len(net.curve))
    known = known or (np.zeros(len(net.ends), bool), np.zeros(len(net.curve), bool))
    place, cell = _quantise_positions(net.vertices, tree.lo, period)
    vertex = _first_equal_rows(place)
    moved = cell - cell[vertex]
    net = replace(net, vertices=np.where((moved != 0).any(axis=1)[:, None], net.vertices[vertex] + moved * period,
                                         net.vertices))  # fmt: skip

    main = slice(None, net.n_sides)
    a, b = net.ends[main].T
    curve = np.arange(len(net.ends))
    at = np.zeros((len(net.ends), 3), np.int64)
    at[main] = moved[a]
    rows = np.column_stack([vertex[a], vertex[b], moved[b] - moved[a], net.plane[main]])
    curve[main] = _first_equal_rows(rows, known[0][main])
    if len(net.middle_of):
        end = net.ends[net.n_sides :, 1]
        at[net.n_sides :] = at[net.middle_of]
        rows = np.column_stack([curve[net.middle_of], vertex[end], moved[end] - at[net.middle_of]])
        curve[net.n_sides :] = net.n_sides + _first_equal_rows(rows, known[0][net.n_sides :])

    beside = (at[net.curve[:, 1:]] - at[net.curve[:, :1]]).reshape(-1, 9)
    patch = _first_equal_rows(np.column_stack([curve[net.curve], beside, net.sense, net.piece]), known[1])
    first = at[net.curve[:, 0]]
    return net, TranslatedCopies(curve, (at - at[curve]) * period, patch, (first - first[patch]) * period)


def _find_whole_periods(field: Field, tree: Octree) -> Array:
    """The field's periods where they are whole numbers of the tree's leaves and less than the box, 0 along other axes: (3,)."""
    periods = field.periods()
    if periods is None:
        return np.zeros(3)
    p = np.array(periods, float)
    first = tree.step * tree.size.max()
    cells = np.maximum(1.0, np.rint(p / first))
    return np.where((np.abs(cells * first - p) <= WHOLE_LEAVES_RTOL * p) & (p < tree.hi - tree.lo), p, 0.0)


def _quantise_positions(points: Array, lo: Array, period: Array) -> tuple[IntArray, IntArray]:
    """Ticks within the period and the period's number, (n, 3) each; no axis without a period is split."""
    size = np.where(period > 0, period, 1.0)
    ticks = np.floor((points - lo) / size * TICKS_PER_PERIOD + TICK_OFFSET).astype(np.int64)
    cell = np.where(period > 0, ticks // TICKS_PER_PERIOD, 0)
    return ticks - cell * TICKS_PER_PERIOD, cell


def _first_equal_rows(rows: IntArray, preferred: BoolArray | None = None) -> IntArray:
    """For each row the number of the first equal one, of the preferred ones if there are any: (n,)."""
    name = _hash_rows(rows.astype(np.uint64))
    last = np.zeros(len(rows), bool) if preferred is None else ~preferred
    first = _first_occurrences(name, np.lexsort([last, name]))
    same = (rows[first] == rows).all(axis=1)  # names may collide, if rarely
    return np.where(same, first, np.arange(len(rows)))


def _first_occurrences(name: NDArray[np.uint64], order: IntArray) -> IntArray:
    """For each item the first in `order`, which sorts by name, of the same name."""
    begins = np.concatenate([[True], name[order][1:] != name[order][:-1]]) if len(order) else np.zeros(0, bool)
    first = np.empty(len(order), np.int64)
    first[order] = order[begins][np.cumsum(begins) - 1]
    return first


def _hash_rows(rows: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """A number for each row (n, k), equal rows' equal."""
    name = np.zeros(len(rows), np.uint64)
    for column in rows.T:
        name = _splitmix64(name + column)
    return name


def _splitmix64(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Bits spread over all places (the finalizer of splitmix64)."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))


SEARCHED_PERIODS = 2
"""Periods that are searched along an axis."""

WHOLE_PERIODS_RTOL = 1e-9
"""Relative: how far a number of periods may be from the box."""


def crop_to_searched_periods(field: Field, lo: Array, hi: Array) -> tuple[Array, IntArray]:
    """The upper corner of the piece that is searched, and the number of periods (3,) of the box along axes where it is less; 0
    along the others."""
    periods = field.periods()
    if periods is None or min(periods) <= 0:
        return hi, np.zeros(3, np.int64)
    count = (hi - lo) / np.array(periods)
    number = np.rint(count).astype(np.int64)
    less = (np.abs(count - number) <= WHOLE_PERIODS_RTOL * count) & (number > SEARCHED_PERIODS)
    return np.where(less, lo + SEARCHED_PERIODS * (hi - lo) / np.maximum(number, 1), hi), np.where(less, number, 0)


def tile_octree(tree: Octree, hi: Array, periods: IntArray) -> Octree:
    """The tree of a piece repeated through the box up to `hi`, with so many `periods` along axes where they are not 0.

    The tree's largest leaves must be a whole number to a period; 2:1 balance may split a few leaves more.
    """
    size = tree.size[tree.leaf]
    sources = []
    for n, count in zip(size.shape, periods.tolist(), strict=True):
        one = np.arange(n // SEARCHED_PERIODS if count else n)
        if count:
            first, last = [one] * (count - 1), [one + len(one)] * (count - 1)
            sources.append((np.concatenate([*first, one + len(one)]), np.concatenate([one, *last])))
        else:
            sources.append((one, one))
    wanted = np.minimum.reduce([size[np.ix_(*choice)] for choice in product(*sources)])
    largest = int(tree.size.max())
    whole = octree.uniform_octree(tree.lo, hi, np.array(wanted.shape) // largest)
    fine = [np.arange(n) for n in wanted.shape]
    while True:
        ratio = wanted.shape[0] // whole.leaf.shape[0]
        of = whole.leaf[np.ix_(*(i // ratio for i in fine))]
        least = np.full(len(whole.size), largest)
        np.minimum.at(least, of.ravel(), wanted.ravel())
        chosen = whole.size * ratio > least
        if not chosen.any():
            return whole
        whole = octree.split_leaves(whole, chosen)

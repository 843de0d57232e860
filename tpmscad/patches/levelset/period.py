"""What repeats in the layout of a periodic field: curves and patches that are translates of others by whole periods.

Leaves are a whole number to a period, so layouts repeat where nothing else is near: the box, or leaves split for its sake.
Vertices whose surroundings are translates of each other, RINGS polygons deep, are put in the same place of their periods; then
one curve or patch of all those that are translates is fitted and measured, and the others are it, moved.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.dual import Mesh
from tpmscad.patches.levelset.layout.net import Net
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask, Octree

RINGS = 3
"""Polygons to each side of a vertex that must be translates of others': so far from the box, sweeps of the relaxation leave
translates a hundredth of a leaf apart."""

TICKS = 1 << 26
"""Places along a period that are told apart: round-off stays far below one, and nothing is laid out that finely."""

OFF = 0.37
"""Ticks begin beside all fractions of a period that leaves end on."""

WHOLE = 1e-9
"""Relative: how far a number of leaves may be from a period."""


@dataclass(frozen=True, slots=True, eq=False)
class Copies:
    """Curve i is curve `curve[i]` moved by `curve_shift[i]`, (C,) and (C, 3), patches likewise; those that are no copies are
    their own, not moved."""

    curve: Ints
    curve_shift: Array
    patch: Ints
    patch_shift: Array

    @property
    def own_curves(self) -> Mask:
        """Curves (C,) that are no copies."""
        return np.asarray(self.curve == np.arange(len(self.curve)))

    @property
    def own_patches(self) -> Mask:
        """Patches (Q,) that are no copies."""
        return np.asarray(self.patch == np.arange(len(self.patch)))

    def any_curve(self, chosen: Mask) -> Mask:
        """The chosen curves (C,) and all that are copies of the same."""
        return np.asarray(np.bincount(self.curve, chosen, len(self.curve))[self.curve] > 0)

    def any_patch(self, chosen: Mask) -> Mask:
        """The chosen patches (Q,) and all that are copies of the same."""
        return np.asarray(np.bincount(self.patch, chosen, len(self.patch))[self.patch] > 0)


def no_copies(curves: int, patches: int) -> Copies:
    """Of a net in which nothing repeats."""
    return Copies(np.arange(curves), np.zeros((curves, 3)), np.arange(patches), np.zeros((patches, 3)))


def tied(mesh: Mesh, field: Field, tree: Octree) -> Mesh:
    """The mesh with the vertices of translated surroundings in the same place of their periods, the innermost one's."""
    period = _periods(field, tree)
    if not period.any():
        return mesh
    place, cell = _places(mesh.start, tree.lo, period)
    upper = mesh.fixed & (mesh.start > 0.5 * (tree.lo + tree.hi))
    name = _mixed(np.column_stack([place, mesh.fixed, upper, np.rint(mesh.size / tree.step.min())]).astype(np.uint64))
    valid = mesh.corners >= 0
    for _ in range(RINGS):
        around = np.where(valid, name[mesh.corners], np.uint64(0)).sum(axis=1, dtype=np.uint64)
        total = np.zeros(len(name), np.uint64)
        for k in range(4):
            np.add.at(total, mesh.corners[valid[:, k], k], _stirred(around[valid[:, k]]))
        name = _stirred(name + _stirred(total))
    outside = np.abs(mesh.start - 0.5 * (tree.lo + tree.hi)).max(axis=1)
    first = _firsts(name, np.lexsort([outside, name]))
    shift = (cell - cell[first]) * period
    return replace(mesh, vertices=np.where(first[:, None] == np.arange(len(first))[:, None], mesh.vertices,
                                           mesh.vertices[first] + shift))  # fmt: skip


def repeated(net: Net, field: Field, tree: Octree, known: tuple[Mask, Mask] | None = None) -> tuple[Net, Copies]:
    """The net with vertices that are translates of each other exactly so, and its copies.

    `known`: curves (C,) and patches (Q,) that are fitted already, of which copies are made rather than of others.
    """
    period = _periods(field, tree)
    if not period.any():
        return net, no_copies(len(net.ends), len(net.curve))
    known = known or (np.zeros(len(net.ends), bool), np.zeros(len(net.curve), bool))
    place, cell = _places(net.vertices, tree.lo, period)
    vertex = _firsts_of_rows(place)
    moved = cell - cell[vertex]
    net = replace(net, vertices=np.where((moved != 0).any(axis=1)[:, None], net.vertices[vertex] + moved * period,
                                         net.vertices))  # fmt: skip

    main = slice(None, net.n_sides)
    a, b = net.ends[main].T
    curve = np.arange(len(net.ends))
    at = np.zeros((len(net.ends), 3), np.int64)
    at[main] = moved[a]
    rows = np.column_stack([vertex[a], vertex[b], moved[b] - moved[a], net.plane[main]])
    curve[main] = _firsts_of_rows(rows, known[0][main])
    if len(net.middle_of):
        end = net.ends[net.n_sides :, 1]
        at[net.n_sides :] = at[net.middle_of]
        rows = np.column_stack([curve[net.middle_of], vertex[end], moved[end] - at[net.middle_of]])
        curve[net.n_sides :] = net.n_sides + _firsts_of_rows(rows, known[0][net.n_sides :])

    beside = (at[net.curve[:, 1:]] - at[net.curve[:, :1]]).reshape(-1, 9)
    patch = _firsts_of_rows(np.column_stack([curve[net.curve], beside, net.sense, net.piece]), known[1])
    first = at[net.curve[:, 0]]
    return net, Copies(curve, (at - at[curve]) * period, patch, (first - first[patch]) * period)


def _periods(field: Field, tree: Octree) -> Array:
    """The field's periods where they are whole numbers of the tree's leaves and less than the box, 0 along other axes: (3,)."""
    periods = field.periods()
    if periods is None:
        return np.zeros(3)
    p = np.array(periods, float)
    first = tree.step * tree.size.max()
    cells = np.maximum(1.0, np.rint(p / first))
    return np.where((np.abs(cells * first - p) <= WHOLE * p) & (p < tree.hi - tree.lo), p, 0.0)


def _places(points: Array, lo: Array, period: Array) -> tuple[Ints, Ints]:
    """Ticks within the period and the period's number, (n, 3) each; no axis without a period is split."""
    size = np.where(period > 0, period, 1.0)
    ticks = np.floor((points - lo) / size * TICKS + OFF).astype(np.int64)
    cell = np.where(period > 0, ticks // TICKS, 0)
    return ticks - cell * TICKS, cell


def _firsts_of_rows(rows: Ints, preferred: Mask | None = None) -> Ints:
    """For each row the number of the first equal one, of the preferred ones if there are any: (n,)."""
    name = _mixed(rows.astype(np.uint64))
    last = np.zeros(len(rows), bool) if preferred is None else ~preferred
    first = _firsts(name, np.lexsort([last, name]))
    same = (rows[first] == rows).all(axis=1)  # names may collide, if rarely
    return np.where(same, first, np.arange(len(rows)))


def _firsts(name: NDArray[np.uint64], order: Ints) -> Ints:
    """For each item the first in `order`, which sorts by name, of the same name."""
    begins = np.concatenate([[True], name[order][1:] != name[order][:-1]]) if len(order) else np.zeros(0, bool)
    first = np.empty(len(order), np.int64)
    first[order] = order[begins][np.cumsum(begins) - 1]
    return first


def _mixed(rows: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """A number for each row (n, k), equal rows' equal."""
    name = np.zeros(len(rows), np.uint64)
    for column in rows.T:
        name = _stirred(name + column)
    return name


def _stirred(x: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Bits spread over all places (the finalizer of splitmix64)."""
    x = x + np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return x ^ (x >> np.uint64(31))

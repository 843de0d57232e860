"""The distinct surfaces of a tree of minima and maxima: evaluation in batches, and where two of them make an edge.

Leaves that vanish on the same plane, sphere or cylinder, or are the same field up to a factor, share a surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.analysis.exact_leaves import find_quadric
from tpmscad.fields.analysis.outermost_extremes import combine_solids, expose_extremes, list_leaves
from tpmscad.fields.field import Field, ScaledField
from tpmscad.fields.tape.tape_enclosures import JetEnclosures, TapeEnclosures

MAX_PAIRS = 1 << 14
"""Pairs of surfaces that are looked at together: the signs of a hundred surfaces for each are some megabytes."""

EQUAL_DIGITS = 10
"""Decimals to which the coordinates of two planes, spheres or cylinders agree that are the same."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelSurfaces:
    """A tree, the surface of each of its leaves and the sign of the leaf there, the first leaf of each surface, enclosures."""

    tree: Field
    surface_of: IntArray
    sign_of: IntArray
    leaf_of: IntArray
    fields: tuple[Field, ...]
    enclosures: tuple[TapeEnclosures, ...]

    @property
    def are_enclosed(self) -> bool:
        """Whether all surfaces are on tapes: foreign functions have no bounds."""
        return not any(each.tape.calls_foreign_functions for each in self.fields)

    def evaluate(self, which: IntArray, points: Array) -> tuple[Array, Array]:
        """Values (n,) and gradients (n, 3) of surfaces, one at each of the points (n, 3)."""
        values, gradients = np.empty(len(points)), np.empty((len(points), 3))
        for k in np.unique(which):
            own = which == k
            values[own], gradients[own] = self.fields[k].value_and_gradient(points[own])
        return values, gradients

    def enclose(self, which: IntArray, lo: Array, hi: Array) -> tuple[Array, Array, BoolArray]:
        """Lower and upper bounds (n, 4) of value and gradient of surfaces over boxes (n, 3), and whether no value jumps there."""
        low, high, smooth = np.empty((len(lo), 4)), np.empty((len(lo), 4)), np.zeros(len(lo), bool)
        for k in np.unique(which):
            own = which == k
            found = self.enclosures[k].enclose(lo[own], hi[own], True)
            forms = (found.value, *found.gradient)
            low[own], high[own] = (np.stack(side, axis=1) for side in ([f.low for f in forms], [f.high for f in forms]))
            smooth[own] = ~found.may_jump
        return low, high, smooth

    def enclose_value(self, surface: int, lo: Array, hi: Array) -> JetEnclosures:
        """The enclosure of one surface's values."""
        return self.enclosures[surface].enclose(lo, hi, False)

    def bound_quadrants(self, pairs: IntArray, sides: IntArray) -> tuple[BoolArray, BoolArray]:
        """Whether the tree is surely, and perhaps, solid in the four quadrants about two surfaces: (2, 2, n) each.

        `sides` (n, k) are the signs of all surfaces, 0 if unknown; the first quadrant is on the negative side of both.
        """
        n = len(pairs)
        sure, perhaps = np.empty((2, 2, n), bool), np.empty((2, 2, n), bool)
        rows = np.arange(n)
        for a in (0, 1):
            for b in (0, 1):
                own = sides.copy()
                own[rows, pairs[:, 0]], own[rows, pairs[:, 1]] = 2 * a - 1, 2 * b - 1
                of_leaf = own[:, self.surface_of] * self.sign_of
                sure[a, b] = combine_solids(self.tree, list((of_leaf < 0).T))
                perhaps[a, b] = combine_solids(self.tree, list((of_leaf <= 0).T))
        return sure, perhaps

    def may_be_edge(self, pairs: IntArray, sides: IntArray) -> tuple[BoolArray, BoolArray]:
        """Whether an edge may lie where two surfaces meet (n,), and whether it surely does.

        It does unless one of the two is passed without a change of solid and void.
        """
        if len(pairs) > MAX_PAIRS:
            parts = [
                self.may_be_edge(pairs[i : i + MAX_PAIRS], sides[i : i + MAX_PAIRS])
                for i in range(0, len(pairs), MAX_PAIRS)
            ]
            return np.concatenate([part[0] for part in parts]), np.concatenate([part[1] for part in parts])
        sure, perhaps = self.bound_quadrants(pairs, sides)
        known = sure == perhaps
        same_across_second = known.all(axis=(0, 1)) & (sure[:, 0] == sure[:, 1]).all(axis=0)
        same_across_first = known.all(axis=(0, 1)) & (sure[0] == sure[1]).all(axis=0)
        # a tree is monotone: nothing changes where all of it is solid, or void
        possible = perhaps.any(axis=(0, 1)) & ~sure.all(axis=(0, 1)) & ~same_across_first & ~same_across_second
        return possible, possible & known.all(axis=(0, 1))


def find_level_surfaces(field: Field) -> LevelSurfaces:
    """The surfaces of a field's leaves, its extremes exposed."""
    tree = expose_extremes(field)
    known: dict[object, tuple[int, int]] = {}
    surfaces: list[int] = []
    signs: list[int] = []
    first: list[int] = []
    fields: list[Field] = []
    for leaf in list_leaves(tree):
        key, sign = _identify(leaf)
        if key not in known:
            known[key] = len(fields), sign
            first.append(len(surfaces))
            fields.append(leaf)
        number, own = known[key]
        surfaces.append(number)
        signs.append(sign * own)
    enclosures = tuple(TapeEnclosures(leaf.tape) for leaf in fields)
    return LevelSurfaces(tree, np.array(surfaces), np.array(signs), np.array(first), tuple(fields), enclosures)


def _identify(leaf: Field) -> tuple[object, int]:
    """What two leaves of one surface have in common, and the sign of this one."""
    quadric = find_quadric(leaf)
    if quadric is not None:
        axis, point = quadric.axis, quadric.point
        large = axis[np.abs(axis) > 0.5 * np.abs(axis).max(initial=0.0)]
        turn = -1.0 if len(large) and large[0] < 0 else 1.0
        if quadric.kind == "plane":
            point = axis * (axis @ point)
        elif quadric.kind == "cylinder":
            point = point - axis * (axis @ point)
        numbers = np.round([*turn * axis, *point, quadric.radius], EQUAL_DIGITS) + 0.0
        return (quadric.kind, *numbers.tolist()), quadric.sign * (int(turn) if quadric.kind == "plane" else 1)
    sign = 1
    while isinstance(leaf, ScaledField) and leaf.factor != 0:
        sign = sign if leaf.factor > 0 else -sign
        leaf = leaf.field
    try:
        hash(leaf)
    except TypeError:
        return id(leaf), sign
    return leaf, sign

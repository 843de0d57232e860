"""Struts that are translates of each other, with all that bounds them: one of each class is worked out.

The ends of a strut follow from the vectors along the struts at its nodes and from the sides of the box that these lie in: the
*star* of a node. Where its borders are split follows from the struts around it in the same way, one step farther. In a periodic
graph there are as many classes as near the sides of its box, however many cells it has.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import product

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.conics import TWO_PI
from tpmscad.lattices.strut_ends import SAME_ANGLE, Star
from tpmscad.lattices.strut_facets import (
    SAME_POINT,
    Facet,
    StrutEnd,
    bound_ball,
    bound_cone,
    choose_cuts,
    find_border_arm,
    find_neighbour,
    make_strut_ends,
)

ON_SIDE = 1e-9
"""In sizes of the box: distance of a node from a side of the box up to which it lies in it."""

SAME_VECTOR = 1e-9
"""In the least radii: difference of vectors along struts, and of radii, that are equal; far below what makes vertices one."""

SIDE_NORMALS = np.concatenate([-np.eye(3), np.eye(3)])

Pair = tuple[StrutEnd, StrutEnd]

Ends = list[tuple[int, StrutEnd, tuple[float, ...]]]
"""The ends of struts at a node: their ways, and the angles at which the struts are cut."""


@dataclass(frozen=True, slots=True, eq=False)
class EndClasses:
    """Classes of struts (m,) with equal ends: `label` (m,), `first` (c,) strut and both ends of each class.

    way (m, 2): the vector along each strut and its radii, from its start and from its end, by number; equal if these are.
    sides (n, 6): the sides of the box that each node lies in, by `SIDE_NORMALS`.
    """

    label: IntArray
    first: IntArray
    pairs: list[Pair]
    way: IntArray
    sides: BoolArray


def find_sides(points: Array, box: tuple[Array, Array] | None) -> BoolArray:
    """The sides of the box that points lie in, by `SIDE_NORMALS`: (n, 6)."""
    if box is None:
        return np.zeros((len(points), 6), bool)
    lo, hi = box
    tol = ON_SIDE * float((hi - lo).max())
    return np.asarray(np.abs(np.concatenate([points - lo, points - hi], axis=1)) <= tol)


def group_ends(
    points: Array, struts: IntArray, radii: Array, balls: Array, box: tuple[Array, Array] | None
) -> EndClasses:
    """The classes of struts (m, 2) between points (n, 3), by their vectors, radii (n,) and the stars of both nodes."""
    along = points[struts[:, 1]] - points[struts[:, 0]]
    unit = SAME_VECTOR * float(radii.min())
    first, last = radii[struts.T]
    ways = np.concatenate([np.column_stack([along, first, last]), np.column_stack([-along, last, first])])
    _, way = _label_rows(np.rint(ways / unit).astype(np.int64))
    way = way.reshape(2, -1).T
    sides = find_sides(points, box)
    star = _label_nodes(struts, way, np.column_stack([sides, np.rint(balls / unit)]).astype(np.int64))
    chosen, label = _label_rows(np.column_stack([way[:, 0], star[struts]]))
    order = np.argsort(struts.ravel(), kind="stable")
    begin = np.searchsorted(struts.ravel()[order], np.arange(len(points) + 1))
    lengths = np.linalg.norm(along, axis=1)
    units, sines = along / lengths[:, None], (last - first) / lengths
    pairs = []
    for s in chosen.tolist():
        stars = []
        for side, node in enumerate(struts[s].tolist()):
            own, end = divmod(order[begin[node] : begin[node + 1]], 2)
            own, end = own[own != s], end[own != s]
            sense = np.where(end == 0, 1.0, -1.0)
            stars.append(
                Star(
                    sense[:, None] * units[own],
                    sense * sines[own],
                    tuple(way[own, end].tolist()),
                    SIDE_NORMALS[sides[node]],
                    float(sines[s]) if side == 0 else -float(sines[s]),
                    float(radii[node]),
                    float(balls[node]),
                )
            )
        pairs.append(make_strut_ends(along[s], (stars[0], stars[1])))
    return EndClasses(label, chosen, pairs, way, sides)


def group_facets(
    points: Array, struts: IntArray, radii: Array, balls: Array, box: tuple[Array, Array] | None
) -> tuple[IntArray, list[list[Facet]]]:
    """The class of each strut (m,), and the faces of each class, of a strut whose start is the origin."""
    ends = group_ends(points, struts, radii, balls, box)
    cuts = [choose_cuts(pair) for pair in ends.pairs]
    around = _label_nodes(struts, 2 * ends.label[:, None] + np.arange(2), ends.sides)
    across = _find_opposites(points, ends.sides, box)
    first, node_label = _label_rows(np.column_stack([around, np.where(across < 0, -1, around[across])]))
    at: dict[int, Ends] = {node: [] for node in {*first.tolist(), *across[first][across[first] >= 0].tolist()}}
    for s, pair in enumerate(struts.tolist()):
        for e, node in enumerate(pair):
            if node in at:
                at[node].append((int(ends.way[s, e]), ends.pairs[ends.label[s]][e], cuts[ends.label[s]]))
    tol = SAME_POINT * float(radii.min())
    splits = [
        _find_splits(at[node], [(axis, at[far]) for axis, far in enumerate(across[node].tolist()) if far >= 0], tol)
        for node in first.tolist()
    ]
    chosen, strut_label = _label_rows(np.column_stack([ends.label, node_label[struts]]))
    number: dict[tuple[int, ...], int] = {}
    classes: list[list[Facet]] = []
    of_label = []
    for s in chosen.tolist():
        label = int(ends.label[s])
        angles = [splits[node_label[struts[s, e]]][int(ends.way[s, e])] for e in range(2)]
        ticks = [tuple(sorted({round(a % TWO_PI / SAME_ANGLE) for a in each})) for each in angles]
        key = label, *ticks[0], -1, *ticks[1]
        if key not in number:
            number[key] = len(classes)
            pair = tuple(replace(end, splits=tuple(own)) for end, own in zip(ends.pairs[label], angles, strict=True))
            facets = list(bound_cone((pair[0], pair[1]), cuts[label]))
            classes.append([*facets, *(f for end in pair for f in bound_ball(end, cuts[label]))])
        of_label.append(number[key])
    return np.array(of_label)[strut_label], classes


def _label_rows(rows: IntArray) -> tuple[IntArray, IntArray]:
    """Of equal rows (n, k) the first one, and the number of each row's kind: (c,), (n,)."""
    _, first, label = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    return first, label.ravel()


def _label_nodes(struts: IntArray, codes: IntArray, extra: BoolArray | IntArray) -> IntArray:
    """Labels (n,) of nodes: equal where the codes (m, 2) of the ends at them, in any order, and the rows `extra` (n, k) are."""
    node, code = struts.ravel(), codes.ravel()
    order = np.lexsort((code, node))
    count = np.bincount(node, minlength=len(extra))
    table = np.full((len(extra), int(count.max())), -1)
    table[node[order], np.arange(len(node)) - np.repeat(np.cumsum(count) - count, count)] = code[order]
    return _label_rows(np.column_stack([table, extra]))[1]


def _find_opposites(points: Array, sides: BoolArray, box: tuple[Array, Array] | None) -> IntArray:
    """Along each axis, the node opposite to each node that lies in a side of the box, -1 if there is none: (n, 3)."""
    across = np.full((len(points), 3), -1)
    if box is None:
        return across
    size = box[1] - box[0]
    tree = cKDTree(points)
    for axis, sign in product(range(3), (-1, +1)):
        own = np.flatnonzero(sides[:, axis if sign < 0 else axis + 3])
        distance, found = tree.query(points[own] - sign * size[axis] * np.eye(3)[axis])
        across[own, axis] = np.where(distance <= ON_SIDE * size.max(), found, -1)
    return across


def _find_splits(own: Ends, opposite: list[tuple[int, Ends]], tol: float) -> dict[int, list[float]]:
    """The angles at which the borders of the struts at a node are split, by their ways.

    That is where a neighbour is cut; and in a side of the box where equal borders in the opposite side are, so that both have the
    same vertices.
    """
    splits: dict[int, list[float]] = {way: [] for way, _, _ in own}
    end_of = {way: end for way, end, _ in own}
    for _, end, cut in own:
        for angle, on_ball in product(cut, (False, True)):
            arm = find_border_arm(end, angle, on_ball=on_ball)
            other = find_neighbour(end, angle, on_ball=on_ball)
            if arm is not None and other is not None:
                splits[other].append(end_of[other].angle_of(arm))
    for axis, far in opposite:
        for (_, end, cut), on_ball in product(far, (False, True)):
            for angle in cut:
                arm = find_border_arm(end, angle, on_ball=on_ball)
                if arm is None or abs(arm[axis]) > tol:
                    continue
                for way, near, _ in own:
                    at = near.angle_of(arm)
                    found = find_border_arm(near, at, on_ball=on_ball)
                    if found is not None and np.linalg.norm(found - arm) <= tol:
                        splits[way].append(at)
    return splits

"""The shells of a closed triangle mesh, and the boundary of the solid that they bound together.

Solid is where the winding number of the mesh is positive. A piece of a triangle bounds the solid if it is so on one of its sides
only; others lie within the solid, or in the void, and no distance may be measured from them. Shells that lie there as a whole are
left out. Of shells that cross each other the library Manifold makes the boundary, from the sets L(k) in which the winding number
exceeds k: a shell S adds L(k) | (L(k - 1) & S), and one that is reversed leaves (L(k) - S) | L(k + 1). What is left is measured
again, and refused if triangles still lie off the boundary, as those of a shell that overlaps itself.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from tpmscad._lazy_import import import_extra
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.fields.data.triangle_distance import build_triangle_tree, sample_triangles

MAX_CENTRES, SAMPLES = 50_000, 20_000
"""Triangles, evenly chosen, on whose sides the winding number is counted, and further points by area: a place that is missed is
smaller than a hundredth of the mesh."""

SIDE_FRACTION = 1e-7
"""Of the largest extent: distance from a triangle of the points on its sides; files in single precision round to 6e-8 of it."""

MAX_FOLD_FRACTION = 1 / 128
"""Of the largest extent: depth of triangles below the boundary of the solid that is told and not refused. It is half of the
spacing at which the distance is sampled at first, so that the field does not show it."""

MIN_FOLD_FRACTION = 1e-5
"""Of the largest extent: depth below which triangles are taken to lie on the boundary."""

SAME_ANGLE = 1e-7
"""Radians by which triangles in one plane may differ."""

SHOWN_SHELLS = 3
"""Shells that a message names."""


def list_half_edges(triangles: IntArray) -> IntArray:
    """Start and end (3 m, 2) of the sides of triangles (m, 3), side by side."""
    return np.concatenate([triangles[:, [0, 1]], triangles[:, [1, 2]], triangles[:, [2, 0]]])


def label_edges(half: IntArray) -> tuple[IntArray, IntArray]:
    """The number of the edge (n,) of each half-edge (n, 2), from 0, and its direction, 1 or -1."""
    low, high = half.min(axis=1), half.max(axis=1)
    edge = np.unique(low * (int(high.max(initial=0)) + 1) + high, return_inverse=True)[1]
    return edge, np.where(half[:, 0] < half[:, 1], 1, -1)


def list_open_edges(triangles: IntArray) -> IntArray:
    """Half-edges (n, 2) that no half-edge in the opposite direction cancels."""
    half = list_half_edges(np.asarray(triangles, np.int64))
    edge, direction = label_edges(half)
    return half[np.bincount(edge, direction)[edge] * direction > 0]


def label_shells(vertices: Array, triangles: IntArray) -> IntArray:
    """The shell (m,) of each triangle of a closed mesh: what is joined over edges.

    Of more than two triangles at an edge, two are joined that have solid between them, so that solids which touch stay apart.
    """
    half, owner = list_half_edges(triangles), np.tile(np.arange(len(triangles)), 3)
    edge, direction = label_edges(half)
    order = np.argsort(edge, kind="stable")
    count = np.bincount(edge)[edge[order]]
    two, several = order[count == 2], order[count > 2]
    one, other = two.reshape(-1, 2).T
    if len(several):
        ends, opposite = np.sort(half[several], axis=1), np.roll(triangles, -2, axis=1).T.ravel()[several]
        angle = _measure_angles(vertices[ends[:, 0]], vertices[ends[:, 1]], vertices[opposite], edge[several])
        turn = np.lexsort((-direction[several], angle, edge[several]))
        pairs = _pair_sides(edge[several][turn], direction[several][turn])
        one, other = np.concatenate([np.stack([one, other]), several[turn][pairs].T], axis=1)
    links = coo_array((np.ones(len(one), np.int8), (owner[one], owner[other])), shape=(len(triangles),) * 2)
    return np.asarray(connected_components(links, directed=False)[1])


def _measure_angles(start: Array, end: Array, opposite: Array, edge: IntArray) -> Array:
    """Angles (n,) of triangles about the edge that each has, from the first of those at the same edge, which are neighbours."""
    axis = end - start
    axis = axis / np.linalg.norm(axis, axis=1)[:, None]
    arm = opposite - start
    arm = arm - np.einsum("ni,ni->n", arm, axis)[:, None] * axis
    first = arm[np.searchsorted(edge, edge)]
    angle = np.arctan2(np.einsum("ni,ni->n", np.cross(first, arm), axis), np.einsum("ni,ni->n", first, arm))
    return np.round((angle + SAME_ANGLE) % (2 * np.pi) / (2 * SAME_ANGLE))  # triangles in one plane have the same


def _pair_sides(edge: IntArray, direction: IntArray) -> IntArray:
    """Pairs (n, 2) of half-edges round each edge, by their place in a list in the order of angles, with solid between them.

    Solid follows a half-edge of direction -1 and ends at one of direction 1, as brackets do round a circle.
    """
    pairs = []
    for around in np.split(np.arange(len(edge)), np.flatnonzero(np.diff(edge)) + 1):
        begun: list[int] = []
        paired: set[int] = set()
        for k in (*around.tolist(), *around.tolist()):
            if k in paired:
                continue
            if direction[k] < 0 and k not in begun:
                begun.append(k)
            elif direction[k] > 0 and begun:
                paired |= {begun[-1], k}
                pairs.append((begun.pop(), k))
    return np.array(pairs, np.int64).reshape(-1, 2)


class MeshSides:
    """Winding numbers on both sides of points on the triangles (m, 3) of a closed mesh."""

    def __init__(self, vertices: Array, triangles: IntArray) -> None:
        self.vertices, self.triangles = vertices, triangles
        self.shell = label_shells(vertices, triangles)
        self.n_shells = int(self.shell.max()) + 1
        corners = vertices[triangles]
        self.extent = float(np.ptp(corners.reshape(-1, 3), axis=0).max())
        a, b, c = np.moveaxis(corners - vertices.mean(axis=0), 1, 0)
        self.volume = np.bincount(self.shell, np.einsum("ni,ni->n", a, np.cross(b, c)) / 6.0)
        some = np.arange(0, len(triangles), len(triangles) // MAX_CENTRES + 1)
        some = np.unique(np.concatenate([some, np.unique(self.shell, return_index=True)[1]]))
        by_area, owner = sample_triangles(corners, SAMPLES)
        points, number = np.concatenate([corners[some].mean(axis=1), by_area]), np.concatenate([some, owner])
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[number]
        length = np.linalg.norm(normal, axis=1)
        step = SIDE_FRACTION * self.extent
        side = np.roll(corners[number], -1, axis=1) - corners[number]
        room = np.linalg.norm(np.cross(side, points[:, None] - corners[number]), axis=2)
        wide = (room > 10 * step * np.linalg.norm(side, axis=2)).all(
            axis=1
        )  # else both sides may be beyond a neighbour
        self.points, self.number = points[wide], number[wide]
        aside = step * normal[wide] / length[wide, None]
        tree = build_triangle_tree(vertices, triangles)
        self.behind, self.ahead = (tree.winding_numbers(self.points + sign * aside) for sign in (-1, 1))

    @cached_property
    def is_off(self) -> BoolArray:
        """Whether the points are no boundary of the solid: it is on both sides of them, or on neither."""
        return (self.behind > 0) == (self.ahead > 0)

    def shells_with(self, points: BoolArray) -> BoolArray:
        """Which shells have any of some points."""
        return np.bincount(self.shell[self.number], points, self.n_shells) > 0

    def shells_within(self, points: BoolArray) -> BoolArray:
        """Which shells have points among some points only."""
        return self.shells_with(points) & ~self.shells_with(~points)

    def select(self, shells: BoolArray) -> MeshSides:
        """The mesh of some of the shells."""
        return MeshSides(self.vertices, self.triangles[shells[self.shell]])

    def reverse(self, shells: BoolArray) -> MeshSides:
        """The mesh with some of the shells reversed."""
        return MeshSides(self.vertices, np.where(shells[self.shell][:, None], self.triangles[:, ::-1], self.triangles))

    def describe(self, shells: BoolArray) -> str:
        """Some of the shells by number, size and place."""
        numbers = np.flatnonzero(shells)
        boxes = [self.vertices[self.triangles[self.shell == k]].reshape(-1, 3) for k in numbers[:SHOWN_SHELLS].tolist()]
        words = [
            f"shell {k + 1} of {self.n_shells}, {np.ptp(box, axis=0).max():.4g} wide about "
            f"{format_point((box.min(axis=0) + box.max(axis=0)) / 2, 5)}"
            for k, box in zip(numbers.tolist(), boxes, strict=False)
        ]
        return "; ".join(words) + (f"; and {len(numbers) - SHOWN_SHELLS} more" if len(numbers) > SHOWN_SHELLS else "")

    def measure_depth(self) -> Array:
        """Distances (n,) of the points that are off the boundary from it, by triangles and points that are on it; at most."""
        if self.is_off.all():
            return np.full(int(self.is_off.sum()), self.extent)
        partly = np.zeros(len(self.triangles), bool)
        partly[self.number[self.is_off]] = True
        found = cKDTree(self.points[~self.is_off]).query(self.points[self.is_off])[0]
        if not partly.all():
            found = np.minimum(
                found, build_triangle_tree(self.vertices, self.triangles[~partly]).distances(self.points[self.is_off])
            )
        return np.asarray(found)


def unite_shells(name: str, vertices: Array, triangles: IntArray) -> tuple[Array, IntArray, tuple[str, ...]]:
    """The mesh of the boundary of the solid that a closed mesh bounds, and notes on what was changed.

    InvalidRequest if it cannot be made; it names the shells.
    """
    notes: list[str] = []
    triangles, n_pairs = _cancel_opposites(triangles)
    if n_pairs:
        notes.append(
            f"{name}: {n_pairs} pairs of triangles that cancel each other, walls of no thickness, were left out"
        )
    if not len(triangles):
        raise InvalidRequest(f"{name} encloses no volume: a body is a closed mesh")
    sides = MeshSides(vertices, triangles)
    if (inverted := _find_inverted(sides)).any():
        notes.append(
            f"{name}: what lies outside of all other shells and faces inwards was reversed: {sides.describe(inverted)}"
        )
        sides = sides.reverse(inverted)
    lost = sides.shells_within(sides.is_off)
    crossed = sides.shells_with(sides.is_off) & ~lost
    if crossed.any() and sides.n_shells > 1:
        sides, crossing = _unite_crossing(name, sides, crossed | lost)
        notes += crossing
    elif lost.any():
        notes.append(
            f"{name}: what lies within other shells that face the same way bounds nothing and was left out: "
            f"{sides.describe(lost)}; reversed it would be a cavity"
        )
        sides = sides.select(~lost)
    once = np.unique(_label_corners(sides.triangles), return_index=True)[1]
    if len(once) < len(sides.triangles) and not len(list_open_edges(sides.triangles[once])):
        notes.append(f"{name}: {len(sides.triangles) - len(once)} triangles that it holds several times were left out")
        sides = MeshSides(sides.vertices, sides.triangles[np.sort(once)])
    if sides.is_off.any():
        depth = sides.measure_depth()
        at = format_point(sides.points[sides.is_off][depth.argmax()], 5)
        if depth.max() > MAX_FOLD_FRACTION * sides.extent:
            shells = sides.describe(sides.shells_with(sides.is_off))
            raise InvalidRequest(
                f"{name} overlaps itself: triangles lie up to {depth.max():.3g} off the boundary of its solid, the farthest near "
                f"{at} ({shells}); unite it to one outer surface in the program that made it (a Boolean union), and save "
                "polygons as triangles"
            )
        if depth.max() > MIN_FOLD_FRACTION * sides.extent:
            notes.append(
                f"{name}: its triangles cross each other, up to {depth.max():.2g} off the boundary of its solid near {at}"
            )
    return sides.vertices, sides.triangles, tuple(notes)


def _label_corners(triangles: IntArray) -> IntArray:
    """A number (m,) for each set of three vertices, from 0."""
    ordered = np.sort(triangles, axis=1)
    edge = label_edges(ordered[:, :2])[0]
    return np.unique(edge * (int(ordered.max()) + 1) + ordered[:, 2], return_inverse=True)[1]


def _cancel_opposites(triangles: IntArray) -> tuple[IntArray, int]:
    """The triangles without pairs of opposite ones on the same vertices, and the number of such pairs."""
    first = triangles.argmin(axis=1)
    rows = np.arange(len(triangles))
    is_even = triangles[rows, (first + 1) % 3] < triangles[rows, (first + 2) % 3]
    which = _label_corners(triangles)
    even, odd = (np.bincount(which[side], minlength=int(which.max()) + 1) for side in (is_even, ~is_even))
    pairs = np.minimum(even, odd)
    if not pairs.any():
        return triangles, 0
    # the first so many of each side go
    order = np.lexsort((rows, is_even, which))
    group = 2 * which[order] + is_even[order]
    start = np.r_[0, np.flatnonzero(np.diff(group)) + 1]
    rank = np.arange(len(order)) - np.repeat(start, np.diff(np.r_[start, len(order)]))
    kept = np.ones(len(triangles), bool)
    kept[order] = rank >= pairs[which[order]]
    return triangles[kept], int(pairs.sum())


def _find_inverted(sides: MeshSides) -> BoolArray:
    """Shells that face inwards where all else is void, with what lies within them."""
    alone = (sides.volume < 0) & sides.shells_within((sides.behind == 0) & (sides.ahead == -1))
    found = np.zeros(sides.n_shells, bool)
    first = sides.points[np.unique(sides.shell[sides.number], return_index=True)[1]]
    known = np.unique(sides.shell[sides.number])
    for k in np.flatnonzero(alone)[np.argsort(sides.volume[alone])].tolist():
        if not found[k]:
            own = build_triangle_tree(sides.vertices, sides.triangles[sides.shell == k])
            found[known[own.winding_numbers(first) != 0]] = True
            found[k] = True
    return found


def _unite_crossing(name: str, sides: MeshSides, crossed: BoolArray) -> tuple[MeshSides, list[str]]:
    """The mesh whose shells that cross, and others in their boxes, are united; as it is where Manifold takes a shell for open."""
    manifold = import_extra("manifold3d", "meshes whose shells overlap", "triangles")
    corners = sides.vertices[sides.triangles]
    order = np.argsort(sides.shell, kind="stable")
    starts = np.flatnonzero(np.diff(sides.shell[order], prepend=-1))
    low = np.minimum.reduceat(corners.min(axis=1)[order], starts)
    high = np.maximum.reduceat(corners.max(axis=1)[order], starts)
    involved = crossed.copy()
    for k in np.flatnonzero(crossed).tolist():
        involved |= ((low <= high[k]) & (high >= low[k])).all(axis=1)
    solids: dict[bool, list[Any]] = {True: [], False: []}
    for k in np.flatnonzero(involved).tolist():
        is_solid = bool(sides.volume[k] > 0)
        own = sides.triangles[sides.shell == k]
        made = _make_manifold(manifold, sides.vertices, own if is_solid else own[:, ::-1])
        if made is None:
            return sides, []
        solids[is_solid].append(made)
    united = _find_positive(manifold, solids[True], solids[False]).to_mesh64()
    points, own = np.array(united.vert_properties)[:, :3], np.array(united.tri_verts, np.int64)
    rest = sides.triangles[~involved[sides.shell]]
    vertices, triangles = np.concatenate([sides.vertices, points]), np.concatenate([rest, own + len(sides.vertices)])
    if not len(triangles):
        raise InvalidRequest(f"{name} encloses no volume: a body is a closed mesh")
    used, triangles = np.unique(triangles, return_inverse=True)
    note = f"{name}: shells that overlap or touch were made one solid: {sides.describe(crossed)}"
    return MeshSides(vertices[used], triangles.reshape(-1, 3)), [note]


def _make_manifold(manifold: Any, vertices: Array, triangles: IntArray) -> Any:
    """The solid of Manifold of one shell; None if its edges do not join two triangles each."""
    used, own = np.unique(triangles, return_inverse=True)
    made = manifold.Manifold(
        manifold.Mesh64(np.ascontiguousarray(vertices[used]), own.reshape(-1, 3).astype(np.uint64))
    )
    return made if made.status() == manifold.Error.NoError else None


def _find_positive(manifold: Any, solids: Sequence[Any], cavities: Sequence[Any]) -> Any:
    """The set in which the winding number of shells is positive: those of solids count 1, those of cavities -1."""
    add = manifold.OpType.Add
    union = manifold.Manifold.batch_boolean(list(solids), add)
    if not cavities:
        return union
    if np.isclose(union.volume(), sum(each.volume() for each in solids), rtol=1e-9):  # no point lies in two
        return union - manifold.Manifold.batch_boolean(list(cavities), add)
    levels = [solids[0]]
    for solid in solids[1:]:
        carried = [level ^ solid for level in levels]
        levels = [level + added for level, added in zip(levels, [solid, *carried[:-1]], strict=True)]
        if not carried[-1].is_empty():
            levels.append(carried[-1])
    for cavity in cavities:
        levels = [a - cavity + b for a, b in zip(levels, levels[1:], strict=False)] + [levels[-1] - cavity]
    return levels[0]

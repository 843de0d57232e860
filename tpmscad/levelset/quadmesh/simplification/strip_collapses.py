"""The changes of a layout that start from one of its polygons: diagonals, sides of triangles, and strips.

How good a layout's polygons would be after changes that start from its triangles and from sides on the box.

Corners where a change leaves only two polygons are taken out with it: which polygons come of that, and whether all that a change
leaves is a surface, is known when it is made. Here polygons at such corners are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.quality import corner_distortion
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MAX_VALENCE, MeshEdit, PolygonMesh
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, VertexStars, segment_max

MAX_STRIP_QUADS = 8
"""Quadrilaterals of the longest strips that are collapsed."""


@dataclass(frozen=True, slots=True)
class CollapseSeed:
    """What a change starts with: vertices that go `into` others, or none where the side `joint` between two triangles is taken
    out; and the polygons, by number, that are `gone` with it at least."""

    into: tuple[tuple[int, int], ...]
    removed: tuple[int, ...]
    shared_edge: tuple[int, int] = (-1, -1)


def plan_edit(polygons: PolygonMesh, start: CollapseSeed) -> MeshEdit | None:
    """The change that starts so, or None where it can't be made, or no longer."""
    if any(number not in polygons.polygon for number in start.removed):
        return None
    if start.into:
        return polygons.plan_collapse(dict(start.into), start.removed)
    one, other = start.removed
    return polygons.joined(one, other, *start.shared_edge)


def plan_edits_from(polygons: PolygonMesh, number: int) -> list[MeshEdit]:
    """What may be collapsed or joined that starts from the polygon of that number.

    Of a quadrilateral its diagonals, and the strips from its sides on the box; of a triangle its sides with other triangles,
    taken out or collapsed, those with quadrilaterals, which become triangles, and the strips from its sides.
    """
    polygon = polygons.polygon[number]
    found = []
    if len(polygon) == 4:
        for a, c in ((polygon[0], polygon[2]), (polygon[1], polygon[3])):
            into = _collapse_direction(polygons, a, c, False)
            if into is not None:
                found.append(CollapseSeed((into,), (number,)))
    starts = [*found, *find_strip_seeds(polygons, number)]
    return [change for change in (plan_edit(polygons, start) for start in starts) if change is not None]


def find_strip_seeds(polygons: PolygonMesh, number: int) -> list[CollapseSeed]:
    """The changes that may start from that polygon but for its diagonals."""
    polygon = polygons.polygon[number]
    found: list[CollapseSeed] = []
    for i, v in enumerate(polygon):
        u = polygon[i - 1]
        other = polygons.beside.get((v, u), -1)
        if len(polygon) == 3:
            if other >= 0 and len(polygons.polygon[other]) == 3:
                found.append(CollapseSeed((), (number, other), (u, v)))
            found += _grow_strips(polygons, [], [number], u, v)
        elif other < 0:
            into = _collapse_direction(polygons, u, v, True)
            if into is not None:
                found += _grow_strips(polygons, [into], [number], polygon[(i + 1) % 4], polygon[(i + 2) % 4])
    return found


def _grow_strips(
    polygons: PolygonMesh, into: list[tuple[int, int]], gone: list[int], u: int, v: int
) -> list[CollapseSeed]:
    """Collapses of the side u to v and of those opposite, one after another, up to a triangle or the box.

    `into` and `gone`: the side on the box and the quadrilateral that a strip starts with, or nothing and a triangle.
    """
    found: list[CollapseSeed] = []
    start = len(into)
    used = {v for pair in into for v in pair}
    for _ in range(MAX_STRIP_QUADS):
        other = polygons.beside.get((v, u), -1)
        step = _collapse_direction(polygons, u, v, other < 0)
        if step is None or u in used or v in used or other in gone:
            break
        used |= {u, v}
        into.append(step)
        if other < 0:
            found.append(CollapseSeed(tuple(into), tuple(gone)))
            break
        corners = polygons.polygon[other]
        if len(corners) == 3:
            found.append(CollapseSeed(tuple(into), (*gone, other)))
            break
        if len(gone) == 1 and not start:
            found.append(CollapseSeed(tuple(into), tuple(gone)))
        gone.append(other)
        i = corners.index(v)
        v, u = corners[i - 1], corners[(i + 2) % 4]
    return found


def _collapse_direction(polygons: PolygonMesh, a: int, b: int, on_box: bool) -> tuple[int, int] | None:
    """Which of two vertices goes into the other: towards the box and its edges, and along the box only."""
    one, other = polygons.fixed[a], polygons.fixed[b]
    if one and other and (not on_box or one + other == 4):
        return None
    return (a, b) if (other, b) > (one, a) else (b, a)


def rate_strip_collapses(
    stars: VertexStars, surface: SurfaceVertices, starts: Sequence[CollapseSeed]
) -> tuple[Array, IntArray]:
    """How bad the worst polygon becomes, infinite where it goes with others than are to, and the patches saved: (n,) each."""
    count, vertices, number = len(starts), len(surface.vertices), len(stars.rows)
    of = np.repeat(np.arange(count), [len(start.into) for start in starts])
    goes, stays = np.array([pair for start in starts for pair in start.into], np.int64).reshape(-1, 2).T
    gone_of = np.repeat(np.arange(count), [len(start.removed) for start in starts])
    gone = np.array([polygon for start in starts for polygon in start.removed], np.int64)

    owner, polygon, _ = stars.around(np.concatenate([goes, stays]))
    left = np.setdiff1d(np.concatenate([of, of])[owner] * number + polygon, gone_of * number + gone)
    by, polygon = np.divmod(left, number)
    merged = vertices + np.concatenate([np.arange(len(of))] * 2)
    before = stars.rows[polygon]
    rows, whole = _shrink_degenerate_quads(
        _rename_vertices(before, by, np.concatenate([of * vertices + goes, of * vertices + stays]), merged, vertices)
    )
    joints, joint_of = _join_triangle_pairs(stars, starts)
    rows, by = np.concatenate([rows, joints]), np.concatenate([by, joint_of])
    whole = np.concatenate([whole, np.ones(len(joints), bool)])

    # corners of polygons that go, or of triangles joined, where two are left inside
    corner_of, corner = np.repeat(gone_of, 4), stars.rows[gone].ravel()
    key, less = np.unique(corner_of[corner >= 0] * vertices + corner[corner >= 0], return_counts=True)
    key_of, corner = np.divmod(key, vertices)
    lone = np.isin(key, np.repeat(joint_of, 4) * vertices + joints.ravel())
    two = (stars.count[corner] - less + lone == 2) & ~surface.fixed[corner].any(axis=1)
    two &= ~np.isin(key, np.concatenate([of * vertices + goes, of * vertices + stays]))
    odd = key[two]
    own = (rows >= 0) & (rows < vertices)
    fine = whole & ~(own & np.isin(by[:, None] * vertices + rows, odd)).any(axis=1)

    there = surface.append_merged_vertices(goes, stays)
    bad = segment_max(corner_distortion(there.vertices, there.normals, there.fixed, rows[fine]), by[fine], count)
    bad[by[~whole]] = np.inf
    round_each = np.bincount(rows[rows >= vertices] - vertices, minlength=len(of))
    twos = np.bincount(key_of[two], minlength=count)
    bad[of[round_each > MAX_VALENCE + twos[of]]] = np.inf
    saved = (
        np.bincount(gone_of, _patch_counts(stars.rows[gone]), count)
        + twos
        - np.bincount(by, _patch_counts(rows), count)
    )
    saved += np.bincount(by[: len(before)], _patch_counts(before), count)
    bad[saved <= 0] = np.inf
    return bad, saved.astype(np.int64)


def _patch_counts(rows: IntArray) -> IntArray:
    return np.where(rows[:, 3] < 0, 3, 1)


def _rename_vertices(rows: IntArray, by: IntArray, keys: IntArray, names: IntArray, vertices: int) -> IntArray:
    """Polygons (m, 4) of changes `by`, with the vertices that have a key there under their new names."""
    order = np.argsort(keys, kind="stable")
    keys, names = keys[order], names[order]
    wanted = np.where(rows >= 0, by[:, None] * vertices + rows, -1)
    at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[at] == wanted, names[at], rows) if len(keys) else rows


def _shrink_degenerate_quads(rows: IntArray) -> tuple[IntArray, BoolArray]:
    """Quadrilaterals with a side of no length made triangles; and which polygons have three corners or more, all different."""
    rows = rows.copy()
    same = rows == np.roll(rows, -1, axis=1)
    short = np.flatnonzero((rows[:, 3] >= 0) & (same.sum(axis=1) == 1))
    turn = (same[short].argmax(axis=1)[:, None] + np.arange(1, 5)) % 4
    rows[short] = np.take_along_axis(rows[short], turn, axis=1)
    rows[short, 3] = -1
    a, b, c, d = rows.T
    return rows, (a != b) & (b != c) & (c != a) & (a != d) & (b != d) & (c != d)


def _join_triangle_pairs(stars: VertexStars, starts: Sequence[CollapseSeed]) -> tuple[IntArray, IntArray]:
    """The quadrilaterals (j, 4) of two triangles without the side between them, and of which start they are."""
    of = np.array([i for i, start in enumerate(starts) if not start.into], np.int64)
    gone = np.array([starts[i].removed for i in of.tolist()], np.int64).reshape(-1, 2)
    a, b = np.array([starts[i].shared_edge for i in of.tolist()], np.int64).reshape(-1, 2).T
    far = stars.rows[gone][..., :3]
    c, d = (far.sum(axis=2) - (a + b)[:, None]).T
    return np.stack([a, d, b, c], axis=1), of

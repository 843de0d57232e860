"""Collapses that start from a triangle or from a side on the box: single edges, strips of quadrilaterals, and triangle pairs.

A strip (polychord) collapse merges the ends of opposite edges along a chain of quadrilaterals between two triangles or sides on
the box (Daniels et al. 2008). A collapse is described by its seed, which `plan_edit` turns into an exact edit.

There are two ways to find collapses. `plan_edits_from` plans those of one polygon exactly; it is the reference for
`rate_strip_collapses`, which rates many seeds at once in arrays and treats doublets approximately: it leaves the polygons at a
doublet out of the rating, since their union is known only once the edit is planned.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.quality import corner_distortion
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MAX_VALENCE, MeshEdit, PolygonMesh, count_patches
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, VertexStars, segment_max

MAX_STRIP_QUADS = 8
"""Largest number of quadrilaterals in a strip."""


@dataclass(frozen=True, slots=True)
class CollapseSeed:
    """What defines a collapse: vertex merges (from, into), and the polygons, by number, that vanish with them at least.

    Without merges the two removed polygons are triangles that lose their `shared_edge`.
    """

    merges: tuple[tuple[int, int], ...]
    removed: tuple[int, ...]
    shared_edge: tuple[int, int] = (-1, -1)


def plan_edit(polygons: PolygonMesh, seed: CollapseSeed) -> MeshEdit | None:
    """The edit of a seed, or None if it is not valid, or no longer so."""
    if any(number not in polygons.corners_of for number in seed.removed):
        return None
    if seed.merges:
        return polygons.plan_collapse(dict(seed.merges), seed.removed)
    one, other = seed.removed
    return polygons.plan_edge_removal(one, other, *seed.shared_edge)


def plan_edits_from(polygons: PolygonMesh, number: int) -> list[MeshEdit]:
    """All valid edits that start from one polygon, planned exactly one by one.

    From a quadrilateral: the collapses of its diagonals, and of the strips that begin at its sides on the box. From a triangle:
    the removal of edges to other triangles, and the collapses of its edges and of the strips that begin at them.
    """
    polygon = polygons.corners_of[number]
    seeds = []
    if len(polygon) == 4:
        for a, c in ((polygon[0], polygon[2]), (polygon[1], polygon[3])):
            merge = _collapse_direction(polygons, a, c, False)
            if merge is not None:
                seeds.append(CollapseSeed((merge,), (number,)))
    seeds += find_strip_seeds(polygons, number)
    return [edit for edit in (plan_edit(polygons, seed) for seed in seeds) if edit is not None]


def find_strip_seeds(polygons: PolygonMesh, number: int) -> list[CollapseSeed]:
    """Seeds of all collapses that start from a polygon, except its diagonals."""
    polygon = polygons.corners_of[number]
    seeds: list[CollapseSeed] = []
    for i, v in enumerate(polygon):
        u = polygon[i - 1]
        other = polygons.polygon_of_half_edge.get((v, u), -1)
        if len(polygon) == 3:
            if other >= 0 and len(polygons.corners_of[other]) == 3:
                seeds.append(CollapseSeed((), (number, other), (u, v)))
            seeds += _grow_strips(polygons, (), number, u, v)
        elif other < 0:
            merge = _collapse_direction(polygons, u, v, True)
            if merge is not None:
                seeds += _grow_strips(polygons, (merge,), number, polygon[(i + 1) % 4], polygon[(i + 2) % 4])
    return seeds


def _grow_strips(
    polygons: PolygonMesh, first: tuple[tuple[int, int], ...], number: int, u: int, v: int
) -> list[CollapseSeed]:
    """Seeds of the strip that crosses the edge from u to v and the edges opposite, up to a triangle or the box.

    The strip begins with polygon `number`: a triangle, or a quadrilateral with the merge `first` of its side on the box.
    """
    seeds: list[CollapseSeed] = []
    merges, removed = list(first), [number]
    used = {v for pair in merges for v in pair}
    for _ in range(MAX_STRIP_QUADS):
        other = polygons.polygon_of_half_edge.get((v, u), -1)
        merge = _collapse_direction(polygons, u, v, other < 0)
        if merge is None or u in used or v in used or other in removed:
            break
        used |= {u, v}
        merges.append(merge)
        if other < 0:
            seeds.append(CollapseSeed(tuple(merges), tuple(removed)))
            break
        corners = polygons.corners_of[other]
        if len(corners) == 3:
            seeds.append(CollapseSeed(tuple(merges), (*removed, other)))
            break
        if len(removed) == 1 and not first:
            seeds.append(CollapseSeed(tuple(merges), tuple(removed)))
        removed.append(other)
        i = corners.index(v)
        v, u = corners[i - 1], corners[(i + 2) % 4]
    return seeds


def _collapse_direction(polygons: PolygonMesh, a: int, b: int, on_box: bool) -> tuple[int, int] | None:
    """The merge (from, into) of two vertices, towards the one with more fixed coordinates.

    None for two vertices on the box that no side on the box joins, and for two on edges of the box.
    """
    one, other = polygons.n_fixed[a], polygons.n_fixed[b]
    if one and other and (not on_box or one + other == 4):
        return None
    return (a, b) if (other, b) > (one, a) else (b, a)


def rate_strip_collapses(
    stars: VertexStars, surface: SurfaceVertices, seeds: Sequence[CollapseSeed]
) -> tuple[Array, IntArray]:
    """Distortion of the worst polygon after each collapse, and the number of patches saved: (n,) each.

    The distortion is infinite if a polygon outside `removed` would degenerate, a valence would be too high or no patch would be
    saved.
    """
    count, n_vertices, n_polygons = len(seeds), len(surface.vertices), len(stars.rows)
    merge_owner = np.repeat(np.arange(count), [len(seed.merges) for seed in seeds])
    removed, kept = np.array([pair for seed in seeds for pair in seed.merges], np.int64).reshape(-1, 2).T
    gone_owner = np.repeat(np.arange(count), [len(seed.removed) for seed in seeds])
    gone = np.array([polygon for seed in seeds for polygon in seed.removed], np.int64)
    merge_keys = np.concatenate([merge_owner * n_vertices + removed, merge_owner * n_vertices + kept])

    # the polygons round merged vertices that stay, with the merged vertices renamed
    entry, polygon, _ = stars.polygons_around(np.concatenate([removed, kept]))
    around = np.concatenate([merge_owner, merge_owner])[entry] * n_polygons + polygon
    owner, polygon = np.divmod(np.setdiff1d(around, gone_owner * n_polygons + gone), n_polygons)
    before = stars.rows[polygon]
    merged = n_vertices + np.concatenate([np.arange(len(merge_owner))] * 2)
    rows, valid = _shrink_degenerate_quads(_rename_vertices(before, owner, merge_keys, merged, n_vertices))
    pairs, pair_owner = _join_triangle_pairs(stars, seeds)
    rows, owner = np.concatenate([rows, pairs]), np.concatenate([owner, pair_owner])
    valid = np.concatenate([valid, np.ones(len(pairs), bool)])

    # doublets: inner corners of removed polygons, or of joined triangles, at which two polygons are left
    corner_owner, corner = np.repeat(gone_owner, 4), stars.rows[gone].ravel()
    keys, n_removed = np.unique(corner_owner[corner >= 0] * n_vertices + corner[corner >= 0], return_counts=True)
    key_owner, corner = np.divmod(keys, n_vertices)
    n_added = np.isin(keys, np.repeat(pair_owner, 4) * n_vertices + pairs.ravel())
    doublet = (stars.valence[corner] - n_removed + n_added == 2) & ~surface.fixed[corner].any(axis=1)
    doublet &= ~np.isin(keys, merge_keys)
    unmerged = (rows >= 0) & (rows < n_vertices)
    at_doublet = (unmerged & np.isin(owner[:, None] * n_vertices + rows, keys[doublet])).any(axis=1)
    measured = valid & ~at_doublet

    after = surface.append_merged_vertices(removed, kept)
    distortion = corner_distortion(after.vertices, after.normals, after.fixed, rows[measured])
    worst = segment_max(distortion, owner[measured], count)
    worst[owner[~valid]] = np.inf
    valence = np.bincount(rows[rows >= n_vertices] - n_vertices, minlength=len(merge_owner))
    n_doublets = np.bincount(key_owner[doublet], minlength=count)
    worst[merge_owner[valence > MAX_VALENCE + n_doublets[merge_owner]]] = np.inf
    saved = (
        np.bincount(gone_owner, count_patches(stars.rows[gone]), count)
        + n_doublets
        - np.bincount(owner, count_patches(rows), count)
    )
    saved += np.bincount(owner[: len(before)], count_patches(before), count)
    worst[saved <= 0] = np.inf
    return worst, saved.astype(np.int64)


def _rename_vertices(rows: IntArray, owner: IntArray, keys: IntArray, names: IntArray, n_vertices: int) -> IntArray:
    """Polygons (m, 4) with each vertex v replaced by the name of the key owner * n_vertices + v, if there is one."""
    if not len(keys):
        return rows
    order = np.argsort(keys, kind="stable")
    keys, names = keys[order], names[order]
    wanted = np.where(rows >= 0, owner[:, None] * n_vertices + rows, -1)
    entry = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
    return np.where(keys[entry] == wanted, names[entry], rows)


def _shrink_degenerate_quads(rows: IntArray) -> tuple[IntArray, BoolArray]:
    """Polygons (m, 4) in which quadrilaterals with one zero side are triangles, and which (m,) then have distinct corners."""
    rows = rows.copy()
    same = rows == np.roll(rows, -1, axis=1)
    short = np.flatnonzero((rows[:, 3] >= 0) & (same.sum(axis=1) == 1))
    turn = (same[short].argmax(axis=1)[:, None] + np.arange(1, 5)) % 4
    rows[short] = np.take_along_axis(rows[short], turn, axis=1)
    rows[short, 3] = -1
    a, b, c, d = rows.T
    return rows, (a != b) & (b != c) & (c != a) & (a != d) & (b != d) & (c != d)


def _join_triangle_pairs(stars: VertexStars, seeds: Sequence[CollapseSeed]) -> tuple[IntArray, IntArray]:
    """The quadrilaterals (j, 4) of two triangles without their shared edge, and the seed (j,) of each."""
    owner = np.array([i for i, seed in enumerate(seeds) if not seed.merges], np.int64)
    triangles = np.array([seeds[i].removed for i in owner.tolist()], np.int64).reshape(-1, 2)
    a, b = np.array([seeds[i].shared_edge for i in owner.tolist()], np.int64).reshape(-1, 2).T
    corners = stars.rows[triangles][..., :3]
    c, d = (corners.sum(axis=2) - (a + b)[:, None]).T
    return np.stack([a, d, b, c], axis=1), owner

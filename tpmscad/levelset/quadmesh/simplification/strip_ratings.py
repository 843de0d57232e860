"""Ratings of many strip collapses at once, in a compiled loop.

Doublets are treated approximately: the polygons at a doublet are left out of the rating, since their union is known only once the
edit is planned.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.quadmesh.quality import measure_polygon
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import MAX_VALENCE, PATCHES_PER_TRIANGLE
from tpmscad.levelset.quadmesh.simplification.strip_collapses import CollapseSeeds
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, VertexStars


def rate_strip_collapses(stars: VertexStars, surface: SurfaceVertices, seeds: CollapseSeeds) -> tuple[Array, IntArray]:
    """Distortion of the worst polygon after each collapse, and the number of patches saved: (n,) each.

    The distortion is infinite if a polygon outside `removed` would degenerate, a valence would be too high or no patch would be
    saved.
    """
    removed, kept = seeds.merges[seeds.merges[..., 0] >= 0].T
    after = surface.append_merged_vertices(removed, kept)
    worst, saved = np.empty(len(seeds)), np.empty(len(seeds), np.int64)
    _rate_strips(
        stars, after.vertices, after.normals, after.fixed, len(surface.vertices),
        seeds.merges, seeds.removed, seeds.shared_edge, worst, saved,
    )  # fmt: skip
    return worst, saved


@njit_cached
def _rate_strips(
    stars: VertexStars,
    vertices: Array,
    normals: Array,
    fixed: BoolArray,
    n_vertices: int,
    merges: IntArray,
    removed: IntArray,
    shared_edge: IntArray,
    worst: Array,
    saved: IntArray,
) -> None:  # pragma: no cover
    """The worst distortion and the patches saved (n,); vertices beyond the first `n_vertices` are the merged ones, in order."""
    new_name = np.full(n_vertices, -1)
    n_gone_at, n_joined_at = np.zeros(n_vertices, np.int64), np.zeros(n_vertices, np.int64)
    done, is_gone = np.full(len(stars.rows), -1), np.full(len(stars.rows), -1)
    valence = np.zeros(merges.shape[1], np.int64)
    row = np.empty(4, np.int64)
    first_merged = n_vertices
    for i in range(len(merges)):
        n_merges = 0
        while n_merges < merges.shape[1] and merges[i, n_merges, 0] >= 0:
            for v in merges[i, n_merges]:
                new_name[v] = first_merged + n_merges
            valence[n_merges] = 0
            n_merges += 1
        total = 0
        for q in removed[i]:
            if q >= 0:
                is_gone[q] = i
                total += _patch_count(stars.rows[q])
                for v in stars.rows[q]:
                    if v >= 0:
                        n_gone_at[v] += 1
        if not n_merges:
            _join_triangles(stars, removed[i], shared_edge[i], row)
            for v in row:
                n_joined_at[v] = 1

        # doublets: inner corners of removed polygons, or of joined triangles, at which two polygons are left
        n_doublets = 0
        for q in removed[i]:
            if q >= 0:
                for v in stars.rows[q]:
                    if v >= 0 and _is_doublet(stars, fixed, new_name, n_gone_at, n_joined_at, v):
                        n_gone_at[v] = -1 - n_gone_at[v]  # marked, and counted once
                        n_doublets += 1

        result = 0.0
        if not n_merges:
            total -= 1
            if not _has_doublet(row, n_gone_at, n_vertices):
                result = measure_polygon(vertices, normals, fixed, row)
        for k in range(n_merges):
            for vertex in merges[i, k]:
                for entry in range(stars.first[vertex], stars.first[vertex + 1]):
                    polygon = stars.polygon[entry]
                    if done[polygon] == i or is_gone[polygon] == i:
                        continue
                    done[polygon] = i
                    total += _patch_count(stars.rows[polygon])
                    for c in range(4):
                        v = stars.rows[polygon, c]
                        row[c] = new_name[v] if v >= 0 and new_name[v] >= 0 else v
                    is_valid = _shrink_degenerate_quad(row)
                    total -= _patch_count(row)
                    for v in row:
                        if v >= n_vertices:
                            valence[v - first_merged] += 1
                    if not is_valid:
                        result = np.inf
                    elif not _has_doublet(row, n_gone_at, n_vertices):
                        result = max(result, measure_polygon(vertices, normals, fixed, row))
        for k in range(n_merges):
            if valence[k] > MAX_VALENCE + n_doublets:
                result = np.inf
        saved[i] = total + n_doublets
        worst[i] = np.inf if saved[i] <= 0 else result

        for k in range(n_merges):
            for v in merges[i, k]:
                new_name[v] = -1
        for q in removed[i]:
            if q >= 0:
                for v in stars.rows[q]:
                    if v >= 0:
                        n_gone_at[v], n_joined_at[v] = 0, 0
        first_merged += n_merges


@njit_cached
def _is_doublet(
    stars: VertexStars, fixed: BoolArray, new_name: IntArray, n_gone_at: IntArray, n_joined_at: IntArray, v: int
) -> bool:  # pragma: no cover
    """Whether two polygons are left at an inner vertex that is not merged and not marked yet."""
    if n_gone_at[v] < 0 or new_name[v] >= 0 or fixed[v, 0] or fixed[v, 1] or fixed[v, 2]:
        return False
    return stars.first[v + 1] - stars.first[v] - n_gone_at[v] + n_joined_at[v] == 2


@njit_cached
def _has_doublet(row: IntArray, n_gone_at: IntArray, n_vertices: int) -> bool:  # pragma: no cover
    """Whether a corner of a polygon (4,) is marked as a doublet."""
    is_marked = False
    for v in row:
        is_marked |= 0 <= v < n_vertices and n_gone_at[v] < 0
    return is_marked


@njit_cached
def _shrink_degenerate_quad(row: IntArray) -> bool:  # pragma: no cover
    """Make a quadrilateral (4,) with one zero side a triangle, in place; whether the corners are then distinct."""
    if row[3] >= 0:
        n_same, place = 0, 0
        for k in range(4):
            if row[k] == row[(k + 1) % 4]:
                n_same, place = n_same + 1, k
        if n_same == 1:
            a, b, c = row[(place + 1) % 4], row[(place + 2) % 4], row[(place + 3) % 4]
            row[0], row[1], row[2], row[3] = a, b, c, -1
    for k in range(4):
        for m in range(k):
            if row[k] == row[m]:
                return False
    return True


@njit_cached
def _join_triangles(
    stars: VertexStars, removed: IntArray, shared_edge: IntArray, row: IntArray
) -> None:  # pragma: no cover
    """The quadrilateral (4,) of two triangles without their shared edge."""
    a, b = shared_edge[0], shared_edge[1]
    c, d = -a - b, -a - b
    for k in range(3):
        c += stars.rows[removed[0], k]
        d += stars.rows[removed[1], k]
    row[0], row[1], row[2], row[3] = a, d, b, c


@njit_cached
def _patch_count(row: IntArray) -> int:  # pragma: no cover
    return PATCHES_PER_TRIANGLE if row[3] < 0 else 1

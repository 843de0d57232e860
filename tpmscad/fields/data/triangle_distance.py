"""Distances of points from the triangles of a mesh, and winding numbers of a closed mesh about points and on a grid.

The nearest triangle is found in a tree of boxes, whose leaves hold a few triangles and whose nodes are split at the median of
the centres along the longest edge. The nearest point of one triangle is that of C. Ericson, Real-Time Collision Detection
(2005), 5.1.5. Winding numbers are counted along lines of the third axis: a line changes the number where it crosses a
triangle, and both triangles at an edge decide by the same floating-point operations on which side of it a line passes; a line
through an edge is moved aside by an infinitesimal length (H. Edelsbrunner, E. P. Muecke, Simulation of Simplicity, 1990).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached, njit_inner
from tpmscad._typing import Array, IntArray

MAX_TRIANGLES_PER_LEAF = 4
"""Triangles in a leaf of the tree: with 2 or 8 the distances of a mesh of 6000 triangles take a tenth longer."""

MAX_DEPTH = 64
"""Nodes that wait to be visited: more than the depth of a tree that is split at medians."""


@dataclass(frozen=True, slots=True, eq=False)
class TriangleTree:
    """A tree of boxes over triangles.

    `corners` (m, 3, 3) of the triangles in the order of the leaves, `order` (m,) their numbers in the mesh. Node i has the box
    `low[i]`, `high[i]`; its children are `child[i]` and the next one, or it is a leaf with the triangles from `first[i]` to
    `last[i]`, and `child[i]` is 0.
    """

    corners: Array
    order: IntArray
    low: Array
    high: Array
    child: IntArray
    first: IntArray
    last: IntArray

    def distances(self, points: Array) -> Array:
        """Distances (n,) of points (n, 3) from the nearest triangle."""
        return self.nearest(points)[0]

    def nearest(self, points: Array) -> tuple[Array, Array, IntArray]:
        """Distances (n,) of points (n, 3), the nearest points (n, 3) of the triangles, and the numbers of these (n,)."""
        points = np.ascontiguousarray(points, dtype=float)
        distance, feet, found = np.empty(len(points)), np.empty((len(points), 3)), np.empty(len(points), np.int64)
        _find_nearest(
            self.corners, self.low, self.high, self.child, self.first, self.last, points, distance, feet, found
        )
        return distance, feet, self.order[found]

    def winding_numbers(self, points: Array) -> IntArray:
        """Winding numbers (n,) of the mesh, which is closed, about points (n, 3) that lie on none of its triangles."""
        points, found = np.ascontiguousarray(points, dtype=float), np.zeros(len(points), np.int64)
        _wind_points(self.corners, self.low, self.high, self.child, self.first, self.last, points, found)
        return found


def sample_triangles(corners: Array, count: int) -> tuple[Array, IntArray]:
    """About `count` points (n, 3) on triangles (m, 3, 3), evenly by area, and the triangle (n,) of each."""
    area = 0.5 * np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    ends = np.cumsum(area)
    at = (np.arange(count) + 0.5) / count * ends[-1]
    t = np.minimum(np.searchsorted(ends, at), len(corners) - 1)
    # a low-discrepancy sequence of two dimensions (M. Roberts, 2018), folded into the triangle
    u, v = np.modf(0.5 + np.outer([0.7548776662466927, 0.5698402909980532], np.arange(count)))[0]
    outside = u + v > 1
    u, v = np.where(outside, 1 - u, u)[:, None], np.where(outside, 1 - v, v)[:, None]
    a, b, c = np.moveaxis(corners[t], 1, 0)
    return a + u * (b - a) + v * (c - a), t


def build_triangle_tree(vertices: Array, triangles: IntArray) -> TriangleTree:
    """The tree of the triangles (m, 3) between vertices (k, 3); at least one. A million take 3 s."""
    corners = np.ascontiguousarray(vertices[triangles], dtype=float)
    low, high = corners.min(axis=1), corners.max(axis=1)
    order = np.arange(len(triangles))
    nodes = 2 * len(triangles)  # at most: each node that is split has two children, and no leaf is empty
    boxes_low, boxes_high = np.empty((nodes, 3)), np.empty((nodes, 3))
    child, first, last = (np.zeros(nodes, np.int64) for _ in range(3))
    n = _split_nodes(low, high, order, boxes_low, boxes_high, child, first, last)
    return TriangleTree(corners[order], order, boxes_low[:n], boxes_high[:n], child[:n], first[:n], last[:n])


@njit_cached
def _split_nodes(low, high, order, boxes_low, boxes_high, child, first, last):  # type: ignore[no-untyped-def]
    """Fill the nodes of a tree of boxes and sort `order` to its leaves; returns the number of nodes."""
    last[0], count, node = len(order), 1, 0
    centre_low, centre_high = np.empty(3), np.empty(3)
    while node < count:
        a, b = first[node], last[node]
        boxes_low[node], boxes_high[node] = np.inf, -np.inf
        centre_low[:], centre_high[:] = np.inf, -np.inf
        for t in order[a:b]:
            for k in range(3):
                boxes_low[node, k] = min(boxes_low[node, k], low[t, k])
                boxes_high[node, k] = max(boxes_high[node, k], high[t, k])
                centre = low[t, k] + high[t, k]
                centre_low[k], centre_high[k] = min(centre_low[k], centre), max(centre_high[k], centre)
        if b - a > MAX_TRIANGLES_PER_LEAF:
            axis, middle = np.argmax(centre_high - centre_low), a + (b - a) // 2
            own = order[a:b].copy()
            order[a:b] = own[np.argsort(low[own, axis] + high[own, axis])]
            child[node] = count
            first[count], last[count], first[count + 1], last[count + 1] = a, middle, middle, b
            count += 2
        node += 1
    return count


@njit_inner
def _box_distance2(low, high, i, x, y, z):  # type: ignore[no-untyped-def]
    """Squared distance of a point from the box of node i."""
    dx = max(low[i, 0] - x, 0.0, x - high[i, 0])
    dy = max(low[i, 1] - y, 0.0, y - high[i, 1])
    dz = max(low[i, 2] - z, 0.0, z - high[i, 2])
    return dx * dx + dy * dy + dz * dz


@njit_inner
def _nearest_of_triangle(corners, t, x, y, z):  # type: ignore[no-untyped-def]
    """The barycentric coordinates v, w of the second and third corner at the nearest point of triangle t."""
    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
    abx, aby, abz = corners[t, 1, 0] - ax, corners[t, 1, 1] - ay, corners[t, 1, 2] - az
    acx, acy, acz = corners[t, 2, 0] - ax, corners[t, 2, 1] - ay, corners[t, 2, 2] - az
    apx, apy, apz = x - ax, y - ay, z - az
    d1, d2 = abx * apx + aby * apy + abz * apz, acx * apx + acy * apy + acz * apz
    if d1 <= 0.0 and d2 <= 0.0:
        return 0.0, 0.0
    bpx, bpy, bpz = apx - abx, apy - aby, apz - abz
    d3, d4 = abx * bpx + aby * bpy + abz * bpz, acx * bpx + acy * bpy + acz * bpz
    if d3 >= 0.0 and d4 <= d3:
        return 1.0, 0.0
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return d1 / (d1 - d3), 0.0
    cpx, cpy, cpz = apx - acx, apy - acy, apz - acz
    d5, d6 = abx * cpx + aby * cpy + abz * cpz, acx * cpx + acy * cpy + acz * cpz
    if d6 >= 0.0 and d5 <= d6:
        return 0.0, 1.0
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return 0.0, d2 / (d2 - d6)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return 1.0 - w, w
    total = va + vb + vc
    return vb / total, vc / total


@njit_inner
def _find_foot(corners, t, x, y, z):  # type: ignore[no-untyped-def]
    """The nearest point of triangle t."""
    v, w = _nearest_of_triangle(corners, t, x, y, z)
    ax, ay, az = corners[t, 0, 0], corners[t, 0, 1], corners[t, 0, 2]
    return (
        ax + v * (corners[t, 1, 0] - ax) + w * (corners[t, 2, 0] - ax),
        ay + v * (corners[t, 1, 1] - ay) + w * (corners[t, 2, 1] - ay),
        az + v * (corners[t, 1, 2] - az) + w * (corners[t, 2, 2] - az),
    )


@njit_cached
def _find_nearest(corners, low, high, child, first, last, points, distance, feet, found):  # type: ignore[no-untyped-def]
    """Fill distances, nearest points and leaf positions of the nearest triangles; see `TriangleTree`."""
    waiting = np.empty(MAX_DEPTH, np.int64)
    bound = np.empty(MAX_DEPTH)
    nearest = 0
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        # the triangle of the point before is near, as points mostly follow each other
        fx, fy, fz = _find_foot(corners, nearest, x, y, z)
        best = (x - fx) ** 2 + (y - fy) ** 2 + (z - fz) ** 2
        feet[p, 0], feet[p, 1], feet[p, 2] = fx, fy, fz
        waiting[0], bound[0], top = 0, _box_distance2(low, high, 0, x, y, z), 1
        while top > 0:
            top -= 1
            if bound[top] >= best:
                continue
            node = waiting[top]
            if child[node] > 0:
                one, other = child[node], child[node] + 1
                near, far = _box_distance2(low, high, one, x, y, z), _box_distance2(low, high, other, x, y, z)
                if far < near:
                    one, other, near, far = other, one, far, near
                if far < best:
                    waiting[top], bound[top] = other, far
                    top += 1
                if near < best:
                    waiting[top], bound[top] = one, near
                    top += 1
                continue
            for t in range(first[node], last[node]):
                fx, fy, fz = _find_foot(corners, t, x, y, z)
                square = (x - fx) ** 2 + (y - fy) ** 2 + (z - fz) ** 2
                if square < best:
                    best, nearest = square, t
                    feet[p, 0], feet[p, 1], feet[p, 2] = fx, fy, fz
        distance[p], found[p] = np.sqrt(best), nearest


def grid_winding_numbers(vertices: Array, triangles: IntArray, x: Array, y: Array, z: Array) -> IntArray:
    """Winding numbers (nx, ny, nz) of a closed mesh about the points of a grid with equal steps along each axis.

    Outward triangles wind once about the points inside. Lines through vertices and edges are moved by
    an infinitesimal length.
    """
    count = np.zeros((len(x), len(y), len(z) + 1), np.int64)
    _count_crossings(np.ascontiguousarray(vertices, dtype=float), triangles, x, y, z, count)
    return np.cumsum(count[:, :, ::-1], axis=2)[:, :, -2::-1]


@njit_inner
def _side(ax, ay, bx, by, px, py):  # type: ignore[no-untyped-def]
    """Twice the area of the triangle a, b, p, computed alike for a, b and b, a but for its sign."""
    if ax > bx or (ax == bx and ay > by):
        return -((ax - bx) * (py - by) - (ay - by) * (px - bx))
    return (bx - ax) * (py - ay) - (by - ay) * (px - ax)


@njit_inner
def _sign_of_side(side, ax, ay, bx, by):  # type: ignore[no-untyped-def]
    """The sign of a side; that of a point moved a little along x, and much less along y, if the point lies on the line a, b."""
    if side != 0.0:
        return np.sign(side)
    return np.sign(ay - by) if ay != by else np.sign(bx - ax)


@njit_inner
def _cross(a, b, c, x, y):  # type: ignore[no-untyped-def]
    """The sign of the triangle a, b, c where the line at x, y along the third axis crosses it, else 0, and the height there."""
    wc = _side(a[0], a[1], b[0], b[1], x, y)
    wa = _side(b[0], b[1], c[0], c[1], x, y)
    wb = _side(c[0], c[1], a[0], a[1], x, y)
    sa = _sign_of_side(wa, b[0], b[1], c[0], c[1])
    sb = _sign_of_side(wb, c[0], c[1], a[0], a[1])
    sc = _sign_of_side(wc, a[0], a[1], b[0], b[1])
    if sa == sb == sc and wa + wb + wc != 0.0:
        return (1 if sa > 0 else -1), (wa * a[2] + wb * b[2] + wc * c[2]) / (wa + wb + wc)
    return 0, 0.0


@njit_cached
def _wind_points(corners, low, high, child, first, last, points, found):  # type: ignore[no-untyped-def]
    """Fill the winding numbers about points; see `TriangleTree`."""
    waiting = np.empty(MAX_DEPTH, np.int64)
    for p in range(len(points)):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        waiting[0], top = 0, 1
        while top > 0:
            top -= 1
            node = waiting[top]
            if not (low[node, 0] <= x <= high[node, 0] and low[node, 1] <= y <= high[node, 1] and z <= high[node, 2]):
                continue
            if child[node] > 0:
                waiting[top], waiting[top + 1] = child[node], child[node] + 1
                top += 2
                continue
            for t in range(first[node], last[node]):
                sign, height = _cross(corners[t, 0], corners[t, 1], corners[t, 2], x, y)
                if sign != 0 and height > z:
                    found[p] += sign


@njit_cached
def _count_crossings(vertices, triangles, x, y, z, count):  # type: ignore[no-untyped-def]
    """Add to `count`, at the first grid point above each crossing of a grid line and a triangle, the sign of the latter.

    The winding number at a grid point is the sum over all crossings above it.
    """
    hx, hy, hz = x[1] - x[0], y[1] - y[0], z[1] - z[0]
    for t in range(len(triangles)):
        a, b, c = vertices[triangles[t, 0]], vertices[triangles[t, 1]], vertices[triangles[t, 2]]
        i0 = max(0, int(np.ceil((min(a[0], b[0], c[0]) - x[0]) / hx)) - 1)
        i1 = min(len(x) - 1, int(np.floor((max(a[0], b[0], c[0]) - x[0]) / hx)) + 1)
        j0 = max(0, int(np.ceil((min(a[1], b[1], c[1]) - y[0]) / hy)) - 1)
        j1 = min(len(y) - 1, int(np.floor((max(a[1], b[1], c[1]) - y[0]) / hy)) + 1)
        for i in range(i0, i1 + 1):
            for j in range(j0, j1 + 1):
                sign, height = _cross(a, b, c, x[i], y[j])
                if sign != 0:
                    k = min(max(int(np.ceil((height - z[0]) / hz)), 0), len(z))
                    count[i, j, k] += sign

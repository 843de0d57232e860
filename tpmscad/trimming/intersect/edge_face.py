"""Intersection of the edges of one network with the faces of another: all roots of C(t) = S(u, v), by bounds and Newton's method.

A piece of the edge and a cell of the face are a box in (t, u, v). With D = C - S, its Jacobian J at the middle of the box and
a bound e of the remainder of Taylor's formula, the roots lie in -J^-1 D + |rows of J^-1| e. The box is dropped if that leaves
it; if the derivatives vary so little in it that J^-1 D is injective, it holds one root at most, which Newton's method finds;
else it is divided, in t or in (u, v) alone as long as that part of it is much longer. What is left at the smallest size is a
contact without a crossing, or one along a length: it is told with its place.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from tpmscad._compiled_loops import njit_cached, njit_inner
from tpmscad._typing import Array, IntArray
from tpmscad.trimming.operands.network_tables import (
    NetworkEdges,
    NetworkFaces,
    evaluate_piece,
    grow_rows,
    is_in_region,
    is_planar,
    misses_plane,
    place_on_plane,
)
from tpmscad.trimming.operands.patch_polynomials import evaluate_face

MAX_DIVISIONS = 14
"""Halvings of a box. Curves that come nearer than 2^-28 of a cell's bulge without a crossing count as touching."""

MAX_BOXES = 100_000
"""Boxes of one edge and one face, after which they count as lying in one another."""

LENGTH_RATIO = 4.0
"""Ratio of the lengths of the two parts of a box above which the longer one alone is divided. An edge of .0065 that pierces a
face of .15 once, at 4 degrees, and then stays within .0001 of it took 10,600 boxes when all were cubes in (t, u, v)."""

INJECTIVE = 0.7
"""Bound in place of 1 in the test of injectivity."""

NEWTON_STEPS = 30
"""Newton steps of a root; convergence is quadratic in a box that passed the test."""

STEP_TOL = 1e-14
"""Step, in units of the cell and the piece, at which a root has converged."""

BORDER_MARGIN = 1e-6
"""Roots are sought this far beyond the borders, in units of the box, so that those at a border are seen from both sides."""

SAME_ROOT = 1e-9
"""Difference in units of the piece and the cell up to which two roots are one, found in adjacent boxes."""


class EdgeHits(NamedTuple):
    """The H roots of n pairs of an edge and a face, and the places (m, 3) of contacts that were not resolved.

    `pair` (H,): the row of the pair. `t` (H,), `uv` (H, 2): parameters. `touching_pair` (m,): rows of the unresolved ones, which
    lie in the loops of the face, or are too many.
    """

    pair: IntArray
    t: Array
    uv: Array
    touching_pair: IntArray
    touching: Array


def intersect_edges_with_faces(edges: NetworkEdges, faces: NetworkFaces, pairs: IntArray) -> EdgeHits:
    """All intersections of the pairs (n, 2) of an edge and a face, each once, by pair and parameter of the edge.

    Roots are sought on the whole carrier of the face, whose domain the trimming loops may cut.
    """
    found, touching = _find_roots(edges, faces, np.ascontiguousarray(pairs, np.int64))
    order = np.lexsort((found[:, 4], found[:, 3], found[:, 1], found[:, 0]))
    found = found[order]
    close = (np.diff(found[:, 0]) == 0) & (np.abs(np.diff(found[:, 1])) <= SAME_ROOT * found[1:, 2])
    close &= (np.abs(np.diff(found[:, 3:5], axis=0)) <= SAME_ROOT * found[1:, 5:7]).all(axis=1)
    found = found[np.concatenate([np.ones(min(len(found), 1), bool), ~close])]
    return EdgeHits(
        found[:, 0].astype(np.int64), found[:, 1], found[:, 3:5], touching[:, 0].astype(np.int64), touching[:, 1:]
    )


@njit_cached
def _find_roots(
    edges: NetworkEdges, faces: NetworkFaces, pairs: IntArray
) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Rows (pair, t, half of t, u, v, halves of u and v) of roots, and rows (pair, x, y, z) of unresolved contacts.

    A pair with such a contact is not looked at further.
    """
    roots, touching = np.empty((64, 7)), np.empty((16, 4))
    n_roots, n_touching = 0, 0
    stack = np.empty((24 * MAX_DIVISIONS + 8, 5))
    least = 0.5 ** (MAX_DIVISIONS + 1)
    curve, jet, own, near = np.empty((2, 3)), np.empty((3, 3)), np.empty(7), np.empty(64, np.int64)
    for k in range(len(pairs)):
        e, f = pairs[k, 0], pairs[k, 1]
        boxes, touches, n_near = 0, False, 0
        if faces.cells.first[f + 1] - faces.cells.first[f] > len(near):
            near = np.empty(faces.cells.first[f + 1] - faces.cells.first[f], np.int64)
        planar = is_planar(faces, f)
        for c in range(faces.cells.first[f], faces.cells.first[f + 1]):
            if planar:
                near[0], n_near = c, 1
                break
            outside, r = False, faces.cells.radius[c]
            for d in range(3):
                at = faces.cells.centre[c, d]
                outside = outside or at + r < edges.low[e, d] or at - r > edges.high[e, d]
            if not outside:
                near[n_near] = c
                n_near += 1
        for piece in range(edges.first_piece[e], edges.first_piece[e + 1]):
            for c in near[:n_near]:
                apart = 0.0
                for d in range(3):
                    apart += (edges.coefficients[piece, 0, d] - faces.cells.centre[c, d]) ** 2
                reach = edges.radius[piece] + faces.cells.radius[c]
                if apart > reach * reach and not planar:
                    continue
                if planar and misses_plane(faces, f, edges.coefficients[piece, 0], edges.radius[piece]):
                    continue
                stack[0, :3], stack[0, 3:] = 0.0, 1.0
                if planar:
                    place_on_plane(
                        faces, f, edges.coefficients[piece, 0], edges.radius[piece], stack[0, 1:3], stack[0, 4:]
                    )
                size = 1
                while size:
                    size -= 1
                    x, y, z = stack[size, 0], stack[size, 1], stack[size, 2]
                    wt, w = stack[size, 3], stack[size, 4]
                    boxes += 1
                    state = _examine_box(edges, faces, f, piece, c, x, y, z, wt, w, curve, jet, own)
                    if state == 0:
                        continue
                    if state == 1:
                        if n_roots == len(roots):
                            roots = grow_rows(roots)
                        own[0] = k
                        for d in range(7):
                            roots[n_roots, d] = own[d]
                        n_roots += 1
                        continue
                    if max(wt, w) <= least or boxes > MAX_BOXES:
                        u = faces.cells.middle[c, 0] + faces.cells.half[c, 0] * y
                        v = faces.cells.middle[c, 1] + faces.cells.half[c, 1] * z
                        if boxes > MAX_BOXES or is_in_region(faces.regions, f, u, v):
                            if n_touching == len(touching):
                                touching = grow_rows(touching)
                            touching[n_touching, 0] = k
                            for d in range(3):
                                touching[n_touching, 1 + d] = curve[0, d]
                            n_touching += 1
                            touches = True
                            break
                        continue
                    along = wt * edges.radius[piece]
                    across = w * faces.cells.radius[c]
                    halve_t = wt > least and (along * LENGTH_RATIO >= across or w <= least)
                    halve_uv = w > least and (across * LENGTH_RATIO >= along or wt <= least)
                    dt, duv = 0.5 * wt if halve_t else 0.0, 0.5 * w if halve_uv else 0.0
                    for i in range(8 if halve_uv else 2):
                        if not halve_t and i & 1:
                            continue
                        stack[size, 0] = x + dt * (2 * (i & 1) - 1)
                        stack[size, 1] = y + duv * (2 * ((i >> 1) & 1) - 1)
                        stack[size, 2] = z + duv * (2 * (i >> 2) - 1)
                        stack[size, 3], stack[size, 4] = wt - dt, w - duv
                        size += 1
                if touches:
                    break
            if touches:
                break
    return roots[:n_roots], touching[:n_touching]


@njit_inner
def _examine_box(
    edges: NetworkEdges,
    faces: NetworkFaces,
    f: int,
    piece: int,
    cell: int,
    x: float,
    y: float,
    z: float,
    wt: float,
    w: float,
    curve: Array,
    jet: Array,
    own: Array,
) -> int:  # pragma: no cover - compiled
    """0 if the box about (x, y, z) has no root, 1 with the root in `own`, 2 if it must be divided.

    Its half widths are wt in t, and w in u and v.
    """
    hu, hv = faces.cells.half[cell, 0], faces.cells.half[cell, 1]
    mu, mv = faces.cells.middle[cell, 0], faces.cells.middle[cell, 1]
    tx2, ty2, tz2 = edges.bend[piece, 0], edges.bend[piece, 1], edges.bend[piece, 2]
    bt = np.sqrt(tx2 * tx2 + ty2 * ty2 + tz2 * tz2)
    buu, buv, bvv = faces.cells.bend[cell, 0], faces.cells.bend[cell, 1], faces.cells.bend[cell, 2]
    evaluate_piece(edges, piece, x, curve)
    evaluate_face(faces.patches, f, mu + hu * y, mv + hv * z, jet)
    ux, uy, uz = jet[1, 0] * hu, jet[1, 1] * hu, jet[1, 2] * hu
    vx, vy, vz = jet[2, 0] * hv, jet[2, 1] * hv, jet[2, 2] * hv
    tx, ty, tz = curve[1, 0], curve[1, 1], curve[1, 2]
    dx, dy, dz = curve[0, 0] - jet[0, 0], curve[0, 1] - jet[0, 1], curve[0, 2] - jet[0, 2]
    noise = 1e-14 * (abs(curve[0, 0]) + abs(curve[0, 1]) + abs(curve[0, 2]))
    of_face = w * w * (0.5 * buu + buv + 0.5 * bvv) + noise
    rest = of_face + 0.5 * wt * wt * bt
    along, side = wt * (1.0 + BORDER_MARGIN), w * (1.0 + BORDER_MARGIN)
    u, v = np.sqrt(ux * ux + uy * uy + uz * uz), np.sqrt(vx * vx + vy * vy + vz * vz)
    reach = along * np.sqrt(tx * tx + ty * ty + tz * tz) + side * (u + v) + rest
    if dx * dx + dy * dy + dz * dz > reach * reach:
        return 0
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    area = np.sqrt(nx * nx + ny * ny + nz * nz)
    rise = tx * nx + ty * ny + tz * nz
    off = (
        0.5 * wt * wt * (abs(nx) * tx2 + abs(ny) * ty2 + abs(nz) * tz2) + of_face * area
    )  # of planes 0, if the edge is parallel
    if abs(dx * nx + dy * ny + dz * nz) > along * abs(rise) + off:
        return 0
    # rows of J^-1 for J = [C', -S_u, -S_v]
    ax, ay, az = nx / rise, ny / rise, nz / rise
    bx, by, bz = (ty * vz - tz * vy) / rise, (tz * vx - tx * vz) / rise, (tx * vy - ty * vx) / rise
    cx, cy, cz = (uy * tz - uz * ty) / rise, (uz * tx - ux * tz) / rise, (ux * ty - uy * tx) / rise
    a, b, c = (
        np.sqrt(ax * ax + ay * ay + az * az),
        np.sqrt(bx * bx + by * by + bz * bz),
        np.sqrt(cx * cx + cy * cy + cz * cz),
    )
    r0 = -(ax * dx + ay * dy + az * dz)
    r1 = -(bx * dx + by * dy + bz * dz)
    r2 = -(cx * dx + cy * dy + cz * dz)
    if not (a < 1e12):
        return 2
    if abs(r0) > along + a * rest or abs(r1) > side + b * rest or abs(r2) > side + c * rest:
        return 0
    vary = wt * bt + w * (buu + 2.0 * buv + bvv)
    if max(a, b, c) * vary > INJECTIVE:
        return 2
    p, q, s = x, y, z
    for _ in range(NEWTON_STEPS):
        p, q, s = p + r0, q + r1, s + r2
        if abs(p - x) > 3.0 * wt or abs(q - y) > 3.0 * w or abs(s - z) > 3.0 * w:
            return 2
        moved = max(abs(r0), abs(r1), abs(r2))
        evaluate_piece(edges, piece, p, curve)
        evaluate_face(faces.patches, f, mu + hu * q, mv + hv * s, jet)
        dx, dy, dz = curve[0, 0] - jet[0, 0], curve[0, 1] - jet[0, 1], curve[0, 2] - jet[0, 2]
        ux, uy, uz = jet[1, 0] * hu, jet[1, 1] * hu, jet[1, 2] * hu
        vx, vy, vz = jet[2, 0] * hv, jet[2, 1] * hv, jet[2, 2] * hv
        tx, ty, tz = curve[1, 0], curve[1, 1], curve[1, 2]
        nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        rise = tx * nx + ty * ny + tz * nz
        r0 = -(dx * nx + dy * ny + dz * nz) / rise
        r1 = -(dx * (ty * vz - tz * vy) + dy * (tz * vx - tx * vz) + dz * (tx * vy - ty * vx)) / rise
        r2 = -(dx * (uy * tz - uz * ty) + dy * (uz * tx - ux * tz) + dz * (ux * ty - uy * tx)) / rise
        step = max(abs(r0), abs(r1), abs(r2))
        if step < STEP_TOL or (step >= moved and step < 1e3 * STEP_TOL):
            if abs(p - x) > along or abs(q - y) > side or abs(s - z) > side:
                return 0
            own[1], own[2] = edges.middle[piece] + edges.half[piece] * p, edges.half[piece]
            own[3], own[4] = mu + hu * q, mv + hv * s
            own[5], own[6] = hu, hv
            return 1
    return 2

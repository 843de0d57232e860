"""Seeds of the curves that two faces have in common and that no edge meets, found by exclusion.

A closed curve surrounds, on each of two faces, a point with a normal that is parallel to one within it on the other: most pairs
of faces have none. A closed curve also has a point at which its tangent, the product of both normals, is perpendicular to any
direction that is given. For two faces the direction is that of the known curves, or of the tangent where they meet on average,
so that few cells remain. Two cells, one of each face, are dropped if the tangent is nowhere perpendicular to it, or if they are
apart along a normal of one of them, or along the curve. Where the derivatives vary so little in them that a curve passes once at
most, the point on it is found by Newton's method; it lies on a curve that is known, or is the seed of a closed one. Else both
cells are divided.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached, njit_inner
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.trimming.intersect.common_points import (
    MIN_SINE,
    Work,
    copy_point,
    correct_point,
    find_tangent,
    meets,
    pass_fraction,
    solve_four,
)
from tpmscad.trimming.operands.network_tables import (
    FaceCells,
    NetworkFaces,
    is_in_region,
    is_planar,
    misses_plane,
    place_on_plane,
)
from tpmscad.trimming.operands.patch_polynomials import PatchPolynomials, evaluate_face

MAX_DIVISIONS = 8
"""Halvings of two cells. What still is not resolved touches within 2^-16 of their bulge, without a crossing that is known."""

MAX_BOXES = 200_000
"""Pairs of cells of two faces, after which these count as lying in one another."""

INJECTIVE = 0.7
"""Bound in place of 1 in the test that a curve passes two cells once at most."""

SEED_REACH = 1.5
"""Half width, in cells, within which a point found for two cells is examined."""

FOUND, NONE, UNRESOLVED = range(3)
"""Outcomes of a search: a seed; no seed in any pair; a contact without a crossing that is known."""

APART, CROSSING, UNDECIDED, SINGLE = range(4)
"""Outcomes of the test of two cells."""


@njit_inner
def _is_known(
    patches: PatchPolynomials,
    f: int,
    g: int,
    of_pair: IntArray,
    pair: int,
    bounds: IntArray,
    points: Array,
    places: Array,
    match_tol: float,
    work: Work,
) -> bool:  # pragma: no cover - compiled
    """Whether the first of the places lies on one of the known curves of a pair, as `find_seed` gets them."""
    for k in range(of_pair[pair], of_pair[pair + 1]):
        for row in range(bounds[k], bounds[k + 1] - 1):
            ahead = pass_fraction(points, row, places, np.int64(0))
            if ahead > 0.0 and meets(patches, f, g, points, row, ahead, places, np.int64(0), match_tol, work):
                return True
    return False


@njit_cached
def list_searched_pairs(faces: NetworkFaces, pairs: IntArray) -> IntArray:  # pragma: no cover - compiled
    """The rows (n,) of pairs of faces that may have closed curves in common."""
    cells = faces.cells
    result, n = np.empty(len(pairs), np.int64), 0
    near, counts = np.empty((2, np.diff(cells.first).max()), np.int64), np.empty(2, np.int64)
    for k in range(len(pairs)):
        f, g = pairs[k, 0], pairs[k, 1]
        counts[0] = _list_near_cells(faces, f, g, near[0])
        counts[1] = _list_near_cells(faces, g, f, near[1])
        if counts.min() > 0 and _may_be_parallel(cells, f, g, near, counts):
            result[n] = k
            n += 1
    return result[:n]


@njit_cached
def find_seed(
    faces: NetworkFaces,
    pairs: IntArray,
    begin: int,
    of_pair: IntArray,
    bounds: IntArray,
    points: Array,
    seed: Array,
    beside: BoolArray,
    match_tol: float,
    work: Work,
) -> tuple[int, int]:  # pragma: no cover - compiled
    """FOUND and the next pair from `begin` on with a `seed` (4,) on no known curve; NONE and len(pairs) if there is none.

    The pairs are those of `list_searched_pairs`. The seed lies in the loops of both faces; `beside` (n,) is set for pairs that
    may have others, beyond their loops. UNRESOLVED and the pair for a contact that is not resolved. Pair k has the curves
    of_pair[k] to of_pair[k + 1] - 1, and curve c has the points bounds[c] to bounds[c + 1] - 1.
    """
    stack = np.empty((8 * MAX_DIVISIONS + 16, 6))
    origin, normal, box, across = np.empty((1, 3)), np.empty(3), np.empty(4), np.empty(3)
    cells = faces.cells
    near, counts = np.empty((2, np.diff(cells.first).max()), np.int64), np.empty(2, np.int64)
    for k in range(begin, len(pairs)):
        f, g = pairs[k, 0], pairs[k, 1]
        counts[0] = _list_near_cells(faces, f, g, near[0])
        counts[1] = _list_near_cells(faces, g, f, near[1])
        _choose_direction(cells, near, counts, across)
        _take_chords(of_pair, k, bounds, points, across)
        boxes = 0
        for a in near[0, : counts[0]]:
            for b in near[1, : counts[1]]:
                apart, along = 0.0, 0.0
                for d in range(3):
                    apart += (cells.centre[a, d] - cells.centre[b, d]) ** 2
                    e, h = (d + 1) % 3, (d + 2) % 3
                    along += across[d] * (
                        cells.normal[a, e] * cells.normal[b, h] - cells.normal[a, h] * cells.normal[b, e]
                    )
                reach = cells.radius[a] + cells.radius[b]
                is_apart = apart > reach * reach and not is_planar(faces, f) and not is_planar(faces, g)
                if is_apart or abs(along) > cells.turn[a] + cells.turn[b]:
                    continue
                if is_planar(faces, f) and misses_plane(faces, f, cells.centre[b], cells.radius[b]):
                    continue
                if is_planar(faces, g) and misses_plane(faces, g, cells.centre[a], cells.radius[a]):
                    continue
                for c in range(4):
                    stack[0, c] = 0.0
                stack[0, 4], stack[0, 5] = 1.0, 1.0
                if is_planar(faces, f):
                    place_on_plane(faces, f, cells.centre[b], cells.radius[b], stack[0, :2], stack[0, 4:5])
                if is_planar(faces, g):
                    place_on_plane(faces, g, cells.centre[a], cells.radius[a], stack[0, 2:4], stack[0, 5:])
                size = 1
                while size:
                    size -= 1
                    w, x = stack[size, 4], stack[size, 5]
                    for c in range(4):
                        box[c] = stack[size, c]
                    boxes += 1
                    state = _examine_cells(
                        faces.patches, f, g, cells, a, b, box, w, x, across, seed, origin, normal, work
                    )
                    if state == APART:
                        continue
                    if state == CROSSING:
                        if _is_known(faces.patches, f, g, of_pair, k, bounds, points, origin, match_tol, work):
                            continue
                        in_regions = is_in_region(faces.regions, f, seed[0], seed[1])
                        if in_regions and is_in_region(faces.regions, g, seed[2], seed[3]):
                            return FOUND, k
                        beside[k] = True
                        continue
                    divide_first = w * cells.radius[a] > x * cells.radius[b]
                    if (w if divide_first else x) < 2.0**-MAX_DIVISIONS or boxes > MAX_BOXES:
                        if state == UNDECIDED:
                            state = _settle_smallest_box(
                                faces,
                                f,
                                g,
                                a,
                                b,
                                box,
                                w,
                                x,
                                of_pair,
                                k,
                                bounds,
                                points,
                                seed,
                                origin,
                                normal,
                                match_tol,
                                work,
                            )
                            if state == CROSSING:
                                return FOUND, k
                            if state == UNDECIDED:
                                return UNRESOLVED, k
                            beside[k] = True
                        continue
                    shift = 0 if divide_first else 2
                    half = 0.5 * (w if divide_first else x)
                    for i in range(4):
                        for c in range(4):
                            stack[size, c] = box[c]
                        stack[size, shift] += half * (2 * (i & 1) - 1)
                        stack[size, shift + 1] += half * (2 * (i >> 1) - 1)
                        stack[size, 4], stack[size, 5] = (half, x) if divide_first else (w, half)
                        size += 1
    return NONE, len(pairs)


@njit_inner
def _list_near_cells(faces: NetworkFaces, f: int, g: int, near: IntArray) -> int:  # pragma: no cover - compiled
    """Write the cells of a face that meet the box of another one, the first for all of a plane; returns how many there are."""
    cells, count = faces.cells, 0
    if is_planar(faces, f) and cells.first[f + 1] > cells.first[f]:
        near[0] = cells.first[f]
        return 1
    for a in range(cells.first[f], cells.first[f + 1]):
        outside = False
        for d in range(3):
            at, r = cells.centre[a, d], cells.radius[a]
            outside = outside or at + r < faces.low[g, d] or at - r > faces.high[g, d]
        if not outside:
            near[count] = a
            count += 1
    return count


@njit_inner
def _may_be_parallel(
    cells: FaceCells, f: int, g: int, near: IntArray, counts: IntArray
) -> bool:  # pragma: no cover - compiled
    """Whether a normal of one face may be parallel to one of the other, within closed curves through the cells `near`.

    A closed curve of two faces surrounds, on each of them, a point with a normal that is parallel to one within it on the other
    (Sinha, Klassen and Wang 1985). What it surrounds lies in the rectangle of parameters about the cells that it passes.
    """
    bound = np.empty((2, 4))
    for side in range(2):
        for d in range(2):
            low, high = np.inf, -np.inf
            for a in near[side, : counts[side]]:
                low, high = min(low, cells.middle[a, d]), max(high, cells.middle[a, d])
            bound[side, d], bound[side, 2 + d] = low, high
    for a in range(cells.first[f], cells.first[f + 1]):
        if _is_outside(cells, a, bound[0]):
            continue
        for b in range(cells.first[g], cells.first[g + 1]):
            if _is_outside(cells, b, bound[1]):
                continue
            square, turn = 0.0, cells.turn[a] + cells.turn[b]
            for d in range(3):
                e, h = (d + 1) % 3, (d + 2) % 3
                square += (cells.normal[a, e] * cells.normal[b, h] - cells.normal[a, h] * cells.normal[b, e]) ** 2
            if square <= turn * turn:
                return True
    return False


@njit_inner
def _is_outside(cells: FaceCells, a: int, bound: Array) -> bool:  # pragma: no cover - compiled
    """Whether the middle of a cell lies outside a rectangle (4,)."""
    u, v = cells.middle[a, 0], cells.middle[a, 1]
    return u < bound[0] or v < bound[1] or u > bound[2] or v > bound[3]


@njit_inner
def _choose_direction(
    cells: FaceCells, near: IntArray, counts: IntArray, across: Array
) -> None:  # pragma: no cover - compiled
    """Write a unit vector to which the tangent of a common curve in the cells `near` of both faces is rarely perpendicular."""
    mean = np.zeros((2, 3))
    for side in range(2):
        for i in range(counts[side]):
            for d in range(3):
                mean[side, d] += cells.normal[near[side, i], d]
        length = np.sqrt((mean[side] ** 2).sum())
        for d in range(3):
            mean[side, d] = mean[side, d] / length if length > 0.0 else 1.0 * (d == side)
    square = 0.0
    for d in range(3):
        e, h = (d + 1) % 3, (d + 2) % 3
        across[d] = mean[0, e] * mean[1, h] - mean[0, h] * mean[1, e]
        square += across[d] * across[d]
    if square < 1e-20:  # any direction in both faces will do
        least = np.argmin(np.abs(mean[0]))
        for d in range(3):
            across[d] = (1.0 if d == least else 0.0) - mean[0, least] * mean[0, d]
        square = (across**2).sum()
    for d in range(3):
        across[d] /= np.sqrt(square)


@njit_inner
def _take_chords(
    of_pair: IntArray, pair: int, bounds: IntArray, points: Array, across: Array
) -> None:  # pragma: no cover - compiled
    """Write the direction of the chords of the known curves of a pair, to which these rarely are perpendicular."""
    chord = np.zeros(3)
    for k in range(of_pair[pair], of_pair[pair + 1]):
        for d in range(3):
            step = points[bounds[k + 1] - 1, d] - points[bounds[k], d]
            chord[d] += step
    length = np.sqrt((chord**2).sum())
    if length > 0.0:
        for d in range(3):
            across[d] = chord[d] / length


@njit_inner
def _settle_smallest_box(
    faces: NetworkFaces,
    f: int,
    g: int,
    a: int,
    b: int,
    box: Array,
    w: float,
    x: float,
    of_pair: IntArray,
    pair: int,
    bounds: IntArray,
    points: Array,
    seed: Array,
    origin: Array,
    normal: Array,
    match_tol: float,
    work: Work,
) -> int:  # pragma: no cover - compiled
    """The outcome for parts of two cells that are divided no further: where a patch is singular no bound decides.

    CROSSING with a `seed` on no known curve, UNDECIDED if neither a point nor a known curve is found near by, with the place in
    the jet of the first face; else SINGLE.
    """
    cells = faces.cells
    hu, hv, hs, hr = cells.half[a, 0], cells.half[a, 1], cells.half[b, 0], cells.half[b, 1]
    u, v = cells.middle[a, 0] + hu * box[0], cells.middle[a, 1] + hv * box[1]
    s, r = cells.middle[b, 0] + hs * box[2], cells.middle[b, 1] + hr * box[3]
    if not (is_in_region(faces.regions, f, u, v) and is_in_region(faces.regions, g, s, r)):
        return SINGLE
    evaluate_face(faces.patches, f, u, v, work.jet_f)
    evaluate_face(faces.patches, g, s, r, work.jet_g)
    sine = find_tangent(faces.patches, f, g, work)
    reach, apart = 0.0, 0.0
    for d in range(3):
        reach += w * (abs(work.jet_f[1, d]) * hu + abs(work.jet_f[2, d]) * hv)
        reach += x * (abs(work.jet_g[1, d]) * hs + abs(work.jet_g[2, d]) * hr)
        apart += abs(work.jet_f[0, d] - work.jet_g[0, d])
        origin[0, d] = 0.5 * (work.jet_f[0, d] + work.jet_g[0, d])
        work.place[d], normal[d] = origin[0, d], work.tangent[d]
    bend = w * w * (cells.bend[a, 0] + cells.bend[a, 1] + cells.bend[a, 2])
    reach = 4.0 * (reach + bend + x * x * (cells.bend[b, 0] + cells.bend[b, 1] + cells.bend[b, 2]) + apart)
    seed[0], seed[1], seed[2], seed[3] = u, v, s, r
    if sine > MIN_SINE and correct_point(faces.patches, f, g, seed, work.place, normal, work):
        moved = 0.0
        for d in range(3):
            moved = max(moved, abs(work.jet_f[0, d] - origin[0, d]))
        if moved < reach:
            if not (
                is_in_region(faces.regions, f, seed[0], seed[1]) and is_in_region(faces.regions, g, seed[2], seed[3])
            ):
                return SINGLE
            copy_point(work.jet_f, origin, 0)
            known = _is_known(faces.patches, f, g, of_pair, pair, bounds, points, origin, match_tol, work)
            return SINGLE if known else CROSSING
    for row in range(bounds[of_pair[pair]], bounds[of_pair[pair + 1]] - 1):
        square, along, arm = 0.0, 0.0, 0.0
        for d in range(3):
            chord, way = points[row + 1, d] - points[row, d], origin[0, d] - points[row, d]
            square, along, arm = square + chord * chord, along + chord * way, arm + way * way
        ahead = min(max(along / max(square, 1e-300), 0.0), 1.0)
        if arm - 2.0 * ahead * along + ahead * ahead * square < reach * reach:
            return SINGLE
    evaluate_face(faces.patches, f, u, v, work.jet_f)
    return UNDECIDED


@njit_inner
def _examine_cells(
    patches: PatchPolynomials,
    f: int,
    g: int,
    cells: FaceCells,
    a: int,
    b: int,
    box: Array,
    w: float,
    x: float,
    across: Array,
    seed: Array,
    origin: Array,
    normal: Array,
    work: Work,
) -> int:  # pragma: no cover - compiled
    """APART without a common point where a curve is perpendicular to `across`, CROSSING with one in `seed` and `origin`.

    SINGLE for one curve at most, else UNDECIDED.
    """
    hu, hv = cells.half[a, 0], cells.half[a, 1]
    hs, hr = cells.half[b, 0], cells.half[b, 1]
    u, v = cells.middle[a, 0] + hu * box[0], cells.middle[a, 1] + hv * box[1]
    s, r = cells.middle[b, 0] + hs * box[2], cells.middle[b, 1] + hr * box[3]
    evaluate_face(patches, f, u, v, work.jet_f)
    evaluate_face(patches, g, s, r, work.jet_g)
    sine = find_tangent(patches, f, g, work)
    p, q = work.jet_f, work.jet_g
    uu, uv, vv = cells.bend[a, 0], cells.bend[a, 1], cells.bend[a, 2]
    ss, sr, rr = cells.bend[b, 0], cells.bend[b, 1], cells.bend[b, 2]
    rest = w * w * (0.5 * (uu + vv) + uv) + x * x * (0.5 * (ss + rr) + sr)
    if not _is_perpendicular(p, q, w, x, (hu, hv, hs, hr), (uu, uv, vv), (ss, sr, rr), across):
        return APART
    for axis in range(3):
        if axis == 0:
            _cross(p, normal)
        elif axis == 1:
            _cross(q, normal)
        else:
            if not sine > 0.0:
                break
            for d in range(3):
                normal[d] = work.tangent[d]
        apart, reach, length = 0.0, 0.0, 0.0
        gu, gv, gs, gr, shift = 0.0, 0.0, 0.0, 0.0, 0.0
        for d in range(3):
            apart += (p[0, d] - q[0, d]) * normal[d]
            gu += p[1, d] * normal[d]
            gv += p[2, d] * normal[d]
            gs += q[1, d] * normal[d]
            gr += q[2, d] * normal[d]
            length += normal[d] * normal[d]
            shift += abs(p[0, d] * normal[d])
        reach = w * (abs(gu) * hu + abs(gv) * hv) + x * (abs(gs) * hs + abs(gr) * hr)
        if abs(apart) > (1.0 + 1e-6) * reach + rest * np.sqrt(length) + 1e-14 * shift:
            return APART
    if sine < MIN_SINE:
        return UNDECIDED
    # columns of the inverse of the map (parameters) -> (difference, coordinate along the curve), in units of the cells
    size, along = 0.0, 0.0
    for c in range(4):
        for k in range(4):
            jet, h = p if k < 2 else q, (hu, hv, hs, hr)[k]
            work.system[3, k] = 0.0
            for d in range(3):
                work.system[d, k] = h * jet[1 + k % 2, d] if k < 2 else -h * jet[1 + k % 2, d]
                work.system[3, k] += 0.5 * h * jet[1 + k % 2, d] * work.tangent[d]
            work.system[k, 4] = 1.0 if k == c else 0.0
        if not solve_four(work.system):
            return UNDECIDED
        along = 0.0
        for k in range(4):
            along = max(along, abs(work.system[k, 4]))
        size += along * along if c < 3 else 0.0
    vary = w * (uu + 2.0 * uv + vv) + x * (ss + 2.0 * sr + rr)
    if (np.sqrt(size) + 0.5 * along) * vary > INJECTIVE:
        return UNDECIDED
    for d in range(3):
        work.place[d], normal[d] = 0.5 * (p[0, d] + q[0, d]), work.tangent[d]
    seed[0], seed[1], seed[2], seed[3] = u, v, s, r
    if not correct_point(patches, f, g, seed, work.place, normal, work):
        return SINGLE
    if abs(seed[0] - u) > SEED_REACH * w * hu or abs(seed[1] - v) > SEED_REACH * w * hv:
        return SINGLE
    if abs(seed[2] - s) > SEED_REACH * x * hs or abs(seed[3] - r) > SEED_REACH * x * hr:
        return SINGLE
    copy_point(work.jet_f, origin, 0)
    return CROSSING


@njit_inner
def _is_perpendicular(
    p: Array,
    q: Array,
    w: float,
    x: float,
    halves: tuple[float, float, float, float],
    bend_p: tuple[float, float, float],
    bend_q: tuple[float, float, float],
    across: Array,
) -> bool:  # pragma: no cover - compiled
    """Whether the product of the normals S_u x S_v of parts of two cells may be perpendicular to a vector."""
    along, area_p, area_q, pu, pv, qu, qv = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for d in range(3):
        pu, pv, qu, qv = pu + p[1, d] ** 2, pv + p[2, d] ** 2, qu + q[1, d] ** 2, qv + q[2, d] ** 2
    nx, ny, nz = _normal(p)
    mx, my, mz = _normal(q)
    area_p, area_q = np.sqrt(nx * nx + ny * ny + nz * nz), np.sqrt(mx * mx + my * my + mz * mz)
    along = across[0] * (ny * mz - nz * my) + across[1] * (nz * mx - nx * mz) + across[2] * (nx * my - ny * mx)
    hu, hv, hs, hr = halves
    scale_p, scale_q = hu * hv, hs * hr
    vary_p = w * _bound_turn(hu * np.sqrt(pu), hv * np.sqrt(pv), w, bend_p)
    vary_q = x * _bound_turn(hs * np.sqrt(qu), hr * np.sqrt(qv), x, bend_q)
    area_p, area_q = scale_p * area_p, scale_q * area_q
    return scale_p * scale_q * abs(along) <= vary_p * (area_q + vary_q) + area_p * vary_q


@njit_inner
def _bound_turn(
    along: float, side: float, w: float, bend: tuple[float, float, float]
) -> float:  # pragma: no cover - compiled
    """Bound of the rate at which S_u x S_v varies in a part of a cell of half width w; lengths of S_u and S_v at its middle."""
    uu, uv, vv = bend
    return (uu + uv) * (side + w * (uv + vv)) + (uv + vv) * (along + w * (uu + uv))


@njit_inner
def _normal(jet: Array) -> tuple[float, float, float]:  # pragma: no cover - compiled
    """S_u x S_v."""
    return (
        jet[1, 1] * jet[2, 2] - jet[1, 2] * jet[2, 1],
        jet[1, 2] * jet[2, 0] - jet[1, 0] * jet[2, 2],
        jet[1, 0] * jet[2, 1] - jet[1, 1] * jet[2, 0],
    )


@njit_inner
def _cross(jet: Array, out: Array) -> None:  # pragma: no cover - compiled
    """Write S_u x S_v."""
    out[0], out[1], out[2] = _normal(jet)

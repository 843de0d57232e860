"""Curves and patches of a net fitted to a level set, all at once, joining with tangent continuity through the field's gradient.

A curve is fitted first, with the field's normals along it: its ends tangent to the surface, its own tangent orthogonal to the
normals. The patches on both sides take its poles and are asked, in the same least squares that place their inner poles, to have a
derivative across the border orthogonal to the same normals; so they meet smoothly though neither knows the other. Distances
along the normal count fully, along the surface (where a point of the patch lies matters little) with the weight `SLIDE`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.inside import Inside
from tpmscad.patches.levelset.layout.net import Net
from tpmscad.patches.levelset.layout.octree import Array, Ints, Mask
from tpmscad.patches.levelset.layout.relax import onto
from tpmscad.patches.levelset.period import Copies, no_copies
from tpmscad.patches.levelset.work import PIECE, Work, here
from tpmscad.splines.bspline import design

SLIDE = 0.3
CURVE_TANGENT = 1.0
END_TANGENT = 1e3
CROSS = 1.0
PASSES = 2

CLEAR = 0.3
"""Curves that would leave the box keep this part of their ends' distance from its faces: where the surface grazes a face, the
straight way between two vertices leads beyond it, across the surface's section there."""


@dataclass(frozen=True, slots=True, eq=False)
class NetFit:
    """Bezier poles on [0, 1]: `curves[i]` (p + 1, 3) and `patches[i]` (p + 1, q + 1, 3); copies are moved, not fitted."""

    curves: list[Array]
    patches: list[Array]
    copies: Copies


def bezier(degree: int, t: Array, order: int = 0) -> Array:
    """Bernstein polynomials of the degree on [0, 1], or derivatives, at t: (n, degree + 1)."""
    return design(np.repeat([0.0, 1.0], degree + 1), degree, t, order)


def fit_net(
    net: Net,
    field: Field,
    curve_degree: Ints,
    patch_degree: Ints,
    before: tuple[NetFit, Mask, Mask] | None = None,
    work: Work = here,
    copies: Copies | None = None,
) -> NetFit:
    """Fit every curve with its degree (C,), then every patch with its degree (Q,), raised where its sides' are higher.

    `before`: an earlier fit of the net, and the curves (C,) and patches (Q,) of it to be fitted anew; the others are kept.
    `copies`: what repeats in the net (nothing if neither is given); copies must have the degrees of what they are copies of.
    """
    copies = copies or (before[0].copies if before else no_copies(len(net.ends), len(net.curve)))
    curves = list(before[0].curves) if before else [np.empty(0)] * len(net.ends)
    anew = copies.own_curves & (before[1] if before else True)
    main, spokes = np.flatnonzero(anew[: net.n_sides]), net.n_sides + np.flatnonzero(anew[net.n_sides :])
    of_copies = np.flatnonzero(~copies.own_curves)
    group_copies = of_copies[of_copies < net.n_sides], of_copies[of_copies >= net.n_sides]
    start = net.vertices[net.ends[:, 0]]
    end = net.vertices[net.ends[:, 1]]
    for group in (main, spokes):
        if group is spokes and len(spokes):
            start[spokes] = [_middle(curves[c]) for c in net.middle_of[spokes - net.n_sides]]
        for degree in np.unique(curve_degree[group]):
            at = group[curve_degree[group] == degree]
            fixed = np.zeros((len(net.ends), 3), bool)
            on_box = at[net.plane[at] >= 0]
            fixed[on_box, net.plane[on_box] // 2] = True
            parts = _pieces(at)
            done = work(fit_curves, [(field, start[part], end[part], fixed[part], int(degree)) for part in parts])
            for part, found in zip(parts, done, strict=True):
                for i, poles in zip(part, found, strict=True):
                    curves[i] = poles.copy()  # Dask hands out arrays in read-only memory, which scipy refuses
        for i in group_copies[group is spokes]:
            curves[i] = curves[copies.curve[i]] + copies.curve_shift[i]

    side_degree = curve_degree[net.curve]
    degrees = np.stack(
        [np.maximum(patch_degree, side_degree[:, 0::2].max(1)), np.maximum(patch_degree, side_degree[:, 1::2].max(1))],
        1,
    )
    patches = list(before[0].patches) if before else [np.empty(0)] * len(net.curve)
    wanted = np.flatnonzero(copies.own_patches & (before[2] if before else True))
    tasks, parts = [], []
    for degree_u, degree_v in np.unique(degrees[wanted], axis=0):
        for part in _pieces(wanted[(degrees[wanted] == (degree_u, degree_v)).all(axis=1)]):
            border = [_borders(net, curves, part, s, int((degree_u, degree_v)[s % 2])) for s in range(4)]
            tasks.append((field, border, net.plane[net.curve[part]] < 0))
            parts.append(part)
    for part, found in zip(parts, work(fit_patches, tasks), strict=True):
        for i, poles in zip(part, found, strict=True):
            patches[i] = poles.copy()
    for i in np.flatnonzero(~copies.own_patches):
        patches[i] = patches[copies.patch[i]] + copies.patch_shift[i]
    return NetFit(curves, patches, copies)


def _pieces(numbers: Ints) -> list[Ints]:
    return [numbers[i : i + PIECE] for i in range(0, len(numbers), PIECE)]


def fit_curves(field: Field, start: Array, end: Array, fixed: Mask, degree: int) -> Array:
    """Curves on the level set between points (n, 3) of it, in planes of the box where coordinates are `fixed`: (n, p + 1, 3)."""
    t = np.linspace(0.0, 1.0, 2 * degree + 4)
    reach = 0.3 * np.linalg.norm(end - start, axis=1)
    straight = start[:, None] + t[:, None] * (end - start)[:, None]
    points = straight
    for _ in range(2):
        points = _evenly(_between(field, points, straight, fixed, reach), t)
    points = _between(field, points, straight, fixed, reach)

    values, slopes = bezier(degree, t), bezier(degree, t, 1)
    share = np.arange(degree + 1)[:, None] / degree
    poles = (1 - share) * start[:, None] + share * end[:, None]
    inner = slice(1, degree)
    for turn in range(PASSES):
        if turn:
            points = _between(field, values @ poles, straight, fixed, reach)
        normal = _normals(field, points, fixed)
        slope = slopes @ poles
        system = _System(degree - 1, len(start))
        system.near(values[:, inner], normal, points - values @ poles, SLIDE)
        system.along(slopes[:, inner], normal, -slope, CURVE_TANGENT / len(t))
        system.along(slopes[[0, -1]][:, inner], normal[:, [0, -1]], -slope[:, [0, -1]], END_TANGENT)
        poles[:, inner] += system.solved()
    rows, axis = np.nonzero(fixed)
    poles[rows, :, axis] = start[rows, axis][:, None]
    return poles


def fit_patches(field: Field, border: list[Array], joined: Mask) -> Array:
    """Patches between their four borders, each (n, degree + 1, 3) run counter-clockwise: (n, p + 1, q + 1, 3).

    `joined` (n, 4): sides across which the surface goes on; on the others, in the box's faces, nothing is asked of the slope.
    """
    poles = _coons(border)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    u, v = (np.linspace(0.0, 1.0, d + 5)[1:-1] for d in (p, q))
    bu, bv = bezier(p, u), bezier(q, v)
    inner = np.einsum("ai,bj->abij", bu[:, 1:-1], bv[:, 1:-1]).reshape(len(u) * len(v), -1)
    size = np.linalg.norm(poles[:, 0, 0] - poles[:, -1, -1], axis=1)
    free = np.zeros((len(poles), 3), bool)
    for _ in range(PASSES):
        # corrections are solved for, not poles: small next to the coordinates, they keep all their digits
        points = tensor(bu, poles, bv)
        target = _onto(field, points, free, 0.3 * size)
        system = _System((p - 1) * (q - 1), len(poles))
        system.near(inner, _normals(field, target), target - points, SLIDE)
        for side, inside in enumerate(joined.T):
            basis, slope, normal = _crossing(field, poles, side)
            system.along(basis, normal * inside[:, None, None], -slope, CROSS / np.sqrt(len(basis)))
        poles[:, 1:-1, 1:-1] += system.solved().reshape(len(poles), p - 1, q - 1, 3)
    return poles


def _crossing(field: Field, poles: Array, side: int) -> tuple[Array, Array, Array]:
    """Along a side: the inner poles' part in the derivative across it (m, inner), that derivative and the normals (n, m, 3)."""
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    along, across = (p, q) if side in (0, 2) else (q, p)
    t = np.linspace(0.0, 1.0, along + 5)[1:-1]
    values = bezier(along, t)
    slope = bezier(across, np.array([1.0 if side in (1, 2) else 0.0]), 1)
    ends = bezier(across, np.array([1.0 if side in (1, 2) else 0.0]))
    if side in (0, 2):
        basis = np.einsum("ai,bj->abij", values[:, 1:-1], slope[:, 1:-1])
        across_it, points = tensor(values, poles, slope), tensor(values, poles, ends)
    else:
        basis = np.einsum("bi,aj->abij", slope[:, 1:-1], values[:, 1:-1])
        across_it, points = tensor(slope, poles, values), tensor(ends, poles, values)
    return basis.reshape(len(t), -1), across_it, _normals(field, points)


class _System:
    """Normal equations of many small least squares for poles (n, unknowns, 3), rows with a common basis and own directions."""

    def __init__(self, unknowns: int, count: int) -> None:
        self.matrix = np.zeros((count, 3, 3, unknowns, unknowns))
        self.right = np.zeros((count, unknowns, 3))

    def near(self, basis: Array, normal: Array, target: Array, slide: float) -> None:
        """basis (m, unknowns) times poles near the target (n, m, 3): weight 1 along the normal, `slide` across."""
        metric = (1 - slide**2) * normal[..., :, None] * normal[..., None, :] + slide**2 * np.eye(3)
        self._add(basis, metric, np.einsum("nmij,nmj->nmi", metric, target), 1.0)

    def along(self, basis: Array, normal: Array, target: Array, weight: float) -> None:
        """The component along the normal only, with that weight."""
        metric = normal[..., :, None] * normal[..., None, :]
        self._add(basis, metric, np.einsum("nmij,nmj->nmi", metric, target), weight)

    def _add(self, basis: Array, metric: Array, pulled: Array, weight: float) -> None:
        m, k = basis.shape
        products = (basis[:, :, None] * basis[:, None, :]).reshape(m, k * k) * weight**2
        count = len(self.matrix)
        for i in range(3):
            for j in range(i, 3):
                block = (metric[..., i, j].reshape(count, m) @ products).reshape(count, k, k)
                self.matrix[:, i, j] += block
                if i != j:
                    self.matrix[:, j, i] += block
        self.right += weight**2 * (basis.T @ pulled)

    def solved(self) -> Array:
        count, _, _, k, _ = self.matrix.shape
        full = self.matrix.transpose(0, 1, 3, 2, 4).reshape(count, 3 * k, 3 * k)
        right = self.right.transpose(0, 2, 1).reshape(count, 3 * k, 1)
        return np.asarray(np.linalg.solve(full, right).reshape(count, 3, k).transpose(0, 2, 1), float)


def tensor(rows: Array, poles: Array, columns: Array) -> Array:
    """Points on the grid of two designs, flattened u first: (n, len(rows) * len(columns), 3)."""
    n, nu, nv, _ = poles.shape
    half = (rows @ poles.reshape(n, nu, nv * 3)).reshape(n, len(rows), nv, 3)
    return (columns @ half).reshape(n, -1, 3)


def _coons(border: list[Array]) -> Array:
    """The poles of the bilinearly blended Coons patches of four borders run counter-clockwise: (n, p + 1, q + 1, 3)."""
    low, high = border[0][:, :, None], border[2][:, ::-1, None]
    left, right = border[3][:, None, ::-1], border[1][:, None]
    s = np.linspace(0.0, 1.0, low.shape[1])[:, None, None]
    t = np.linspace(0.0, 1.0, left.shape[2])[:, None]
    corners = (1 - s) * ((1 - t) * low[:, :1] + t * high[:, :1]) + s * ((1 - t) * low[:, -1:] + t * high[:, -1:])
    poles = (1 - t) * low + t * high + (1 - s) * left + s * right - corners
    poles[:, :, 0], poles[:, :, -1] = low[:, :, 0], high[:, :, 0]
    poles[:, 0], poles[:, -1] = left[:, 0], right[:, 0]
    return np.asarray(poles)


def _borders(net: Net, curves: list[Array], patches: Ints, side: int, degree: int) -> Array:
    """The poles of one side of patches, run counter-clockwise and raised to the degree: (n, degree + 1, 3)."""
    result = np.empty((len(patches), degree + 1, 3))
    for row, patch in enumerate(patches):
        own = curves[net.curve[patch, side]]
        matrix = _to_side(len(own) - 1, degree, int(net.piece[patch, side]), int(net.sense[patch, side]))
        result[row] = own if matrix is None else matrix @ own
    return result


@lru_cache(maxsize=256)
def _to_side(low: int, high: int, piece: int, sense: int) -> Array | None:
    """From a curve's poles to those of a piece of it, of a higher degree, run forwards or backwards; None: the same."""
    if low == high and piece == 0 and sense > 0:
        return None
    matrix = np.eye(low + 1)
    if piece:
        halves = [[comb(i, j) * 0.5**i if j <= i else 0.0 for j in range(low + 1)] for i in range(low + 1)]
        matrix = np.array(halves)
        if piece == 2:
            matrix = matrix[::-1, ::-1]
    raised = np.array(
        [
            [comb(low, j) * comb(high - low, i - j) / comb(high, i) if 0 <= i - j <= high - low else 0.0
             for j in range(low + 1)]
            for i in range(high + 1)
        ]
    )  # fmt: skip
    matrix = raised @ matrix
    return matrix if sense > 0 else matrix[::-1]


def _middle(poles: Array) -> Array:
    return np.asarray(bezier(len(poles) - 1, np.array([0.5]))[0] @ poles)


def _evenly(points: Array, t: Array) -> Array:
    """Polylines (n, m, 3) resampled at fractions t of their length."""
    step = np.linalg.norm(np.diff(points, axis=1), axis=2)
    along = np.concatenate([np.zeros((len(points), 1)), np.cumsum(step, axis=1)], axis=1)
    along /= np.maximum(along[:, -1:], 1e-300)
    at = np.clip((along[:, None, :] <= t[None, :, None]).sum(axis=2) - 1, 0, points.shape[1] - 2)
    low, high = np.take_along_axis(along, at, 1), np.take_along_axis(along, at + 1, 1)
    s = ((t - low) / np.maximum(high - low, 1e-300))[..., None]
    start, end = (np.take_along_axis(points, k[..., None], 1) for k in (at, at + 1))
    return (1 - s) * start + s * end


def _between(field: Field, points: Array, straight: Array, fixed: Mask, reach: Array) -> Array:
    """Points of curves (n, m, 3) but for their ends brought onto the surface, in the box where there is one."""
    result = points.copy()
    result[:, 1:-1] = _onto(field, points[:, 1:-1], fixed, reach)
    if not isinstance(field, Inside):
        return result
    lo, hi = np.array(field.lo), np.array(field.hi)
    leaving = np.flatnonzero(((result < lo) | (result > hi))[:, 1:-1].any(axis=(1, 2)))
    low, high = (b + CLEAR * (straight[leaving] - b) for b in (lo, hi))
    out = (result[leaving] < low) | (result[leaving] > high)
    out[:, [0, -1]] = False
    row, at = np.nonzero(out.any(axis=2))
    if len(row):
        moved = np.clip(result[leaving[row], at], low[row, at], high[row, at])
        result[leaving[row], at] = onto(field, moved, fixed[leaving[row]] | out[row, at], reach[leaving[row]], 8)
    return result


def _onto(field: Field, points: Array, fixed: Mask, reach: Array) -> Array:
    m = points.shape[1]
    flat = onto(field, points.reshape(-1, 3), np.repeat(fixed, m, axis=0), np.repeat(reach, m), 8)
    return flat.reshape(points.shape)


def _normals(field: Field, points: Array, fixed: Mask | None = None) -> Array:
    """Unit normals at points (n, m, 3); those of the level set's section where coordinates (n, 3) are fixed."""
    slope = field.gradient(points)
    if fixed is not None:
        slope = np.where(fixed[:, None], 0.0, slope)
    return slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-300)

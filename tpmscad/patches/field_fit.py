"""Curves and patches of a net fitted to a level set, all at once, joining with tangent continuity through the field's gradient.

A curve is fitted first, with the field's normals along it: its ends tangent to the surface, its own tangent orthogonal to the
normals. The patches on both sides take its poles and are asked, in the same least squares that place their inner poles, to have a
derivative across the border orthogonal to the same normals; so they meet smoothly though neither knows the other. Distances
along the normal count fully, along the surface (where a point of the patch lies matters little) with the weight `SLIDE`.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from math import comb

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.layout.net import Net
from tpmscad.patches.layout.octree import Array, Ints, Mask
from tpmscad.patches.layout.relax import onto
from tpmscad.splines.bspline import design

SLIDE = 0.3
CURVE_TANGENT = 1.0
END_TANGENT = 1e3
CROSS = 1.0
PASSES = 2
CHUNK = 2048
"""Patches solved at a time: 48 x 48 normal matrices of 20 kB each."""


@dataclass(frozen=True, slots=True, eq=False)
class NetFit:
    """Bezier poles on [0, 1]: `curves[i]` (p + 1, 3) and `patches[i]` (p + 1, q + 1, 3)."""

    curves: list[Array]
    patches: list[Array]


def bezier(degree: int, t: Array, order: int = 0) -> Array:
    """Bernstein polynomials of the degree on [0, 1], or derivatives, at t: (n, degree + 1)."""
    return design(np.repeat([0.0, 1.0], degree + 1), degree, t, order)


def fit_net(net: Net, field: Field, curve_degree: Ints, patch_degree: Ints) -> NetFit:
    """Fit every curve with its degree (C,), then every patch with its degree (Q,), raised where its sides' are higher."""
    curves: list[Array] = [np.empty(0)] * len(net.ends)
    main, spokes = np.arange(net.n_sides), np.arange(net.n_sides, len(net.ends))
    start = net.vertices[net.ends[:, 0]]
    end = net.vertices[net.ends[:, 1]]
    for group in (main, spokes):
        if group is spokes and len(spokes):
            start[spokes] = [_middle(curves[c]) for c in net.middle_of]
        for degree in np.unique(curve_degree[group]):
            at = group[curve_degree[group] == degree]
            fixed = np.zeros((len(at), 3), bool)
            on_box = np.flatnonzero(net.plane[at] >= 0)
            fixed[on_box, net.plane[at[on_box]] // 2] = True
            for i, poles in zip(at, fit_curves(field, start[at], end[at], fixed, int(degree)), strict=True):
                curves[i] = poles

    side_degree = curve_degree[net.curve]
    degrees = np.stack(
        [np.maximum(patch_degree, side_degree[:, 0::2].max(1)), np.maximum(patch_degree, side_degree[:, 1::2].max(1))],
        1,
    )
    patches: list[Array] = [np.empty(0)] * len(net.curve)
    for degree_u, degree_v in np.unique(degrees, axis=0):
        at = np.flatnonzero((degrees == (degree_u, degree_v)).all(axis=1))
        for part in np.array_split(at, -(-len(at) // CHUNK)):
            border = [_borders(net, curves, part, s, int((degree_u, degree_v)[s % 2])) for s in range(4)]
            for i, poles in zip(part, fit_patches(field, border, net.plane[net.curve[part]] < 0), strict=True):
                patches[i] = poles
    return NetFit(curves, patches)


def fit_curves(field: Field, start: Array, end: Array, fixed: Mask, degree: int) -> Array:
    """Curves on the level set between points (n, 3) of it, in planes of the box where coordinates are `fixed`: (n, p + 1, 3)."""
    t = np.linspace(0.0, 1.0, 2 * degree + 4)
    reach = 0.3 * np.linalg.norm(end - start, axis=1)
    points = start[:, None] + t[:, None] * (end - start)[:, None]
    for _ in range(2):
        points[:, 1:-1] = _onto(field, points[:, 1:-1], fixed, reach)
        points = _evenly(points, t)
    points[:, 1:-1] = _onto(field, points[:, 1:-1], fixed, reach)

    values, slopes = bezier(degree, t), bezier(degree, t, 1)
    poles = np.zeros((len(start), degree + 1, 3))
    poles[:, 0], poles[:, -1] = start, end
    normal = _normals(field, points)
    ends = normal[:, [0, -1]]
    inner = slice(1, degree)
    for turn in range(PASSES):
        if turn:
            points = values @ poles
            points[:, 1:-1] = _onto(field, points[:, 1:-1], fixed, reach)
            normal = _normals(field, points)
        rim = np.zeros_like(poles)
        rim[:, [0, -1]] = poles[:, [0, -1]]
        known_value, known_slope = values @ rim, slopes @ rim
        system = _System(degree - 1, len(start))
        system.near(values[:, inner], normal, points - known_value, SLIDE)
        system.along(slopes[:, inner], normal, -known_slope, CURVE_TANGENT / len(t))
        system.along(slopes[[0, -1]][:, inner], ends, -known_slope[:, [0, -1]], END_TANGENT)
        poles[:, inner] = system.solved()
    rows, axis = np.nonzero(fixed)
    poles[rows, :, axis] = start[rows, axis][:, None]
    return poles


def fit_patches(field: Field, border: list[Array], joined: Mask) -> Array:
    """Patches between their four borders, each (n, degree + 1, 3) run counter-clockwise: (n, p + 1, q + 1, 3).

    `joined` (n, 4): sides across which the surface goes on; on the others, in the box's faces, nothing is asked of the slope.
    """
    p, q = border[0].shape[1] - 1, border[1].shape[1] - 1
    poles = np.zeros((len(border[0]), p + 1, q + 1, 3))
    poles[:, :, 0], poles[:, -1] = border[0], border[1]
    poles[:, :, -1], poles[:, 0] = border[2][:, ::-1], border[3][:, ::-1]
    rim = poles.copy()

    u, v = (np.linspace(0.0, 1.0, d + 5)[1:-1] for d in (p, q))
    bu, bv = bezier(p, u), bezier(q, v)
    inner = np.einsum("ai,bj->abij", bu[:, 1:-1], bv[:, 1:-1]).reshape(len(u) * len(v), -1)
    size = np.linalg.norm(poles[:, 0, 0] - poles[:, -1, -1], axis=1)
    known = tensor(bu, rim, bv)
    chart = _coons(rim, u, v)
    free = np.zeros((len(poles), 3), bool)
    crossing = [_crossing(field, rim, s) for s in range(4)]
    for turn in range(PASSES):
        if turn:
            chart = tensor(bu, poles, bv)
        target = _onto(field, chart, free, 0.3 * size)
        normal = _normals(field, target)
        system = _System((p - 1) * (q - 1), len(poles))
        system.near(inner, normal, target - known, SLIDE)
        for (basis, given, normals), inside in zip(crossing, joined.T, strict=True):
            system.along(basis, normals * inside[:, None, None], -given, CROSS / np.sqrt(len(basis)))
        poles[:, 1:-1, 1:-1] = system.solved().reshape(len(poles), p - 1, q - 1, 3)
    return poles


def _crossing(field: Field, rim: Array, side: int) -> tuple[Array, Array, Array]:
    """Along a side: the inner poles' part in the derivative across it (m, inner), the rim's (n, m, 3), and normals (n, m, 3)."""
    p, q = rim.shape[1] - 1, rim.shape[2] - 1
    along, across = (p, q) if side in (0, 2) else (q, p)
    t = np.linspace(0.0, 1.0, along + 5)[1:-1]
    values = bezier(along, t)
    slope = bezier(across, np.array([1.0 if side in (1, 2) else 0.0]), 1)
    ends = bezier(across, np.array([1.0 if side in (1, 2) else 0.0]))
    if side in (0, 2):
        basis = np.einsum("ai,bj->abij", values[:, 1:-1], slope[:, 1:-1])
        given, points = tensor(values, rim, slope), tensor(values, rim, ends)
    else:
        basis = np.einsum("bi,aj->abij", slope[:, 1:-1], values[:, 1:-1])
        given, points = tensor(slope, rim, values), tensor(ends, rim, values)
    return basis.reshape(len(t), -1), given, _normals(field, points)


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
        return np.linalg.solve(full, right).reshape(count, 3, k).transpose(0, 2, 1)


def tensor(rows: Array, poles: Array, columns: Array) -> Array:
    """Points on the grid of two designs, flattened u first: (n, len(rows) * len(columns), 3)."""
    n, nu, nv, _ = poles.shape
    half = (rows @ poles.reshape(n, nu, nv * 3)).reshape(n, len(rows), nv, 3)
    return (columns @ half).reshape(n, -1, 3)


def _coons(rim: Array, u: Array, v: Array) -> Array:
    """The bilinearly blended Coons patch of the border poles at the grid of u and v: (n, len(u) * len(v), 3)."""
    p, q = rim.shape[1] - 1, rim.shape[2] - 1
    bu, bv = bezier(p, u), bezier(q, v)
    low, high = bu @ rim[:, :, 0], bu @ rim[:, :, -1]  # (n, a, 3)
    left, right = bv @ rim[:, 0], bv @ rim[:, -1]  # (n, b, 3)
    s, t = u[:, None, None], v[None, :, None]
    corners = (
        (1 - s) * (1 - t) * rim[:, None, None, 0, 0]
        + s * (1 - t) * rim[:, None, None, -1, 0]
        + (1 - s) * t * rim[:, None, None, 0, -1]
        + s * t * rim[:, None, None, -1, -1]
    )
    blend = (1 - t) * low[:, :, None] + t * high[:, :, None] + (1 - s) * left[:, None] + s * right[:, None] - corners
    return np.asarray(blend.reshape(len(rim), -1, 3))


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


def _onto(field: Field, points: Array, fixed: Mask, reach: Array) -> Array:
    m = points.shape[1]
    flat = onto(field, points.reshape(-1, 3), np.repeat(fixed, m, axis=0), np.repeat(reach, m), 8)
    return flat.reshape(points.shape)


def _normals(field: Field, points: Array) -> Array:
    slope = field.gradient(points)
    return slope / np.maximum(np.linalg.norm(slope, axis=-1, keepdims=True), 1e-300)


Progress = Callable[[float], None]

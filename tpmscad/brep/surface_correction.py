"""Corrections of free-form surfaces, so that they pass through given points: S + D with a smooth spline D on the same parameters.

At parameters (s_i, t_i) the correction is to be the offset o_i of a point from the surface there. It minimises

    sum |D(s_i, t_i) - o_i|^2 / n + BENDING h^4 (int |D_ss|^2 + 2 |D_st|^2 + |D_tt|^2 + MASS int |D|^2),

in parameters that are scaled to the lengths of the surface's sides, with the length h of a span, by sparse normal equations; a
few steps of iterative refinement with one factorisation reduce what the last terms leave of the offsets. The spans are increased
until the offsets are met. D has a period where the surface is closed, and vanishes to second order at poles.

The polynomials of the end spans go on beyond the borders before, so that the continuation, too, is corrected smoothly.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline
from scipy.sparse import csr_array, diags_array, kron
from scipy.sparse.linalg import splu

from tpmscad._typing import Array
from tpmscad.brep.foot_surface import find_point_sides, tabulate_spans
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.index_ranges import repeat_rows
from tpmscad.splines.basis import apply_bases, design_matrix
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import greville_abscissae, to_common_space
from tpmscad.splines.quadrature import gauss_legendre

MIN_CORRECTION_DEGREE = 5
"""Least degree of D: corrected surfaces stay C4, so that intersection curves are fitted as before."""

SPAN_COUNTS = (8, 12, 16, 24, 36, 54)
"""Spans along the longer side that are tried; the other side has them in proportion."""

BENDING, MASS = 1e-6, 1e-3
"""Weights of bending, and of |D|^2 in it, on a surface whose longer side has the length 1."""

REFINEMENTS = 6
"""Steps of iterative refinement: each reduces what bending leaves of the offsets."""

FLAT_ROWS = 3
"""Rows of coefficients at a pole that are zero: its point, tangent plane and curvature stay."""

MOVE_LINES = 65
"""Lines of parameters on whose grid the largest move is found."""

SIDE_SAMPLES = 9
"""Points along lines of parameters from which the lengths of the sides are found."""


@dataclass(frozen=True, slots=True, eq=False)
class CorrectedSurface:
    """A surface that was corrected, the largest |D| between and at the points, and what is left of the offsets."""

    surface: FreeFormSurface
    move: float
    left: float


def correct_surface(surface: FreeFormSurface, points: Array, tol: float) -> CorrectedSurface:
    """The surface moved so that it passes through points (n, 3) next to it.

    Parameters
    ----------
    surface : FreeFormSurface
        The surface; its continuation becomes a part of it.
    points : ndarray, shape (n, 3)
        Points next to it.
    tol : float
        Distance from the points in model units at which no more spans are tried.

    Returns
    -------
    CorrectedSurface
        The surface, the largest move, and the distance that is left, which exceeds `tol` if the most spans were not enough.
    """
    wide = absorb_continuation(surface)
    uv = wide.feet(points).parameters
    offsets = points - wide(*uv.T)
    best: CorrectedSurface | None = None
    for count in SPAN_COUNTS:
        moved = _fit_correction(wide, uv, offsets, count)
        first, second = to_common_space(wide.spline, moved)
        spline = BSplineSurface(
            first.poles + second.poles, first.knots_u, first.knots_v, first.degree_u, first.degree_v
        )
        left = float(np.linalg.norm(spline_at(spline, uv) - points, axis=1).max())
        if best is None or left < best.left:
            move = _largest_move(moved, uv)
            best = CorrectedSurface(FreeFormSurface(spline, wide.closed), move, left)
        if best.left <= tol:
            break
    assert best is not None
    return best


def _largest_move(moved: BSplineSurface, uv: Array) -> float:
    """The largest |D| on the box of the parameters (n, 2)."""
    lines = [np.linspace(low, high, MOVE_LINES) for low, high in zip(uv.min(axis=0), uv.max(axis=0), strict=True)]
    between = np.linalg.norm(moved.grid(lines[0], lines[1]), axis=2).max()
    return float(max(between, np.linalg.norm(spline_at(moved, uv), axis=1).max()))


def spline_at(spline: BSplineSurface, uv: Array) -> Array:
    """Points (n, 3) at parameters (n, 2), which are on the domain."""
    return spline(*uv.T)


def absorb_continuation(surface: FreeFormSurface) -> FreeFormSurface:
    """The same surface on the wider domain to which the polynomials of its end spans go on."""
    _, spans = tabulate_spans(surface.spline, surface.closed, surface.continuation)
    spline = surface.spline
    poles, knots = spline.poles, [spline.knots_u, spline.knots_v]
    for axis, degree in enumerate((spline.degree_u, spline.degree_v)):
        start = spline.domain[axis][0]
        wide = knots[axis].copy()
        wide[: degree + 1], wide[-degree - 1 :] = start + spans.box[axis, 0], start + spans.box[axis, 1]
        if (wide == knots[axis]).all():
            continue
        sites = greville_abscissae(wide, degree)
        values = BSpline(knots[axis], np.moveaxis(poles, axis, 0), degree, extrapolate=True)(sites)
        solved = np.linalg.solve(design_matrix(wide, degree, sites), values.reshape(len(sites), -1))
        poles = np.moveaxis(solved.reshape(values.shape), 0, axis)
        knots[axis] = wide
    wider = BSplineSurface(np.ascontiguousarray(poles), knots[0], knots[1], spline.degree_u, spline.degree_v)
    return FreeFormSurface(wider, surface.closed)


def _fit_correction(surface: FreeFormSurface, uv: Array, offsets: Array, count: int) -> BSplineSurface:
    """D with `count` spans along the longer side."""
    spline = surface.spline
    lengths = _side_lengths(spline)
    axes = []
    for axis in (0, 1):
        own = (spline.degree_u, spline.degree_v)[axis]
        degree, spans = max(own, MIN_CORRECTION_DEGREE), max(1, int(np.ceil(count * lengths[axis] / lengths.max())))
        knots = (spline.knots_u, spline.knots_v)[axis]
        axes.append(_make_axis(knots, own, spline.domain[axis], degree, spans, surface.closed[axis]))
    is_point = find_point_sides(spline)
    for axis, sides in enumerate(((3, 1), (0, 2))):
        axes[axis].hold(bool(is_point[sides[0]]), bool(is_point[sides[1]]))
    rows = [csr_array(a.evaluate(uv[:, k])) for k, a in enumerate(axes)]
    n = len(uv)
    design = _row_products(rows[0], rows[1])
    scale = lengths / lengths.max()
    grams = [a.gram_matrices(float(s)) for a, s in zip(axes, scale, strict=True)]
    bending = (
        kron(grams[0][2], grams[1][0]) + 2.0 * kron(grams[0][1], grams[1][1]) + kron(grams[0][0], grams[1][2])
    ) + MASS * kron(grams[0][0], grams[1][0])
    normal = (design.T @ design / n + BENDING / count**4 * bending).tocsc()
    normal = normal + diags_array(np.full(normal.shape[0], 1e-15 * normal.diagonal().max())).tocsc()
    solver = splu(normal)
    net = np.zeros((normal.shape[0], 3))
    for _ in range(REFINEMENTS):
        net = net + solver.solve(design.T @ (offsets - design @ net) / n)
    net = net.reshape(axes[0].size, axes[1].size, 3)
    poles = apply_bases(axes[0].expand, net, axes[1].expand)
    return BSplineSurface(poles, axes[0].knots, axes[1].knots, axes[0].degree, axes[1].degree)


@dataclass(slots=True, eq=False)
class _CorrectionAxis:
    """Clamped knots of D along a parameter, and the matrix (m, size) from free coefficients to its poles."""

    knots: Array
    degree: int
    expand: Array

    @property
    def size(self) -> int:
        """Number of free coefficients."""
        return self.expand.shape[1]

    def hold(self, low: bool, high: bool) -> None:
        """Leave out the coefficients that move the low or the high end, or bend the surface there."""
        first, last = (FLAT_ROWS if low else 0), self.size - (FLAT_ROWS if high else 0)
        self.expand = self.expand[:, first:last]

    def evaluate(self, t: Array, order: int = 0) -> Array:
        """Values (n, size) of the free basis functions, or their derivatives."""
        return np.asarray(design_matrix(self.knots, self.degree, t, order) @ self.expand)

    def gram_matrices(self, length: float) -> list[csr_array]:
        """Integrals of the products of values, first and second derivatives, on a parameter of the given length."""
        x, w = gauss_legendre(self.degree + 1)
        ends = np.unique(self.knots)
        half = 0.5 * np.diff(ends)
        at = (ends[:-1] + half)[:, None] + half[:, None] * x
        weights = (half[:, None] * w).ravel() / (ends[-1] - ends[0]) * length
        stretch = length / (ends[-1] - ends[0])
        found = []
        for order in range(3):
            rows = self.evaluate(at.ravel(), order) / stretch**order
            found.append(csr_array(rows.T @ (weights[:, None] * rows)))
        return found


def _make_axis(
    knots: Array, own: int, domain: tuple[float, float], degree: int, spans: int, closed: bool
) -> _CorrectionAxis:
    """An axis with about `spans` spans; at the knots of the surface, of degree `own`, it is no smoother than the surface.

    Offsets of a smooth edge from the surface are as rough as the surface.
    """
    low, high = domain
    values, repeats = np.unique(knots[own + 1 : -own - 1], return_counts=True)
    times = np.maximum(1, degree - own + repeats)
    far = 0.6 * (high - low) / spans
    breaks, counts = [low], [degree]
    for value, count in zip([*values.tolist(), high], [*times.tolist(), degree], strict=True):
        if count == 1 and (value - breaks[-1] < far or high - value < far):  # smooth knots are taken together
            continue
        pieces = max(1, int(np.round(spans * (value - breaks[-1]) / (high - low))))
        between = np.linspace(breaks[-1], value, pieces + 1)[1:].tolist()
        breaks += [*between[:-1], value]
        counts += [*[1] * (pieces - 1), count]
    clamped = np.concatenate([[low], np.repeat(breaks, counts), [high]])
    if not closed:
        return _CorrectionAxis(clamped, degree, np.eye(len(clamped) - degree - 1))
    once = np.repeat(breaks[:-1], [1, *counts[1:-1]])
    n, period = len(once), high - low
    turns = int(np.ceil(degree / n)) + 1
    endless = np.concatenate([once + period * k for k in range(-turns, turns + 2)])
    start = turns * n - degree
    periodic = endless[start : start + n + 2 * degree + 1]
    sites = greville_abscissae(clamped, degree)
    rows = np.asarray(BSpline.design_matrix(np.clip(sites, low, high), periodic, degree).toarray())
    wrapped = np.zeros((len(sites), n))
    np.add.at(wrapped.T, np.arange(rows.shape[1]) % n, rows.T)
    return _CorrectionAxis(
        clamped, degree, np.asarray(np.linalg.solve(design_matrix(clamped, degree, sites), wrapped), float)
    )


def _row_products(first: csr_array, second: csr_array) -> csr_array:
    """The row-wise Kronecker product (n, a * b) of matrices (n, a) and (n, b)."""
    n, b = second.shape
    counts_a, counts_b = np.diff(first.indptr), np.diff(second.indptr)
    row, place = repeat_rows(counts_a * counts_b)
    i, j = place // counts_b[row], place % counts_b[row]
    at_a, at_b = first.indptr[row] + i, second.indptr[row] + j
    column = first.indices[at_a].astype(np.int64) * b + second.indices[at_b]
    return csr_array((first.data[at_a] * second.data[at_b], (row, column)), shape=(n, first.shape[1] * b))


def _side_lengths(spline: BSplineSurface) -> Array:
    """Mean lengths (2,) of the lines of u and of v."""
    u, v = (np.linspace(*interval, SIDE_SAMPLES) for interval in spline.domain)
    grid = spline.grid(u, v)
    return np.array([np.linalg.norm(np.diff(grid, axis=k), axis=2).sum(axis=k).mean() for k in (0, 1)])

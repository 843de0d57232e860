"""The surfaces of faces as polynomials in space, in flat tables that compiled loops read.

Every carrier becomes one tensor of monomials per knot span, in two local parameters on [-1, 1]; a plane becomes a bilinear patch,
and a quadric a spline equal to it up to round-off (`conic_splines`).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.brep.carriers import Carrier, Plane
from tpmscad.brep.foot_surface import span_powers
from tpmscad.splines.basis import apply_span_bases
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.conic_splines import approximate_quadric

PLANE_MARGIN = 0.02
"""Enlargement of the rectangle that stands for a plane, relative to the face."""


class PatchPolynomials(NamedTuple):
    """The surfaces of F faces, a named tuple, which compiled functions take.

    Attributes
    ----------
    layout : (F, 9)
        Of each face the columns `DEGREE_U` to `PLANAR`.
    breaks : (B,)
        Ends of the spans, of u and then of v of each face.
    coefficients : (C,)
        Monomials in space, model units, face by face: spans of u, of v, powers of u, of v, coordinates.
    """

    layout: IntArray
    breaks: Array
    coefficients: Array


DEGREE_U, DEGREE_V, SPANS_U, SPANS_V, BREAK_U, BREAK_V, COEFFICIENT, SENSE, PLANAR = range(9)
"""Columns of a layout: degrees, numbers of spans, where breaks and monomials start; +1 if S_u x S_v leads out, else -1; 1 for a
plane."""


def tabulate_carriers(carriers: Sequence[Carrier], uv: Sequence[Array], sense: ArrayLike) -> PatchPolynomials:
    """The polynomials of carriers, planes and quadrics about points uv (n, 2) of theirs; sense: +1 if S_u x S_v leads out."""
    breaks, coefficients = [], []
    for surface in map(as_spline, carriers, uv):
        (u, left), (v, right) = (
            span_powers(surface.knots_u, surface.degree_u),
            span_powers(surface.knots_v, surface.degree_v),
        )
        breaks += [u, v]
        coefficients.append(apply_span_bases(left, surface.poles, right))
    shapes = np.array([c.shape[:4] for c in coefficients], np.int64)
    starts = (
        find_starts([len(b) for b in breaks])[:-1].reshape(-1, 2),
        find_starts([c.size for c in coefficients])[:-1, None],
    )
    planar = np.array([[isinstance(carrier, Plane)] for carrier in carriers], np.int64).reshape(-1, 1)
    layout = np.concatenate([shapes[:, 2:] - 1, shapes[:, :2], *starts, np.reshape(sense, (-1, 1)), planar], axis=1)
    return PatchPolynomials(layout, stack(breaks), stack([c.ravel() for c in coefficients]))


def as_spline(carrier: Carrier, uv: Array) -> BSplineSurface:
    """A carrier as a spline in its own parameters, a plane or quadric about points uv (n, 2)."""
    if isinstance(carrier, BSplineSurface):
        return carrier
    return _bound_plane(carrier, uv) if isinstance(carrier, Plane) else approximate_quadric(carrier, uv)


def _bound_plane(plane: Plane, uv: Array) -> BSplineSurface:
    """The plane as a bilinear patch about points uv (n, 2)."""
    margin = PLANE_MARGIN * np.ptp(uv, axis=0).max()
    (u0, v0), (u1, v1) = uv.min(axis=0) - margin, uv.max(axis=0) + margin
    poles = plane(np.array([[u0, u0], [u1, u1]]), np.array([[v0, v1], [v0, v1]]))
    return BSplineSurface(poles, np.array([u0, u0, u1, u1]), np.array([v0, v0, v1, v1]), 1, 1)


def find_starts(counts: ArrayLike) -> IntArray:
    """Where each of n parts of these lengths starts, and the total (n + 1,)."""
    return np.concatenate([[0], np.cumsum(np.asarray(counts, np.int64))]).astype(np.int64)


def stack(parts: list[Array], columns: int = 0) -> Array:
    """Parts (n,), or (n, columns), one after the other; there may be none."""
    empty = np.zeros((0, columns)) if columns else np.zeros(0)
    return np.ascontiguousarray(np.concatenate([empty, *parts]))


@njit_cached
def evaluate_face(patches: PatchPolynomials, f: int, u: float, v: float, jet: Array) -> None:
    """Fill in S, S_u and S_v (3, 3) of face f at (u, v); beyond its domain its outer polynomials go on."""
    bu, bv = patches.layout[f, BREAK_U], patches.layout[f, BREAK_V]
    nu, nv = patches.layout[f, SPANS_U], patches.layout[f, SPANS_V]
    p, q = patches.layout[f, DEGREE_U], patches.layout[f, DEGREE_V]
    i = 0
    while i + 1 < nu and u >= patches.breaks[bu + i + 1]:
        i += 1
    j = 0
    while j + 1 < nv and v >= patches.breaks[bv + j + 1]:
        j += 1
    hu = 0.5 * (patches.breaks[bu + i + 1] - patches.breaks[bu + i])
    hv = 0.5 * (patches.breaks[bv + j + 1] - patches.breaks[bv + j])
    x = (u - patches.breaks[bu + i]) / hu - 1.0
    y = (v - patches.breaks[bv + j]) / hv - 1.0
    base = patches.layout[f, COEFFICIENT] + (i * nv + j) * (p + 1) * (q + 1) * 3
    for d in range(3):
        s, su, sv = 0.0, 0.0, 0.0
        for k in range(p, -1, -1):
            row = base + k * (q + 1) * 3 + d
            a, b = 0.0, 0.0
            for m in range(q, -1, -1):
                b = b * y + a
                a = a * y + patches.coefficients[row + 3 * m]
            su = su * x + s
            s = s * x + a
            sv = sv * x + b
        jet[0, d], jet[1, d], jet[2, d] = s, su / hu, sv / hv

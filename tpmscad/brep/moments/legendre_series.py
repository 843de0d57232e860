"""Moments along pcurve spans on a single polynomial patch: the integrands as Legendre series, integrated along u in closed form.

The integral of F dv along a span is linear in the products P_i(u) P_j(v) at its nodes. A span needs one small matrix, however
many nodes it has, and the patch one table of coefficients. Same result as `loop_integrals.integrate_pcurves`, only faster.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.moments.loop_integrals import N_MOMENTS, PcurveSpans, pcurve_gauss_nodes, sum_moments
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.quadrature import gauss_legendre

EXTRA_TERMS = 1
"""Terms beyond the 4 p that make x (x . n) exact: the area, the integral of a square root, is then as accurate."""

PCURVES_PER_BATCH = 32
"""Pcurve spans per batch: the polynomials at their nodes stay in the cache of the processor."""


def is_single_span(carrier: BSplineSurface) -> bool:
    """Whether a surface is a single polynomial patch, without inner knots."""
    return carrier.poles.shape[:2] == (carrier.degree_u + 1, carrier.degree_v + 1)


def integrate_pcurves_single_span(surface: BSplineSurface, pieces: PcurveSpans) -> Array:
    """`loop_integrals.integrate_pcurves` for a surface without inner knots: (n, 16)."""
    result = np.zeros((len(pieces), N_MOMENTS))
    u, v, rise, of = pcurve_gauss_nodes(surface, pieces)
    if len(u) == 0:
        return result
    (u0, u1), (v0, v1) = surface.domain
    terms = 4 * surface.degree_u + EXTRA_TERMS, 4 * surface.degree_v + EXTRA_TERMS
    table = _legendre_coefficients(surface, terms).reshape(-1, N_MOMENTS)
    x, y = 2.0 * (u - u0) / (u1 - u0) - 1.0, 2.0 * (v - v0) / (v1 - v0) - 1.0
    moving, start = np.unique(of, return_index=True)
    bounds = np.append(start, len(of))
    for at in range(0, len(moving), PCURVES_PER_BATCH):
        own = bounds[at : at + PCURVES_PER_BATCH + 1]
        rows = slice(own[0], own[-1])
        along_u = 0.5 * (u1 - u0) * _antiderivatives(x[rows], terms[0])
        along_v = rise[rows] * _legendre(y[rows], terms[1])
        ends = (own - own[0]).tolist()
        products = np.stack([along_u[:, a:b] @ along_v[:, a:b].T for a, b in pairwise(ends)])
        result[moving[at : at + PCURVES_PER_BATCH]] = products.reshape(-1, len(table)) @ table
    return result


def _legendre_coefficients(surface: BSplineSurface, terms: tuple[int, int]) -> Array:
    """Legendre coefficients of the 16 integrands: (terms_u, terms_v, 16)."""
    (u0, u1), (v0, v1) = surface.domain
    x, y = (gauss_legendre(n)[0] for n in terms)
    us, vs = u0 + (u1 - u0) * (0.5 + 0.5 * x), v0 + (v1 - v0) * (0.5 + 0.5 * y)
    points = surface.grid(us, vs)
    normals = np.cross(surface.grid(us, vs, 1, 0), surface.grid(us, vs, 0, 1))
    values = sum_moments(points.reshape(-1, 1, 3), normals.reshape(-1, 1, 3), np.ones(1)).reshape(*terms, N_MOMENTS)
    along_u = (_to_series(terms[0]) @ values.reshape(terms[0], -1)).reshape(values.shape)
    return _to_series(terms[1]) @ along_u


@lru_cache(maxsize=16)
def _to_series(terms: int) -> Array:
    """Values at Gauss points -> Legendre coefficients: (terms, terms)."""
    x, w = gauss_legendre(terms)
    return _legendre(x, terms) * (w * (np.arange(terms) + 0.5)[:, None])


def _antiderivatives(x: Array, terms: int) -> Array:
    """Integrals of the Legendre polynomials from -1 to x (n,): (terms, n)."""
    values = _legendre(x, terms + 1)
    result = np.empty((terms, len(x)))
    result[0] = x + 1.0
    result[1:] = (values[2:] - values[:-2]) / (2.0 * np.arange(1, terms) + 1.0)[:, None]
    return result


def _legendre(x: Array, terms: int) -> Array:
    """The Legendre polynomials at x (n,): (terms, n)."""
    values = np.empty((terms, len(x)))
    values[0], values[1] = 1.0, x
    for k in range(2, terms):
        values[k] = ((2 * k - 1) * x * values[k - 1] - (k - 1) * values[k - 2]) / k
    return values

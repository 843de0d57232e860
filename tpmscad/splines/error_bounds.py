"""A-priori error bounds from second derivatives and control nets, rigorous for vector-valued surfaces.

**Filip** (Filip, Magedson, Markot, Surface algorithms using bounds on derivatives, CAGD 3 (1986); TPMS2STEP, eq. 3). Let L be the
linear interpolant of a C^1, piecewise C^2 surface S on a right triangle of the parameters with legs h, k. Then

    |S - L| <= (h^2 M_uu + 2 h k M_uv + k^2 M_vv) / 8,      M_uu = sup |S_uu|, ...  over the triangle.

The theorem is about scalar functions; applied to <e, S> for the unit vector e along S - L it holds with vector norms. Maxima
over the components, as eq. 3 of TPMS2STEP prints them, are smaller by up to sqrt(3), and the bound then fails.

**Zheng-Sederberg** (Estimating tessellation parameter intervals for rational curves and surfaces, ACM Trans. Graph. 19 (2000);
TPMS2STEP, eq. 4) with unit weights is the middle term of the same sum, L^2 n^2 A_ij / 4 with n^2 A_ij in the place of M_uv:
it bounds how far the bilinear facet over a cell of the grid is from its two triangles, not how far the surface is from them.

**A fit.** With S the original, F the fit, and the mesh of both over one grid, the paper's virtual surface gives
|S - F| <= Filip(S) + max over the vertices |S - F| + Filip(F), between points of equal parameters, hence also orthogonally.

Suprema over B-splines come from control nets: a derivative is a B-spline and lies in the convex hull of its poles, span by
span. The bounds decay like h^2 whatever the degree, so they are reported and start a search, never end it.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.basis import differentiate_poles
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import insert_knot


def filip_bound(m_uu: float, m_uv: float, m_vv: float, step_u: float, step_v: float) -> float:
    """Greatest distance between a surface and its triangle mesh over a grid of the given steps, at equal parameters.

    m_uu, m_uv, m_vv are upper bounds of the norms of the second derivatives.
    """
    return (step_u**2 * m_uu + 2 * step_u * step_v * m_uv + step_v**2 * m_vv) / 8


def filip_step(m_uu: float, m_uv: float, m_vv: float, tol: float) -> float:
    """The step, equal in u and v, at which `filip` is tol."""
    return float(np.sqrt(8 * tol / (m_uu + 2 * m_uv + m_vv)))


def zheng_sederberg_bound(m_uv: float, step_u: float, step_v: float) -> float:
    """Greatest distance between the bilinear facet on four points of a surface and its two triangles, at equal parameters."""
    return step_u * step_v * m_uv / 4


def second_derivative_bounds(surface: BSplineSurface, pieces: int = 1) -> tuple[float, float, float]:
    """Upper bounds of |S_uu|, |S_uv|, |S_vv| over the domain, each from the control net of that derivative.

    Cutting every span into `pieces` first makes the nets, and so the bounds, tighter.
    """
    return (
        float(derivative_bounds(surface, 2, 0, pieces).max()),
        float(derivative_bounds(surface, 1, 1, pieces).max()),
        float(derivative_bounds(surface, 0, 2, pieces).max()),
    )


def derivative_bounds(surface: BSplineSurface, du: int, dv: int, pieces: int = 1) -> Array:
    """Upper bounds of the norm of the derivative of orders (du, dv), one for every piece of every span: (U', V')."""
    if du > surface.degree_u or dv > surface.degree_v:
        spans = [len(np.unique(knots)) - 1 for knots in (surface.knots_u, surface.knots_v)]
        return np.zeros((spans[0] * pieces, spans[1] * pieces))
    poles, active = surface.poles, []
    for knots, degree, order in ((surface.knots_u, surface.degree_u, du), (surface.knots_v, surface.degree_v, dv)):
        poles, fine = _refine_spans(poles, knots, degree, pieces)
        for _ in range(order):
            poles, fine, degree = differentiate_poles(poles, fine, degree)
        starts = np.flatnonzero(np.diff(fine) > 0)
        active.append(starts[:, None] - degree + np.arange(degree + 1))
        poles = poles.swapaxes(0, 1)
    lengths = np.linalg.norm(poles, axis=-1)
    return lengths[active[0][:, None, :, None], active[1][None, :, None, :]].max(axis=(2, 3))


def fit_error_bound(
    samples: Array, u: Array, v: Array, second: tuple[float, float, float], fitted: BSplineSurface
) -> float:
    """Upper bound on the distance between an original surface and a fit of it, at equal parameters, by the virtual surface.

    samples (m, n, 3) are the original at the grid u (m,), v (n,), which must reach the borders of the domain; `second` are
    upper bounds of the norms of its second derivatives.
    """
    ends = ((u[0], u[-1]), (v[0], v[-1]))
    if ends != fitted.domain:
        raise ValueError(f"a grid over {ends} says nothing about a domain {fitted.domain}")
    step_u, step_v = float(np.diff(u).max()), float(np.diff(v).max())
    vertices = float(np.linalg.norm(samples - fitted.grid(u, v), axis=-1).max())
    return (
        vertices
        + filip_bound(*second, step_u, step_v)
        + filip_bound(*second_derivative_bounds(fitted, 2), step_u, step_v)
    )


def _refine_spans(poles: Array, knots: Array, degree: int, pieces: int) -> tuple[Array, Array]:
    """The same B-spline along the first axis with every span cut into pieces."""
    breaks = np.unique(knots)
    for start, end in zip(breaks[:-1], breaks[1:], strict=True):
        for t in np.linspace(start, end, pieces + 1)[1:-1]:
            poles, knots = insert_knot(poles, knots, degree, float(t), degree)
    return poles, knots

"""A-priori error bounds from second derivatives and control nets, rigorous for vector-valued surfaces.

**Filip** (Filip, Magedson, Markot, Surface algorithms using bounds on derivatives, CAGD 3 (1986); TPMS2STEP, eq. 3). Let L be the
linear interpolant of a C^1, piecewise C^2 surface S on a right triangle of the parameters with legs h, k. Then

    |S - L| <= (h^2 M_uu + 2 h k M_uv + k^2 M_vv) / 8,      M_uu = sup |S_uu|, ...  over the triangle.

The theorem is about scalar functions; applied to <e, S> for the unit vector e along S - L it holds with vector norms. Maxima
over the components, as eq. 3 of TPMS2STEP prints them, are smaller by up to sqrt(3), and the bound then fails.

**Zheng-Sederberg** (Estimating tessellation parameter intervals for rational curves and surfaces, ACM Trans. Graph. 19 (2000);
TPMS2STEP, eq. 4) with unit weights is the middle term of the same sum, L^2 n^2 A_ij / 4 with n^2 A_ij in the place of M_uv.
It bounds the distance between the bilinear facet over a cell of the grid and its two triangles, not that of the surface.

**A fit.** Let S be the original, F the fit, and consider the mesh of both over one grid. The paper's virtual surface gives
|S - F| <= Filip(S) + max over the vertices |S - F| + Filip(F), between points of equal parameters, hence also orthogonally.

Suprema over B-splines come from control nets: a derivative is a B-spline and lies in the convex hull of its poles, span by
span. The bounds decay like h^2 for every degree. They are reported and may start a search, but never end it.
"""

from __future__ import annotations

from math import perm

import numpy as np

from tpmscad._typing import Array
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.knots import bezier_pieces


def filip_bound(m_uu: float, m_uv: float, m_vv: float, step_u: float, step_v: float) -> float:
    """Upper bound on the distance between a surface and its triangle mesh over a grid, at equal parameters.

    Parameters
    ----------
    m_uu, m_uv, m_vv : float
        Upper bounds of the norms of the second derivatives.
    step_u, step_v : float
        Steps of the grid.

    Returns
    -------
    float
        The bound, in the unit of the surface.

    Notes
    -----
    Filip, Magedson, Markot (1986); TPMS2STEP, eq. 3, with vector norms.

    Examples
    --------
    >>> from tpmscad.splines import filip_bound
    >>> filip_bound(1.0, 0.0, 1.0, 2.0, 2.0)
    1.0
    """
    return (step_u**2 * m_uu + 2 * step_u * step_v * m_uv + step_v**2 * m_vv) / 8


def zheng_sederberg_bound(m_uv: float, step_u: float, step_v: float) -> float:
    """Upper bound on the distance between a bilinear facet and its two triangles, at equal parameters.

    Parameters
    ----------
    m_uv : float
        Upper bound of the norm of the mixed second derivative.
    step_u, step_v : float
        Steps of the grid.

    Returns
    -------
    float
        The bound, in the unit of the surface.

    Notes
    -----
    Zheng, Sederberg (2000); TPMS2STEP, eq. 4, with unit weights.

    Examples
    --------
    >>> from tpmscad.splines import zheng_sederberg_bound
    >>> zheng_sederberg_bound(1.0, 2.0, 2.0)
    1.0
    """
    return step_u * step_v * m_uv / 4


def second_derivative_bounds(surface: BSplineSurface, pieces: int = 1) -> tuple[float, float, float]:
    """Upper bounds of the norms of the second derivatives of a surface, from control nets.

    Parameters
    ----------
    surface : BSplineSurface
        The surface.
    pieces : int, optional
        Parts that every span is first cut into; more parts make the bounds tighter.

    Returns
    -------
    m_uu, m_uv, m_vv : float
        Bounds of |S_uu|, |S_uv|, |S_vv| over the domain.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, second_derivative_bounds
    >>> knots = bezier_knots(1)
    >>> saddle = BSplineSurface(np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 1]]]), knots, knots, 1, 1)
    >>> second_derivative_bounds(saddle)
    (0.0, 1.0, 0.0)
    """
    return (
        float(derivative_bounds(surface, 2, 0, pieces).max()),
        float(derivative_bounds(surface, 1, 1, pieces).max()),
        float(derivative_bounds(surface, 0, 2, pieces).max()),
    )


def derivative_bounds(surface: BSplineSurface, du: int, dv: int, pieces: int = 1) -> Array:
    """Upper bounds of the norm of a mixed derivative, span by span.

    Parameters
    ----------
    surface : BSplineSurface
        The surface.
    du, dv : int
        Orders of the derivative.
    pieces : int, optional
        Parts that every span is first cut into.

    Returns
    -------
    ndarray, shape (U', V')
        One bound for every part of every span.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, derivative_bounds
    >>> knots = bezier_knots(1)
    >>> saddle = BSplineSurface(np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 1]]]), knots, knots, 1, 1)
    >>> derivative_bounds(saddle, 1, 1)
    array([[1.]])
    """
    if du > surface.degree_u or dv > surface.degree_v:
        spans = [len(np.unique(knots)) - 1 for knots in (surface.knots_u, surface.knots_v)]
        return np.zeros((spans[0] * pieces, spans[1] * pieces))
    u, v, nets = bezier_pieces(surface, pieces)
    nets = np.diff(np.diff(nets, du, axis=2), dv, axis=3) * (perm(surface.degree_u, du) * perm(surface.degree_v, dv))
    lengths = np.linalg.norm(nets, axis=-1).max(axis=(2, 3))
    return np.asarray(lengths / np.outer(np.diff(u) ** du, np.diff(v) ** dv))


def fit_error_bound(
    samples: Array, u: Array, v: Array, second: tuple[float, float, float], fitted: BSplineSurface
) -> float:
    """Upper bound on the distance between a surface and a fit of it, at equal parameters, by the virtual surface.

    Parameters
    ----------
    samples : ndarray, shape (m, n, 3)
        Points of the original on the grid.
    u, v : ndarray, shape (m,), (n,)
        Parameters of the grid; they must reach the borders of the domain.
    second : tuple of float
        Upper bounds of the norms of the second derivatives of the original.
    fitted : BSplineSurface
        The fit.

    Returns
    -------
    float
        The bound, in the unit of the surface.

    Raises
    ------
    ValueError
        If the grid does not span the domain of the fit.

    Notes
    -----
    TPMS2STEP, section 3.3, in rigorous form; see the module's documentation.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad.splines import BSplineSurface, bezier_knots, fit_error_bound
    >>> knots, t = bezier_knots(1), np.array([0.0, 1.0])
    >>> square = BSplineSurface(np.array([[[0.0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]]), knots, knots, 1, 1)
    >>> fit_error_bound(square.poles, t, t, (0.0, 0.0, 0.0), square)
    0.0
    """
    ends = ((u[0], u[-1]), (v[0], v[-1]))
    if ends != fitted.domain:
        raise ValueError(f"a grid over {ends} does not bound a fit on the domain {fitted.domain}: let the grid span it")
    step_u, step_v = float(np.diff(u).max()), float(np.diff(v).max())
    vertices = float(np.linalg.norm(samples - fitted.grid(u, v), axis=-1).max())
    return (
        vertices
        + filip_bound(*second, step_u, step_v)
        + filip_bound(*second_derivative_bounds(fitted, 2), step_u, step_v)
    )

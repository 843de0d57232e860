"""Quadrics and conics as splines in their own parameters, equal to them up to round-off.

Cuts of networks know polynomials only. Angles are divided into spans of at most `MAX_SPAN`, on which the surface or curve is
interpolated at Chebyshev nodes; cylinders and cones are linear in the length of their generators. The faces of a result keep
the quadrics and conics: only the tables of the cut hold the splines.
"""

from __future__ import annotations

from functools import lru_cache
from math import ceil

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, ConicalSurface, Ellipse, Quadric, SphericalSurface
from tpmscad.brep.quadrics import ToroidalSurface
from tpmscad.splines.basis import apply_bases, bezier_interpolation
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

MAX_SPAN = np.pi / 6
"""Radians of a span: interpolation of a circle of radius 1 at ten nodes errs by (span / 4)^10 / (10! 2^-1) = 8e-16."""

ANGLE_DEGREE = 9
"""Degree in angles."""

MARGIN = 0.02
"""Enlargement of the parameter ranges of a face, relative to them: its loops are known at points only."""

KEPT_PATCHES = 2_000
"""Patches that are kept, of at most 140 kB: each union of many struts asks for those of all struts again."""


def approximate_quadric(quadric: Quadric, uv: Array) -> BSplineSurface:
    """The quadric as a patch on a rectangle about the parameters uv (n, 2), which ends at a pole or an apex."""
    low, high = uv.min(axis=0), uv.max(axis=0)
    margin = MARGIN * (high - low)
    return _approximate_on(quadric, *(low - margin).tolist(), *(high + margin).tolist())


@lru_cache(maxsize=KEPT_PATCHES)
def _approximate_on(quadric: Quadric, u0: float, v0: float, u1: float, v1: float) -> BSplineSurface:
    """The quadric on a rectangle, as far as its pole or apex."""
    least, greatest = _bound_latitude(quadric)
    by_angle = isinstance(quadric, SphericalSurface | ToroidalSurface)
    nodes_u, knots_u, to_poles_u = _divide_range(u0, u1, ANGLE_DEGREE)
    nodes_v, knots_v, to_poles_v = _divide_range(max(v0, least), min(v1, greatest), ANGLE_DEGREE if by_angle else 1)
    poles = apply_bases(to_poles_u, quadric(nodes_u[:, None], nodes_v), to_poles_v)
    return BSplineSurface(poles, knots_u, knots_v, ANGLE_DEGREE, ANGLE_DEGREE if by_angle else 1)


def approximate_conic(conic: Circle | Ellipse, low: float, high: float) -> BSplineCurve:
    """A circle or an ellipse between two angles."""
    nodes, knots, to_poles = _divide_range(low, high, ANGLE_DEGREE)
    return BSplineCurve(to_poles @ conic(nodes), knots, ANGLE_DEGREE)


def _bound_latitude(quadric: Quadric) -> tuple[float, float]:
    """The range of v between the poles of a sphere, or on the one side of the apex of a cone that is its nappe."""
    if isinstance(quadric, SphericalSurface):
        return -np.pi / 2, np.pi / 2
    if isinstance(quadric, ConicalSurface) and quadric.angle != 0:
        apex = -quadric.radius / np.sin(quadric.angle)
        return (apex, np.inf) if quadric.angle > 0 else (-np.inf, apex)
    return -np.inf, np.inf


def _divide_range(low: float, high: float, degree: int) -> tuple[Array, Array, Array]:
    """Nodes (m degree + 1,) on m spans, which share their ends, the knots, and the matrix from values there to poles.

    A range of degree 1 has one span.
    """
    m = 1 if degree == 1 else max(1, ceil((high - low) / MAX_SPAN))
    ends = np.linspace(low, high, m + 1)
    nodes = np.append((ends[:-1, None] + np.diff(ends)[:, None] * bezier_interpolation(degree)[0][:-1]).ravel(), high)
    return nodes, np.concatenate([[low], np.repeat(ends, degree), [high]]), _join_spans(m, degree)


@lru_cache(maxsize=32)
def _join_spans(m: int, degree: int) -> Array:
    """The matrix (m degree + 1, m degree + 1) from values at the nodes of m spans to poles."""
    _, to_poles = bezier_interpolation(degree)
    matrix = np.zeros((m * degree + 1, m * degree + 1))
    for i in range(m):
        own = slice(i * degree, (i + 1) * degree + 1)
        matrix[own, own] = to_poles
        matrix[i * degree] = 0.0  # poles at the ends of spans are points
        matrix[i * degree, i * degree] = 1.0
    return matrix

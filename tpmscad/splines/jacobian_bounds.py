"""The sign of the Jacobian determinant of trivariate Bezier bodies, proved by Bernstein coefficients.

The derivatives of a body are Bernstein polynomials, so is their triple product, and a Bernstein polynomial lies between its
least and its greatest coefficient. Halving the parameter box brings the coefficients nearer to the values, quadratically; at the
corners of a box they are values. A determinant that is positive at every corner met and whose coefficients are positive
in the end is positive everywhere: a proof, up to the round-off of sums of positive multiples (`ROUND_OFF`).

All functions work on stacks of nets (n, degree_u + 1, degree_v + 1, degree_w + 1, ...) over the unit cube.

Source, for curved finite elements: A. Johnen, J.-F. Remacle, C. Geuzaine, Geometrical validity of curvilinear finite elements,
J. Comput. Phys. 233 (2013), 359-372.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.splines.basis import binomials, halving_matrix

MAX_HALVINGS = 12
"""Times that a box of parameters is halved along each axis until the sign of the determinant is decided."""

ROUND_OFF = 1e-13
"""Fraction of the greatest coefficient below which a coefficient counts as zero: thousands of sums of products in float64."""


@dataclass(frozen=True, slots=True)
class JacobianBound:
    """What is known of the least determinant of a stack of bodies.

    `lower` is a lower bound of it, `attained` the least value met, `body` and `parameters` the place of that value.
    `positive` says whether the determinant is proved positive.
    """

    lower: float
    attained: float
    body: int
    parameters: tuple[float, float, float]

    @property
    def positive(self) -> bool:
        """Whether the determinant is proved positive everywhere."""
        return self.lower > 0


def bernstein_jacobian(nets: Array) -> Array:
    """Bernstein coefficients (n, 3 p, 3 q, 3 r) of (V_u x V_v) . V_w from nets (n, p + 1, q + 1, r + 1, 3)."""
    du, dv, dw = ((nets.shape[axis] - 1) * np.diff(nets, axis=axis) for axis in (1, 2, 3))
    components = []
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        minor = multiply_bernstein(du[..., i], dv[..., j]) - multiply_bernstein(du[..., j], dv[..., i])
        components.append(multiply_bernstein(minor, dw[..., k]))
    return np.sum(components, axis=0)


def multiply_bernstein(first: Array, second: Array) -> Array:
    """Coefficients of the products of two stacks of trivariate Bernstein polynomials (n, a, b, c) and (n, d, e, f)."""
    if second.size > first.size:
        first, second = second, first
    a, b = _scale(first, 1.0), _scale(second, 1.0)
    result = np.zeros((len(a), *(x + y - 1 for x, y in zip(a.shape[1:], b.shape[1:], strict=True))))
    _, m, n, o = a.shape
    for i, j, k in np.ndindex(*b.shape[1:]):
        result[:, i : i + m, j : j + n, k : k + o] += b[:, i, j, k, None, None, None] * a
    return _scale(result, -1.0)


def _scale(coefficients: Array, power: float) -> Array:
    """Coefficients times the binomials of their indices to a power."""
    for axis in (1, 2, 3):
        shape = np.ones(4, int)
        shape[axis] = coefficients.shape[axis]
        coefficients = coefficients * (binomials(coefficients.shape[axis] - 1) ** power).reshape(shape)
    return coefficients


def bound_jacobian(nets: Array) -> JacobianBound:
    """Bounds of the least Jacobian determinant of bodies (n, p + 1, q + 1, r + 1, 3), refined until its sign is decided.

    The boxes whose least coefficient is not positive are halved; the search ends at a value that is not positive, when all are
    decided, or after MAX_HALVINGS.
    """
    coefficients = bernstein_jacobian(nets)
    zero = ROUND_OFF * float(np.abs(coefficients).max())
    body = np.arange(len(nets))
    corner, size = np.zeros((len(nets), 3)), 1.0
    lower, best = np.inf, (np.inf, 0, (0.0, 0.0, 0.0))
    for _ in range(MAX_HALVINGS + 1):
        best = min(best, _least_corner(coefficients, body, corner, size))
        least = coefficients.min(axis=(1, 2, 3)) - zero
        decided = least > 0
        lower = min(lower, float(least[decided].min(initial=np.inf)))
        if decided.all() or best[0] <= zero:
            break
        coefficients, body, corner = _halve(coefficients[~decided], body[~decided], corner[~decided], size)
        size /= 2
    if not decided.all():
        lower = min(lower, float(least.min()))
    return JacobianBound(lower, *best)


def _least_corner(
    coefficients: Array, body: IntArray, corner: Array, size: float
) -> tuple[float, int, tuple[float, float, float]]:
    """The least value at the corners of the boxes, the body and the parameters where it is."""
    at = coefficients[:, [0, -1]][:, :, [0, -1]][:, :, :, [0, -1]]
    n, i, j, k = np.unravel_index(int(np.argmin(at)), at.shape)
    u, v, w = (corner[n] + size * np.array([i, j, k])).tolist()
    return float(at[n, i, j, k]), int(body[n]), (u, v, w)


def _halve(coefficients: Array, body: IntArray, corner: Array, size: float) -> tuple[Array, IntArray, Array]:
    """The eight halves of every box: coefficients, bodies and corners."""
    parts, corners = [], []
    for halves in product((1, 2), repeat=3):
        part = coefficients
        for axis, half in enumerate(halves, start=1):
            degree = part.shape[axis] - 1
            part = np.moveaxis(np.tensordot(halving_matrix(degree, half), part, axes=(1, axis)), 0, axis)
        parts.append(part)
        corners.append(corner + (np.array(halves) - 1) * size / 2)
    return np.concatenate(parts), np.tile(body, 8), np.concatenate(corners)

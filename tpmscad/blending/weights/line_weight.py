"""Univariate weights w = sum_i B_i(t) C_i of a scalar coordinate t (porous blending, eqs 7, 10 and 12, figure 3).

A coefficient is free if the support of its basis function lies in the blending layer [start, end]. The other coefficients are
fixed at the weight of the side that their support reaches, 0 or 1. The weight is therefore exactly 0 and 1 outside the layer and
joins these constants with degree - 1 continuous derivatives.

Unlike the paper, which spreads a given number of coefficients over all regions, the default knots start and end on the layer: at
the paper's 30 coefficients a thin layer has no free coefficient at all.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.weights.coordinates import Coordinate, LinearCoordinate
from tpmscad.blending.weights.weight_protocol import trace_function
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.sample_grid import grid_points
from tpmscad.fields.field import Field
from tpmscad.fields.tape.tape_nodes import Node, clamp, piecewise_polynomial
from tpmscad.splines.basis import power_coefficients
from tpmscad.splines.knots import uniform_knots

MIN_FREE_COEFFICIENTS = 8
"""Number of free coefficients that the optimiser needs at least."""

SUPPORT_TOL_SPANS = 1e-9
"""Fraction of a knot span by which a support may leave the layer: the round-off of knots that lie on its ends."""


@dataclass(frozen=True, slots=True, eq=False)
class LineWeight(Field):
    """A B-spline weight of one coordinate: coefficients (n,), knots (n + degree + 1,), layer [start, end], free mask (n,).

    `lower_bounds` and `upper_bounds` of the free coefficients lie within [0, 1]. The weight of points (..., 3) is (...), in
    [0, 1] if the coefficients are; `gradient` is exact.
    """

    coordinate: Coordinate
    coefficients: Array
    knots: Array
    degree: int
    start: float
    end: float
    is_free: BoolArray
    lower_bounds: float | Array = 0.0
    upper_bounds: float | Array = 1.0

    def evaluate(self, t: Array) -> Array:
        """The weight at coordinates t; constant outside the spline's domain.

        Values are clipped to [0, 1], which round-off may leave by an ulp or two.
        """
        spline = BSpline(self.knots, self.coefficients, self.degree)
        return np.clip(spline(np.clip(t, *self._domain)), 0.0, 1.0)

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The weight on the nodes of a tape."""
        t = trace_function(self.coordinate, (x, y, z))
        degree, coefficients = self.degree, self.coefficients
        spans = np.flatnonzero(np.diff(self.knots) > 0)
        _, pieces = power_coefficients(self.knots, coefficients, degree)
        # exactly constant where the coefficients are, without the round-off of the conversion
        for piece, span in enumerate(spans):
            own = coefficients[max(span - degree, 0) : span + 1]
            if len(own) and (own == own[0]).all():
                pieces[:, piece] = 0.0
                pieces[-1, piece] = own[0]
        low, high = self._domain
        inside = (self.knots[spans] >= low) & (self.knots[spans] < high)
        knots = np.append(self.knots[spans[inside]], high)
        value = piecewise_polynomial(knots, pieces[:, inside], clamp(t, float(low), float(high)))
        return x.recorder.with_gradient(clamp(value, 0.0, 1.0), (value,), lambda: (1.0,))

    def on_grid(self, x: ArrayLike, y: ArrayLike, z: ArrayLike) -> Array:
        """Values on the tensor-product grid of three axes; a read-only broadcast if the coordinate is one of them."""
        axes = np.asarray(x, float), np.asarray(y, float), np.asarray(z, float)
        if (axis := self.axis) is not None:
            shape = [1, 1, 1]
            shape[axis] = -1
            return np.broadcast_to(self.evaluate(axes[axis]).reshape(shape), tuple(map(len, axes)))
        return self(grid_points(axes))

    @property
    def axis(self) -> int | None:
        """The axis 0, 1 or 2 if the coordinate is x, y or z; otherwise None."""
        return self.coordinate.axis if isinstance(self.coordinate, LinearCoordinate) else None

    def design_matrix(self, points: Array) -> csr_array:
        """Values of all basis functions at points (m, 3): sparse (m, n)."""
        return self._basis_rows(self.coordinate(points))

    def apply_transpose(self, x: Array, y: Array, z: Array, values: Array) -> Array:
        """Sums over a grid of values (nx, ny, nz) times each basis function: (n,)."""
        axes = (x, y, z)
        if (axis := self.axis) is not None:
            others = tuple(k for k in range(3) if k != axis)
            return np.asarray(self._basis_rows(axes[axis]).T @ values.sum(axis=others))
        nonzero = np.nonzero(values)
        points = np.stack([coordinates[index] for coordinates, index in zip(axes, nonzero, strict=True)], axis=-1)
        return np.asarray(self.design_matrix(points).T @ values[nonzero])

    def with_coefficients(self, coefficients: Array) -> LineWeight:
        """The weight with other coefficients (n,)."""
        return replace(self, coefficients=coefficients)

    @property
    def _domain(self) -> tuple[float, float]:
        return self.knots[self.degree], self.knots[-self.degree - 1]

    def _basis_rows(self, t: Array) -> csr_array:
        if t.size == 0:  # SciPy 1.17 cannot make a matrix without rows
            return csr_array((0, self.coefficients.size))
        return csr_array(BSpline.design_matrix(np.clip(t, *self._domain), self.knots, self.degree))


def make_line_weight(
    coordinate: Coordinate,
    layer: tuple[float, float],
    domain: tuple[float, float],
    *,
    rising: bool = True,
    count: int | None = None,
    degree: int = 3,
) -> LineWeight:
    """The initial weight of a layer: 0 before it, 1 after it (reversed if not `rising`), uniform coefficients in between.

    With `count`, that many coefficients lie on clamped uniform knots over the whole domain, as in the paper. If these leave fewer
    than MIN_FREE_COEFFICIENTS free, the spans that meet the layer are halved until enough are free. Without `count`, uniform
    knots start and end on the layer.
    """
    start, end = layer
    if not start < end:
        raise InvalidRequest(f"the blending layer from {start:g} to {end:g} is empty: widen the blending region")
    if count is None:
        n_spans = MIN_FREE_COEFFICIENTS * 2 + degree
        step = (end - start) / n_spans
        knots: Array = start + step * np.arange(-degree, n_spans + degree + 1, dtype=float)
        knots[degree], knots[-degree - 1] = start, end
    else:
        if count <= degree:
            raise InvalidRequest(f"count {count}: a weight of degree {degree} has at least {degree + 1} coefficients")
        knots = uniform_knots(count - degree, degree, domain=domain)
    while _is_unusable(knots, degree, start, end):
        knots = _halve_spans(knots, start, end)
    is_free = _find_free_coefficients(knots, degree, start, end)
    first, last = np.flatnonzero(is_free)[[0, -1]]
    ramp = np.concatenate(
        [np.zeros(first), np.linspace(0.0, 1.0, last - first + 3)[1:-1], np.ones(len(is_free) - last - 1)]
    )
    return LineWeight(coordinate, ramp if rising else 1.0 - ramp, knots, degree, start, end, is_free)


def _find_free_coefficients(knots: Array, degree: int, start: float, end: float) -> BoolArray:
    slack = SUPPORT_TOL_SPANS * float(np.min(np.diff(knots)[np.diff(knots) > 0]))
    return (knots[: -degree - 1] >= start - slack) & (knots[degree + 1 :] <= end + slack)


def _is_unusable(knots: Array, degree: int, start: float, end: float) -> bool:
    spans_layer = (knots[: -degree - 1] < start) & (knots[degree + 1 :] > end)
    n_free = int(_find_free_coefficients(knots, degree, start, end).sum())
    return bool(spans_layer.any()) or n_free < MIN_FREE_COEFFICIENTS


def _halve_spans(knots: Array, start: float, end: float) -> Array:
    """The knots, and the midpoint of every span that meets the layer."""
    distinct = np.unique(knots)
    meets = (distinct[:-1] < end) & (distinct[1:] > start)
    return np.sort(np.concatenate([knots, ((distinct[:-1] + distinct[1:]) / 2)[meets]]))

"""One-dimensional weights w = sum B_i(t) C_i of a scalar coordinate t (porous blending, eqs 7, 10, 12 and figure 3).

A coefficient whose support lies in the blending layer [start, end] is free; those that reach out of it are fixed at the weight of
the side they reach. So the weight is exactly 0 and 1 outside the layer and joins it with degree - 1 continuous derivatives.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline
from scipy.sparse import csr_array

from tpmscad._typing import Array, BoolArray
from tpmscad.blending.weights.coordinates import Coordinate, LinearCoordinate
from tpmscad.errors import InvalidRequest
from tpmscad.fields.sample_grid import grid_points

MIN_FREE_COEFFICIENTS = 8
"""Free coefficients below which blends were seen to stay unrepaired for want of freedom."""

SUPPORT_TOL_SPANS = 1e-9
"""Part of a knot span by which a support may reach out of the layer: knots placed on its ends do, by round-off."""


@dataclass(frozen=True, slots=True, eq=False)
class LineWeight:
    """A weight of one coordinate: coefficients (n,), knots (n + degree + 1,), the layer [start, end] and what is free (n,).

    Called with points (..., 3) it returns w (...), in [0, 1] if its coefficients are; `gradient` is exact.
    """

    coordinate: Coordinate
    coefficients: Array
    knots: Array
    degree: int
    start: float
    end: float
    free: BoolArray
    low: float | Array = 0.0
    high: float | Array = 1.0
    """Bounds of the free coefficients, within [0, 1]."""

    def __call__(self, points: ArrayLike) -> Array:
        return self.of(self.coordinate(np.asarray(points, float)))

    def of(self, t: Array, order: int = 0) -> Array:
        """The weight, or a derivative by t, at values of the coordinate; constant outside the spline's domain.

        Clipped to [0, 1], which the coefficients keep to and round-off may leave by an ulp or two.
        """
        low, high = self.knots[self.degree], self.knots[-self.degree - 1]
        spline = BSpline(self.knots, self.coefficients, self.degree)
        values = np.asarray(spline(np.clip(t, low, high), order))
        return np.clip(values, 0.0, 1.0) if order == 0 else np.where((t < low) | (t > high), 0.0, values)

    def gradient(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        return self.of(self.coordinate(points), 1)[..., None] * self.coordinate.gradient(points)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        """The weight on the grid of all x with all y with all z (read only where it varies along one axis)."""
        axes = (x, y, z)
        if (axis := self.axis) is not None:
            shape = [1, 1, 1]
            shape[axis] = -1
            return np.broadcast_to(self.of(axes[axis]).reshape(shape), (len(x), len(y), len(z)))
        return self(grid_points(axes))

    @property
    def axis(self) -> int | None:
        """The axis the coordinate runs along, where it is one of x, y, z."""
        return self.coordinate.axis if isinstance(self.coordinate, LinearCoordinate) else None

    def design(self, points: Array) -> csr_array:
        """Values of every basis function at points (m, 3): sparse (m, n)."""
        t = np.clip(self.coordinate(points), self.knots[self.degree], self.knots[-self.degree - 1])
        return csr_array(BSpline.design_matrix(t, self.knots, self.degree))

    def adjoint(self, x: Array, y: Array, z: Array, values: Array) -> Array:
        """sum over that grid of values (nx, ny, nz) times each basis function: (n,)."""
        axes = (x, y, z)
        if (axis := self.axis) is not None:
            others = tuple(k for k in range(3) if k != axis)
            along = np.clip(axes[axis], self.knots[self.degree], self.knots[-self.degree - 1])
            rows = csr_array(BSpline.design_matrix(along, self.knots, self.degree))
            return np.asarray(rows.T @ values.sum(axis=others))
        used = np.nonzero(values)
        points = np.stack([axis_values[part] for axis_values, part in zip(axes, used, strict=True)], axis=-1)
        return np.asarray(self.design(points).T @ values[used])

    def moved(self, coefficients: Array) -> LineWeight:
        return replace(self, coefficients=coefficients)


def make_line_weight(
    coordinate: Coordinate,
    layer: tuple[float, float],
    span: tuple[float, float],
    *,
    rising: bool = True,
    count: int | None = None,
    degree: int = 3,
    refine: bool = True,
    spans: int | None = None,
) -> LineWeight:
    """The initial weight of a layer: 0 before it and 1 after it (the other way round if not rising), uniform steps within.

    count: coefficients over the whole span [t0, t1] of the regions, on uniform clamped knots as in the paper; where that leaves
    fewer than 8 free, the spans within the layer are halved until it does not, or InvalidRequest says how many are needed.
    None: uniform knots that start and end on the layer, so that all of it is used (`spans` of them, 19 unless told).
    """
    start, end = layer
    if not start < end:
        raise InvalidRequest(f"the blending layer from {start:g} to {end:g} is empty")
    if degree < 1:
        raise InvalidRequest(f"degree {degree}: a weight needs at least 1, and 2 for a continuous gradient")
    if count is None:
        pieces = (MIN_FREE_COEFFICIENTS * 2 + degree) if spans is None else spans
        step = (end - start) / pieces
        knots: Array = start + step * np.arange(-degree, pieces + degree + 1, dtype=float)
        knots[degree], knots[-degree - 1] = start, end
    else:
        if count <= degree:
            raise InvalidRequest(f"{count} coefficients of degree {degree}: at least {degree + 1} are needed")
        low, high = span
        inner = np.linspace(low, high, count - degree + 1)
        knots = np.concatenate([np.full(degree, low), inner, np.full(degree, high)])
    while _is_unusable(knots, degree, start, end):
        if not refine:
            n_free = int(_find_free_coefficients(knots, degree, start, end).sum())
            raise InvalidRequest(
                f"{len(knots) - degree - 1} coefficients leave {n_free} free in the layer {start:g} to {end:g}; at least "
                f"{MIN_FREE_COEFFICIENTS} are needed, that is {count_needed_coefficients(degree, layer, span)} over "
                f"{span[0]:g} to {span[1]:g}, or a wider layer"
            )
        knots = _halve_spans(knots, start, end)
    free = _find_free_coefficients(knots, degree, start, end)
    first, last = np.flatnonzero(free)[[0, -1]]
    ramp = np.concatenate(
        [np.zeros(first), np.linspace(0.0, 1.0, last - first + 3)[1:-1], np.ones(len(free) - last - 1)]
    )
    return LineWeight(coordinate, ramp if rising else 1.0 - ramp, knots, degree, start, end, free)


def count_needed_coefficients(degree: int, layer: tuple[float, float], span: tuple[float, float]) -> int:
    """Coefficients on uniform clamped knots over the span that leave MIN_FREE free wherever the layer lies between them."""
    step = (layer[1] - layer[0]) / (MIN_FREE_COEFFICIENTS + degree + 1)
    return int(np.ceil((span[1] - span[0]) / step)) + degree


def _find_free_coefficients(knots: Array, degree: int, start: float, end: float) -> BoolArray:
    slack = SUPPORT_TOL_SPANS * float(np.min(np.diff(knots)[np.diff(knots) > 0]))
    return (knots[: -degree - 1] >= start - slack) & (knots[degree + 1 :] <= end + slack)


def _is_unusable(knots: Array, degree: int, start: float, end: float) -> bool:
    both = (knots[: -degree - 1] < start) & (knots[degree + 1 :] > end)
    return bool(both.any()) or int(_find_free_coefficients(knots, degree, start, end).sum()) < MIN_FREE_COEFFICIENTS


def _halve_spans(knots: Array, start: float, end: float) -> Array:
    """A knot in the middle of every span that meets the layer."""
    distinct = np.unique(knots)
    meets = (distinct[:-1] < end) & (distinct[1:] > start)
    return np.sort(np.concatenate([knots, ((distinct[:-1] + distinct[1:]) / 2)[meets]]))

"""Implicit periodic B-spline units: cubic tensor-product splines on a uniform periodic grid of coefficients (implicit porous
structures by implicit B-splines, as blended in porous blending, section 4.1)."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.fields import stencil
from tpmscad.fields.evaluation import FieldJet, Triple
from tpmscad.fields.field import Field
from tpmscad.fields.nodal_field import as_periods


@dataclass(frozen=True, slots=True, eq=False)
class ImplicitBSpline(Field):
    """sum C[i, j, k] B(x mx / px - i) B(...) B(...), B the centred cubic cardinal B-spline, all periodic."""

    coefficients: Array
    period: Triple

    def at(self, x: Array, y: Array, z: Array) -> Array:
        return stencil.contract_table(self.coefficients, self._stencils(x, y, z), (x, y, z))

    def jet(self, x: Array, y: Array, z: Array) -> FieldJet:
        return stencil.contract_table_jet(self.coefficients, self._stencils(x, y, z), (x, y, z))

    def periods(self) -> Triple | None:
        return self.period

    def __repr__(self) -> str:
        digest = hashlib.sha256(self.coefficients.tobytes()).hexdigest()[:8]
        return f"BSplineUnit({'x'.join(map(str, self.coefficients.shape))} coefficients {digest}, period={self.period})"

    def _stencils(self, *coordinates: Array) -> list[stencil.Stencil]:
        return [
            _cubic_stencil(t, count, period)
            for t, count, period in zip(coordinates, self.coefficients.shape, self.period, strict=True)
        ]


def bspline_unit(coefficients: ArrayLike, period: float | Sequence[float] = 10.0) -> ImplicitBSpline:
    """The periodic cubic spline of coefficients (mx, my, mz), at least one each; twice continuously differentiable.

    Coefficient (i, j, k) belongs to the point (i / mx, j / my, k / mz) of the period.
    """
    array = np.array(coefficients, dtype=float)
    if array.ndim != 3 or array.size == 0:
        raise InvalidRequest(
            f"coefficients of shape {array.shape}: a three-dimensional array that is not empty is needed"
        )
    if not np.isfinite(array).all():
        raise InvalidRequest("the coefficients must all be finite")
    array.setflags(write=False)
    return ImplicitBSpline(array, as_periods(period))


def _cubic_stencil(t: Array, count: int, period: float) -> stencil.Stencil:
    rate = count / period
    u = t * rate
    base = np.floor(u)
    r = u - base
    s = 1.0 - r
    first = base.astype(np.int64)
    return stencil.Stencil(
        [(first + step) % count for step in (-1, 0, 1, 2)],
        [
            (s * s * s) / 6.0,
            (4.0 + (r * r) * (3.0 * r - 6.0)) / 6.0,
            (4.0 + (s * s) * (3.0 * s - 6.0)) / 6.0,
            (r * r * r) / 6.0,
        ],
        [
            (-0.5 * rate) * (s * s),
            (0.5 * rate) * (r * (3.0 * r - 4.0)),
            (-0.5 * rate) * (s * (3.0 * s - 4.0)),
            (0.5 * rate) * (r * r),
        ],
    )

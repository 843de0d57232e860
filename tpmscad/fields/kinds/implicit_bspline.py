"""Implicit periodic B-spline units: cubic tensor-product splines on a uniform periodic grid of coefficients.

Porous blending, section 4.1, blends porous structures that are given by implicit B-splines in this form.
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import LENGTHS, VALUES
from tpmscad.fields.field import Field
from tpmscad.fields.periods_and_directions import choose_periods
from tpmscad.fields.tape.evaluation import Triple
from tpmscad.fields.tape.tape_nodes import Node, periodic_spline


@dataclass(frozen=True, slots=True, eq=False)
class ImplicitBSpline(Field):
    """sum C[i, j, k] B(x mx / px - i) B(y my / py - j) B(z mz / pz - k), periodic; B is the centred cubic cardinal B-spline."""

    coefficients: Array
    period: Triple

    def trace(self, x: Node, y: Node, z: Node) -> Node:
        """The formula on the nodes of a tape."""
        return periodic_spline(self.coefficients, self.period, (x, y, z))

    def periods(self) -> Triple | None:
        """Periods along the axes, or None."""
        return self.period

    def __repr__(self) -> str:
        digest = hashlib.sha256(self.coefficients.tobytes()).hexdigest()[:8]
        return f"ImplicitBSpline({'x'.join(map(str, self.coefficients.shape))} coefficients {digest}, period={self.period})"


@validate_call()
def bspline_unit(
    coefficients: Annotated[
        ArrayLike, VALUES, "Coefficient (i, j, k) belongs to the point (i / mx, j / my, k / mz) of the period."
    ],
    period: Annotated[
        float | Sequence[float] | None, LENGTHS, "Periods along the axes, in model units; 10 by default."
    ] = None,
    *,
    cell: Annotated[
        float | Sequence[float] | None, LENGTHS, "The same as `period`, by the word of lattices; give one of the two."
    ] = None,
) -> ImplicitBSpline:
    """Return the periodic cubic B-spline field of given coefficients.

    Returns
    -------
    ImplicitBSpline
        The field, twice continuously differentiable.

    Raises
    ------
    InvalidRequest
        If the coefficients are not a finite array of three dimensions, or a period is not positive.

    Examples
    --------
    >>> import numpy as np
    >>> from tpmscad import fields
    >>> unit = fields.bspline_unit(np.random.default_rng(0).normal(size=(4, 4, 4)), period=10.0)
    """
    array = np.array(coefficients, dtype=float)
    array.setflags(write=False)
    return ImplicitBSpline(array, choose_periods(period, cell))

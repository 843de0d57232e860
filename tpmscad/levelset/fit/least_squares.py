"""Projections onto a level set and normals of it, as the alternating fits of curves and patches need them.

Points of a curve or patch are projected, and its poles are fitted to the projections (`normal_equations`), a few times in turn.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.smoothing import project_with_gradients
from tpmscad.levelset.quadmesh.vectors import normalize

TANGENTIAL_WEIGHT = 0.3
"""Weight of residuals along the level set; those along its normal have the weight 1."""

FIT_PASSES = 2
"""Alternations of projecting points of a curve or patch onto the level set and fitting to the projections."""

MAX_STEP_OF_CHORD = 0.3
"""Largest Newton step towards the level set, as a fraction of a curve's chord or a patch's diagonal."""

PROJECTION_STEPS = 8
"""Most Newton steps towards the level set."""

PROJECTION_TOL_OF_MAX_STEP = 1e-3
"""A projection ends with a step below this fraction of the largest one. The point is then off the level set by half the curvature
times the square of the step, a thousandth of any tolerance that such patches can meet, and the normal by an angle of 1e-3."""

FAIRNESS_WEIGHT = 3e-3
"""Weight of the second differences of poles. Where the level set turns by 90 degrees within a part of a curve, curves of degree 9
would have control polygons several times as long as they are, normals that swing as much, and patches that fold beside them."""


def project_curves_to_level_set(field: Field, points: Array, fixed: BoolArray, max_step: Array) -> tuple[Array, Array]:
    """Points (n, m, 3) projected onto the level set, and its unit normals there (n, m, 3).

    Coordinates `fixed` (n, 3) stay, and the normals are those of the section of the level set by the box; `max_step` (n,) bounds
    single steps.
    """
    m = points.shape[1]
    flat, all_fixed, steps = points.reshape(-1, 3), np.repeat(fixed, m, axis=0), np.repeat(max_step, m)
    projected, gradients = project_with_gradients(
        field, flat, all_fixed, steps, PROJECTION_STEPS, PROJECTION_TOL_OF_MAX_STEP
    )
    return projected.reshape(points.shape), unit_vectors(gradients.reshape(points.shape), fixed)


def unit_vectors(vectors: Array, fixed: BoolArray | None = None) -> Array:
    """Unit vectors along vectors (n, m, 3), without their components that are `fixed` (n, 3)."""
    free = vectors if fixed is None else np.where(fixed[:, None], 0.0, vectors)
    return normalize(free)

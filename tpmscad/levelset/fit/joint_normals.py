"""Normals along the curves of a network, by which two patches that meet there are exactly tangent continuous (G1).

A curve c of degree d between two points of a level set carries a vector polynomial n of degree d with

    n . c' = 0      identically: all Bernstein coefficients of the product vanish.

**Joints.** Let D be the derivative across a common side c of a patch. If n . D = 0 identically for both patches, n vanishes
nowhere, and neither D is parallel to c' anywhere, then the tangent plane of both is the plane orthogonal to n, at every point of
the curve. `network_fit` imposes n . D = 0 on each patch by itself, as linear conditions on its inner poles. At a T-vertex the
patch across takes n on the whole curve and the patches of the cut triangle take it on its halves: the same polynomial.

**Corners.** At a corner of a patch X two sides a and b begin. There D of side a is b', and its derivative along a is the twist
X_uv; likewise for b. The conditions of the two sides and their derivatives are there

    n . b' = 0,   n_a' . b' + n . X_uv = 0,        n . a' = 0,   n_b' . a' + n . X_uv = 0,

where n is the common value of n_a and n_b. They are consistent if n_a' . b' = n_b' . a'. The normals of all curves that end at a
vertex have therefore the field's unit normal there, and derivatives by one symmetric form, the field's second form S:

    n_a' . b' = a' S b'       for all b' in the tangent plane,

so that the conditions are consistent in any number of patches round a vertex. For b' = a' the identity above requires
n_a' . a' = -n . a'': the curves are fitted with n . c'' = -c' S c' at their ends. Where a spoke s begins in the middle of a
curve c, its normal has the value of n_c there, and n_s' . c' = n_c' . s' takes the place of the field's form.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.array_table import ArrayTable
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.linear_extension import LinearExtension
from tpmscad.levelset.fit.equality_constraints import EqualityConstraints
from tpmscad.levelset.fit.least_squares import unit_vectors
from tpmscad.levelset.fit.normal_equations import NormalEquations, curve_basis
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR
from tpmscad.splines.basis import bernstein_basis, bernstein_product

FORM_STEP_FRACTION = 1e-4
"""Step of the differences for second forms, as a fraction of the box or period. Joints need forms that agree where curves meet,
not accurate ones: a longer step has less noise, which the conditions on patches amplify."""


@dataclass(frozen=True, slots=True, eq=False)
class EndShapes:
    """Shape of a level set at the two ends of curves: unit normals (n, 2, 3) and second forms (n, 2, 3, 3), symmetric.

    The normal changes along a tangent vector a by S a, up to a multiple of itself.
    """

    normal: Array
    form: Array


@dataclass(frozen=True, slots=True, eq=False)
class SpokeStarts(ArrayTable):
    """What the spokes (n,) take from the curves in whose middle they begin: n, n' and c' there, (n, 3) each."""

    normal: Array
    normal_derivative: Array
    derivative: Array


def measure_second_forms(field: Field, points: Array, size: float) -> tuple[Array, Array]:
    """Unit normals (..., 3) and second forms (..., 3, 3) at points (..., 3) of a level set, by differences of the gradient.

    `size` is that of the whole level set; of a `LinearExtension` the size of its box counts, and the points tried are inside,
    so that a point beyond the box has the form of the nearest point of the box.
    """
    low, high = np.full(3, -np.inf), np.full(3, np.inf)
    if isinstance(field, LinearExtension):
        low, high = np.array(field.lo), np.array(field.hi)
        size = float((high - low).max())
    axes = np.arange(3)
    shift = FORM_STEP_FRACTION * size * np.eye(3)
    inside = np.clip(points, low, high)[..., None, :]
    after, before = np.minimum(inside + shift, high), np.maximum(inside - shift, low)
    width = (after - before)[..., axes, axes, None]
    hessian = (field.gradient(after) - field.gradient(before)) / width
    gradient = field.gradient(points)
    length = np.maximum(np.linalg.norm(gradient, axis=-1), MIN_DIVISOR)
    form = (hessian + np.swapaxes(hessian, -1, -2)) / (2 * length[..., None, None])
    return np.asarray(gradient / length[..., None]), np.asarray(form)


def fit_normals(field: Field, curves: Array, ends: EndShapes, starts: SpokeStarts | None = None) -> Array:
    """Poles (n, d + 1, 3) of the normals along curves (n, d + 1, 3), near the field's; `starts` if the curves are spokes."""
    degree = curves.shape[1] - 1
    tangent = degree * np.diff(curves, axis=1)
    at_end = tangent[:, [0, -1]]
    value = ends.normal.copy()
    direction = np.cross(ends.normal, at_end)
    change = np.einsum("nei,neij,nej->ne", direction, ends.form, at_end)
    if starts is not None:
        value[:, 0], direction[:, 0] = starts.normal, starts.derivative
        change[:, 0] = np.einsum("ni,ni->n", starts.normal_derivative, at_end[:, 0])
    length = np.maximum(np.linalg.norm(direction, axis=-1), MIN_DIVISOR)
    direction, change = direction / length[..., None], change / length

    chord = np.linalg.norm(curves[:, -1] - curves[:, 0], axis=-1)
    scale = np.where(chord > 0, chord, 1.0)  # sides without length are split afterwards
    product = (bernstein_product(degree, degree - 1).reshape(-1, degree) @ (tangent / scale[:, None, None])).reshape(
        len(curves), 2 * degree, degree + 1, 3
    )
    fraction = np.linspace(0.0, 1.0, degree + 1)[:, None]
    normals = (1 - fraction) * value[:, None, 0] + fraction * value[:, None, 1]
    sloped = np.zeros((len(curves), 2, degree + 1, 3))
    sloped[:, 0, 1], sloped[:, 1, -2] = direction[:, 0], -direction[:, 1]
    rows = np.concatenate([product, sloped], axis=1)[:, :, 1:-1]
    at_ends = np.einsum("nex,nex->ne", direction, degree * (normals[:, [1, -1]] - normals[:, [0, -2]]))
    target = np.concatenate([-np.einsum("nkix,nix->nk", product, normals), (change - at_ends) / degree], axis=1)
    t = np.linspace(0.0, 1.0, 2 * degree + 4)
    basis = bernstein_basis(degree, t)
    wanted = unit_vectors(field.gradient(basis @ curves))
    system = NormalEquations(degree - 1, len(curves))
    system.add_point_rows(curve_basis(basis[:, 1:-1]), wanted, wanted - basis @ normals, 1.0)
    conditions = EqualityConstraints.factorise(rows.reshape(*rows.shape[:2], -1))
    normals[:, 1:-1] += system.solve_subject_to(conditions, target)
    return normals


def match_end_curvatures(curves: Array, ends: EndShapes, fixed: BoolArray) -> Array:
    """Curves (n, d + 1, 3), tangent to the level set at their ends, with its normal curvature there.

    The second pole from each end moves along the normal, or its part in the plane where coordinates `fixed` (n, 3) are kept.
    """
    result = curves.copy()
    degree = curves.shape[1] - 1
    for end, (a, b, c) in enumerate(((0, 1, 2), (-1, -2, -3))):
        normal, form = ends.normal[:, end], ends.form[:, end]
        way = normal * ~fixed
        way /= np.maximum(np.einsum("ni,ni->n", way, normal), MIN_DIVISOR)[:, None]
        first = degree * (result[:, b] - result[:, a])
        second = degree * (degree - 1) * (result[:, c] - 2 * result[:, b] + result[:, a])
        lack = -np.einsum("ni,nij,nj->n", first, form, first) - np.einsum("ni,ni->n", normal, second)
        result[:, c] += way * (lack / (degree * (degree - 1)))[:, None]
    return result

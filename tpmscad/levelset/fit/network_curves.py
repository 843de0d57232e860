"""Curves fitted to a level set between points of it, all of a degree at once."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.field import Field
from tpmscad.fields.linear_extension import LinearExtension
from tpmscad.levelset.fit.least_squares import (
    FIT_PASSES,
    TANGENTIAL_WEIGHT,
    NormalEquations,
    project_curves_to_level_set,
    unit_normals,
)
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set
from tpmscad.splines.basis import bernstein_basis

CURVE_TANGENT_WEIGHT = 1.0
END_TANGENT_WEIGHT = 1e3

MIN_CLEARANCE_FRACTION = 0.3
"""Curves that would leave the box keep this part of their ends' distance from its faces: where the surface grazes a face, the
straight way between two vertices leads beyond it, across the surface's section there."""


def fit_curves(field: Field, start: Array, end: Array, fixed: BoolArray, degree: int) -> Array:
    """Curves on the level set between points (n, 3) of it, in planes of the box where coordinates are `fixed`: (n, p + 1, 3)."""
    t = np.linspace(0.0, 1.0, 2 * degree + 4)
    reach = 0.3 * np.linalg.norm(end - start, axis=1)
    straight = start[:, None] + t[:, None] * (end - start)[:, None]
    points = straight
    for _ in range(2):
        points = _resample_by_arc_length(_project_interior_points(field, points, straight, fixed, reach), t)
    points = _project_interior_points(field, points, straight, fixed, reach)

    values, slopes = bernstein_basis(degree, t), bernstein_basis(degree, t, 1)
    share = np.arange(degree + 1)[:, None] / degree
    poles = (1 - share) * start[:, None] + share * end[:, None]
    inner = slice(1, degree)
    for turn in range(FIT_PASSES):
        if turn:
            points = _project_interior_points(field, values @ poles, straight, fixed, reach)
        normal = unit_normals(field, points, fixed)
        slope = slopes @ poles
        system = NormalEquations(degree - 1, len(start))
        system.near(values[:, inner], normal, points - values @ poles, TANGENTIAL_WEIGHT)
        system.along(slopes[:, inner], normal, -slope, CURVE_TANGENT_WEIGHT / len(t))
        system.along(slopes[[0, -1]][:, inner], normal[:, [0, -1]], -slope[:, [0, -1]], END_TANGENT_WEIGHT)
        poles[:, inner] += system.solved()
    rows, axis = np.nonzero(fixed)
    poles[rows, :, axis] = start[rows, axis][:, None]
    return poles


def _resample_by_arc_length(points: Array, t: Array) -> Array:
    """Polylines (n, m, 3) resampled at fractions t of their length."""
    step = np.linalg.norm(np.diff(points, axis=1), axis=2)
    along = np.concatenate([np.zeros((len(points), 1)), np.cumsum(step, axis=1)], axis=1)
    along /= np.maximum(along[:, -1:], 1e-300)
    at = np.clip((along[:, None, :] <= t[None, :, None]).sum(axis=2) - 1, 0, points.shape[1] - 2)
    low, high = np.take_along_axis(along, at, 1), np.take_along_axis(along, at + 1, 1)
    s = ((t - low) / np.maximum(high - low, 1e-300))[..., None]
    start, end = (np.take_along_axis(points, k[..., None], 1) for k in (at, at + 1))
    return (1 - s) * start + s * end


def _project_interior_points(field: Field, points: Array, straight: Array, fixed: BoolArray, reach: Array) -> Array:
    """Points of curves (n, m, 3) but for their ends brought onto the surface, in the box where there is one."""
    result = points.copy()
    result[:, 1:-1] = project_curves_to_level_set(field, points[:, 1:-1], fixed, reach)
    if not isinstance(field, LinearExtension):
        return result
    lo, hi = np.array(field.lo), np.array(field.hi)
    leaving = np.flatnonzero(((result < lo) | (result > hi))[:, 1:-1].any(axis=(1, 2)))
    low, high = (b + MIN_CLEARANCE_FRACTION * (straight[leaving] - b) for b in (lo, hi))
    out = (result[leaving] < low) | (result[leaving] > high)
    out[:, [0, -1]] = False
    row, at = np.nonzero(out.any(axis=2))
    if len(row):
        moved = np.clip(result[leaving[row], at], low[row, at], high[row, at])
        result[leaving[row], at] = project_to_level_set(
            field, moved, fixed[leaving[row]] | out[row, at], reach[leaving[row]], 8
        )
    return result

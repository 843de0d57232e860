"""Bezier curves fitted to a level set between two of its points, all of one degree at once."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.linear_extension import LinearExtension
from tpmscad.levelset.fit.equality_constraints import EqualityConstraints
from tpmscad.levelset.fit.joint_normals import EndShapes, match_end_curvatures
from tpmscad.levelset.fit.least_squares import (
    FAIRNESS_WEIGHT,
    FIT_PASSES,
    MAX_STEP_OF_CHORD,
    PROJECTION_STEPS,
    TANGENTIAL_WEIGHT,
    project_curves_to_level_set,
    unit_vectors,
)
from tpmscad.levelset.fit.normal_equations import NormalEquations, curve_basis
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR
from tpmscad.splines.basis import bending_energy, bernstein_basis

CURVE_TANGENT_WEIGHT = 1.0
"""Weight of the residuals by which tangents along the curve leave the level set."""

MIN_CLEARANCE_FRACTION = 0.3
"""A curve that would leave the box keeps at least this fraction of its chord's distance from the faces. Where the level set
grazes a face, the shortest way between two vertices leads beyond the face."""


def fit_curves(field: Field, start: Array, end: Array, fixed: BoolArray, degree: int, shapes: EndShapes) -> Array:
    """Poles (n, p + 1, 3) of curves on the level set from `start` to `end` (n, 3), in planes of the box where `fixed` (n, 3).

    They have tangents in the tangent planes and the normal curvatures of the level set at their ends, whose shapes are given.
    """
    t = np.linspace(0.0, 1.0, 2 * degree + 4)
    max_step = MAX_STEP_OF_CHORD * np.linalg.norm(end - start, axis=1)
    chord = start[:, None] + t[:, None] * (end - start)[:, None]
    # of unit length in the planes of the box, too: the condition at one end counts no less than that at the other
    end_normals = unit_vectors(shapes.normal, fixed)
    points = chord
    for _ in range(2):
        points = _project_interior_points(field, points, chord, fixed, max_step, end_normals)[0]
        points = _resample_by_arc_length(points, t)
    points, normal = _project_interior_points(field, points, chord, fixed, max_step, end_normals)

    values, derivatives = bernstein_basis(degree, t), bernstein_basis(degree, t, 1)
    energy, numbers = bending_energy(degree + 1, 1), np.arange(degree + 1)
    fraction = np.arange(degree + 1)[:, None] / degree
    poles = (1 - fraction) * start[:, None] + fraction * end[:, None]
    held = hold_end_poles(end_normals, degree - 1)
    for turn in range(FIT_PASSES):
        if turn:
            points, normal = _project_interior_points(field, values @ poles, chord, fixed, max_step, end_normals)
        inner = slice(1, degree)
        system = NormalEquations(degree - 1, len(start))
        system.add_point_rows(curve_basis(values[:, inner]), normal, points - values @ poles, TANGENTIAL_WEIGHT)
        tangent = derivatives @ poles
        system.add_normal_rows(curve_basis(derivatives[:, inner]), normal, -tangent, CURVE_TANGENT_WEIGHT / len(t))
        system.add_energy(energy, numbers[inner], poles, FAIRNESS_WEIGHT)
        lack = np.einsum("nei,nei->ne", end_normals, poles[:, [0, -1]] - poles[:, [1, -2]])
        poles[:, inner] += system.solve_subject_to(held, lack)
    poles = match_end_curvatures(poles, shapes, fixed)
    held = hold_end_poles(end_normals, degree - 3)
    for _ in range(FIT_PASSES):
        points, normal = _project_interior_points(field, values @ poles, chord, fixed, max_step, end_normals)
        inner = slice(2, degree - 1)
        system = NormalEquations(degree - 3, len(start))
        system.add_point_rows(curve_basis(values[:, inner]), normal, points - values @ poles, TANGENTIAL_WEIGHT)
        system.add_energy(energy, numbers[inner], poles, FAIRNESS_WEIGHT)
        poles[:, inner] += system.solve_subject_to(held, np.zeros((len(start), 2)))
    rows, axis = np.nonzero(fixed)
    poles[rows, :, axis] = start[rows, axis][:, None]
    return poles


def hold_end_poles(normals: Array, count: int) -> EqualityConstraints:
    """Conditions on the components of the first and the last of `count` poles along normals (n, 2, 3).

    Where a normal vanishes there is no condition.
    """
    rows = np.zeros((len(normals), 2, count, 3))
    rows[:, 0, 0], rows[:, 1, -1] = normals[:, 0], normals[:, 1]
    return EqualityConstraints.factorise(rows.reshape(len(normals), 2, -1))


def _resample_by_arc_length(points: Array, t: Array) -> Array:
    """Polylines (n, m, 3) resampled at fractions t of their lengths."""
    step = np.linalg.norm(np.diff(points, axis=1), axis=2)
    arc = np.concatenate([np.zeros((len(points), 1)), np.cumsum(step, axis=1)], axis=1)
    arc /= np.maximum(arc[:, -1:], MIN_DIVISOR)
    segment = np.clip((arc[:, None, :] <= t[None, :, None]).sum(axis=2) - 1, 0, points.shape[1] - 2)
    low, high = np.take_along_axis(arc, segment, 1), np.take_along_axis(arc, segment + 1, 1)
    s = ((t - low) / np.maximum(high - low, MIN_DIVISOR))[..., None]
    start, end = (np.take_along_axis(points, k[..., None], 1) for k in (segment, segment + 1))
    return (1 - s) * start + s * end


def _project_interior_points(
    field: Field, points: Array, chord: Array, fixed: BoolArray, max_step: Array, end_normals: Array
) -> tuple[Array, Array]:
    """Points of curves (n, m, 3) projected onto the level set, except their ends, and unit normals; in the box of an extension.

    Points that leave the box of a `LinearExtension`, or come too near to its faces, are moved back and projected parallel to the
    faces they crossed. `end_normals` (n, 2, 3) are known.
    """
    result, normals = points.copy(), np.empty(points.shape)
    result[:, 1:-1], normals[:, 1:-1] = project_curves_to_level_set(field, points[:, 1:-1], fixed, max_step)
    normals[:, [0, -1]] = end_normals
    if not isinstance(field, LinearExtension):
        return result, normals
    lo, hi = np.array(field.lo), np.array(field.hi)
    leaving = np.flatnonzero(((result < lo) | (result > hi))[:, 1:-1].any(axis=(1, 2)))
    low, high = (b + MIN_CLEARANCE_FRACTION * (chord[leaving] - b) for b in (lo, hi))
    out = (result[leaving] < low) | (result[leaving] > high)
    out[:, [0, -1]] = False
    row, k = np.nonzero(out.any(axis=2))
    if len(row):
        curve = leaving[row]
        moved = np.clip(result[curve, k], low[row, k], high[row, k])
        held = fixed[curve] | out[row, k]
        result[curve, k] = project_to_level_set(field, moved, held, max_step[curve], PROJECTION_STEPS)
        normals[curve, k] = unit_vectors(field.gradient(result[curve, k])[:, None], fixed[curve])[:, 0]
    return result, normals

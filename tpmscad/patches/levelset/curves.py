"""Curves fitted to a level set between points of it, all of a degree at once."""

from __future__ import annotations

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.bezier import bezier
from tpmscad.patches.levelset.inside import Inside
from tpmscad.patches.levelset.layout.octree import Array, Mask
from tpmscad.patches.levelset.layout.relax import onto
from tpmscad.patches.levelset.least import PASSES, SLIDE, System, normals, onto_all

CURVE_TANGENT = 1.0
END_TANGENT = 1e3

CLEAR = 0.3
"""Curves that would leave the box keep this part of their ends' distance from its faces: where the surface grazes a face, the
straight way between two vertices leads beyond it, across the surface's section there."""


def fit_curves(field: Field, start: Array, end: Array, fixed: Mask, degree: int) -> Array:
    """Curves on the level set between points (n, 3) of it, in planes of the box where coordinates are `fixed`: (n, p + 1, 3)."""
    t = np.linspace(0.0, 1.0, 2 * degree + 4)
    reach = 0.3 * np.linalg.norm(end - start, axis=1)
    straight = start[:, None] + t[:, None] * (end - start)[:, None]
    points = straight
    for _ in range(2):
        points = _evenly(_between(field, points, straight, fixed, reach), t)
    points = _between(field, points, straight, fixed, reach)

    values, slopes = bezier(degree, t), bezier(degree, t, 1)
    share = np.arange(degree + 1)[:, None] / degree
    poles = (1 - share) * start[:, None] + share * end[:, None]
    inner = slice(1, degree)
    for turn in range(PASSES):
        if turn:
            points = _between(field, values @ poles, straight, fixed, reach)
        normal = normals(field, points, fixed)
        slope = slopes @ poles
        system = System(degree - 1, len(start))
        system.near(values[:, inner], normal, points - values @ poles, SLIDE)
        system.along(slopes[:, inner], normal, -slope, CURVE_TANGENT / len(t))
        system.along(slopes[[0, -1]][:, inner], normal[:, [0, -1]], -slope[:, [0, -1]], END_TANGENT)
        poles[:, inner] += system.solved()
    rows, axis = np.nonzero(fixed)
    poles[rows, :, axis] = start[rows, axis][:, None]
    return poles


def _evenly(points: Array, t: Array) -> Array:
    """Polylines (n, m, 3) resampled at fractions t of their length."""
    step = np.linalg.norm(np.diff(points, axis=1), axis=2)
    along = np.concatenate([np.zeros((len(points), 1)), np.cumsum(step, axis=1)], axis=1)
    along /= np.maximum(along[:, -1:], 1e-300)
    at = np.clip((along[:, None, :] <= t[None, :, None]).sum(axis=2) - 1, 0, points.shape[1] - 2)
    low, high = np.take_along_axis(along, at, 1), np.take_along_axis(along, at + 1, 1)
    s = ((t - low) / np.maximum(high - low, 1e-300))[..., None]
    start, end = (np.take_along_axis(points, k[..., None], 1) for k in (at, at + 1))
    return (1 - s) * start + s * end


def _between(field: Field, points: Array, straight: Array, fixed: Mask, reach: Array) -> Array:
    """Points of curves (n, m, 3) but for their ends brought onto the surface, in the box where there is one."""
    result = points.copy()
    result[:, 1:-1] = onto_all(field, points[:, 1:-1], fixed, reach)
    if not isinstance(field, Inside):
        return result
    lo, hi = np.array(field.lo), np.array(field.hi)
    leaving = np.flatnonzero(((result < lo) | (result > hi))[:, 1:-1].any(axis=(1, 2)))
    low, high = (b + CLEAR * (straight[leaving] - b) for b in (lo, hi))
    out = (result[leaving] < low) | (result[leaving] > high)
    out[:, [0, -1]] = False
    row, at = np.nonzero(out.any(axis=2))
    if len(row):
        moved = np.clip(result[leaving[row], at], low[row, at], high[row, at])
        result[leaving[row], at] = onto(field, moved, fixed[leaving[row]] | out[row, at], reach[leaving[row]], 8)
    return result

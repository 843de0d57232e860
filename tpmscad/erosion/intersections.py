"""Points common to two or three sheets, in the parameters of all of them, by Newton's method."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.erosion.offset_shell import Rim
from tpmscad.erosion.sheets import Sheet
from tpmscad.splines.bspline import BSplineSurface

MAX_STEPS = 16
"""Newton steps; from the neighbouring point of a curve three to five suffice."""

RESIDUAL_REL_TOL = 1e-13
"""In sizes of the coordinates: distance of the points on the sheets that counts as zero."""

CONTINUATION = 1e-4
"""Of the range of a parameter: how far the polynomials of the end spans of a fitted sheet are followed beyond its domain.
Faces of a body miss each other at a seam by its own inaccuracy."""

LEAST_PIVOT = 1e-13
"""Singular values below this part of the largest one are left out, where sheets are tangent."""


def _within_domains(sheets: Sequence[Sheet], y: Array) -> Array:
    """Parameters (n, 2 k) with those of fitted sheets clipped to what was fitted, and a little that its end spans go on."""
    for k, sheet in enumerate(sheets):
        if isinstance(sheet.carrier, BSplineSurface):
            for axis, (low, high) in enumerate(sheet.carrier.domain):
                slack = CONTINUATION * (high - low)
                y[:, 2 * k + axis] = np.clip(y[:, 2 * k + axis], low - slack, high + slack)
    return y


@dataclass(frozen=True, slots=True, eq=False)
class Meeting:
    """Points (n, 3) of two sheets, parameters (n, 4), derivatives by these (n, 4, 3), and which points converged (n,)."""

    parameters: Array
    points: Array
    frames: Array
    converged: BoolArray


def meet_pair(one: Sheet, other: Sheet, y: Array, at: Array, along: Array) -> Meeting:
    """Points of two sheets in the planes through `at` (n, 3) normal to `along` (n, 3), from parameters y (n, 4)."""
    y, scale, n = y.copy(), 1.0 + float(np.abs(at).max(initial=0.0)), len(y)
    residual, frames, points = np.full((n, 4), np.inf), np.zeros((n, 4, 3)), np.zeros((n, 3))
    matrix = np.empty((n, 4, 4))
    for _ in range(MAX_STEPS):
        first, frames[:, 0], frames[:, 1] = one.jet(y[:, :2])
        second, frames[:, 2], frames[:, 3] = other.jet(y[:, 2:])
        points = 0.5 * (first + second)
        residual = np.concatenate([first - second, ((first - at) * along).sum(axis=1, keepdims=True)], axis=1)
        if np.abs(residual).max(initial=0.0) <= RESIDUAL_REL_TOL * scale:
            break
        matrix[:, :3, :2] = frames[:, :2].swapaxes(1, 2)
        matrix[:, :3, 2:] = -frames[:, 2:].swapaxes(1, 2)
        matrix[:, 3, :2], matrix[:, 3, 2:] = (frames[:, :2] @ along[:, :, None])[:, :, 0], 0.0
        y = _within_domains((one, other), y - _solve(matrix, residual))
    converged = np.abs(residual).max(axis=1, initial=0.0) <= 1000 * RESIDUAL_REL_TOL * scale
    return Meeting(y, points, frames, np.asarray(converged))


def meet_three(sheets: Sequence[Sheet], y: Array) -> tuple[Array, Array] | None:
    """The common point of three sheets, from parameters y (6,): the parameters (6,) and the point (3,); None if there is none."""
    y = y[None].copy()
    for _ in range(MAX_STEPS):
        jets = [sheet.jet(y[:, 2 * k : 2 * k + 2]) for k, sheet in enumerate(sheets)]
        points = [jet[0][0] for jet in jets]
        scale = 1.0 + float(np.abs(points[0]).max())
        residual = np.concatenate([points[0] - points[1], points[0] - points[2]])
        if np.abs(residual).max() <= RESIDUAL_REL_TOL * scale:
            break
        matrix = np.zeros((6, 6))
        for row in (0, 1):
            matrix[3 * row : 3 * row + 3, :2] = np.stack([jets[0][1][0], jets[0][2][0]], axis=1)
            k = row + 1
            matrix[3 * row : 3 * row + 3, 2 * k : 2 * k + 2] = -np.stack([jets[k][1][0], jets[k][2][0]], axis=1)
        y = _within_domains(sheets, y - _solve(matrix[None], residual[None]))
    if not np.abs(residual).max() <= 1000 * RESIDUAL_REL_TOL * scale:
        return None
    return y[0], np.mean(points, axis=0)


def meet_rim(rim: Rim, sheet: Sheet, t: float, uv: Array) -> tuple[float, Array, Array] | None:
    """Where a rim pierces a sheet, from its parameter t and (u, v) on the sheet: these and the point (3,); None if nowhere."""
    y = np.array([t, *uv])
    for _ in range(MAX_STEPS):
        at, slope = rim.curve(y[0]), rim.curve(y[0], 1)
        point, along_u, along_v = (x[0] for x in sheet.jet(y[None, 1:]))
        scale = 1.0 + float(np.abs(at).max())
        residual = at - point
        if np.abs(residual).max() <= RESIDUAL_REL_TOL * scale:
            break
        y = y - _solve(np.stack([slope, -along_u, -along_v], axis=1)[None], residual[None])[0]
        y[0] = np.clip(y[0], *rim.span)
        y[None, 1:] = _within_domains((sheet,), y[None, 1:])
    if not np.abs(residual).max() <= 1000 * RESIDUAL_REL_TOL * scale:
        return None
    return float(y[0]), y[1:], at


def _solve(matrix: Array, residual: Array) -> Array:
    """Solutions (n, k) of square systems, of least norm where they are singular."""
    try:
        found = np.linalg.solve(matrix, residual[..., None])[..., 0]
        if np.isfinite(found).all():
            return np.asarray(found)
    except np.linalg.LinAlgError:
        pass
    return np.asarray((np.linalg.pinv(matrix, rcond=LEAST_PIVOT) @ residual[..., None])[..., 0])

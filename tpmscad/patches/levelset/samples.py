"""Points of a level set in a box, found along the lines of a grid; where the field jumps there is none, and that is said."""

from __future__ import annotations

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.caps import LayoutError
from tpmscad.patches.levelset.layout.octree import Array
from tpmscad.patches.levelset.layout.relax import onto

HALVINGS, JUMP = 40, 1e-3
"""Where a step between grid points still has this part of its height after so many halvings, the field jumps."""


def samples_of(field: Field, lo: Array, hi: Array, spacing: float) -> Array:
    """Points of {field = 0} in the box: where it crosses the lines of a grid of about that spacing, shifted off every layout.

    LayoutError where the field jumps from one sign to the other: it has no level set there to follow.
    """
    counts = np.maximum(2, np.ceil((hi - lo) / spacing)).astype(int) + 1
    axes = [np.linspace(low, high, n) for low, high, n in zip(lo, hi, counts, strict=True)]
    values = field.on_grid(*axes)
    found, brackets = [], []
    for axis in range(3):
        swapped = np.moveaxis(values, axis, 0)
        i, j, k = np.nonzero((swapped[:-1] > 0) != (swapped[1:] > 0))
        f0, f1 = swapped[i, j, k], swapped[i + 1, j, k]
        b, c = (a for a in range(3) if a != axis)
        points = np.empty((len(i), 3))
        points[:, axis] = axes[axis][i] + f0 / (f0 - f1) * (axes[axis][i + 1] - axes[axis][i])
        points[:, b], points[:, c] = axes[b][j], axes[c][k]
        fixed = np.ones(points.shape, bool)
        fixed[:, axis] = False
        found.append(onto(field, points, fixed, np.full(len(points), 0.5 * spacing)))
        low, high = points.copy(), points.copy()
        low[:, axis], high[:, axis] = axes[axis][i], axes[axis][i + 1]
        brackets.append(np.stack([low, high], axis=1))
    points, bracket = np.concatenate(found), np.concatenate(brackets)
    inside = ((points >= lo) & (points <= hi)).all(axis=1)
    value, slope = field.value_and_gradient(points)
    converged = np.abs(value) <= 1e-6 * spacing * np.linalg.norm(slope, axis=1)
    _check_no_jump(field, bracket[~converged])
    return points[inside & converged]


def _check_no_jump(field: Field, bracket: Array) -> None:
    """LayoutError where the field's sign changes between points (n, 2, 3) without its value passing zero."""
    if not len(bracket):
        return
    low, high = bracket[:, 0], bracket[:, 1]
    first, last = field(low), field(high)
    wide, below = np.abs(last - first), first > 0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        same = (field(middle) > 0) == below
        low, high = np.where(same[:, None], middle, low), np.where(same[:, None], high, middle)
    first, last = field(low), field(high)
    jump = np.abs(last - first)
    if (jump > JUMP * wide).any():
        worst = int((jump / np.maximum(wide, 1e-300)).argmax())
        where = ", ".join(f"{x:.5g}" for x in low[worst])
        raise LayoutError(
            f"the field jumps from {first[worst]:.3g} to {last[worst]:.3g} at ({where}): it must be continuous in the domain; "
            "of a blend, keep the domain within the regions, and the border between them within the blending region"
        )

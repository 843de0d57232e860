"""A field taken apart into the level sets that bound its solid, each laid out by itself.

The solid of an intersection is bounded by parts of both level sets, and where these never meet inside the box (the two walls of a
sheet) each is whole: {max(f, g) = 0} is {f = 0} and {g = 0} side by side. So a thin wall costs what a thick one does. Level sets
that meet make an edge, which patches that join smoothly can't follow.

Points of a level set in a box, found along the lines of a grid; where the field jumps there is none, and that is said.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.errors import LevelSetError
from tpmscad.fields.field import Field, MinMaxField
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set


def decompose_level_sets(field: Field) -> tuple[Field, ...]:
    """The fields whose level sets bound the solid of `field`."""
    if isinstance(field, MinMaxField):
        return (*decompose_level_sets(field.first), *decompose_level_sets(field.second))
    return (field,)


def replace_level_sets(field: Field, parts: tuple[Field, ...]) -> Field:
    """`field` with its layers, as `layers` takes them apart, replaced by others."""
    if isinstance(field, MinMaxField):
        n = len(decompose_level_sets(field.first))
        return MinMaxField(
            replace_level_sets(field.first, parts[:n]), replace_level_sets(field.second, parts[n:]), field.sign
        )
    return parts[0]


def check_separation(field: Field, parts: tuple[Field, ...], points: list[Array], tol: float) -> float:
    """The least distance between the layers, to first order, at `points` (n, 3) of each; LayoutError unless above 2 tol.

    On {f = 0} the whole field must vanish, too: elsewhere that part of the level set does not bound the solid.
    """
    least = np.inf
    for i, part in enumerate(parts):
        if len(parts) == 1 or not len(points[i]):
            continue
        off = np.abs(field(points[i])) / np.linalg.norm(part.gradient(points[i]), axis=1)
        if off.max() > tol:
            raise LevelSetError(
                f"two surfaces cross near {_format_point(points[i][off.argmax()])}: an edge that smooth patches can't follow; "
                "round it (fields.smooth_intersection, smooth_union) or cut the solid by the kernel instead"
            )
        for other in (o for j, o in enumerate(parts) if j != i):
            value, slope = other.value_and_gradient(points[i])
            wall = np.abs(value) / np.maximum(np.linalg.norm(slope, axis=1), 1e-300)
            least = min(least, float(wall.min()))
            if least <= 2 * tol:
                raise LevelSetError(
                    f"the wall is {wall.min():.3g} thick near {_format_point(points[i][wall.argmin()])}, which tol {tol:g} can't "
                    f"tell from none: use a tol below {wall.min() / 2:.2g}, or a thicker wall"
                )
    return least


def _format_point(point: Array) -> str:
    return "(" + ", ".join(f"{x:.5g}" for x in point) + ")"


JUMP_HALVINGS, JUMP_FRACTION = 40, 1e-3
"""Where a step between grid points still has this part of its height after so many halvings, the field jumps."""


def sample_level_set(field: Field, lo: Array, hi: Array, spacing: float) -> Array:
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
        found.append(project_to_level_set(field, points, fixed, np.full(len(points), 0.5 * spacing)))
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
    for _ in range(JUMP_HALVINGS):
        middle = 0.5 * (low + high)
        same = (field(middle) > 0) == below
        low, high = np.where(same[:, None], middle, low), np.where(same[:, None], high, middle)
    first, last = field(low), field(high)
    jump = np.abs(last - first)
    if (jump > JUMP_FRACTION * wide).any():
        worst = int((jump / np.maximum(wide, 1e-300)).argmax())
        where = ", ".join(f"{x:.5g}" for x in low[worst])
        raise LevelSetError(
            f"the field jumps from {first[worst]:.3g} to {last[worst]:.3g} at ({where}): it must be continuous in the domain; "
            "of a blend, keep the domain within the regions, and the border between them within the blending region"
        )

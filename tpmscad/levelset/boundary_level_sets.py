"""The level sets that bound a solid: decomposition of a field into them, samples of each, and the distance between them.

The solid of max(f, g) is bounded by parts of {f = 0} and {g = 0}. If the two never meet inside the box, as the two walls of a
sheet, the boundary is both of them entirely, and each can be meshed and fitted by itself: a thin wall then needs no more patches
than a thick one. Level sets that meet form a sharp edge, which smoothly joined patches cannot follow; such a field is rejected,
for its parts to be made one by one and cut by each other.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array, BoolArray
from tpmscad.errors import CrossingSurfaces, LevelSetError, ThinWall, format_point
from tpmscad.fields.analysis.exact_leaves import find_quadric
from tpmscad.fields.analysis.saddles import find_narrow_points, spread_directions
from tpmscad.fields.data.sample_grid import SampleGrid
from tpmscad.fields.field import Field
from tpmscad.fields.kinds.linear_extension import LinearExtension
from tpmscad.levelset.quadmesh.smoothing import project_to_level_set
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR
from tpmscad.memory_limit import require_memory

MIN_WALL_TOLS = 2
"""Least distance between two level sets, in tolerances."""

TOUCHING_TOLS = 1e-6
"""Distance between two level sets, in tolerances, that no finer tolerance would tell from none."""

SAMPLE_STEP_FRACTION = 0.5
"""Largest Newton step of a sample, in spacings of the sampling grid."""

SAMPLE_TOL_FRACTION = 1e-6
"""Distance from the level set, in spacings, within which a sample has converged."""

NARROW_PLACE_LINES = 134
MIN_NARROW_PLACE_CELLS = 8
"""Lines along the longest edge, and the fewest cells along any, of the grid on which narrow places are sought."""

ISOLATION_SPACINGS = 4.0
"""Distance from all known samples, in spacings of that grid, from which a sample is of a part that they missed."""

NARROW_PLACE_RAYS = 8
NARROW_PLACE_RADII = (0.5, 0.1, 0.02)
"""Number of points round a narrow place, at each of these distances in spacings, that are projected onto the level set."""

SPACING_RTOL = 0.01
"""Lines may be farther apart by this, so that those of data whose spacings differ by a little pass the samples."""

JUMP_HALVINGS = 40
JUMP_FRACTION = 1e-3
"""A sign change is a jump of the field if after this number of bisections its height is still this fraction of the first one."""

CORNER_TOL_FRACTION = 1e-2
"""A level set closer to a corner of the box than this fraction of the tolerance is shifted."""

MAX_SHIFT_FRACTION = 0.1
MAX_VOLUME_CHANGE_FRACTION = 3e-4
"""Largest shift of a level set, as a fraction of the tolerance, and largest change of the solid's volume by it, as a fraction."""

CROSSINGS_PER_AREA = 1.5
"""Crossings of a surface with the lines of a grid per squared grid step of its area: the mean of |nx| + |ny| + |nz| over
directions."""


BYTES_PER_SAMPLE = 40
"""Of a grid on which a field's level set is looked for: the values, their signs and the crossings."""


def check_separation(field: Field, parts: tuple[Field, ...], points: list[Array], tol: float) -> float:
    """The least distance between the level sets, to first order, at `points` (n, 3) of each.

    CrossingSurfaces if `field` does not vanish all over each level set, which then bounds the solid in part only, or if a plane,
    sphere or cylinder, which can be exact, is within 2 tol of another; ThinWall if two others are.
    """
    least = np.inf
    for i, part in enumerate(parts):
        if len(parts) == 1 or not len(points[i]):
            continue
        distance = np.abs(field(points[i])) / np.linalg.norm(part.gradient(points[i]), axis=1)
        if distance.max() > tol:
            crossing = np.where(distance > tol, distance, np.inf).argmin()
            raise CrossingSurfaces(
                f"two surfaces cross near {format_point(points[i][crossing], 5)}: an edge that smooth patches can't "
                "follow; round it (`width` of a smooth intersection or union), or give the body that cuts the solid as `domain`"
            )
        for other in (o for j, o in enumerate(parts) if j != i):
            value, gradient = other.value_and_gradient(points[i])
            wall = np.abs(value) / np.maximum(np.linalg.norm(gradient, axis=1), MIN_DIVISOR)
            least = min(least, float(wall.min()))
            if least <= MIN_WALL_TOLS * tol:
                at = format_point(points[i][wall.argmin()], 5)
                if find_quadric(part) is not None or find_quadric(other) is not None:
                    raise CrossingSurfaces(f"two surfaces come within {wall.min():.3g} of each other near {at}")
                if wall.min() <= TOUCHING_TOLS * tol:
                    raise LevelSetError(
                        f"two surfaces touch near {at}: a wall or a gap between them has no thickness there; move them apart, by "
                        f"more than {MIN_WALL_TOLS} tol, or make them overlap"
                    )
                raise ThinWall(
                    f"the wall is {wall.min():.3g} thick near {at}, too thin for `tol` "
                    f"{tol:g}: use one below {wall.min() / 2:.2g}, or a thicker wall",
                    float(wall.min()),
                )
    return least


def sample_level_set(field: Field, lo: Array, hi: Array, spacing: float) -> Array:
    """Points (n, 3) of {field = 0} in the box, from its crossings with the lines of a grid of about this spacing.

    LevelSetError where the sign changes in a jump of the field, which has no level set there.
    """
    wanted = np.maximum(2, np.ceil((1.0 - SPACING_RTOL) * (hi - lo) / spacing)) + 1
    require_memory(
        float(np.prod(wanted)),
        BYTES_PER_SAMPLE,
        f"{wanted.max():.3g} samples along an edge of the box, {spacing:.3g} apart",
        "use larger cells or a smaller box",
    )
    counts = wanted.astype(int)
    axes = [np.linspace(low, high, n) for low, high, n in zip(lo, hi, counts, strict=True)]
    points, bracket = _project_line_crossings(field, axes, spacing)
    inside = ((points >= lo) & (points <= hi)).all(axis=1)
    value, gradient = field.value_and_gradient(points)
    converged = np.abs(value) <= SAMPLE_TOL_FRACTION * spacing * np.linalg.norm(gradient, axis=1)
    _check_no_jump(field, bracket[~converged])
    flat = np.logical_not(gradient.any(axis=1))
    if flat.any():
        raise LevelSetError(
            f"the gradient is zero on the field's surface, at {flat.sum()} of {len(points)} points, the first near "
            f"{format_point(points[flat][0], 5)}: a surface needs a slope there; check the gradient given, or move the level"
        )
    return points[inside & converged]


@dataclass(frozen=True, slots=True, eq=False)
class NarrowPlaces:
    """Necks, gaps and specks of a level set: critical points (n, 3) of the field near it, found on a grid of spacing `reach`."""

    points: Array
    reach: float


def find_narrow_places(field: Field, lo: Array, hi: Array) -> NarrowPlaces:
    """The narrow places of {field = 0} in the box."""
    cells = np.maximum(MIN_NARROW_PLACE_CELLS, np.ceil(NARROW_PLACE_LINES * (hi - lo) / (hi - lo).max())).astype(int)
    grid = SampleGrid(tuple(lo.tolist()), tuple(hi.tolist()), tuple((cells + 1).tolist()))
    reach = float(grid.spacing.max())
    [narrow] = find_narrow_points([field], grid, reach)
    return NarrowPlaces(narrow.points, reach)


def sample_narrow_places(field: Field, lo: Array, hi: Array, known: Array, found: NarrowPlaces) -> Array:
    """Points (n, 3) of {field = 0} in the box that samples `known` (m, 3) may have missed.

    They surround the narrow places found, which may lie between samples on a finer grid. Samples of that grid far from those
    known are of small parts.
    """
    places, reach = found.points, found.reach
    around = np.concatenate([reach * radius * spread_directions(NARROW_PLACE_RAYS) for radius in NARROW_PLACE_RADII])
    starts = (places[:, None] + np.concatenate([np.zeros((1, 3)), around])).reshape(-1, 3)
    starts = starts[((starts >= lo) & (starts <= hi)).all(axis=1)]
    points = project_to_level_set(field, starts, np.zeros(starts.shape, bool), np.full(len(starts), reach))
    value, gradient = field.value_and_gradient(points)
    converged = np.abs(value) < SAMPLE_TOL_FRACTION * reach * np.linalg.norm(gradient, axis=1)
    near = np.linalg.norm(points - starts, axis=1) <= reach
    around_places = points[converged & near & ((points >= lo) & (points <= hi)).all(axis=1)]
    finer = sample_level_set(field, lo, hi, reach)
    if len(known):
        finer = finer[cKDTree(known).query(finer)[0] > ISOLATION_SPACINGS * reach]
    return np.concatenate([finer, around_places])


def shift_level_off_corners(
    field: Field, part: LinearExtension, points: Array, lo: Array, hi: Array, tol: float, spacing: float
) -> tuple[LinearExtension, str | None]:
    """The part of `field` with its level shifted by at most a tenth of tol if it passes through a corner of the box, and a note.

    `points` (n, 3) are its samples with this spacing. The shift is limited by the change of the solid's volume, too.
    """
    corners = box_corners(lo, hi).reshape(-1, 3)
    value, gradient = part.value_and_gradient(corners)
    near = np.abs(value) < CORNER_TOL_FRACTION * tol * np.linalg.norm(gradient, axis=1)
    if not (near.any() and len(points)):
        return part, None
    volume_per_area = _estimate_volume_per_area(field, points, lo, hi, spacing)
    distance = min(MAX_SHIFT_FRACTION * tol, MAX_VOLUME_CHANGE_FRACTION * volume_per_area)
    shift = distance * float(np.linalg.norm(part.gradient(points), axis=1).min())
    note = f"the surface passes through the box's corner {format_point(corners[near][0], 6)}: its level was moved by {shift:.3g}"
    return replace(part, field=part.field + shift), note


def measure_shape_operators(field: Field, points: Array, step: float) -> Array:
    """Shape operators (n, 3, 3) of the level sets through points (n, 3), by differences of the gradient over `step`.

    Their eigenvalues are the principal curvatures, and zero along the normal.
    """
    gradient = field.gradient(points)
    norm = np.maximum(np.linalg.norm(gradient, axis=1, keepdims=True), MIN_DIVISOR)
    normal = gradient / norm
    hessian = np.stack(
        [(field.gradient(points + step * e) - field.gradient(points - step * e)) / (2 * step) for e in np.eye(3)], -1
    )
    tangential = np.eye(3) - normal[:, :, None] * normal[:, None, :]
    return np.asarray(tangential @ hessian @ tangential / norm[..., None])


def box_corners(lo: Array, hi: Array) -> Array:
    """Corners (2, 2, 2, 3) of the box [lo, hi]."""
    return np.stack(np.meshgrid(*np.stack([lo, hi], axis=1), indexing="ij"), axis=-1)


def _project_line_crossings(field: Field, axes: list[Array], spacing: float) -> tuple[Array, Array]:
    """Crossings (n, 3) of the level set with grid lines, projected across the lines, and the grid points (n, 2, 3) round them."""
    values = field.on_grid(*axes)
    crossings, brackets = [], []
    for axis in range(3):
        along = np.moveaxis(values, axis, 0)
        i, j, k = np.nonzero((along[:-1] > 0) != (along[1:] > 0))
        f0, f1 = along[i, j, k], along[i + 1, j, k]
        b, c = (a for a in range(3) if a != axis)
        points = np.empty((len(i), 3))
        points[:, axis] = axes[axis][i] + f0 / (f0 - f1) * (axes[axis][i + 1] - axes[axis][i])
        points[:, b], points[:, c] = axes[b][j], axes[c][k]
        fixed = np.ones(points.shape, bool)
        fixed[:, axis] = False
        max_step = np.full(len(points), SAMPLE_STEP_FRACTION * spacing)
        crossings.append(project_to_level_set(field, points, fixed, max_step))
        low, high = points.copy(), points.copy()
        low[:, axis], high[:, axis] = axes[axis][i], axes[axis][i + 1]
        brackets.append(np.stack([low, high], axis=1))
    return np.concatenate(crossings), np.concatenate(brackets)


def _check_no_jump(field: Field, bracket: Array) -> None:
    """LevelSetError if bisection between points (n, 2, 3) of opposite sign ends at a jump of the field."""
    if not len(bracket):
        return
    low, high = bracket[:, 0], bracket[:, 1]
    first, last = field(low), field(high)
    height, positive = np.abs(last - first), first > 0
    for _ in range(JUMP_HALVINGS):
        middle = 0.5 * (low + high)
        same: BoolArray = (field(middle) > 0) == positive
        low, high = np.where(same[:, None], middle, low), np.where(same[:, None], high, middle)
    first, last = field(low), field(high)
    jump = np.abs(last - first)
    if (jump > JUMP_FRACTION * height).any():
        worst = int((jump / np.maximum(height, MIN_DIVISOR)).argmax())
        raise LevelSetError(
            f"the field jumps from {first[worst]:.3g} to {last[worst]:.3g} at {format_point(low[worst], 5)}: it must be "
            "continuous in the domain; of a blend, keep the domain within the regions, and the border between them within the "
            "blending region"
        )


def _estimate_volume_per_area(field: Field, points: Array, lo: Array, hi: Array, spacing: float) -> float:
    """Rough ratio of the solid's volume to the area of a level set with these samples (n, 3), for `shift_level_off_corners`."""
    axes = [np.linspace(a, b, max(2, int(np.ceil((b - a) / spacing))) + 1) for a, b in zip(lo, hi, strict=True)]
    volume = float(np.mean(field.on_grid(*axes) < 0) * np.prod(hi - lo))
    step_squared = float(np.prod([axis[1] - axis[0] for axis in axes]) ** (2 / 3))
    return volume / (len(points) * step_squared / CROSSINGS_PER_AREA)

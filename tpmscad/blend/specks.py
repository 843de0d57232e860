"""Specks: isolated solid or void that no sample has seen, found where the field has a least or greatest value near zero.

A component between the samples holds a least value of f, a void one a greatest. Samples near one are told by their differences
to their neighbours: the parabola through three of them has its vertex within a sample of the middle along every axis, and leaves
room for a change of sign. From there the value is sought on ever closer stencils, which follow creases as well as smooth valleys,
and what has the sign of a speck is looked at on a close grid around: a speck is a component that stays within it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tpmscad.blend.composition import BlendedField
from tpmscad.blend.grid import SLAB, Array, Grid, Ints, Mask
from tpmscad.blend.necks import sphere
from tpmscad.blend.scene import Scene
from tpmscad.fields import Field

NEAR = 0.3
"""Values looked at, in parts of the field's rms in the blending regions."""

ROOM = 0.5
"""Part of the second differences by which a value between samples may pass that of a sample: at a crease half way between two."""

VERTEX = 0.6
"""How far off the vertex may be, in samples: half a sample, and some for what is no parabola."""

SLACK = 0.05
"""Part of all second differences by which the vertex may be off along an axis where the field hardly bends."""

ZOOMS, MOVES = 6, 2
"""Stencils, each half as wide as the one before, and moves on the first two: the place is good to a hundredth of the spacing."""

RAYS = (14, 5), (60, 10)
"""Directions, and points along each, by which most of what is no speck is told: a few first, then more."""

AROUND, CLOSER = 3, 5
"""The close grid: samples to each side, and points to a sample."""


@dataclass(frozen=True, slots=True, eq=False)
class Specks:
    """The extremal points (n, 3) of specks and the values of f there (n,): negative for solid ones."""

    points: Array
    values: Array

    def __len__(self) -> int:
        return len(self.values)


NO_SPECKS = Specks(np.zeros((0, 3)), np.zeros(0))


def specks(scene: Scene, field: BlendedField, values: Array, most: int | None = None) -> Specks | None:
    """The specks between the samples of a scene where the weights act; `values` are those of the field on its grid.

    None, and nothing has been looked for, if more than `most` samples are doubtful.
    """
    starts, signs, room = _candidates(scene, values)
    if most is not None and len(starts) > most:
        return None
    points, least, signs = _sought(scene, field, scene.grid.points(starts), signs, room)
    for rays, radii in RAYS:
        kept = _apart(points, least, scene.grid.spacing)
        kept = kept[_enclosed(scene, field, points[kept], signs[kept], sphere(rays), radii)]
        points, least, signs = points[kept], least[kept], signs[kept]
    found = [k for k, sign in enumerate(signs) if isolated(field, scene.grid, points[k], sign)]
    return Specks(points[found], (signs * least)[found])


def _apart(points: Array, least: Array, spacing: Array) -> Ints:
    """The numbers of the points (n, 3) with the least value of all within about half a spacing."""
    order = np.argsort(least, kind="stable")
    _, once = np.unique(np.round(points[order] / (0.5 * spacing)), axis=0, return_index=True)
    return order[once]


def _candidates(scene: Scene, values: Array) -> tuple[Ints, Array, Array]:
    """Flat indices of samples near a least (sign 1) or greatest (-1) value close to zero, the signs, the room for less."""
    movable: Mask = np.logical_or.reduce(scene.mixing)
    planes = np.flatnonzero(movable.any(axis=(1, 2)))
    total = sum(float(np.sum(values[x][movable[x]] ** 2)) for x in planes)
    near = NEAR * np.sqrt(total / max(int(np.count_nonzero(movable)), 1))
    step = max(1, SLAB // (values.shape[1] * values.shape[2]))
    found = [_doubtful(values, movable, planes[k : k + step], float(near)) for k in range(0, len(planes), step)]
    index, signs, room = (np.concatenate(part) for part in zip(*found, strict=True))
    return index, signs, room


def _doubtful(values: Array, movable: Mask, planes: Ints, limit: float) -> tuple[Ints, Array, Array]:
    """The candidates of some planes across x: at 400^3 all at once would take a gigabyte."""
    _, ny, nz = values.shape
    first = planes[0] * ny * nz
    part = values[planes[0] : planes[-1] + 1]
    near = first + np.flatnonzero((movable[planes[0] : planes[-1] + 1] & (part < limit) & (part > -limit)).reshape(-1))
    flat = values.reshape(-1)
    middle = flat[near]
    place = np.unravel_index(near, values.shape)
    half, second = np.zeros((3, len(near))), np.zeros((3, len(near)))
    for axis, stride in enumerate((ny * nz, nz, 1)):
        low, high = place[axis] == 0, place[axis] == values.shape[axis] - 1
        below = flat[np.where(low, near + stride, near - stride)]
        above = flat[np.where(high, near - stride, near + stride)]
        half[axis], second[axis] = (above - below) / 2, above - 2 * middle + below
    found, signs, rooms = [], [], []
    for sign in (1.0, -1.0):
        bend = np.maximum(sign * second, 0.0)
        room = bend.sum(axis=0)
        chosen = (np.abs(half) <= VERTEX * bend + SLACK * room).all(axis=0)
        chosen &= (sign * middle > 0) & (sign * middle < ROOM * room)
        found.append(near[chosen])
        signs.append(np.full(int(chosen.sum()), sign))
        rooms.append(ROOM * room[chosen])
    return np.concatenate(found), np.concatenate(signs), np.concatenate(rooms)


def _sought(scene: Scene, field: BlendedField, points: Array, signs: Array, room: Array) -> tuple[Array, Array, Array]:
    """Places near the points (n, 3), in the domain, where sign * f is least and below zero: where, how much, and the signs.

    On stencils of 27 points; what cannot get below zero any more is given up.
    """
    low, high, spacing = np.array(scene.grid.low), np.array(scene.grid.high), scene.grid.spacing
    offsets = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    least = signs * field(points)
    for zoom in range(ZOOMS):
        for _ in range(MOVES if zoom < 2 else 1):
            around = np.clip(points[:, None] + offsets * (spacing * 0.5 ** (zoom + 1)), low, high)
            value = signs[:, None] * field(around)
            best, rows = np.argmin(value, axis=1), np.arange(len(points))
            points, least = around[rows, best], np.minimum(least, value[rows, best])
        open_still = least < room * 0.5 ** (zoom + 1)
        points, least, signs, room = points[open_still], least[open_still], signs[open_still], room[open_still]
    below = least < 0
    return points[below], least[below], signs[below]


def _enclosed(scene: Scene, field: BlendedField, points: Array, signs: Array, directions: Array, radii: int) -> Mask:
    """Whether every ray from a point (n, 3) meets the other sign within the close grid, or the border of the domain first."""
    low, high, spacing = np.array(scene.grid.low), np.array(scene.grid.high), scene.grid.spacing
    steps = np.linspace(0, AROUND, radii + 1)[1:, None] * spacing
    rays = points[:, None, None] + directions[None, :, None] * steps
    outside = np.any((rays < low) | (rays > high), axis=-1)
    other = signs[:, None, None] * field(rays) >= 0
    return np.asarray((other | (outside & (signs > 0)[:, None, None])).any(axis=2).all(axis=1))


def isolated(field: Field, grid: Grid, point: Array, sign: float) -> bool:
    """Whether the component of {sign * f < 0} at the point ends within a few samples of it, a void one inside the domain."""
    step = grid.spacing / CLOSER
    reach = np.arange(-AROUND * CLOSER, AROUND * CLOSER + 1)
    axes, open_ends = [], []
    for axis in range(3):
        t = point[axis] + step[axis] * reach
        low, high = grid.low[axis], grid.high[axis]
        axes.append(np.clip(t, low, high)[np.concatenate([[True], np.diff(np.clip(t, low, high)) > 0])])
        open_ends.append((sign < 0 or t[0] >= low, sign < 0 or t[-1] <= high))
    phase: Mask = sign * field.on_grid(*axes) < 0
    labels, _ = ndimage.label(phase)
    place = tuple(int(np.argmin(abs(t - c))) for t, c in zip(axes, point, strict=True))
    if labels[place] == 0:
        return True
    own = labels == labels[place]
    for axis, ends in enumerate(open_ends):
        sides = own.take(0, axis), own.take(-1, axis)
        if any(side.any() for side, counts in zip(sides, ends, strict=True) if counts):
            return False
    return True

"""Specks: isolated solid or void that no sample has seen, found where the field has a least or greatest value near zero.

A component between the samples holds a least value of f, a void one a greatest. Samples near one are told by their differences
to their neighbours: the parabola through three of them has its vertex within a sample of the middle along every axis, and leaves
room for a change of sign. From there the value is sought on ever closer stencils, which follow creases as well as smooth valleys,
and what has the sign of a speck is looked at on a close grid around: a speck is a component that stays within it.

Specks taken away: the weight is asked to give f the sign at them that it has around, and what else was demanded is kept.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import evaluate_affine_form
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.optimiser import BlendState, Strategy, WeightRefiner, evaluate_weights, repair_defects
from tpmscad.blending.weights.constraints import NO_CONSTRAINTS, WeightConstraints, add_consistent_constraints
from tpmscad.fields import Field
from tpmscad.fields.saddles import spread_directions
from tpmscad.fields.sample_grid import POINTS_PER_SLAB, SampleGrid

MAX_CANDIDATE_VALUE_RMS = 0.3
"""Values looked at, in parts of the field's rms in the blending regions."""

CREASE_OVERSHOOT_FRACTION = 0.5
"""Part of the second differences by which a value between samples may pass that of a sample: at a crease half way between two."""

MAX_VERTEX_OFFSET_SAMPLES = 0.6
"""How far off the vertex may be, in samples: half a sample, and some for what is no parabola."""

VERTEX_SLACK_FRACTION = 0.05
"""Part of all second differences by which the vertex may be off along an axis where the field hardly bends."""

STENCIL_ZOOMS, MOVES_PER_ZOOM = 6, 2
"""Stencils, each half as wide as the one before, and moves on the first two: the place is good to a hundredth of the spacing."""

RAY_TESTS = (14, 5), (60, 10)
"""Directions, and points along each, by which most of what is no speck is told: a few first, then more."""

CLOSE_GRID_REACH_SAMPLES, CLOSE_GRID_POINTS_PER_SAMPLE = 3, 5
"""The close grid: samples to each side, and points to a sample."""


@dataclass(frozen=True, slots=True, eq=False)
class SubgridDefects:
    """The extremal points (n, 3) of specks and the values of f there (n,): negative for solid ones."""

    points: Array
    values: Array

    def __len__(self) -> int:
        return len(self.values)


NO_SUBGRID_DEFECTS = SubgridDefects(np.zeros((0, 3)), np.zeros(0))


def find_subgrid_defects(
    scene: SampledComposition, field: BlendedField, values: Array, most: int | None = None
) -> SubgridDefects | None:
    """The specks between the samples of a scene where the weights act; `values` are those of the field on its grid.

    None, and nothing has been looked for, if more than `most` samples are doubtful.
    """
    starts, signs, room = _find_candidates(scene, values)
    if most is not None and len(starts) > most:
        return None
    points, least, signs = _minimise_on_stencils(scene, field, scene.grid.points(starts), signs, room)
    for rays, radii in RAY_TESTS:
        kept = _select_distinct(points, least, scene.grid.spacing)
        kept = kept[_is_enclosed(scene, field, points[kept], signs[kept], spread_directions(rays), radii)]
        points, least, signs = points[kept], least[kept], signs[kept]
    found = [k for k, sign in enumerate(signs) if is_isolated(field, scene.grid, points[k], sign)]
    return SubgridDefects(points[found], (signs * least)[found])


def _select_distinct(points: Array, least: Array, spacing: Array) -> IntArray:
    """The numbers of the points (n, 3) with the least value of all within about half a spacing."""
    order = np.argsort(least, kind="stable")
    _, once = np.unique(np.round(points[order] / (0.5 * spacing)), axis=0, return_index=True)
    return order[once]


def _find_candidates(scene: SampledComposition, values: Array) -> tuple[IntArray, Array, Array]:
    """Flat indices of samples near a least (sign 1) or greatest (-1) value close to zero, the signs, the room for less."""
    movable: BoolArray = np.logical_or.reduce(scene.mixing_masks)
    planes = np.flatnonzero(movable.any(axis=(1, 2)))
    total = sum(float(np.sum(values[x][movable[x]] ** 2)) for x in planes)
    near = MAX_CANDIDATE_VALUE_RMS * np.sqrt(total / max(int(np.count_nonzero(movable)), 1))
    step = max(1, POINTS_PER_SLAB // (values.shape[1] * values.shape[2]))
    found = [
        _find_candidates_in_planes(values, movable, planes[k : k + step], float(near))
        for k in range(0, len(planes), step)
    ]
    index, signs, room = (np.concatenate(part) for part in zip(*found, strict=True))
    return index, signs, room


def _find_candidates_in_planes(
    values: Array, movable: BoolArray, planes: IntArray, limit: float
) -> tuple[IntArray, Array, Array]:
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
        chosen = (np.abs(half) <= MAX_VERTEX_OFFSET_SAMPLES * bend + VERTEX_SLACK_FRACTION * room).all(axis=0)
        chosen &= (sign * middle > 0) & (sign * middle < CREASE_OVERSHOOT_FRACTION * room)
        found.append(near[chosen])
        signs.append(np.full(int(chosen.sum()), sign))
        rooms.append(CREASE_OVERSHOOT_FRACTION * room[chosen])
    return np.concatenate(found), np.concatenate(signs), np.concatenate(rooms)


def _minimise_on_stencils(
    scene: SampledComposition, field: BlendedField, points: Array, signs: Array, room: Array
) -> tuple[Array, Array, Array]:
    """Places near the points (n, 3), in the domain, where sign * f is least and below zero: where, how much, and the signs.

    On stencils of 27 points; what cannot get below zero any more is given up.
    """
    low, high, spacing = np.array(scene.grid.low), np.array(scene.grid.high), scene.grid.spacing
    offsets = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    least = signs * field(points)
    for zoom in range(STENCIL_ZOOMS):
        for _ in range(MOVES_PER_ZOOM if zoom < 2 else 1):
            around = np.clip(points[:, None] + offsets * (spacing * 0.5 ** (zoom + 1)), low, high)
            value = signs[:, None] * field(around)
            best, rows = np.argmin(value, axis=1), np.arange(len(points))
            points, least = around[rows, best], np.minimum(least, value[rows, best])
        open_still = least < room * 0.5 ** (zoom + 1)
        points, least, signs, room = points[open_still], least[open_still], signs[open_still], room[open_still]
    below = least < 0
    return points[below], least[below], signs[below]


def _is_enclosed(
    scene: SampledComposition, field: BlendedField, points: Array, signs: Array, directions: Array, radii: int
) -> BoolArray:
    """Whether every ray from a point (n, 3) meets the other sign within the close grid, or the border of the domain first."""
    low, high, spacing = np.array(scene.grid.low), np.array(scene.grid.high), scene.grid.spacing
    steps = np.linspace(0, CLOSE_GRID_REACH_SAMPLES, radii + 1)[1:, None] * spacing
    rays = points[:, None, None] + directions[None, :, None] * steps
    outside = np.any((rays < low) | (rays > high), axis=-1)
    other = signs[:, None, None] * field(rays) >= 0
    return np.asarray((other | (outside & (signs > 0)[:, None, None])).any(axis=2).all(axis=1))


def is_isolated(field: Field, grid: SampleGrid, point: Array, sign: float) -> bool:
    """Whether the component of {sign * f < 0} at the point ends within a few samples of it, a void one inside the domain."""
    step = grid.spacing / CLOSE_GRID_POINTS_PER_SAMPLE
    reach = np.arange(
        -CLOSE_GRID_REACH_SAMPLES * CLOSE_GRID_POINTS_PER_SAMPLE,
        CLOSE_GRID_REACH_SAMPLES * CLOSE_GRID_POINTS_PER_SAMPLE + 1,
    )
    axes, open_ends = [], []
    for axis in range(3):
        t = point[axis] + step[axis] * reach
        low, high = grid.low[axis], grid.high[axis]
        axes.append(np.clip(t, low, high)[np.concatenate([[True], np.diff(np.clip(t, low, high)) > 0])])
        open_ends.append((sign < 0 or t[0] >= low, sign < 0 or t[-1] <= high))
    phase: BoolArray = sign * field.on_grid(*axes) < 0
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


MAX_REMOVAL_ROUNDS = 8

MAX_QUICK_CANDIDATES = 400
"""Doubtful samples up to which specks are looked for unless told otherwise: a tenth of a second, and nine random pairs in ten."""

REMOVAL_OVERSHOOT_RMS = 0.05
"""How far past zero f is moved, in parts of its rms in the blending regions, or half of the way within reach."""


def find_blend_subgrid_defects(
    scene: SampledComposition, field: BlendedField, state: BlendState, most: int | None = None
) -> SubgridDefects | None:
    """The specks of a state, those left aside that a structure has by itself: they are the inputs' own. None: not looked for."""
    found = find_subgrid_defects(scene, field.with_weights(state.weights), scene.values(state.weights), most)
    if found is None:
        return None
    theirs = [
        any(-sign * f(point) > 0 and is_isolated(f, scene.grid, point, sign) for f in field.structures)
        for point, sign in zip(found.points, -np.sign(found.values), strict=True)
    ]
    own = ~np.array(theirs, bool)
    return SubgridDefects(found.points[own], found.values[own])


def remove_subgrid_defects(
    scenes: Sequence[SampledComposition], field: BlendedField, start: BlendState, free: WeightRefiner, most: int | None
) -> tuple[BlendState, int, SubgridDefects | None]:
    """A clean state with as few specks as some rounds reach, the rounds taken, and the specks that are left (None: see above)."""
    best, least, rounds = start, find_blend_subgrid_defects(scenes[-1], field, start, most), 0
    for freed in (False, True):
        begin = best
        if least is None or len(least) == 0:
            break
        if freed:
            more = [free(k, weight) for k, weight in enumerate(best.weights)]
            begin = evaluate_weights(scenes, [new or old for new, old in zip(more, best.weights, strict=True)])
        state, found, kept = begin, least, [NO_CONSTRAINTS] * len(best.weights)
        while len(found) and rounds < MAX_REMOVAL_ROUNDS * (1 + freed):
            state, kept, used = _run_removal_round(scenes, field, state, found, kept)
            rounds += used
            if not state.is_clean:
                break
            found = find_blend_subgrid_defects(scenes[-1], field, state) or NO_SUBGRID_DEFECTS
            if len(found) < len(least):
                best, least = state, found
    return best, rounds, least


def _run_removal_round(
    scenes: Sequence[SampledComposition],
    field: BlendedField,
    state: BlendState,
    found: SubgridDefects,
    kept: list[WeightConstraints],
) -> tuple[BlendState, list[WeightConstraints], int]:
    """The specks turned and the errors that this makes mended: the state, all that is demanded, the rounds taken."""
    weights, kept = list(state.weights), list(kept)
    for stage, weight in enumerate(weights):
        groups = _removal_constraints(field.with_weights(weights), stage, found, scenes[-1])
        kept[stage], coefficients, _ = add_consistent_constraints(weight, weight.coefficients, kept[stage], groups)
        weights[stage] = weight.moved(coefficients)
    state = evaluate_weights(scenes, weights)
    if state.is_clean:
        return state, kept, 1
    state, used = repair_defects(scenes, state, Strategy(), MAX_REMOVAL_ROUNDS, kept)
    return state, kept, 1 + used


def _removal_constraints(
    field: BlendedField, stage: int, found: SubgridDefects, scene: SampledComposition
) -> list[WeightConstraints]:
    """Of each speck that the weight of the stage can turn the demand to do so."""
    movable = scene.movable()
    unit = float(np.sqrt(np.mean(scene.values(field.weights)[movable] ** 2)))
    none, slope = evaluate_affine_form(field, stage, found.points)
    signs = -np.sign(found.values)
    farthest = signs * none + np.maximum(signs * slope, 0.0)
    reachable = (slope != 0) & (farthest > 0)
    past = np.minimum(REMOVAL_OVERSHOOT_RMS * unit, 0.5 * farthest)
    return [
        WeightConstraints(
            found.points[k : k + 1],
            np.array([(signs[k] * past[k] - none[k]) / slope[k]]),
            np.array([1.0 if signs[k] * slope[k] > 0 else -1.0]),
        )
        for k in np.flatnonzero(reachable)
    ]

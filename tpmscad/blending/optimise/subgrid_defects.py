"""Subgrid defects: isolated solid or void between the samples, seen by none of them. Their search and their removal.

A component between the samples holds a local minimum of f below zero, a cavity a local maximum above zero. The search has three
steps. Candidates are samples with a value near zero whose second differences allow a change of sign within a sample of them.
From each candidate sign * f is minimised on ever finer stencils of 27 points, which follow creases as well as smooth valleys.
Where the result has changed sign, rays and finally a fine local grid decide whether its component is isolated.

For the removal the weight is constrained such that f has the surrounding sign at the extremum. The paper has no counterpart: it
counts defects at the resolution of the optimisation only.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.blending.composition.affine_form import evaluate_affine_form
from tpmscad.blending.composition.blended_field import BlendedField
from tpmscad.blending.composition.sampled_composition import SampledComposition
from tpmscad.blending.optimise.blend_state import BlendProblem, BlendState, OptimisationOutcome, evaluate_weights
from tpmscad.blending.optimise.constraint_rounds import (
    ConstrainedWeights,
    evaluate_and_repair,
    run_constraint_round,
    start_unconstrained,
)
from tpmscad.blending.weights.constraints import WeightConstraints, make_sign_constraints
from tpmscad.fields import Field
from tpmscad.fields.analysis.saddles import spread_directions
from tpmscad.fields.data.sample_grid import POINTS_PER_SLAB, SampleGrid

MAX_CANDIDATE_VALUE_RMS = 0.3
"""Greatest |f| of a candidate, as a fraction of the field's rms where stages mix."""

CREASE_OVERSHOOT_FRACTION = 0.5
"""Fraction of the second differences by which f between samples may pass a sample: at a crease half way between two samples."""

MAX_VERTEX_OFFSET_SAMPLES = 0.6
"""Distance, in samples, of a candidate from the vertex of its parabola: half a sample, and a reserve for other shapes."""

VERTEX_SLACK_FRACTION = 0.05
"""Fraction of the sum of second differences by which the vertex condition may fail along an axis with little curvature."""

STENCIL_ZOOMS, MOVES_PER_ZOOM = 6, 2
"""Halvings of the stencil, and moves on each of the first two: the extremum is then located to a hundredth of the spacing."""

RAY_TESTS: tuple[tuple[int, int], ...] = ((14, 5), (60, 10))
"""Numbers of directions, and of points along each, of the ray tests: a quick one, then a thorough one."""

CLOSE_GRID_REACH_SAMPLES, CLOSE_GRID_POINTS_PER_SAMPLE = 3, 5
"""Half width of the fine local grid in samples, and its points for each sample."""

MAX_REMOVAL_ROUNDS = 8

MAX_QUICK_CANDIDATES = 400
"""Number of candidates up to which a search is quick, about a tenth of a second."""

REMOVAL_OVERSHOOT_RMS = 0.05
"""Margin beyond zero at a removed extremum, as a fraction of the field's rms; half of the attainable value if that is less."""


@dataclass(frozen=True, slots=True, eq=False)
class SubgridDefects:
    """The extrema (n, 3) of subgrid defects and the values (n,) of f there: negative for solid ones."""

    points: Array
    values: Array

    def __len__(self) -> int:
        return len(self.values)


NO_SUBGRID_DEFECTS = SubgridDefects(np.zeros((0, 3)), np.zeros(0))


def find_subgrid_defects(
    composition: SampledComposition, field: BlendedField, values: Array, max_candidates: int | None = None
) -> SubgridDefects | None:
    """The subgrid defects of a field where its weights act; `values` are its samples on the composition's grid.

    None, without a search, if there are more than `max_candidates` candidates.
    """
    candidates, signs, overshoot = _find_candidates(composition, values)
    if max_candidates is not None and len(candidates) > max_candidates:
        return None
    grid = composition.grid
    points, minima, signs = _minimise_on_stencils(grid, field, grid.points(candidates), signs, overshoot)
    for n_directions, n_points in RAY_TESTS:
        kept = _select_distinct(points, minima, grid.spacing)
        directions = spread_directions(n_directions)
        kept = kept[_is_enclosed(grid, field, points[kept], signs[kept], directions, n_points)]
        points, minima, signs = points[kept], minima[kept], signs[kept]
    isolated = [k for k, sign in enumerate(signs) if is_isolated(field, grid, points[k], sign)]
    return SubgridDefects(points[isolated], (signs * minima)[isolated])


def _select_distinct(points: Array, minima: Array, spacing: Array) -> IntArray:
    """Indices of the points (n, 3) with the least minimum among those within about half a spacing."""
    order = np.argsort(minima, kind="stable")
    _, first_of_cell = np.unique(np.round(points[order] / (0.5 * spacing)), axis=0, return_index=True)
    return order[first_of_cell]


def _find_candidates(composition: SampledComposition, values: Array) -> tuple[IntArray, Array, Array]:
    """Candidate samples: flat indices, the sign for which sign * f may have a negative minimum, its possible overshoot.

    The rms is taken over all samples that stages mix, plane by plane: these masks include later regions, unlike those of
    `rms_in_blending_regions`.
    """
    movable: BoolArray = np.logical_or.reduce(composition.mixing_masks)
    planes = np.flatnonzero(movable.any(axis=(1, 2)))
    total = sum(float(np.sum(values[x][movable[x]] ** 2)) for x in planes)
    limit = MAX_CANDIDATE_VALUE_RMS * np.sqrt(total / max(int(np.count_nonzero(movable)), 1))
    step = max(1, POINTS_PER_SLAB // (values.shape[1] * values.shape[2]))
    found = [
        _find_candidates_in_planes(values, movable, planes[k : k + step], float(limit))
        for k in range(0, len(planes), step)
    ]
    index, signs, overshoot = (np.concatenate(part) for part in zip(*found, strict=True))
    return index, signs, overshoot


def _find_candidates_in_planes(
    values: Array, movable: BoolArray, planes: IntArray, limit: float
) -> tuple[IntArray, Array, Array]:
    """The candidates in some planes across x; all planes at once would take a gigabyte at 400^3."""
    _, ny, nz = values.shape
    offset = planes[0] * ny * nz
    slab = slice(planes[0], planes[-1] + 1)
    is_near_zero = movable[slab] & (values[slab] < limit) & (values[slab] > -limit)
    near = offset + np.flatnonzero(is_near_zero.reshape(-1))
    flat = values.reshape(-1)
    middle = flat[near]
    index = np.unravel_index(near, values.shape)
    half_difference, second_difference = np.zeros((3, len(near))), np.zeros((3, len(near)))
    for axis, stride in enumerate((ny * nz, nz, 1)):
        is_first, is_last = index[axis] == 0, index[axis] == values.shape[axis] - 1
        below = flat[np.where(is_first, near + stride, near - stride)]
        above = flat[np.where(is_last, near - stride, near + stride)]
        half_difference[axis], second_difference[axis] = (above - below) / 2, above - 2 * middle + below
    found, signs, overshoots = [], [], []
    for sign in (1.0, -1.0):
        curvature = np.maximum(sign * second_difference, 0.0)
        total = curvature.sum(axis=0)
        is_extremal = np.abs(half_difference) <= MAX_VERTEX_OFFSET_SAMPLES * curvature + VERTEX_SLACK_FRACTION * total
        chosen = is_extremal.all(axis=0)
        chosen &= (sign * middle > 0) & (sign * middle < CREASE_OVERSHOOT_FRACTION * total)
        found.append(near[chosen])
        signs.append(np.full(int(chosen.sum()), sign))
        overshoots.append(CREASE_OVERSHOOT_FRACTION * total[chosen])
    return np.concatenate(found), np.concatenate(signs), np.concatenate(overshoots)


def _minimise_on_stencils(
    grid: SampleGrid, field: BlendedField, points: Array, signs: Array, overshoot: Array
) -> tuple[Array, Array, Array]:
    """Negative minima of sign * f near the points (n, 3) in the domain: where, their values, and the signs.

    A point is given up once its value exceeds what the remaining stencils can still gain.
    """
    low, high, spacing = np.array(grid.low), np.array(grid.high), grid.spacing
    offsets = np.stack(np.meshgrid(*[[-1.0, 0.0, 1.0]] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    minima = signs * field(points)
    for zoom in range(STENCIL_ZOOMS):
        for _ in range(MOVES_PER_ZOOM if zoom < 2 else 1):
            stencil = np.clip(points[:, None] + offsets * (spacing * 0.5 ** (zoom + 1)), low, high)
            value = signs[:, None] * field(stencil)
            best, rows = np.argmin(value, axis=1), np.arange(len(points))
            points, minima = stencil[rows, best], np.minimum(minima, value[rows, best])
        is_open = minima < overshoot * 0.5 ** (zoom + 1)
        points, minima, signs, overshoot = points[is_open], minima[is_open], signs[is_open], overshoot[is_open]
    below = minima < 0
    return points[below], minima[below], signs[below]


def _is_enclosed(
    grid: SampleGrid, field: BlendedField, points: Array, signs: Array, directions: Array, n_points: int
) -> BoolArray:
    """Whether every ray from a point (n, 3) meets the opposite sign within the local grid, or first leaves the domain."""
    low, high, spacing = np.array(grid.low), np.array(grid.high), grid.spacing
    steps = np.linspace(0, CLOSE_GRID_REACH_SAMPLES, n_points + 1)[1:, None] * spacing
    rays = points[:, None, None] + directions[None, :, None] * steps
    is_outside = np.any((rays < low) | (rays > high), axis=-1)
    is_opposite = signs[:, None, None] * field(rays) >= 0
    return np.asarray((is_opposite | (is_outside & (signs > 0)[:, None, None])).any(axis=2).all(axis=1))


def is_isolated(field: Field, grid: SampleGrid, point: Array, sign: float) -> bool:
    """Whether the face-connected component of {sign * f < 0} at a point (3,) ends within a few samples of the grid.

    A void component (sign -1) that reaches the border of the domain is not isolated.
    """
    step = grid.spacing / CLOSE_GRID_POINTS_PER_SAMPLE
    reach = CLOSE_GRID_REACH_SAMPLES * CLOSE_GRID_POINTS_PER_SAMPLE
    axes, ends_count = [], []
    for axis in range(3):
        t = point[axis] + step[axis] * np.arange(-reach, reach + 1)
        low, high = grid.low[axis], grid.high[axis]
        clipped = np.clip(t, low, high)
        axes.append(clipped[np.concatenate([[True], np.diff(clipped) > 0])])
        ends_count.append((sign < 0 or t[0] >= low, sign < 0 or t[-1] <= high))
    phase: BoolArray = sign * field.on_grid(*axes) < 0
    labels, _ = ndimage.label(phase)  # face connectivity is its default
    index = tuple(int(np.argmin(abs(t - c))) for t, c in zip(axes, point, strict=True))
    if labels[index] == 0:
        return True
    component = labels == labels[index]
    for axis, counts in enumerate(ends_count):
        ends = component.take(0, axis), component.take(-1, axis)
        if any(end.any() for end, is_open in zip(ends, counts, strict=True) if is_open):
            return False
    return True


def find_blend_subgrid_defects(
    problem: BlendProblem, state: BlendState, max_candidates: int | None = None
) -> SubgridDefects | None:
    """The subgrid defects of a state on the doubled grid, without those that a structure has by itself.

    None, without a search, if there are more than `max_candidates` candidates.
    """
    field, values = problem.field.with_weights(state.weights), problem.fine.values(state.weights)
    found = find_subgrid_defects(problem.fine, field, values, max_candidates)
    if found is None:
        return None
    grid = problem.fine.grid
    is_structure_defect = [
        any(-sign * f(point) > 0 and is_isolated(f, grid, point, sign) for f in problem.field.structures)
        for point, sign in zip(found.points, -np.sign(found.values), strict=True)
    ]
    is_own = ~np.array(is_structure_defect, bool)
    return SubgridDefects(found.points[is_own], found.values[is_own])


def count_subgrid_defects(
    problem: BlendProblem, outcome: OptimisationOutcome, max_candidates: int | None
) -> OptimisationOutcome:
    """The outcome with its subgrid defects counted; they stay None if the state has other defects."""
    found = find_blend_subgrid_defects(problem, outcome.state, max_candidates) if outcome.state.is_clean else None
    return replace(outcome, n_subgrid_defects=None if found is None else len(found))


def remove_subgrid_defects(
    problem: BlendProblem, outcome: OptimisationOutcome, max_candidates: int | None
) -> OptimisationOutcome:
    """The outcome with as few subgrid defects as some rounds reach: with the weights as they are, then with refined ones.

    A state with other defects stays as it is, and its subgrid defects are not counted.
    """
    best, rounds = outcome.state, 0
    least = find_blend_subgrid_defects(problem, best, max_candidates) if best.is_clean else None
    if least is None:
        return outcome
    for attempt in (1, 2):
        if len(least) == 0:
            break
        state, found = best, least
        if attempt == 2 and (refined := problem.refine_all(best.weights)) is not None:
            state = evaluate_weights(problem.compositions, refined)
        constrained = start_unconstrained(state.weights)
        while len(found) and rounds < MAX_REMOVAL_ROUNDS * attempt:
            constrained = replace(constrained, weights=state.weights)
            constrained = _turn_signs(problem, constrained, found)
            state, used = evaluate_and_repair(problem.compositions, constrained, MAX_REMOVAL_ROUNDS)
            rounds += 1 + used
            if not state.is_clean:
                break
            found = find_blend_subgrid_defects(problem, state) or NO_SUBGRID_DEFECTS
            if len(found) < len(least):
                best, least = state, found
    return replace(outcome.advance(best, rounds), n_subgrid_defects=len(least))


def _turn_signs(problem: BlendProblem, constrained: ConstrainedWeights, found: SubgridDefects) -> ConstrainedWeights:
    """The weights after each stage has turned the sign of f at the subgrid defects that it can."""

    def propose(current: ConstrainedWeights, stage: int) -> list[WeightConstraints]:
        field = problem.field.with_weights(current.weights)
        rms = problem.fine.rms_in_blending_regions(problem.fine.values(field.weights))
        constant, slope = evaluate_affine_form(field, stage, found.points)
        signs = -np.sign(found.values)
        attainable = signs * constant + np.maximum(signs * slope, 0.0)
        is_reachable = (slope != 0) & (attainable > 0)
        margin = np.minimum(REMOVAL_OVERSHOOT_RMS * rms, 0.5 * attainable)
        points, constant, slope, signs, margin = (
            values[is_reachable] for values in (found.points, constant, slope, signs, margin)
        )
        return make_sign_constraints(points, constant, slope, signs, margin).split()

    return run_constraint_round(constrained, propose)[0]

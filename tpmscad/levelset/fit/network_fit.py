"""Bezier curves and patches of a network fitted to a level set, joined with tangent continuity (G1) through the field's gradient.

1. Each curve is fitted with the field's normals along it: its tangent is orthogonal to the normals, most strictly at its ends.
2. Each patch takes the poles of its four curves as its sides. Its inner poles minimise the distance of the patch from the level
   set and the component along the same normals of the derivative across each side. Two patches thus have the same tangent planes
   along a common curve, although neither depends on the other.

All items of one degree are fitted in batches, which may run in parallel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.fit.least_squares import (
    FIT_PASSES,
    MAX_STEP_OF_CHORD,
    TANGENTIAL_WEIGHT,
    NormalEquations,
    project_curves_to_level_set,
    unit_normals,
)
from tpmscad.levelset.fit.network_curves import fit_curves
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork
from tpmscad.levelset.quadmesh.periodicity import TranslatedCopies, no_copies
from tpmscad.parallel import TaskRunner, run_serial, split_batches
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches, side_pole_matrix

CROSS_TANGENT_WEIGHT = 1.0
"""Weight of the cross-boundary derivative's component along the normal."""

ITEMS_PER_TASK = 256
"""Curves or patches fitted in one task: a few tenths of a second."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkFit:
    """Bezier poles of all curves, (p + 1, 3) each, and patches, (p + 1, q + 1, 3) each; copies are translated originals."""

    curves: list[Array]
    patches: list[Array]
    copies: TranslatedCopies


@dataclass(frozen=True, slots=True, eq=False)
class WarmStart:
    """An earlier fit, and masks of its curves (C,) and patches (Q,) that are to be fitted again; the others are reused."""

    fit: NetworkFit
    refit_curves: BoolArray
    refit_patches: BoolArray


def fit_network(
    network: PatchNetwork,
    field: Field,
    curve_degree: IntArray,
    patch_degree: IntArray,
    warm_start: WarmStart | None = None,
    run_tasks: TaskRunner = run_serial,
    copies: TranslatedCopies | None = None,
) -> NetworkFit:
    """Fit every curve with its degree (C,), then every patch with its degree (Q,) or those of its sides where they are higher.

    `copies` are those of the warm start by default, and none without one; a copy must have the degree of its original.
    """
    n_curves, n_patches = len(network.ends), len(network.curve)
    if warm_start is None:
        copies = copies or no_copies(n_curves, n_patches)
        nothing = NetworkFit([np.empty(0)] * n_curves, [np.empty(0)] * n_patches, copies)
        warm_start = WarmStart(nothing, np.ones(n_curves, bool), np.ones(n_patches, bool))
    copies = copies or warm_start.fit.copies
    curves = _fit_network_curves(network, field, curve_degree, warm_start, copies, run_tasks)
    patches = _fit_network_patches(network, field, curves, curve_degree, patch_degree, warm_start, copies, run_tasks)
    return NetworkFit(curves, patches, copies)


def fit_patches(field: Field, border: list[Array], joined: BoolArray) -> Array:
    """Poles (n, p + 1, q + 1, 3) of patches with four given sides, each (n, degree + 1, 3), counter-clockwise.

    `joined` (n, 4): sides with a patch beyond. On the others, in the faces of the box, the cross-boundary derivative is free.
    """
    poles = _interpolate_coons(border)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    u, v = (np.linspace(0.0, 1.0, d + 5)[1:-1] for d in (p, q))
    bu, bv = bernstein_basis(p, u), bernstein_basis(q, v)
    inner = np.einsum("ai,bj->abij", bu[:, 1:-1], bv[:, 1:-1]).reshape(len(u) * len(v), -1)
    sides = [_cross_boundary_bases(p, q, side) for side in range(4)]
    max_step = MAX_STEP_OF_CHORD * np.linalg.norm(poles[:, 0, 0] - poles[:, -1, -1], axis=1)
    free = np.zeros((len(poles), 3), bool)
    for _ in range(FIT_PASSES):
        # the unknowns are corrections of the poles: small next to the coordinates, they keep all their digits
        points = evaluate_bezier_patches(bu, poles, bv)
        target = project_curves_to_level_set(field, points, free, max_step)
        system = NormalEquations((p - 1) * (q - 1), len(poles))
        system.add_point_rows(inner, unit_normals(field, target), target - points, TANGENTIAL_WEIGHT)
        for side, has_neighbour in zip(sides, joined.T, strict=True):
            derivative = evaluate_bezier_patches(side.derivative[0], poles, side.derivative[1])
            normal = unit_normals(field, evaluate_bezier_patches(side.point[0], poles, side.point[1]))
            normal = normal * has_neighbour[:, None, None]
            system.add_normal_rows(side.inner, normal, -derivative, CROSS_TANGENT_WEIGHT / np.sqrt(len(side.inner)))
        poles[:, 1:-1, 1:-1] += system.solve().reshape(len(poles), p - 1, q - 1, 3)
    return poles


@dataclass(frozen=True, slots=True, eq=False)
class _SideBases:
    """Bernstein bases at parameters along one side of patches, between its ends.

    `derivative`, `point`: the pair of bases along u and v of the cross-boundary derivative and of the point; `inner` (m,
    unknowns): the part of the inner poles in the derivative.
    """

    inner: Array
    derivative: tuple[Array, Array]
    point: tuple[Array, Array]


def _cross_boundary_bases(p: int, q: int, side: int) -> _SideBases:
    """The bases of a side of patches of degrees p and q; sides are numbered counter-clockwise from v = 0."""
    along, across = (p, q) if side in (0, 2) else (q, p)
    t = np.linspace(0.0, 1.0, along + 5)[1:-1]
    end = np.array([1.0 if side in (1, 2) else 0.0])
    values, slope, value = bernstein_basis(along, t), bernstein_basis(across, end, 1), bernstein_basis(across, end)
    if side in (0, 2):
        inner = np.einsum("ai,bj->abij", values[:, 1:-1], slope[:, 1:-1])
        return _SideBases(inner.reshape(len(t), -1), (values, slope), (values, value))
    inner = np.einsum("bi,aj->abij", slope[:, 1:-1], values[:, 1:-1])
    return _SideBases(inner.reshape(len(t), -1), (slope, values), (value, values))


def _fit_network_curves(
    network: PatchNetwork,
    field: Field,
    degree: IntArray,
    warm_start: WarmStart,
    copies: TranslatedCopies,
    run_tasks: TaskRunner,
) -> list[Array]:
    """All curves: the sides of polygons first, then the spokes, which begin at midpoints of sides."""
    curves = list(warm_start.fit.curves)
    refit, is_spoke = copies.original_curves & warm_start.refit_curves, np.arange(len(curves)) >= network.n_sides
    start, end = network.vertices[network.ends[:, 0]], network.vertices[network.ends[:, 1]]
    on_box = np.flatnonzero(network.plane >= 0)
    fixed = np.zeros((len(curves), 3), bool)
    fixed[on_box, network.plane[on_box] // 2] = True
    for group in (~is_spoke, is_spoke):
        numbers = np.flatnonzero(refit & group)
        for c in numbers[is_spoke[numbers]]:
            start[c] = _curve_midpoint(curves[network.split_curve[c - network.n_sides]])
        batches = [
            (batch, int(d))
            for d in np.unique(degree[numbers])
            for batch in split_batches(numbers[degree[numbers] == d], ITEMS_PER_TASK)
        ]
        tasks = [(field, start[batch], end[batch], fixed[batch], d) for batch, d in batches]
        for i, poles in _numbered_results([batch for batch, _ in batches], run_tasks(fit_curves, tasks)):
            curves[i] = poles
        for i in np.flatnonzero(~copies.original_curves & group):
            curves[i] = curves[copies.curve[i]] + copies.curve_shift[i]
    return curves


def _fit_network_patches(
    network: PatchNetwork,
    field: Field,
    curves: list[Array],
    curve_degree: IntArray,
    patch_degree: IntArray,
    warm_start: WarmStart,
    copies: TranslatedCopies,
    run_tasks: TaskRunner,
) -> list[Array]:
    """All patches between fitted curves, with degrees no lower than those of their sides."""
    side_degree = curve_degree[network.curve]
    degree_u = np.maximum(patch_degree, side_degree[:, 0::2].max(1))
    degree_v = np.maximum(patch_degree, side_degree[:, 1::2].max(1))
    degrees = np.stack([degree_u, degree_v], 1)
    patches = list(warm_start.fit.patches)
    numbers = np.flatnonzero(copies.original_patches & warm_start.refit_patches)
    tasks, batches = [], []
    for pair in np.unique(degrees[numbers], axis=0):
        for batch in split_batches(numbers[(degrees[numbers] == pair).all(axis=1)], ITEMS_PER_TASK):
            border = [_collect_side_poles(network, curves, batch, s, int(pair[s % 2])) for s in range(4)]
            tasks.append((field, border, network.plane[network.curve[batch]] < 0))
            batches.append(batch)
    for i, poles in _numbered_results(batches, run_tasks(fit_patches, tasks)):
        patches[i] = poles
    for i in np.flatnonzero(~copies.original_patches):
        patches[i] = patches[copies.patch[i]] + copies.patch_shift[i]
    return patches


def _numbered_results(batches: list[IntArray], results: list[Array]) -> Iterator[tuple[int, Array]]:
    """The number of each item in the batches with its poles."""
    for batch, poles_of_batch in zip(batches, results, strict=True):
        for i, poles in zip(batch, poles_of_batch, strict=True):
            yield i, poles.copy()  # arrays from Dask are in read-only memory, which scipy does not accept


def _interpolate_coons(border: list[Array]) -> Array:
    """Poles (n, p + 1, q + 1, 3) of the bilinearly blended Coons patches with these sides, counter-clockwise."""
    low, high = border[0][:, :, None], border[2][:, ::-1, None]
    left, right = border[3][:, None, ::-1], border[1][:, None]
    s = np.linspace(0.0, 1.0, low.shape[1])[:, None, None]
    t = np.linspace(0.0, 1.0, left.shape[2])[:, None]
    corners = (1 - s) * ((1 - t) * low[:, :1] + t * high[:, :1]) + s * ((1 - t) * low[:, -1:] + t * high[:, -1:])
    poles = (1 - t) * low + t * high + (1 - s) * left + s * right - corners
    poles[:, :, 0], poles[:, :, -1] = low[:, :, 0], high[:, :, 0]
    poles[:, 0], poles[:, -1] = left[:, 0], right[:, 0]
    return np.asarray(poles)


def _collect_side_poles(network: PatchNetwork, curves: list[Array], patches: IntArray, side: int, degree: int) -> Array:
    """Poles (n, degree + 1, 3) of one side of patches, counter-clockwise, from their curves by degree elevation."""
    result = np.empty((len(patches), degree + 1, 3))
    for row, patch in enumerate(patches):
        poles = curves[network.curve[patch, side]]
        piece, sense = int(network.piece[patch, side]), int(network.sense[patch, side])
        matrix = side_pole_matrix(len(poles) - 1, degree, piece, sense)
        result[row] = poles if matrix is None else matrix @ poles
    return result


def _curve_midpoint(poles: Array) -> Array:
    return np.asarray(bernstein_basis(len(poles) - 1, np.array([0.5]))[0] @ poles)

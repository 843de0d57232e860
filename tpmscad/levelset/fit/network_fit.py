"""Bezier curves and patches of a network fitted to a level set, with joints that are tangent continuous (G1) to round-off.

1. Each curve is fitted, and a normal along it, a polynomial to which its tangent is orthogonal identically (`joint_normals`).
2. Each patch takes the poles of its four curves as its sides. Its inner poles minimise the distance of the patch from the level
   set under the linear conditions that the derivative across each side is orthogonal to the normal of its curve identically. Two
   patches thus have the same tangent planes along a common curve, although neither depends on the other.

All items of one degree are fitted in batches, which may run in parallel.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.fit.equality_constraints import EqualityConstraints
from tpmscad.levelset.fit.joint_normals import EndShapes, SpokeStarts, fit_normals, measure_second_forms
from tpmscad.levelset.fit.least_squares import (
    FAIRNESS_WEIGHT,
    FIT_PASSES,
    MAX_STEP_OF_CHORD,
    TANGENTIAL_WEIGHT,
    project_curves_to_level_set,
)
from tpmscad.levelset.fit.network_curves import fit_curves
from tpmscad.levelset.fit.normal_equations import NormalEquations
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork
from tpmscad.levelset.quadmesh.periodicity import TranslatedCopies
from tpmscad.levelset.quadmesh.vectors import normalize
from tpmscad.parallel import TaskRunner, run_serial, split_batches
from tpmscad.splines.basis import (
    bending_energy,
    bernstein_basis,
    bernstein_product,
    evaluate_bezier_patches,
    side_pole_matrix,
)

ITEMS_PER_TASK = 256
"""Curves or patches fitted in one task: a few tenths of a second."""

MAX_ENTRIES = 2**18
"""Entries of the normal equations that are summed and solved together: what fits into a cache of 2 MiB. 256 patches of degree 9
take 2.7 ms each with all their equations at once and 1.4 so, of degree 7 .90 and .50, of degree 5 .25 and .19."""


@dataclass(frozen=True, slots=True, eq=False)
class NetworkFit:
    """Bezier poles of all curves, (p + 1, 3) each, and patches, (p + 1, q + 1, 3) each; copies are translated originals.

    `normals`: poles of the normal along each curve, of its degree; zeros for those in faces of the box, which join nothing.
    """

    curves: list[Array]
    normals: list[Array]
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
    warm_start: WarmStart,
    run_tasks: TaskRunner = run_serial,
) -> NetworkFit:
    """Fit every curve with its degree (C,), then every patch with its degree (Q,) or those of its sides where they are higher.

    Copies are those of the warm start; a copy must have the degree of its original.
    """
    copies = warm_start.fit.copies
    curves, normals = _fit_network_curves(network, field, curve_degree, warm_start, run_tasks)
    # the same both ways: patches of degrees 9 and 5 between sides of both degrees fold
    degrees = np.maximum(patch_degree, curve_degree[network.curve].max(axis=1))
    patches = _fit_network_patches(network, field, (curves, normals), degrees, warm_start, run_tasks)
    return NetworkFit(curves, normals, patches, copies)


def fit_patches(field: Field, border: list[Array], normals: list[Array]) -> Array:
    """Poles (n, p + 1, q + 1, 3) of patches with four given sides, each (n, degree + 1, 3), counter-clockwise.

    `normals`: poles of the normals along the sides, each (n, k + 1, 3), to which the derivatives across them are orthogonal to
    round-off. Where they are zero, in the faces of the box, the derivative is free.
    """
    poles = _interpolate_coons(border)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    u, v = (np.linspace(0.0, 1.0, d + 5)[1:-1] for d in (p, q))
    bu, bv = bernstein_basis(p, u), bernstein_basis(q, v)
    inner = bu[:, 1:-1], bv[:, 1:-1]
    energy = bending_energy(p + 1, q + 1)
    unknown = np.arange((p + 1) * (q + 1)).reshape(p + 1, q + 1)[1:-1, 1:-1].ravel()
    n_at_once = max(1, MAX_ENTRIES // (3 * unknown.size) ** 2)
    max_step = MAX_STEP_OF_CHORD * np.linalg.norm(poles[:, 0, 0] - poles[:, -1, -1], axis=1)
    free = np.zeros((len(poles), 3), bool)
    products = [_normal_products(p, q, side, along) for side, along in enumerate(normals)]
    rows = np.concatenate([_rows_of_inner_poles(p, q, side, each) for side, each in enumerate(products)], axis=1)
    conditions = EqualityConstraints.factorise(rows)
    for _ in range(FIT_PASSES):
        # the unknowns are corrections of the poles: small next to the coordinates, they keep all their digits
        points = evaluate_bezier_patches(bu, poles, bv)
        target, target_normals = project_curves_to_level_set(field, points, free, max_step)
        across = np.concatenate(
            [_multiply(each, cross_poles(poles, side)) for side, each in enumerate(products)], axis=1
        )
        for first in range(0, len(poles), n_at_once):
            part = slice(first, first + n_at_once)
            net = poles[part].reshape(-1, (p + 1) * (q + 1), 3)
            system = NormalEquations(unknown.size, len(net))
            system.add_point_rows(inner, target_normals[part], target[part] - points[part], TANGENTIAL_WEIGHT)
            system.add_energy(energy, unknown, net, FAIRNESS_WEIGHT)
            step = system.solve_subject_to(conditions[part], -across[part])
            poles[part, 1:-1, 1:-1] += step.reshape(-1, p - 1, q - 1, 3)
    return poles


def cross_poles(poles: Array, side: int) -> Array:
    """Poles (n, degree + 1, 3) of the derivative across a side of patches, inwards, divided by the degree across it.

    They run along the side counter-clockwise; sides are numbered so from v = 0.
    """
    turned = (poles, poles[:, ::-1].swapaxes(1, 2), poles[:, ::-1, ::-1], poles[:, :, ::-1].swapaxes(1, 2))[side]
    return np.asarray(turned[:, :, 1] - turned[:, :, 0])


def _normal_products(p: int, q: int, side: int, normals: Array) -> Array:
    """Matrices (n, k + d - 1, d + 1, 3) from `cross_poles` D of a side to the inner Bernstein coefficients of normals . D.

    The first and the last coefficient vanish by the sides: no inner pole is in them.
    """
    product = bernstein_product(normals.shape[1] - 1, p if side in (0, 2) else q)[1:-1]
    _, degree, along = product.shape
    flat = product.transpose(0, 2, 1).reshape(-1, degree) @ normals
    return flat.reshape(len(normals), -1, along, 3)


def _multiply(products: Array, poles: Array) -> Array:
    """The coefficients (n, m) that matrices (n, m, d + 1, 3) give of poles (n, d + 1, 3)."""
    n, m, *_ = products.shape
    return np.asarray((products.reshape(n, m, -1) @ poles.reshape(n, -1, 1))[..., 0])


def _rows_of_inner_poles(p: int, q: int, side: int, product: Array) -> Array:
    """The part (n, m, unknowns) of the inner poles in the products of a side with its normals."""
    inner = np.zeros((*product.shape[:2], p - 1, q - 1, 3))
    within = product[:, :, 1:-1]
    if side == 0:
        inner[:, :, :, 0] = within
    elif side == 1:
        inner[:, :, -1] = within
    elif side == 2:
        inner[:, :, :, -1] = within[:, :, ::-1]
    else:
        inner[:, :, 0] = within[:, :, ::-1]
    return inner.reshape(*product.shape[:2], -1)


def _fit_network_curves(
    network: PatchNetwork,
    field: Field,
    degree: IntArray,
    warm_start: WarmStart,
    run_tasks: TaskRunner,
) -> tuple[list[Array], list[Array]]:
    """All curves and the normals along them: the sides of polygons first, then the spokes, which begin at midpoints of sides."""
    curves, normals, copies = list(warm_start.fit.curves), list(warm_start.fit.normals), warm_start.fit.copies
    refit, is_spoke = copies.original_curves & warm_start.refit_curves, np.arange(len(curves)) >= network.n_sides
    start, end = network.vertices[network.ends[:, 0]], network.vertices[network.ends[:, 1]]
    on_box = np.flatnonzero(network.plane >= 0)
    fixed = np.zeros((len(curves), 3), bool)
    fixed[on_box, network.plane[on_box] // 2] = True
    size = float(np.ptp(network.vertices, axis=0).max())
    for group in (~is_spoke, is_spoke):
        numbers = np.flatnonzero(refit & group)
        starts = None
        if is_spoke[numbers].any():
            split = network.split_curve[numbers - network.n_sides]
            start[numbers], starts = _start_spokes([curves[c] for c in split], [normals[c] for c in split])
        batches = [
            (batch, int(d))
            for d in np.unique(degree[numbers])
            for batch in split_batches(np.flatnonzero(degree[numbers] == d), ITEMS_PER_TASK)
        ]
        tasks = [
            (
                field,
                *(each[numbers[rows]] for each in (start, end, fixed)),
                size,
                d,
                None if starts is None else starts[rows],
            )
            for rows, d in batches
        ]
        results = run_tasks(fit_joined_curves, tasks)
        for i, (poles, along) in _numbered_results([numbers[rows] for rows, _ in batches], results):
            curves[i], normals[i] = poles, along
        for i in np.flatnonzero(~copies.original_curves & group):
            curves[i], normals[i] = curves[copies.curve[i]] + copies.curve_shift[i], normals[copies.curve[i]]
    return curves, normals


def fit_joined_curves(
    field: Field, start: Array, end: Array, fixed: BoolArray, size: float, degree: int, starts: SpokeStarts | None
) -> Array:
    """Poles (n, 2, p + 1, 3) of curves and of the normals along them; the normals are zero where coordinates are `fixed`.

    `size` is that of the network (`measure_second_forms`); `starts` belong to spokes.
    """
    normal, form = measure_second_forms(field, np.stack([start, end], axis=1), size)
    if starts is not None:
        normal[:, 0] = normalize(starts.normal)
    ends = EndShapes(normal, form)
    curves = fit_curves(field, start, end, fixed, degree, ends)
    normals = fit_normals(field, curves, ends, starts)
    normals[fixed.any(axis=1)] = 0.0
    return np.stack([curves, normals], axis=1)


def _start_spokes(curves: list[Array], normals: list[Array]) -> tuple[Array, SpokeStarts]:
    """The midpoints (n, 3) of curves, and what the spokes that begin there take from them."""
    rows = []
    for poles, along in zip(curves, normals, strict=True):
        value, slope = _basis_at_middle(len(poles) - 1)
        rows.append([value @ poles, value @ along, slope @ along, slope @ poles])
    points, normal, normal_derivative, derivative = np.array(rows).transpose(1, 0, 2)
    return points, SpokeStarts(normal, normal_derivative, derivative)


@lru_cache(maxsize=16)
def _basis_at_middle(degree: int) -> tuple[Array, Array]:
    """Bernstein polynomials and their derivatives (degree + 1,) at 1/2."""
    return bernstein_basis(degree, np.array([0.5]))[0], bernstein_basis(degree, np.array([0.5]), 1)[0]


def _fit_network_patches(
    network: PatchNetwork,
    field: Field,
    joined: tuple[list[Array], list[Array]],
    degrees: IntArray,
    warm_start: WarmStart,
    run_tasks: TaskRunner,
) -> list[Array]:
    """All patches between fitted curves with normals along them, with degrees (Q,) no lower than that of any of their sides."""
    patches, copies = list(warm_start.fit.patches), warm_start.fit.copies
    numbers = np.flatnonzero(copies.original_patches & warm_start.refit_patches)
    tasks, batches = [], []
    for degree in np.unique(degrees[numbers]).tolist():
        for batch in split_batches(numbers[degrees[numbers] == degree], ITEMS_PER_TASK):
            border, along = (
                [_collect_side_poles(network, poles, batch, side, degree) for side in range(4)] for poles in joined
            )
            tasks.append((field, border, along))
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
    numbers = network.curve[patches, side].tolist()
    rows_of_kind: dict[tuple[int, int, int], list[int]] = {}
    for row, kind in enumerate(
        zip(
            [len(curves[c]) - 1 for c in numbers],
            network.piece[patches, side].tolist(),
            network.sense[patches, side].tolist(),
            strict=True,
        )
    ):
        rows_of_kind.setdefault(kind, []).append(row)
    result = np.empty((len(patches), degree + 1, 3))
    for (low, piece, sense), rows in rows_of_kind.items():
        poles = np.array([curves[numbers[row]] for row in rows])
        matrix = side_pole_matrix(low, degree, piece, sense)
        result[rows] = poles if matrix is None else matrix @ poles
    return result

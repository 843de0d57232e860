"""Curves and patches of a net fitted to a level set, all at once, joining with tangent continuity through the field's gradient.

A curve is fitted first, with the field's normals along it: its ends tangent to the surface, its own tangent orthogonal to the
normals. The patches on both sides take its poles and are asked, in the same least squares that place their inner poles, to have a
derivative across the border orthogonal to the same normals; so they meet smoothly though neither knows the other. Distances
along the normal count fully, along the surface (where a point of the patch lies matters little) with the weight `SLIDE`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.fields.field import Field
from tpmscad.levelset.fit.least_squares import (
    FIT_PASSES,
    TANGENTIAL_WEIGHT,
    NormalEquations,
    project_curves_to_level_set,
    unit_normals,
)
from tpmscad.levelset.fit.network_curves import fit_curves
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork
from tpmscad.levelset.quadmesh.periodicity import TranslatedCopies, no_copies
from tpmscad.parallel import ITEMS_PER_TASK, TaskRunner, run_serial
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches, side_pole_matrix

CROSS_TANGENT_WEIGHT = 1.0


@dataclass(frozen=True, slots=True, eq=False)
class NetworkFit:
    """Bezier poles on [0, 1]: `curves[i]` (p + 1, 3) and `patches[i]` (p + 1, q + 1, 3); copies are moved, not fitted."""

    curves: list[Array]
    patches: list[Array]
    copies: TranslatedCopies


def fit_network(
    net: PatchNetwork,
    field: Field,
    curve_degree: IntArray,
    patch_degree: IntArray,
    before: tuple[NetworkFit, BoolArray, BoolArray] | None = None,
    work: TaskRunner = run_serial,
    copies: TranslatedCopies | None = None,
) -> NetworkFit:
    """Fit every curve with its degree (C,), then every patch with its degree (Q,), raised where its sides' are higher.

    `before`: an earlier fit of the net, and the curves (C,) and patches (Q,) of it to be fitted anew; the others are kept.
    `copies`: what repeats in the net (nothing if neither is given); copies must have the degrees of what they are copies of.
    """
    copies = copies or (before[0].copies if before else no_copies(len(net.ends), len(net.curve)))
    curves = list(before[0].curves) if before else [np.empty(0)] * len(net.ends)
    anew = copies.original_curves & (before[1] if before else True)
    main, spokes = np.flatnonzero(anew[: net.n_sides]), net.n_sides + np.flatnonzero(anew[net.n_sides :])
    of_copies = np.flatnonzero(~copies.original_curves)
    group_copies = of_copies[of_copies < net.n_sides], of_copies[of_copies >= net.n_sides]
    start = net.vertices[net.ends[:, 0]]
    end = net.vertices[net.ends[:, 1]]
    for group in (main, spokes):
        if group is spokes and len(spokes):
            start[spokes] = [_curve_midpoint(curves[c]) for c in net.middle_of[spokes - net.n_sides]]
        for degree in np.unique(curve_degree[group]):
            at = group[curve_degree[group] == degree]
            fixed = np.zeros((len(net.ends), 3), bool)
            on_box = at[net.plane[at] >= 0]
            fixed[on_box, net.plane[on_box] // 2] = True
            parts = _split_into_tasks(at)
            done = work(fit_curves, [(field, start[part], end[part], fixed[part], int(degree)) for part in parts])
            for part, found in zip(parts, done, strict=True):
                for i, poles in zip(part, found, strict=True):
                    curves[i] = poles.copy()  # Dask hands out arrays in read-only memory, which scipy refuses
        for i in group_copies[group is spokes]:
            curves[i] = curves[copies.curve[i]] + copies.curve_shift[i]

    side_degree = curve_degree[net.curve]
    degrees = np.stack(
        [np.maximum(patch_degree, side_degree[:, 0::2].max(1)), np.maximum(patch_degree, side_degree[:, 1::2].max(1))],
        1,
    )
    patches = list(before[0].patches) if before else [np.empty(0)] * len(net.curve)
    wanted = np.flatnonzero(copies.original_patches & (before[2] if before else True))
    tasks, parts = [], []
    for degree_u, degree_v in np.unique(degrees[wanted], axis=0):
        for part in _split_into_tasks(wanted[(degrees[wanted] == (degree_u, degree_v)).all(axis=1)]):
            border = [_collect_side_poles(net, curves, part, s, int((degree_u, degree_v)[s % 2])) for s in range(4)]
            tasks.append((field, border, net.plane[net.curve[part]] < 0))
            parts.append(part)
    for part, found in zip(parts, work(fit_patches, tasks), strict=True):
        for i, poles in zip(part, found, strict=True):
            patches[i] = poles.copy()
    for i in np.flatnonzero(~copies.original_patches):
        patches[i] = patches[copies.patch[i]] + copies.patch_shift[i]
    return NetworkFit(curves, patches, copies)


def _split_into_tasks(numbers: IntArray) -> list[IntArray]:
    return [numbers[i : i + ITEMS_PER_TASK] for i in range(0, len(numbers), ITEMS_PER_TASK)]


def fit_patches(field: Field, border: list[Array], joined: BoolArray) -> Array:
    """Patches between their four borders, each (n, degree + 1, 3) run counter-clockwise: (n, p + 1, q + 1, 3).

    `joined` (n, 4): sides across which the surface goes on; on the others, in the box's faces, nothing is asked of the slope.
    """
    poles = _interpolate_coons(border)
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    u, v = (np.linspace(0.0, 1.0, d + 5)[1:-1] for d in (p, q))
    bu, bv = bernstein_basis(p, u), bernstein_basis(q, v)
    inner = np.einsum("ai,bj->abij", bu[:, 1:-1], bv[:, 1:-1]).reshape(len(u) * len(v), -1)
    size = np.linalg.norm(poles[:, 0, 0] - poles[:, -1, -1], axis=1)
    free = np.zeros((len(poles), 3), bool)
    for _ in range(FIT_PASSES):
        # corrections are solved for, not poles: small next to the coordinates, they keep all their digits
        points = evaluate_bezier_patches(bu, poles, bv)
        target = project_curves_to_level_set(field, points, free, 0.3 * size)
        system = NormalEquations((p - 1) * (q - 1), len(poles))
        system.near(inner, unit_normals(field, target), target - points, TANGENTIAL_WEIGHT)
        for side, inside in enumerate(joined.T):
            basis, slope, normal = _build_cross_rows(field, poles, side)
            system.along(basis, normal * inside[:, None, None], -slope, CROSS_TANGENT_WEIGHT / np.sqrt(len(basis)))
        poles[:, 1:-1, 1:-1] += system.solved().reshape(len(poles), p - 1, q - 1, 3)
    return poles


def _build_cross_rows(field: Field, poles: Array, side: int) -> tuple[Array, Array, Array]:
    """Along a side: the inner poles' part in the derivative across it (m, inner), that derivative and the normals (n, m, 3)."""
    p, q = poles.shape[1] - 1, poles.shape[2] - 1
    along, across = (p, q) if side in (0, 2) else (q, p)
    t = np.linspace(0.0, 1.0, along + 5)[1:-1]
    values = bernstein_basis(along, t)
    slope = bernstein_basis(across, np.array([1.0 if side in (1, 2) else 0.0]), 1)
    ends = bernstein_basis(across, np.array([1.0 if side in (1, 2) else 0.0]))
    if side in (0, 2):
        basis = np.einsum("ai,bj->abij", values[:, 1:-1], slope[:, 1:-1])
        across_it, points = evaluate_bezier_patches(values, poles, slope), evaluate_bezier_patches(values, poles, ends)
    else:
        basis = np.einsum("bi,aj->abij", slope[:, 1:-1], values[:, 1:-1])
        across_it, points = evaluate_bezier_patches(slope, poles, values), evaluate_bezier_patches(ends, poles, values)
    return basis.reshape(len(t), -1), across_it, unit_normals(field, points)


def _interpolate_coons(border: list[Array]) -> Array:
    """The poles of the bilinearly blended Coons patches of four borders run counter-clockwise: (n, p + 1, q + 1, 3)."""
    low, high = border[0][:, :, None], border[2][:, ::-1, None]
    left, right = border[3][:, None, ::-1], border[1][:, None]
    s = np.linspace(0.0, 1.0, low.shape[1])[:, None, None]
    t = np.linspace(0.0, 1.0, left.shape[2])[:, None]
    corners = (1 - s) * ((1 - t) * low[:, :1] + t * high[:, :1]) + s * ((1 - t) * low[:, -1:] + t * high[:, -1:])
    poles = (1 - t) * low + t * high + (1 - s) * left + s * right - corners
    poles[:, :, 0], poles[:, :, -1] = low[:, :, 0], high[:, :, 0]
    poles[:, 0], poles[:, -1] = left[:, 0], right[:, 0]
    return np.asarray(poles)


def _collect_side_poles(net: PatchNetwork, curves: list[Array], patches: IntArray, side: int, degree: int) -> Array:
    """The poles of one side of patches, run counter-clockwise and raised to the degree: (n, degree + 1, 3)."""
    result = np.empty((len(patches), degree + 1, 3))
    for row, patch in enumerate(patches):
        own = curves[net.curve[patch, side]]
        matrix = side_pole_matrix(len(own) - 1, degree, int(net.piece[patch, side]), int(net.sense[patch, side]))
        result[row] = own if matrix is None else matrix @ own
    return result


def _curve_midpoint(poles: Array) -> Array:
    return np.asarray(bernstein_basis(len(poles) - 1, np.array([0.5]))[0] @ poles)

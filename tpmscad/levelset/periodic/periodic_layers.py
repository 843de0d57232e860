"""The offset surfaces of a periodic level set as patches of one period, and their copies over a box.

One patch of each orbit is fitted; rigid motions and translations by whole periods place its copies. No box is known to the fit.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from itertools import product

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.errors import LevelSetError
from tpmscad.fields.analysis.isometries import find_isometries
from tpmscad.fields.field import Field
from tpmscad.levelset.boundary_level_sets import measure_shape_operators, sample_level_set
from tpmscad.levelset.periodic.periodic_fit import PeriodicFit, fit_periodic_patches, is_better_fit
from tpmscad.levelset.periodic.periodic_mesh import (
    PeriodicMesh,
    build_periodic_mesh,
    count_euler_characteristic,
    min_corner_sine,
)
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface

LEAVES_PER_PERIOD = (7, 8, 9, 10, 12, 14, 16, 20, 24)
ORIGINS = (0.5, 0.0)
"""Grids that are tried in order: leaves to a period along each axis, and the position of a node in leaves."""

REFERENCE_LEAVES = 28
REFERENCE_ORIGIN = np.array([0.0113, 0.0047, 0.0159])
"""Leaves to a period of the grid that gives the Euler characteristic of the level set, and its node off all symmetry elements."""

MIN_MESH_SINE = 0.3
"""Least sine of a corner angle of a mesh that is fitted: thinner polygons cost more digits than a finer grid costs patches."""

MAX_GRIDS, FINER_BY_LEAVES = 3, 2
"""Grids on which an offset surface is fitted until it meets the tolerance, and by how many leaves to a period each is finer: near
its greatest curvature an offset surface needs smaller patches than the surface itself."""

SAMPLES_PER_PERIOD = 12
"""Grid lines to a period whose crossings with the level set are the samples at which patches are tested."""

CURVATURE_STEP_PERIODS = 1e-4
"""Step of the differences for curvatures, in the least period."""

CACHE_SIZE = 32
"""Layouts and fits kept: those of the catalogue's surfaces at a few offsets each."""


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicLayout:
    """A field with its isometries (of the grid used), the mesh of its level set in one period, and samples (n, 3) of it.

    `grid`: leaves to a period, and origin in leaves, of the grid.
    """

    field: Field
    grid: tuple[int, float]
    isometries: Motion
    mesh: PeriodicMesh
    samples: Array


@lru_cache(maxsize=CACHE_SIZE)
def make_periodic_layout(field: Field, first_grid: tuple[int, float] | None = None) -> PeriodicLayout:
    """The layout of {field = 0} on the coarsest grid whose mesh has the level set's topology and well-shaped polygons.

    `first_grid`: leaves to a period and origin of a grid that is known to resolve the topology; it is tried before the others.

    LevelSetError if there is none. Cached: every thickness of a surface has the same layout.
    """
    isometries = find_isometries(field)
    periods = field.periods()
    assert periods is not None
    period = np.array(periods)
    best: tuple[float, PeriodicMesh, Motion, tuple[int, float]] | None = None
    expected: int | None = None
    first = () if first_grid is None else (first_grid,)
    for number, (count, origin) in enumerate((*first, *product(LEAVES_PER_PERIOD, ORIGINS))):
        kept = _select_isometries_of_grid(isometries, period, count, origin)
        if len(kept) < len(isometries) // 2:
            continue
        try:
            mesh = build_periodic_mesh(field, kept, np.full(3, count), origin / count * period)
        except LevelSetError:
            continue
        if number >= len(first):
            if expected is None:
                fine = np.full(3, REFERENCE_LEAVES)
                expected = count_euler_characteristic(field, fine, REFERENCE_ORIGIN * period)
            if _count_vertices_less_faces(mesh) != expected:
                continue
        sine = min_corner_sine(mesh, field)
        if best is None or sine > best[0]:
            best = sine, mesh, kept, (count, origin)
        if sine >= MIN_MESH_SINE:
            break
    if best is None or best[0] <= 0:
        raise LevelSetError("no grid resolves the level set within one period: it has features below a twentieth of it")
    _, mesh, kept, grid = best
    samples = sample_level_set(field, np.zeros(3), period, float(period.min()) / SAMPLES_PER_PERIOD)
    return PeriodicLayout(field, grid, kept, mesh, samples)


def measure_offset_limits(layout: PeriodicLayout) -> tuple[float, float]:
    """Signed distances to the nearest centres of curvature of the level set on either side, from its samples."""
    step = CURVATURE_STEP_PERIODS * float(layout.mesh.period.min())
    curvatures = np.linalg.eigvalsh(measure_shape_operators(layout.field, layout.samples, step))
    return -1.0 / float(curvatures.max()), -1.0 / float(curvatures.min())


@lru_cache(maxsize=CACHE_SIZE)
def fit_periodic_offset(
    field: Field, offset: float, tol: float, first_grid: tuple[int, float] | None = None
) -> PeriodicFit:
    """The patches at the normal offset from {field = 0}, within `tol` if possible, on finer grids if need be. Cached."""
    best: PeriodicFit | None = None
    for _ in range(MAX_GRIDS):
        layout = make_periodic_layout(field, first_grid)
        count, origin = layout.grid
        first_grid = count + FINER_BY_LEAVES, origin
        if best is not None and _count_vertices_less_faces(layout.mesh) != _count_vertices_less_faces(best.mesh):
            continue
        fit = fit_periodic_patches(field, layout.mesh, layout.isometries, offset, layout.samples, tol)
        if best is None or is_better_fit(fit, best):
            best = fit
        if best.met:
            break
    assert best is not None
    return best


def patch_surfaces(fit: PeriodicFit) -> tuple[BSplineSurface, ...]:
    """The fitted patches as B-spline surfaces on the unit square."""
    knots = np.repeat([0.0, 1.0], fit.degree + 1)
    return tuple(BSplineSurface(poles, knots, knots, fit.degree, fit.degree) for poles in fit.poles)


def place_copies_in_box(fit: PeriodicFit, low: Array, high: Array, touch_tol: float) -> tuple[IntArray, Motion]:
    """All copies of the patches whose poles reach into the box [low, high] by more than `touch_tol`: patch and motion, (n,) each.

    S_u x S_v of a copy points along the gradient times the handedness of its motion: the corners of a representative are
    counter-clockwise as seen from the void, and a mirror turns that round.
    """
    mesh = fit.mesh
    row = mesh.representative_row
    poles = mesh.polygon_motion[:, None].apply(fit.poles.reshape(len(fit.poles), -1, 3)[row])
    least, greatest = poles.min(axis=1), poles.max(axis=1)
    patches, motions = [], []
    for shift in _periods_in_reach(mesh.period, least.min(axis=0), greatest.max(axis=0), low, high):
        inside = ((greatest + shift > low + touch_tol) & (least + shift < high - touch_tol)).all(axis=1)
        placed = mesh.polygon_motion[inside]
        patches.append(row[inside])
        motions.append(Motion(placed.rotation, placed.translation + shift))
    return np.concatenate(patches), Motion.concatenate(motions)


def _count_vertices_less_faces(mesh: PeriodicMesh) -> int:
    """The Euler characteristic of a closed mesh of quadrilaterals, which has twice as many sides as faces."""
    return len(mesh.vertices) - len(mesh.corners)


def _periods_in_reach(period: Array, least: Array, greatest: Array, low: Array, high: Array) -> Iterator[Array]:
    """Translations by whole periods that bring some part of [least, greatest] into the box [low, high]."""
    first, last = np.ceil((low - greatest) / period).astype(int), np.floor((high - least) / period).astype(int)
    axes: Sequence[range] = [range(a, b + 1) for a, b in zip(first, last, strict=True)]
    return (np.array(cell) * period for cell in product(*axes))


def _select_isometries_of_grid(isometries: Motion, period: Array, count: int, origin: float) -> Motion:
    """The isometries that map a grid of `count` leaves to a period, with a node at `origin` leaves, to itself."""
    node = np.full(3, origin)
    image = isometries.apply_to_vectors(node * period / count) + isometries.translation
    steps = image / period * count - node
    return isometries[np.abs(steps - np.rint(steps)).max(axis=1) < 1e-9]

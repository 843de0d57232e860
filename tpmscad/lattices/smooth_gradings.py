"""Graded walls as smooth functions: patches that are fitted one by one join only where what they are fitted to is smooth.

A formula is smooth as a rule; a field of data, of a distance or of limited values has creases, at which the samples of two
neighbours disagree about its derivatives. Such a grading is replaced by one function that interpolates it on a grid and has all
derivatives. How far that is from the grading is measured at points of all patches, and counts in the deviation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from tpmscad._typing import Array
from tpmscad.lattices.g2_fit import find_least_coefficients, sample_parameters
from tpmscad.lattices.mapped_surface import MappedSurface, evaluate_grading
from tpmscad.splines.gaussian_interpolation import GaussianInterpolant, interpolate_samples

SPACINGS_PER_CELL = (5, 8, 16, 20)
"""Spacings of the grid in the order of trial. The samples of the fit resolve finer ones no longer."""

DEVIATION_SHARE = 0.6
"""Part of the tolerance within which a smoothed wall is taken; the rest is left to the fit. Creases need twice as many spacings
for two fifths of the error, and the fit one degree more for a fifth to a third."""

SMOOTH_TAIL = 1e-11
"""Part of its greatest value below which the last coefficients of a smooth grading are: 1e-12 of formulas, 1e-6 at creases, and
4e-10 where a third derivative jumps in the corner of a patch, which left gaps of 6e-6 between neighbours."""

CHECKED_AT_ONCE = 64
"""Patches at which it is seen together whether a grading is smooth; first those over which it is least like a polynomial."""

MARGIN_SPACINGS = 2
"""Spacings of the grid beyond the patches."""


def smooth_gradings(
    mapped: MappedSurface, distances: Sequence[float], tol: float
) -> tuple[MappedSurface, float, tuple[str, ...]]:
    """The surface with smooth gradings, how far its walls are from those asked for, if possible a part of `tol`, and notes."""
    error, notes, given_surface = 0.0, [], mapped
    for name, factor in (("thickness", max(map(abs, distances))), ("centre", 1.0)):
        given = getattr(mapped, name)
        if given is None:
            continue
        evaluate = partial(evaluate_grading, "offset" if name == "centre" else name, given)
        points, *gradings = given_surface.checked
        values = gradings[name == "centre"]
        if np.ptp(values) == 0.0 or _is_smooth(mapped, evaluate, values):
            continue
        function, miss = _smooth(
            evaluate, points.position.reshape(-1, 3), values.ravel(), mapped.cell, DEVIATION_SHARE * tol / factor
        )
        mapped = replace(mapped, **{name: function})  # type: ignore[arg-type]
        error += factor * miss
        notes.append(f"the graded wall is not smooth everywhere; its surfaces are rounded by up to {factor * miss:.2g}")
    return mapped, error, tuple(notes)


def _is_smooth(mapped: MappedSurface, evaluate: Callable[[Array], Array], values: Array) -> bool:
    """Whether the samples of the fit resolve a grading, of which values (P, m, m) on all patches are known."""
    bend = np.abs(np.diff(values, 4, axis=1)).max(axis=(1, 2)) + np.abs(np.diff(values, 4, axis=2)).max(axis=(1, 2))
    u, v = np.meshgrid(sample_parameters(), sample_parameters(), indexing="ij")
    limit = SMOOTH_TAIL * float(np.abs(values).max())
    chosen = np.array_split(np.argsort(-bend), math.ceil(len(bend) / CHECKED_AT_ONCE))
    return all(find_least_coefficients(evaluate(mapped.points(u, v, c).position)).max() <= limit for c in chosen)


def _smooth(
    evaluate: Callable[[Array], Array], points: Array, values: Array, cell: float, limit: float
) -> tuple[Callable[[Array], Array], float]:
    """The smooth function that differs least from values (n,) at points (n, 3), or by no more than a limit, and by how much."""
    found: list[tuple[float, GaussianInterpolant]] = []
    for parts in SPACINGS_PER_CELL:
        spacing = cell / parts
        origin = points.min(axis=0) - MARGIN_SPACINGS * spacing
        counts = np.ceil((points.max(axis=0) - origin) / spacing).astype(int) + MARGIN_SPACINGS + 1
        grid = origin + spacing * np.moveaxis(np.indices(counts.tolist()), 0, -1)
        function = interpolate_samples(evaluate(grid), origin, spacing)
        found.append((float(np.abs(function(points) - values).max()), function))
        if found[-1][0] <= limit:
            break
    miss, function = min(found, key=lambda each: each[0])
    return function, miss

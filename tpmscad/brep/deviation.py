"""Two-way deviation of a fitted patch from its reference surface: orthogonal distances on dense grids, in both directions.

The foot point of each sample on the other surface is its orthogonal projection, sought from the parameters of the sample.
Both directions use the tangents of the fitted patch: those of the reference differ from them by the error that is measured. The
grid is independent of the samples of the fit, and finer grids around the largest local maxima keep the maximum (the one-sided
Hausdorff distance) from being missed between samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy.ndimage import maximum_filter

from tpmscad._typing import Array, IntArray
from tpmscad.brep.orthogonal_projection import project_to_patch, project_to_surface
from tpmscad.splines.bspline import BSplineSurface

ReferenceSurface = Callable[[Array, Array], Array]
"""Positions (..., 3) of the reference surface at (u, v); defined a little beyond the domain, where foot points may lie."""

DistanceFunction = Callable[[Array, Array], Array]
"""Distances (n,) of the points of one surface at parameters (n,), (n,) from the other."""

SAMPLES_PER_PARAMETER = 49
"""Samples along each parameter: three per lobe of the error of a patch of degree 16."""

REFINED_PEAKS = 6
"""Largest local maxima of the sampled distances around which samples are refined: the maximum is then 0.2 % too low at most."""

SAMPLES_PER_PEAK_AXIS = 9
"""Samples along each parameter between the neighbours of a local maximum."""

REFERENCE_MARGIN_FRACTION = 0.04
"""Fraction of the domain by which foot points on the reference may lie outside it; a foot point that stops there
overestimates a distance."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """Largest and root-mean-square orthogonal distance, and the largest in each direction, in the unit of the surfaces."""

    max: float
    rms: float
    to_reference: float
    from_reference: float

    def scaled(self, factor: float) -> Deviation:
        """The deviation in another unit of length."""
        return Deviation(factor * self.max, factor * self.rms, factor * self.to_reference, factor * self.from_reference)


def combine_deviations(each: Sequence[Deviation]) -> Deviation:
    """The deviation of several patches together: the largest distances, and the root mean square over all patches."""
    return Deviation(
        max=max(d.max for d in each),
        rms=float(np.sqrt(np.mean([d.rms**2 for d in each]))),
        to_reference=max(d.to_reference for d in each),
        from_reference=max(d.from_reference for d in each),
    )


def measure_deviation(
    fitted: BSplineSurface, reference: ReferenceSurface, samples: int = SAMPLES_PER_PARAMETER
) -> Deviation:
    """The two-way deviation between a fitted patch and the reference surface over the domain of the patch."""
    (u0, u1), (v0, v1) = fitted.domain
    grid = cosine_grid(samples)
    return measure_both_ways(
        u0 + (u1 - u0) * grid,
        v0 + (v1 - v0) * grid,
        partial(_distances_to_reference, fitted, reference),
        partial(_distances_from_reference, fitted, reference),
    )


def cosine_grid(samples: int) -> Array:
    """Parameters (samples,) from 0 to 1, denser near the ends: the lobes of an error are narrow near the sides."""
    return np.asarray((1 - np.cos(np.pi * np.linspace(0.0, 1.0, samples))) / 2)


def measure_both_ways(
    u: Array, v: Array, to_reference: DistanceFunction, from_reference: DistanceFunction
) -> Deviation:
    """The deviation by the distances in both directions on the grid u x v, spaced by `cosine_grid`, and near their maxima."""
    on_grid = [g.ravel() for g in np.meshgrid(u, v, indexing="ij")]
    largest, squares = [], []
    for measure in (to_reference, from_reference):
        distances = measure(*on_grid).reshape(len(u), len(v))
        finer = measure(*_sample_around_peaks(distances, u, v))
        largest.append(float(max(distances.max(), finer.max())))
        squares.append(_mean_square(distances))
    return Deviation(max(largest), float(np.sqrt(np.mean(squares))), largest[0], largest[1])


def _sample_around_peaks(distances: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Parameters (n,), (n,) of finer samples around the largest local maxima of distances on the grid u x v."""
    rank = distances == maximum_filter(distances, size=3)
    at = np.argwhere(rank)
    at = at[np.argsort(-distances[rank], kind="stable")][:REFINED_PEAKS]
    step, index = np.linspace(-1.0, 1.0, SAMPLES_PER_PEAK_AXIS), np.arange(len(u))
    near_u = np.interp(np.clip(at[:, :1] + step, 0, len(u) - 1), index, u)
    near_v = np.interp(np.clip(at[:, 1:] + step, 0, len(v) - 1), index, v)
    fine_u, fine_v = np.broadcast_arrays(near_u[:, :, None], near_v[:, None, :])
    return fine_u.ravel(), fine_v.ravel()


def _mean_square(distances: Array) -> float:
    """Mean square over the parameter square of distances (n, n) on the cosine-spaced grid."""
    weight = np.sin(np.pi * np.linspace(0.0, 1.0, len(distances)))
    return float(weight @ distances**2 @ weight / weight.sum() ** 2)


def _distances_to_reference(fitted: BSplineSurface, reference: ReferenceSurface, u: Array, v: Array) -> Array:
    """Distances of points of the fitted patch from the reference; foot points may lie a little beyond the domain: (n,)."""
    points = fitted(u, v)
    tangents = fitted(u, v, 1, 0), fitted(u, v, 0, 1)
    (u0, u1), (v0, v1) = fitted.domain
    margin_u, margin_v = REFERENCE_MARGIN_FRACTION * (u1 - u0), REFERENCE_MARGIN_FRACTION * (v1 - v0)
    domain = (u0 - margin_u, u1 + margin_u), (v0 - margin_v, v1 + margin_v)

    def jet(s: Array, t: Array, rows: IntArray) -> Sequence[Array]:
        return reference(s, t), tangents[0][rows], tangents[1][rows]

    foot_u, foot_v = project_to_surface(jet, points, u, v, domain)
    return np.linalg.norm(points - reference(foot_u, foot_v), axis=-1)


def _distances_from_reference(fitted: BSplineSurface, reference: ReferenceSurface, u: Array, v: Array) -> Array:
    """Distances of points of the reference from the fitted patch, an upper bound beyond its sides: (n,)."""
    return project_to_patch(fitted, reference(u, v), u, v)[0]

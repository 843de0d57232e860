"""How far a fitted patch is from its reference, measured: orthogonal distances on dense grids, in both directions.

Each sample's foot on the other surface is found by Gauss-Newton from its own parameters, with the fitted patch's tangents (the
reference's differ from them by the error that is being measured). The grid knows nothing of the samples the fit used; around
the worst samples finer grids look again, so that the maximum is not missed between samples.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from tpmscad._typing import Array
from tpmscad.splines.bspline import BSplineSurface

ReferenceSurface = Callable[[Array, Array], Array]
"""Positions (..., 3) of the reference surface at (u, v); must hold a little outside the patch's domain, where feet may lie."""

SAMPLES_PER_PARAMETER = 49
"""Samples along each parameter: three for each lobe of the error of a patch of degree 16."""

REFINED_PEAKS, SAMPLES_PER_PEAK_AXIS = 6, 9
"""So many local maxima are sampled again, so much finer. Measured against 203^2 samples on 75 fits: 0.2 % too low at most;
2.9 % with equal spacing and one peak."""

FOOT_PARAMETER_TOL = 1e-10
"""Feet that move less than this in a step are found: what is left of the tangential part is far below any deviation."""

REFERENCE_MARGIN_FRACTION = 0.04
"""Feet on the reference may lie this fraction of the domain outside it; a foot held back there only enlarges the distance."""

MAX_FOOT_ITERATIONS = 8
"""Gauss-Newton steps: each gains the factor of the tangents' relative error, 1e-1 at worst on the coarsest fits."""


@dataclass(frozen=True, slots=True)
class Deviation:
    """Largest and root-mean-square orthogonal distance, and the largest in each direction, in the units of the surfaces."""

    max: float
    rms: float
    to_reference: float
    from_reference: float

    def scaled(self, factor: float) -> Deviation:
        return Deviation(*(factor * getattr(self, name) for name in self.__slots__))


def combine_deviations(each: Sequence[Deviation]) -> Deviation:
    """The largest of several patches' deviations, and the root mean square over all of them."""
    return Deviation(
        max=max(d.max for d in each),
        rms=float(np.sqrt(np.mean([d.rms**2 for d in each]))),
        to_reference=max(d.to_reference for d in each),
        from_reference=max(d.from_reference for d in each),
    )


def measure_deviation(
    fitted: BSplineSurface, reference: ReferenceSurface, samples: int = SAMPLES_PER_PARAMETER
) -> Deviation:
    """The two-way distance between a fitted patch and the reference on the patch's domain."""
    (u0, u1), (v0, v1) = fitted.domain
    grid = (1 - np.cos(np.pi * np.linspace(0.0, 1.0, samples))) / 2  # errors' lobes are narrow near borders
    u, v = np.meshgrid(u0 + (u1 - u0) * grid, v0 + (v1 - v0) * grid, indexing="ij")
    largest, squares = [], []
    for measure in (_distances_to_reference, _distances_from_reference):
        distances = measure(fitted, reference, u.ravel(), v.ravel()).reshape(u.shape)
        fine_u, fine_v = sample_around_peaks(distances, u[:, 0], v[0])
        largest.append(float(max(distances.max(), measure(fitted, reference, fine_u, fine_v).max())))
        squares.append(mean_square(distances))
    return Deviation(max(largest), float(np.sqrt(np.mean(squares))), largest[0], largest[1])


def sample_around_peaks(distances: Array, u: Array, v: Array) -> tuple[Array, Array]:
    """Finer samples about the PEAKS highest local maxima of the sampled distances: two of (n,)."""
    rank = distances == maximum_filter(distances, size=3)
    at = np.argwhere(rank)
    at = at[np.argsort(-distances[rank], kind="stable")][:REFINED_PEAKS]
    step, index = np.linspace(-1.0, 1.0, SAMPLES_PER_PEAK_AXIS), np.arange(len(u))
    near_u = np.interp(np.clip(at[:, :1] + step, 0, len(u) - 1), index, u)
    near_v = np.interp(np.clip(at[:, 1:] + step, 0, len(v) - 1), index, v)
    fine_u, fine_v = np.broadcast_arrays(near_u[:, :, None], near_v[:, None, :])
    return fine_u.ravel(), fine_v.ravel()


def mean_square(distances: Array) -> float:
    """Mean over the parameter square of values on the cosine-spaced grid."""
    weight = np.sin(np.pi * np.linspace(0.0, 1.0, len(distances)))
    return float(weight @ distances**2 @ weight / weight.sum() ** 2)


def _distances_to_reference(fitted: BSplineSurface, reference: ReferenceSurface, u: Array, v: Array) -> Array:
    """Distances of fitted points to the reference, whose feet may lie beyond the patch's border: (n,)."""
    points = fitted(u, v)
    tangents = fitted(u, v, 1, 0), fitted(u, v, 0, 1)
    (u0, u1), (v0, v1) = fitted.domain
    room_u, room_v = REFERENCE_MARGIN_FRACTION * (u1 - u0), REFERENCE_MARGIN_FRACTION * (v1 - v0)
    a, b = u, v
    for _ in range(MAX_FOOT_ITERATIONS):
        da, db = _gauss_newton_step(points - reference(a, b), *tangents)
        a, b = np.clip(a + da, u0 - room_u, u1 + room_u), np.clip(b + db, v0 - room_v, v1 + room_v)
        if max(np.abs(da).max(), np.abs(db).max()) < FOOT_PARAMETER_TOL:
            break
    return np.linalg.norm(points - reference(a, b), axis=-1)


def _distances_from_reference(fitted: BSplineSurface, reference: ReferenceSurface, u: Array, v: Array) -> Array:
    """Distances of reference points to the fitted patch alone, feet kept on it: an upper bound where it ends: (n,)."""
    return project_to_patch(fitted, reference(u, v), u, v)[0]


def project_to_patch(fitted: BSplineSurface, points: Array, u: Array, v: Array) -> tuple[Array, Array, Array]:
    """Distances (n,) of points (n, 3) to the patch and their feet's parameters (n,), (n,), looked for from (u, v)."""
    (u0, u1), (v0, v1) = fitted.domain
    a, b = u, v
    for _ in range(MAX_FOOT_ITERATIONS):
        residual, along_u, along_v = points - fitted(a, b), fitted(a, b, 1, 0), fitted(a, b, 0, 1)
        da, db = _gauss_newton_step(residual, along_u, along_v)
        leaves_u, leaves_v = (a + da < u0) | (a + da > u1), (b + db < v0) | (b + db > v1)
        db = np.where(leaves_u, _tangential_step(along_v, residual), db)  # on a border the foot slides along it alone
        da = np.where(leaves_v, _tangential_step(along_u, residual), da)
        a, b = np.clip(a + da, u0, u1), np.clip(b + db, v0, v1)
        if max(np.abs(da).max(), np.abs(db).max()) < FOOT_PARAMETER_TOL:
            break
    return np.linalg.norm(points - fitted(a, b), axis=-1), a, b


def _tangential_step(tangent: Array, residual: Array) -> Array:
    return np.einsum("ni,ni->n", tangent, residual) / np.einsum("ni,ni->n", tangent, tangent)


def _gauss_newton_step(residual: Array, tangent_u: Array, tangent_v: Array) -> tuple[Array, Array]:
    """The parameter step that cancels the residual's tangential part."""
    uu, uv, vv = (np.einsum("ni,ni->n", p, q) for p, q in ((tangent_u,) * 2, (tangent_u, tangent_v), (tangent_v,) * 2))
    ru, rv = np.einsum("ni,ni->n", tangent_u, residual), np.einsum("ni,ni->n", tangent_v, residual)
    determinant = uu * vv - uv**2
    return (vv * ru - uv * rv) / determinant, (uu * rv - uv * ru) / determinant

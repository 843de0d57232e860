"""Deviation of many fitted patches from a mapped surface, offset along its normals.

An estimate of first order is made on a grid of every patch; where it is greatest, the distance is found by orthogonal projection.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter

from tpmscad._typing import Array, IntArray
from tpmscad.brep.deviation import REFERENCE_MARGIN_FRACTION, SAMPLES_PER_PEAK_AXIS, Deviation, cosine_grid
from tpmscad.brep.orthogonal_projection import project_to_surface
from tpmscad.lattices.g2_fit import CHEBYSHEV_NODES, PIECE_NODES, sample_parameters
from tpmscad.lattices.mapped_surface import MappedSurface
from tpmscad.splines.basis import bernstein_basis, evaluate_bezier_patches

SAMPLES_PER_PARAMETER = 25
"""Samples along each parameter for the deviation of each of the many patches."""

PIECE_SAMPLES_PER_PARAMETER = 17
"""The same of pieces of patches, which are half as large."""

PATCHES_AT_ONCE = 100
"""Patches that are evaluated together: their points fit into tens of megabytes."""

ESTIMATE_MARGIN = 1.06
"""Factor by which a deviation may exceed its estimate, of first order, on the grid; 1.046 was the most that was found."""


def sample_layers(
    mapped: MappedSurface, t: Array, distances: Sequence[float], chosen: IntArray, spans: int = 1
) -> list[Array]:
    """Points (n, k, k, m, m, 3) of placements (n,) for each distance, at parameters (m,) along u and v of k x k pieces."""
    along = (np.arange(spans)[:, None] + t) / spans
    u, v = np.broadcast_arrays(along[:, None, :, None], along[None, :, None, :])
    parts: list[list[Array]] = [[] for _ in distances]
    many = max(PATCHES_AT_ONCE // spans**2, 1)
    for start in range(0, len(chosen), many):
        points = mapped.points(u, v, chosen[start : start + many])
        unit, centre = mapped.grading(points.position)
        for part, distance in zip(parts, distances, strict=True):
            part.append(points.position + (centre + distance * unit)[..., None] * points.normal)
    return [np.concatenate(part) for part in parts]


@dataclass(frozen=True, slots=True, eq=False)
class SampledPatches:
    """Points of the exact offset surfaces over the patches of placements (n,), which are divided into spans x spans pieces.

    Of each surface `nodes` (n, spans, spans, m, m, 3) are those to which patches are fitted, and `checks` those on `cosine_grid`
    at which they are measured.
    """

    placement: IntArray
    spans: int
    nodes: list[Array]
    checks: list[Array]

    @classmethod
    def of(cls, mapped: MappedSurface, distances: Sequence[float], placement: IntArray, spans: int) -> SampledPatches:
        """The samples of surfaces at their signed distances."""
        nodes = CHEBYSHEV_NODES if spans == 1 else PIECE_NODES
        checks = SAMPLES_PER_PARAMETER if spans == 1 else PIECE_SAMPLES_PER_PARAMETER
        grids = sample_parameters(nodes), cosine_grid(checks)
        return cls(placement, spans, *(sample_layers(mapped, t, distances, placement, spans) for t in grids))

    def divide(self, mapped: MappedSurface, distances: Sequence[float], spans: int) -> SampledPatches:
        """The samples of the same patches in so many pieces."""
        return self if spans == self.spans else self.of(mapped, distances, self.placement, spans)

    def select(self, chosen: IntArray) -> SampledPatches:
        """The samples over some of the patches."""
        nodes, checks = ([points[chosen] for points in layers] for layers in (self.nodes, self.checks))
        return SampledPatches(self.placement[chosen], self.spans, nodes, checks)


@dataclass(frozen=True, slots=True, eq=False)
class MeasuredPatches:
    """The deviation of all patches together, and estimates of how far each is off (n,)."""

    deviation: Deviation
    estimates: Array


def measure_patches(
    mapped: MappedSurface, distances: Sequence[float], samples: SampledPatches, poles: Sequence[Array]
) -> MeasuredPatches:
    """Deviation of the fitted patches, all together: the greatest is sought by estimates, and measured where they have a maximum.

    An estimate is of first order in the difference at equal parameters. Maxima that could exceed the greatest one are refined and
    projected, in each direction; all samples count for the root mean square. poles: of each layer those of the pieces of its
    patches, (n, spans, spans, p + 1, p + 1, 3).
    """
    columns = zip(distances, samples.checks, poles, strict=True)
    grids = [_Estimates.on_grid(mapped, samples.placement, *of_layer) for of_layer in columns]
    off = np.stack([grid.distances.max(axis=(2, 3)) for grid in grids])  # (layers, 2, pieces of all patches)
    least = off.max(axis=(0, 2)) / ESTIMATE_MARGIN
    to_reference, from_reference = np.max([grid.measure_peaks(least) for grid in grids], axis=0).tolist()
    rms = float(np.sqrt(np.mean(np.concatenate([grid.mean_square for grid in grids]))))
    deviation = Deviation(max(to_reference, from_reference), rms, to_reference, from_reference)
    return MeasuredPatches(deviation, off.max(axis=(0, 1)).reshape(len(samples.placement), -1).max(axis=1))


@dataclass(frozen=True, slots=True, eq=False)
class _Estimates:
    """Estimated distances of the pieces (n,) of patches to the exact surface and back, and their mean square (n,).

    distances: (2, n, m, m) on `cosine_grid`. Of each piece the placement of its patch, its Bezier poles, and the parameters at
    which it begins in the patch, (2, n), as multiples of its extent in them.
    """

    mapped: MappedSurface
    distance: float
    placement: IntArray
    origin: IntArray
    spans: int
    poles: Array
    distances: Array
    mean_square: Array

    @classmethod
    def on_grid(
        cls, mapped: MappedSurface, placement: IntArray, distance: float, exact: Array, poles: Array
    ) -> _Estimates:
        """Of all patches of a layer, at all points of the grid."""
        spans = poles.shape[1]
        owner, *origin = np.indices(poles.shape[:3]).reshape(3, -1)
        exact, poles = (x.reshape(-1, *x.shape[3:]) for x in (exact, poles))
        t = cosine_grid(exact.shape[-2])
        u, v = np.meshgrid(t, t, indexing="ij")
        weight = np.sin(np.pi * np.linspace(0.0, 1.0, len(t)))
        values, slopes = (bernstein_basis(poles.shape[1] - 1, t, order) for order in range(2))
        found = np.empty((2, len(poles), *u.shape))
        for start in range(0, len(poles), PATCHES_AT_ONCE):
            chosen = slice(start, start + PATCHES_AT_ONCE)
            own = poles[chosen]
            fitted, du, dv = (
                evaluate_bezier_patches(rows, own, columns).reshape(len(own), *u.shape, 3)
                for rows, columns in ((values, values), (slopes, values), (values, slopes))
            )
            found[:, chosen] = _estimate_distances(exact[chosen] - fitted, du, dv, u, v)
        square = np.einsum("i,kpij,j->p", weight, found**2, weight) / (2 * weight.sum() ** 2)
        return cls(mapped, distance, placement[owner], np.array(origin), spans, poles, found, square)

    def measure_peaks(self, least: Array) -> tuple[float, float]:
        """The greatest distance to the exact surface, and back, at the maxima of estimates of at least `least` (2,)."""
        to_reference = self._distances_to_reference(*self._find_peaks(0, least[0]))
        return to_reference, self._distances_from_reference(*self._find_peaks(1, least[1]))

    def _find_peaks(self, direction: int, least: float) -> tuple[IntArray, Array, Array]:
        """Patches and parameters (n,) of the maxima of at least `least`, refined between the points of the grid."""
        found = self.distances[direction]
        t, index = cosine_grid(found.shape[-1]), np.arange(found.shape[-1])
        patch, *at = np.nonzero((found >= least) & (found == maximum_filter(found, size=(1, 3, 3))))
        step = np.linspace(-1.0, 1.0, SAMPLES_PER_PEAK_AXIS)
        u, v = (np.interp(np.clip(k[:, None] + step, 0, index[-1]), index, t) for k in at)
        u, v = np.repeat(u, len(step), axis=1), np.tile(v, len(step))
        many = np.repeat(patch, u.shape[1])
        fitted, du, dv = self._evaluate(many, u.ravel(), v.ravel())
        miss = self._reference(many, u.ravel(), v.ravel()) - fitted
        finer = _estimate_distances(miss, du, dv, u.ravel(), v.ravel())[direction].reshape(u.shape)
        best = finer.argmax(axis=1)[:, None]
        u, v = (np.take_along_axis(x, best, axis=1)[:, 0] for x in (u, v))
        return patch, u, v

    def _evaluate(self, patch: IntArray, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Points (n, 3) of the fitted patches and their derivatives by u and by v, the i-th of patch[i]."""
        degree = self.poles.shape[1] - 1
        (u0, u1), (v0, v1) = ([bernstein_basis(degree, x, order) for order in range(2)] for x in (u, v))
        rows = [np.einsum("na,nabk->nbk", r, self.poles[patch]) for r in (u0, u1)]
        point, du, dv = (np.einsum("nb,nbk->nk", c, r) for c, r in ((v0, rows[0]), (v0, rows[1]), (v1, rows[0])))
        return point, du, dv

    def _reference(self, patch: IntArray, u: Array, v: Array) -> Array:
        """Points (n, 3) of the exact offset surface, the i-th of patch[i]."""
        u, v = ((first + t) / self.spans for first, t in zip(self.origin[:, patch], (u, v), strict=True))
        return self.mapped.shift(self.mapped.points_at(self.placement[patch], u, v), self.distance)

    def _distances_to_reference(self, patch: IntArray, u: Array, v: Array) -> float:
        """The greatest distance of points of the patches from the exact surface, whose foot points may lie a little beyond."""
        points, du, dv = self._evaluate(patch, u, v)

        def jet(s: Array, t: Array, rows: IntArray) -> Sequence[Array]:
            return self._reference(patch[rows], s, t), du[rows], dv[rows]

        domain = -REFERENCE_MARGIN_FRACTION, 1.0 + REFERENCE_MARGIN_FRACTION
        foot = project_to_surface(jet, points, u, v, (domain, domain))
        return float(np.linalg.norm(points - self._reference(patch, *foot), axis=1).max(initial=0.0))

    def _distances_from_reference(self, patch: IntArray, u: Array, v: Array) -> float:
        """The greatest distance of points of the exact surface from the patches, an upper bound beyond their sides."""
        points, domain = self._reference(patch, u, v), (0.0, 1.0)
        foot = project_to_surface(lambda s, t, rows: self._evaluate(patch[rows], s, t), points, u, v, (domain, domain))
        return float(np.linalg.norm(points - self._evaluate(patch, *foot)[0], axis=1).max(initial=0.0))


def _estimate_distances(miss: Array, du: Array, dv: Array, u: Array, v: Array) -> Array:
    """Distances (2, ...) to first order in the steps `miss` (..., 3) from a patch to a surface: to the surface, and back.

    They are the parts along the normal; on a side back also that by which the surface lies beyond the patch, where foot points
    stop. u, v: as many parameters as the last axes have points.
    """
    normal = np.cross(du, dv)
    along = np.abs(np.einsum("...d,...d->...", miss, normal)) / np.linalg.norm(normal, axis=-1)
    back = along.copy()
    for at_side, direction, outwards in ((u == 0, dv, -du), (u == 1, dv, du), (v == 0, du, -dv), (v == 1, du, dv)):
        across = np.cross(direction[..., at_side, :], normal[..., at_side, :])
        across *= np.sign(np.einsum("...d,...d->...", across, outwards[..., at_side, :]))[..., None]
        beyond = np.einsum("...d,...d->...", miss[..., at_side, :], across) / np.linalg.norm(across, axis=-1)
        back[..., at_side] = np.maximum(back[..., at_side], np.hypot(along[..., at_side], np.maximum(beyond, 0.0)))
    return np.stack([along, back])

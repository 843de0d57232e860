"""Keeping the volume fraction along a transition: a shift of the field, zero at both ends of the layer.

A mixture of two structures can be much more or much less solid than either. A spline c(t) of the line weight's coordinate is
added to the blended field, so that at each t the solid fraction is what interpolates those of the two structures there; its
coefficients are zero wherever the weight's are fixed, so that nothing outside the layer changes and the field stays as smooth.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import BSpline

from tpmscad.blend.composition import Weighting
from tpmscad.blend.grid import Array, lattice
from tpmscad.blend.scene import Scene
from tpmscad.blend.weights_line import LineWeight
from tpmscad.errors import InvalidRequest

LAYERS_PER_COEFFICIENT = 2
PARTS = 20
PASSES = 3
"""Refinements of the shift: the spline smooths what each layer asks for, and the next pass mends what is left."""


@dataclass(frozen=True, slots=True, eq=False)
class LineShift:
    """A spline c of a line weight's coordinate in units of the field: coefficients (n,), zero beyond the layer."""

    line: LineWeight
    coefficients: Array

    def __call__(self, points: ArrayLike) -> Array:
        return self._of(self.line.coordinate(np.asarray(points, float)), 0)

    def gradient(self, points: ArrayLike) -> Array:
        points = np.asarray(points, float)
        return self._of(self.line.coordinate(points), 1)[..., None] * self.line.coordinate.gradient(points)

    def on_grid(self, x: Array, y: Array, z: Array) -> Array:
        return self(lattice((x, y, z)))

    def _of(self, t: Array, order: int) -> Array:
        values = BSpline(self.line.knots, self.coefficients, self.line.degree)(
            np.clip(t, self.line.start, self.line.end), order
        )
        return np.where((t < self.line.start) | (t > self.line.end), 0.0, values)


def fraction_shift(scene: Scene, weights: Sequence[Weighting], stage: int) -> LineShift:
    """The shift of one stage, from the samples of the scene (shifts left out). Raises InvalidRequest for volume weights."""
    line = weights[stage]
    if not isinstance(line, LineWeight):
        raise InvalidRequest(f"keep_fraction needs a blending region that is a layer: blending region {stage} is none")
    inside = scene.blending[stage] & (scene.owner <= stage + 1)
    t = line.coordinate(scene.grid.points(np.flatnonzero(inside)))
    bare = scene.with_shifts([None] * len(weights))
    values = bare.values(weights)[inside]
    first, second = (scene.structures[k][inside] <= 0 for k in (stage, stage + 1))
    count = LAYERS_PER_COEFFICIENT * int(line.free.sum())
    edges = np.linspace(line.start, line.end, count + 1)
    layer = np.clip(np.searchsorted(edges, t, side="right") - 1, 0, count - 1)
    middle = (edges[:-1] + edges[1:]) / 2
    present = np.bincount(layer, minlength=count) > 0
    share = (middle - line.start) / (line.end - line.start)
    share = share if line.coefficients[-1] > line.coefficients[0] else 1 - share
    basis = BSpline.design_matrix(middle[present], line.knots, line.degree).toarray()[:, line.free]
    coefficients = np.zeros(len(line.coefficients))
    for _ in range(PASSES):
        shifted = values + LineShift(line, coefficients)._of(t, 0)
        wanted = np.zeros(count)
        for k in np.flatnonzero(present):
            here = layer == k
            target = (1 - share[k]) * first[here].mean() + share[k] * second[here].mean()
            wanted[k] = -np.quantile(shifted[here], target)
        coefficients[line.free] += np.linalg.lstsq(basis, wanted[present], rcond=None)[0]
    return LineShift(line, coefficients)


def fraction_error(scene: Scene, weights: Sequence[Weighting], line: LineWeight, stage: int) -> float:
    """Mean distance, over twenty parts of the layer of `line`, of the solid fraction from the interpolated one."""
    inside = scene.blending[stage] & (scene.owner <= stage + 1)
    share = (line.coordinate(scene.grid.points(np.flatnonzero(inside))) - line.start) / (line.end - line.start)
    share = share if line.coefficients[-1] > line.coefficients[0] else 1 - share
    layer = np.clip((share * PARTS).astype(int), 0, PARTS - 1)
    solid = scene.values(weights)[inside] <= 0
    first, second = (scene.structures[k][inside] <= 0 for k in (stage, stage + 1))
    off = []
    for k in np.unique(layer):
        here = layer == k
        off.append(abs(solid[here].mean() - ((1 - share[here]) * first[here] + share[here] * second[here]).mean()))
    return float(np.mean(off))

"""The distances of many patches from their surfaces, at scattered parameters: values, gradients, and the zeros next to points.

A pair of a patch S and an implicit surface g has the function g(S(u, v)). `ComposedDistance` evaluates that of one pair on grids;
here each point has a pair of its own, so that the iterations of thousands of pairs run together.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.intersect.marching import NEWTON_STEPS, STEP_TOL
from tpmscad.trimming.operands.quadric_table import QuadricTable

MAX_DOMAINS = 10.0
"""Widths of the domain beyond which an iteration that leaves a patch has diverged."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchDistances:
    """The functions g_i(S_i(u, v)) of n pairs: the patches S_i, and a table with a row for each g_i."""

    patches: Sequence[BSplineSurface]
    implicit: QuadricTable

    def evaluate(self, pair: IntArray, at: Array) -> tuple[Array, Array]:
        """Values (m,) and gradients (m, 2) of the functions `pair` (m,) at parameters `at` (m, 2)."""
        points, by_u, by_v = self.jet(pair, at)
        value, slope = (found[:, 0] for found in self.implicit.take(pair).jet(points[:, None], 1))
        gradient = np.column_stack([np.einsum("nk,nk->n", slope, along) for along in (by_u, by_v)])
        return value, gradient

    def jet(self, pair: IntArray, at: Array) -> tuple[Array, Array, Array]:
        """Points and first derivatives (m, 3) of the patches of the pairs `pair` (m,) at parameters `at` (m, 2)."""
        found = np.empty((3, len(pair), 3))
        identity = np.array([id(self.patches[i]) for i in pair.tolist()], np.int64)
        for own in np.unique(identity).tolist():
            rows = np.flatnonzero(identity == own)
            found[:, rows] = self.patches[int(pair[rows[0]])].jet(*at[rows].T)
        return found[0], found[1], found[2]

    def project_to_zero(self, pair: IntArray, at: Array) -> Array:
        """The zeros (m, 2) that Newton steps along the gradient find from `at` (m, 2), NaN where they diverge."""
        at = at.copy()
        left = np.arange(len(pair))
        for _ in range(NEWTON_STEPS):
            if not len(left):
                break
            value, gradient = self.evaluate(pair[left], at[left])
            with np.errstate(divide="ignore", invalid="ignore"):
                step = (value / np.einsum("nk,nk->n", gradient, gradient))[:, None] * gradient
            at[left] -= step
            lost = ~self._is_near_domain(pair[left], at[left])
            at[left[lost]] = np.nan
            left = left[~lost & (np.abs(step).max(axis=1) >= STEP_TOL)]
        return at

    def _is_near_domain(self, pair: IntArray, at: Array) -> BoolArray:
        """Parameters (m, 2) that are finite and at most `MAX_DOMAINS` widths away from the middle of their patches."""
        domains = np.array([self.patches[i].domain for i in pair.tolist()]).reshape(-1, 2, 2)
        off = np.abs(at - domains.mean(axis=2))
        return np.asarray((off <= MAX_DOMAINS * np.diff(domains, axis=2)[..., 0]).all(axis=1))

"""Fitted curves in the faces of the box, which bound its planar caps: overshoot beyond the box, and crossings.

The two sides of a neck narrower than the tolerance may each be within the tolerance and still cross. Inside the box such a
crossing shows as a folded patch. In a cap nothing but the CAD kernel would notice it, at the very end; so it is tested here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.levelset.fit.network_fit import NetworkFit
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.patch_network import PatchNetwork
from tpmscad.splines.basis import bernstein_basis

CURVE_PARAMETERS = np.linspace(0.0, 1.0, 33)
"""Parameters at which a curve is sampled."""

PAIRS_PER_BATCH = 1 << 10
"""Pairs of curves tested at once, with 1024 pairs of segments each."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxCurves:
    """Curves (n,) of a network that lie in faces of the box, and points (n, len(CURVE_PARAMETERS), 3) along them."""

    curve: IntArray
    points: Array


def sample_box_curves(network: PatchNetwork, fit: NetworkFit) -> BoxCurves:
    """The curves of a fit in faces of the box, sampled."""
    curve = np.flatnonzero(network.plane >= 0)
    points = np.empty((len(curve), len(CURVE_PARAMETERS), 3))
    n_poles = np.array([len(fit.curves[c]) for c in curve], np.int64)
    for n in np.unique(n_poles):
        rows = np.flatnonzero(n_poles == n)
        points[rows] = bernstein_basis(n - 1, CURVE_PARAMETERS) @ np.stack([fit.curves[c] for c in curve[rows]])
    return BoxCurves(curve, points)


def measure_overshoot(network: PatchNetwork, box_curves: BoxCurves, tree: Octree) -> Array:
    """Distance (C,) by which each curve in a face of the box leaves the box across its edges; zero or less if it does not."""
    result = np.zeros(len(network.ends))
    points = box_curves.points
    result[box_curves.curve] = np.maximum(tree.lo - points, points - tree.hi).max(axis=(1, 2))
    return result


def find_crossing_curves(network: PatchNetwork, box_curves: BoxCurves) -> BoolArray:
    """Mask (C,) of curves in faces of the box that cross another one there without a common end.

    Bounding boxes are the broad phase, pairs of segments the narrow phase.
    """
    result = np.zeros(len(network.ends), bool)
    curve, points = box_curves.curve, box_curves.points
    for plane in range(6):
        rows = np.flatnonzero(network.plane[curve] == plane)
        flat = np.delete(points[rows], plane // 2, axis=2)
        low, high, ends = flat.min(axis=1), flat.max(axis=1), network.ends[curve[rows]]
        for i in range(len(rows)):
            overlapping = ((low[i + 1 :] <= high[i]) & (high[i + 1 :] >= low[i])).all(axis=1)
            others = i + 1 + np.flatnonzero(overlapping)
            others = others[~(ends[others][:, :, None] == ends[i]).any(axis=(1, 2))]
            for start in range(0, len(others), PAIRS_PER_BATCH):
                batch = others[start : start + PAIRS_PER_BATCH]
                crossed = batch[_polylines_cross(flat[i][None], flat[batch])]
                result[curve[rows[crossed]]] = True
                result[curve[rows[i]]] |= len(crossed) > 0
    return result


def _polylines_cross(one: Array, other: Array) -> BoolArray:
    """Whether polylines (1 or n, m, 2) and (n, m, 2) cross: (n,)."""
    a, b, c, d = one[:, :-1, None], one[:, 1:, None], other[:, None, :-1], other[:, None, 1:]
    opposite = (_orient(a, b, c) * _orient(a, b, d) < 0) & (_orient(c, d, a) * _orient(c, d, b) < 0)
    return np.asarray(opposite.any(axis=(1, 2)))


def _orient(p: Array, q: Array, r: Array) -> Array:
    """Twice the signed area of the triangles p, q, r (..., 2)."""
    return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

"""Sections of the patches with the box, which bound its caps: they stay in it, and do not cross each other.

Two sides of a neck that is narrower than the tolerance may each lie within it and still cross. Inside the box a fold tells; in
a cap nothing would but the kernel, at the end.
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
"""Where along its parameter a curve is looked at."""

PAIRS_PER_BATCH = 1 << 10
"""Pairs of curves looked at together: 1024 pairs of segments each."""


@dataclass(frozen=True, slots=True, eq=False)
class BoxCurves:
    """The curves of a net in faces of the box, `at` (n,), and points along them (n, len(ALONG), 3)."""

    at: IntArray
    points: Array


def measure_overshoot(net: PatchNetwork, sections: BoxCurves, tree: Octree) -> Array:
    """How far curves (C,) in faces of the box leave it by its edges."""
    result = np.zeros(len(net.ends))
    at, points = sections.at, sections.points
    result[at] = np.maximum(tree.lo - points, points - tree.hi).max(axis=(1, 2))
    return result


def find_crossing_curves(net: PatchNetwork, sections: BoxCurves) -> BoolArray:
    """Curves (C,) in faces of the box that cross another there, but for those that share an end."""
    result = np.zeros(len(net.ends), bool)
    at, points = sections.at, sections.points
    for plane in range(6):
        own = np.flatnonzero(net.plane[at] == plane)
        flat = np.delete(points[own], plane // 2, axis=2)
        low, high, ends = flat.min(axis=1), flat.max(axis=1), net.ends[at[own]]
        for i in range(len(own)):
            near = ((low[i + 1 :] <= high[i]) & (high[i + 1 :] >= low[i])).all(axis=1)
            others = i + 1 + np.flatnonzero(near)
            others = others[~(ends[others][:, :, None] == ends[i]).any(axis=(1, 2))]
            for start in range(0, len(others), PAIRS_PER_BATCH):
                part = others[start : start + PAIRS_PER_BATCH]
                crossed = part[_polylines_cross(flat[i][None], flat[part])]
                result[at[own[crossed]]] = True
                result[at[own[i]]] |= len(crossed) > 0
    return result


def sample_box_curves(net: PatchNetwork, fit: NetworkFit) -> BoxCurves:
    """The sections of a fit with the box, sampled."""
    at = np.flatnonzero(net.plane >= 0)
    points = np.empty((len(at), len(CURVE_PARAMETERS), 3))
    count = np.array([len(fit.curves[c]) for c in at], np.int64)
    for n in np.unique(count):
        same = np.flatnonzero(count == n)
        points[same] = bernstein_basis(n - 1, CURVE_PARAMETERS) @ np.stack([fit.curves[c] for c in at[same]])
    return BoxCurves(at, points)


def _polylines_cross(one: Array, other: Array) -> BoolArray:
    """Whether polylines (1 or n, m, 2) and (n, m, 2) cross: (n,)."""
    a, b, c, d = one[:, :-1, None], one[:, 1:, None], other[:, None, :-1], other[:, None, 1:]

    def side(p: Array, q: Array, r: Array) -> Array:
        return (q[..., 0] - p[..., 0]) * (r[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (r[..., 0] - p[..., 0])

    apart = (side(a, b, c) * side(a, b, d) < 0) & (side(c, d, a) * side(c, d, b) < 0)
    return np.asarray(apart.any(axis=(1, 2)))

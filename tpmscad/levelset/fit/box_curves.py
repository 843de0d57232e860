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
        crossing = mark_crossing_polylines(np.delete(points[rows], plane // 2, axis=2), network.ends[curve[rows]])
        result[curve[rows]] = crossing
    return result


def mark_crossing_polylines(lines: Array, ends: IntArray) -> BoolArray:
    """Mask (n,) of polylines (n, m, 2) that cross another one without a common end; `ends` (n, 2) are the numbers of theirs."""
    low, high = lines.min(axis=1), lines.max(axis=1)
    crossing = np.zeros(len(lines), bool)
    for i in range(len(lines) - 1):
        others = i + 1 + np.flatnonzero(((low[i + 1 :] <= high[i]) & (high[i + 1 :] >= low[i])).all(axis=1))
        for j in others[~np.isin(ends[others], ends[i]).any(axis=1)]:
            if _do_polylines_cross(lines[i], lines[j]):
                crossing[[i, j]] = True
    return crossing


def _do_polylines_cross(one: Array, other: Array) -> bool:
    """Whether two polylines (m, 2) cross: whether the ends of a segment of each lie on both sides of one of the other."""
    of_other, of_one = _sides(one, other), _sides(other, one).T
    return bool((_changes_along(of_other, 1) & _changes_along(of_one, 0)).any())


def _sides(line: Array, points: Array) -> Array:
    """Twice the signed areas (m - 1, n) of the triangles of the segments of a polyline (m, 2) with points (n, 2)."""
    along, to_points = np.diff(line, axis=0)[:, None], points - line[:-1, None]
    return np.asarray(along[..., 0] * to_points[..., 1] - along[..., 1] * to_points[..., 0])


def _changes_along(sides: Array, axis: int) -> BoolArray:
    """Where two successive values along an axis have opposite signs."""
    first, second = (np.take(sides, range(k, sides.shape[axis] - 1 + k), axis=axis) for k in (0, 1))
    return np.asarray(first * second < 0)

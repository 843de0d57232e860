"""Fitted curves in the faces of the box, which bound its planar caps: overshoot beyond the box, and crossings.

The two sides of a neck narrower than the tolerance may each be within the tolerance and still cross. Inside the box such a
crossing shows as a folded patch. In a cap nothing but the CAD kernel would notice it, at the very end; so it is tested here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._compiled_loops import njit_cached
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
        flat = np.delete(points[rows], plane // 2, axis=2)
        low, high = flat.min(axis=1), flat.max(axis=1)
        order = np.argsort(low[:, 0], kind="stable")
        crossing = np.zeros(len(rows), bool)
        _mark_crossing_polylines(flat[order], low[order], high[order], network.ends[curve[rows[order]]], crossing)
        result[curve[rows[order]]] = crossing
    return result


@njit_cached
def _mark_crossing_polylines(
    lines: Array, low: Array, high: Array, ends: IntArray, crossing: BoolArray
) -> None:  # pragma: no cover
    """Mark polylines (n, m, 2) that cross another one without a common end (n, 2); they are sorted by their least abscissa."""
    for i in range(len(lines)):
        for j in range(i + 1, len(lines)):
            if low[j, 0] > high[i, 0]:
                break
            if low[j, 1] > high[i, 1] or high[j, 1] < low[i, 1]:
                continue
            shared = False
            for a in range(2):
                for b in range(2):
                    shared |= ends[i, a] == ends[j, b]
            if not shared and _do_polylines_cross(lines[i], lines[j]):
                crossing[i] = crossing[j] = True


@njit_cached
def _do_polylines_cross(one: Array, other: Array) -> bool:  # pragma: no cover
    """Whether two polylines (m, 2) cross."""
    for i in range(len(one) - 1):
        a, b = one[i], one[i + 1]
        for j in range(len(other) - 1):
            c, d = other[j], other[j + 1]
            if _orient(a, b, c) * _orient(a, b, d) < 0 and _orient(c, d, a) * _orient(c, d, b) < 0:
                return True
    return False


@njit_cached
def _orient(p: Array, q: Array, r: Array) -> float:  # pragma: no cover
    """Twice the signed area of the triangle p, q, r."""
    return (q[0] - p[0]) * (r[1] - p[1]) - (q[1] - p[1]) * (r[0] - p[0])

"""Parameters of points along the body's edges: lines, circles, ellipses and B-splines."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.carriers import Circle, EdgeCurve, Ellipse
from tpmscad.patches.conics import TURN
from tpmscad.splines.bspline import Curve
from tpmscad.trimming.tool import Array

SAMPLES = 129
"""Samples along a curve without a closed form, between which the nearest point is found by Newton's method."""


def nearest(curve: EdgeCurve, span: Array, points: Array) -> tuple[Array, Array]:
    """Parameters (n,) of the curve's points next to points (n, 3), and how far apart they are.

    Angles are given as near as possible to the middle of the span.
    """
    if isinstance(curve, Curve) and curve.degree == 1 and len(curve.poles) == 2:
        low, high = curve.domain
        way = curve.poles[1] - curve.poles[0]
        t = low + (high - low) * ((points - curve.poles[0]) @ way) / float(way @ way)
    elif isinstance(curve, Circle | Ellipse):
        arm = points - curve.origin
        x, y = arm @ curve.x_axis, arm @ curve.y_axis
        if isinstance(curve, Circle):
            t = np.arctan2(y, x)
        else:
            t = _closest(curve, np.arctan2(y / curve.minor, x / curve.major), points)
        middle = 0.5 * (span[0] + span[1])
        t = middle + (t - middle + TURN / 2) % TURN - TURN / 2
    else:
        at = np.linspace(span[0], span[1], SAMPLES)
        apart = np.linalg.norm(points[:, None] - curve(at), axis=2)
        t = np.clip(_closest(curve, at[apart.argmin(axis=1)], points), span[0], span[1])
    return t, np.linalg.norm(curve(t) - points, axis=1)


def _closest(curve: EdgeCurve, t: Array, points: Array) -> Array:
    for _ in range(8):
        gap, first, second = curve(t) - points, curve(t, 1), curve(t, 2)
        slope = (gap * first).sum(axis=1)
        bend = (first * first).sum(axis=1) + (gap * second).sum(axis=1)
        t = t - slope / np.where(bend > 0, bend, (first * first).sum(axis=1))
        if isinstance(curve, Curve):
            t = np.clip(t, *curve.domain)
    return t

"""Lines and circles among curves that are known by points."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.carriers import Circle, EdgeCurve
from tpmscad.splines.bspline import line_segment


def recognise_line_or_circle(points: Array, tol: float) -> tuple[EdgeCurve, tuple[float, float]] | None:
    """Line or circle on which points (m, 3) along a curve lie, with its span from the first to the last; or None."""
    start, end, middle = points[0], points[-1], points[len(points) // 2]
    chord = end - start
    length = float(np.linalg.norm(chord))
    if length > tol:
        off = points - start
        off = off - np.multiply.outer(off @ chord / length**2, chord)
        if np.linalg.norm(off, axis=1).max() <= tol:
            return line_segment(start, end, (0.0, length)), (0.0, length)
    else:  # a closed curve: points at thirds
        end, middle = points[2 * len(points) // 3], points[len(points) // 3]
    a, b = middle - start, end - start
    normal = np.cross(a, b)
    if np.linalg.norm(normal) <= tol * max(np.linalg.norm(a), np.linalg.norm(b)):
        return None
    arm = np.cross(normal, a) * (b @ b) + np.cross(b, normal) * (a @ a)
    arm = arm / (2.0 * normal @ normal)  # from the first point to the center
    centre, radius = start + arm, float(np.linalg.norm(arm))
    circle = Circle(centre, -arm / radius, normal / np.linalg.norm(normal), radius)
    out = points - centre
    if max(np.abs(out @ circle.normal).max(), np.abs(np.linalg.norm(out, axis=1) - radius).max()) > tol:
        return None
    angle = np.unwrap(np.arctan2(out @ circle.y_axis, out @ circle.x_axis))
    return (circle, (0.0, float(angle[-1]))) if (np.diff(angle) > 0).all() else None

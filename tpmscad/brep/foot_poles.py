"""Feet at a pole of a surface, a side that is one point: the parameters there tell no direction.

Nearer than POLE_CHART to a smooth pole the foot is that on its paraboloid. A run that has come to any pole goes on in the
direction in which the distance falls the fastest.
"""

from __future__ import annotations

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, IntArray
from tpmscad.brep.foot_surface import SpanPolynomials, evaluate_spans

STEP_TOL = 3e-15
"""In sizes of the surface: the length of a step at which a run has converged."""

SAFE_DIAGONAL, SAFE_DETERMINANT = 1e-3, 1e-4
"""Least ratios of H_ii to S_i . S_i, and of det H to their product, with which H is used as it is."""

POLE_TURNS = 24
"""Directions about a pole among which a run that has come to it chooses the one to go on in."""

POLE_CHART = 3e-6
"""In sizes: nearer to a smooth pole the foot is that on the paraboloid of the pole, and errors are of third order."""


@njit_cached
def find_pole(spans: SpanPolynomials, u: float, v: float) -> int:  # pragma: no cover - compiled
    """The side that is a point next to which the parameters are, or -1."""
    box = spans.box
    near_v = 0 if v - box[1, 0] < box[1, 1] - v else 2
    near_u = 3 if u - box[0, 0] < box[0, 1] - u else 1
    if spans.pole[near_v] != 0 and min(v - box[1, 0], box[1, 1] - v) < 1e-3 * (box[1, 1] - box[1, 0]):
        return near_v
    if spans.pole[near_u] != 0 and min(u - box[0, 0], box[0, 1] - u) < 1e-3 * (box[0, 1] - box[0, 0]):
        return near_u
    return -1


@njit_cached
def settle_at_pole(
    spans: SpanPolynomials, side: int, px: float, py: float, pz: float, place: Array, span: IntArray, jet: Array
) -> bool:  # pragma: no cover - compiled
    """Move `place` to the foot of p, with its jet, if it is within POLE_CHART of a smooth pole; returns whether it is.

    With the height h and the tangential part t of p over the pole, the foot is at w = (1 - h K)^-1 t in the tangent plane.
    """
    if spans.pole[side] != 1:
        return False
    normal, curvature = spans.pole_normal[side], spans.pole_curvature[side]
    along, first = (0, 6) if side % 2 == 0 else (1, 3)
    near = side == 0 or side == 3
    low, high = spans.box[along, 0], spans.box[along, 1]
    pole = spans.box[1 - along, 0] if near else spans.box[1 - along, 1]
    place[along], place[1 - along] = low, pole
    evaluate_spans(spans, place[0], place[1], span, jet)
    x, y, z = px - jet[0], py - jet[1], pz - jet[2]
    h = x * normal[0] + y * normal[1] + z * normal[2]
    x, y, z = x - h * normal[0], y - h * normal[1], z - h * normal[2]
    trace, norm = 0.0, 0.0
    for r in range(3):
        trace += curvature[r, r]
        for c in range(3):
            norm += curvature[r, c] ** 2
    determinant = 1.0 - h * trace + 0.5 * h * h * (trace * trace - norm)
    if not (determinant > SAFE_DETERMINANT and 2.0 - h * trace > SAFE_DIAGONAL):
        return False
    # (1 - h K)^-1 = (1 - h (trace K - K)) / det(1 - h K) in the tangent plane
    kx = curvature[0, 0] * x + curvature[0, 1] * y + curvature[0, 2] * z
    ky = curvature[1, 0] * x + curvature[1, 1] * y + curvature[1, 2] * z
    kz = curvature[2, 0] * x + curvature[2, 1] * y + curvature[2, 2] * z
    wx = (x - h * (trace * x - kx)) / determinant
    wy = (y - h * (trace * y - ky)) / determinant
    wz = (z - h * (trace * z - kz)) / determinant
    length = np.sqrt(wx * wx + wy * wy + wz * wz)
    if length > POLE_CHART * spans.size:
        return False
    # the direction of w among those of the lines through the pole: sampled, then between the neighbours
    best, least = low, np.inf
    inwards = -1.0 if near else 1.0
    for k in range(POLE_TURNS + 1):
        place[along] = low + (high - low) * k / POLE_TURNS
        evaluate_spans(spans, place[0], place[1], span, jet)
        x, y, z = jet[first], jet[first + 1], jet[first + 2]
        slope = inwards * (wx * x + wy * y + wz * z) / (np.sqrt(x * x + y * y + z * z) + 1e-300)
        if slope < least:
            best, least = place[along], slope
    step = (high - low) / POLE_TURNS
    start, end, period = best - step, best + step, spans.period[along]
    if period == 0.0:
        start, end = max(start, low), min(end, high)
    sx, sy, sz = normal[1] * wz - normal[2] * wy, normal[2] * wx - normal[0] * wz, normal[0] * wy - normal[1] * wx
    place[along] = start + period if start < low else start
    evaluate_spans(spans, place[0], place[1], span, jet)
    before = sx * jet[first] + sy * jet[first + 1] + sz * jet[first + 2]
    for _ in range(40):
        half = 0.5 * (start + end)
        place[along] = half + period if half < low else half - period if half > high else half
        evaluate_spans(spans, place[0], place[1], span, jet)
        middle = sx * jet[first] + sy * jet[first + 1] + sz * jet[first + 2]
        if (middle > 0.0) == (before > 0.0):
            start = half
        else:
            end = half
    slope = np.sqrt(jet[first] ** 2 + jet[first + 1] ** 2 + jet[first + 2] ** 2)
    if least > -0.9 * length:  # none of the lines of a part of a surface about the pole goes there
        length = 0.0
    place[1 - along] = pole - inwards * length / max(slope, 1e-300)
    evaluate_spans(spans, place[0], place[1], span, jet)
    return True


@njit_cached
def turn_at_pole(
    spans: SpanPolynomials, side: int, px: float, py: float, pz: float, place: Array, span: IntArray, jet: Array
) -> bool:  # pragma: no cover - compiled
    """Move `place` about the pole to where the distance falls the fastest, with its jet; returns whether it falls at all."""
    along, first = (0, 6) if side % 2 == 0 else (1, 3)
    sign = 1.0 if side == 0 or side == 3 else -1.0
    low, high = spans.box[along, 0], spans.box[along, 1]
    place[1 - along] = spans.box[1 - along, 0] if sign > 0.0 else spans.box[1 - along, 1]
    best, least = low, 0.0
    for k in range(POLE_TURNS + 1):
        place[along] = low + (high - low) * k / POLE_TURNS
        evaluate_spans(spans, place[0], place[1], span, jet)
        x, y, z = jet[first], jet[first + 1], jet[first + 2]
        slope = sign * ((jet[0] - px) * x + (jet[1] - py) * y + (jet[2] - pz) * z)
        slope /= np.sqrt(x * x + y * y + z * z) + 1e-300
        if slope < least:
            best, least = place[along], slope
    place[along] = best
    evaluate_spans(spans, place[0], place[1], span, jet)
    return least < -STEP_TOL * spans.size


@njit_cached
def write_pole_hessian(
    curvature: Array, d: float, normal: Array, hessian: Array
) -> None:  # pragma: no cover - compiled
    """Fill in -K (1 - d K)^-1 (3, 3) for the curvature K of a pole, of rank two, projected on the tangent plane of the foot."""
    trace, norm = 0.0, 0.0
    for r in range(3):
        trace += curvature[r, r]
        for c in range(3):
            norm += curvature[r, c] ** 2
    gauss = 0.5 * (trace * trace - norm)
    # in the tangent plane K (1 - d K)^-1 = (K - d det K) / det(1 - d K), and det K = trace K K - K^2 there
    by = 1.0 - d * trace + d * d * gauss
    for r in range(3):
        for c in range(3):
            product = 0.0
            for k in range(3):
                product += curvature[r, k] * curvature[k, c]
            hessian[r, c] = -(curvature[r, c] - d * (trace * curvature[r, c] - product)) / by
    across = 0.0
    for r in range(3):
        for c in range(3):
            across += normal[r] * hessian[r, c] * normal[c]
    x = hessian[0, 0] * normal[0] + hessian[0, 1] * normal[1] + hessian[0, 2] * normal[2]
    y = hessian[1, 0] * normal[0] + hessian[1, 1] * normal[1] + hessian[1, 2] * normal[2]
    z = hessian[2, 0] * normal[0] + hessian[2, 1] * normal[1] + hessian[2, 2] * normal[2]
    for r in range(3):
        for c in range(3):
            left, right = (x, y, z)[r], (x, y, z)[c]
            hessian[r, c] += across * normal[r] * normal[c] - left * normal[c] - normal[r] * right

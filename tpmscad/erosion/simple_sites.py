"""Straight and circular edges and vertices of a body in arrays, so that points are compared with all of them at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.carriers import Circle, EdgeCurve
from tpmscad.brep.conics import TWO_PI

Span = tuple[float, float]
"""First and last parameter of an edge."""


@dataclass(frozen=True, slots=True, eq=False)
class SimpleSites:
    """Vertices (V, 3), ends (L, 2, 3) of straight edges, and circular edges by frames and spans.

    frames (A, 4, 3): origins, x axes, y axes and normals. radii (A,). spans (A, 2): the middle and half of each arc, in radians.
    """

    vertices: Array
    lines: Array
    frames: Array
    radii: Array
    spans: Array

    @classmethod
    def of(
        cls, vertices: Sequence[Array], lines: Sequence[tuple[EdgeCurve, Span]], arcs: Sequence[tuple[Circle, Span]]
    ) -> SimpleSites:
        """The arrays of vertices, straight edges and circular ones."""
        spans = np.array([span for _, span in arcs]).reshape(-1, 2)
        return cls(
            np.reshape(vertices, (-1, 3)),
            np.reshape([curve(np.array(span)) for curve, span in lines], (-1, 2, 3)),
            np.reshape([(c.origin, c.x_axis, c.y_axis, c.normal) for c, _ in arcs], (-1, 4, 3)),
            np.array([c.radius for c, _ in arcs]),
            np.stack([spans.mean(axis=1), 0.5 * np.ptp(spans, axis=1)], axis=1),
        )

    def are_near(self, points: Array, limit: float) -> BoolArray:
        """Which points (n, 3) are nearer than `limit` to a vertex, or to an edge on which they have a foot: (n,)."""
        low, high, square = points.min(axis=0) - limit, points.max(axis=0) + limit, limit * limit
        vertices = self.vertices[((self.vertices > low) & (self.vertices < high)).all(axis=1)]
        near = np.asarray((_square(points[:, None] - vertices) < square).any(axis=1))

        start, end = self.lines[:, 0], self.lines[:, 1]
        at = ((np.minimum(start, end) < high) & (np.maximum(start, end) > low)).all(axis=1)
        start, step = start[at], end[at] - start[at]
        arm = points[:, None] - start
        t = (arm * step).sum(axis=2) / _square(step)
        near |= ((t >= 0) & (t <= 1) & (_square(arm - t[..., None] * step) < square)).any(axis=1)

        origin, radius = self.frames[:, 0], self.radii[:, None]
        at = ((origin - radius < high) & (origin + radius > low)).all(axis=1)
        arm = points[:, None] - origin[at]
        x, y, height = ((arm * axis).sum(axis=2) for axis in self.frames[at, 1:].swapaxes(0, 1))
        middle, half = self.spans[at].T
        turn = (np.arctan2(y, x) - middle + TWO_PI / 2) % TWO_PI - TWO_PI / 2
        apart = height**2 + (np.hypot(x, y) - self.radii[at]) ** 2
        return near | ((np.abs(turn) <= half) & (apart < square)).any(axis=1)


def _square(vectors: Array) -> Array:
    """Squared lengths (...) of vectors (..., 3)."""
    return np.asarray((vectors * vectors).sum(axis=-1))

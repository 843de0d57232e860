"""The body's faces as regions of their carriers' parameters, and points in them, or in the body."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.carriers import Plane, Quadric
from tpmscad.brep.loops import points_in_polygons
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineCurve
from tpmscad.trimming.operands.implicit_surfaces import CONE, CYLINDER, PLANE, SPHERE
from tpmscad.trimming.operands.trimming_body import TrimmingBody, face_use_range

SEGMENTS_PER_LINE, SEGMENTS_PER_CURVE = 1, 256
"""Segments that stand for a line and for a curve on a face's border: of a circle they are 2e-5 of the radius away, at most."""

UNDECIDED_FRACTION = 1e-3
"""Points this near to a face's border (in parts of the body) do not tell where they are."""

MAX_RAYS = 20
"""Directions tried until a ray from a point meets no border of a face."""


@dataclass(frozen=True, slots=True, eq=False)
class FaceRegion:
    """One face of the body: the segments of its border in (u, v) (n, 2, 2) and in space (n, 2, 3), and the middle of its
    (u, v), by which angles are told from their repetitions."""

    carrier: Plane | Quadric
    segments: Array
    border: Array
    middle: Array

    def parameters(self, points: Array) -> Array:
        """(u, v) of points (..., 3), in the period about the face."""
        return shift_to_period(self.carrier.parameters(points), self.carrier, self.middle)

    def contains(self, points: Array) -> BoolArray:
        """Whether points (n, 3) on the carrier lie in the face, by parity."""
        return points_in_polygons(self.segments[:, 0], self.segments[:, 1], self.parameters(points))

    def distance_to_border(self, points: Array) -> Array:
        """Distances of points (n, 3) from the border: (n,); round-off leaves 1e-7 of the face's size of them."""
        middle = self.border[:, 0].mean(axis=0)
        points, a = points - middle, self.border[:, 0] - middle
        way = self.border[:, 1] - self.border[:, 0]
        length = (way * way).sum(axis=1)
        ahead = points @ way.T - (a * way).sum(axis=1)  # (n, segments), as all that follows
        along = np.clip(ahead / np.maximum(length, 1e-300), 0.0, 1.0)
        square = (a * a).sum(axis=1) - 2.0 * (points @ a.T) - along * (2.0 * ahead - along * length)
        return np.asarray(np.sqrt(np.maximum(square.min(axis=1) + (points * points).sum(axis=1), 0.0)))


def shift_to_period(uv: Array, carrier: Plane | Quadric, middle: Array) -> Array:
    """(u, v) (..., 2) moved by whole periods to within half of one of `middle`."""
    uv = uv.copy()
    for axis, period in enumerate(carrier.period):
        if period:
            uv[..., axis] -= period * np.round((uv[..., axis] - middle[axis]) / period)
    return uv


def build_face_regions(body: TrimmingBody) -> list[FaceRegion]:
    """All faces of the body."""
    brep = body.brep
    result = []
    for f, carrier in enumerate(body.carriers):
        segments, border = [], []
        for k in range(*face_use_range(brep, f)):
            e = brep.uses.edge[k]
            curve, sense = body.curves[e], brep.uses.sense[k]
            plain = isinstance(curve, BSplineCurve) and curve.degree == 1 and isinstance(carrier, Plane)
            low, high = brep.edges.span[e][:: 1 if sense > 0 else -1]
            t = np.linspace(low, high, (SEGMENTS_PER_LINE if plain else SEGMENTS_PER_CURVE) + 1)
            points = curve(t)
            uv = carrier.parameters(points) if isinstance(carrier, Plane) else brep.pcurves[brep.uses.pcurve[k]](t)
            segments.append(uv)
            border.append(points)
        everything = np.concatenate(segments)
        middle = 0.5 * (everything.min(axis=0) + everything.max(axis=0))
        loops = _close_loops(brep.faces.loop_start[f], brep.faces.loop_start[f + 1], brep.faces.use_start, segments)
        result.append(FaceRegion(carrier, loops, np.concatenate([_split_polyline(p) for p in border]), middle))
    return result


def _split_polyline(points: Array) -> Array:
    return np.stack([points[:-1], points[1:]], axis=1)


def _close_loops(first: int, last: int, use_start: IntArray, uses: list[Array]) -> Array:
    """Segments of the uses, and those that close their loops where a use does not begin where the last one ended (a pole)."""
    result = []
    offset = int(use_start[first])
    for loop in range(first, last):
        own = uses[use_start[loop] - offset : use_start[loop + 1] - offset]
        path = np.concatenate([*own, own[0][:1]])
        result.append(_split_polyline(path))
    return np.concatenate(result)


def points_in_body(body: TrimmingBody, faces: list[FaceRegion], points: Array) -> BoolArray:
    """Whether points (n, 3) are in the body: rays against its surfaces, their hits against the faces."""
    rng = np.random.default_rng(7)
    result = np.zeros(len(points), bool)
    for i, point in enumerate(points):
        for _ in range(MAX_RAYS):
            way = rng.normal(size=3)
            count = _count_ray_crossings(body, faces, point, way / np.linalg.norm(way))
            if count is not None:
                result[i] = count % 2 == 1
                break
        else:
            raise TrimmingError(f"whether {point.round(6)} is in the body stays uncertain")
    return result


def _count_ray_crossings(body: TrimmingBody, faces: list[FaceRegion], point: Array, way: Array) -> int | None:
    """How many faces a ray meets; None where it passes a border too near to tell."""
    count = 0
    for f, region in enumerate(faces):
        s = _intersect_line(body, int(body.surface[f]), point, way)
        s = s[s > 0]
        if len(s) == 0:
            continue
        hits = point + s[:, None] * way
        inside = region.contains(hits)
        if (region.distance_to_border(hits) < UNDECIDED_FRACTION * body.size).any():
            return None
        count += int(inside.sum())
    return count


def _intersect_line(body: TrimmingBody, k: int, point: Array, way: Array) -> Array:
    """Parameters where the line point + s way meets surface k."""
    levels = body.levels
    kind, axis, a, b = int(levels.kind[k]), levels.axis[k], float(levels.a[k]), float(levels.b[k])
    if kind == PLANE:
        slope = float(axis @ way)
        return np.array([-(axis @ point + a) / slope]) if slope else np.zeros(0)
    arm = point - levels.point[k]
    if kind in (CYLINDER, CONE):
        c = np.tan(a) if kind == CONE else 0.0
        p, q = arm - (arm @ axis) * axis, way - (way @ axis) * axis
        z, w = float(arm @ axis), float(way @ axis)
        quadratic = [
            q @ q - c**2 * w * w,
            2 * (p @ q - c**2 * z * w),
            p @ p - c**2 * z * z - (0.0 if kind == CONE else a * a),
        ]
    elif kind == SPHERE:
        quadratic = [1.0, 2 * (arm @ way), arm @ arm - a * a]
    else:  # (|x|^2 + a^2 - b^2)^2 = 4 a^2 (|x|^2 - z^2) on the torus
        square = np.array([1.0, 2 * (arm @ way), arm @ arm])
        z, w = float(arm @ axis), float(way @ axis)
        height = np.array([w * w, 2 * z * w, z * z])
        shifted = square + np.array([0.0, 0.0, a * a - b * b])
        left = np.polymul(shifted, shifted)
        quadratic = np.polysub(left, 4 * a * a * (square - height)).tolist()
    found = np.roots(quadratic)
    found = found[np.abs(found.imag) < 1e-9 * np.maximum(1.0, np.abs(found))].real
    points = point + found[:, None] * way
    return np.asarray(found[np.abs(levels.of(np.array([k])).value(points[None])[0]) < 1e-6 * body.size])

"""Vertices and edges of a body whose faces miss each other, so that its planes and quadrics stay and free-form faces give way.

A file rounds its edges, and two surfaces that should meet miss each other by some of its accuracy. Surfaces are *hard* if they
are planes or quadrics, which do not move, and soft if they are free-form, which are corrected (`brep/surface_correction.py`).

- A vertex is the nearest point to the ends of its edges in which the hard surfaces meet, and next to the soft ones.
- An edge is the curve in which its surfaces meet at an angle, if it passes through its vertices; else a smooth curve next to the
  kernel's, pulled onto the hard surface; else the mean of both soft surfaces. Its ends are moved onto the vertices.

What is left between an edge and its surfaces becomes the tolerance of the edge, within an `Allowance`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.carriers import EdgeCurve, Plane
from tpmscad.brep.curve_recognition import recognise_line_or_circle
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.kernel.recognise.edge_curves import (
    UnsupportedFace,
    difference_gradients,
    fit_curve_on_carriers,
    project_to_carriers,
    project_to_tangency,
    smooth_path,
)
from tpmscad.kernel.recognise.face_carriers import EXACT_REL_TOL
from tpmscad.splines.bspline import BSplineCurve

MAX_GAP_REL = 5e-3
"""In body sizes: the greatest gap that is closed. STEP files of solids had gaps of up to 4e-4."""

HARD_SINE = 0.05
"""Sine of the angle between surfaces below which they count as tangent: they fix their common points across only."""

SAME_BEND = 1e-4
"""Relative difference of the second derivatives of distances below which two tangent surfaces are one."""

VERTEX_SINE = 1e-4
"""That sine for the hard surfaces alone, which meet within round-off."""

SMOOTHING = 0.1
"""Of the gap along an edge: how far the smooth curve may be from the kernel's."""

MAX_MOVE_GAPS = 8.0
"""Gaps by which a surface may move between its edges, where nothing but bending holds it, or an edge to where its surfaces meet:
4.1 on a face of a real casting."""

MAX_LEFT_TOLS = 20.0
"""Tolerances by which an edge may miss a hard surface."""


@dataclass(frozen=True, slots=True)
class Allowance:
    """How far edges may miss their faces beyond round-off: a length in model units, and what limits it, in words."""

    length: float = 0.0
    reason: str = "the file states no accuracy that covers it: repair the body in the CAD system that made it"

    def require(self, miss: float, least: float, words: str) -> None:
        """UnsupportedFace, in words, if a distance exceeds the allowance and the length `least`, which is round-off."""
        if not miss <= max(self.length, least):
            raise UnsupportedFace(f"{words}, more than {max(self.length, least):.2g} ({self.reason})")


def close_vertex(
    start: Array, carriers: Sequence[BodyCarrier], seams: Sequence[Plane], size: float, allowance: Allowance
) -> Array:
    """The point next to `start` (3,) on all hard surfaces, and near the soft ones; `seams` are planes that contain seams there.

    It is `start` itself where surfaces that are nearly tangent meet farther away than `MAX_MOVE_GAPS` of the gap between them,
    if that is allowed. Raises UnsupportedFace if the hard surfaces have no common point within MAX_GAP_REL.
    """
    hard = [c for c in carriers if not isinstance(c, FreeFormSurface)]
    point = project_to_carriers([*carriers, *seams], start[None], HARD_SINE)
    if hard:
        point = project_to_carriers([*hard, *seams], point, VERTEX_SINE)
    tangent = _move_to_tangency(hard, point, size)
    point = point if tangent is None else tangent
    moved = float(np.linalg.norm(point[0] - start))
    gap = largest_miss(start[None], carriers)
    if moved > MAX_MOVE_GAPS * gap and EXACT_REL_TOL * size < gap <= allowance.length:
        return start
    if not moved <= MAX_GAP_REL * size:
        raise UnsupportedFace(
            f"shares no point with its neighbouring faces near {start.round(6)}: "
            f"the nearest one is {moved:.2g} away, more than {MAX_GAP_REL * size:.2g}"
        )
    return np.asarray(point[0])


def close_edge(
    points: Array,
    carriers: Sequence[BodyCarrier],
    start: Array,
    end: Array,
    tol: float,
    size: float,
    allowance: Allowance,
) -> tuple[EdgeCurve, tuple[float, float]]:
    """Curve and span of an edge along points (m, 3) of the kernel's curve, from one vertex to the other.

    Raises UnsupportedFace if two hard surfaces miss each other by more than is allowed, or the curve is farther than MAX_GAP_REL
    from a surface.
    """
    gap = max(float(np.abs(c.distance(points)).max()) for c in carriers)
    gap = max(gap, *(float(np.linalg.norm(p - q)) for p, q in ((points[0], start), (points[-1], end))))
    if gap > MAX_GAP_REL * size:
        raise UnsupportedFace(
            f"has an edge that is {gap:.2g} off its surfaces near {points[len(points) // 2].round(6)}, "
            f"more than {MAX_GAP_REL * size:.2g}"
        )
    ends = np.stack([start, end])
    hard = [c for c in carriers if not isinstance(c, FreeFormSurface) or float(np.abs(c.distance(ends)).max()) <= tol]
    if len(hard) == 2 and any(isinstance(c, FreeFormSurface) for c in hard) and _sines(hard, points).min() < HARD_SINE:
        hard = [c for c in hard if not isinstance(c, FreeFormSurface)]
    path = _move_to_tangency(hard, points, size)
    path = project_to_carriers(carriers, points, HARD_SINE) if path is None else path
    path = _join_ends(path, start, end)
    again = _move_to_tangency(hard, path[1:-1], size)
    if again is not None:
        path[1:-1] = again
    if not any(isinstance(c, FreeFormSurface) for c in carriers):
        for within in (tol, 4.0 * gap):  # a line or a circle that the file has rounded
            known = recognise_line_or_circle(path, within)
            if known is not None and largest_miss(known[0](np.linspace(*known[1], len(points))), carriers) <= tol:
                return known
    near = max(SMOOTHING * gap, tol)
    path = smooth_path(path, near)
    quadrics = [c for c in hard if not isinstance(c, FreeFormSurface)]
    try:
        curve = _fit_between(hard, path, tol / 4, near)
    except UnsupportedFace:  # the soft surface is too rough
        hard = quadrics
        try:
            curve = _fit_between(hard, path, tol / 4, near)
        except UnsupportedFace:  # two quadrics are nearly tangent, and miss each other
            if not allowance.length:
                raise
            curve = _fit_between([], path, tol / 4, near)
    left = largest_miss(curve(np.linspace(*curve.domain, 2 * len(points))), hard) if hard else 0.0
    place = points[len(points) // 2].round(6)
    allowance.require(
        left,
        MAX_LEFT_TOLS * tol,
        f"misses a neighbouring face by {left:.2g} along the edge near {place}; planes, cylinders, cones, spheres and tori "
        "are not moved",
    )
    return curve, curve.domain


def _join_ends(path: Array, start: Array, end: Array) -> Array:
    """A path (m, 3) moved so that it begins and ends at two points."""
    share = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1)))
    share = (share / max(share[-1], 1e-300))[:, None]
    return np.asarray(path + (1.0 - share) * (start - path[0]) + share * (end - path[-1]))


def _move_to_tangency(hard: Sequence[BodyCarrier], points: Array, size: float) -> Array | None:
    """Points (m, 3) next to the given ones in which hard surfaces meet, those of a small angle tangentially.

    None if there are no tangent ones, or no such points.
    """
    tangent = [(i, j) for i, j in combinations(range(len(hard)), 2) if are_tangent_quadrics([hard[i], hard[j]], points)]
    if not tangent:
        return None
    found = project_to_tangency(hard, tangent, points)
    near = np.linalg.norm(found - points, axis=1).max() <= MAX_GAP_REL * size
    return found if near and largest_miss(found, hard) <= EXACT_REL_TOL * size else None


def _fit_between(hard: Sequence[BodyCarrier], path: Array, tol: float, near: float) -> BSplineCurve:
    """The curve on the hard surfaces and within `near` of a path (m, 3), through its ends."""
    inner = path.copy()
    if hard:
        inner[1:-1] = project_to_carriers(hard, path[1:-1], HARD_SINE)
    return fit_curve_on_carriers(hard, inner, tol, near)


def are_tangent_quadrics(carriers: Sequence[BodyCarrier], points: Array) -> bool:
    """Whether two different planes or quadrics are tangent along points (m, 3): their edge is a line or a circle."""
    if len(carriers) != 2 or any(isinstance(c, FreeFormSurface) for c in carriers):
        return False
    if _sines(carriers, points).max() > HARD_SINE:
        return False
    first, second = (difference_gradients(c, points) for c in carriers)
    bend = np.maximum(np.linalg.norm(first, axis=(1, 2)), np.linalg.norm(second, axis=(1, 2)))
    return bool((np.linalg.norm(first - second, axis=(1, 2)) > SAME_BEND * bend).any())


def plane_through_seam(carrier: BodyCarrier, point: Array, tangent: Array) -> Plane:
    """The plane of the tangent of a seam and the normal of its surface next to a point (3,) of the kernel's seam."""
    if isinstance(carrier, FreeFormSurface):  # its seam is a line of its parameters
        (uv,) = carrier.parameters(point[None])
        ends = [(low, period) for (low, _), period in zip(carrier.domain, carrier.period, strict=True)]
        off = [abs((x - low) / p - round((x - low) / p)) if p else np.inf for x, (low, p) in zip(uv, ends, strict=True)]
        axis = int(np.argmin(off))
        uv[axis] = ends[axis][0]
        u, v = uv.tolist()
        point, tangent = carrier(u, v), carrier(u, v, int(axis == 1), int(axis == 0))
    normal = np.asarray(carrier.gradient(point[None]))[0]
    across = np.cross(tangent, normal)
    across /= np.linalg.norm(across)
    return Plane(point, normal - (normal @ across) * across, across)


def _sines(carriers: Sequence[BodyCarrier], points: Array) -> Array:
    """Sines (m,) of the angle between two surfaces at points (m, 3)."""
    first, second = (c.gradient(points) for c in carriers)
    return np.asarray(np.linalg.norm(np.cross(first, second), axis=1))


def largest_miss(points: Array, carriers: Sequence[BodyCarrier]) -> float:
    """Largest distance of points (m, 3) from any of the surfaces."""
    return max(float(np.abs(c.distance(points)).max()) for c in carriers)

"""Point membership classification: points inside the trimming body, and points inside the lattice's solid.

A point is in the body if a ray from it crosses the body's faces an odd number of times. The lattice need not be closed, so a
point is in its solid if it lies on the inner side of the nearest patch, at the foot point of its orthogonal projection.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.orthogonal_projection import project_to_surface
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.operands.patch_sides import PatchSides, read_patches
from tpmscad.trimming.operands.quadric_table import CONE, CYLINDER, MIN_DIVISOR_LENGTH, PLANE, SPHERE, QuadricTable
from tpmscad.trimming.operands.trimming_body import TrimmingBody

UNDECIDED_FRACTION = 1e-3
"""A ray that passes a face's border at less than this distance, relative to the body, is discarded."""

MAX_RAYS = 20
"""Rays tried from one point until one passes all borders at a distance."""

RAY_SEED = 7
"""Seed of the ray directions: results are reproducible."""

REAL_ROOT_TOL = 1e-9
"""Largest imaginary part of a root that counts as real, relative to its size or to 1."""

ROOT_DISTANCE_FRACTION = 1e-6
"""Largest distance of a root's point from its surface, relative to the body: it rejects the other nappe of a cone."""

LINE_SAMPLES = 2001
"""Samples of a free-form distance along a ray."""

BISECTIONS = 30
"""Bisections of an interval between samples in which the distance changes its sign."""

LIPSCHITZ_FACTOR = 1.001
"""Largest ratio of |d1| + |d2| to an interval in which a distance changes its sign: 1, and round-off."""

SAMPLES_PER_DIRECTION = 9
"""Samples along u and v of a patch; the nearest one starts the projection."""

MAX_CANDIDATE_PATCHES = 4
"""Patches with the nearest samples that a point is projected onto."""

BORDER_FRACTION = 1e-6
"""Distance in (u, v), relative to the patch, below which a foot point lies on the patch's border."""

MAX_SLANT_SINE = 0.1
"""Sine of the angle to the normal up to which a foot point on an open border still decides."""


def points_in_body(body: TrimmingBody, regions: tuple[FaceRegion, ...], points: Array) -> BoolArray:
    """Points (n, 3) that lie inside the body, by ray casting with the even-odd rule: (n,)."""
    rng = np.random.default_rng(RAY_SEED)
    result = np.zeros(len(points), bool)
    for i, point in enumerate(points):
        for _ in range(MAX_RAYS):
            direction = rng.normal(size=3)
            count = _count_ray_crossings(body, regions, point, direction / np.linalg.norm(direction))
            if count is not None:
                result[i] = count % 2 == 1
                break
        else:
            raise TrimmingError(
                f"the point {point.round(6)} is neither inside nor outside the body: "
                f"{MAX_RAYS} rays from it pass borders of faces"
            )
    return result


def _count_ray_crossings(
    body: TrimmingBody, regions: tuple[FaceRegion, ...], point: Array, direction: Array
) -> int | None:
    """The number of faces that a ray crosses; None if it passes too near a border."""
    count = 0
    for f, region in enumerate(regions):
        s = _intersect_line(body, int(body.surface_of_face[f]), point, direction)
        s = s[s > 0]
        if len(s) == 0:
            continue
        crossings = point + s[:, None] * direction
        inside = region.contains(crossings)
        if (region.distance_to_border(crossings) < UNDECIDED_FRACTION * body.size).any():
            return None
        count += int(inside.sum())
    return count


def _intersect_line(body: TrimmingBody, k: int, point: Array, direction: Array) -> Array:
    """Parameters s at which the line point + s direction meets surface k, as roots of a polynomial."""
    surface = body.surfaces.row(k)
    if surface.is_free_form[0]:
        return _sample_line(surface, point, direction, body.size)
    kind, axis = int(surface.kind[0]), surface.axis[0]
    a, b = float(surface.parameter_a[0]), float(surface.parameter_b[0])
    if kind == PLANE:
        slope = float(axis @ direction)
        return np.array([-(axis @ point + a) / slope]) if slope else np.zeros(0)
    arm = point - surface.point[0]
    if kind in (CYLINDER, CONE):
        c = np.tan(a) if kind == CONE else 0.0
        p, q = arm - (arm @ axis) * axis, direction - (direction @ axis) * axis
        z, w = float(arm @ axis), float(direction @ axis)
        coefficients = [
            q @ q - c**2 * w * w,
            2 * (p @ q - c**2 * z * w),
            p @ p - c**2 * z * z - (0.0 if kind == CONE else a * a),
        ]
    elif kind == SPHERE:
        coefficients = [1.0, 2 * (arm @ direction), arm @ arm - a * a]
    else:  # (|x|^2 + a^2 - b^2)^2 = 4 a^2 (|x|^2 - z^2) on the torus
        square = np.array([1.0, 2 * (arm @ direction), arm @ arm])
        z, w = float(arm @ axis), float(direction @ axis)
        height = np.array([w * w, 2 * z * w, z * z])
        shifted = square + np.array([0.0, 0.0, a * a - b * b])
        left = np.polymul(shifted, shifted)
        coefficients = np.polysub(left, 4 * a * a * (square - height)).tolist()
    found = np.roots(coefficients)
    found = found[np.abs(found.imag) < REAL_ROOT_TOL * np.maximum(1.0, np.abs(found))].real
    points = point + found[:, None] * direction
    return np.asarray(found[np.abs(surface.value(points[None])[0]) < ROOT_DISTANCE_FRACTION * body.size])


def _sample_line(surface: QuadricTable, point: Array, direction: Array, size: float) -> Array:
    """Parameters s > 0, up to two sizes of the body, at which a line crosses a free-form surface (a table of one row).

    Two crossings between samples are missed, with the same parity.
    """
    s = 2.0 * size * np.linspace(0.0, 1.0, LINE_SAMPLES)

    def value(at: Array) -> Array:
        (found,), forced = surface.marked_jet((point + at[:, None] * direction)[None], 0)
        return np.where(forced[0], np.inf, found[0])

    d = value(s)
    near = np.abs(d[1:]) + np.abs(d[:-1]) <= LIPSCHITZ_FACTOR * np.diff(s)
    i = np.flatnonzero(near & ((d[1:] < 0) != (d[:-1] < 0)))
    low, high, rising = s[i], s[i + 1], d[i] < 0
    for _ in range(BISECTIONS):
        middle = 0.5 * (low + high)
        below = (value(middle) < 0) == rising
        low, high = np.where(below, middle, low), np.where(below, high, middle)
    return 0.5 * (low + high)


def points_in_lattice(lattice: Brep, sides: PatchSides, points: Array) -> BoolArray:
    """Points (n, 3) that lie in the lattice's solid; TrimmingError if a foot point lies on the lattice's open border."""
    faces, patches = lattice.faces, read_patches(lattice)
    samples = np.zeros((len(lattice.carriers), SAMPLES_PER_DIRECTION**2, 3))
    for c in np.unique(faces.carrier).tolist():
        patch = patches[c]
        (u0, u1), (v0, v1) = patch.domain
        samples[c] = patch.grid(
            np.linspace(u0, u1, SAMPLES_PER_DIRECTION), np.linspace(v0, v1, SAMPLES_PER_DIRECTION)
        ).reshape(-1, 3)
    middle = samples.mean(axis=1)
    radius = np.linalg.norm(samples - middle[:, None], axis=2).max(axis=1)[faces.carrier]
    centre = faces.motion.apply(middle[faces.carrier])
    open_edge = np.zeros(len(lattice.edges), bool)
    open_edge[connectivity.find_unmatched_edges(lattice)] = True
    result = np.zeros(len(points), bool)
    for i, point in enumerate(points):
        apart = np.linalg.norm(centre - point, axis=1)
        near = np.flatnonzero(apart - radius <= (apart + radius).min())
        local = faces.motion[near].apply_inverse(point)
        distance = np.linalg.norm(samples[faces.carrier[near]] - local[:, None], axis=2)
        nearest = np.argsort(distance.min(axis=1))[:MAX_CANDIDATE_PATCHES]
        found = [
            _project_to_patch(patches[int(faces.carrier[near[j]])], local[j], int(distance[j].argmin()))
            for j in nearest
        ]
        f, (_, uv, side, slant) = min(
            ((int(near[j]), x) for j, x in zip(nearest, found, strict=True)), key=lambda x: x[1][0]
        )
        own = slice(sides.start[f], sides.start[f + 1])
        on_open_side = _sides_at(patches[int(faces.carrier[f])], uv)[sides.side[own]] & open_edge[sides.edge[own]]
        if slant > MAX_SLANT_SINE and on_open_side.any():
            raise TrimmingError(
                f"the lattice's open border is next to {point.round(6)}: pass `inside` to tell solid from void"
            )
        outward = faces.sense[f] * faces.motion[f].handedness
        result[i] = side * outward < 0
    return result


def _sides_at(patch: BSplineSurface, uv: Array) -> BoolArray:
    """The sides (4,) of the patch on which (u, v) lies."""
    (u0, u1), (v0, v1) = patch.domain
    distance = np.array([uv[1] - v0, u1 - uv[0], v1 - uv[1], uv[0] - u0])
    return np.asarray(distance < BORDER_FRACTION * np.array([v1 - v0, u1 - u0] * 2))


def _project_to_patch(patch: BSplineSurface, point: Array, start: int) -> tuple[float, Array, float, float]:
    """Orthogonal projection of a point in the patch's frame, from sample `start`.

    Returns the distance, (u, v) of the foot point, the offset along S_u x S_v and the sine of the angle to the normal.
    """
    low, high = np.array(patch.domain).T
    uv = low + (high - low) * np.array(divmod(start, SAMPLES_PER_DIRECTION)) / (SAMPLES_PER_DIRECTION - 1)
    orders = (0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2)
    u, v = project_to_surface(
        lambda s, t, _: [patch(s, t, *order) for order in orders], point[None], uv[:1], uv[1:], patch.domain
    )
    uv = np.concatenate([u, v])
    gap, normal = point - patch(uv[0], uv[1]), patch.normal(uv[0], uv[1])
    apart = max(float(np.linalg.norm(gap)), MIN_DIVISOR_LENGTH)
    normal = normal / np.linalg.norm(normal)
    slant = float(np.linalg.norm(np.cross(gap, normal))) / apart
    return apart, uv, float(gap @ normal), slant

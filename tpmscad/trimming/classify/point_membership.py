"""Points in the lattice's solid: the nearest point of its patches tells by which side of it they are on."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import TrimmingError
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.implicit_surfaces import MIN_DIVISOR_LENGTH
from tpmscad.trimming.operands.patch_sides import PatchSides

SAMPLES_PER_DIRECTION = 9
"""Points along u and v of a patch from which the nearest point is searched."""

MAX_CANDIDATE_PATCHES = 4
"""Patches from which the search goes on, those with the nearest samples."""

NEWTON_STEPS = 20
"""Newton steps to the nearest point of a patch."""

BORDER_FRACTION = 1e-6
"""A nearest point this near to an open border of the lattice, in (u, v), does not tell."""

MAX_SLANT_SINE = 0.1
"""Unless the point lies straight above it: the sine of the angle to the normal is less than this."""


def points_in_lattice(lattice: Brep, sides: PatchSides, points: Array) -> BoolArray:
    """Whether points (n, 3) are in the lattice's solid; TrimmingError where their nearest point is on an open border."""
    faces = lattice.faces
    used = np.unique(faces.carrier)
    samples = np.zeros((len(lattice.carriers), SAMPLES_PER_DIRECTION**2, 3))
    for c in used:
        patch = lattice.carriers[c]
        assert isinstance(patch, BSplineSurface)
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
        found = [_project_to_patch(lattice, int(near[j]), local[j], int(distance[j].argmin())) for j in nearest]
        f, (_, uv, side, slant) = min(
            ((int(near[j]), x) for j, x in zip(nearest, found, strict=True)), key=lambda x: x[1][0]
        )
        patch = lattice.carriers[faces.carrier[f]]
        assert isinstance(patch, BSplineSurface)
        (u0, u1), (v0, v1) = patch.domain
        at_side = np.array([uv[1] - v0, u1 - uv[0], v1 - uv[1], uv[0] - u0]) < BORDER_FRACTION * np.array(
            [v1 - v0, u1 - u0] * 2
        )
        if slant > MAX_SLANT_SINE and (at_side & open_edge[sides.edge[f]]).any():
            raise TrimmingError(
                f"the lattice's open border is next to {point.round(6)}: pass `inside` to tell solid from void"
            )
        outward = faces.sense[f] * faces.motion[f].handedness
        result[i] = side * outward < 0
    return result


def _project_to_patch(lattice: Brep, face: int, point: Array, start: int) -> tuple[float, Array, float, float]:
    """Of the patch's point next to a point in its frame: distance, (u, v), the side (> 0 along S_u x S_v), and how slanted."""
    patch = lattice.carriers[lattice.faces.carrier[face]]
    assert isinstance(patch, BSplineSurface)
    low, high = np.array(patch.domain).T
    uv = low + (high - low) * np.array(divmod(start, SAMPLES_PER_DIRECTION)) / (SAMPLES_PER_DIRECTION - 1)
    for _ in range(NEWTON_STEPS):
        jet = {d: patch(uv[0], uv[1], *d) for d in ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))}
        gap, first = jet[0, 0] - point, np.stack([jet[1, 0], jet[0, 1]])
        slope, metric = first @ gap, first @ first.T
        uu, uw, ww = (float(gap @ jet[d]) for d in ((2, 0), (1, 1), (0, 2)))
        bend = metric + np.array([[uu, uw], [uw, ww]])
        definite = bend[0, 0] > 0 and np.linalg.det(bend) > 0
        step = np.linalg.solve(bend if definite else metric, slope)
        new = np.clip(uv - step, low, high)
        if np.abs(new - uv).max() < 1e-13:
            break
        uv = new
    gap, normal = point - patch(uv[0], uv[1]), patch.normal(uv[0], uv[1])
    apart = max(float(np.linalg.norm(gap)), MIN_DIVISOR_LENGTH)
    normal = normal / np.linalg.norm(normal)
    slant = float(np.linalg.norm(np.cross(gap, normal))) / apart
    return apart, uv, float(gap @ normal), slant

"""Which patches a face of the body can touch: spheres about patches, and about parts of them, against distances."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.operands.trimming_body import TrimmingBody

PARTS_PER_DIRECTION = 4
"""Parts of a patch along u and v that are looked at singly."""

STEPS_PER_PART = 4
"""Sampled steps along u and v in each part."""

RADIUS_FACTOR = 1.25
"""On the radius of samples: a part of a patch reaches less far beyond them."""

CURVED_DISTANCE_FACTOR = 1.5
"""On distances along a curved face, which are longer than straight ones."""

BORDER_MARGIN_FRACTION = 1e-3
"""Borders are taken to be this much wider, in parts of the body: they are polygons here."""

PAIRS_PER_BATCH = 1_000_000
"""Pairs of a sphere and a segment looked at together."""


def find_candidate_pairs(lattice: Brep, body: TrimmingBody, regions: list[FaceRegion]) -> BoolArray:
    """Patches that a face on surface k may meet: (F, K). A surface that misses a patch may be near it, but not the reverse."""
    faces = lattice.faces
    used = np.unique(faces.carrier)
    centre, radius = (
        np.zeros((len(lattice.carriers), PARTS_PER_DIRECTION**2, 3)),
        np.zeros((len(lattice.carriers), PARTS_PER_DIRECTION**2)),
    )
    for c in used:
        patch = lattice.carriers[c]
        assert isinstance(patch, BSplineSurface)
        centre[c], radius[c] = _bound_patch_parts(patch)
    whole = centre.mean(axis=1)
    reach = (np.linalg.norm(centre - whole[:, None], axis=2) + radius).max(axis=1)[faces.carrier]
    middle = faces.motion.apply(whole[faces.carrier])
    surfaces = body.levels.of(np.arange(body.n_surfaces))
    distance = surfaces.distances(middle)
    near = np.zeros(distance.shape, bool)
    for f, k in enumerate(body.surface):
        low, high = body.face_boxes[f]
        gap = np.maximum(np.maximum(low - middle, middle - high), 0.0)
        close = (np.abs(distance[:, k]) <= reach) & ((gap**2).sum(axis=1) <= reach**2) & ~near[:, k]
        at = np.flatnonzero(close)
        for rows in np.array_split(at, max(1, len(at) * len(regions[f].segments) // PAIRS_PER_BATCH)):
            if len(rows):
                near[rows, k] = _spheres_meet_face(regions[f], middle[rows], reach[rows], distance[rows, k], body.size)
    face, surface = np.nonzero(near)
    own = faces.carrier[face]
    for rows in np.array_split(np.arange(len(face)), max(1, len(face) // 20000)):
        parts = faces.motion[face[rows], None].apply(centre[own[rows]])
        value = surfaces.of(surface[rows]).value(parts)
        near[face[rows], surface[rows]] = (np.abs(value) <= radius[own[rows]]).any(axis=1)
    return near


def _spheres_meet_face(region: FaceRegion, middle: Array, reach: Array, distance: Array, size: float) -> BoolArray:
    """Whether the face may meet spheres: their feet are in it, or nearer to its border than the spheres reach."""
    carrier = region.carrier
    u, v = carrier.parameters(middle).T
    feet = carrier(u, v)
    if not isinstance(carrier, Plane):
        reach = CURVED_DISTANCE_FACTOR * (reach + np.abs(distance))
    return region.contains(feet) | (region.distance_to_border(feet) <= reach + BORDER_MARGIN_FRACTION * size)


def _bound_patch_parts(patch: BSplineSurface) -> tuple[Array, Array]:
    """Centres (PARTS^2, 3) and radii of spheres about the parts of a patch."""
    steps = PARTS_PER_DIRECTION * STEPS_PER_PART
    (u0, u1), (v0, v1) = patch.domain
    points = patch.grid(np.linspace(u0, u1, steps + 1), np.linspace(v0, v1, steps + 1))
    parts = np.stack(
        [
            points[i : i + STEPS_PER_PART + 1, j : j + STEPS_PER_PART + 1].reshape(-1, 3)
            for i in range(0, steps, STEPS_PER_PART)
            for j in range(0, steps, STEPS_PER_PART)
        ]
    )
    centre = 0.5 * (parts.min(axis=1) + parts.max(axis=1))
    return centre, RADIUS_FACTOR * np.linalg.norm(parts - centre[:, None], axis=2).max(axis=1)

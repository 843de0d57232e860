"""Broad phase: a conservative test for the patches that a face of the body can intersect, by bounding spheres.

A patch is first tested as a whole: its bounding sphere against the face's box, surface and trimming loops. The remaining patches
are divided into parts, whose spheres are tested against the surface only.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.operands.trimming_body import TrimmingBody

PARTS_PER_DIRECTION = 4
"""Parts of a patch along u and along v."""

STEPS_PER_PART = 4
"""Sampled steps of each part along u and along v."""

RADIUS_FACTOR = 1.25
"""Factor on the radius of the samples: a part extends beyond them by less."""

CURVED_DISTANCE_FACTOR = 1.5
"""Factor on distances along a curved face, which exceed straight distances."""

BORDER_MARGIN_FRACTION = 1e-3
"""Margin about trimming loops, relative to the body: the loops are polygons here."""

PAIRS_PER_BATCH = 1_000_000
"""Pairs of a sphere and a polygon segment tested in one batch."""

PATCHES_PER_BATCH = 20_000
"""Pairs of a patch and a surface whose parts are tested in one batch."""


def find_candidate_pairs(
    lattice: Brep, patches: Mapping[int, BSplineSurface], body: TrimmingBody, regions: Sequence[FaceRegion]
) -> BoolArray:
    """The pairs of patch and surface that may intersect within a face: (F, K). False positives occur, false negatives do not."""
    faces = lattice.faces
    centre = np.zeros((len(lattice.carriers), PARTS_PER_DIRECTION**2, 3))
    radius = np.zeros((len(lattice.carriers), PARTS_PER_DIRECTION**2))
    for c in np.unique(faces.carrier).tolist():
        centre[c], radius[c] = _bound_patch_parts(patches[c])
    whole = centre.mean(axis=1)
    reach = (np.linalg.norm(centre - whole[:, None], axis=2) + radius).max(axis=1)[faces.carrier]
    middle = faces.motion.apply(whole[faces.carrier])
    surfaces = body.surfaces.take(np.arange(body.n_surfaces))
    distance = surfaces.distances(middle, reach)
    near = np.zeros(distance.shape, bool)
    for f, k in enumerate(body.surface_of_face):
        low, high = body.face_boxes[f]
        gap = np.maximum(np.maximum(low - middle, middle - high), 0.0)
        close = (np.abs(distance[:, k]) <= reach) & ((gap**2).sum(axis=1) <= reach**2) & ~near[:, k]
        at = np.flatnonzero(close)
        for rows in np.array_split(at, max(1, len(at) * len(regions[f].segments) // PAIRS_PER_BATCH)):
            if len(rows):
                near[rows, k] = _spheres_meet_face(regions[f], middle[rows], reach[rows], distance[rows, k], body.size)
    face, surface = np.nonzero(near)
    own = faces.carrier[face]
    for rows in np.array_split(np.arange(len(face)), max(1, len(face) // PATCHES_PER_BATCH)):
        parts = faces.motion[face[rows], None].apply(centre[own[rows]])
        value = surfaces.take(surface[rows]).value(parts)
        near[face[rows], surface[rows]] = (np.abs(value) <= radius[own[rows]]).any(axis=1)
    return near


def _spheres_meet_face(region: FaceRegion, middle: Array, reach: Array, distance: Array, size: float) -> BoolArray:
    """Spheres that may meet the face: the foot point of the centre is in the face, or nearer to its border than the radius."""
    carrier = region.carrier
    u, v = carrier.parameters(middle).T
    feet = carrier(u, v)
    if not isinstance(carrier, Plane):
        reach = CURVED_DISTANCE_FACTOR * (reach + np.abs(distance))
    return region.contains(feet) | (region.distance_to_border(feet) <= reach + BORDER_MARGIN_FRACTION * size)


def _bound_patch_parts(patch: BSplineSurface) -> tuple[Array, Array]:
    """Centres (PARTS_PER_DIRECTION^2, 3) and radii of bounding spheres of the parts of a patch."""
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

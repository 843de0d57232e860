"""Which patches a face of the body can touch: spheres about patches, and about parts of them, against distances."""

from __future__ import annotations

import numpy as np

from tpmscad.patches.carriers import Plane
from tpmscad.patches.complex import PatchComplex
from tpmscad.splines.bspline import Surface
from tpmscad.trimming.body import Body
from tpmscad.trimming.regions import Region
from tpmscad.trimming.tool import Array, Flags

PARTS = 4
"""Parts of a patch along u and v that are looked at singly."""

POINTS = 4
"""Sampled steps along u and v in each part."""

BULGE = 1.25
"""On the radius of samples: a part of a patch reaches less far beyond them."""

ROUND = 1.5
"""On distances along a curved face, which are longer than straight ones."""

LEEWAY = 1e-3
"""Borders are taken to be this much wider, in parts of the body: they are polygons here."""

BATCH = 1_000_000
"""Pairs of a sphere and a segment looked at together."""


def near_patches(lattice: PatchComplex, body: Body, regions: list[Region]) -> Flags:
    """Patches that a face on surface k may meet: (F, K). A surface that misses a patch may be near it, but not the reverse."""
    faces = lattice.faces
    used = np.unique(faces.carrier)
    centre, radius = np.zeros((len(lattice.carriers), PARTS**2, 3)), np.zeros((len(lattice.carriers), PARTS**2))
    for c in used:
        patch = lattice.carriers[c]
        assert isinstance(patch, Surface)
        centre[c], radius[c] = _spheres(patch)
    whole = centre.mean(axis=1)
    reach = (np.linalg.norm(centre - whole[:, None], axis=2) + radius).max(axis=1)[faces.carrier]
    middle = np.einsum("fij,fj->fi", faces.rotation, whole[faces.carrier]) + faces.translation
    surfaces = body.levels.of(np.arange(body.n_surfaces))
    distance = surfaces.distances(middle)
    near = np.zeros(distance.shape, bool)
    for f, k in enumerate(body.surface):
        low, high = body.boxes[f]
        gap = np.maximum(np.maximum(low - middle, middle - high), 0.0)
        close = (np.abs(distance[:, k]) <= reach) & ((gap**2).sum(axis=1) <= reach**2) & ~near[:, k]
        at = np.flatnonzero(close)
        for rows in np.array_split(at, max(1, len(at) * len(regions[f].segments) // BATCH)):
            if len(rows):
                near[rows, k] = _touched(regions[f], middle[rows], reach[rows], distance[rows, k], body.size)
    face, surface = np.nonzero(near)
    own = faces.carrier[face]
    for rows in np.array_split(np.arange(len(face)), max(1, len(face) // 20000)):
        parts = np.einsum("pij,psj->psi", faces.rotation[face[rows]], centre[own[rows]])
        value = surfaces.of(surface[rows]).value(parts + faces.translation[face[rows]][:, None])
        near[face[rows], surface[rows]] = (np.abs(value) <= radius[own[rows]]).any(axis=1)
    return near


def _touched(region: Region, middle: Array, reach: Array, distance: Array, size: float) -> Flags:
    """Whether the face may meet spheres: their feet are in it, or nearer to its border than the spheres reach."""
    carrier = region.carrier
    u, v = carrier.parameters(middle).T
    feet = carrier(u, v)
    if not isinstance(carrier, Plane):
        reach = ROUND * (reach + np.abs(distance))
    return region.contains(feet) | (region.to_border(feet) <= reach + LEEWAY * size)


def _spheres(patch: Surface) -> tuple[Array, Array]:
    """Centres (PARTS^2, 3) and radii of spheres about the parts of a patch."""
    steps = PARTS * POINTS
    (u0, u1), (v0, v1) = patch.domain
    points = patch.grid(np.linspace(u0, u1, steps + 1), np.linspace(v0, v1, steps + 1))
    parts = np.stack(
        [
            points[i : i + POINTS + 1, j : j + POINTS + 1].reshape(-1, 3)
            for i in range(0, steps, POINTS)
            for j in range(0, steps, POINTS)
        ]
    )
    centre = 0.5 * (parts.min(axis=1) + parts.max(axis=1))
    return centre, BULGE * np.linalg.norm(parts - centre[:, None], axis=2).max(axis=1)

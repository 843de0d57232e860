"""Where an octree is too coarse for a level set: hidden crossings, and normals that turn too far within a leaf."""

from __future__ import annotations

import numpy as np

from tpmscad.fields.field import Field
from tpmscad.patches.levelset.layout.octree import Array, Mask, Octree

PROBES = 5
"""Samples along each edge of a leaf, corners included."""

CHUNK = 1 << 12


def too_coarse(tree: Octree, field: Field, cosine: float | None) -> Mask:
    """Leaves (N,) with an edge that the surface crosses twice, a part of it between equal corners, or (unless None) normals near
    the surface further than arc cos `cosine` from their mean."""
    t = np.linspace(0.0, 1.0, PROBES)
    unit = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    result = np.zeros(len(tree.size), bool)
    for start in range(0, len(tree.size), CHUNK):
        part = slice(start, start + CHUNK)
        points = tree.points(tree.origin[part][:, None] + tree.size[part][:, None, None] * unit)
        values = field(points)
        grid = values.reshape(-1, PROBES, PROBES, PROBES)
        solid = grid <= 0
        flagged = _hidden(solid)
        if cosine is not None:
            busy = np.flatnonzero(solid.any(axis=(1, 2, 3)) & ~solid.all(axis=(1, 2, 3)))
            flagged[busy] |= _turning(
                field, points[busy], values[busy], tree.size[part][busy] * tree.step.max(), cosine
            )
        result[part] = flagged
    return result


def _hidden(solid: Mask) -> Mask:
    corners = solid[:, :: PROBES - 1, :: PROBES - 1, :: PROBES - 1].reshape(len(solid), -1)
    same = corners.all(axis=1) | ~corners.any(axis=1)
    flagged = same & (solid.any(axis=(1, 2, 3)) & ~solid.all(axis=(1, 2, 3)))
    for axis in (1, 2, 3):
        lines = np.moveaxis(solid, axis, 3)[:, :: PROBES - 1, :: PROBES - 1]
        flagged |= ((lines[..., 1:] != lines[..., :-1]).sum(axis=-1) > 1).any(axis=(1, 2))
    return np.asarray(flagged, bool)


def _turning(field: Field, points: Array, values: Array, size: Array, cosine: float) -> Mask:
    """Whether the normals of samples within half a probe's spacing of the surface leave the cone about their mean."""
    slope = field.gradient(points)
    steep = np.linalg.norm(slope, axis=-1)
    near = np.abs(values) <= 0.5 * steep * (size / (PROBES - 1))[:, None] * np.sqrt(3.0)
    normal = slope / np.maximum(steep, 1e-300)[..., None]
    mean = np.where(near[..., None], normal, 0.0).sum(axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
    turned = np.einsum("nki,ni->nk", normal, mean)
    return np.asarray((near & (turned < cosine)).any(axis=1))

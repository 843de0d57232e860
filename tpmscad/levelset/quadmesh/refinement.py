"""Where an octree is too coarse for a level set: hidden crossings, and normals that turn too far within a leaf."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.octree import Octree

SAMPLES_PER_LEAF_EDGE = 5
"""Samples along each edge of a leaf, corners included."""

LEAVES_PER_BATCH = 1 << 12


def find_coarse_leaves(tree: Octree, field: Field, cosine: float | None) -> BoolArray:
    """Leaves (N,) with an edge that the surface crosses twice, a part of it between equal corners, or (unless None) normals near
    the surface further than arc cos `cosine` from their mean."""
    t = np.linspace(0.0, 1.0, SAMPLES_PER_LEAF_EDGE)
    unit = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    result = np.zeros(len(tree.size), bool)
    for start in range(0, len(tree.size), LEAVES_PER_BATCH):
        part = slice(start, start + LEAVES_PER_BATCH)
        points = tree.points(tree.origin[part][:, None] + tree.size[part][:, None, None] * unit)
        values = field(points)
        grid = values.reshape(-1, SAMPLES_PER_LEAF_EDGE, SAMPLES_PER_LEAF_EDGE, SAMPLES_PER_LEAF_EDGE)
        solid = grid <= 0
        flagged = _has_hidden_crossing(solid)
        if cosine is not None:
            busy = np.flatnonzero(solid.any(axis=(1, 2, 3)) & ~solid.all(axis=(1, 2, 3)))
            flagged[busy] |= _exceeds_normal_cone(
                field, points[busy], values[busy], tree.size[part][busy] * tree.step.max(), cosine
            )
        result[part] = flagged
    return result


def _has_hidden_crossing(solid: BoolArray) -> BoolArray:
    corners = solid[
        :, :: SAMPLES_PER_LEAF_EDGE - 1, :: SAMPLES_PER_LEAF_EDGE - 1, :: SAMPLES_PER_LEAF_EDGE - 1
    ].reshape(len(solid), -1)
    same = corners.all(axis=1) | ~corners.any(axis=1)
    flagged = same & (solid.any(axis=(1, 2, 3)) & ~solid.all(axis=(1, 2, 3)))
    for axis in (1, 2, 3):
        lines = np.moveaxis(solid, axis, 3)[:, :: SAMPLES_PER_LEAF_EDGE - 1, :: SAMPLES_PER_LEAF_EDGE - 1]
        flagged |= ((lines[..., 1:] != lines[..., :-1]).sum(axis=-1) > 1).any(axis=(1, 2))
    return np.asarray(flagged, bool)


def _exceeds_normal_cone(field: Field, points: Array, values: Array, size: Array, cosine: float) -> BoolArray:
    """Whether the normals of samples within half a probe's spacing of the surface leave the cone about their mean."""
    slope = field.gradient(points)
    steep = np.linalg.norm(slope, axis=-1)
    near = np.abs(values) <= 0.5 * steep * (size / (SAMPLES_PER_LEAF_EDGE - 1))[:, None] * np.sqrt(3.0)
    normal = slope / np.maximum(steep, 1e-300)[..., None]
    mean = np.where(near[..., None], normal, 0.0).sum(axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1), 1e-300)[:, None]
    turned = np.einsum("nki,ni->nk", normal, mean)
    return np.asarray((near & (turned < cosine)).any(axis=1))

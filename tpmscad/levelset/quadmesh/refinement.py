"""Refinement criteria of an octree before meshing: crossings hidden from the leaf corners, and normal cones.

The field is sampled on a regular grid in each leaf. A leaf is too coarse if the dual mesh would miss part of the level set in it,
or if the normals near the level set leave a given cone.
"""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array, BoolArray
from tpmscad.fields.field import Field
from tpmscad.levelset.quadmesh.octree import Octree
from tpmscad.levelset.quadmesh.octree_faces import ROUND_OFF_FRACTION
from tpmscad.levelset.quadmesh.vectors import MIN_DIVISOR

SAMPLES_PER_LEAF_EDGE = 5
"""Samples along each edge of a leaf, corners included."""

LEAVES_PER_BATCH = 1 << 12
"""Leaves whose samples are evaluated at once: a few megabytes."""


def find_coarse_leaves(tree: Octree, field: Field, cosine: float | None) -> BoolArray:
    """Mask (N,) of leaves that hide a crossing, or whose normals leave the cone of half-angle arccos `cosine` (None: any)."""
    t = np.linspace(0.0, 1.0, SAMPLES_PER_LEAF_EDGE)
    unit = np.stack(np.meshgrid(t, t, t, indexing="ij"), axis=-1).reshape(-1, 3)
    result = np.zeros(len(tree.size), bool)
    for start in range(0, len(tree.size), LEAVES_PER_BATCH):
        batch = slice(start, start + LEAVES_PER_BATCH)
        points = tree.points(tree.origin[batch][:, None] + tree.size[batch][:, None, None] * unit)
        values = field(points)
        solid = values <= ROUND_OFF_FRACTION * np.abs(values).max(axis=1, keepdims=True)
        solid = solid.reshape(-1, SAMPLES_PER_LEAF_EDGE, SAMPLES_PER_LEAF_EDGE, SAMPLES_PER_LEAF_EDGE)
        flagged = _has_hidden_crossing(solid)
        if cosine is not None:
            mixed = np.flatnonzero(_is_mixed(solid))
            edges = tree.size[batch][mixed] * tree.cell_edges.max()
            flagged[mixed] |= _exceeds_normal_cone(field, points[mixed], values[mixed], edges, cosine)
        result[batch] = flagged
    return result


def _is_mixed(solid: BoolArray) -> BoolArray:
    """Whether samples (n, k, k, k) contain both solid and void."""
    return np.asarray(solid.any(axis=(1, 2, 3)) & ~solid.all(axis=(1, 2, 3)))


def _has_hidden_crossing(solid: BoolArray) -> BoolArray:
    """Whether an edge of each leaf is crossed more than once, or both phases occur between corners of one phase."""
    last = SAMPLES_PER_LEAF_EDGE - 1
    corners = solid[:, ::last, ::last, ::last].reshape(len(solid), -1)
    uniform = corners.all(axis=1) | ~corners.any(axis=1)
    flagged = uniform & _is_mixed(solid)
    for axis in (1, 2, 3):
        lines = np.moveaxis(solid, axis, 3)[:, ::last, ::last]
        flagged |= ((lines[..., 1:] != lines[..., :-1]).sum(axis=-1) > 1).any(axis=(1, 2))
    return np.asarray(flagged, bool)


def _exceeds_normal_cone(field: Field, points: Array, values: Array, size: Array, cosine: float) -> BoolArray:
    """Whether normals at samples (n, k, 3) near the level set make a larger angle with their mean than arccos `cosine`.

    A sample is near if the level set is closer, to first order, than half the diagonal of the sampling grid's cell.
    """
    gradient = field.gradient(points)
    gradient_norm = np.linalg.norm(gradient, axis=-1)
    near = np.abs(values) <= 0.5 * gradient_norm * (size / (SAMPLES_PER_LEAF_EDGE - 1))[:, None] * np.sqrt(3.0)
    normal = gradient / np.maximum(gradient_norm, MIN_DIVISOR)[..., None]
    mean = np.where(near[..., None], normal, 0.0).sum(axis=1)
    mean /= np.maximum(np.linalg.norm(mean, axis=1), MIN_DIVISOR)[:, None]
    return np.asarray((near & (np.einsum("nki,ni->nk", normal, mean) < cosine)).any(axis=1))

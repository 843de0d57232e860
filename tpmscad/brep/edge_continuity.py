"""How smoothly faces join: gap, tangent jump and curvature jump across every edge between B-spline faces, measured.

Both faces are evaluated along the edge, ends included, so that extraordinary vertices are among the samples. Curvature is
compared as the symmetric 3 x 3 tensor K = A I^-1 II I^-1 A^T (A the tangents, I and II the fundamental forms), which does not
depend on either parametrisation. Edges that are copies of one another by a rigid motion are measured once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

SAMPLES_PER_EDGE = 33
"""Samples along an edge, ends included."""

MOTION_DIGITS = 6
"""Relative motions that agree to this many decimals (rotations; translations in edge lengths) are the same joint."""


@dataclass(frozen=True, slots=True)
class EdgeContinuity:
    """The worst over all joints: gap (model units), tangent jump (degrees), curvature jump over the greatest curvature."""

    gap: float
    tangent_jump_deg: float
    curvature_jump: float
    n_classes: int


def measure_edge_continuity(brep: Brep, tags: tuple[str, ...]) -> EdgeContinuity:
    """Measure every edge both of whose faces are B-splines with one of these tags (zeros where there is none)."""
    first, second = _smooth_edge_use_pairs(brep, tags)
    gap = turn = bend = steepest = 0.0
    chosen = _congruence_representatives(brep, first, second)
    for a, b in zip(first[chosen], second[chosen], strict=True):
        (x, n, k), (y, m, q) = (_evaluate_along_use(brep, int(use)) for use in (a, b))
        gap = max(gap, float(np.linalg.norm(x - y, axis=1).max()))
        sine = np.linalg.norm(np.cross(n, m), axis=1)
        turn = max(turn, float(np.arctan2(sine, np.einsum("ni,ni->n", n, m)).max()))
        bend = max(bend, float(np.linalg.norm(k - q, ord=2, axis=(1, 2)).max()))
        steepest = max(steepest, float(np.linalg.norm(k, ord=2, axis=(1, 2)).max()))
    return EdgeContinuity(gap, float(np.degrees(turn)), bend / steepest if steepest else 0.0, len(chosen))


def _smooth_edge_use_pairs(brep: Brep, tags: tuple[str, ...]) -> tuple[IntArray, IntArray]:
    """The two uses of every edge that joins two B-spline faces with these tags."""
    face = brep.face_of_use
    smooth = np.array([isinstance(c, BSplineSurface) for c in brep.carriers])[brep.faces.carrier]
    wanted = smooth & np.isin(brep.faces.tag, [brep.tags.index(t) for t in tags if t in brep.tags])
    uses = np.flatnonzero(wanted[face])
    uses = uses[np.argsort(brep.uses.edge[uses], kind="stable")]
    edge = brep.uses.edge[uses]
    at = np.flatnonzero(edge[:-1] == edge[1:])
    return uses[at], uses[at + 1]


def _congruence_representatives(brep: Brep, first: IntArray, second: IntArray) -> IntArray:
    """Indices of one pair of uses for each class of joints that rigid motions carry onto one another."""
    if len(first) == 0:
        return np.zeros(0, np.int64)
    faces, face = brep.faces, brep.face_of_use
    f, g = face[first], face[second]
    relative = faces.motion[g].relative_to(faces.motion[f])
    spans = brep.vertices[brep.edges.end] - brep.vertices[brep.edges.start]
    scale = np.linalg.norm(spans, axis=1).max()
    key = np.column_stack(
        [
            np.stack([faces.carrier[f], faces.carrier[g], faces.sense[f], faces.sense[g]], axis=1),
            np.stack([brep.uses.pcurve[first], brep.uses.pcurve[second]], axis=1),
            np.round(relative.rotation.reshape(-1, 9), MOTION_DIGITS),
            np.round(relative.translation / scale, MOTION_DIGITS),
        ]
    )
    _, chosen = np.unique(key + 0.0, axis=0, return_index=True)
    return np.sort(chosen)


def _evaluate_along_use(brep: Brep, use: int) -> tuple[Array, Array, Array]:
    """Points (n, 3), outward unit normals (n, 3) and curvature tensors (n, 3, 3) of a use's face along its whole curve."""
    faces = brep.faces
    face = brep.face_of_use[use]
    surface = brep.carriers[faces.carrier[face]]
    pcurve: BSplineCurve = brep.pcurves[brep.uses.pcurve[use]]
    assert isinstance(surface, BSplineSurface)
    u, v = pcurve(np.linspace(*pcurve.domain, SAMPLES_PER_EDGE)).T
    return evaluate_curvature(surface.moved(faces.motion[face]), u, v, int(faces.sense[face]))


def evaluate_curvature(surface: BSplineSurface, u: Array, v: Array, sense: int = 1) -> tuple[Array, Array, Array]:
    """Points (n, 3), unit normals sense * S_u x S_v (n, 3) and curvature tensors (n, 3, 3) at the pairs (u, v) (n,)."""
    tangents = np.stack([surface(u, v, 1, 0), surface(u, v, 0, 1)], axis=-1)
    normal = sense * np.cross(tangents[..., 0], tangents[..., 1])
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    uv = np.einsum("ni,ni->n", surface(u, v, 1, 1), normal)
    second = np.stack(
        [
            np.einsum("ni,ni->n", surface(u, v, 2, 0), normal),
            uv,
            uv,
            np.einsum("ni,ni->n", surface(u, v, 0, 2), normal),
        ],
        axis=-1,
    ).reshape(-1, 2, 2)
    dual = tangents @ np.linalg.inv(np.swapaxes(tangents, 1, 2) @ tangents)
    return surface(u, v), normal, dual @ second @ np.swapaxes(dual, 1, 2)

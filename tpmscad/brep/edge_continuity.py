"""Continuity across the edges between B-spline faces, measured: gap (G0), tangent jump (G1) and curvature jump (G2).

Both faces are evaluated along the edge, ends included, so that extraordinary vertices are among the samples. Curvature is
compared as the symmetric 3 x 3 tensor K = A I^-1 II I^-1 A^T (A: tangents, I and II: fundamental forms), which does not depend on
the parametrisations. Of edges that are congruent, adjacent faces included, one is measured, on whole
patches.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.restricted_surfaces import whole_surfaces
from tpmscad.splines.basis import design_matrices
from tpmscad.splines.bspline import BSplineSurface

SAMPLES_PER_EDGE = 33
"""Samples along an edge, ends included."""

EDGES_AT_ONCE = 300
"""Edges whose faces are evaluated together: tens of megabytes."""

ORDERS = ((0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2))
"""Orders of the derivatives of a surface that its curvature takes."""

MOTION_DIGITS = 6
"""Decimals to which the relative motions of two faces must agree (translations in edge lengths) for edges to be congruent."""


@dataclass(frozen=True, slots=True)
class EdgeContinuity:
    """Largest gap (model units), tangent jump (degrees), curvature jump relative to the largest curvature; congruence classes."""

    gap: float
    tangent_jump_deg: float
    curvature_jump: float
    n_classes: int


def measure_edge_continuity(brep: Brep, tags: tuple[str, ...]) -> EdgeContinuity:
    """Measure every edge between two B-spline faces with one of the tags; all values are 0 if there is none."""
    first, second = _smooth_edge_use_pairs(brep, tags)
    wholes, number = whole_surfaces(brep)
    brep = replace(
        brep,
        carriers=tuple(wholes.get(i, c) for i, c in enumerate(brep.carriers)),
        faces=replace(brep.faces, carrier=number[brep.faces.carrier]),
    )
    chosen = _congruence_representatives(brep, first, second)
    worst = np.zeros(4)
    for start in range(0, len(chosen), EDGES_AT_ONCE):
        some = chosen[start : start + EDGES_AT_ONCE]
        worst = np.maximum(worst, compare_sides(*(_evaluate_along_uses(brep, uses[some]) for uses in (first, second))))
    return summarise_jumps(worst, len(chosen))


Side = tuple[Array, Array, Array]
"""Points (..., 3), unit normals (..., 3) and curvature tensors (..., 3, 3) of a face along an edge."""


def compare_sides(first: Side, second: Side) -> Array:
    """Greatest gap, angle between normals in radians, difference of curvature tensors, and curvature of the first side: (4,)."""
    (x_a, n_a, k_a), (x_b, n_b, k_b) = first, second
    sine = np.linalg.norm(np.cross(n_a, n_b), axis=-1)
    return np.array(
        [
            np.linalg.norm(x_a - x_b, axis=-1).max(),
            np.arctan2(sine, np.einsum("...i,...i->...", n_a, n_b)).max(),
            np.linalg.norm(k_a - k_b, ord=2, axis=(-2, -1)).max(),
            np.linalg.norm(k_a, ord=2, axis=(-2, -1)).max(),
        ]
    )


def summarise_jumps(worst: Array, n_classes: int) -> EdgeContinuity:
    """The continuity whose greatest values are those of `compare_sides` (4,)."""
    gap, angle, bend, curvature = worst.tolist()
    return EdgeContinuity(gap, float(np.degrees(angle)), bend / curvature if curvature else 0.0, n_classes)


def _smooth_edge_use_pairs(brep: Brep, tags: tuple[str, ...]) -> tuple[IntArray, IntArray]:
    """The two uses of every edge between two B-spline faces with one of the tags: (n,), (n,)."""
    face = brep.face_of_use
    smooth = np.array([isinstance(c, BSplineSurface) for c in brep.carriers])[brep.faces.carrier]
    wanted = smooth & np.isin(brep.faces.tag, [i for i, own in enumerate(brep.tags) if own in tags])
    uses = np.flatnonzero(wanted[face])
    uses = uses[np.argsort(brep.uses.edge[uses], kind="stable")]
    edge = brep.uses.edge[uses]
    at = np.flatnonzero(edge[:-1] == edge[1:])
    return uses[at], uses[at + 1]


def _congruence_representatives(brep: Brep, first: IntArray, second: IntArray) -> IntArray:
    """Indices of one pair of uses per congruence class of edges, in ascending order."""
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


def _evaluate_along_uses(brep: Brep, uses: IntArray) -> Side:
    """Points (n, m, 3), outward unit normals and curvature tensors of the faces of n uses at m places along their pcurves.

    Uses with one pcurve, on surfaces of one spline space, share the basis functions.
    """
    faces, face = brep.faces, brep.face_of_use[uses]
    derivatives = np.empty((len(ORDERS), len(uses), SAMPLES_PER_EDGE, 3))
    groups: dict[tuple[Any, ...], list[int]] = {}
    for i, (carrier, pcurve) in enumerate(
        zip(faces.carrier[face].tolist(), brep.uses.pcurve[uses].tolist(), strict=True)
    ):
        surface, curve = brep.carriers[carrier], brep.pcurves[pcurve]
        assert isinstance(surface, BSplineSurface)
        groups.setdefault((*surface.space, curve.degree, curve.knots.tobytes(), curve.poles.tobytes()), []).append(i)
    for rows in groups.values():
        surfaces = [brep.carriers[i] for i in faces.carrier[face[rows]].tolist()]
        surface, curve = surfaces[0], brep.pcurves[int(brep.uses.pcurve[uses[rows[0]]])]
        assert isinstance(surface, BSplineSurface)
        u, v = curve(np.linspace(*curve.domain, SAMPLES_PER_EDGE)).T
        along_u = design_matrices(surface.knots_u, surface.degree_u, u, (0, 1, 2))
        along_v = design_matrices(surface.knots_v, surface.degree_v, v, (0, 1, 2))
        nets = np.stack([own.poles for own in surfaces if isinstance(own, BSplineSurface)])
        flat = nets.swapaxes(0, 1).reshape(nets.shape[1], -1)
        halves = [(basis @ flat).reshape(len(u), len(rows), nets.shape[2], 3) for basis in along_u]
        for k, (du, dv) in enumerate(ORDERS):
            derivatives[k, rows] = np.einsum("mnvd,mv->nmd", halves[du], along_v[dv], optimize=True)
    motion = faces.motion[face]
    turned = np.einsum("nij,knmj->knmi", motion.rotation, derivatives)
    normals, tensors = curvature_tensors(*turned[1:])
    sense = faces.sense[face][:, None]
    return turned[0] + motion.translation[:, None], sense[..., None] * normals, sense[..., None, None] * tensors


def evaluate_curvature(surface: BSplineSurface, u: Array, v: Array, sense: int = 1) -> tuple[Array, Array, Array]:
    """Points (n, 3), unit normals sense * S_u x S_v (n, 3) and curvature tensors (n, 3, 3) at the pairs (u, v) (n,)."""
    normals, tensors = curvature_tensors(
        surface(u, v, 1, 0), surface(u, v, 0, 1), surface(u, v, 2, 0), surface(u, v, 1, 1), surface(u, v, 0, 2), sense
    )
    return surface(u, v), normals, tensors


def curvature_tensors(du: Array, dv: Array, duu: Array, duv: Array, dvv: Array, sense: int = 1) -> tuple[Array, Array]:
    """Unit normals sense * S_u x S_v (..., 3) and curvature tensors (..., 3, 3) from derivatives (..., 3)."""
    tangents = np.stack([du, dv], axis=-1)
    normal = sense * np.cross(du, dv)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    uu, uv, vv = (np.einsum("...i,...i->...", second, normal) for second in (duu, duv, dvv))
    second = np.stack([uu, uv, uv, vv], axis=-1).reshape(*uu.shape, 2, 2)
    dual = tangents @ np.linalg.inv(np.swapaxes(tangents, -1, -2) @ tangents)
    return normal, dual @ second @ np.swapaxes(dual, -1, -2)

"""Moments of whole Bezier patches by tensor-product Gauss rules, in batches, instead of line integrals along their loops.

Level-set meshes have thousands of untrimmed patches of few degrees, each bounded by its four sides in one or two edges.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.moments.loop_integrals import GAUSS_POINTS_SINGLE_SPAN, N_MOMENTS, sum_moments
from tpmscad.splines.basis import design_matrix, evaluate_bezier_patches
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.quadrature import tensor_gauss_legendre

PATCHES_PER_BATCH = 256
"""Patches per batch: 10 MB, which mostly fit the cache of the processor."""


def whole_moments(brep: Brep) -> tuple[NDArray[np.bool_], Array]:
    """Whether each face is a whole Bezier patch on [0, 1]^2 (F,), and the moments of these before placement (F, 16)."""
    faces, uses, face = brep.faces, brep.uses, brep.face_of_use
    whole = np.array([_is_bezier(c) for c in brep.carriers], bool)[faces.carrier]
    ends, straight = _use_end_parameters(brep)
    border = ((ends[:, 0] == ends[:, 1]) & ((ends[:, 0] == 0.0) | (ends[:, 0] == 1.0))).any(axis=1)
    whole[face[~(straight & border)]] = False
    area = 0.5 * uses.sense * (ends[:, 0, 0] + ends[:, 1, 0]) * (ends[:, 1, 1] - ends[:, 0, 1])
    whole &= np.bincount(face, area, len(faces)) == 1.0

    moments = np.zeros((len(faces), N_MOMENTS))
    used = np.unique(faces.carrier[whole])
    table = np.zeros((len(brep.carriers), N_MOMENTS))
    surfaces = {int(i): s for i in used if isinstance(s := brep.carriers[i], BSplineSurface)}
    shapes = np.array([s.poles.shape[:2] for s in surfaces.values()]).reshape(-1, 2)
    for shape in np.unique(shapes, axis=0):
        at = used[(shapes == shape).all(axis=1)]
        for some in np.array_split(at, -(-len(at) // PATCHES_PER_BATCH)):
            table[some] = _bezier_patch_moments(np.stack([surfaces[int(i)].poles for i in some]))
    moments[whole] = table[faces.carrier[whole]]
    return whole, moments


def _is_bezier(carrier: object) -> bool:
    return (
        isinstance(carrier, BSplineSurface)
        and carrier.domain == ((0.0, 1.0), (0.0, 1.0))
        and len(carrier.knots_u) == 2 * carrier.poles.shape[0]
        and len(carrier.knots_v) == 2 * carrier.poles.shape[1]
    )


def _use_end_parameters(brep: Brep) -> tuple[Array, NDArray[np.bool_]]:
    """(u, v) at both ends of the span of each use (K, 2, 2), and whether its pcurve is a straight line (K,)."""
    uses = brep.uses
    lines = [c.degree == 1 and len(c.poles) == 2 for c in brep.pcurves]
    straight = np.array([*lines, False], bool)[uses.pcurve]
    poles = np.zeros((len(lines) + 1, 2, 2))
    domain = np.tile([0.0, 1.0], (len(lines) + 1, 1))
    for i in np.flatnonzero(lines):
        poles[i], domain[i] = brep.pcurves[i].poles, brep.pcurves[i].domain
    span, of = brep.edges.span[uses.edge], uses.pcurve
    t = (span - domain[of, :1]) / np.diff(domain[of], axis=1)
    return (1 - t)[..., None] * poles[of, :1] + t[..., None] * poles[of, 1:], straight


def _bezier_patch_moments(poles: Array) -> Array:
    """Moments of patches of one degree, poles (n, p + 1, q + 1, 3): (n, 16)."""
    _, nu, nv, _ = poles.shape
    u, v, weights = tensor_gauss_legendre(_gauss_point_count(nu), _gauss_point_count(nv))
    (bu, du), (bv, dv) = (
        [design_matrix(np.repeat([0.0, 1.0], m), m - 1, t, order) for order in (0, 1)] for m, t in ((nu, u), (nv, v))
    )
    points, along_u, along_v = (evaluate_bezier_patches(a, poles, b) for a, b in ((bu, bv), (du, bv), (bu, dv)))
    return sum_moments(points, np.cross(along_u, along_v), weights.ravel())


def _gauss_point_count(poles: int) -> int:
    """Gauss points along one parameter: exact for the polynomial moments, of degree 4 p - 1, and enough for the area."""
    return max(GAUSS_POINTS_SINGLE_SPAN, 2 * (poles - 1))

"""The primitive patches of a lattice: offset surfaces of the exact patch, fitted with the fewest poles that meet a tolerance.

The control nets are those of CPIA (`splines.cpia`): the least-squares fit among all surfaces that join their own
copies over the four sides with curvature continuity (G2), at corners of six patches too. TPMS2STEP (eqs. 10-13) asks for
parametric C2, which no regular patch has at such corners. The surface at a negative offset is the image of the one
at the positive offset under the rotoinversion of the patch, so that offsets of equal size share a primitive.

Surfaces bounded by mirror planes are fitted in `mirror_fit`.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tpmscad import surfaces
from tpmscad.brep.deviation import Deviation, combine_deviations, measure_deviation
from tpmscad.lattices.offset_surfaces import Layers, LayersFit, OffsetSurfaces
from tpmscad.splines import error_bounds
from tpmscad.splines.adaptive_fit import AdaptiveFit, GridEvaluator, fit_degree, fit_to_tolerance
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import ContinuityConditions, Joint, joint_conditions
from tpmscad.splines.cpia import CpiaResult, NetConvergence
from tpmscad.splines.spline_axis import SplineAxis

CORNER_VALENCE = 6
"""Patches around every corner of the primitive."""

DEGREES = tuple(range(5, 19))
"""Candidate degrees. Beyond 18 float64 does not hold the joints to 1e-9 of the cell."""

BOUND_SAMPLES_PER_PARAMETER = 65
"""Vertices along each parameter of the mesh between the surfaces in the a-priori bounds."""


def fit_offset_surfaces(
    name: str, reference: str, layers: Layers, cell: float, tol: float
) -> LayersFit[OffsetSurfaces]:
    """Fit the lower and upper surface at their normal offsets (model units; None: no surface) to within `tol`.

    Where no candidate meets `tol` the best one is returned: compare the deviation.
    """
    sizes = sorted({abs(d) / cell for d in layers if d is not None})
    searched = [fit_primitive(name, reference, size, tol / cell) for size in sizes]
    # Gap faces and caps join both surfaces, so both take one degree: the higher of the two.
    degree = max(fit.degree for fit in searched)
    fits = [
        fit if fit.degree == degree else fit_primitive_of_degree(name, reference, size, degree)
        for fit, size in zip(searched, sizes, strict=True)
    ]
    lower, upper = (None if d is None else (sizes.index(abs(d) / cell), d < 0) for d in layers)
    primitives = tuple(fit.surface for fit in fits)
    deviations = [
        _measure_offset_deviation(name, reference, size, p) for size, p in zip(sizes, primitives, strict=True)
    ]
    bounds = [_rigorous_bounds(name, reference, size, p) for size, p in zip(sizes, primitives, strict=True)]
    return LayersFit(
        OffsetSurfaces(primitives, lower, upper),
        combine_deviations(deviations).scaled(cell),
        {label: cell * max(b[label] for b in bounds) for label in bounds[0]},
        NetConvergence.worst(fit.convergence for fit in fits).scaled(cell),
    )


@lru_cache(maxsize=64)
def fit_primitive(name: str, reference: str, offset: float, tol: float) -> AdaptiveFit:
    """The offset patch (cells) with the fewest poles whose measured two-way deviation is at most `tol` (cells).

    Cached: the same lattice in another box or with another boundary reuses the fit.
    """
    return fit_to_tolerance(
        _offset_grid_evaluator(name, reference, offset),
        lambda fitted: _measure_offset_deviation(name, reference, offset, fitted).max,
        tol,
        conditions=lambda u, v: self_joint_conditions(name, u, v),
        degrees=DEGREES,
    )


@lru_cache(maxsize=64)
def fit_primitive_of_degree(name: str, reference: str, offset: float, degree: int) -> CpiaResult:
    """The offset patch (cells) of a given degree."""
    return fit_degree(
        _offset_grid_evaluator(name, reference, offset),
        degree,
        lambda u, v: self_joint_conditions(name, u, v),
    )


def self_joint_conditions(name: str, axis_u: SplineAxis, axis_v: SplineAxis) -> ContinuityConditions:
    """Curvature continuity of the patch with its copies over its four sides."""
    edges = surfaces.patch_symmetry(name).edge_motions
    joints = [Joint(side, edges.rotation[side], edges.translation[side], side) for side in range(4)]
    return joint_conditions(joints, axis_u, axis_v, order=2, valence=CORNER_VALENCE)


def _offset_grid_evaluator(name: str, reference: str, offset: float) -> GridEvaluator:
    patch = surfaces.primitive_patch(name, reference)
    return lambda u, v: patch.jet(u[:, None], v[None, :], offset).position


def _measure_offset_deviation(name: str, reference: str, offset: float, fitted: BSplineSurface) -> Deviation:
    patch = surfaces.primitive_patch(name, reference)
    return measure_deviation(fitted, lambda u, v: patch.jet(u, v, offset).position)


def _rigorous_bounds(name: str, reference: str, offset: float, fitted: BSplineSurface) -> dict[str, float]:
    """TPMS2STEP's two bounds (eqs. 3 and 4) in rigorous form, over a mesh of BOUND_SAMPLES_PER_PARAMETER^2 vertices.

    The second derivatives of the exact surface are sampled at the vertices; those of the fit are bounded by control nets.
    """
    patch = surfaces.primitive_patch(name, reference)
    t = np.linspace(0.0, 1.0, BOUND_SAMPLES_PER_PARAMETER)
    jet = patch.jet(t[:, None], t[None, :], offset)
    uu, uv, vv = (float(np.linalg.norm(d, axis=-1).max()) for d in (jet.duu, jet.duv, jet.dvv))
    mixed = error_bounds.second_derivative_bounds(fitted, 2)[1]
    return {
        "of the deviation, by a mesh (Filip)": error_bounds.fit_error_bound(jet.position, t, t, (uu, uv, vv), fitted),
        "of facets on the fitted surface, not of its deviation (Zheng, Sederberg)": float(
            error_bounds.zheng_sederberg_bound(mixed, t[1], t[1])
        ),
    }

"""The primitive patches of a lattice: offset surfaces of the exact patch, fitted with as few poles as the tolerance allows.

The fit is the least-squares one among all that join their own copies over the four sides with curvature continuity, corners
where six patches meet included (TPMS2STEP asks parametric C2, eqs 10-13, which no regular patch has at such corners). A surface
at a negative distance is the one at the positive distance turned over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tpmscad import surfaces
from tpmscad.brep.deviation import Deviation, combine_deviations, measure_deviation
from tpmscad.lattices.offset_surfaces import OffsetSurfaces
from tpmscad.splines import error_bounds
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.continuity_conditions import ContinuityConditions, Joint, joint_conditions
from tpmscad.splines.spline_axis import SplineAxis
from tpmscad.splines.surface_fit import AdaptiveFit, SplineSpace, fit_to_tolerance

CORNER_VALENCE = 6
"""Patches around every corner of the primitive."""

LADDER = tuple(SplineSpace(degree) for degree in range(5, 19))
"""One span of degree 5 to 18. Past 18 float64 no longer holds the joints to 1e-9 of the cell."""

BOUND_SAMPLES_PER_PARAMETER = 65
"""Samples along each parameter of the mesh that stands between the surfaces in the a-priori bound."""


@dataclass(frozen=True, slots=True, eq=False)
class OffsetSurfacesFit:
    """The fitted surfaces of a sheet, in cells, with their deviation and rigorous bound in model units."""

    sheet: OffsetSurfaces
    deviation: Deviation
    bounds: Mapping[str, float]


def fit_offset_surfaces(
    name: str, reference: str, layers: tuple[float | None, float | None], cell: float, tol: float
) -> OffsetSurfacesFit:
    """Fit the lower and upper surfaces at their normal distances (model units; None: no surface) to within `tol`.

    Distances of equal size share a primitive. Where no degree of the ladder meets `tol` the best comes back: compare.
    """
    sizes = sorted({abs(d) / cell for d in layers if d is not None})
    fits = [fit_primitive(name, reference, size, tol / cell) for size in sizes]
    # Gap faces and caps join both surfaces, so they take one spline space: the larger of the two.
    degree = max(fit.space.degree for fit in fits)
    primitives = [
        fit.surface if fit.space.degree == degree else fit_primitive_of_degree(name, reference, size, degree)
        for fit, size in zip(fits, sizes, strict=True)
    ]
    lower, upper = (None if d is None else (sizes.index(abs(d) / cell), d < 0) for d in layers)
    measured = [
        _measure_offset_deviation(name, reference, size, primitive)
        for size, primitive in zip(sizes, primitives, strict=True)
    ]
    each = [_rigorous_bounds(name, reference, size, p) for size, p in zip(sizes, primitives, strict=True)]
    bound = {label: cell * max(b[label] for b in each) for label in each[0]}
    return OffsetSurfacesFit(
        OffsetSurfaces(tuple(primitives), lower, upper), combine_deviations(measured).scaled(cell), bound
    )


@lru_cache(maxsize=64)
def fit_primitive(name: str, reference: str, offset: float, tol: float) -> AdaptiveFit:
    """The offset patch (in cells) with the fewest poles whose measured two-way deviation is at most `tol` (in cells)."""
    return fit_to_tolerance(
        _offset_grid_evaluator(name, reference, offset),
        lambda fitted: _measure_offset_deviation(name, reference, offset, fitted).max,
        tol,
        conditions=lambda u, v: self_joint_conditions(name, u, v),
        ladder=LADDER,
    )


@lru_cache(maxsize=64)
def fit_primitive_of_degree(name: str, reference: str, offset: float, degree: int) -> BSplineSurface:
    """The offset patch of one given degree."""
    return fit_to_tolerance(
        _offset_grid_evaluator(name, reference, offset),
        lambda fitted: 0.0,
        1.0,
        conditions=lambda u, v: self_joint_conditions(name, u, v),
        ladder=(SplineSpace(degree),),
    ).surface


def self_joint_conditions(name: str, axis_u: SplineAxis, axis_v: SplineAxis) -> ContinuityConditions:
    """Curvature continuity with the patch's copies over its four sides."""
    edges = surfaces.patch_symmetry(name).edge_motions
    joints = [Joint(side, edges.rotation[side], edges.translation[side], side) for side in range(4)]
    return joint_conditions(joints, axis_u, axis_v, order=2, valence=CORNER_VALENCE)


def _offset_grid_evaluator(name: str, reference: str, offset: float):  # type: ignore[no-untyped-def]  # a closure of the Grid type
    patch = surfaces.primitive_patch(name, reference)
    return lambda u, v: patch.jet(u[:, None], v[None, :], offset).position


def _measure_offset_deviation(name: str, reference: str, offset: float, fitted: BSplineSurface) -> Deviation:
    patch = surfaces.primitive_patch(name, reference)
    return measure_deviation(fitted, lambda u, v: patch.jet(u, v, offset).position)


def _rigorous_bounds(name: str, reference: str, offset: float, fitted: BSplineSurface) -> dict[str, float]:
    """TPMS2STEP's two bounds (eqs 3 and 4) in rigorous form, over a mesh of BOUND_GRID^2 points between the surfaces.

    The exact surface's second derivatives are sampled on the mesh's points; the fitted one's are bounded by its control nets.
    """
    patch = surfaces.primitive_patch(name, reference)
    t = np.linspace(0.0, 1.0, BOUND_SAMPLES_PER_PARAMETER)
    jet = patch.jet(t[:, None], t[None, :], offset)
    uu, uv, vv = (float(np.linalg.norm(d, axis=-1).max()) for d in (jet.duu, jet.duv, jet.dvv))
    own = error_bounds.second_derivative_bounds(fitted, 2)
    return {
        "Filip's, from the exact surface by a mesh to the fitted one": error_bounds.fit_error_bound(
            jet.position, t, t, (uu, uv, vv), fitted
        ),
        "Zheng-Sederberg's, from the mesh to the fitted surface's bilinear facets": float(
            error_bounds.zheng_sederberg_bound(own[1], t[1], t[1])
        ),
    }

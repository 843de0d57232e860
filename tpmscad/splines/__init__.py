"""B-splines: bases, curves and surfaces, fits by progressive iteration, continuity as linear rows, and error bounds.

The modules from the lowest up: `basis` and `quadrature` (evaluators and rules), `bspline`, `knots`, `curve_batch`,
`tensor_product` (values and their evaluation), `spline_axis` (orthonormal coordinates), `continuity_conditions` and
`affine_subspace` (G2 conditions and their solution space), `surface_fit` (the direct least-squares solution),
`progressive_iteration` and `cpia` (PIA, LSPIA, CPIA), `adaptive_fit` (the fewest poles for a tolerance) and
`error_bounds` (a-priori bounds).
"""

from __future__ import annotations

from tpmscad.splines.adaptive_fit import BEZIER_SPACES, AdaptiveFit, FitTrial, SplineSpace, fit_to_tolerance
from tpmscad.splines.affine_subspace import AffineSubspace, pole_metric, solve_conditions, unconstrained_subspace
from tpmscad.splines.basis import design_matrix
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface, line_segment
from tpmscad.splines.bspline_volume import BSplineVolume, ruled_volume
from tpmscad.splines.continuity_conditions import ContinuityConditions, Joint, joint_conditions
from tpmscad.splines.cpia import (
    CpiaResult,
    DataGrid,
    NetConvergence,
    cpia_convergence_rate,
    fit_cpia,
    trapezoidal_grid,
)
from tpmscad.splines.error_bounds import (
    derivative_bounds,
    filip_bound,
    filip_step,
    fit_error_bound,
    second_derivative_bounds,
    zheng_sederberg_bound,
)
from tpmscad.splines.knots import (
    bezier_knots,
    elevate_degree,
    insert_knot,
    restrict_surface,
    split_surface,
    uniform_knots,
)
from tpmscad.splines.progressive_iteration import iterate_lspia, iterate_pia, pia_convergence_rate
from tpmscad.splines.spline_axis import SplineAxis, gauss_axis, pole_axis, sampled_axis
from tpmscad.splines.surface_fit import fit_surface

__all__ = [
    "BEZIER_SPACES",
    "AdaptiveFit",
    "AffineSubspace",
    "BSplineCurve",
    "BSplineSurface",
    "BSplineVolume",
    "ContinuityConditions",
    "CpiaResult",
    "DataGrid",
    "FitTrial",
    "Joint",
    "NetConvergence",
    "SplineAxis",
    "SplineSpace",
    "bezier_knots",
    "cpia_convergence_rate",
    "derivative_bounds",
    "design_matrix",
    "elevate_degree",
    "filip_bound",
    "filip_step",
    "fit_cpia",
    "fit_error_bound",
    "fit_surface",
    "fit_to_tolerance",
    "gauss_axis",
    "insert_knot",
    "iterate_lspia",
    "iterate_pia",
    "joint_conditions",
    "line_segment",
    "pia_convergence_rate",
    "pole_axis",
    "pole_metric",
    "restrict_surface",
    "ruled_volume",
    "sampled_axis",
    "second_derivative_bounds",
    "solve_conditions",
    "split_surface",
    "trapezoidal_grid",
    "unconstrained_subspace",
    "uniform_knots",
    "zheng_sederberg_bound",
]

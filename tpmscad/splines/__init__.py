"""B-splines as values, their fits and bounds, and continuity between rigid copies as linear conditions on the poles."""

from __future__ import annotations

from tpmscad.splines.adaptive import BEZIER, Fit, Space, Trial, adapt
from tpmscad.splines.axis import Axis, bezier_knots, gauss_axis, pole_axis, sampled_axis, uniform_knots
from tpmscad.splines.bounds import (
    derivative_bounds,
    filip,
    filip_step,
    fit_bound,
    second_derivative_bounds,
    zheng_sederberg,
)
from tpmscad.splines.bspline import Curve, Surface, design, line
from tpmscad.splines.continuity import Conditions, Joint, joint_conditions
from tpmscad.splines.cpia import Grid, Iteration, cpia, cpia_rate, plain_grid
from tpmscad.splines.fitting import fit
from tpmscad.splines.knots import elevate, insert, restrict, split
from tpmscad.splines.pia import lspia, pia, pia_rate
from tpmscad.splines.subspace import Subspace, free, pole_metric, solve_conditions

__all__ = [
    "BEZIER",
    "Axis",
    "Conditions",
    "Curve",
    "Fit",
    "Grid",
    "Iteration",
    "Joint",
    "Space",
    "Subspace",
    "Surface",
    "Trial",
    "adapt",
    "bezier_knots",
    "cpia",
    "cpia_rate",
    "derivative_bounds",
    "design",
    "elevate",
    "filip",
    "filip_step",
    "fit",
    "fit_bound",
    "free",
    "gauss_axis",
    "insert",
    "joint_conditions",
    "line",
    "lspia",
    "pia",
    "pia_rate",
    "plain_grid",
    "pole_axis",
    "pole_metric",
    "restrict",
    "sampled_axis",
    "second_derivative_bounds",
    "solve_conditions",
    "split",
    "uniform_knots",
    "zheng_sederberg",
]

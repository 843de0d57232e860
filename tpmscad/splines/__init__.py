"""B-splines as values, their fits, and continuity between rigid copies as linear conditions on the poles."""

from __future__ import annotations

from tpmscad.splines.axis import Axis, bezier_knots, gauss_axis, pole_axis, sampled_axis, uniform_knots
from tpmscad.splines.bspline import Curve, Surface, design, line
from tpmscad.splines.continuity import Conditions, Joint, joint_conditions
from tpmscad.splines.fitting import fit
from tpmscad.splines.subspace import Subspace, solve_conditions

__all__ = [
    "Axis",
    "Conditions",
    "Curve",
    "Joint",
    "Subspace",
    "Surface",
    "bezier_knots",
    "design",
    "fit",
    "gauss_axis",
    "joint_conditions",
    "line",
    "pole_axis",
    "sampled_axis",
    "solve_conditions",
    "uniform_knots",
]

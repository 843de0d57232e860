"""B-splines: bases, curves and surfaces, fits by progressive iteration, continuity as linear rows, and error bounds.

The modules from the lowest up: `basis` and `quadrature` (evaluators and rules), `bspline`, `knots` and
`curve_batch` (values and their evaluation), `spline_axis` (orthonormal coordinates), `continuity_conditions` and
`affine_subspace` (G2 conditions and their solution space), `surface_fit` (the direct least-squares solution),
`cpia` (the iteration that makes control nets), `adaptive_fit` (the fewest poles for a tolerance) and
`error_bounds` (a-priori bounds).
"""

from tpmscad._lazy_import import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

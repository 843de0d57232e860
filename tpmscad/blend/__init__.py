"""Porous structures blended without topological errors: weights, the earlier methods, the topological optimiser.

Fields are callables f(points (..., 3)) -> (...), solid where f < 0; regions are fields too, <= 0 inside. Lengths are in the units
of the points.
"""

from tpmscad.blend.coordinates import Along, CylinderRadius, SphereRadius
from tpmscad.blend.initial import Line, Volume
from tpmscad.blend.result import BlendResult, Errors, Tally
from tpmscad.blend.solve import blend

__all__ = ["Along", "BlendResult", "CylinderRadius", "Errors", "Line", "SphereRadius", "Tally", "Volume", "blend"]

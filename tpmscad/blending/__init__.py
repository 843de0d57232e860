"""Porous structures blended without topological errors: weights, the earlier methods, the topological optimiser.

Fields are callables f(points (..., 3)) -> (...), solid where f < 0; regions are fields too, <= 0 inside. Lengths are in the units
of the points. The room is called like its function: `tpmscad.blend(...)` is `tpmscad.blending.porous_blending.blend(...)`.
"""

from tpmscad.blending.initial_weights import LineWeightSpec, VolumeWeightSpec
from tpmscad.blending.porous_blending import blend
from tpmscad.blending.result import BlendResult, DefectCounts, DefectReport
from tpmscad.blending.weights.coordinates import CylinderRadius, LinearCoordinate, SphereRadius

__all__ = [
    "BlendResult",
    "CylinderRadius",
    "DefectCounts",
    "DefectReport",
    "LineWeightSpec",
    "LinearCoordinate",
    "SphereRadius",
    "VolumeWeightSpec",
    "blend",
]

"""Porous structures blended without topological defects: the function `blend`, its weight specifications, its result.

Structures, regions and blending regions are fields, f(points (..., 3)) -> (...): structures are solid where f < 0, and regions
hold the points where f <= 0. Lengths are in the units of the points. The function is also available as `tpmscad.blend`.
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

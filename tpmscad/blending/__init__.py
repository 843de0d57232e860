"""Porous structures blended without topological defects: the function `blend`, its weight specifications, its result.

Structures, regions and blending regions are fields, f(points (..., 3)) -> (...): structures are solid where f < 0, and regions
hold the points where f <= 0. Lengths are in the units of the points. The function is also available as `tpmscad.blend`.
"""

from tpmscad._lazy_import import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

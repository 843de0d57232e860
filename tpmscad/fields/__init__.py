"""Implicit fields: functions of points (..., 3) in model units, f < 0 solid, with exact gradients.

phi = fields.tpms("gyroid", period=10.0)
graded = fields.rod(phi, fields.ramp("x", (0, 40), (-0.6, 0.2)))
part = graded & fields.sphere((20, 20, 20), 18)
"""

from tpmscad.fields.algebra import constant
from tpmscad.fields.booleans import (
    complement,
    difference,
    intersection,
    smooth_difference,
    smooth_intersection,
    smooth_union,
    union,
)
from tpmscad.fields.catalogue import TPMS, TpmsInfo, find
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.function import from_function
from tpmscad.fields.ramps import coordinate, linear, ramp
from tpmscad.fields.regions import box, cylinder, halfspace, sphere
from tpmscad.fields.thresholds import pore, rod, sheet
from tpmscad.fields.tpms import tpms

__all__ = [
    "TPMS",
    "Field",
    "TpmsInfo",
    "as_field",
    "box",
    "complement",
    "constant",
    "coordinate",
    "cylinder",
    "difference",
    "find",
    "from_function",
    "halfspace",
    "intersection",
    "linear",
    "pore",
    "ramp",
    "rod",
    "sheet",
    "smooth_difference",
    "smooth_intersection",
    "smooth_union",
    "sphere",
    "tpms",
    "union",
]

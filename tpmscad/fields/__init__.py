"""Implicit fields: functions of points (..., 3) in model units, f < 0 solid, with exact gradients.

phi = fields.tpms("gyroid", period=10.0)
graded = fields.rod(phi, fields.ramp("x", (0, 40), (-0.6, 0.2)))
part = graded & fields.sphere((20, 20, 20), 18)
"""

from tpmscad.fields.booleans import (
    complement,
    difference,
    intersection,
    smooth_difference,
    smooth_intersection,
    smooth_union,
    union,
)
from tpmscad.fields.bspline import bspline_unit
from tpmscad.fields.catalogue import TPMS, TpmsInfo, find
from tpmscad.fields.cell_sizes import cell_sizes
from tpmscad.fields.field import Field, as_field, constant
from tpmscad.fields.fraction import threshold_for, volume_fraction
from tpmscad.fields.function import from_function
from tpmscad.fields.grading import graded_threshold
from tpmscad.fields.image import image_region
from tpmscad.fields.maps import mapped, rotated, scaled, translated
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
    "bspline_unit",
    "cell_sizes",
    "complement",
    "constant",
    "coordinate",
    "cylinder",
    "difference",
    "find",
    "from_function",
    "graded_threshold",
    "halfspace",
    "image_region",
    "intersection",
    "linear",
    "mapped",
    "pore",
    "ramp",
    "rod",
    "rotated",
    "scaled",
    "sheet",
    "smooth_difference",
    "smooth_intersection",
    "smooth_union",
    "sphere",
    "threshold_for",
    "tpms",
    "translated",
    "union",
    "volume_fraction",
]

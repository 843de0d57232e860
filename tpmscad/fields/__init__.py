"""Implicit fields: functions of points (..., 3) in model units with exact gradients; f < 0 is solid.

>>> from tpmscad import fields
>>> phi = fields.tpms("gyroid", period=10.0)
>>> graded = fields.rod(phi, fields.ramp("x", (0, 40), (-0.6, 0.2)))
>>> part = graded & fields.sphere((20, 20, 20), 18)
"""

from tpmscad import catalogue
from tpmscad.catalogue import CATALOGUE as TPMS
from tpmscad.catalogue import SurfaceRecord
from tpmscad.fields.booleans import (
    complement,
    difference,
    intersection,
    smooth_difference,
    smooth_intersection,
    smooth_union,
    union,
)
from tpmscad.fields.cell_grading import cell_sizes
from tpmscad.fields.coordinate_transforms import rotate, scale, translate, warp
from tpmscad.fields.expressions import expression
from tpmscad.fields.field import Field, as_field, constant, from_function
from tpmscad.fields.image_regions import image_region
from tpmscad.fields.implicit_bspline import bspline_unit
from tpmscad.fields.nodal_field import tpms
from tpmscad.fields.normal_distance import normal_distance, wall
from tpmscad.fields.primitive_regions import box, cylinder, halfspace, sphere
from tpmscad.fields.ramps import coordinate, linear, ramp
from tpmscad.fields.sampled_data import sampled
from tpmscad.fields.scattered_data import scattered
from tpmscad.fields.thresholds import pore, rod, sheet
from tpmscad.fields.volume_fraction_thresholds import graded_threshold, threshold_for, volume_fraction
from tpmscad.public_calls import public

# here and not in the catalogue, which the help of the command line reads without NumPy
find_surface = public()(catalogue.find_surface)

__all__ = [
    "TPMS",
    "Field",
    "SurfaceRecord",
    "as_field",
    "box",
    "bspline_unit",
    "cell_sizes",
    "complement",
    "constant",
    "coordinate",
    "cylinder",
    "difference",
    "expression",
    "find_surface",
    "from_function",
    "graded_threshold",
    "halfspace",
    "image_region",
    "intersection",
    "linear",
    "normal_distance",
    "pore",
    "ramp",
    "rod",
    "rotate",
    "sampled",
    "scale",
    "scattered",
    "sheet",
    "smooth_difference",
    "smooth_intersection",
    "smooth_union",
    "sphere",
    "threshold_for",
    "tpms",
    "translate",
    "union",
    "volume_fraction",
    "wall",
    "warp",
]


def __dir__() -> list[str]:
    return sorted(__all__)

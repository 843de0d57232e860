"""Implicit fields: functions of points (..., 3) in model units with exact gradients; f < 0 is solid.

>>> from tpmscad import fields
>>> phi = fields.tpms("gyroid", period=10.0)
>>> graded = fields.rod(phi, fields.ramp("x", (0, 40), (-0.6, 0.2)))
>>> part = graded & fields.sphere((20, 20, 20), 18)
"""

from tpmscad._lazy_import import attach_stub

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

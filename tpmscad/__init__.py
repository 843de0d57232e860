"""Triply periodic minimal surfaces and porous fields as exact, certified NURBS solids.

Lengths are in model units (mm in files), angles in degrees. A point array has shape (..., 3), xyz last. A field is solid where it
is negative. The public names are listed in `__init__.pyi`; each is imported at its first use, because those that make solids load
the CAD kernel, which takes seconds.
"""

from tpmscad._lazy_import import attach_stub
from tpmscad.kernel_wheels import warn_of_conflict

__getattr__, __dir__, __all__ = attach_stub(__name__, __file__)

__version__ = "0.1.0"

warn_of_conflict()

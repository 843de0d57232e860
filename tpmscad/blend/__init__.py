"""Porous structures blended without topological errors: weights, the earlier methods, the topological optimiser.

Fields are callables f(points (..., 3)) -> (...), solid where f < 0; regions are fields too, <= 0 inside. Lengths are in the units
of the points. The room is called like its function: `tpmscad.blend(...)` is `tpmscad.blend.solve.blend(...)`.
"""

import sys
from types import ModuleType
from typing import Any

from tpmscad.blend.coordinates import Along, CylinderRadius, SphereRadius
from tpmscad.blend.initial import Line, Volume
from tpmscad.blend.result import BlendResult, Errors, Tally
from tpmscad.blend.solve import blend

__all__ = ["Along", "BlendResult", "CylinderRadius", "Errors", "Line", "SphereRadius", "Tally", "Volume", "blend"]


class _Room(ModuleType):
    """A module that can be called (Python's "Customizing module attribute access"): the public name is the room's own."""

    def __call__(self, *structures: Any, **options: Any) -> BlendResult:
        return blend(*structures, **options)


_Room.__call__.__doc__ = blend.__doc__
sys.modules[__name__].__class__ = _Room

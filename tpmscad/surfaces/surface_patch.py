"""The primitive patch of a surface and its normal offsets, on the closed unit square."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.errors import InvalidRequest
from tpmscad.surfaces import minimal_patch, nodal_patch
from tpmscad.surfaces.differential_geometry import SurfaceJet, min_curvature_radius
from tpmscad.surfaces.surface_records import check_reference, find_surface

PARAMETER_MARGIN = 0.05
"""How far outside the unit square the surface is evaluated: Newton steps of a caller may leave the square a little."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePatch:
    """A quadrilateral of which the whole surface is made by proper motions; lengths in cells (cubic cell edge 1).

    Its corners are flat points where six patches meet. du x dv is along the normal, and the normal along the gradient of the
    nodal function. `max_offset` is the least radius of curvature, the same on both sides. `mid_and_normal(u, v)` are the mid
    surface and its unit normal with their derivatives, (6, ..., 3) each: value, u, v, uu, uv, vv.
    """

    name: str
    reference: str
    max_offset: float
    mid_and_normal: Callable[[Array, Array], tuple[Array, Array]]

    def jet(self, u: ArrayLike, v: ArrayLike, offset: float = 0.0) -> SurfaceJet:
        """The surface at normal distance `offset` and its derivatives at the pairs (u, v), broadcast.

        Exact to 1e-13 on [-MARGIN, 1 + MARGIN]^2. InvalidRequest outside, and for |offset| >= `max_offset`, where an offset
        surface has cusps.
        """
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        for value in (u, v):
            outside = ~((value >= -PARAMETER_MARGIN) & (value <= 1 + PARAMETER_MARGIN))
            if outside.any():
                raise InvalidRequest(
                    f"parameter {value[outside].flat[0]:g} is outside the unit square of the {self.name} patch; "
                    "keep u and v in [0, 1]"
                )
        if not abs(offset) < self.max_offset:
            raise InvalidRequest(
                f"offset {offset:g} of the {self.reference} {self.name} passes its curvature radius: offsets stay below "
                f"{self.max_offset:.6g} cells, so the thickness below {2 * self.max_offset:.6g} cells; thin the wall or "
                "enlarge the cell"
            )
        mid, normal = self.mid_and_normal(u, v)
        position, du, dv, duu, duv, dvv = mid + offset * normal if offset else mid
        return SurfaceJet(position, du, dv, duu, duv, dvv, normal[0])


@cache
def primitive_patch(name: str, reference: str = "minimal") -> SurfacePatch:
    """The primitive patch of a catalogued surface: `reference` is "minimal" (exact) or "nodal" (trigonometric level set).

    InvalidRequest names what there is.
    """
    info = find_surface(name)
    check_reference(info, reference)
    if info.primitives != "exact":
        raise InvalidRequest(f"the {info.title} has no patch in closed form; its pieces between mirrors are fitted")
    if reference == "minimal":
        return SurfacePatch(
            info.name, reference, minimal_patch.max_offset(info.name), partial(minimal_patch.mid_and_normal, info.name)
        )
    evaluate = partial(nodal_patch.mid_and_normal, info.name)
    return SurfacePatch(info.name, reference, min_curvature_radius(evaluate), evaluate)

"""The primitive patch of a surface and its normal offsets on the closed unit square.

A primitive patch is a quadrilateral X(u, v) whose copies under proper motions make up the whole surface. Offsets follow the unit
normal, X + d n, and stay regular as long as |d| is below the least radius of curvature.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._typing import Array
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_arguments import Reference, SurfaceName
from tpmscad.catalogue import check_reference, find_surface
from tpmscad.errors import InvalidRequest
from tpmscad.surfaces import minimal_patch, nodal_patch
from tpmscad.surfaces.differential_geometry import SurfaceJet, min_curvature_radius

PARAMETER_MARGIN = 0.05
"""Width of the strip around the unit square in which the patch is evaluated too: a caller's Newton step may leave the square."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfacePatch:
    """A primitive patch, lengths in cells (cubic cell edge 1).

    - The corners are flat points, where six patches meet.
    - du x dv is parallel to the normal, and the normal to the gradient of the nodal function.
    - `max_offset`: least radius of curvature, the same on both sides.
    - `mid_and_normal(u, v)`: mid surface and unit normal with their derivatives, (6, ..., 3) each: value, u, v, uu, uv, vv.
    """

    name: str
    reference: str
    max_offset: float
    mid_and_normal: Callable[[Array, Array], tuple[Array, Array]]

    def jet(self, u: ArrayLike, v: ArrayLike, offset: float = 0.0) -> SurfaceJet:
        """Evaluate the offset surface with its first and second derivatives.

        Parameters
        ----------
        u, v : array_like
            Parameters, broadcast against each other, in [-PARAMETER_MARGIN, 1 + PARAMETER_MARGIN].
        offset : float
            Signed distance along the normal, in cells.

        Returns
        -------
        SurfaceJet
            Position, derivatives and unit normal, (..., 3) each, accurate to 1e-13.

        Raises
        ------
        InvalidRequest
            If a parameter is outside the domain, or ``abs(offset) >= max_offset``, where offset surfaces have cusps.
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


@validate_call()
@cache
def primitive_patch(name: SurfaceName, reference: Reference = "minimal") -> SurfacePatch:
    """Return the primitive patch of a surface that has one in closed form.

    Returns
    -------
    SurfacePatch
        The patch; repeated calls return the same object.

    Raises
    ------
    InvalidRequest
        If the surface is unknown, lacks the reference, or consists of mirrored pieces. The message names the alternatives.

    Examples
    --------
    >>> from tpmscad import surfaces
    >>> surfaces.primitive_patch("gyroid").jet(0.5, 0.5).position
    array([0.   , 0.25 , 0.375])
    """
    record = find_surface(name)
    check_reference(record, reference)
    if record.primitives != "exact":
        fitted = "its pieces between mirrors" if record.primitives == "mirrored" else "patches of its nodal level set"
        raise InvalidRequest(f"the {record.title} has no patch in closed form; {fitted} are fitted")
    if reference == "minimal":
        return SurfacePatch(
            record.name,
            reference,
            minimal_patch.max_offset(record.name),
            partial(minimal_patch.mid_and_normal, record.name),
        )
    evaluate = partial(nodal_patch.mid_and_normal, record.name)
    return SurfacePatch(record.name, reference, min_curvature_radius(evaluate), evaluate)

"""The body or the box that a solid was made in: what void counts in, and what fractions are fractions of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox
from OCP.TopoDS import TopoDS_Shape

from tpmscad._typing import Array, BoolArray
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.measure.shape_sampling import FaceSamples, lie_on_surface
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.exploration import solids_of
from tpmscad.rigid_motion import Motion


@dataclass(frozen=True, eq=False)
class Envelope:
    """A body, or a box given by opposite corners, with its volume in model units cubed.

    `name` says in messages what it is: "the body", "the box of the cells".
    """

    name: str
    volume: float
    body: TopoDS_Shape | None = None
    corners: tuple[tuple[float, ...], tuple[float, ...]] = ((0.0,) * 3, (0.0,) * 3)

    @classmethod
    def of_box(cls, name: str, low: Sequence[float] | Array, high: Sequence[float] | Array) -> Envelope:
        """The envelope that a box between two corners is; InvalidRequest unless the second one is above the first."""
        corners = np.array([low, high], float)
        if corners.shape != (2, 3) or not (corners[1] > corners[0]).all():
            raise InvalidRequest(
                f"{name} must be two opposite corners, ((x0, y0, z0), (x1, y1, z1)), not {low}, {high}"
            )
        first, last = (tuple(corner) for corner in corners.tolist())
        return cls(name, float(np.diff(corners, axis=0).prod()), corners=(first, last))

    def holds_on_surface(self, samples: FaceSamples, tol: float) -> BoolArray:
        """Which samples of faces lie on the envelope's surface, to `tol` in model units: (n,)."""
        if self.body is not None:
            return lie_on_surface(self.body, samples, tol)
        low, high = np.array(self.corners)
        on_planes = (np.abs(samples.points - low) < tol) & (samples.normals < -0.5)
        on_planes |= (np.abs(samples.points - high) < tol) & (samples.normals > 0.5)
        return np.asarray(on_planes.any(axis=1))

    def __reduce__(self) -> tuple[Any, ...]:
        content = None if self.body is None else convert.shape_to_bytes(self.body)
        return _restore, (self.name, self.volume, content, self.corners)

    def moved(self, motion: Motion) -> Envelope:
        """The envelope after a rigid motion: a box becomes a body."""
        body = self.body
        if body is None:
            low, high = (convert.point(np.array(corner)) for corner in self.corners)
            body = BRepPrimAPI_MakeBox(low, high).Solid()
        return replace(self, body=solids_of(convert.transform_shape(body, motion))[0])


def _restore(name: str, volume: float, content: bytes | None, corners: Any) -> Envelope:
    """An envelope from a pickle."""
    return Envelope(name, volume, None if content is None else convert.shape_from_bytes(content), corners)

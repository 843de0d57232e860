"""The offset surfaces that bound a sheet or skeletal solid, as primitives over one mid patch, and faces placed on them.

Lengths are in cells (edge of the cubic cell = 1). "Lower" and "upper" are meant along the normal of the mid surface, which is
the gradient of its nodal function: the lower surface has the smaller signed distance.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Generic, TypeVar

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.array_table import ArrayTable
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.deviation import Deviation
from tpmscad.brep.welding import weld_patches
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.cpia import NetConvergence

LATTICE_TAGS = ("offset+", "offset-", "gap")
"""Tags of faces: the upper surface, the lower surface, and the ruled faces between them along a natural boundary."""

TOUCH_TOL_CELLS = 1e-9
"""A patch that reaches into a box by less does not count as inside: far above round-off, far below any tolerance."""


Layers = tuple[float | None, float | None]
"""Signed normal distances of the lower and the upper surface in model units; None where there is no surface."""

S = TypeVar("S")


@dataclass(frozen=True, slots=True, eq=False)
class LayersFit(Generic[S]):
    """Fitted surfaces of a wall; their deviation, rigorous bounds on it and the nets' `convergence` in model units; notes."""

    surfaces: S
    deviation: Deviation
    bounds: Mapping[str, float] = field(default_factory=dict)
    convergence: NetConvergence = field(default_factory=lambda: NetConvergence(0, 0.0))
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class PatchAssembly:
    """Placed patches, in cells, and the lower corner (3,) of the box that is to trim them; None if they are closed."""

    brep: Brep
    trim_corner: Array | None


@dataclass(frozen=True, slots=True)
class OffsetLayer:
    """One bounding surface over the mid patch.

    The index of its primitive, whether the primitive is first moved by `PatchSymmetry.swap`, the direction of the outward
    normal along that of the mid surface (+1 or -1), and the tag.
    """

    primitive: int
    swapped: bool
    outward: int
    tag: str


@dataclass(frozen=True, slots=True, eq=False)
class OffsetSurfaces:
    """The bounding surfaces over one mid patch: primitives, and for the lower and the upper surface (primitive, swapped).

    A surface at distance -d is the primitive at +d moved by the rotoinversion of the patch: it is `swapped`. `lower` or `upper`
    is None if the solid lies on one side of a single surface.
    """

    primitives: tuple[BSplineSurface, ...]
    lower: tuple[int, bool] | None
    upper: tuple[int, bool] | None

    def layers(self) -> Iterator[OffsetLayer]:
        """The lower surface, then the upper one, as far as they exist."""
        for layer, outward, tag in ((self.lower, -1, "offset-"), (self.upper, 1, "offset+")):
            if layer is not None:
                yield OffsetLayer(*layer, outward, tag)


@dataclass(frozen=True, slots=True, eq=False)
class PlacedFaces(ArrayTable):
    """n whole patches as faces: primitive, rigid motion, sense of the outward normal, tag; (n,) each."""

    carrier: IntArray
    motion: Motion
    sense: IntArray
    tag: IntArray

    def weld(self, primitives: Sequence[BSplineSurface]) -> Brep:
        """The boundary representation of the faces, with shared edges and vertices."""
        return weld_patches(primitives, self.carrier, self.motion, self.sense, self.tag, LATTICE_TAGS)


def place_faces(carrier: int | IntArray, motion: Motion, sense: int | IntArray, tag: str) -> PlacedFaces:
    """Faces (n,) of one tag on each motion; a single carrier or sense holds for all."""
    n = len(motion)
    return PlacedFaces(
        np.broadcast_to(carrier, n), motion, np.broadcast_to(sense, n), np.full(n, LATTICE_TAGS.index(tag))
    )

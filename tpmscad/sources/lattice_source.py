"""The source of a lattice: what fits the offset surfaces of a wall, places their copies and knows their mid surface."""

from __future__ import annotations

from typing import ClassVar, Generic, TypeVar

from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.fields.kinds.normal_distance import NormalDistance
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.offset_surfaces import Layers, LayersFit, PatchAssembly
from tpmscad.lattices.spline_volumes import SplineVolumes
from tpmscad.sources.patched_surface import SignedDistance

S = TypeVar("S")


class LatticeSource(Generic[S]):
    """A surface of the catalogue as something that lattices are made of; S are its fitted surfaces.

    - `name`: that of the surface; `reference`: "minimal" or "nodal".
    - `can_be_mapped`: whether the lattice may be deformed by a coordinate map, unequal cell edges included.
    - `follows_cell_edges`: whether the patches are those of a cell of unequal edges themselves, without a map.
    - `has_facing_patches`: whether the sides of a wall are copies of patches over one mid patch, so that splines may fill it.
    """

    name: str
    reference: str
    can_be_mapped: ClassVar[bool] = False
    follows_cell_edges: ClassVar[bool] = False
    has_facing_patches: ClassVar[bool] = True

    def fit(self, layers: Layers, cell: float, tol: float) -> LayersFit[S]:
        """The offset surfaces at `layers` for a cell edge in model units, to within `tol` (model units) if possible."""
        raise NotImplementedError

    def cover(self, fitted: S, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All patches with a part inside the box of `cells`, the lattice moved by `phase` (cells)."""
        raise NotImplementedError

    def natural(self, fitted: S, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """The patches of whole cells, moved by `phase` (cells)."""
        raise NotImplementedError

    def fill(self, fitted: S, cells: tuple[int, int, int], phase: Array, *, natural: bool) -> SplineVolumes | None:
        """Trivariate splines, in cells, that fill what `natural` or `cover` and the box bound; None if the box cuts walls."""
        raise NotImplementedError

    def mid_surface(
        self, cell: tuple[float, float, float], cells: tuple[int, int, int], phase: Array, map: Map | None
    ) -> SignedDistance:
        """Signed distances from the mid surface; without a map from that of the first cell, without phase.

        By default they are those from its level set, for surfaces without a patch in closed form.
        """
        return NormalDistance(fields.tpms(self.name, cell, reference=self.reference))

"""The source of a lattice: what fits the offset surfaces of a wall, places their copies and knows their mid surface.

A catalogued surface is made in one of three ways: of copies of an exact primitive patch, of reflections of a piece between
mirrors, or of patches fitted to one period of its nodal level set. A `LatticeSource` hides the difference; `lattice_source` is
the only function that chooses.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any, ClassVar, Protocol, TypeVar

import numpy as np

from tpmscad import surfaces
from tpmscad._typing import Array
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.offset_surfaces import Layers, LayersFit, PatchAssembly
from tpmscad.lattices.spline_volumes import SplineVolumes
from tpmscad.sources.exact_sources import CopiedPrimitive, ReflectedPieces
from tpmscad.sources.level_set_source import LevelSetSource
from tpmscad.sources.patched_surface import SignedDistance
from tpmscad.surfaces import MirrorSymmetry

CACHE_SIZE = 64
"""Sources kept: those of the catalogue with a few cells each."""

S = TypeVar("S")


class LatticeSource(Protocol[S]):
    """A surface of the catalogue as something that lattices are made of; S are its fitted surfaces.

    - `can_be_mapped`: whether the lattice may be deformed by a coordinate map, unequal cell edges included.
    - `follows_cell_edges`: whether the patches are those of a cell of unequal edges themselves, without a map.
    - `has_facing_patches`: whether the sides of a wall are copies of patches over one mid patch, so that splines may fill it.
    """

    can_be_mapped: ClassVar[bool]
    follows_cell_edges: ClassVar[bool]
    has_facing_patches: ClassVar[bool]

    def fit(self, layers: Layers, cell: float, tol: float) -> LayersFit[S]:
        """The offset surfaces at `layers` for a cell edge in model units, to within `tol` (model units) if possible."""

    def cover(self, fitted: S, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All patches with a part inside the box of `cells`, the lattice moved by `phase` (cells)."""

    def natural(self, fitted: S, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """The patches of whole cells, moved by `phase` (cells)."""

    def fill(self, fitted: S, cells: tuple[int, int, int], phase: Array, *, natural: bool) -> SplineVolumes | None:
        """Trivariate splines, in cells, that fill what `natural` or `cover` and the box bound; None if the box cuts walls."""

    def mid_surface(
        self, cell: tuple[float, float, float], cells: tuple[int, int, int], phase: Array, map: Map | None
    ) -> SignedDistance:
        """Signed distances from the mid surface; without a map from that of the first cell, without phase."""


@lru_cache(maxsize=CACHE_SIZE)
def lattice_source(
    name: str,
    reference: str,
    cell: tuple[float, float, float] = (1.0, 1.0, 1.0),
    levels: tuple[float, float] | None = None,
) -> LatticeSource[Any]:
    """The source of lattices of a catalogued surface, by its name and reference ("minimal" or "nodal").

    `cell` holds the edges of the cell, `levels` the nodal levels of the two sides of a wall if they are no offsets.
    """
    if surfaces.find_surface(name).primitives == "level set":
        x, y, z = (np.array(cell) / cell[0]).tolist()
        return LevelSetSource(name, (x, y, z), levels)
    symmetry = surfaces.surface_symmetry(name)
    if isinstance(symmetry, MirrorSymmetry):
        return ReflectedPieces(name, symmetry)
    return CopiedPrimitive(name, reference, symmetry)

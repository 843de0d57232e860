"""Where the patches of a lattice come from: copies of an exact primitive patch, or reflections of a piece between mirrors.

A catalogued surface is made in one of two ways, according to its symmetry. A `LatticeSource` hides the difference: it fits the
offset surfaces of a wall and places their copies. `lattice_source` is the only function that chooses between the two.

An assembly of patches is in cells. It is either closed, or open and then to be trimmed by a box of whole cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from tpmscad import surfaces
from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.lattices import copies
from tpmscad.lattices.mirror_fit import fit_mirror_pieces
from tpmscad.lattices.offset_surfaces import TOUCH_TOL_CELLS, OffsetSurfaces
from tpmscad.lattices.primitive import OffsetSurfacesFit, fit_offset_surfaces
from tpmscad.lattices.spline_volumes import SplineVolumes, copy_wall, wall_of_piece, wall_over_mid_patch
from tpmscad.surfaces import MirrorSymmetry, PatchSymmetry

Layers = tuple[float | None, float | None]
"""Signed normal distances of the lower and the upper surface in model units; None where there is no surface."""


@dataclass(frozen=True, slots=True, eq=False)
class PatchAssembly:
    """Placed patches, in cells, and the lower corner (3,) of the box that is to trim them; None if they are closed."""

    brep: Brep
    trim_corner: Array | None


class LatticeSource(Protocol):
    """A surface of the catalogue as something that lattices are made of."""

    @property
    def can_be_mapped(self) -> bool:
        """Whether the lattice may be deformed by a coordinate map, unequal cell edges included."""

    def fit(self, layers: Layers, cell: float, tol: float) -> OffsetSurfacesFit:
        """The offset surfaces at `layers` for a cell edge in model units, to within `tol` (model units) if possible."""

    def cover(self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All patches with a part inside the box of `cells`, the lattice moved by `phase` (cells)."""

    def natural(self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """The patches of whole cells, moved by `phase` (cells)."""

    def fill(
        self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array, *, natural: bool
    ) -> SplineVolumes | None:
        """Trivariate splines, in cells, that fill what `natural` or `cover` and the box bound; None if the box cuts walls."""


@dataclass(frozen=True, slots=True, eq=False)
class CopiedPrimitive:
    """A surface made of proper motions of one exact patch."""

    name: str
    reference: str
    symmetry: PatchSymmetry

    @property
    def can_be_mapped(self) -> bool:
        """True: every patch can be fitted anew to its image."""
        return True

    def fit(self, layers: Layers, cell: float, tol: float) -> OffsetSurfacesFit:
        """The offset surfaces, with rigorous bounds on their deviation from the exact patch."""
        return fit_offset_surfaces(self.name, self.reference, layers, cell, tol)

    def cover(self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All copies of the patch with a part inside the box."""
        return PatchAssembly(copies.cover_box(self.symmetry, offsets, cells, phase), np.zeros(3))

    def natural(self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """Closed by ruled gap faces along the boundary of the block."""
        placements = copies.place_whole_cells(self.name, cells, phase)
        return PatchAssembly(copies.build_natural_lattice(self.symmetry, offsets, placements), None)

    def fill(
        self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array, *, natural: bool
    ) -> SplineVolumes | None:
        """Copies of the wall over the mid patch."""
        if not natural:
            return None
        placements = copies.place_whole_cells(self.name, cells, phase)
        return copy_wall(wall_over_mid_patch(self.symmetry, offsets), placements, cells, "gap")


@dataclass(frozen=True, slots=True, eq=False)
class ReflectedPieces:
    """A surface made of reflections of one piece in the mirrors around it.

    A map would bend the mirrors, so these lattices cannot be mapped.
    """

    name: str
    symmetry: MirrorSymmetry

    @property
    def can_be_mapped(self) -> bool:
        """False: a map would bend the mirrors."""
        return False

    def fit(self, layers: Layers, cell: float, tol: float) -> OffsetSurfacesFit:
        """Without rigorous bounds: the reference surface is implicit."""
        lower, upper = (None if d is None else d / cell for d in layers)
        offsets, deviation, convergence = fit_mirror_pieces(self.name, (lower, upper), tol / cell)
        return OffsetSurfacesFit(offsets, deviation.scaled(cell), {}, convergence.scaled(cell))

    def cover(self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """The pieces in all tetrahedra with a part inside the box."""
        return PatchAssembly(copies.cover_box_by_reflection(self.symmetry, offsets, cells, phase), np.zeros(3))

    def natural(self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """Bounded by the mirrors around the block, which move with the phase: the box to trim by is flat there."""
        brep = copies.cover_box_by_reflection(self.symmetry, offsets, cells, phase, natural=True)
        return PatchAssembly(brep, phase)

    def fill(
        self, offsets: OffsetSurfaces, cells: tuple[int, int, int], phase: Array, *, natural: bool
    ) -> SplineVolumes | None:
        """Reflections of the wall of a piece; a box fits them if its planes are mirrors."""
        placements = copies.place_pieces(self.symmetry, cells, phase, natural=natural)
        corners = placements[:, None].apply(self.symmetry.edges.reshape(4, 3)) - natural * phase
        if corners.min() < -TOUCH_TOL_CELLS or (corners > np.array(cells) + TOUCH_TOL_CELLS).any():
            return None
        return copy_wall(wall_of_piece(offsets), placements, cells, "cap")


def lattice_source(name: str, reference: str) -> LatticeSource:
    """The source of lattices of a catalogued surface, by the name and the reference ("minimal" or "nodal") of the request."""
    symmetry = surfaces.surface_symmetry(name)
    if isinstance(symmetry, MirrorSymmetry):
        return ReflectedPieces(name, symmetry)
    return CopiedPrimitive(name, reference, symmetry)

"""Lattices of exact patches: copies of a primitive by proper motions, or reflections of a piece in the mirrors around it.

An assembly of patches is in cells. It is either closed, or open and then to be trimmed by a box of whole cells.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tpmscad import surfaces
from tpmscad._typing import Array
from tpmscad.lattices import copies
from tpmscad.lattices.coordinate_maps import Map, stretching
from tpmscad.lattices.mirror_fit import fit_mirror_pieces
from tpmscad.lattices.offset_surfaces import TOUCH_TOL_CELLS, Layers, LayersFit, OffsetSurfaces, PatchAssembly
from tpmscad.lattices.primitive import fit_offset_surfaces
from tpmscad.lattices.spline_volumes import SplineVolumes, copy_wall, wall_of_piece, wall_over_mid_patch
from tpmscad.sources.lattice_source import LatticeSource
from tpmscad.sources.patched_surface import PatchedSurface, SignedDistance
from tpmscad.surfaces import MirrorSymmetry, PatchSymmetry, SurfacePatch


@dataclass(frozen=True, slots=True, eq=False)
class CopiedPrimitive(LatticeSource[OffsetSurfaces]):
    """A surface made of proper motions of one exact patch."""

    name: str
    reference: str
    symmetry: PatchSymmetry

    can_be_mapped: ClassVar[bool] = True

    @property
    def patch(self) -> SurfacePatch:
        """The exact primitive patch, in cells."""
        return surfaces.primitive_patch(self.name, self.reference)

    def fit(self, layers: Layers, cell: float, tol: float) -> LayersFit[OffsetSurfaces]:
        """The offset surfaces, with rigorous bounds on their deviation from the exact patch."""
        return fit_offset_surfaces(self.name, self.reference, layers, cell, tol)

    def cover(self, fitted: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All copies of the patch with a part inside the box."""
        return PatchAssembly(copies.patches_over_box(self.symmetry, fitted, cells, phase), np.zeros(3))

    def natural(self, fitted: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """Closed by ruled gap faces along the boundary of the block."""
        placements = copies.place_whole_cells(self.name, cells, phase)
        return PatchAssembly(copies.build_natural_lattice(self.symmetry, fitted, placements), None)

    def fill(
        self, fitted: OffsetSurfaces, cells: tuple[int, int, int], phase: Array, *, natural: bool
    ) -> SplineVolumes | None:
        """Copies of the wall over the mid patch."""
        if not natural:
            return None
        placements = copies.place_whole_cells(self.name, cells, phase)
        return copy_wall(wall_over_mid_patch(self.symmetry, fitted), placements, cells, "gap")

    def mid_surface(
        self, cell: tuple[float, float, float], cells: tuple[int, int, int], phase: Array, map: Map | None
    ) -> SignedDistance:
        """Signed distances from the nearest copy of the patch."""
        counts, shift = ((1, 1, 1), np.zeros(3)) if map is None else (cells, phase - np.floor(phase))
        if map is None and len(set(cell)) > 1:
            map = stretching(tuple(edge / cell[0] for edge in cell))
        placements = copies.translate_motions(self.symmetry.cell_motions, copies.cell_origins(counts, 1) + shift)
        return PatchedSurface(self.patch, placements, cell[0], map)


@dataclass(frozen=True, slots=True, eq=False)
class ReflectedPieces(LatticeSource[OffsetSurfaces]):
    """A surface made of reflections of one piece in the mirrors around it.

    A map would bend the mirrors, so these lattices cannot be mapped.
    """

    name: str
    reference: str
    symmetry: MirrorSymmetry

    def fit(self, layers: Layers, cell: float, tol: float) -> LayersFit[OffsetSurfaces]:
        """The offset surfaces, without rigorous bounds: the reference surface is implicit."""
        return fit_mirror_pieces(self.name, layers, cell, tol, self.reference)

    def cover(self, fitted: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """The pieces in all tetrahedra with a part inside the box."""
        return PatchAssembly(copies.reflected_pieces_over_box(self.symmetry, fitted, cells, phase), np.zeros(3))

    def natural(self, fitted: OffsetSurfaces, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """Bounded by the mirrors around the block, which move with the phase: the box to trim by is flat there."""
        brep = copies.reflected_pieces_over_box(self.symmetry, fitted, cells, phase, natural=True)
        return PatchAssembly(brep, phase)

    def fill(
        self, fitted: OffsetSurfaces, cells: tuple[int, int, int], phase: Array, *, natural: bool
    ) -> SplineVolumes | None:
        """Reflections of the wall of a piece; a box fits them if its planes are mirrors."""
        placements = copies.place_pieces(self.symmetry, cells, phase, natural=natural)
        corners = placements[:, None].apply(self.symmetry.edges.reshape(4, 3)) - natural * phase
        if corners.min() < -TOUCH_TOL_CELLS or (corners > np.array(cells) + TOUCH_TOL_CELLS).any():
            return None
        return copy_wall(wall_of_piece(fitted), placements, cells, "cap")

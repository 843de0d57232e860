"""Lattices of the catalogued surfaces without exact patches: offsets of the level set, laid out over one period.

The surface {f = 0} has a symmetric quadrilateral mesh on one period (`levelset.periodic`), over which every offset surface is
fitted, one patch for each orbit of the isometries of f. A `LevelSetSource` places copies of them over a box like the sources
of exact patches (`exact_sources`); the box or the body cuts them in the same way.

Cells of unequal edges stretch the field; offsets are then measured along the normal of the stretched surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.brep.deviation import combine_deviations
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.lattices.copies import COVER_MARGIN_CELLS, weld_in_box
from tpmscad.lattices.offset_surfaces import (
    Layers,
    LayersFit,
    PatchAssembly,
    PlacedFaces,
    place_faces,
)
from tpmscad.levelset.periodic.periodic_fit import PeriodicFit
from tpmscad.levelset.periodic.periodic_layers import (
    fit_periodic_offset,
    make_periodic_layout,
    measure_offset_limits,
    patch_surfaces,
    place_copies_in_box,
)
from tpmscad.rigid_motion import Motion
from tpmscad.sources.lattice_source import LatticeSource
from tpmscad.splines.bspline import BSplineSurface

COARSEST_GRIDS: Mapping[str, tuple[int, float]] = {
    "lidinoid": (8, 0.0),
    "split_p": (8, 0.5),
    "fischer_koch_s": (8, 0.5),
    "octo": (7, 0.5),
}
"""Leaves to a period, and origin in leaves, of the coarsest grid that resolves the surface; others are searched for."""


LevelSetLayers = tuple[PeriodicFit | None, PeriodicFit | None]
"""The fits of the lower and the upper surface, in units of the first cell edge; None where there is no surface."""


@dataclass(frozen=True, slots=True)
class LevelSetSource(LatticeSource[LevelSetLayers]):
    """A catalogued surface as offsets of its level set; lengths in units of the first cell edge.

    `period` holds the cell edges in that unit. `levels`: values on the lower and upper surface instead of normal offsets.
    """

    name: str
    period: tuple[float, float, float]
    levels: tuple[float, float] | None = None
    reference: str = "nodal"

    follows_cell_edges: ClassVar[bool] = True
    has_facing_patches: ClassVar[bool] = False

    def fit(self, layers: Layers, cell: float, tol: float) -> LayersFit[LevelSetLayers]:
        """The surfaces at normal distances `layers` (model units), one patch of each orbit fitted to within `tol` if possible."""
        fits: list[PeriodicFit | None] = []
        for number, distance in enumerate(layers):
            if distance is None:
                fits.append(None)
            elif self.levels is None:
                grid = COARSEST_GRIDS.get(self.name) if len(set(self.period)) == 1 else None
                if grid is None:
                    self._check_stretched_offset(distance, cell)
                fits.append(fit_periodic_offset(self._field(0.0), distance / cell, tol / cell, grid))
            else:
                fits.append(fit_periodic_offset(self._field(self.levels[number]), 0.0, tol / cell))
        deviation = combine_deviations([f.deviation for f in fits if f is not None]).scaled(cell)
        lower, upper = fits
        return LayersFit((lower, upper), deviation)

    def cover(self, fitted: LevelSetLayers, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All copies of the patches with a part inside the box of `cells`."""
        period = np.array(self.period)
        size = np.array(cells) * period
        shift = (phase - np.floor(phase)) * period
        primitives: list[BSplineSurface] = []
        parts = []
        for fit, outward, tag in zip(fitted, (-1, 1), ("offset-", "offset+"), strict=True):
            if fit is None:
                continue
            patch, motion = place_copies_in_box(
                fit, -shift - COVER_MARGIN_CELLS, size - shift + COVER_MARGIN_CELLS, 0.0
            )
            motion = Motion(motion.rotation, motion.translation + shift)
            parts.append(place_faces(len(primitives) + patch, motion, outward * motion.handedness, tag))
            primitives += patch_surfaces(fit)
        return PatchAssembly(weld_in_box(primitives, PlacedFaces.concatenate(parts), size), np.zeros(3))

    def natural(self, fitted: LevelSetLayers, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """Refused: the patches do not end at a boundary of whole cells (`lattice_request` says so first)."""
        raise InvalidRequest(f"the {self.name} has no natural boundary: use boundary='box'")

    def _check_stretched_offset(self, distance: float, cell: float) -> None:
        """InvalidRequest if an offset of the stretched surface passes its radius of curvature."""
        low, high = (cell * limit for limit in measure_offset_limits(make_periodic_layout(self._field(0.0))))
        if not low < distance < high:
            raise InvalidRequest(
                f"offset {distance:g} (thickness {2 * abs(distance):g} if symmetric) passes the curvature radius of the "
                f"stretched {self.name}: offsets stay between {low:.4g} and {high:.4g}; thin the wall or enlarge the cell"
            )

    def _field(self, level: float) -> Field:
        """The field whose zero set is a level of the surface's function, one cell edge the unit of length."""
        function = fields.tpms(self.name, self.period, reference=self.reference)
        return function if level == 0 else function - level

"""Lattices of the catalogued surfaces without exact patches: offsets of the nodal level set, laid out over one period.

The surface {f = 0} has a symmetric quadrilateral mesh on one period (`levelset.torus_mesh`), over which every offset surface is
fitted, one patch for each orbit of the isometries of f. A `LevelSetSource` places copies of them over a box like the sources
of exact patches (`lattices.sources`); the box or the body cuts them in the same way.

Cells of unequal edges stretch the field; offsets are then measured along the normal of the stretched surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np

from tpmscad import fields
from tpmscad._typing import Array, BoolArray
from tpmscad.brep.deviation import Deviation, combine_deviations
from tpmscad.catalogue import find_surface
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import Field
from tpmscad.lattices.copies import midlines_in_box_planes, quarter_patch
from tpmscad.lattices.offset_surfaces import LATTICE_TAGS, TOUCH_TOL_CELLS, PlacedFaces
from tpmscad.lattices.sources import Layers, PatchAssembly, lattice_source
from tpmscad.levelset.periodic.periodic_fit import PeriodicFit
from tpmscad.levelset.periodic.periodic_layers import (
    fit_periodic_offset,
    make_periodic_layout,
    measure_offset_limits,
    patch_surfaces,
    place_copies_in_box,
)
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.splines.bspline import BSplineSurface
from tpmscad.splines.cpia import NetConvergence

COARSEST_GRIDS: Mapping[str, tuple[int, float]] = {
    "lidinoid": (8, 0.0),
    "split_p": (8, 0.5),
    "fischer_koch_s": (8, 0.5),
    "octo": (7, 0.5),
}
"""Leaves to a period, and origin in leaves, of the coarsest grid that resolves the surface; others are searched for."""


class SourceFit(Protocol):
    """Fitted surfaces of a lattice (`sheet`), their deviation, bounds and convergence in model units."""

    @property
    def sheet(self) -> Any:
        """The fitted surfaces, for the source that made them."""

    @property
    def deviation(self) -> Deviation:
        """Two-way deviation from the offset surfaces."""

    @property
    def bounds(self) -> Mapping[str, float]:
        """A-priori bounds on the deviation by name."""

    @property
    def convergence(self) -> NetConvergence:
        """What the iteration proves of the nets."""


class PatchSource(Protocol):
    """What lattices are made of; see `tpmscad.lattices.sources.LatticeSource`."""

    def fit(self, layers: Layers, cell: float, tol: float) -> SourceFit:
        """The offset surfaces at `layers` for a cell edge, to within `tol` if possible."""

    def cover(self, offsets: Any, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All patches with a part inside the box of `cells`."""

    def natural(self, offsets: Any, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """The patches of whole cells."""


@dataclass(frozen=True, slots=True, eq=False)
class LevelSetLayers:
    """The fits of the lower and the upper surface, in units of the first cell edge; None where there is no surface."""

    lower: PeriodicFit | None
    upper: PeriodicFit | None


@dataclass(frozen=True, slots=True, eq=False)
class LevelSetLayersFit:
    """Fitted layers, with their deviation from the offset surfaces and the greatest tangent jump, in model units and degrees."""

    sheet: LevelSetLayers
    deviation: Deviation
    bounds: Mapping[str, float] = field(default_factory=dict)
    convergence: NetConvergence = field(default_factory=lambda: NetConvergence(0, 0.0))


@dataclass(frozen=True, slots=True)
class LevelSetSource:
    """A catalogued surface as offsets of its nodal level set; lengths in units of the first cell edge.

    `period` holds the cell edges in that unit. `levels`: nodal values of the lower and upper surface instead of normal offsets.
    """

    name: str
    period: tuple[float, float, float]
    levels: tuple[float, float] | None = None

    @property
    def can_be_mapped(self) -> bool:
        """Whether the lattice may be deformed by a coordinate map."""
        return False

    def fit(self, layers: Layers, cell: float, tol: float) -> LevelSetLayersFit:
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
        return LevelSetLayersFit(LevelSetLayers(*fits), deviation)

    def cover(self, offsets: LevelSetLayers, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
        """All copies of the patches with a part inside the box of `cells`."""
        period = np.array(self.period)
        size = np.array(cells) * period
        shift = (phase - np.floor(phase)) * period
        primitives: list[BSplineSurface] = []
        parts = []
        for fit, outward, tag in ((offsets.lower, -1, "offset-"), (offsets.upper, 1, "offset+")):
            if fit is None:
                continue
            placed = place_copies_in_box(fit, -shift, size - shift, TOUCH_TOL_CELLS)
            motion = type(placed.motion)(placed.motion.rotation, placed.motion.translation + shift)
            tags = np.full(len(placed.patch), LATTICE_TAGS.index(tag))
            parts.append(PlacedFaces(len(primitives) + placed.patch, motion, outward * placed.sense, tags))
            primitives += patch_surfaces(fit)
        faces = PlacedFaces.concatenate(parts)
        if midlines_in_box_planes(tuple(primitives), faces, size):
            primitives = [quarter for primitive in primitives for quarter in quarter_patch(primitive)]
            faces = faces[np.repeat(np.arange(len(faces.carrier)), 4)]
            carrier = 4 * faces.carrier + np.tile(np.arange(4), len(faces.carrier) // 4)
            faces = PlacedFaces(carrier, faces.motion, faces.sense, faces.tag)
            faces = faces[_reaches_into_box(primitives, faces, size)]
        return PatchAssembly(faces.weld(primitives), np.zeros(3))

    def natural(self, offsets: LevelSetLayers, cells: tuple[int, int, int], phase: Array) -> PatchAssembly:
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
        """The field whose zero set is a level of the nodal function, one cell edge the unit of length."""
        nodal = fields.tpms(self.name, self.period)
        return nodal if level == 0 else nodal - level


def resolve_source(request: LatticeRequest) -> PatchSource:
    """The source of the patches of a request without a map."""
    if is_level_set_surface(request.surface):
        first = request.cell[0]
        x, y, z = (edge / first for edge in request.cell)
        return LevelSetSource(request.surface, (x, y, z), request.levels)
    return lattice_source(request.surface, request.reference)


def is_level_set_surface(name: str) -> bool:
    """Whether lattices of a surface are offsets of its nodal level set, for want of exact patches."""
    return find_surface(name).primitives == "level set"


def _reaches_into_box(primitives: list[BSplineSurface], faces: PlacedFaces, size: Array) -> BoolArray:
    """Whether the bounding box of each face's (n,) poles overlaps the box [0, size]."""
    inside = np.zeros(len(faces.carrier), bool)
    for number, primitive in enumerate(primitives):
        own = np.flatnonzero(faces.carrier == number)
        placed = faces.motion[own, None].apply(primitive.poles.reshape(-1, 3))
        low, high = placed.min(axis=1), placed.max(axis=1)
        inside[own] = ((high > TOUCH_TOL_CELLS) & (low < size - TOUCH_TOL_CELLS)).all(axis=1)
    return inside

"""The request for a lattice: what its options mean together, as one frozen value.

Each option is valid by itself. In a `LatticeRequest` they are consistent with each other, defaults that depend on
the surface are filled in, and a thickness or a volume fraction has become a pair of normal offsets.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace
from functools import partial
from typing import Any, TypeVar

import numpy as np
from scipy.spatial.transform import Rotation

from tpmscad import surfaces
from tpmscad._typing import Array, triple
from tpmscad.api.arguments import select_arguments
from tpmscad.api.public_calls import validate_options
from tpmscad.errors import InvalidRequest
from tpmscad.requests.lattice_options import FluidDomainsOptions, InfillOptions, LatticeOptions
from tpmscad.requests.wall_request import resolve_wall, solve_cell
from tpmscad.sources.catalogue_sources import lattice_source
from tpmscad.sources.lattice_source import LatticeSource
from tpmscad.sources.level_set_source import LevelSetSource

MIN_TOL = 2e-7
"""Model units: twice the distance of 1e-7 below which the kernel merges points."""

MIN_TOL_CELLS = 1e-7
"""In cells: the deviation that patches of degree 18 reach before round-off spoils the smoothness of their joints."""

DEFAULT_TOL_CELLS = 1e-3
"""In cells, of the smallest cell edge: the tolerance if none is given."""


OPTIONS_OF_FIELDS = {
    *("body", "box", "surface", "solid", "skin", "open_faces", "keep", "map", "clear", "loose", "tol", "progress")
}
"""Arguments of an infill that the solid of a field takes."""

T = TypeVar("T")

EXACT_ROTATION_TOL = 1e-15
"""A rotation matrix within this distance of one with entries -1, 0 and 1 becomes that matrix."""


@dataclass(frozen=True, slots=True)
class LatticeRequest:
    """A valid request for a lattice, in model units.

    `cell` holds the three edges, `cells` the counts, `offset` the normal distances of the two walls (sheet) or of the one surface
    twice (skeletal), `levels` the nodal levels of the two walls if they are no offsets of one surface, `notes` what the
    certificate says of the wall, `phase` the shift in cells, `tol` the greatest deviation. Of a graded wall `thickness` and
    `centre` are functions of points (n, 3) of the model: the offsets are multiples of the thickness, counted from the centre.
    """

    surface: str
    cell: tuple[float, float, float]
    cells: tuple[int, int, int]
    offset: tuple[float, float]
    kind: str
    side: str
    reference: str
    boundary: str
    phase: tuple[float, float, float]
    tol: float
    levels: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()
    thickness: Callable[[Array], Array] | None = None
    centre: Callable[[Array], Array] | None = None

    @property
    def is_graded(self) -> bool:
        """Whether the normal distances vary."""
        return self.thickness is not None or self.centre is not None

    @property
    def even_offset(self) -> tuple[float, float] | None:
        """The normal distances of the two walls, if they are the same everywhere."""
        return None if self.is_graded or self.levels is not None else self.offset

    def turned(self, rotation: Array) -> LatticeRequest:
        """The same wall in coordinates that `rotation` (3, 3) takes to those of the model."""
        thickness, centre = (f and partial(_evaluate_turned, f, rotation) for f in (self.thickness, self.centre))
        return replace(self, thickness=thickness, centre=centre)

    def require_even(self, instead: str) -> None:
        """InvalidRequest if the wall is graded, where cells are copied, with what to do `instead`."""
        if self.is_graded:
            raise InvalidRequest(f"the wall is graded, and no cell is a copy of another: give a number, or {instead}")

    @property
    def source(self) -> LatticeSource[Any]:
        """What the lattice is made of."""
        return lattice_source(self.surface, self.reference, self.cell, self.levels)

    @property
    def layer_offsets(self) -> tuple[float | None, float | None]:
        """Normal distances of the lower and the upper bounding surface; None where the solid has no wall on that side.

        The lower surface faces decreasing nodal values: it bounds a skeletal solid on the "+" side.
        """
        if self.kind == "sheet":
            return self.offset
        return (self.offset[0], None) if self.side == "+" else (None, self.offset[0])


def resolve_lattice_request(options: LatticeOptions) -> LatticeRequest:
    """The valid request of the options of `lattice`; InvalidRequest names the value, the limit and the remedy."""
    info = surfaces.find_surface(options.surface)
    name = info.name
    reference = options.reference or (info.references[0] if info.references else "minimal")
    surfaces.check_reference(info, reference)
    if options.kind == "sheet" and options.side == "+":
        raise InvalidRequest(
            "side='+' says which side of one surface is solid, but a sheet is the wall between two: leave `side` out, or give "
            "kind='skeletal'"
        )
    if options.kind == "skeletal" and options.boundary == "natural":
        raise InvalidRequest(
            "a skeletal solid has no natural boundary: nothing bridges one surface; use boundary='box'"
        )
    options = replace(options, surface=name, reference=reference)
    pore_notes: tuple[str, ...] = ()
    if options.pore_size is not None:
        cell, pore_notes = solve_cell(options)
    elif options.cell is not None:
        cell = options.cell
    else:
        raise InvalidRequest(f"a lattice of the {name} needs cell=, the edge length of its cell, or pore_size=")
    edges, counts = as_triple(cell), as_triple(options.cells)
    has_mapping = options.map is not None or len(set(edges)) > 1
    source = lattice_source(name, reference, edges)
    if isinstance(source, LevelSetSource):
        _check_level_set_request(info.title, options.boundary, options.map)
    elif has_mapping and not source.can_be_mapped:
        raise InvalidRequest(
            f"a map or unequal cell edges {list(edges)} bend the mirror planes of the {info.title}, between which its patches "
            "are made: give one cell edge and no map, or make a solid of the field with tpmscad.solidify, whose periods may be "
            "unequal and whose domain may be a spline map"
        )
    tol = DEFAULT_TOL_CELLS * min(edges) if options.tol is None else options.tol
    least = max(MIN_TOL, MIN_TOL_CELLS * min(edges))
    if tol < least:
        raise InvalidRequest(
            f"tol {tol:g} is below {least:g}, the least that float64 and the kernel's 1e-7 allow at cell {min(edges):g}; "
            "ask for more, or scale the model up"
        )
    wall = resolve_wall(options, edges[0], has_mapping)
    if not has_mapping and wall.thickness is None:
        for distance in wall.offset:
            surfaces.check_offset(name, reference, distance, edges[0])
    return LatticeRequest(
        name,
        edges,
        counts,
        wall.offset,
        options.kind,
        options.side,
        reference,
        options.boundary,
        _resolve_phase(info, options),
        tol,
        wall.levels,
        (*wall.notes, *pore_notes),
        wall.thickness,
        wall.centre,
    )


def _evaluate_turned(function: Callable[[Array], Array], rotation: Array, points: Array) -> Array:
    return function(points @ rotation.T)


read_lattice_request = validate_options(LatticeOptions, 'lattice("gyroid", cell=10, thickness=1)')(
    resolve_lattice_request
)
"""The same from the arguments of `lattice`, each validated by itself."""


def reject_lattice_options(options: InfillOptions) -> None:
    """InvalidRequest for keywords of a lattice together with a field, which defines the whole shape."""
    extra = [
        field.name
        for field in fields(InfillOptions)
        if field.name not in OPTIONS_OF_FIELDS and getattr(options, field.name) != field.default
    ]
    if extra:
        raise InvalidRequest(
            f"a field is taken as it is: leave {', '.join(extra)} out, and scale or turn the field itself"
        )


def lattice_in_body(options: InfillOptions | FluidDomainsOptions) -> LatticeOptions:
    """The lattice that fills a body, anchored at the origin of its coordinates; of an infill it has no phase by default."""
    given = select_arguments(options, LatticeOptions)
    if isinstance(options, InfillOptions):
        given["phase"] = options.phase or (0.0, 0.0, 0.0)
    return LatticeOptions(**given)


def as_triple(value: T | Sequence[T]) -> tuple[T, T, T]:
    """One value for each axis; a single value stands for three."""
    return triple(value if isinstance(value, Sequence) else (value,) * 3)


def _resolve_phase(info: surfaces.SurfaceRecord, options: LatticeOptions) -> tuple[float, float, float]:
    """The phase asked for; by default the one that makes one piece in a box, and none for whole patches or under a map."""
    if options.phase is not None:
        return as_triple(options.phase)
    if options.boundary == "natural" or options.map is not None:
        return 0.0, 0.0, 0.0
    return info.one_piece.phase_of(options.kind, options.side)


def _check_level_set_request(title: str, boundary: str, map: Any) -> None:
    """InvalidRequest for what a lattice of fitted level-set patches cannot have."""
    if map is not None:
        raise InvalidRequest(
            f"the patches of the {title} are fitted to one period and copied, which a map does not allow: "
            "make a solid of the field with tpmscad.solidify, whose `domain` takes a spline map of tpmscad.maps"
        )
    if boundary == "natural":
        raise InvalidRequest(
            f"the patches of the {title} do not end at a boundary of whole cells, so it has no natural one: "
            "use boundary='box'"
        )


def lattice_size(options: LatticeOptions) -> tuple[float, float, float]:
    """Edge lengths of the box of `cells` x `cell` that the lattice of these options fills."""
    cell = options.cell
    if cell is None:  # it follows from the pore size
        cell = resolve_lattice_request(options).cell
    return size_of_cells(cell, options.cells)


def size_of_cells(cell: float | Sequence[float], cells: int | Sequence[int]) -> tuple[float, float, float]:
    """Edge lengths of the box of `cells` x `cell`."""
    return triple(edge * count for edge, count in zip(as_triple(cell), as_triple(cells), strict=True))


def rotation_matrix(rotation: Sequence[float]) -> Array:
    """Matrix (3, 3) of intrinsic rotations about x, y and z, in degrees; quarter turns are exact."""
    matrix = Rotation.from_euler("XYZ", rotation, degrees=True).as_matrix()
    rounded = np.rint(matrix)
    return np.asarray(rounded if np.abs(matrix - rounded).max() < EXACT_ROTATION_TOL else matrix)

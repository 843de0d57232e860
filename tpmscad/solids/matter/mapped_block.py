"""Which patches a mapped lattice needs, and what trims them: whole cells, a box that the map keeps, or a body of revolution.

A lattice of natural boundary is a block of whole cells; along an axis after whose length the map repeats it has no end. With
boundary "box" the image of the box of the lattice trims it. It can do so if the map leaves its sides flat and square to the axes,
as a stretch or a grading does, or makes a body of revolution of it, as wraps around a cylinder and along the equator of a sphere
do: a tube, or a sector of one. On a dome the image of the cylinder inscribed in the box trims the lattice, to a round rim. Each
of these images bounds the lattice without overlap.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from tpmscad import surfaces
from tpmscad._typing import Array, triple
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, format_point
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.build.primitive_solids import revolve_profile
from tpmscad.lattices import copies, mapped_lattice, mapped_surface
from tpmscad.lattices.coordinate_maps import IDENTITY, Map, as_map, composition, stretching
from tpmscad.lattices.mapped_surface import MappedSurface, grading
from tpmscad.lattices.revolved_box import RevolvedBox, find_revolved_box, find_revolved_cylinder
from tpmscad.lattices.rounded_maps import round_over_cells
from tpmscad.lattices.self_contact import require_no_self_contact
from tpmscad.lattices.spline_maps import SplineMap
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.sources.exact_sources import CopiedPrimitive
from tpmscad.trimming.operands.polyhedra import box

MIN_WALL_THICKNESS = 1e-5
"""Model units: a hundred times the kernel's tolerance, at which the trimmed edges of the two walls are still distinct."""


def exact_source(request: LatticeRequest) -> CopiedPrimitive:
    """The source of a lattice under a map, which only copies of an exact patch can be."""
    source = request.source
    assert isinstance(source, CopiedPrimitive)
    return source


def compose_map(
    request: LatticeRequest, map: Map | Callable[[Array], Array] | None
) -> tuple[Map | None, tuple[str, ...]]:
    """The map from cubic lattice coordinates (cell = the first edge) to the model, None for copies of a patch, and notes."""
    stretch = None
    if len(set(request.cell)) > 1 and not request.source.follows_cell_edges:
        stretch = stretching(tuple(edge / request.cell[0] for edge in request.cell))
    if map is None:
        return (IDENTITY if stretch is None and request.is_graded else stretch), ()
    block = np.array(request.cell)
    notes: tuple[str, ...] = ()
    if isinstance(map, SplineMap):
        rounded = round_over_cells(map, request.cells, block, request.tol)
        wrap = rounded.map
        edges = " x ".join(f"{edge:.3g}" for edge in map.mean_edges() / request.cells)
        notes = (f"the {map.name} has cells of {edges} mm on average",)
        if rounded.moved > 0:
            notes += (f"it is rounded at its knots, by {rounded.moved:.2g} mm at most",)
        if map.face_error > 0:
            notes += (f"its ends are within {map.face_error:.2g} mm of the faces",)
    else:
        wrap = as_map(map).over_block(block * request.cells)
    return (wrap if stretch is None else composition(wrap, stretch, request.cell[0])), notes


def cover_mapped_lattice(request: LatticeRequest, surface: MappedSurface) -> tuple[MappedSurface, Brep | None]:
    """The mid surface over the patches that a lattice needs, and the body that trims them, if any.

    Limits are infinite along closed axes; a natural boundary has none. InvalidRequest if the box has no image to trim by.
    """
    map, symmetry = surface.map, surface.symmetry
    cell, phase = request.cell[0], np.array(request.phase)
    size = cell * np.array(request.cells, float)
    if request.boundary == "natural":
        mapped_surface.require_regular(map, mapped_surface.box_points(request.cells, cell), cell)
        closed = mapped_surface.find_closed_axes(map, request.cells, cell)
        placements = copies.place_whole_cells(request.surface, request.cells, phase, closed)
        return replace(surface, placements=placements, periods=_periods(request, closed)), None
    reach = find_greatest_offset(request, lambda: map(mapped_surface.box_points(request.cells, cell)))
    try:
        bounds = mapped_lattice.map_box(map, size)
    except InvalidRequest:
        revolved = find_revolved_box(map, size) or find_revolved_cylinder(map, size)
        if revolved is None:
            raise
    else:
        mapped_surface.require_regular(map, mapped_surface.box_points(request.cells, cell), cell)
        placements = mapped_lattice.select_placements_near_box(
            surface.patch, symmetry, map, bounds, np.zeros(3), request.cells, phase, cell, reach
        )
        return replace(surface, placements=placements, limits=(np.zeros(3), size)), box(*bounds)
    closed = triple(revolved.closed and axis == revolved.lattice_axis for axis in range(3))
    points = _points_inside(revolved, request)
    mapped_surface.require_regular(map, points, cell)
    least_stretch = float(np.linalg.svd(map.jacobian(points, cell), compute_uv=False).min())
    placements = mapped_lattice.select_placements_in_lattice(
        surface.patch, symmetry, request.cells, phase, reach / (cell * least_stretch), closed, revolved.inscribed / cell
    )
    open_ended = np.where(closed, np.inf, 0.0)
    body = revolve_profile(revolved.sides, revolved.straight, revolved.origin, revolved.axis, revolved.angle)
    limits, periods = (-open_ended, size + open_ended), _periods(request, closed)
    return replace(surface, placements=placements, periods=periods, limits=limits), brep_from_shape(body)


def find_greatest_offset(request: LatticeRequest, sample: Callable[[], Array]) -> float:
    """The greatest distance of the walls from the mid surface, in model units; of graded walls, at points (..., 3) near it."""
    if not request.is_graded:
        return float(np.abs(request.offset).max())
    unit, centre = grading(request.thickness, request.centre, sample())
    return float(np.abs([centre + d * unit for d in request.offset]).max())


def require_walls(surface: MappedSurface, request: LatticeRequest) -> None:
    """InvalidRequest if walls bend too sharply, meet, or have no thickness, over given placements."""
    if request.is_graded:
        _require_graded_walls(surface, request)
    if surface.map is IDENTITY:
        return
    mapped_lattice.require_offsets_below_curvature_radius(surface, request.offset, f"mapped {request.surface}")
    if request.kind == "sheet":
        require_no_self_contact(surface, request.offset)


def _require_graded_walls(surface: MappedSurface, request: LatticeRequest) -> None:
    """InvalidRequest where a graded wall has no thickness, or reaches farther than an even one may."""
    found, *gradings = surface.checked
    inside = surface.lie_within(found.lattice)
    points, unit, centre = (values[inside] for values in (found.position, *gradings))
    thin = np.flatnonzero(unit < MIN_WALL_THICKNESS)
    if surface.in_body is not None:
        thin = thin[surface.in_body(points[thin])]
    if len(thin):
        thinnest = int(thin[unit[thin].argmin()])
        raise InvalidRequest(
            f"the thickness {unit[thinnest]:g} at {format_point(points[thinnest], 6)} in the model is below "
            f"{MIN_WALL_THICKNESS:g}, a hundred times the kernel's tolerance, and must be positive all along the lattice: "
            "keep its values above that"
        )
    if surface.map is not IDENTITY or not len(points):
        return
    for multiple in request.offset:
        distances = centre + multiple * unit
        for worst in (int(distances.argmin()), int(distances.argmax())):
            try:
                surfaces.check_offset(request.surface, request.reference, float(distances[worst]), surface.cell)
            except InvalidRequest as error:
                raise InvalidRequest(f"{error}; so far the wall reaches at {format_point(points[worst], 6)}") from None


def _points_inside(revolved: RevolvedBox, request: LatticeRequest) -> Array:
    """Lattice points of the box, or of the cylinder that is inscribed in it."""
    cell = request.cell[0]
    points = mapped_surface.box_points(request.cells, cell)
    if revolved.lattice_axis is not None:
        return points
    x, y = cell * request.cells[0] / 2, cell * request.cells[1] / 2
    return points[np.hypot(points[:, 0] - x, points[:, 1] - y) <= revolved.inscribed]


def _periods(request: LatticeRequest, closed: tuple[bool, bool, bool]) -> tuple[float, float, float]:
    return triple(float(n) if c else 0.0 for n, c in zip(request.cells, closed, strict=True))

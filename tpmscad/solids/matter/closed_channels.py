"""Walls that close the channels of a heat exchanger at the faces of a body where they must not open.

Let D be the signed distance from the mid surface and [a, b] the offsets of the wall. The channel + is {D > b + C+}, the channel
- {D < a - C-}, and the wall what lies between. C+ vanishes deep in the body and grows, towards each face where the channel +
must not open, to the greatest value of D: no channel is left there. With the depth t below face i and the quintic step s from 1
at t <= skin to 0 at t >= skin + transition,

    C = H (1 - prod_i (1 - s_i)),

which is twice continuously differentiable where depths are, is nowhere below any single term, and never exceeds H. Since C >= 0
the wall contains {a <= D <= b}, so that the channels are nowhere nearer to each other than b - a, and since C = H next to a
closed face they stay the skin away from it.

The distance is smooth up to the reach of the surface only; farther off its place is taken by an affine function of the surface's
own function f. D is tabulated as a periodic cubic spline, which costs a fiftieth of a search for foot points.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.ndimage import spline_filter1d

from tpmscad._typing import Array, triple
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces, select_spline_faces
from tpmscad.brep.carriers import CylindricalSurface, Plane, SphericalSurface
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import InvalidRequest
from tpmscad.fields.field import ConstantField, Field
from tpmscad.fields.kinds.booleans import intersection
from tpmscad.fields.kinds.coordinate_transforms import AffineTransformedField
from tpmscad.fields.kinds.implicit_bspline import ImplicitBSpline
from tpmscad.fields.kinds.nodal_field import NodalField
from tpmscad.fields.kinds.normal_distance import NormalDistance, signed_distances
from tpmscad.fields.kinds.primitive_regions import CylinderRegion, HalfSpaceRegion, SphereRegion
from tpmscad.fields.kinds.ramps import RampField
from tpmscad.kernel.body_import._body_field import tabulate_face_distance
from tpmscad.kernel.body_import.cad_body import CadBody
from tpmscad.kernel.measure.shape_sampling import FaceSamples, sample_faces
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.kernel.recognise.edge_curves import UnsupportedFace
from tpmscad.kernel.recognise.face_carriers import recognise_carrier
from tpmscad.requests.channel_openings import ChannelOpenings
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.results.certificate import require
from tpmscad.solids.matter.field_matter import expand_body_box
from tpmscad.solids.matter.field_patches import fit_field_patches
from tpmscad.solids.matter.lattice_block import LatticeBlock
from tpmscad.solids.matter.patch_measures import measure_field_patches, move_patch_measures
from tpmscad.solids.matter.reference_distance import field_distance
from tpmscad.stage_timer import StageTimer

MAX_SLOPE = 1.0
"""Greatest growth of the wall's half thickness per length of the transition: its side then turns by at most 45 degrees."""

QUINTIC_SLOPE = 1.875
"""Greatest slope of the quintic step from 0 to 1 over a unit length."""

HEIGHT_MARGIN = 1.02
"""The wall reaches this multiple of what fills the channel, so that the last of it closes before the step is flat."""

N_PERIOD_POINTS = 12_000
"""Points in the period, of which those near the surface are its samples."""

SAMPLE_DEPTH_CELLS = 0.04
"""In cells: distance within which those points are projected onto the surface."""

REACH_STEP_CELLS = 0.005
SHELL_REACH_FRACTION = 0.95
"""Steps in which the reach is sought, and the fraction of it up to which the distance is used."""

DISTANCE_RTOL = 1e-6
"""In cells: error of a distance that shows that the foot point is another one: the offset exceeds the reach."""

WALL_MARGIN = 1.05
"""The distance is exact up to this multiple of the wall's offset."""

TABLE_SIZES = (48, 64, 96, 128)
"""Samples of a table of distances along each period."""

MAX_TABLE_TOLS = 0.2
"""Error of the table near the wall, in tolerances, from which a finer one is not made."""

MAX_DEAD_END_FRACTION = 0.1
"""Area of a sheet, relative to the greatest on its side of the wall, up to which it bounds a dead end that becomes wall: with a
hundredth, dimples at the openings of boxes of two cells stay as pieces through which nothing flows."""

TABLE_STEPS_PER_TRANSITION = 8
"""Samples of the distance to a face that is neither plane, cylinder nor sphere, along the transition."""

FACE_SAMPLES = 40
"""Samples of a face of mean area."""

ON_FACE_DIAGONALS = 1e-6
"""In diagonals of the body: distance at which samples lie on a plane or quadric."""


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedDistance:
    """A field that is the distance from a mid surface near the wall and grows through both channels; lengths in model units.

    `error`: of the field near the wall. `low`, `high`: its extremes.
    """

    field: Field
    error: float
    low: float
    high: float


def build_closed_block(
    request: LatticeRequest,
    rotation: Array,
    body: CadBody,
    openings: ChannelOpenings,
    transition: float | None,
    skin: float | None,
    stages: StageTimer,
) -> LatticeBlock:
    """The wall around a body, closed for each channel towards the faces that it does not open at.

    InvalidRequest if the wall cannot have this thickness, or the transition is too short.
    """
    if request.levels is not None:
        raise InvalidRequest(
            "openings close a wall between two offsets of a surface, and this one lies between two levels: give thickness="
        )
    request.require_even("leave openings out")
    thickness = float(np.ptp(request.offset))
    length = max(request.cell) if transition is None else transition
    depth = thickness if skin is None else skin
    with stages("fit"):
        distance = extend_distance(request)
    heights = distance.high - request.offset[1], request.offset[0] - distance.low
    height = HEIGHT_MARGIN * max(heights)
    if QUINTIC_SLOPE * height > MAX_SLOPE * length:
        raise InvalidRequest(
            f"transition {length:g} is too short: a wall of {thickness:g} would close the channels at more than 45 degrees; "
            f"give at least {QUINTIC_SLOPE * height / MAX_SLOPE:.3g}, or a smaller cell"
        )
    placed = distance.field
    if (rotation != np.eye(3)).any():
        rows = [triple(row.tolist()) for row in rotation.T]
        placed = AffineTransformedField(placed, triple(rows), (0.0, 0.0, 0.0), 1.0)
    samples = _sample_body(body)
    closings = [
        HEIGHT_MARGIN * each * (1.0 - _open_fraction(body, samples, opened, depth, length))
        for each, opened in zip(heights, (openings.plus, openings.minus), strict=True)
    ]
    wall = intersection(
        placed - request.offset[1] - closings[0], request.offset[0] - placed - closings[1]
    )  # positive in the channels
    low, high = expand_body_box(*enclosing_box(body.shape))
    found = fit_field_patches(wall, low, high, request.tol - distance.error, stages)
    measures = move_patch_measures(measure_field_patches(found), distance.error)
    closed = require(found.properties.closed, "the patches of the closed wall do not close in the body's box")
    patches = _tag_sides(select_spline_faces(found.fitted.brep), placed, sum(request.offset) / 2)
    patches, notes = _drop_loose_sheets(patches)
    return LatticeBlock(
        f"{request.surface} exchanger",
        patches,
        replace(
            measures,
            tol=request.tol,
            reference=f"{request.reference} {request.surface} surface and its closings",
            checks=(*measures.checks, closed),
            notes=(
                *measures.notes,
                *request.notes,
                f"each channel closes over {length:g} towards the faces where it does not open, behind {depth:g} of wall; "
                f"channels are at least {thickness:g} apart, less twice the deviation",
                *notes,
            ),
        ),
        field_distance(wall),
        lambda: found.fitted.brep,
        closes_channels=True,
    )


def extend_distance(request: LatticeRequest) -> ExtendedDistance:
    """The distance from the mid surface of a wall, continued through both channels; InvalidRequest if the wall is too thick."""
    f = NodalField(request.surface, request.cell, request.phase, request.reference)
    edge = min(request.cell)
    feet, normals = _sample_mid_surface(f, edge)
    exact = NormalDistance(f)
    field: Field = exact
    for side, offset in ((1.0, request.offset[1]), (-1.0, request.offset[0])):
        reach = SHELL_REACH_FRACTION * _find_reach(exact, feet, normals, side, edge)
        first = max(WALL_MARGIN * side * offset, REACH_STEP_CELLS * edge)
        heights = np.linspace(first, max(reach, first), 9)
        values = np.array([side * f(feet + side * h * normals) for h in heights])
        start, end = float(values[0].max()), float(values[-1].min())
        if not first < reach or not start < end:
            raise InvalidRequest(
                f"a wall that reaches {side * offset:.3g} from the {request.surface} is too thick for openings: its distance is "
                f"smooth up to {reach:.3g} only; use a thinner wall or a larger cell"
            )
        slope, base = np.polyfit(values.ravel(), np.repeat(heights, len(feet)), 1)
        base = max(float(base), first - float(slope) * start)
        weight = RampField(f, side * start, side * end, 0.0, 1.0, True)
        outer = float(slope) * f + side * base
        field = field * (1.0 - weight) + outer * weight
    return _tabulate_distance(field, exact, feet, normals, request)


def _sample_mid_surface(f: NodalField, edge: float) -> tuple[Array, Array]:
    """Points (n, 3) of {f = 0} in a period, and the unit normals there."""
    points = np.random.default_rng(0).uniform(size=(N_PERIOD_POINTS, 3)) * np.array(f.period)
    value, gradient = f.value_and_gradient(points)
    near = np.abs(value) < SAMPLE_DEPTH_CELLS * edge * np.linalg.norm(gradient, axis=1)
    distance, *normal = signed_distances(f, points[near].T)
    normals = np.stack(normal, axis=1)
    return points[near] - distance[:, None] * normals, normals


def _find_reach(exact: Field, feet: Array, normals: Array, side: float, edge: float) -> float:
    """The distance up to which points on the normals have these feet, in steps, model units."""
    reach, step = 0.0, REACH_STEP_CELLS * edge
    while reach < edge:
        points = feet + side * (reach + step) * normals
        if (np.abs(exact(points) - side * (reach + step)) > DISTANCE_RTOL * edge).any():
            break
        reach += step
    return reach


def _tabulate_distance(
    field: Field, exact: Field, feet: Array, normals: Array, request: LatticeRequest
) -> ExtendedDistance:
    """The field as a periodic spline, measured on both sides of the wall; InvalidRequest if it misses half the tolerance."""
    period = request.cell
    error = np.inf
    sides = [offset + part * np.ptp(request.offset) for offset in request.offset for part in (-0.02, 0.0, 0.02)]
    for count in TABLE_SIZES:
        axes = [np.arange(count) * (length / count) for length in period]
        values = coefficients = field.on_grid(*axes)
        for axis in range(3):
            coefficients = spline_filter1d(coefficients, 3, axis=axis, mode="grid-wrap")
        table = ImplicitBSpline(coefficients, period)
        error = max(float(np.abs(table(feet + side * normals) - side).max()) for side in sides)
        if error <= MAX_TABLE_TOLS * request.tol:
            break
    if error > 0.5 * request.tol:
        raise InvalidRequest(
            f"tol {request.tol:g} is too small for openings: the distance from the {request.surface} is known to {error:.2g} "
            f"only; give at least {2 * error:.2g}"
        )
    return ExtendedDistance(table, error, float(values.min()) - error, float(values.max()) + error)


def _sample_body(body: CadBody) -> FaceSamples:
    """Samples of the faces of a body."""
    own = faces_of(body.shape)
    return sample_faces(own, float((body.report.area / (FACE_SAMPLES * len(own))) ** 0.5))


def _open_fraction(body: CadBody, samples: FaceSamples, opened: frozenset[int], depth: float, length: float) -> Field:
    """The product of a step for each face that is not open: 1 deep in the body, 0 within `depth` of such a face."""
    result: Field | None = None
    covered: set[int] = set()
    for number, face in enumerate(faces_of(body.shape)):
        if number in opened or number in covered:
            continue
        surface = _find_exact_distance(body, samples, number, opened)
        margin = 0.0
        if surface is None:
            spacing = length / TABLE_STEPS_PER_TRANSITION
            surface, margin = -tabulate_face_distance(body, face, spacing), 0.25 * spacing
        else:
            covered |= _find_faces_on(body, samples, surface)
        step = RampField(surface, -(depth + margin + length), -(depth + margin), 1.0, 0.0, True)
        result = step if result is None else result * step
    return ConstantField(1.0) if result is None else result


def _find_exact_distance(body: CadBody, samples: FaceSamples, number: int, opened: frozenset[int]) -> Field | None:
    """The distance to a plane, cylinder or sphere, negative in the body; None if the body or an opening lies on it elsewhere."""
    diagonal = float(np.linalg.norm(np.ptp(samples.points, axis=0)))
    try:
        carrier = recognise_carrier(faces_of(body.shape)[number], diagonal)
    except UnsupportedFace:
        return None
    origin = triple(carrier.origin.tolist())
    normal = triple(carrier.normal.tolist()) if isinstance(carrier, Plane) else None
    surface: Field
    if normal is not None:
        surface = HalfSpaceRegion(origin, normal)
    elif isinstance(carrier, CylindricalSurface):
        surface = CylinderRegion(origin, triple(carrier.axis.tolist()), carrier.radius, None)
    elif isinstance(carrier, SphericalSurface):
        surface = SphereRegion(origin, carrier.radius)
    else:
        return None
    own = samples.face == number
    outward = np.einsum("ni,ni->n", surface.gradient(samples.points[own]), samples.normals[own])
    if outward.sum() < 0:
        surface = -surface
    is_outside = surface(samples.points) > ON_FACE_DIAGONALS * diagonal
    if is_outside.any() or _find_faces_on(body, samples, surface) & opened:
        return None
    return surface


def _find_faces_on(body: CadBody, samples: FaceSamples, surface: Field) -> set[int]:
    """The numbers of the faces whose samples lie on {surface = 0}."""
    diagonal = float(np.linalg.norm(np.ptp(samples.points, axis=0)))
    off = np.abs(surface(samples.points)) > ON_FACE_DIAGONALS * diagonal
    return set(np.unique(samples.face).tolist()) - set(samples.face[off].tolist())


def _tag_sides(patches: Brep, distance: Field, middle: float) -> Brep:
    """The patches with the tag of the side of the wall that each face is."""
    points = patches.vertices[patches.edges.start[patches.uses.edge]]
    first = np.unique(patches.face_of_use, return_index=True)[1]
    is_lower = distance(points[first]) < middle
    return replace(patches, faces=replace(patches.faces, tag=is_lower.astype(np.int64)), tags=("offset+", "offset-"))


def _drop_loose_sheets(patches: Brep) -> tuple[Brep, tuple[str, ...]]:
    """The patches without the sheets that closing channels leave round pockets and dead ends, and a note on these.

    A sheet without a boundary surrounds a pocket, which no fluid enters; others bound a dead end at an opening if they are small.
    """
    count, sheet = connectivity.label_shells(patches)
    area = np.bincount(sheet, integral_properties.integrate_faces(patches).area, count)
    side = np.zeros(count, np.int64)
    side[sheet] = patches.faces.tag
    n_uses = np.bincount(patches.uses.edge, minlength=len(patches.edges))
    is_open = np.zeros(count, bool)
    is_open[sheet[patches.face_of_use[n_uses[patches.uses.edge] == 1]]] = True
    greatest = np.array([area[side == number].max(initial=0.0) for number in (0, 1)])
    is_loose = (~is_open & (area < greatest[side])) | (area < MAX_DEAD_END_FRACTION * greatest[side])
    if not is_loose.any():
        return patches, ()
    kept = drop_unused_geometry(select_faces(patches, np.flatnonzero(~is_loose[sheet])))
    what = f"{is_loose.sum()} pockets or dead ends" if is_loose.sum() > 1 else "a pocket or dead end"
    note = f"{what} that the closing channels left apart, of area up to {area[is_loose].max():.3g} mm2, became wall"
    return kept, (note,)

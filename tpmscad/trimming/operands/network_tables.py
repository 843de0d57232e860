"""The faces and edges of a network of patches, in flat tables that compiled loops read.

Surfaces are polynomials in space (`patch_polynomials`), placed by the motions of their faces. They are divided into *cells*
(`patch_cells`), edges into *pieces*, each with bounds of its points.
"""

from __future__ import annotations

from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tpmscad._compiled_loops import njit_cached, njit_inner
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.operands.edge_uses import list_spline_curves, sample_loops
from tpmscad.trimming.operands.patch_cells import CELLS_PER_SIDE, divide_patches
from tpmscad.trimming.operands.patch_polynomials import (
    BREAK_U,
    BREAK_V,
    COEFFICIENT,
    DEGREE_U,
    DEGREE_V,
    PLANAR,
    SENSE,
    SPANS_U,
    SPANS_V,
    PatchPolynomials,
    as_spline,
    find_starts,
    stack,
)

BOX_PAIRS_AT_ONCE = 1_000_000
"""Pairs of boxes that are compared at once, a megabyte of answers."""

ROUNDOFF = 1e-12
"""Enlargement of the bounds of cells, relative to the distance of the face from the origin."""


class FaceCells(NamedTuple):
    """The cells of F faces.

    Attributes
    ----------
    first : (F + 1,)
        Where the cells of a face start.
    middle, half : (N, 2)
        Middle and half of the parameter ranges of a cell.
    centre : (N, 3)
        Its point at the middle.
    radius : (N,)
        Greatest distance of its points from that.
    bend : (N, 3)
        Bounds of |S_uu|, |S_uv| and |S_vv| in units of the half ranges.
    normal : (N, 3)
        The mean direction of S_u x S_v, of unit length.
    turn : (N,)
        Bound of the length by which unit normals differ from that, 2 where the patch may be singular.
    """

    first: IntArray
    middle: Array
    half: Array
    centre: Array
    radius: Array
    bend: Array
    normal: Array
    turn: Array


class FaceRegions(NamedTuple):
    """The loops of F faces as polygons: face f has the segments (2, 2) in (u, v) from first[f] to first[f + 1] - 1."""

    first: IntArray
    segments: Array


class NetworkFaces(NamedTuple):
    """F faces of a network: surfaces, cells, regions, and the corners (F, 3) of boxes that contain the surfaces."""

    patches: PatchPolynomials
    cells: FaceCells
    regions: FaceRegions
    low: Array
    high: Array


class NetworkEdges(NamedTuple):
    """E edges of a network, a named tuple, which compiled functions take.

    Attributes
    ----------
    first_piece : (E + 1,)
        Where the pieces of an edge start, in the order of its parameter.
    middle, half : (N,)
        Middle and half of a piece's parameter range.
    coefficients : (N, D, 3)
        Monomials of a piece in a parameter on [-1, 1], model units.
    radius : (N,)
        Greatest distance from its middle.
    bend : (N, 3)
        Bounds of the coordinates of its second derivative.
    low, high : (E, 3)
        Corners of a box that contains the edge.
    """

    first_piece: IntArray
    middle: Array
    half: Array
    coefficients: Array
    radius: Array
    bend: Array
    low: Array
    high: Array


def tabulate_faces(brep: Brep, near: IntArray | None = None, cell_size: float = np.inf) -> NetworkFaces:
    """The faces of a network. Those that are not among `near` (n,), if it is given, have no cells, no loops and no box.

    cell_size: length of cells, model units, above which faces are divided into more than `CELLS_PER_SIDE`.
    """
    faces = brep.faces
    rows = np.arange(len(faces)) if near is None else near
    polygons = sample_loops(brep, rows)
    surfaces, own_surface = _list_surfaces(brep, rows, polygons)
    divided = divide_patches(surfaces, cell_size)
    cells = [divided[i] for i in own_surface.tolist()]
    motion = faces.motion[rows]
    count = np.array([len(own.radius) for own in cells], np.int64)
    owner = np.repeat(np.arange(len(cells)), count)
    placed = [(own.coefficients @ motion.rotation[i].T).reshape(-1, 3) for i, own in enumerate(cells)]
    for i, own in enumerate(cells):  # the constant terms alone move with the translation
        nu, nv, p, q = own.coefficients.shape[:4]
        placed[i].reshape(nu, nv, p, q, 3)[:, :, 0, 0] += motion.translation[i]
    sizes = np.array([p.size for p in placed], np.int64)
    centre = motion[owner].apply(stack([own.centre for own in cells], 3))
    radius = stack([own.radius for own in cells])
    radius = radius + ROUNDOFF * np.abs(centre).max(axis=1, initial=0.0)
    breaks = [b for own in cells for b in own.breaks]
    layout = np.zeros((len(faces), PLANAR + 1), np.int64)
    layout[rows, DEGREE_U : DEGREE_V + 1] = np.array([c.coefficients.shape[2:4] for c in cells]).reshape(-1, 2) - 1
    layout[rows, SPANS_U : SPANS_V + 1] = np.array([c.coefficients.shape[:2] for c in cells]).reshape(-1, 2)
    layout[rows, BREAK_U : BREAK_V + 1] = find_starts([len(b) for b in breaks])[:-1].reshape(-1, 2)
    layout[rows, COEFFICIENT] = np.cumsum(sizes) - sizes
    layout[:, SENSE] = faces.sense
    layout[:, PLANAR] = np.array([isinstance(c, Plane) for c in brep.carriers], bool)[faces.carrier]
    first_cell = find_starts(_spread(count, rows, len(faces)))
    low, high = bound_groups(centre - radius[:, None], centre + radius[:, None], first_cell)
    return NetworkFaces(
        PatchPolynomials(layout, stack(breaks), stack([p.ravel() for p in placed])),
        FaceCells(
            first=first_cell,
            middle=stack([own.middle for own in cells], 2),
            half=stack([own.half for own in cells], 2),
            centre=centre,
            radius=radius,
            bend=stack([own.bend for own in cells], 3),
            normal=motion[owner].apply_to_vectors(stack([own.normal for own in cells], 3)),
            turn=stack([own.turn for own in cells]),
        ),
        FaceRegions(
            find_starts(_spread([len(p) for p in polygons], rows, len(faces))),
            np.concatenate([np.zeros((0, 2, 2)), *polygons]),
        ),
        low=low,
        high=high,
    )


def bound_faces(brep: Brep) -> tuple[Array, Array]:
    """Corners (F, 3) of boxes that contain the faces, by the poles of their surfaces."""
    faces = brep.faces
    others = np.flatnonzero([not isinstance(brep.carriers[c], BSplineSurface) for c in faces.carrier.tolist()])
    polygons = dict(zip(others.tolist(), sample_loops(brep, others), strict=True))
    rows = np.arange(len(faces))
    surfaces, own = _list_surfaces(brep, rows, [polygons.get(f, _NO_SEGMENTS) for f in rows.tolist()])
    low, high = np.empty((len(faces), 3)), np.empty((len(faces), 3))
    order = np.argsort(own, kind="stable")
    for members in np.split(order, np.cumsum(np.bincount(own, minlength=1))[:-1]):
        surface = surfaces[int(own[members[0]])]
        poles = surface.poles
        if surface.poles.shape[:2] == (
            surface.degree_u + 1,
            surface.degree_v + 1,
        ):  # nets of its quarters: its own may be twice as large as the surface
            poles = _halving(surface.degree_v) @ np.tensordot(_halving(surface.degree_u), poles, 1)
        points = faces.motion[members][:, None].apply(poles.reshape(-1, 3))
        low[members], high[members] = points.min(axis=1), points.max(axis=1)
    return low, high


@lru_cache(maxsize=32)
def _halving(degree: int) -> Array:
    """Bezier poles -> those of both halves, (2 degree + 2, degree + 1), by de Casteljau's algorithm."""
    left = np.array([[comb(k, j) / 2.0**k for j in range(degree + 1)] for k in range(degree + 1)])
    return np.concatenate([left, left[::-1, ::-1]])


def _list_surfaces(brep: Brep, rows: IntArray, polygons: list[Array]) -> tuple[list[BSplineSurface], IntArray]:
    """The surfaces of the faces `rows` (n,) as splines, and the number (n,) of each one's own; polygons: their loops."""
    surfaces: list[BSplineSurface] = []
    number: dict[int, int] = {}
    own = np.empty(len(rows), np.int64)
    for i, c in enumerate(brep.faces.carrier[rows].tolist()):
        carrier = brep.carriers[c]
        if isinstance(carrier, BSplineSurface):
            own[i] = number.setdefault(c, len(surfaces))
            if own[i] == len(surfaces):
                surfaces.append(carrier)
            continue
        own[i] = len(surfaces)
        surfaces.append(as_spline(carrier, polygons[i].reshape(-1, 2)))
    return surfaces, own


_NO_SEGMENTS = np.zeros((0, 2, 2))


def _spread(values: ArrayLike, rows: IntArray, n: int) -> IntArray:
    """Values of rows (m,) among n, others 0."""
    result = np.zeros(n, np.int64)
    result[rows] = values
    return result


def bound_groups(low: Array, high: Array, first: IntArray) -> tuple[Array, Array]:
    """Corners (n, 3) of the boxes of groups of boxes, which start at `first` (n + 1,); of none, inside out and infinite."""
    n = len(first) - 1
    found = np.full((n, 3), np.inf), np.full((n, 3), -np.inf)
    full = np.flatnonzero(np.diff(first) > 0)
    if len(full):
        found[0][full] = np.minimum.reduceat(low, first[full])
        found[1][full] = np.maximum.reduceat(high, first[full])
    return found


def join_faces(first: NetworkFaces, second: NetworkFaces) -> NetworkFaces:
    """The faces of two networks as one table, those of the second behind the first's: half the arguments of compiled loops."""
    both = (first, second)
    layout = [p.layout.copy() for p in (first.patches, second.patches)]
    layout[1][:, [BREAK_U, BREAK_V]] += len(first.patches.breaks)
    layout[1][:, COEFFICIENT] += len(first.patches.coefficients)
    cells = (np.concatenate(columns) for columns in zip(*(own.cells[1:] for own in both), strict=True))
    return NetworkFaces(
        PatchPolynomials(
            np.concatenate(layout),
            np.concatenate([own.patches.breaks for own in both]),
            np.concatenate([own.patches.coefficients for own in both]),
        ),
        FaceCells(_join_starts(*(own.cells.first for own in both)), *cells),
        FaceRegions(
            _join_starts(*(own.regions.first for own in both)), np.concatenate([own.regions.segments for own in both])
        ),
        *(np.concatenate(columns) for columns in zip(*(own[3:] for own in both), strict=True)),
    )


def _join_starts(first: IntArray, second: IntArray) -> IntArray:
    """The starts of parts that follow each other."""
    return np.concatenate([first, first[-1] + second[1:]])


def tabulate_edges(brep: Brep, near: IntArray | None = None) -> NetworkEdges:
    """The edges of a network. Those that are not among `near` (n,), if it is given, have no pieces and no box."""
    edges = brep.edges
    rows = np.arange(len(edges)) if near is None else near
    table = tabulate_segments(list_spline_curves(brep), edges.curve[rows], edges.motion[rows], edges.span[rows])
    first = find_starts(_spread(np.diff(table.first_piece), rows, len(edges)))
    low, high = np.full((len(edges), 3), np.inf), np.full((len(edges), 3), -np.inf)
    low[rows], high[rows] = table.low, table.high
    return table._replace(first_piece=first, low=low, high=high)


def tabulate_segments(curves: tuple[BSplineCurve, ...], curve: IntArray, motion: Motion, span: Array) -> NetworkEdges:
    """Segments of placed curves (n,), over spans (n, 2), as a table of edges."""
    n = len(curve)
    rows, row = np.unique(np.column_stack([curve, span]), axis=0, return_inverse=True)
    cuts = [_cut_into_pieces(curves[int(c)], low, high) for c, low, high in rows.tolist()]
    row = row.ravel()
    count = np.array([len(c) - 1 for c in cuts], np.int64)
    first_of_row = np.concatenate([[0], np.cumsum(count)])
    middle = np.concatenate([np.zeros(0), *(0.5 * (c[1:] + c[:-1]) for c in cuts)])
    half = np.concatenate([np.zeros(0), *(0.5 * np.diff(c) for c in cuts)])
    of_piece = np.repeat(rows[:, 0].astype(np.int64), count)
    degree = max((curves[c].degree for c in np.unique(of_piece).tolist()), default=1)
    derivatives = evaluate_curves(curves, of_piece, middle, range(degree + 1)) if len(rows) else []
    local = np.empty((len(middle), degree + 1, 3))
    factor = np.ones(len(middle))
    for k, values in enumerate(derivatives):
        local[:, k] = values * factor[:, None]
        factor = factor * half / (k + 1)
    first = find_starts(count[row])
    owner = np.repeat(np.arange(n), count[row])
    piece = first_of_row[row][owner] + np.arange(len(owner)) - first[owner]
    coefficients = np.einsum("nij,nkj->nki", motion.rotation[owner], local[piece])
    coefficients[:, 0] += motion.translation[owner]
    norms = np.linalg.norm(coefficients, axis=2)
    k = np.arange(degree + 1)
    radius = norms[:, 1:].sum(axis=1) + ROUNDOFF * np.abs(coefficients[:, 0]).max(axis=1, initial=0.0)
    boxes = bound_groups(coefficients[:, 0] - radius[:, None], coefficients[:, 0] + radius[:, None], first)
    return NetworkEdges(
        first_piece=first,
        middle=middle[piece],
        half=half[piece],
        coefficients=np.ascontiguousarray(coefficients),
        radius=radius,
        bend=np.einsum("nkd,k->nd", np.abs(coefficients), k * (k - 1.0)),
        low=boxes[0],
        high=boxes[1],
    )


def _cut_into_pieces(curve: BSplineCurve, low: float, high: float) -> Array:
    """Ends of the pieces of a curve between two parameters."""
    inner = np.unique(curve.knots)
    ends = np.concatenate([[low], inner[(inner > low) & (inner < high)], [high]])
    parts = 1 if curve.degree == 1 else -(-CELLS_PER_SIDE // (len(ends) - 1))
    fraction = np.arange(parts) / parts
    return np.append((ends[:-1, None] + np.diff(ends)[:, None] * fraction).ravel(), high)


@njit_cached
def grow_rows(table: Array) -> Array:  # pragma: no cover - compiled
    """A copy of a table (n, k) with room for as many rows again; a loop compiles in a tenth of the time of np.concatenate."""
    result = np.empty((2 * table.shape[0], table.shape[1]), table.dtype)
    for i in range(table.shape[0]):
        for k in range(table.shape[1]):
            result[i, k] = table[i, k]
    return result


def find_overlapping_boxes(low_a: Array, high_a: Array, low_b: Array, high_b: Array, margin: float) -> IntArray:
    """The pairs (n, 2) of boxes that come nearer to each other than `margin` along every axis, in order."""
    rows = max(1, BOX_PAIRS_AT_ONCE // max(1, len(low_b)))
    found = [np.zeros((0, 2), np.int64)]
    for i in range(0, len(low_a), rows):
        near = np.ones((len(low_a[i : i + rows]), len(low_b)), bool)
        for d in range(3):
            near &= low_a[i : i + rows, None, d] <= high_b[:, d] + margin
            near &= low_b[:, d] <= high_a[i : i + rows, None, d] + margin
        found.append(np.argwhere(near) + np.array([i, 0]))
    return np.ascontiguousarray(np.concatenate(found))


@njit_inner
def evaluate_piece(edges: NetworkEdges, piece: int, x: float, jet: Array) -> None:
    """Fill in the point and the first derivative (2, 3) of a piece at its local parameter x on [-1, 1]."""
    for d in range(3):
        a, b = 0.0, 0.0
        for k in range(edges.coefficients.shape[1] - 1, -1, -1):
            b = b * x + a
            a = a * x + edges.coefficients[piece, k, d]
        jet[0, d], jet[1, d] = a, b


@njit_inner
def is_planar(faces: NetworkFaces, f: int) -> bool:  # pragma: no cover - compiled
    """Whether a face lies on a plane, a linear function of its parameters: each cell stands for all of it then."""
    return bool(faces.patches.layout[f, PLANAR] == 1)


@njit_inner
def misses_plane(faces: NetworkFaces, f: int, centre: Array, radius: float) -> bool:  # pragma: no cover - compiled
    """Whether a ball does not reach the plane of a planar face."""
    c = faces.cells.first[f]
    height = 0.0
    for d in range(3):
        height += (centre[d] - faces.cells.centre[c, d]) * faces.cells.normal[c, d]
    return bool(abs(height) > radius * (1.0 + 1e-6) + 1e-12 * np.abs(centre).sum())


@njit_inner
def place_on_plane(
    faces: NetworkFaces, f: int, centre: Array, radius: float, at: Array, half: Array
) -> None:  # pragma: no cover - compiled
    """Write the middle (2,) and half width (1,) of a square about the part of a planar face in a ball, in its first cell's units.

    The parameters of planes are orthogonal.
    """
    c, base = faces.cells.first[f], faces.patches.layout[f, COEFFICIENT]
    width = 0.0
    for axis in range(2):
        row, extent = base + (6 if axis == 0 else 3), faces.patches.layout[f, BREAK_U + axis]
        h = faces.cells.half[c, axis] / (0.5 * (faces.patches.breaks[extent + 1] - faces.patches.breaks[extent]))
        along, square = 0.0, 0.0
        for d in range(3):
            step = h * faces.patches.coefficients[row + d]
            along += (centre[d] - faces.cells.centre[c, d]) * step
            square += step * step
        at[axis] = along / square
        width = max(width, radius / np.sqrt(square))
    half[0] = width * (1.0 + 1e-9)


@njit_cached
def is_in_region(regions: FaceRegions, f: int, u: float, v: float) -> bool:
    """Whether (u, v) lies in the polygon of a face's loops, by the even-odd rule."""
    inside = False
    for k in range(regions.first[f], regions.first[f + 1]):
        y0, y1 = regions.segments[k, 0, 1], regions.segments[k, 1, 1]
        if (y0 > v) != (y1 > v):
            x0, x1 = regions.segments[k, 0, 0], regions.segments[k, 1, 0]
            if x0 + (v - y0) * (x1 - x0) / (y1 - y0) > u:
                inside = not inside
    return inside


@njit_cached
def are_in_regions(regions: FaceRegions, face: IntArray, uv: Array) -> BoolArray:
    """Whether points (n, 2) lie in the polygons of the faces (n,) named."""
    result = np.empty(len(face), np.bool_)
    for i in range(len(face)):
        result[i] = is_in_region(regions, face[i], uv[i, 0], uv[i, 1])
    return result

"""The faces and edges of a network of patches as polynomials in space, in flat tables that compiled loops read.

Every carrier becomes one tensor of monomials per knot span, in two local parameters on [-1, 1], placed by the motion of its
face; a plane becomes a bilinear patch, and a quadric a spline equal to it up to round-off (`conic_splines`). Spans are divided
into *cells*, edges into *pieces*, and for each the second derivatives are bounded by the sums of their coefficients: with the
point and the first derivatives at the middle, Taylor's formula bounds the cell, and each smaller part of it. These bounds hold
for the polynomials, round-off apart.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from math import comb
from typing import NamedTuple

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import ArrayLike

from tpmscad._compiled_loops import njit_cached, njit_inner
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Carrier, Plane
from tpmscad.brep.foot_surface import span_powers
from tpmscad.rigid_motion import Motion
from tpmscad.splines.basis import apply_span_bases
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.splines.curve_batch import evaluate_curves
from tpmscad.trimming.operands.conic_splines import approximate_quadric
from tpmscad.trimming.operands.edge_uses import list_spline_curves, sample_loops

CELLS_PER_SIDE = 6
"""Cells along each parameter of a patch of one span, and pieces of an edge of one span; a span is never shared by two."""

MAX_CELLS_PER_SIDE = 32
"""The same at most, however much smaller the patches of the other network are."""

PATCHES_PER_BATCH = 64
"""Patches divided at once: their arrays stay below a few tens of megabytes."""

BOX_PAIRS_AT_ONCE = 1_000_000
"""Pairs of boxes that are compared at once, a megabyte of answers."""

PLANE_MARGIN = 0.02
"""Enlargement of the rectangle that stands for a plane, relative to the face."""

ROUNDOFF = 1e-12
"""Enlargement of the bounds of cells, relative to the distance of the face from the origin."""


class PatchPolynomials(NamedTuple):
    """The surfaces of F faces, a named tuple, which compiled functions take.

    Attributes
    ----------
    layout : (F, 9)
        Of each face the columns `DEGREE_U` to `PLANAR`.
    breaks : (B,)
        Ends of the spans, of u and then of v of each face.
    coefficients : (C,)
        Monomials in space, model units, face by face: spans of u, of v, powers of u, of v, coordinates.
    """

    layout: IntArray
    breaks: Array
    coefficients: Array


DEGREE_U, DEGREE_V, SPANS_U, SPANS_V, BREAK_U, BREAK_V, COEFFICIENT, SENSE, PLANAR = range(9)
"""Columns of a layout: degrees, numbers of spans, where breaks and monomials start; +1 if S_u x S_v leads out, else -1; 1 for a
plane."""


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


class _Cells(NamedTuple):
    """The monomials of one carrier, and its cells, in its own frame."""

    breaks: tuple[Array, Array]
    coefficients: Array
    middle: Array
    half: Array
    centre: Array
    radius: Array
    bend: Array
    normal: Array
    turn: Array


def tabulate_faces(brep: Brep, near: IntArray | None = None, cell_size: float = np.inf) -> NetworkFaces:
    """The faces of a network. Those that are not among `near` (n,), if it is given, have no cells, no loops and no box.

    cell_size: length of cells, model units, above which faces are divided into more than `CELLS_PER_SIDE`.
    """
    faces = brep.faces
    rows = np.arange(len(faces)) if near is None else near
    polygons = sample_loops(brep, rows)
    surfaces, own_surface = _list_surfaces(brep, rows, polygons)
    divided = _divide_patches(surfaces, cell_size)
    cells = [divided[i] for i in own_surface.tolist()]
    motion = faces.motion[rows]
    count = np.array([len(own.radius) for own in cells], np.int64)
    owner = np.repeat(np.arange(len(cells)), count)
    placed = [(own.coefficients @ motion.rotation[i].T).reshape(-1, 3) for i, own in enumerate(cells)]
    for i, own in enumerate(cells):  # the constant terms alone move with the translation
        nu, nv, p, q = own.coefficients.shape[:4]
        placed[i].reshape(nu, nv, p, q, 3)[:, :, 0, 0] += motion.translation[i]
    sizes = np.array([p.size for p in placed], np.int64)
    centre = motion[owner].apply(_stack([own.centre for own in cells], 3))
    radius = _stack([own.radius for own in cells])
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
        PatchPolynomials(layout, _stack(breaks), _stack([p.ravel() for p in placed])),
        FaceCells(
            first=first_cell,
            middle=_stack([own.middle for own in cells], 2),
            half=_stack([own.half for own in cells], 2),
            centre=centre,
            radius=radius,
            bend=_stack([own.bend for own in cells], 3),
            normal=motion[owner].apply_to_vectors(_stack([own.normal for own in cells], 3)),
            turn=_stack([own.turn for own in cells]),
        ),
        FaceRegions(
            find_starts(_spread([len(p) for p in polygons], rows, len(faces))),
            np.concatenate([np.zeros((0, 2, 2)), *polygons]),
        ),
        low=low,
        high=high,
    )


def tabulate_carriers(carriers: Sequence[Carrier], uv: Sequence[Array], sense: ArrayLike) -> PatchPolynomials:
    """The polynomials of carriers, planes and quadrics about points uv (n, 2) of theirs; sense: +1 if S_u x S_v leads out."""
    breaks, coefficients = [], []
    for surface in map(_as_spline, carriers, uv):
        (u, left), (v, right) = (
            span_powers(surface.knots_u, surface.degree_u),
            span_powers(surface.knots_v, surface.degree_v),
        )
        breaks += [u, v]
        coefficients.append(apply_span_bases(left, surface.poles, right))
    shapes = np.array([c.shape[:4] for c in coefficients], np.int64)
    starts = (
        find_starts([len(b) for b in breaks])[:-1].reshape(-1, 2),
        find_starts([c.size for c in coefficients])[:-1, None],
    )
    planar = np.array([[isinstance(carrier, Plane)] for carrier in carriers], np.int64).reshape(-1, 1)
    layout = np.concatenate([shapes[:, 2:] - 1, shapes[:, :2], *starts, np.reshape(sense, (-1, 1)), planar], axis=1)
    return PatchPolynomials(layout, _stack(breaks), _stack([c.ravel() for c in coefficients]))


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
        surfaces.append(_as_spline(carrier, polygons[i].reshape(-1, 2)))
    return surfaces, own


def _as_spline(carrier: Carrier, uv: Array) -> BSplineSurface:
    """A carrier as a spline in its own parameters, a plane or quadric about points uv (n, 2)."""
    if isinstance(carrier, BSplineSurface):
        return carrier
    return _bound_plane(carrier, uv) if isinstance(carrier, Plane) else approximate_quadric(carrier, uv)


_NO_SEGMENTS = np.zeros((0, 2, 2))


def find_starts(counts: ArrayLike) -> IntArray:
    """Where each of n parts of these lengths starts, and the total (n + 1,)."""
    return np.concatenate([[0], np.cumsum(np.asarray(counts, np.int64))]).astype(np.int64)


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


def _stack(parts: list[Array], columns: int = 0) -> Array:
    empty = np.zeros((0, columns)) if columns else np.zeros(0)
    return np.ascontiguousarray(np.concatenate([empty, *parts]))


def _bound_plane(plane: Plane, uv: Array) -> BSplineSurface:
    """The plane as a bilinear patch about points uv (n, 2)."""
    margin = PLANE_MARGIN * np.ptp(uv, axis=0).max()
    (u0, v0), (u1, v1) = uv.min(axis=0) - margin, uv.max(axis=0) + margin
    poles = plane(np.array([[u0, u0], [u1, u1]]), np.array([[v0, v1], [v0, v1]]))
    return BSplineSurface(poles, np.array([u0, u0, u1, u1]), np.array([v0, v0, v1, v1]), 1, 1)


def _divide_patches(surfaces: list[BSplineSurface], cell_size: float) -> list[_Cells]:
    """The monomials and cells of patches, those of equal degrees and spans at once."""
    groups: dict[tuple[int, int, int, int, bytes, bytes], list[int]] = {}
    for i, s in enumerate(surfaces):
        knots = (_relative_knots(*own) for own in zip((s.knots_u, s.knots_v), s.domain, strict=True))
        key = (s.degree_u, s.degree_v, *_count_parts(s, cell_size), *(k.tobytes() for k in knots))
        groups.setdefault(key, []).append(i)  # type: ignore[arg-type]
    result: dict[int, _Cells] = {}
    for key, members in groups.items():
        for part in range(0, len(members), PATCHES_PER_BATCH):
            own = members[part : part + PATCHES_PER_BATCH]
            result |= dict(zip(own, _divide_like_patches([surfaces[i] for i in own], key[2:4]), strict=True))
    return [result[i] for i in range(len(surfaces))]


def _count_parts(surface: BSplineSurface, cell_size: float) -> tuple[int, int]:
    """Parts of each span of u and of v: `CELLS_PER_SIDE` for the whole surface, or as many as cells of a size ask for."""
    result = []
    for axis, knots in ((0, surface.knots_u), (1, surface.knots_v)):
        length = np.linalg.norm(np.diff(surface.poles, axis=axis), axis=2).sum(axis=axis).max()
        cells = min(max(CELLS_PER_SIDE, length / cell_size), MAX_CELLS_PER_SIDE)
        result.append(int(np.ceil(cells / (len(np.unique(knots)) - 1))))
    return result[0], result[1]


def _relative_knots(knots: Array, domain: tuple[float, float]) -> Array:
    """Knots as fractions of the domain: those of patches of one span are 0 and 1."""
    return np.asarray((knots - domain[0]) / (domain[1] - domain[0]))


def _divide_like_patches(surfaces: list[BSplineSurface], parts: tuple[int, int]) -> list[_Cells]:
    """The monomials and cells of patches whose knots divide their domains alike; parts: cells of each span along u and v."""
    s = surfaces[0]
    degrees = p, q = s.degree_u, s.degree_v
    (_, left), (_, right) = (
        span_powers(_relative_knots(knots, domain), degree)
        for knots, domain, degree in zip((s.knots_u, s.knots_v), s.domain, degrees, strict=True)
    )
    poles = np.stack([own.poles for own in surfaces])
    coefficients = apply_span_bases(left, poles, right)
    n, nu, nv = coefficients.shape[:3]
    (x, hx, in_u), (y, hy, in_v) = (_part_powers(m, d) for m, d in zip(parts, degrees, strict=True))
    local = apply_span_bases(in_u, coefficients, in_v).swapaxes(2, 3)
    local = local.reshape(n, nu * parts[0] * nv * parts[1], p + 1, q + 1, 3)
    norms = np.linalg.norm(local, axis=4)
    k, m = np.arange(p + 1.0), np.arange(q + 1.0)
    bend = np.stack(
        [
            np.einsum("nckm,k->nc", norms, k * (k - 1)),
            np.einsum("nckm,k,m->nc", norms, k, m),
            np.einsum("nckm,m->nc", norms, m * (m - 1)),
        ],
        axis=2,
    )
    radius = norms.sum(axis=(2, 3)) - norms[:, :, 0, 0]
    normal, turn = _bound_normals(coefficients, parts)
    result = []
    for i, own in enumerate(surfaces):
        breaks = tuple(
            np.unique(knots[degree : len(knots) - degree])
            for knots, degree in zip((own.knots_u, own.knots_v), degrees, strict=True)
        )
        middles, halves = [], []
        for ends, at, h in zip(breaks, (x, y), (hx, hy), strict=True):
            centre, half = 0.5 * (ends[1:] + ends[:-1]), 0.5 * np.diff(ends)
            middles.append((centre[:, None] + half[:, None] * at).ravel())
            halves.append(np.repeat(half * h, len(at)))
        middle, half = (
            np.stack(np.meshgrid(*both, indexing="ij"), axis=2).reshape(-1, 2) for both in (middles, halves)
        )
        result.append(
            _Cells(
                (breaks[0], breaks[1]),
                np.ascontiguousarray(coefficients[i]),
                middle,
                half,
                local[i, :, 0, 0].copy(),
                radius[i],
                bend[i],
                normal[i],
                turn[i],
            )
        )
    return result


def _bound_normals(coefficients: Array, parts: tuple[int, int]) -> tuple[Array, Array]:
    """Mean unit normals (n, cells, 3) of cells, and bounds (n, cells) of how far the unit normals in them differ from these.

    S_u x S_v is a polynomial: its Chebyshev coefficients on a cell, or on each quarter of a coarse one, of which the first is the
    mean, bound how far it leaves the direction of that. coefficients: of patches, (n, spans of u, of v, powers of u, of v, 3).
    """
    n, nu, nv, p, q, _ = coefficients.shape
    ways = 2 if max(nu * parts[0], nv * parts[1]) <= 2 * CELLS_PER_SIDE else 1
    (x, to_u), (y, to_v) = (_chebyshev_parts(ways * m, max(2 * (d - 1), 1)) for m, d in zip(parts, (p, q), strict=True))
    power_u, power_v = np.vander(x, p, increasing=True), np.vander(y, q, increasing=True)
    slope_u, slope_v = (
        np.concatenate([np.zeros((len(t), 1)), w[:, :-1] * np.arange(1.0, w.shape[1])], axis=1)
        for t, w in ((x, power_u), (y, power_v))
    )
    nets = np.moveaxis(coefficients, 5, 3)
    su, sv = (of_u @ nets @ of_v.T for of_u, of_v in ((slope_u, power_v), (power_u, slope_v)))
    values = np.cross(su, sv, axis=3)
    terms = to_u.reshape(-1, len(x)) @ values @ to_v.reshape(-1, len(y)).T
    terms = terms.reshape(n, nu, nv, 3, ways * parts[0], len(x), ways * parts[1], len(y))
    mean = terms[..., 0, :, 0].transpose(0, 1, 4, 2, 5, 3)
    unit, turn = _bound_directions(terms)
    quarters = (n, nu * parts[0], ways, nv * parts[1], ways)
    mean = mean.reshape(*quarters, 3).sum(axis=(2, 4))
    normal = mean / np.maximum(np.linalg.norm(mean, axis=-1, keepdims=True), 1e-300)
    off = np.linalg.norm(unit.reshape(*quarters, 3) - normal[:, :, None, :, None], axis=-1)
    turn = np.minimum((off + turn.reshape(quarters)).max(axis=(2, 4)), 2.0)
    return normal.reshape(n, -1, 3), turn.reshape(n, -1)


@njit_cached
def _bound_directions(terms: Array) -> tuple[Array, Array]:  # pragma: no cover - compiled
    """Unit vectors along the first of terms (n, a, b, 3, i, k, j, l), and bounds of how far that of any sum with signs is off.

    Sums are those over k and l; the vectors are (n, a, i, b, j, 3), the bounds (n, a, i, b, j).
    """
    n, na, nb, _, ni, nk, nj, nl = terms.shape
    unit, turn = np.zeros((n, na, ni, nb, nj, 3)), np.full((n, na, ni, nb, nj), 2.0)
    for own in np.ndindex((n, na, ni, nb, nj)):
        m, a, i, b, j = own
        x, y, z = terms[m, a, b, 0, i, 0, j, 0], terms[m, a, b, 1, i, 0, j, 0], terms[m, a, b, 2, i, 0, j, 0]
        length = np.sqrt(x * x + y * y + z * z)
        scale = 1.0 / max(length, 1e-300)
        x, y, z = x * scale, y * scale, z * scale
        unit[m, a, i, b, j, 0], unit[m, a, i, b, j, 1], unit[m, a, i, b, j, 2] = x, y, z
        aside, others = 0.0, -length  # the first term itself adds its length
        for k in range(nk):
            for q in range(nl):
                p, r, t = terms[m, a, b, 0, i, k, j, q], terms[m, a, b, 1, i, k, j, q], terms[m, a, b, 2, i, k, j, q]
                ahead = p * x + r * y + t * z
                p, r, t = p - ahead * x, r - ahead * y, t - ahead * z
                aside += np.sqrt(p * p + r * r + t * t)
                others += abs(ahead)
        least = length - others
        if aside < least:
            turn[own] = aside / max(least, 1e-300)
    return unit, turn


@lru_cache(maxsize=32)
def _chebyshev_parts(count: int, n: int) -> tuple[Array, Array]:
    """Nodes (n,) on [-1, 1], and matrices (count, n, n) from values there to Chebyshev coefficients on equal parts."""
    x = np.asarray(chebyshev.chebpts1(n), np.float64)
    local = np.linalg.inv(chebyshev.chebvander(x, n - 1))
    middle = -1.0 + (2 * np.arange(count) + 1) / count
    within = chebyshev.chebvander(middle[:, None] + x / count, n - 1) @ local
    return x, np.asarray(local @ within, np.float64)


@lru_cache(maxsize=32)
def _part_powers(count: int, degree: int) -> tuple[Array, float, Array]:
    """Middles (count,) and half length of equal parts of [-1, 1], and matrices from monomials there to those of each part."""
    half = 1.0 / count
    middle = np.asarray(-1.0 + half * (2 * np.arange(count) + 1), np.float64)
    matrices = np.zeros((count, degree + 1, degree + 1))
    for k in range(degree + 1):
        for j in range(k + 1):
            matrices[:, j, k] = comb(k, j) * middle ** (k - j) * half**j
    return middle, half, matrices


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


@njit_cached
def evaluate_face(patches: PatchPolynomials, f: int, u: float, v: float, jet: Array) -> None:
    """Fill in S, S_u and S_v (3, 3) of face f at (u, v); beyond its domain its outer polynomials go on."""
    bu, bv = patches.layout[f, BREAK_U], patches.layout[f, BREAK_V]
    nu, nv = patches.layout[f, SPANS_U], patches.layout[f, SPANS_V]
    p, q = patches.layout[f, DEGREE_U], patches.layout[f, DEGREE_V]
    i = 0
    while i + 1 < nu and u >= patches.breaks[bu + i + 1]:
        i += 1
    j = 0
    while j + 1 < nv and v >= patches.breaks[bv + j + 1]:
        j += 1
    hu = 0.5 * (patches.breaks[bu + i + 1] - patches.breaks[bu + i])
    hv = 0.5 * (patches.breaks[bv + j + 1] - patches.breaks[bv + j])
    x = (u - patches.breaks[bu + i]) / hu - 1.0
    y = (v - patches.breaks[bv + j]) / hv - 1.0
    base = patches.layout[f, COEFFICIENT] + (i * nv + j) * (p + 1) * (q + 1) * 3
    for d in range(3):
        s, su, sv = 0.0, 0.0, 0.0
        for k in range(p, -1, -1):
            row = base + k * (q + 1) * 3 + d
            a, b = 0.0, 0.0
            for m in range(q, -1, -1):
                b = b * y + a
                a = a * y + patches.coefficients[row + 3 * m]
            su = su * x + s
            s = s * x + a
            sv = sv * x + b
        jet[0, d], jet[1, d], jet[2, d] = s, su / hu, sv / hv


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

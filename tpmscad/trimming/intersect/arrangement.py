"""The arrangement of a lattice and a trimming body: their common vertices, curve segments, intersections and labels.

An `Arrangement` is a value. Each stage of the pipeline takes one and returns a copy with more fields filled: the intersection
stages append vertices and curves, the classification stages add labels, and the rebuilding stages only read. Indices are stable:
a later stage appends to `vertices` and `curves` and never renumbers them.

The *imprints* are the curves that the lattice's boundary and a surface of the body have in common: arcs across patches, and
lattice edges that lie in a surface.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface
from tpmscad.trimming.operands.face_regions import FaceRegion
from tpmscad.trimming.operands.patch_sides import PatchSides
from tpmscad.trimming.operands.trimming_body import TrimmingBody

SNAP_TOLS = 2.0
"""Vertex tolerance in tolerances: a vertex nearer than this to a surface lies on it, and no edge comes out shorter."""

MARGIN_SNAPS = 100.0
"""Distance, in vertex tolerances, from the box of a free-form face or an edge within which something may lie on it: more than an
imprint may miss an edge of the body."""

FIT_FRACTION_OF_TOL = 0.5
"""Fraction of the tolerance to which a curve is fitted: a vertex of two curves is as far from each of them again."""

ZERO_FRACTION_OF_TOL = 0.05
"""Fraction of the tolerance below which a saddle value, or a segment tangent to a surface at its end, counts as zero."""


@dataclass(frozen=True, slots=True, eq=False)
class Operands:
    """The lattice and the body to intersect, prepared.

    `patches`: the lattice's B-spline carriers by number. `curves`: the curves of its edges. `candidates` (F, K): the pairs of
    patch and surface that the broad phase has left. `tol`: tolerance in model units.
    """

    lattice: Brep
    sides: PatchSides
    patches: Mapping[int, BSplineSurface]
    curves: tuple[BSplineCurve, ...]
    body: TrimmingBody
    regions: tuple[FaceRegion, ...]
    candidates: BoolArray
    tol: float

    @property
    def snap(self) -> float:
        """Vertex tolerance, in model units."""
        return SNAP_TOLS * self.tol

    @property
    def fit_tol(self) -> float:
        """Tolerance of fitted curves, in model units."""
        return FIT_FRACTION_OF_TOL * self.tol

    @property
    def zero_tol(self) -> float:
        """Distance that counts as zero along a lattice edge, in model units."""
        return ZERO_FRACTION_OF_TOL * self.tol


@dataclass(frozen=True, slots=True, eq=False)
class CurveSegments:
    """n segments of placed curves: curve index, rigid motion, parameter span (n, 2), start and end vertex."""

    curve: IntArray
    motion: Motion
    span: Array
    start: IntArray
    end: IntArray

    def __len__(self) -> int:
        return len(self.curve)


@dataclass(frozen=True, slots=True, eq=False)
class CurveSurfaceIntersections:
    """The intersections of n curve segments with K surfaces.

    `initial_sign` (n, K): -1 or +1 at the start of the segment, 0 if the segment lies in the surface. `row_of_pair` (n, K): -1
    without roots, else p with the ascending parameters root_parameter[root_start[p]:root_start[p + 1]]. `root_segment`,
    `root_surface`: of each root. `root_sign` (R,): the sign before each root. `coincident_deviation` (n,): largest distance of a
    segment from the surface it lies in. The distance from a free-form surface may change its sign without a root.
    """

    initial_sign: IntArray
    row_of_pair: IntArray
    root_start: IntArray
    root_parameter: Array
    root_segment: IntArray
    root_surface: IntArray
    root_sign: IntArray
    coincident_deviation: Array

    def roots_of(self, segment: int, surface: int) -> Array:
        """The ascending parameters at which a segment crosses a surface."""
        p = self.row_of_pair[segment, surface]
        return self.root_parameter[self.root_start[p] : self.root_start[p + 1]] if p >= 0 else np.zeros(0)


@dataclass(frozen=True, slots=True, eq=False)
class SubSegments:
    """M sub-segments, ordered by segment and parameter: those of segment i are first[i] to first[i + 1] - 1."""

    segment: IntArray
    span: Array
    start: IntArray
    end: IntArray
    first: IntArray


@dataclass(frozen=True, slots=True, eq=False)
class FittedArc:
    """An arc on one patch: pcurve and space curve (in the patch's local frame) on [0, 1], and their measured deviation."""

    pcurve: BSplineCurve
    curve: BSplineCurve
    deviation: float


@dataclass(frozen=True, slots=True, eq=False)
class PatchArcs:
    """The branches of the intersection of patches with surfaces.

    Flat arrays over A arcs: `face`, `surface`, `fitted_index` in `fitted_arcs`, `sense` (+1 if the surface's negative side is on
    the left of the arc's parameter, else -1), `start` and `end` vertex. `sign_beside_sides`: by (face, surface), the signs (4,)
    next to those of the patch's sides that lie in the surface, else 0. `n_classes`: number of congruence classes of pairs.
    """

    fitted_arcs: tuple[FittedArc, ...]
    face: IntArray
    surface: IntArray
    fitted_index: IntArray
    sense: IntArray
    start: IntArray
    end: IntArray
    sign_beside_sides: Mapping[tuple[int, int], IntArray]
    n_classes: int


@dataclass(frozen=True, slots=True, eq=False)
class IntersectionCurves:
    """T imprints, the arcs first.

    `curve_segments`: their curves, in `Arrangement.curves`. `surface` (T,): the surface of the body. `face` (T,): the patch of an
    arc, or -1. `edge` (T,): the lattice edge, or -1 for an arc. `sense` (T,): as in `PatchArcs`; 0 for lattice edges.
    """

    curve_segments: CurveSegments
    surface: IntArray
    face: IntArray
    edge: IntArray
    sense: IntArray

    def __len__(self) -> int:
        return len(self.surface)


@dataclass(frozen=True, slots=True, eq=False)
class BodyEdgeIntersections:
    """The points in which the body's edges pierce the lattice's boundary.

    `edge`, `edge_parameter`, `vertex` (H,): a vertex inside an edge of the body. `vertex_of_body_vertex`: the vertex at a vertex
    of the body. `curve_index`, `curve_parameter`, `curve_vertex` (R,): the parameters at which imprints pass these vertices.
    """

    edge: IntArray
    edge_parameter: Array
    vertex: IntArray
    vertex_of_body_vertex: Mapping[int, int]
    curve_index: IntArray
    curve_parameter: Array
    curve_vertex: IntArray


NOT_YET: Any = None
"""The value of a field of an arrangement that a later stage fills."""


@dataclass(frozen=True, slots=True, eq=False)
class Arrangement:
    """What is known of the intersection of two operands.

    Geometry: `vertices` (V, 3); `on_surface` (V', surfaces): the vertices that lie on a surface, of those made before the body's
    edges were intersected; `curves`: the lattice's, then those of the fitted arcs; `edges`: the lattice's edges as segments;
    `edge_roots` and `edge_root_vertex` (R,): their intersections with surfaces and the vertices there; `arcs`; `imprints`;
    `body_edge_points`; `imprint_pieces`: the imprints split at those points.

    Labels: `piece_face` (P,): the body's face on which an imprint's piece lies, or -1; `vertex_face`: the body's face on which a
    vertex lies, by (vertex, surface); `keys_on_body`: all vertices on faces of the body, as `vertex_surface_key`;
    `edge_pieces`: the lattice's edges split where they cross the body's boundary; `edge_piece_face` (M,): the face of the
    body that contains a piece, or -1; `edge_piece_inside` (M,): pieces inside the body; `inside_on_side`: for pieces on a face of
    the body, by the edge use of a patch, whether the patch is inside the body there.
    """

    operands: Operands
    vertices: Array
    on_surface: BoolArray
    curves: tuple[BSplineCurve, ...]
    edges: CurveSegments
    edge_roots: CurveSurfaceIntersections = NOT_YET
    edge_root_vertex: IntArray = NOT_YET
    arcs: PatchArcs = NOT_YET
    imprints: IntersectionCurves = NOT_YET
    body_edge_points: BodyEdgeIntersections = NOT_YET
    imprint_pieces: SubSegments = NOT_YET
    piece_face: IntArray = NOT_YET
    vertex_face: Mapping[tuple[int, int], int] = NOT_YET
    keys_on_body: IntArray = NOT_YET
    edge_pieces: SubSegments = NOT_YET
    edge_piece_face: IntArray = NOT_YET
    edge_piece_inside: BoolArray = NOT_YET
    inside_on_side: Mapping[int, bool] = NOT_YET

    @classmethod
    def of_lattice(cls, operands: Operands) -> Arrangement:
        """The arrangement before any intersection: the lattice's own vertices, curves and edges."""
        e = operands.lattice.edges
        edges = CurveSegments(e.curve, e.motion, e.span, e.start, e.end)
        return cls(operands, operands.lattice.vertices, NOT_YET, operands.curves, edges).snap_vertices()

    def snap_vertices(self) -> Arrangement:
        """A copy whose `on_surface` covers all vertices made so far."""
        body, snap = self.operands.body, self.operands.snap
        return replace(self, on_surface=np.abs(body.surfaces.distances(self.vertices, MARGIN_SNAPS * snap)) < snap)

    @property
    def n_edge_pieces(self) -> int:
        """Number of the lattice edges' pieces; in the final numbering of edges the imprints' pieces follow them."""
        return len(self.edge_pieces.segment)

    @property
    def face_of_edge(self) -> IntArray:
        """The body's face that contains each edge of the final numbering, or -1."""
        return np.concatenate([self.edge_piece_face, self.piece_face])

    def vertex_surface_key(self, vertex: IntArray, surface: IntArray) -> IntArray:
        """One integer for a pair of vertex and surface."""
        return vertex * len(self.operands.body.surfaces) + surface

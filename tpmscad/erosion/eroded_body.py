"""The boundary representation of what is deeper than a skin below the boundary of a body."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, drop_unused_geometry
from tpmscad.brep.carriers import EdgeCurve, Plane
from tpmscad.brep.free_form_surface import FreeFormSurface
from tpmscad.brep.loops import LoopError, chain_faces, points_in_polygons
from tpmscad.brep.restricted_surfaces import restrict_carriers
from tpmscad.erosion.edge_fits import fit_edges
from tpmscad.erosion.edge_graph import MERGE_REL_TOL, EdgeGraph
from tpmscad.erosion.face_regions import MIN_SQUARED_LENGTH
from tpmscad.erosion.offset_shell import OffsetShell, build_offset_shell
from tpmscad.erosion.rim_cuts import cut_rim
from tpmscad.erosion.seeds import find_seeds
from tpmscad.erosion.tracing import leave_vertices, trace_from_seed
from tpmscad.errors import TrimmingError, format_point
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve

TAG = "skin"
"""Tag of the faces."""

DEVIATION_MARGIN = 1.5
"""Factor on sampled deviations of edges."""

FRACTIONS = np.linspace(0.0, 1.0, 33)
"""Places along an edge at which its deviation is measured, and of the polygons in which loops are nested."""

CARRIER_MARGIN = 0.3
"""In body sizes: how far fitted carriers may go on beyond the vertices. A lattice that the eroded body trims is followed beyond
its edges; with 0.001 the trim of an elliptic prism fails, and the kernel's split takes twice as long."""

MAX_PLACES = 1000
"""Places of a vertex on one sheet, more than there are."""

CHECK_BORDER = 0.01
"""Of the extent of a sheet's domain: nodes nearer to the border of a face are not compared with the depth."""


def erode_body(
    brep: Brep, free_form: Mapping[int, FreeFormSurface], skin: float, is_open: BoolArray | None = None
) -> Brep:
    """The boundary of the points of a body deeper than `skin` (model units).

    Parameters
    ----------
    brep : Brep
        A closed body without motions, on planes, quadrics and splines.
    free_form : mapping of int to FreeFormSurface
        Its spline carriers with their distances, by their numbers.
    skin : float
        Depth in model units.
    is_open : ndarray of bool, shape (F,), optional
        Planar faces from which no depth is measured: they bound the result themselves. At a face that leans out over an open one
        the depth is at most 1.45 times the skin.

    Returns
    -------
    Brep
        Closed, with outward normals; without faces if nothing is that deep. There may be several shells.

    Raises
    ------
    TrimmingError
        If the arrangement of the offset surfaces cannot be resolved.
    """
    opened = np.zeros(len(brep.faces), bool) if is_open is None else is_open
    shell = build_offset_shell(brep, free_form, skin, opened)
    return _Builder(shell, trace_edges(shell)).build()


def trace_edges(shell: OffsetShell) -> EdgeGraph:
    """All edges of the eroded body. Raises TrimmingError where an edge cannot be followed to its ends.

    A point of the shell bounds the eroded body if no site is nearer than the skin. First the rims are cut where they get shallow,
    and edges are traced from all vertices. Then edges that no vertex leads to are sought on all sheets.
    """
    graph = EdgeGraph.of(shell)
    for rim in shell.rims:
        cut_rim(graph, rim)
    leave_vertices(graph)
    for seed in find_seeds(graph):
        trace_from_seed(graph, *seed)
        leave_vertices(graph)
    return graph


class _Builder:
    """Edges and uses of an edge graph, chained into faces."""

    def __init__(self, shell: OffsetShell, graph: EdgeGraph):
        self.shell, self.graph = shell, graph
        self.curves: list[EdgeCurve] = []
        self.pcurves: list[BSplineCurve] = []
        self.spans: list[tuple[float, float]] = []
        self.ends: list[tuple[int, int]] = []
        self.uses: dict[int, list[tuple[int, int, int]]] = {}

    def build(self) -> Brep:
        """The boundary representation; TrimmingError if its faces do not close or contradict the depth."""
        traced = ((edge.start, edge.end) for edge in self.graph.edges)
        for edge, start, end in (
            *self.graph.rim_pieces,
            *((edge, *ends) for edge, ends in zip(fit_edges(self.graph), traced, strict=True)),
        ):
            self.curves.append(edge.curve)
            self.spans.append(edge.span)
            self.ends.append((start, end))
            for sheet, pcurve, sense in zip(edge.sheets, edge.pcurves, edge.senses, strict=True):
                number = -1
                if pcurve is not None:
                    number = len(self.pcurves)
                    self.pcurves.append(pcurve)
                self.uses.setdefault(sheet, []).append((len(self.curves) - 1, sense, number))
        return self._assemble()

    def _path(self, sheet: int, use: tuple[int, int, int]) -> Array:
        """(u, v) along an edge use, in its direction."""
        edge, sense, pcurve = use
        low, high = self.spans[edge]
        t = low + (high - low) * FRACTIONS[::sense]
        carrier = self.shell.sheets[sheet].carrier
        if pcurve >= 0:
            return self.pcurves[pcurve](t)
        assert isinstance(carrier, Plane)
        return carrier.parameters(self.curves[edge](t))

    def _assemble(self) -> Brep:
        vertices = np.reshape(self.graph.vertices, (-1, 3))
        ends = np.array(self.ends, np.int64).reshape(-1, 2)
        rows: list[tuple[int, int, int]] = []
        carriers, senses, use_start, loop_start = [], [], [0], [0]
        for sheet in range(len(self.shell.sheets)):
            own = self.uses.get(sheet, [])
            paths = [self._path(sheet, use) for use in own]
            faces = self._chain(sheet, own, paths, ends)
            self._check_depth(sheet, [np.concatenate([paths[i] for i in loop]) for face in faces for loop in face])
            for loops in faces:
                for loop in loops:
                    rows += [own[i] for i in loop]
                    use_start.append(len(rows))
                loop_start.append(len(use_start) - 1)
                carriers.append(self.shell.sheets[sheet].carrier)
                senses.append(self.shell.sheets[sheet].sense)
        n = len(self.curves)
        edge_table = Edges(
            np.arange(n),
            Motion.identity(n),
            np.array(self.spans).reshape(-1, 2),
            ends[:, 0],
            ends[:, 1],
            np.zeros(n),
        )
        faces_table = Faces(
            np.arange(len(carriers)),
            Motion.identity(len(carriers)),
            np.array(senses, np.int64),
            np.zeros(len(carriers), np.int64),
            np.array(loop_start),
            np.array(use_start),
        )
        uses = EdgeUses(*np.array(rows, np.int64).reshape(-1, 3).T)
        brep = Brep(
            tuple(carriers), tuple(self.curves), tuple(self.pcurves), vertices, edge_table, uses, faces_table, (TAG,)
        )
        if not len(carriers):
            return brep
        self._measure_deviation(brep)
        unmatched = connectivity.find_unmatched_edges(brep)
        if len(unmatched):
            at = format_point(vertices[ends[unmatched[0], 0]])
            raise TrimmingError(f"{len(unmatched)} edges of the eroded body join no two faces, the first at {at}")
        margin = CARRIER_MARGIN * self.shell.size
        brep = restrict_carriers(brep, vertices.min(axis=0) - margin, vertices.max(axis=0) + margin)
        return drop_unused_geometry(brep)

    def _chain(
        self, sheet: int, own: list[tuple[int, int, int]], paths: list[Array], ends: IntArray
    ) -> list[list[list[int]]]:
        """The faces of a sheet as lists of loops of its uses."""
        if not own:
            return []
        edge, sense = np.array([use[0] for use in own]), np.array([use[1] for use in own])
        start, end = ends[edge, 0], ends[edge, 1]
        start, end = np.where(sense > 0, start, end), np.where(sense > 0, end, start)
        start, end = (
            np.array(
                [v * MAX_PLACES + self._find_place(sheet, v, path[at]) for v, path in zip(own_ends, paths, strict=True)]
            )
            for own_ends, at in ((start.tolist(), 0), (end.tolist(), -1))
        )
        try:
            return chain_faces(start, end, paths)
        except LoopError as error:
            at = format_point(paths[0][0])
            raise TrimmingError(f"the faces of an offset surface do not close about (u, v) = {at}: {error}") from error

    def _find_place(self, sheet: int, vertex: int, uv: Array) -> int:
        """Which of the places of a vertex on a sheet, which has more than one where it crosses itself, is next to (u, v) (2,)."""
        u, v = uv
        if np.linalg.norm(self.shell.sheets[sheet].carrier(u, v, 1, 0)) <= MERGE_REL_TOL * self.shell.size:
            return 0  # a pole, through which loops run from one u to another
        apart = [np.abs(place - uv).max() if s == sheet else np.inf for s, place in self.graph.incident[vertex]]
        return int(np.argmin(apart))

    def _check_depth(self, sheet: int, polygons: list[Array]) -> None:
        """TrimmingError if a node of the sheet is deep enough but outside its faces (n, 2), or inside and too shallow."""
        own, grid = self.shell.sheets[sheet], self.graph.grid(sheet)
        uv, deep = grid.uv[grid.inside], grid.deep[grid.inside]
        if not polygons:
            wrong = deep
        else:
            start, end = np.concatenate(polygons), np.concatenate([np.roll(p, -1, axis=0) for p in polygons])
            inside = points_in_polygons(start, end, uv)
            wrong = inside != deep
            if wrong.any():
                extent = np.ptp(own.box(), axis=0)
                near = _distance_to_segments(uv[wrong] / extent, start / extent, end / extent)
                wrong[np.flatnonzero(wrong)[near < CHECK_BORDER]] = False
        if wrong.any():
            at = format_point(own.carrier(*uv[wrong][0]))
            raise TrimmingError(f"a part of an offset surface about {at} is not bounded by the edges found")

    def _measure_deviation(self, brep: Brep) -> None:
        """Write the deviations of edges: distances of their curves from carriers along pcurves, and from vertices."""
        face_of_use, deviation = brep.face_of_use, brep.edges.deviation
        for k in range(len(brep.uses)):
            edge, pcurve = int(brep.uses.edge[k]), int(brep.uses.pcurve[k])
            low, high = self.spans[edge]
            t = low + (high - low) * FRACTIONS
            points = self.curves[edge](t)
            carrier = brep.carriers[brep.faces.carrier[face_of_use[k]]]
            if pcurve < 0:
                assert isinstance(carrier, Plane)
                off = np.abs(carrier.distance(points))
            else:
                off = np.linalg.norm(carrier(*self.pcurves[pcurve](t).T) - points, axis=1)
            gaps = np.linalg.norm(points[[0, -1]] - brep.vertices[list(self.ends[edge])], axis=1)
            deviation[edge] = max(deviation[edge], DEVIATION_MARGIN * max(float(off.max()), float(gaps.max())))


def _distance_to_segments(points: Array, start: Array, end: Array) -> Array:
    """Distances (n,) of points (n, 2) from the nearest of segments (m, 2), (m, 2)."""
    along = end - start
    square = np.maximum((along * along).sum(axis=1), MIN_SQUARED_LENGTH)
    w = np.clip(((points[:, None] - start) * along).sum(axis=2) / square, 0.0, 1.0)
    return np.asarray(np.linalg.norm(points[:, None] - start - w[..., None] * along, axis=2).min(axis=1))

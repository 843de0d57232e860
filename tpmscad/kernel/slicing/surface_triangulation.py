"""Triangulations with the surfaces and curves that they lie on, and the parts of them that horizontal planes can meet.

Parts hold arrays only where faces are B-splines and planes, so that other processes can cut them. Which triangles a plane may
meet follows from control nets: a B-spline lies in the convex hull of its poles.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.kernel.export.solid_mesh import EdgeSegments, ParametricMesh
from tpmscad.kernel.occt.geometry_evaluators import (
    ConicEvaluator,
    CurveEvaluator,
    CurveTable,
    LineEvaluator,
    PlaneEvaluator,
    RevolutionEvaluator,
    SplineCurveEvaluator,
    SplineSurfaceEvaluator,
    SurfaceEvaluator,
    SurfaceTable,
    edge_evaluator,
    face_evaluator,
    pack_curves,
    pack_surfaces,
)

HEIGHT_MARGIN = 1e-3
"""Height added to every range, in sizes of the solid: edges may lie beside the surfaces of their faces."""


PARAMETER_MARGIN = 0.25
"""In extents of a face in its parameters: how far a face on a quadric may reach beyond the nodes of its triangulation. Between
two nodes an edge turns by half a radian at most, and so leaves its chord by a sixteenth of its length."""


@dataclass(frozen=True, slots=True, eq=False)
class SurfaceTriangulation:
    """Triangles of a solid, and the surfaces and curves that their corners and sides lie on.

    points (n, 3), triangles (m, 3), face (m,), nodes, uv, segment and segments are those of `ParametricMesh`; surfaces and curves
    evaluate its faces and edges by number.
    """

    points: Array
    triangles: IntArray
    face: IntArray
    nodes: IntArray
    uv: Array
    segment: IntArray
    segments: EdgeSegments
    surfaces: SurfaceTable
    curves: CurveTable

    @property
    def size(self) -> float:
        """Greatest extent of the points along an axis."""
        return float(np.ptp(self.points, axis=0).max())

    @property
    def face_of_node(self) -> IntArray:
        """A face that each point is a corner of, (n,)."""
        face = np.zeros(len(self.points), np.int64)
        face[self.triangles] = self.face[:, None]
        return face

    def height_ranges(self) -> Array:
        """Lowest and highest point of the solid's boundary over each triangle, or beyond: (m, 2)."""
        z = self.points[self.triangles, 2]
        low, high = z.min(axis=1), z.max(axis=1)
        of_face = np.array([self._bound_face(number) for number in range(len(self.surfaces.evaluators))])[self.face]
        of_curve = np.array([*(_find_height_range(each) for each in self.curves.evaluators), (np.inf, -np.inf)])
        of_side = of_curve[np.where(self.segment >= 0, self.segments.edge[self.segment], -1)]
        margin = HEIGHT_MARGIN * self.size
        return np.stack(
            [
                np.minimum(np.minimum(low, of_face[:, 0]), of_side[..., 0].min(axis=1)) - margin,
                np.maximum(np.maximum(high, of_face[:, 1]), of_side[..., 1].max(axis=1)) + margin,
            ],
            axis=1,
        )

    def _bound_face(self, number: int) -> tuple[float, float]:
        """Heights between which the inside of a face lies, if its edges do."""
        evaluator = self.surfaces.evaluators[number]
        if not isinstance(evaluator, RevolutionEvaluator):
            return _find_height_range(evaluator)
        uv = self.uv[self.face == number].reshape(-1, 2)
        margin = PARAMETER_MARGIN * np.ptp(uv, axis=0)
        return evaluator.bound_heights(uv.min(axis=0) - margin, uv.max(axis=0) + margin)

    def select(self, chosen: IntArray) -> SurfaceTriangulation:
        """The part of some triangles (k,), with their points, surfaces and curves alone."""
        node, triangles = np.unique(self.triangles[chosen], return_inverse=True)
        face, of_triangle = np.unique(self.face[chosen], return_inverse=True)
        segment = self.segment[chosen]
        own = np.unique(segment[segment >= 0])
        edge, of_segment = np.unique(self.segments.edge[own], return_inverse=True)
        return replace(
            self,
            points=self.points[node],
            triangles=triangles.reshape(-1, 3),
            face=of_triangle,
            nodes=self.nodes[chosen],
            uv=self.uv[chosen],
            segment=np.where(segment >= 0, np.searchsorted(own, segment), -1),
            segments=EdgeSegments(
                of_segment, np.searchsorted(node, self.segments.nodes[own]), self.segments.parameters[own]
            ),
            surfaces=self.surfaces.select(face),
            curves=self.curves.select(edge),
        )


def triangulation_of(mesh: ParametricMesh) -> SurfaceTriangulation:
    """The triangulation of a solid as OCCT made it, with evaluators of its faces and edges."""
    return SurfaceTriangulation(
        mesh.mesh.points,
        mesh.mesh.triangles,
        mesh.mesh.face,
        mesh.nodes,
        mesh.uv,
        mesh.segment,
        mesh.segments,
        pack_surfaces([face_evaluator(face) for face in mesh.faces]),
        pack_curves([edge_evaluator(edge) for edge in mesh.edges]),
    )


def _find_height_range(evaluator: SurfaceEvaluator | CurveEvaluator) -> tuple[float, float]:
    """Heights between which a surface or curve lies: those of its poles.

    Planes and straight lines add nothing to the corners and sides of triangles.
    """
    if isinstance(evaluator, ConicEvaluator):
        z, reach = float(evaluator.origin[2]), float(np.hypot(evaluator.major[2], evaluator.minor[2]))
        return z - reach, z + reach
    if isinstance(evaluator, SplineSurfaceEvaluator | SplineCurveEvaluator):
        z = evaluator.spline.poles[..., 2]
        return float(z.min()), float(z.max())
    return (np.inf, -np.inf) if isinstance(evaluator, PlaneEvaluator | LineEvaluator) else (-np.inf, np.inf)

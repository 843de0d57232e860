"""Degenerate edges, which OCCT requires where a loop passes a pole of a sphere or the apex of a cone.

A boundary representation has no edge there: consecutive half-edges of the loop meet at the vertex with different u, and the
step along v = const between them is implicit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.TopAbs import TopAbs_FORWARD, TopAbs_REVERSED
from OCP.TopoDS import TopoDS_Edge, TopoDS_Face, TopoDS_Vertex

from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import ConicalSurface, SphericalSurface
from tpmscad.kernel.occt import convert

MIN_POLE_STEP_ANGLE = 1e-6
"""Radians of u from which two consecutive half-edges meet at a pole; elsewhere their u agrees to round-off."""


@dataclass(frozen=True, slots=True)
class PoleStep:
    """Step of a loop along a pole at `vertex`, from (start, v) to (end, v)."""

    vertex: int
    start: float
    end: float
    v: float


def find_pole_steps(brep: Brep) -> dict[int, PoleStep]:
    """Pole step after each half-edge that ends at a pole and whose successor starts at a different u."""
    edges, uses, faces = brep.edges, brep.uses, brep.faces
    steps = {}
    has_pole = np.array([isinstance(c, SphericalSurface | ConicalSurface) for c in brep.carriers], bool)[faces.carrier]
    for face in np.flatnonzero(has_pole).tolist():
        for loop in range(int(faces.loop_start[face]), int(faces.loop_start[face + 1])):
            members = list(range(int(faces.use_start[loop]), int(faces.use_start[loop + 1])))
            ends = [_use_end_parameters(brep, k) for k in members]
            for i, k in enumerate(members):
                (u, v), (then, _) = ends[i][1], ends[(i + 1) % len(members)][0]
                if abs(then - u) > MIN_POLE_STEP_ANGLE:
                    e = uses.edge[k]
                    vertex = edges.end[e] if uses.sense[k] > 0 else edges.start[e]
                    steps[k] = PoleStep(int(vertex), u, then, v)
    return steps


def _use_end_parameters(brep: Brep, use: int) -> list[list[float]]:
    """(u, v) at the start and at the end of a half-edge."""
    span = brep.edges.span[brep.uses.edge[use]]
    ends: list[list[float]] = brep.pcurves[brep.uses.pcurve[use]](span).tolist()
    return ends if brep.uses.sense[use] > 0 else ends[::-1]


def make_degenerate_edge(
    builder: BRep_Builder, face: TopoDS_Face, vertex: TopoDS_Vertex, step: PoleStep, tolerance: float
) -> TopoDS_Edge:
    """Edge from the vertex to itself without a 3-D curve, along increasing u, oriented as the loop uses it."""
    low, high = min(step.start, step.end), max(step.start, step.end)
    edge = TopoDS_Edge()
    builder.MakeEdge(edge)
    builder.UpdateEdge(edge, convert.line_2d(np.array([0.0, step.v]), np.array([1.0, step.v])), face, tolerance)
    builder.Add(edge, vertex.Oriented(TopAbs_FORWARD))
    builder.Add(edge, vertex.Oriented(TopAbs_REVERSED))
    builder.Range(edge, low, high)
    builder.Degenerated(edge, True)
    return convert.as_edge(edge.Oriented(TopAbs_FORWARD if step.end > step.start else TopAbs_REVERSED))

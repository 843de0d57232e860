"""A patch complex becomes kernel solids by its own connectivity: no sewing, nothing searched for, no tolerance guessed.

Vertices, edges and faces of the complex become one TopoDS each. An edge has one 3-D curve and one parameter curve per use; all
take the same parameter, so SameParameter holds by construction. Edges on planes need no parameter curve: the kernel projects.
Where a loop runs along a pole of a quadric, the kernel wants a degenerated edge, which the complex does not have (see `poles`).
Wires run counter-clockwise in (u, v), and a face is reversed where its outward normal is -S_u x S_v. Motions are baked into the
poles: a mirror in a TopLoc_Location makes OCC turn solids inside out.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.Geom import Geom_Surface
from OCP.TopAbs import TopAbs_FORWARD, TopAbs_IN, TopAbs_REVERSED
from OCP.TopoDS import (
    TopoDS_Compound,
    TopoDS_Face,
    TopoDS_Shape,
    TopoDS_Shell,
    TopoDS_Solid,
    TopoDS_Wire,
)

from tpmscad.errors import KernelError
from tpmscad.kernel import convert
from tpmscad.kernel.edges import TOLERANCE as TOLERANCE
from tpmscad.kernel.edges import motions, parameter_curves, topods_edges, topods_vertices
from tpmscad.kernel.nesting import Nesting, nesting
from tpmscad.kernel.poles import degenerated, pole_steps
from tpmscad.patches import connectivity, measure
from tpmscad.patches.carriers import Carrier, Plane
from tpmscad.patches.complex import Array, PatchComplex
from tpmscad.splines.bspline import Surface


@dataclass(frozen=True, slots=True, eq=False)
class Built:
    """Solids of a complex. `shape` is a TopoDS_Solid, or a compound of several; `faces[i]` is face i of the complex.

    `nesting` tells which faces bound which solid.
    """

    shape: TopoDS_Shape
    solids: tuple[TopoDS_Solid, ...]
    faces: tuple[TopoDS_Face, ...]
    nesting: Nesting

    @property
    def solid(self) -> Any:
        """The build123d Solid, or Compound of Solids; its `.wrapped` is `shape`."""
        return wrapped(self.shape, len(self.solids))


def build(complex: PatchComplex, moments: measure.Moments | None = None) -> Built:
    """The solid or solids that a closed complex bounds, in model units, largest first.

    `moments` are its faces', where they are known already; afterwards they are in `nesting`. KernelError where the complex is
    open, or a shell is inside out.
    """
    unmatched = connectivity.unmatched_edges(complex)
    if len(unmatched):
        at = complex.vertices[complex.edges.start[unmatched[0]]]
        raise KernelError("build", f"{len(unmatched)} edges do not join two faces, the first at {at.round(6)}")
    faces = topods_faces(complex)
    count, label = connectivity.shells(complex)
    members = np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label, minlength=count))[:-1])
    shells = [shell_of(faces[i] for i in of) for of in members]

    nested = nesting(complex, lambda shell, point: holds(shells[shell], point), moments)
    solids = tuple(solid_of([shells[s] for s in piece]) for piece in nested.pieces)
    return Built(solids[0] if len(solids) == 1 else compound(solids), solids, faces, nested)


def holds(shell: TopoDS_Shell, point: Array) -> bool:
    """Whether what the shell bounds holds a point (3,)."""
    classifier = BRepClass3d_SolidClassifier(solid_of([shell]))
    classifier.Perform(convert.point(point), TOLERANCE)
    return bool(classifier.State() == TopAbs_IN)


def wrapped(shape: TopoDS_Shape, solids: int) -> Any:
    """The build123d Solid, or Compound where the shape holds several."""
    from build123d import Compound, Solid  # takes seconds to import, and files are written without it

    return Solid(shape) if solids == 1 else Compound(shape)


def compound(shapes: Iterable[TopoDS_Shape]) -> TopoDS_Compound:
    """The shapes side by side as one."""
    builder, result = BRep_Builder(), TopoDS_Compound()
    builder.MakeCompound(result)
    for shape in shapes:
        builder.Add(result, shape)
    return result


def topods_faces(complex: PatchComplex) -> tuple[TopoDS_Face, ...]:
    """Every face, outward normals, on shared edges and vertices; of open complexes too."""
    builder = BRep_Builder()
    surfaces = _surfaces(complex)
    vertices = topods_vertices(builder, complex)
    edges = topods_edges(builder, complex, vertices)
    pcurves = parameter_curves(complex)
    at_pole = pole_steps(complex)
    tolerance = np.maximum(TOLERANCE, complex.edges.deviation).tolist()
    faces, uses = complex.faces, complex.uses
    use_edge, use_sense = uses.edge.tolist(), uses.sense.tolist()
    loop_start, use_start, sense = faces.loop_start.tolist(), faces.use_start.tolist(), faces.sense.tolist()
    result = []
    for i in range(len(faces)):
        face = TopoDS_Face()
        builder.MakeFace(face, surfaces[i], TOLERANCE)
        seen: dict[int, int] = {}
        for loop in range(loop_start[i], loop_start[i + 1]):
            wire = TopoDS_Wire()
            builder.MakeWire(wire)
            for k in range(use_start[loop], use_start[loop + 1]):
                e, pcurve = use_edge[k], pcurves[k]
                if pcurve is not None and e in seen:  # a seam: this face lies on both sides of the edge
                    along, against = (k, seen[e]) if use_sense[k] > 0 else (seen[e], k)
                    builder.UpdateEdge(edges[e], pcurves[along], pcurves[against], face, tolerance[e])
                elif pcurve is not None:
                    builder.UpdateEdge(edges[e], pcurve, face, tolerance[e])
                    seen[e] = k
                builder.Add(wire, edges[e].Oriented(TopAbs_FORWARD if use_sense[k] > 0 else TopAbs_REVERSED))
                if k in at_pole:
                    step = at_pole[k]
                    builder.Add(wire, degenerated(builder, face, vertices[step.vertex], step, TOLERANCE))
            wire.Closed(True)
            builder.Add(face, wire)
        result.append(face if sense[i] > 0 else convert.as_face(face.Reversed()))
    return tuple(result)


def _surfaces(complex: PatchComplex) -> list[Geom_Surface]:
    """Each face's own placed surface: a surface that two faces share can't hold both parameter curves of their edge."""
    faces = complex.faces
    moves = motions(faces.rotation, faces.translation)
    bases = [_base(c) for c in complex.carriers]
    result = []
    for i, index in enumerate(faces.carrier.tolist()):
        carrier, base, rotation = complex.carriers[index], bases[index], faces.rotation[i]
        if isinstance(carrier, Plane):
            origin = rotation @ carrier.origin + faces.translation[i]
            result.append(convert.plane(origin, rotation @ carrier.x_axis, rotation @ carrier.y_axis))
        else:
            result.append(base.Transformed(moves[i]))
    return result


def _base(carrier: Carrier) -> Geom_Surface | None:
    """The surface where it was made; None for planes, which are made in their places."""
    if isinstance(carrier, Plane):
        return None
    return convert.surface(carrier) if isinstance(carrier, Surface) else convert.quadric(carrier)


def shell_of(faces: Iterable[TopoDS_Face]) -> TopoDS_Shell:
    builder, shell = BRep_Builder(), TopoDS_Shell()
    builder.MakeShell(shell)
    for face in faces:
        builder.Add(shell, face)
    shell.Closed(True)
    return shell


def solid_of(shells: Iterable[TopoDS_Shell]) -> TopoDS_Solid:
    builder, solid = BRep_Builder(), TopoDS_Solid()
    builder.MakeSolid(solid)
    for shell in shells:
        builder.Add(solid, shell)
    return solid

"""OCCT solids from a boundary representation, by its own connectivity: no sewing, no search, no tolerance guess.

Each vertex, edge and face becomes one TopoDS object. An edge has one 3-D curve and one pcurve per half-edge, all with the same
parameter, so that SameParameter holds by construction. Half-edges on planes need no pcurve, since OCCT projects them. Where a
loop passes a pole of a quadric, OCCT requires a degenerate edge, which the boundary representation lacks (`edges`).
Wires run counter-clockwise in (u, v), and a face is reversed if its outward normal is -S_u x S_v. Motions are applied to the
poles: a reflection in a TopLoc_Location makes OCCT turn solids inside out.

`build_regions` builds neighbouring regions that share the faces, edges and vertices in which they touch.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import numpy as np
from OCP.BRep import BRep_Builder
from OCP.BRepClass3d import BRepClass3d_SolidClassifier
from OCP.Geom import Geom_Surface
from OCP.TopAbs import TopAbs_FORWARD, TopAbs_IN, TopAbs_REVERSED
from OCP.TopoDS import (
    TopoDS_Face,
    TopoDS_Shape,
    TopoDS_Solid,
    TopoDS_Wire,
)

from tpmscad._typing import Array, IntArray
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import Brep, drop_unused_geometry, select_faces
from tpmscad.brep.carriers import Plane
from tpmscad.brep.moments import integral_properties
from tpmscad.errors import KernelError
from tpmscad.kernel.build.edges import (
    build_edges,
    build_pcurves,
    build_transforms,
    build_vertices,
    find_pole_steps,
    make_degenerate_edge,
)
from tpmscad.kernel.build.shell_nesting import ShellNesting, nest_shells
from tpmscad.kernel.occt import convert
from tpmscad.kernel.occt.construction import make_compound, make_shell, make_solid, to_build123d
from tpmscad.kernel.occt.convert import CONFUSION_TOLERANCE
from tpmscad.kernel.occt.shape_pickling import Dismantled
from tpmscad.splines.bspline import BSplineSurface


@dataclass(frozen=True, eq=False)
class BrepSolids:
    """OCCT solids of a boundary representation, made when they are first asked for.

    brep: the boundary representation. nesting: the faces of each solid. known_faces: its OCCT faces, if they were made already.
    """

    brep: Brep
    nesting: ShellNesting
    known_faces: tuple[TopoDS_Face, ...] | None = None

    @property
    def n_solids(self) -> int:
        """Number of solids."""
        return len(self.nesting.shells_of_solid)

    @property
    def n_cavities(self) -> int:
        """Number of closed cavities in them."""
        return len(self.nesting.volume) - self.n_solids

    @cached_property
    def faces(self) -> tuple[TopoDS_Face, ...]:
        """The OCCT face of each face."""
        return build_faces(self.brep) if self.known_faces is None else self.known_faces

    @cached_property
    def _members(self) -> list[IntArray]:
        """The faces of each shell."""
        return _split_by_shell(self.nesting.shell_of_face, len(self.nesting.volume))

    def faces_of_solid(self, number: int) -> IntArray:
        """The faces of a solid, in the kernel's order."""
        return np.concatenate([self._members[shell] for shell in self.nesting.shells_of_solid[number]])

    def vertices_of_solid(self, number: int) -> Array:
        """The positions (n, 3) of the vertices of a solid."""
        if self.n_solids == 1:
            return self.brep.vertices
        return select_faces(self.brep, self.faces_of_solid(number)).vertices

    @cached_property
    def solids(self) -> tuple[TopoDS_Solid, ...]:
        """The solids, largest first."""
        members = self._members
        shells = [make_shell(self.faces[i] for i in of) for of in members]
        return tuple(make_solid([shells[s] for s in piece]) for piece in self.nesting.shells_of_solid)

    @cached_property
    def shape(self) -> TopoDS_Shape:
        """The TopoDS_Solid, or a compound if there are several."""
        return self.solids[0] if len(self.solids) == 1 else make_compound(self.solids)

    @property
    def solid(self) -> Any:
        """The build123d Solid, or a Compound if there are several, with a placement of its own."""
        return to_build123d(self.shape, len(self.solids))

    def dismantle(self) -> Dismantled:
        """The faces, and the function that makes the solids of them again."""
        return self.faces, partial(_assemble_solids, self.brep, self.nesting)

    def __reduce__(self) -> Any:
        return BrepSolids, (self.brep, self.nesting)  # the shapes are made anew where they are asked for


def _assemble_solids(brep: Brep, nested: ShellNesting, shapes: Sequence[Any]) -> BrepSolids:
    return BrepSolids(brep, nested, tuple(map(convert.as_face, shapes)))


def build_solids(brep: Brep, moments: integral_properties.FaceMoments | None = None) -> BrepSolids:
    """Solids bounded by a closed boundary representation, in model units, largest first.

    `moments` are those of its faces, if known already; the result holds them in `nesting`. Raises KernelError if an edge does not
    join two faces or if a shell is inside out. The kernel's faces are made here only if shells must be told inside or outside
    one another.
    """
    unmatched = connectivity.find_unmatched_edges(brep)
    if len(unmatched):
        at = brep.vertices[brep.edges.start[unmatched[0]]]
        raise KernelError("build", f"{len(unmatched)} edges do not join two faces, the first at {at.round(6)}")
    count, label = connectivity.label_shells(brep)
    return _nest_and_collect(brep, None, _split_by_shell(label, count), moments)


def _nest_and_collect(
    brep: Brep,
    faces: tuple[TopoDS_Face, ...] | None,
    members: Sequence[IntArray],
    moments: integral_properties.FaceMoments | None = None,
) -> BrepSolids:
    """The solids of faces grouped by shells; faces are made when they are needed, and classifiers once, as they load them all."""
    classifiers: dict[int, BRepClass3d_SolidClassifier] = {}

    def contains(number: int, point: Array) -> bool:
        nonlocal faces
        if faces is None:
            faces = build_faces(brep)
        if number not in classifiers:
            shell = make_shell(faces[i] for i in members[number])
            classifiers[number] = BRepClass3d_SolidClassifier(make_solid([shell]))
        classifiers[number].Perform(convert.point(point), CONFUSION_TOLERANCE)
        return bool(classifiers[number].State() == TopAbs_IN)

    nested = nest_shells(brep, contains, moments)
    return BrepSolids(brep, nested, faces)


def _split_by_shell(label: IntArray, count: int) -> list[IntArray]:
    """The faces of each of `count` shells, in ascending order."""
    return np.split(np.argsort(label, kind="stable"), np.cumsum(np.bincount(label, minlength=count))[:-1])


def select_solids(brep: Brep, built: BrepSolids, selected: Sequence[int]) -> tuple[Brep, BrepSolids]:
    """Some of the solids of `built`, with the boundary representation of these alone; faces that are known stay the same."""
    nesting = built.nesting
    pieces = [nesting.shells_of_solid[s] for s in selected]
    faces = np.flatnonzero(np.isin(nesting.shell_of_face, [shell for piece in pieces for shell in piece]))
    shells, shell_of_face = np.unique(nesting.shell_of_face[faces], return_inverse=True)
    number = {shell: k for k, shell in enumerate(shells.tolist())}
    kept = ShellNesting(
        shell_of_face=shell_of_face,
        volume=nesting.volume[shells],
        moments=nesting.moments.select(faces),
        shells_of_solid=tuple(tuple(number[shell] for shell in piece) for piece in pieces),
    )
    part = drop_unused_geometry(select_faces(brep, faces))
    known = None if built.known_faces is None else tuple(built.known_faces[f] for f in faces.tolist())
    return part, BrepSolids(part, kept, known)


def build_faces(brep: Brep) -> tuple[TopoDS_Face, ...]:
    """OCCT faces with outward normals on shared edges and vertices; the boundary may be open."""
    builder = BRep_Builder()
    surfaces = _placed_surfaces(brep)
    vertices = build_vertices(builder, brep)
    edges = build_edges(builder, brep, vertices)
    pcurves = build_pcurves(brep)
    at_pole = find_pole_steps(brep)
    tolerance = np.maximum(CONFUSION_TOLERANCE, brep.edges.deviation).tolist()
    faces, uses = brep.faces, brep.uses
    use_edge, use_sense = uses.edge.tolist(), uses.sense.tolist()
    loop_start, use_start, sense = faces.loop_start.tolist(), faces.use_start.tolist(), faces.sense.tolist()
    result = []
    for i in range(len(faces)):
        face = TopoDS_Face()
        builder.MakeFace(face, surfaces[i], CONFUSION_TOLERANCE)
        seen: dict[int, int] = {}
        for loop in range(loop_start[i], loop_start[i + 1]):
            wire = TopoDS_Wire()
            builder.MakeWire(wire)
            for k in range(use_start[loop], use_start[loop + 1]):
                e, pcurve = use_edge[k], pcurves[k]
                if pcurve is not None and e in seen:  # a seam: the face lies on both sides of the edge
                    along, against = (k, seen[e]) if use_sense[k] > 0 else (seen[e], k)
                    builder.UpdateEdge(edges[e], pcurves[along], pcurves[against], face, tolerance[e])
                elif pcurve is not None:
                    builder.UpdateEdge(edges[e], pcurve, face, tolerance[e])
                    seen[e] = k
                builder.Add(wire, edges[e].Oriented(TopAbs_FORWARD if use_sense[k] > 0 else TopAbs_REVERSED))
                if k in at_pole:
                    step = at_pole[k]
                    builder.Add(
                        wire, make_degenerate_edge(builder, face, vertices[step.vertex], step, CONFUSION_TOLERANCE)
                    )
            wire.Closed(True)
            builder.Add(face, wire)
        result.append(face if sense[i] > 0 else convert.as_face(face.Reversed()))
    return tuple(result)


def _placed_surfaces(brep: Brep) -> list[Geom_Surface]:
    """Placed surface of each face; faces that share an edge need separate surfaces to hold both of its pcurves."""
    faces = brep.faces
    moves = build_transforms(faces.motion)
    bases = {
        index: convert.surface(carrier) if isinstance(carrier, BSplineSurface) else convert.quadric(carrier)
        for index, carrier in enumerate(brep.carriers)
        if not isinstance(carrier, Plane)
    }
    result = []
    for i, index in enumerate(faces.carrier.tolist()):
        carrier = brep.carriers[index]
        if isinstance(carrier, Plane):
            motion = faces.motion[i]
            x_axis, y_axis = motion.apply_to_vectors(carrier.x_axis), motion.apply_to_vectors(carrier.y_axis)
            result.append(convert.plane(motion.apply(carrier.origin), x_axis, y_axis))
        else:
            result.append(bases[index].Transformed(moves[i]))
    return result


def build_regions(
    brep: Brep, regions: Sequence[Brep], members: Sequence[IntArray], moments: integral_properties.FaceMoments
) -> tuple[BrepSolids, ...]:
    """Solids of each region, largest first. `members[r]` are the faces of `brep` from which region r is made.

    `moments` are those of the faces of `brep`.
    """
    faces = build_faces(brep)
    result = []
    for region, member in zip(regions, members, strict=True):
        turned = brep.faces.sense[member] != region.faces.sense
        own = [
            convert.as_face(faces[m].Reversed()) if is_turned else faces[m]
            for m, is_turned in zip(member.tolist(), turned.tolist(), strict=True)
        ]
        count, label = connectivity.label_shells(region)
        measured = moments.select(member, turned)
        result.append(_nest_and_collect(region, tuple(own), _split_by_shell(label, count), measured))
    return tuple(result)

"""The patch complex: a boundary representation in arrays, the waist of the program. No kernel object is in it.

Geometry is stored once and placed by rigid motions: a *carrier* (B-spline primitive, plane or quadric), a 3-D *curve* (B-spline,
circle or ellipse) and a parameter curve serve every face, edge and edge use that is a copy of another. A motion is x -> R x + t
with R orthogonal, mirrors included; a mirrored copy keeps its parameters, and its own S_u x S_v is taken after the motion.

    vertices        (V, 3)
    edges           one curve each, the piece of it between two parameters, from a start vertex to an end vertex
    uses            an edge as one side of a loop, with its direction and its parameter curve on the face's carrier
    loops           consecutive uses, closed; the face lies on the left of each use in the carrier's (u, v)
    faces           a placed carrier, a sense, loops (any order), a tag

A use's parameter curve and its edge's curve take the same parameter: carrier(pcurve(t)) = curve(t) for t in the edge's range,
whichever way the use runs. On a plane there is none (index -1), the edge's projection serves.

On a quadric there is always one, a `Curve` in its (u, v). A face on a quadric has no seam: its loops close in (u, v) without a
period's step (angles may lie anywhere, so long as the loop is in one piece), and a surface that closes on itself is at least two
faces. A sphere's pole and a cone's apex are vertices where a face reaches them, never edges: two uses that meet there end at
different u on the line v = const which is the pole, and the loop is understood to run straight along this line from one to the
next. No edge belongs to that step, its length and its `dv` are zero; the kernel gets its degenerated edge there.

A part of a complex: some of its faces, those on splines, or the same faces seen from the other side.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.carriers import Carrier, ConicalSurface, CylindricalSurface, EdgeCurve
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """E edges: edge i is the placed curve on [span[i, 0], span[i, 1]], from vertex start[i] to vertex end[i].

    `deviation` is the greatest measured distance, in model units, between the edge's curve and the carriers it bounds, along
    the shared parameter; zero to round-off where the edge is a patch side.
    """

    curve: IntArray
    motion: Motion
    span: Array
    start: IntArray
    end: IntArray
    deviation: Array

    def __len__(self) -> int:
        return len(self.curve)


@dataclass(frozen=True, slots=True, eq=False)
class EdgeUses:
    """K edge uses in loop order: the edge, +1 or -1 along its parameter, the parameter curve's index, -1 on planes."""

    edge: IntArray
    sense: IntArray
    pcurve: IntArray

    def __len__(self) -> int:
        return len(self.edge)


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """F faces: face i has loops loop_start[i] .. loop_start[i + 1] - 1, loop j has uses use_start[j] .. use_start[j + 1] - 1.

    The outward normal (out of the solid) is sense[i] times S_u x S_v of the placed carrier. `tag` indexes the complex's tags.
    """

    carrier: IntArray
    motion: Motion
    sense: IntArray
    tag: IntArray
    loop_start: IntArray
    use_start: IntArray

    def __len__(self) -> int:
        return len(self.carrier)


@dataclass(frozen=True, slots=True, eq=False)
class Brep:
    """Faces on shared edges and vertices, in model units."""

    carriers: tuple[Carrier, ...]
    curves: tuple[EdgeCurve, ...]
    pcurves: tuple[BSplineCurve, ...]
    vertices: Array
    edges: Edges
    uses: EdgeUses
    faces: Faces
    tags: tuple[str, ...]

    @property
    def face_of_use(self) -> IntArray:
        """(K,) the face each use belongs to."""
        loop_of_use = np.repeat(np.arange(len(self.faces.use_start) - 1), np.diff(self.faces.use_start))
        face_of_loop = np.repeat(np.arange(len(self.faces)), np.diff(self.faces.loop_start))
        return face_of_loop[loop_of_use]

    def faces_with_tag(self, tag: str) -> IntArray:
        """Indices of the faces with this tag; the tag must be one of the complex's."""
        return np.flatnonzero(self.faces.tag == self.tags.index(tag))


def scale_brep(brep: Brep, factor: float) -> Brep:
    """The complex enlarged about the origin. Parameters of carriers scale where they are lengths on quadrics, others stay."""
    edges, faces = brep.edges, brep.faces
    pcurves, uses = _scale_length_parameters(brep, factor)
    return replace(
        brep,
        carriers=tuple(c.scaled(factor) for c in brep.carriers),
        curves=tuple(c.scaled(factor) for c in brep.curves),
        pcurves=pcurves,
        vertices=factor * brep.vertices,
        edges=replace(edges, motion=_scale_motion(edges.motion, factor), deviation=factor * edges.deviation),
        uses=uses,
        faces=replace(faces, motion=_scale_motion(faces.motion, factor)),
    )


def _scale_motion(motion: Motion, factor: float) -> Motion:
    return Motion(motion.rotation, factor * motion.translation)


def move_brep(brep: Brep, motion: Motion) -> Brep:
    """The boundary representation moved by a single rigid motion; a mirror turns it inside out."""
    edges, faces = brep.edges, brep.faces
    return replace(
        brep,
        vertices=motion.apply(brep.vertices),
        edges=replace(edges, motion=motion @ edges.motion),
        faces=replace(faces, motion=motion @ faces.motion),
    )


def translate_brep(brep: Brep, by: Array) -> Brep:
    """The boundary representation translated by a vector (3,); rotations keep their bits."""
    edges, faces = brep.edges, brep.faces
    return replace(
        brep,
        vertices=brep.vertices + by,
        edges=replace(edges, motion=Motion(edges.motion.rotation, edges.motion.translation + by)),
        faces=replace(faces, motion=Motion(faces.motion.rotation, faces.motion.translation + by)),
    )


def _scale_length_parameters(brep: Brep, factor: float) -> tuple[tuple[BSplineCurve, ...], EdgeUses]:
    """Parameter curves with v scaled where it is a length, on cylinders and cones; one that others use as well is kept beside."""
    uses, pcurves = brep.uses, list(brep.pcurves)
    has_length = np.array([isinstance(c, CylindricalSurface | ConicalSurface) for c in brep.carriers], bool)
    by_length = has_length[brep.faces.carrier[brep.face_of_use]]
    index, elsewhere = uses.pcurve.copy(), set(uses.pcurve[~by_length].tolist())
    for p in np.unique(uses.pcurve[by_length]).tolist():
        old = brep.pcurves[p]
        new = BSplineCurve(old.poles * np.array([1.0, factor]), old.knots, old.degree)
        if p in elsewhere:
            index[by_length & (uses.pcurve == p)] = len(pcurves)
            pcurves.append(new)
        else:
            pcurves[p] = new
    return tuple(pcurves), replace(uses, pcurve=index)


def select_faces(whole: Brep, kept: IntArray) -> Brep:
    """The complex of some of the faces, on the edges and vertices that these use."""
    faces, uses, e = whole.faces, whole.uses, whole.edges
    loops = [range(faces.loop_start[f], faces.loop_start[f + 1]) for f in kept]
    spans = [range(faces.use_start[loop], faces.use_start[loop + 1]) for of in loops for loop in of]
    at = np.array([k for span in spans for k in span], np.int64)
    used, edge = np.unique(uses.edge[at], return_inverse=True)
    vertices, ends = np.unique(np.concatenate([e.start[used], e.end[used]]), return_inverse=True)
    start, end = np.split(ends.ravel(), 2)
    return replace(
        whole,
        vertices=whole.vertices[vertices],
        edges=Edges(e.curve[used], e.motion[used], e.span[used], start, end, e.deviation[used]),
        uses=EdgeUses(edge.ravel(), uses.sense[at], uses.pcurve[at]),
        faces=Faces(
            carrier=faces.carrier[kept],
            motion=faces.motion[kept],
            sense=faces.sense[kept],
            tag=faces.tag[kept],
            loop_start=np.cumsum([0, *map(len, loops)]),
            use_start=np.cumsum([0, *map(len, spans)]),
        ),
    )


def spline_faces(patches: Brep) -> Iterator[tuple[IntArray, BSplineSurface]]:
    """B-spline surfaces in turn, each with the faces on it (f,)."""
    for index in np.unique(patches.faces.carrier).tolist():
        carrier = patches.carriers[index]
        if isinstance(carrier, BSplineSurface):
            yield np.flatnonzero(patches.faces.carrier == index), carrier


def reverse_faces(patches: Brep) -> Brep:
    """The patches that bound what the lattice leaves: the other side of every one is out."""
    return replace(patches, faces=replace(patches.faces, sense=-patches.faces.sense))

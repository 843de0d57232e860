"""The boundary representation (Brep): faces on shared edges and vertices, in arrays, without a kernel object.

Geometry is stored once and placed by rigid motions (`tpmscad.rigid_motion.Motion`): a *carrier* (B-spline surface, plane or
quadric), a *curve* (B-spline, circle or ellipse) and a *pcurve* (parameter curve) serve every face, edge and edge use that is a
copy of another. A mirrored copy keeps its parameters; its own S_u x S_v is taken after the motion.

    vertices   (V, 3)    positions
    edges      E         a placed curve between two parameters, from a start vertex to an end vertex
    uses       K         edge uses (half-edges): an edge as one side of a loop, its direction, its pcurve on the carrier
    loops                consecutive uses, closed; the face lies on the left of each use in the (u, v) of the carrier
    faces      F         a placed carrier, the sense of its outward normal, loops in any order, a tag

Two faces that share an edge use it once each, in opposite directions as seen from outside (+1 and -1 along the curve):

         face 0, sense +1
      o <--------------- o      use of face 0: edge e, sense -1
      |------- e ------->|      edge e: start o, end o
      o ---------------> o      use of face 1: edge e, sense +1
         face 1, sense +1

Invariants

- The pcurve of a use and the curve of its edge share their parameter: carrier(pcurve(t)) = curve(t), both placed, for t in the
  span of the edge, whichever way the use runs. How far they differ is the `deviation` of the edge.
- On a plane there is no pcurve (index -1): the edge is projected onto the plane.
- On a quadric there is always one. A face on a quadric has no seam: its loops close in (u, v) without a jump by a period
  (angles may lie in any period), and a surface that closes on itself carries at least two faces.
- The pole of a sphere and the apex of a cone are vertices where a face reaches them, never edges. Two uses that meet there end
  at different u on the line v = const that is the pole; the loop runs straight along this line from one to the other. The step
  has no edge, and neither length nor dv; the kernel gets a degenerate edge there.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tpmscad._typing import Array, IntArray
from tpmscad.brep.carriers import Carrier, ConicalSurface, CylindricalSurface, EdgeCurve
from tpmscad.index_ranges import expand_ranges
from tpmscad.rigid_motion import Motion
from tpmscad.splines.bspline import BSplineCurve, BSplineSurface

STACKED = 1000
"""Surfaces that are evaluated at once: of degree 4 at 25 points 1.6 us each; 2.1 in stacks of 100, 3.1 in stacks of 10,000."""


@dataclass(frozen=True, slots=True, eq=False)
class Edges:
    """E edges: edge i is curve[i], moved by motion[i], on [span[i, 0], span[i, 1]], from vertex start[i] to vertex end[i].

    `deviation` is the largest measured distance, in model units, between the curve and the carriers of the adjacent faces at
    equal parameters; round-off where the edge is a side of the patches.
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
    """K edge uses (half-edges) in loop order: edge, direction along its curve (+1 or -1), pcurve (-1 on planes)."""

    edge: IntArray
    sense: IntArray
    pcurve: IntArray

    def __len__(self) -> int:
        return len(self.edge)


@dataclass(frozen=True, slots=True, eq=False)
class Faces:
    """F faces: face i has loops loop_start[i] .. loop_start[i + 1] - 1, loop j has uses use_start[j] .. use_start[j + 1] - 1.

    The outward normal, out of the solid, is sense[i] times S_u x S_v of the placed carrier. `tag` indexes `Brep.tags`, the names
    of groups, of which several may be equal.
    """

    carrier: IntArray
    motion: Motion
    sense: IntArray
    tag: IntArray
    loop_start: IntArray
    use_start: IntArray

    def __len__(self) -> int:
        return len(self.carrier)


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Brep:
    """A boundary representation, in model units; see the module for its invariants."""

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
        """The face that each edge use belongs to: (K,)."""
        loop_of_use = np.repeat(np.arange(len(self.faces.use_start) - 1), np.diff(self.faces.use_start))
        face_of_loop = np.repeat(np.arange(len(self.faces)), np.diff(self.faces.loop_start))
        return face_of_loop[loop_of_use]

    def faces_with_tag(self, tag: str) -> IntArray:
        """Indices of the faces with a tag."""
        return np.flatnonzero(np.array([own == tag for own in self.tags], bool)[self.faces.tag])


def scale_brep(brep: Brep, factor: float) -> Brep:
    """The boundary representation scaled about the origin; parameters of quadrics that are lengths scale with it."""
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
    """The pcurves with v scaled where it is a length, on cylinders and cones; one shared with other carriers is copied first."""
    uses, pcurves = brep.uses, list(brep.pcurves)
    has_length = np.array([isinstance(c, CylindricalSurface | ConicalSurface) for c in brep.carriers], bool)
    on_length_carrier = has_length[brep.faces.carrier[brep.face_of_use]]
    index, shared_elsewhere = uses.pcurve.copy(), set(uses.pcurve[~on_length_carrier].tolist())
    for p in np.unique(uses.pcurve[on_length_carrier]).tolist():
        old = brep.pcurves[p]
        new = BSplineCurve(old.poles * np.array([1.0, factor]), old.knots, old.degree)
        if p in shared_elsewhere:
            index[on_length_carrier & (uses.pcurve == p)] = len(pcurves)
            pcurves.append(new)
        else:
            pcurves[p] = new
    return tuple(pcurves), replace(uses, pcurve=index)


def sample_edges(brep: Brep, count: int, chosen: IntArray | None = None) -> Array:
    """Points at equal steps of the parameter along each edge, or the chosen ones (E,), ends included: (E, count, 3)."""
    own = slice(None) if chosen is None else chosen
    curve, span, motion = brep.edges.curve[own], brep.edges.span[own], brep.edges.motion[own]
    keys, key = np.unique(np.column_stack([curve, span]), axis=0, return_inverse=True)
    local = [brep.curves[int(index)](np.linspace(low, high, count)) for index, low, high in keys.tolist()]
    return motion[:, None].apply(np.array(local).reshape(-1, count, 3)[key.ravel()])


def select_faces(brep: Brep, selected: IntArray) -> Brep:
    """The boundary representation of the selected faces, on the edges and vertices that these use."""
    faces, uses, edges = brep.faces, brep.uses, brep.edges
    selected = np.asarray(selected, np.int64)
    n_loops = faces.loop_start[selected + 1] - faces.loop_start[selected]
    loop = expand_ranges(faces.loop_start[selected], faces.loop_start[selected + 1])[1]
    n_uses = faces.use_start[loop + 1] - faces.use_start[loop]
    use = expand_ranges(faces.use_start[loop], faces.use_start[loop + 1])[1]
    used, edge = np.unique(uses.edge[use], return_inverse=True)
    vertices, ends = np.unique(np.concatenate([edges.start[used], edges.end[used]]), return_inverse=True)
    start, end = np.split(ends.ravel(), 2)
    return replace(
        brep,
        vertices=brep.vertices[vertices],
        edges=Edges(edges.curve[used], edges.motion[used], edges.span[used], start, end, edges.deviation[used]),
        uses=EdgeUses(edge.ravel(), uses.sense[use], uses.pcurve[use]),
        faces=Faces(
            carrier=faces.carrier[selected],
            motion=faces.motion[selected],
            sense=faces.sense[selected],
            tag=faces.tag[selected],
            loop_start=np.concatenate([[0], np.cumsum(n_loops)]),
            use_start=np.concatenate([[0], np.cumsum(n_uses)]),
        ),
    )


def drop_unused_geometry(brep: Brep) -> Brep:
    """The same boundary representation without the carriers, curves and pcurves that no face, edge or use refers to."""
    faces, edges, uses = brep.faces, brep.edges, brep.uses
    carriers, carrier = np.unique(faces.carrier, return_inverse=True)
    curves, curve = np.unique(edges.curve, return_inverse=True)
    pcurves, pcurve = np.unique(uses.pcurve[uses.pcurve >= 0], return_inverse=True)
    index = uses.pcurve.copy()
    index[index >= 0] = pcurve
    return replace(
        brep,
        carriers=tuple(brep.carriers[i] for i in carriers.tolist()),
        curves=tuple(brep.curves[i] for i in curves.tolist()),
        pcurves=tuple(brep.pcurves[i] for i in pcurves.tolist()),
        edges=replace(edges, curve=curve),
        uses=replace(uses, pcurve=index),
        faces=replace(faces, carrier=carrier),
    )


def spline_faces(brep: Brep) -> Iterator[tuple[IntArray, BSplineSurface]]:
    """The B-spline surfaces that carry faces, each with the indices of its faces (f,)."""
    used, count = np.unique(brep.faces.carrier, return_counts=True)
    faces_of_each = np.split(np.argsort(brep.faces.carrier, kind="stable"), np.cumsum(count)[:-1])
    for index, faces in zip(used.tolist(), faces_of_each, strict=True):
        carrier = brep.carriers[index]
        if isinstance(carrier, BSplineSurface):
            yield faces, carrier


def stacked_spline_faces(brep: Brep) -> Iterator[tuple[IntArray, IntArray, BSplineSurface]]:
    """The faces (f,) on B-splines of one spline space, the place (f,) of each one's surface in a stack, and the k surfaces.

    The stack is one surface in 3k dimensions: what it is asked is answered for all of them in one product of matrices.
    """
    spaces: dict[tuple[Any, ...], list[tuple[IntArray, BSplineSurface]]] = {}
    for faces, surface in spline_faces(brep):
        spaces.setdefault(surface.space, []).append((faces, surface))
    stacks = [alike[i : i + STACKED] for alike in spaces.values() for i in range(0, len(alike), STACKED)]
    for stack in stacks:
        own, surfaces = zip(*stack, strict=True)
        place = np.repeat(np.arange(len(own)), [len(faces) for faces in own])
        yield (
            np.concatenate(own),
            place,
            replace(surfaces[0], poles=np.concatenate([each.poles for each in surfaces], axis=2)),
        )


def select_spline_faces(brep: Brep) -> Brep:
    """The boundary representation of the faces on B-splines, without what only others refer to."""
    on_splines = np.sort(np.concatenate([own for own, _ in spline_faces(brep)]))
    return drop_unused_geometry(select_faces(brep, on_splines))


def reverse_faces(brep: Brep) -> Brep:
    """The same faces with reversed outward normals: they bound the complement of the solid."""
    return replace(brep, faces=replace(brep.faces, sense=-brep.faces.sense))


def copy_brep(brep: Brep, translations: Array) -> Brep:
    """Copies of a boundary representation at translations (n, 3), each on its own edges and vertices; carriers are shared."""
    n, e, u, f = len(translations), brep.edges, brep.uses, brep.faces

    def place(motion: Motion) -> Motion:
        moved = motion.translation + translations[:, None]
        return Motion(np.tile(motion.rotation, (n, 1, 1)), moved.reshape(-1, 3))

    def number(indices: IntArray, step: int) -> IntArray:
        return (indices + step * np.arange(n)[:, None]).ravel()

    def follow(starts: IntArray) -> IntArray:
        return np.append(number(starts[:-1], int(starts[-1])), n * starts[-1])

    return replace(
        brep,
        vertices=(brep.vertices + translations[:, None]).reshape(-1, 3),
        edges=Edges(
            np.tile(e.curve, n),
            place(e.motion),
            np.tile(e.span, (n, 1)),
            number(e.start, len(brep.vertices)),
            number(e.end, len(brep.vertices)),
            np.tile(e.deviation, n),
        ),
        uses=EdgeUses(number(u.edge, len(e)), np.tile(u.sense, n), np.tile(u.pcurve, n)),
        faces=Faces(
            np.tile(f.carrier, n),
            place(f.motion),
            np.tile(f.sense, n),
            np.tile(f.tag, n),
            follow(f.loop_start),
            follow(f.use_start),
        ),
    )


def join_breps(breps: Sequence[Brep]) -> Brep:
    """The faces of several boundary representations as one, each on its own edges and vertices; none of none."""
    none = np.zeros(0, np.int64)
    joined = Brep(
        (),
        (),
        (),
        np.zeros((0, 3)),
        Edges(none, Motion.identity(0), np.zeros((0, 2)), none, none, np.zeros(0)),
        EdgeUses(none, none, none),
        Faces(none, Motion.identity(0), none, none, np.zeros(1, np.int64), np.zeros(1, np.int64)),
        (),
    )
    for other in breps:
        e, f, u = joined.edges, joined.faces, joined.uses
        n_pcurves = len(joined.pcurves)
        joined = Brep(
            carriers=joined.carriers + other.carriers,
            curves=joined.curves + other.curves,
            pcurves=joined.pcurves + other.pcurves,
            vertices=np.concatenate([joined.vertices, other.vertices]),
            edges=Edges(
                np.concatenate([e.curve, other.edges.curve + len(joined.curves)]),
                Motion.concatenate([e.motion, other.edges.motion]),
                np.concatenate([e.span, other.edges.span]),
                np.concatenate([e.start, other.edges.start + len(joined.vertices)]),
                np.concatenate([e.end, other.edges.end + len(joined.vertices)]),
                np.concatenate([e.deviation, other.edges.deviation]),
            ),
            uses=EdgeUses(
                np.concatenate([u.edge, other.uses.edge + len(e)]),
                np.concatenate([u.sense, other.uses.sense]),
                np.concatenate([u.pcurve, np.where(other.uses.pcurve < 0, -1, other.uses.pcurve + n_pcurves)]),
            ),
            faces=Faces(
                np.concatenate([f.carrier, other.faces.carrier + len(joined.carriers)]),
                Motion.concatenate([f.motion, other.faces.motion]),
                np.concatenate([f.sense, other.faces.sense]),
                np.concatenate([f.tag, other.faces.tag + len(joined.tags)]),
                np.concatenate([f.loop_start, other.faces.loop_start[1:] + f.loop_start[-1]]),
                np.concatenate([f.use_start, other.faces.use_start[1:] + f.use_start[-1]]),
            ),
            tags=joined.tags + other.tags,
        )
    return joined

"""A patch complex as Part 21 entities: points, surfaces, curves, topology, solids; formatted in bulk from the arrays.

Coordinates are rounded to `DIGITS` digits of the model's extent, so that points which coincide to round-off become one
CARTESIAN_POINT. A surface or curve that several faces or edges use in one place is written once. Parameter curves are left out,
which every reader allows for.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from tpmscad.kernel.nesting import Nesting
from tpmscad.kernel.step_replica import MIRROR, bases, write_replicas
from tpmscad.kernel.step_text import Entities, reals, references, string
from tpmscad.patches.carriers import Plane
from tpmscad.patches.complex import Array, Ints, PatchComplex
from tpmscad.splines.bspline import Curve, Surface

DIGITS = 14
"""Digits kept after the leading digit of the greatest coordinate: a hundred times float64's round-off."""


@dataclass(frozen=True, slots=True)
class Written:
    """Numbers of the solids' entities and of each face's, in the complex's order."""

    solids: tuple[int, ...]
    faces: tuple[int, ...]


def write_solids(entities: Entities, complex: PatchComplex, nesting: Nesting, replicas: bool = False) -> Written:
    """Add the solids of a closed complex: a MANIFOLD_SOLID_BREP, or BREP_WITH_VOIDS, for each piece.

    `replicas` writes a primitive once and copies it, see `step_replica`.
    """
    surfaces = _Placed.of(complex.faces.carrier, complex.faces.rotation, complex.faces.translation)
    curves = _Placed.of(complex.edges.curve, complex.edges.rotation, complex.edges.translation)
    poles = [_poles(complex.carriers[i]) for i in range(len(complex.carriers))]
    control = [np.zeros((0, 3)) if _is_straight(c) else c.poles for c in complex.curves]
    spline = np.array([isinstance(c, Surface) for c in complex.carriers])[surfaces.primitive]
    written = surfaces.bases(spline) if replicas else surfaces
    surface_points, curve_points = written.points(poles), curves.points(control)
    numbers = _write_points(entities, np.concatenate([complex.vertices, *surface_points, *curve_points]))
    of_vertex, *of_rest = _split(numbers, [len(complex.vertices), *map(len, surface_points), *map(len, curve_points)])
    of_surface, of_curve = of_rest[: len(surface_points)], of_rest[len(surface_points) :]

    surface_number = _write_surfaces(entities, complex, written, of_surface)
    if replicas:
        surface_number = _write_copies(entities, surfaces, spline, written, surface_number)
    curve_number = _write_curves(entities, complex, curves, of_curve)
    edge_number = _write_edges(entities, complex, of_vertex, curve_number[curves.index])
    faces = _write_faces(entities, complex, surface_number[surfaces.index], edge_number)
    shells = entities.extend(
        [f"CLOSED_SHELL('',{references((faces[nesting.faces_of(s)]).tolist())})" for s in range(len(nesting.volume))]
    )
    solids = []
    for outer, *voids in nesting.pieces:
        # A void's faces look into the void already, away from the material, so its shell is taken as it stands.
        inner = entities.extend([f"ORIENTED_CLOSED_SHELL('',*,#{shells[v]},.T.)" for v in voids])
        kind = f"BREP_WITH_VOIDS('',#{shells[outer]},{references(inner)})"
        solids.append(entities.add(kind if voids else f"MANIFOLD_SOLID_BREP('',#{shells[outer]})"))
    return Written(tuple(solids), tuple(faces.tolist()))


@dataclass(frozen=True, slots=True, eq=False)
class _Placed:
    """Distinct placed primitives: which primitive, its motion, and the index of each face's or edge's."""

    primitive: Ints
    rotation: Array
    translation: Array
    index: Ints

    @classmethod
    def of(cls, primitive: Ints, rotation: Array, translation: Array) -> _Placed:
        rows = np.column_stack([primitive, rotation.reshape(-1, 9), translation])
        _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first)  # number them as they come
        rank = np.empty_like(order)
        rank[order] = np.arange(len(order))
        at = first[order]
        return cls(primitive[at], rotation[at], translation[at], rank[index.ravel()])

    def bases(self, spline: NDArray[np.bool_]) -> _Placed:
        """What replicas need instead: planes as they are, and each primitive once for either handedness, where it was made."""
        base, primitive, mirrored = bases(self.primitive[spline], self.rotation[spline])
        planes = np.flatnonzero(~spline)
        index = np.empty(len(spline), np.int64)
        index[planes] = np.arange(len(planes))
        index[spline] = len(planes) + base
        return _Placed(
            np.concatenate([self.primitive[planes], primitive]),
            np.concatenate([self.rotation[planes], np.where(mirrored[:, None, None], MIRROR, np.eye(3))]),
            np.concatenate([self.translation[planes], np.zeros((len(primitive), 3))]),
            index,
        )

    def points(self, local: list[Array]) -> list[Array]:
        """Placed points of each, (n, 3), given those of the primitives."""
        placed: list[Array] = [np.zeros((0, 3))] * len(self.primitive)
        for p in np.unique(self.primitive).tolist():
            at = np.flatnonzero(self.primitive == p)
            moved = np.einsum("mij,pj->mpi", self.rotation[at], local[p]) + self.translation[at, None]
            for i, points in zip(at.tolist(), moved, strict=True):
                placed[i] = points
        return placed


def _poles(carrier: Surface | Plane) -> Array:
    return np.zeros((0, 3)) if isinstance(carrier, Plane) else carrier.poles.reshape(-1, 3)


def _is_straight(curve: Curve) -> bool:
    return curve.degree == 1 and len(curve.poles) == 2


def _split(numbers: Ints, sizes: Sequence[int]) -> list[Ints]:
    return np.split(numbers, np.cumsum(sizes)[:-1])


def _write_points(entities: Entities, points: Array) -> Ints:
    """Write the distinct points; each point's entity number."""
    decimals = DIGITS - int(np.floor(np.log10(np.abs(points).max())))
    grid = np.rint(points * 10.0**decimals).astype(np.int64)
    first, index = _distinct(grid)
    values = reals((grid[first] / 10.0**decimals).ravel().tolist())
    numbers = entities.extend(
        [f"CARTESIAN_POINT('',({x},{y},{z}))" for x, y, z in zip(values[0::3], values[1::3], values[2::3], strict=True)]
    )
    return numbers.start + index


def _distinct(rows: Ints) -> tuple[Ints, Ints]:
    """First member of each class of equal rows, in order of appearance, and each row's class."""
    # Mixing the columns into one 64-bit key sorts ten times faster than rows do; equal keys of unequal rows are looked for.
    mixed = rows[:, 0] * 0x9E3779B97F4A7C1 + rows[:, 1] * 0x1B873593CC9E2D5 + rows[:, 2] * 0x27D4EB2F165667C5
    _, first, index = np.unique(mixed, return_index=True, return_inverse=True)
    if not np.array_equal(rows[first][index.ravel()], rows):
        _, first, index = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return first[order], rank[index.ravel()]


def _knots(*vectors: Array) -> str:
    """Multiplicities of every vector, then the distinct knots of every vector."""
    found = [np.unique(v, return_counts=True) for v in vectors]
    counts = [f"({','.join(map(str, c.tolist()))})" for _, c in found]
    values = [f"({','.join(reals(v.tolist()))})" for v, _ in found]
    return ",".join([*counts, *values])


def _write_surfaces(entities: Entities, complex: PatchComplex, placed: _Placed, numbers: list[Ints]) -> Ints:
    """Each placed carrier's entity number."""
    heads, tails = [], []
    for carrier in complex.carriers:
        if isinstance(carrier, Plane):
            heads.append("")
            tails.append("")
        else:
            rows, columns, _ = carrier.poles.shape
            row = "(" + ",".join(["#%d"] * columns) + ")"
            heads.append(
                f"B_SPLINE_SURFACE_WITH_KNOTS('',{carrier.degree_u},{carrier.degree_v},({','.join([row] * rows)})"
            )
            tails.append(f",.UNSPECIFIED.,.F.,.F.,.F.,{_knots(carrier.knots_u, carrier.knots_v)},.UNSPECIFIED.)")
    bodies = []
    for i, p in enumerate(placed.primitive.tolist()):
        carrier = complex.carriers[p]
        if isinstance(carrier, Plane):
            rotation, translation = placed.rotation[i], placed.translation[i]
            x, y = rotation @ carrier.x_axis, rotation @ carrier.y_axis
            frame = placement(entities, rotation @ carrier.origin + translation, np.cross(x, y), x)
            bodies.append(f"PLANE('',#{frame})")
        else:
            bodies.append(heads[p] % tuple(numbers[i].tolist()) + tails[p])
    return np.array(entities.extend(bodies))


def _write_copies(entities: Entities, placed: _Placed, spline: NDArray[np.bool_], base: _Placed, number: Ints) -> Ints:
    """Each placed carrier's entity number, given those of the bases."""
    result = number[base.index]
    result[spline] = write_replicas(entities, result[spline], placed.rotation[spline], placed.translation[spline])
    return result


def _write_curves(entities: Entities, complex: PatchComplex, placed: _Placed, numbers: list[Ints]) -> Ints:
    """Each placed curve's entity number; 0 for straight ones, which every edge writes from its own vertices."""
    heads, tails = [], []
    for curve in complex.curves:
        heads.append(f"B_SPLINE_CURVE_WITH_KNOTS('',{curve.degree},({','.join(['#%d'] * len(curve.poles))})")
        tails.append(f",.UNSPECIFIED.,.F.,.F.,{_knots(curve.knots)},.UNSPECIFIED.)")
    bent = [i for i, p in enumerate(placed.primitive.tolist()) if not _is_straight(complex.curves[p])]
    result = np.zeros(len(placed.primitive), np.int64)
    result[bent] = entities.extend(
        [
            heads[p] % tuple(numbers[i].tolist()) + tails[p]
            for i, p in zip(bent, placed.primitive[bent].tolist(), strict=True)
        ]
    )
    return result


def _write_edges(entities: Entities, complex: PatchComplex, points: Ints, curve: Ints) -> Ints:
    edges = complex.edges
    vertices = np.array(entities.extend([f"VERTEX_POINT('',#{p})" for p in points.tolist()]))
    curve = curve.copy()
    straight = np.flatnonzero(curve == 0)
    along = complex.vertices[edges.end[straight]] - complex.vertices[edges.start[straight]]
    length = np.linalg.norm(along, axis=1)
    directions = _directions(entities, along / length[:, None])
    vectors = entities.extend([f"VECTOR('',#{d},{r})" for d, r in zip(directions, reals(length.tolist()), strict=True)])
    origins = points[edges.start[straight]].tolist()
    curve[straight] = entities.extend([f"LINE('',#{p},#{v})" for p, v in zip(origins, vectors, strict=True)])
    rows = np.column_stack([vertices[edges.start], vertices[edges.end], curve]).tolist()
    return np.array(entities.extend([f"EDGE_CURVE('',#{a},#{b},#{c},.T.)" for a, b, c in rows]))


def _write_faces(entities: Entities, complex: PatchComplex, surface: Ints, edge: Ints) -> Ints:
    """ADVANCED_FACE each, its name the face's tag; loops counter-clockwise about the outward normal."""
    faces, uses = complex.faces, complex.uses
    outward = faces.sense[complex.face_of_use] > 0
    along = np.where((uses.sense > 0) == outward, "T", "F").tolist()
    oriented = entities.extend(
        [f"ORIENTED_EDGE('',*,*,#{e},.{s}.)" for e, s in zip(edge[uses.edge].tolist(), along, strict=True)]
    )
    face_of_loop = np.repeat(np.arange(len(faces)), np.diff(faces.loop_start))
    turned = (faces.sense[face_of_loop] < 0).tolist()
    starts = faces.use_start.tolist()
    loops = []
    for i, backwards in enumerate(turned):
        members = oriented[starts[i] : starts[i + 1]]
        loops.append(f"EDGE_LOOP('',{references(reversed(members) if backwards else members)})")
    loop = entities.extend(loops)
    outer = outer_loops(complex)
    kind = ["FACE_OUTER_BOUND" if o else "FACE_BOUND" for o in outer.tolist()]
    bounds = entities.extend([f"{k}('',#{n},.T.)" for k, n in zip(kind, loop, strict=True)])
    names = [string(tag) for tag in complex.tags]
    first = faces.loop_start.tolist()
    rows = zip(faces.tag.tolist(), surface.tolist(), faces.sense.tolist(), strict=True)
    return np.array(
        entities.extend(
            [
                f"ADVANCED_FACE({names[t]},{references(bounds[first[i] : first[i + 1]])},#{s},.{'T' if sense > 0 else 'F'}.)"
                for i, (t, s, sense) in enumerate(rows)
            ]
        )
    )


def outer_loops(complex: PatchComplex) -> np.ndarray:
    """Whether each loop is its face's outer one: the only one, or the one around the greatest area."""
    faces = complex.faces
    counts = np.diff(faces.loop_start)
    outer = np.ones(len(faces.use_start) - 1, bool)
    for face in np.flatnonzero(counts > 1).tolist():
        loops = range(int(faces.loop_start[face]), int(faces.loop_start[face + 1]))
        areas = [_area(complex, face, range(int(faces.use_start[j]), int(faces.use_start[j + 1]))) for j in loops]
        outer[loops.start : loops.stop] = np.arange(len(areas)) == int(np.argmax(areas))
    return outer


LOOP_SAMPLES = 8
"""Points per edge for the area within a loop: enough to tell an outer loop from a hole in it."""


def _area(complex: PatchComplex, face: int, uses: range) -> float:
    """Signed area within a loop in its carrier's parameters, counter-clockwise positive."""
    points = []
    carrier = complex.carriers[int(complex.faces.carrier[face])]
    for k in uses:
        e = int(complex.uses.edge[k])
        low, high = complex.edges.span[e].tolist()
        t = np.linspace(low, high, LOOP_SAMPLES + 1)
        if isinstance(carrier, Plane):
            rotation, translation = complex.faces.rotation[face], complex.faces.translation[face]
            edges = complex.edges
            space = complex.curves[int(edges.curve[e])](t) @ edges.rotation[e].T + edges.translation[e]
            uv = carrier.parameters((space - translation) @ rotation)
        else:
            uv = complex.pcurves[int(complex.uses.pcurve[k])](t)
        points.append((uv if complex.uses.sense[k] > 0 else uv[::-1])[:-1])
    x, y = np.concatenate(points).T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _directions(entities: Entities, vectors: Array) -> range:
    values = reals(vectors.ravel().tolist())
    return entities.extend(
        [f"DIRECTION('',({x},{y},{z}))" for x, y, z in zip(values[0::3], values[1::3], values[2::3], strict=True)]
    )


def placement(entities: Entities, origin: Array, axis: Array, reference: Array) -> int:
    """AXIS2_PLACEMENT_3D: z along `axis`, x along `reference`."""
    x, y, z = reals(origin.tolist())
    at = entities.add(f"CARTESIAN_POINT('',({x},{y},{z}))")
    normal, along = _directions(entities, np.stack([axis, reference]))
    return entities.add(f"AXIS2_PLACEMENT_3D('',#{at},#{normal},#{along})")

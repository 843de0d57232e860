"""Every patch against every plane that it may meet: classes, traced and fitted once, and the arcs they leave on each patch.

The plane is brought into the primitive's frame. Patches that see it from the same place (to 1e-9 in direction, 1e-10 of the
patch in distance) are a class; planes seen from either side are one class, turned round.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tpmscad.patches.carriers import Carrier
from tpmscad.patches.complex import PatchComplex
from tpmscad.splines.bspline import Surface
from tpmscad.trimming import fitting, marching
from tpmscad.trimming.borders import Border
from tpmscad.trimming.sides import Sides
from tpmscad.trimming.strands import FLAT, Crossings
from tpmscad.trimming.tool import Array, Flags, Ints, Tool, TrimmingError


@dataclass(frozen=True, slots=True, eq=False)
class PatchCuts:
    """What the planes do to the patches.

    `state` (F, K): -1 the patch is inside, +1 outside, 0 cut. `side_sign` (F, K, 4): next to a side that lies in the plane.
    Arcs, in flat arrays: face, plane, which of `cuts`, +1 or -1 if the inside of the plane is on the left or right of its
    parameter, start and end vertex along the parameter. `points`: the vertices made here, numbered from `first_vertex`.
    """

    state: Ints
    side_sign: Ints
    cuts: tuple[fitting.Cut, ...]
    face: Ints
    plane: Ints
    cut: Ints
    sense: Ints
    start: Ints
    end: Ints
    points: Array
    n_classes: int


def cut_patches(
    complex: PatchComplex,
    sides: Sides,
    tool: Tool,
    on: Flags,
    crossings: Crossings,
    vertex_of_root: Ints,
    first_vertex: int,
    tol: float,
) -> PatchCuts:
    """Trace every plane on every patch near it. `on` (V, K), `crossings`: of the lattice's vertices and edges with the planes."""
    faces = complex.faces
    low = np.zeros((len(complex.carriers), 3))
    high = np.zeros((len(complex.carriers), 3))
    for c in np.unique(faces.carrier):
        poles = complex.carriers[c].poles
        low[c], high[c] = poles.min(axis=(0, 1)), poles.max(axis=(0, 1))
    middle, radius = (low + high) / 2, np.linalg.norm(high - low, axis=1) / 2
    centre = np.einsum("fij,fj->fi", faces.rotation, middle[faces.carrier]) + faces.translation
    distance = tool.distances(centre)
    state = np.where(distance < 0, -1, 1)
    near = np.abs(distance) <= radius[faces.carrier][:, None]
    near &= ~((state > 0) & ~near).any(axis=1)[:, None]  # a patch that is outside anyhow
    face, plane = np.nonzero(near)

    normal = np.einsum("pi,pij->pj", tool.normals[plane], faces.rotation[face])
    constant = np.einsum("pi,pi->p", tool.normals[plane], faces.translation[face]) - tool.heights[plane]
    corner_on = on[sides.corner[face], plane[:, None]]
    side_flat = crossings.sign[sides.edge[face], plane[:, None]] == 0
    special = corner_on.any(axis=1) | side_flat.any(axis=1)
    rounded = np.round(normal, 9) + 0.0
    leading = rounded[np.arange(len(face)), (rounded != 0).argmax(axis=1)]
    turn = np.where((leading < 0) & ~special, -1, 1)
    size = float(radius.max())
    key = np.column_stack(
        [
            faces.carrier[face],
            turn[:, None] * rounded,
            np.round(turn * constant / size, 10) + 0.0,
            corner_on,
            side_flat,
        ]
    )
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    label = label.ravel()

    carrier = faces.carrier[face[first]]
    normal, constant = (turn[:, None] * normal)[first], (turn * constant)[first]
    traces = []
    for p, c, n, h in zip(first, carrier, normal, constant, strict=True):
        borders = _borders(complex, sides, crossings, int(face[p]), int(plane[p]), int(turn[p]))
        traces.append(_trace(complex.carriers[c], n, float(h), borders, corner_on[p], FLAT * tol))
    cuts, first_cut = _fitted(complex, traces, carrier, normal, constant, tol)

    class_sign = np.array([trace.sign for trace in traces], np.int64)
    class_side = np.array([trace.on_side for trace in traces], np.int64).reshape(-1, 4)
    state[face, plane] = turn * class_sign[label]
    side_sign = np.zeros((*state.shape, 4), np.int64)
    side_sign[face, plane] = turn[:, None] * class_side[label]

    rows: list[tuple[int, ...]] = []
    points: list[Array] = []
    for p in np.flatnonzero((class_sign[label] == 0) & ~(state[face] > 0).any(axis=1)):
        trace, f, k = traces[label[p]], int(face[p]), int(plane[p])
        own = first_vertex + len(points)
        surface = complex.carriers[faces.carrier[f]]
        assert isinstance(surface, Surface)
        if len(trace.points):
            local = surface(trace.points[:, 0], trace.points[:, 1])
            points.extend(local @ faces.rotation[f].T + faces.translation[f])
        for a, arc in enumerate(trace.arcs):
            ends = [_end_vertex(end, sides, crossings, vertex_of_root, f, k, own) for end in (arc.start, arc.end)]
            rows.append((f, k, first_cut[label[p]] + a, int(turn[p]), *ends))
    table = np.array(rows, np.int64).reshape(-1, 6)
    face, plane, cut, sense, start, end = table.T
    return PatchCuts(
        state, side_sign, cuts, face, plane, cut, sense, start, end, np.array(points).reshape(-1, 3), len(first)
    )


def _borders(
    complex: PatchComplex, sides: Sides, crossings: Crossings, face: int, plane: int, turn: int
) -> tuple[Border, ...]:
    """The four sides of a patch as its edges know them, for the plane turned by `turn`."""
    result = []
    for edge, forward in zip(sides.edge[face], sides.forward[face], strict=True):
        low, high = complex.edges.span[edge]
        x = (crossings.of(edge, plane) - low) / (high - low)
        sign = int(crossings.sign[edge, plane]) * turn
        result.append(Border(x, sign) if forward else Border(1.0 - x[::-1], sign * (-1) ** len(x)))
    return tuple(result)


def _trace(
    surface: Carrier,
    normal: Array,
    constant: float,
    borders: tuple[Border, ...],
    on_corner: Flags,
    flat: float,
) -> marching.Trace:
    assert isinstance(surface, Surface)
    if not on_corner.any():
        values = surface.poles @ normal + constant  # they bound the patch
        if (values > 0).all() or (values < 0).all():
            return replace(marching.NONE, sign=1 if values.flat[0] > 0 else -1)
    return marching.march(surface, normal, constant, borders, on_corner, flat)


def _fitted(
    complex: PatchComplex, traces: list[marching.Trace], carrier: Ints, normal: Array, constant: Array, tol: float
) -> tuple[tuple[fitting.Cut, ...], Ints]:
    """Curves of all arcs of all classes, in order, and where each class's begin."""
    owner = np.repeat(np.arange(len(traces)), [len(trace.arcs) for trace in traces])
    paths = [arc.path for trace in traces for arc in trace.arcs]
    foci = [trace.foci for trace in traces for _ in trace.arcs]
    cuts: list[fitting.Cut | None] = [None] * len(paths)
    spaces: dict[tuple[int, int, bytes, bytes], list[int]] = {}
    surfaces = []
    for i, c in enumerate(carrier[owner]):
        surface = complex.carriers[c]
        assert isinstance(surface, Surface)
        surfaces.append(surface)
        key = (surface.degree_u, surface.degree_v, surface.knots_u.tobytes(), surface.knots_v.tobytes())
        spaces.setdefault(key, []).append(i)
    for members in spaces.values():
        at = np.array(members)
        fitted = fitting.fit(
            [surfaces[i] for i in members],
            normal[owner[at]],
            constant[owner[at]],
            [paths[i] for i in members],
            [foci[i] for i in members],
            tol,
        )
        for i, cut in zip(members, fitted, strict=True):
            cuts[i] = cut
    return tuple(c for c in cuts if c is not None), np.searchsorted(owner, np.arange(len(traces)))


def _end_vertex(
    end: marching.End, sides: Sides, crossings: Crossings, vertex_of_root: Ints, face: int, plane: int, first_point: int
) -> int:
    """The vertex in which an arc of a class ends on one of its patches."""
    kind, i, j = end
    if kind == "point":
        return first_point + i
    if kind == "corner":
        return int(sides.corner[face, i])
    edge = sides.edge[face, i]
    pair = crossings.pair[edge, plane]
    count = crossings.root_start[pair + 1] - crossings.root_start[pair] if pair >= 0 else 0
    if j >= count:
        raise TrimmingError(f"patches that see plane {plane} from the same place differ on their borders")
    return int(vertex_of_root[crossings.root_start[pair] + (j if sides.forward[face, i] else count - 1 - j)])

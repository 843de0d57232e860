"""Every patch against every surface that it may meet: classes, traced and fitted once, and the arcs they leave on each patch.

The surface is brought into the primitive's frame. Patches that see it from the same place (to 1e-9 in direction, 1e-10 of the
patch in distance) are a class; planes seen from either side are one class, turned round.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad.patches.complex import PatchComplex
from tpmscad.splines.bspline import Surface
from tpmscad.trimming import fitting, marching
from tpmscad.trimming.borders import Border
from tpmscad.trimming.levels import Levels
from tpmscad.trimming.sides import Sides
from tpmscad.trimming.strands import FLAT, Crossings
from tpmscad.trimming.sweeping import march_all
from tpmscad.trimming.tool import Array, Flags, Ints, TrimmingError


@dataclass(frozen=True, slots=True, eq=False)
class PatchCuts:
    """What the surfaces do to the patches.

    Arcs, in flat arrays: face, surface, which of `cuts`, +1 or -1 if the surface's negative side is on the left or right of its
    parameter, start and end vertex along the parameter. `points`: the vertices made here, in order. `side_sign`: by patch and
    surface the signs next to the patch's sides (4,), where one lies in the surface.
    """

    cuts: tuple[fitting.Cut, ...]
    face: Ints
    surface: Ints
    cut: Ints
    sense: Ints
    start: Ints
    end: Ints
    points: Array
    side_sign: dict[tuple[int, int], Ints]
    n_classes: int


def cut_patches(
    complex: PatchComplex,
    sides: Sides,
    levels: Levels,
    near: Flags,
    on: Flags,
    crossings: Crossings,
    vertex_of_root: Ints,
    first_vertex: int,
    tol: float,
) -> PatchCuts:
    """Trace surfaces on the patches `near` them (F, K). `on` (V, K), `crossings`: the lattice's vertices and edges on them."""
    faces = complex.faces
    face, surface = np.nonzero(near)
    seen = levels.of(surface).framed(faces.rotation[face], faces.translation[face])
    corner_on = on[sides.corner[face], surface[:, None]]
    side_flat = crossings.sign[sides.edge[face], surface[:, None]] == 0
    special = corner_on.any(axis=1) | side_flat.any(axis=1)
    rounded = np.round(seen.axis, 9) + 0.0
    leading = rounded[np.arange(len(face)), (rounded != 0).argmax(axis=1)]
    turn = np.where((leading < 0) & ~special & seen.flat, -1, 1)
    seen = seen.turned(turn)
    size = max((float(np.ptp(c.poles)) for c in complex.carriers if isinstance(c, Surface)), default=1.0)
    key = np.column_stack([faces.carrier[face], seen.key(size), corner_on, side_flat])
    _, first, label = np.unique(key, axis=0, return_index=True, return_inverse=True)
    label = label.ravel()

    carrier, seen = faces.carrier[face[first]], seen.of(first)
    borders = [_borders(complex, sides, crossings, int(face[p]), int(surface[p]), int(turn[p])) for p in first]
    patches = [patch for patch in (complex.carriers[c] for c in carrier) if isinstance(patch, Surface)]
    traces = march_all(patches, seen, borders, corner_on[first], FLAT * tol)
    cuts, first_cut = _fitted(complex, traces, carrier, seen, tol)

    side_sign = {
        (int(face[p]), int(surface[p])): turn[p] * traces[label[p]].on_side
        for p in np.flatnonzero(np.array([trace.on_side.any() for trace in traces], bool)[label])
    }
    rows: list[tuple[int, ...]] = []
    points: list[Array] = []
    for p in np.flatnonzero(np.array([len(trace.arcs) > 0 for trace in traces], bool)[label]):
        trace, f, k = traces[label[p]], int(face[p]), int(surface[p])
        own = first_vertex + len(points)
        patch = complex.carriers[faces.carrier[f]]
        assert isinstance(patch, Surface)
        if len(trace.points):
            local = patch(trace.points[:, 0], trace.points[:, 1])
            points.extend(local @ faces.rotation[f].T + faces.translation[f])
        for a, arc in enumerate(trace.arcs):
            ends = [_end_vertex(end, sides, crossings, vertex_of_root, f, k, own) for end in (arc.start, arc.end)]
            rows.append((f, k, first_cut[label[p]] + a, int(turn[p]), *ends))
    face, surface, cut, sense, start, end = np.array(rows, np.int64).reshape(-1, 6).T
    return PatchCuts(
        cuts, face, surface, cut, sense, start, end, np.array(points).reshape(-1, 3), side_sign, len(first)
    )


def _borders(
    complex: PatchComplex, sides: Sides, crossings: Crossings, face: int, surface: int, turn: int
) -> tuple[Border, ...]:
    """The four sides of a patch as its edges know them, for the surface turned by `turn`."""
    result = []
    for edge, forward in zip(sides.edge[face], sides.forward[face], strict=True):
        low, high = complex.edges.span[edge]
        x = (crossings.of(edge, surface) - low) / (high - low)
        sign = int(crossings.sign[edge, surface]) * turn
        result.append(Border(x, sign) if forward else Border(1.0 - x[::-1], sign * (-1) ** len(x)))
    return tuple(result)


def _fitted(
    complex: PatchComplex, traces: list[marching.Trace], carrier: Ints, levels: Levels, tol: float
) -> tuple[tuple[fitting.Cut, ...], Ints]:
    """Curves of all arcs of all classes, in order, and where each class's begin."""
    owner = np.repeat(np.arange(len(traces)), [len(trace.arcs) for trace in traces])
    paths = [arc.path for trace in traces for arc in trace.arcs]
    foci = [trace.foci for trace in traces for _ in trace.arcs]
    cuts: list[fitting.Cut | None] = [None] * len(paths)
    spaces: dict[tuple[int, int, bytes, bytes, bool], list[int]] = {}
    patches = []
    for i, c in enumerate(carrier[owner]):
        s = complex.carriers[c]
        assert isinstance(s, Surface)
        patches.append(s)
        key = (s.degree_u, s.degree_v, s.knots_u.tobytes(), s.knots_v.tobytes(), bool(levels.flat[owner[i]]))
        spaces.setdefault(key, []).append(i)
    for members in spaces.values():
        at = np.array(members)
        fitted = fitting.fit(
            [patches[i] for i in members],
            levels.of(owner[at]),
            [paths[i] for i in members],
            [foci[i] for i in members],
            tol,
        )
        for i, cut in zip(members, fitted, strict=True):
            cuts[i] = cut
    return tuple(c for c in cuts if c is not None), np.searchsorted(owner, np.arange(len(traces)))


def _end_vertex(
    end: marching.End,
    sides: Sides,
    crossings: Crossings,
    vertex_of_root: Ints,
    face: int,
    surface: int,
    first_point: int,
) -> int:
    """The vertex in which an arc of a class ends on one of its patches."""
    kind, i, j = end
    if kind == "point":
        return first_point + i
    if kind == "corner":
        return int(sides.corner[face, i])
    edge = sides.edge[face, i]
    pair = crossings.pair[edge, surface]
    count = crossings.root_start[pair + 1] - crossings.root_start[pair] if pair >= 0 else 0
    if j >= count:
        raise TrimmingError(f"patches that see surface {surface} from the same place differ on their borders")
    return int(vertex_of_root[crossings.root_start[pair] + (j if sides.forward[face, i] else count - 1 - j)])

"""Complexes that bound neighbouring regions, put together: what two of them have in common is stored once.

The regions were trimmed by one body, so that what they share is the same to round-off; it is found by place.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from tpmscad._typing import Array, IntArray
from tpmscad.brep.boundary_representation import Brep, Edges, EdgeUses, Faces, select_faces
from tpmscad.errors import TrimmingError
from tpmscad.rigid_motion import Motion

COINCIDENCE_TOL = 2e-6
"""Model units: vertices and edge middles this near to each other are the same; trimming snaps to a tenth of it."""


PARAMETER_TOL = 1e-9
"""Of an edge's parameters, which run from 0 to 1 or over its length."""


@dataclass(frozen=True, slots=True, eq=False)
class SharedTopology:
    """All faces once, and for each region which of them bound it: face numbers, in its own complex's order."""

    brep: Brep
    region_faces: tuple[IntArray, ...]


def share_topology(regions: Sequence[Brep]) -> SharedTopology:
    """The regions' complexes as one; TrimmingError where faces that should be common are not.

    A face that two regions share keeps the sense of the first.
    """
    whole = _concatenate_complexes(regions)
    vertex = _first_coincident(whole.vertices)
    edges = whole.edges
    start, end = vertex[edges.start], vertex[edges.end]
    middle = _points_on_edges(whole, 0.5)
    label = _first_coincident(middle)
    ends = np.sort(np.stack([start, end], axis=1), axis=1)
    _, first, edge = np.unique(np.column_stack([ends, label]), axis=0, return_index=True, return_inverse=True)
    owner = first[edge.ravel()]
    quarter = _points_on_edges(whole, 0.25)
    against = np.linalg.norm(quarter - quarter[owner], axis=1) > COINCIDENCE_TOL
    if (np.linalg.norm(quarter - _points_on_edges(whole, 0.75)[owner], axis=1)[against] > COINCIDENCE_TOL).any():
        raise TrimmingError("the regions' common edges are parametrised differently")
    uses = whole.uses
    odd = against | (np.abs(edges.span - edges.span[owner]).max(axis=1) > PARAMETER_TOL)
    odd = odd[uses.edge] & (uses.pcurve >= 0)
    uses = EdgeUses(owner[uses.edge], np.where(against[uses.edge], -uses.sense, uses.sense), uses.pcurve)
    merged = replace(whole, edges=replace(edges, start=start, end=end), uses=uses)
    kept, member = np.unique(_first_equal_face(merged), return_inverse=True)
    if (odd & np.isin(whole.face_of_use, kept)).any():
        raise TrimmingError("an edge common to two regions has other parameters on a curved face")
    bounds = np.cumsum([0, *(len(r.faces) for r in regions)])
    members = tuple(member.ravel()[a:b] for a, b in zip(bounds[:-1], bounds[1:], strict=True))
    return SharedTopology(select_faces(merged, kept), members)


def _first_coincident(points: Array) -> IntArray:
    """For each point the first of those that lie there."""
    first = np.arange(len(points))
    pairs = cKDTree(points).query_pairs(COINCIDENCE_TOL, output_type="ndarray")
    for i, j in pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))].tolist():
        first[j] = min(first[j], first[i])
    return first


def _points_on_edges(whole: Brep, part: float) -> Array:
    """A point of every edge, at this part of its span: (E, 3)."""
    edges = whole.edges
    keys, key = np.unique(np.column_stack([edges.curve, edges.span]), axis=0, return_inverse=True)
    local = np.stack([whole.curves[int(i)](low + part * (high - low)) for i, low, high in keys])[key.ravel()]
    return edges.motion.apply(local)


def _first_equal_face(merged: Brep) -> IntArray:
    """For each face the first with the same edges on the same surface: patches bounded by other edges stay their own."""
    owner: dict[tuple[int, ...], int] = {}
    result = np.arange(len(merged.faces))
    face_of_use = merged.face_of_use
    order = np.argsort(face_of_use, kind="stable")
    splits = np.cumsum(np.bincount(face_of_use, minlength=len(merged.faces)))[:-1]
    caps = merged.tags.index("cap") if "cap" in merged.tags else -1
    for face, uses in enumerate(np.split(order, splits)):
        if merged.faces.tag[face] != caps:
            result[face] = owner.setdefault(tuple(sorted(merged.uses.edge[uses].tolist())), face)
    return result


def _concatenate_complexes(regions: Sequence[Brep]) -> Brep:
    tags = tuple(dict.fromkeys(tag for r in regions for tag in r.tags))
    parts, at = [], np.zeros(6, np.int64)
    for r in regions:
        carriers, curves, pcurves, vertices, n_edges, _ = at.tolist()
        e, f = r.edges, r.faces
        number = np.array([tags.index(tag) for tag in r.tags])
        parts.append(
            replace(
                r,
                edges=replace(e, curve=e.curve + curves, start=e.start + vertices, end=e.end + vertices),
                uses=EdgeUses(
                    r.uses.edge + n_edges, r.uses.sense, np.where(r.uses.pcurve < 0, -1, r.uses.pcurve + pcurves)
                ),
                faces=replace(f, carrier=f.carrier + carriers, tag=number[f.tag]),
            )
        )
        at += np.array([len(r.carriers), len(r.curves), len(r.pcurves), len(r.vertices), len(e), 0])
    loops, uses = (
        _concatenate_offsets([p.faces.loop_start for p in parts]),
        _concatenate_offsets([p.faces.use_start for p in parts]),
    )

    def edges(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(p.edges, name) for p in parts])

    def sides(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(p.uses, name) for p in parts])

    def faces(name: str) -> NDArray[Any]:
        return np.concatenate([getattr(p.faces, name) for p in parts])

    return Brep(
        carriers=tuple(c for p in parts for c in p.carriers),
        curves=tuple(c for p in parts for c in p.curves),
        pcurves=tuple(c for p in parts for c in p.pcurves),
        vertices=np.concatenate([p.vertices for p in parts]),
        edges=Edges(
            motion=Motion.concatenate([p.edges.motion for p in parts]),
            **{name: edges(name) for name in Edges.__slots__ if name != "motion"},
        ),
        uses=EdgeUses(*map(sides, EdgeUses.__slots__)),
        faces=Faces(
            motion=Motion.concatenate([p.faces.motion for p in parts]),
            **{name: faces(name) for name in ("carrier", "sense", "tag")},
            loop_start=loops,
            use_start=uses,
        ),
        tags=tags,
    )


def _concatenate_offsets(each: Sequence[IntArray]) -> IntArray:
    total, parts = 0, [np.zeros(1, np.int64)]
    for starts in each:
        parts.append(starts[1:] + total)
        total += int(starts[-1])
    return np.concatenate(parts)

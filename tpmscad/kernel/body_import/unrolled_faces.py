"""A CAD body on its way to a patch complex: vertices, edges, faces with loops of edge uses in (u, v), seams still there."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.carriers import ConicalSurface, EdgeCurve, Plane, Quadric
from tpmscad.brep.loops import signed_area
from tpmscad.kernel.recognise.edge_curves import EDGE_SAMPLES, UnsupportedFace, follow_parameters, is_at_pole

ANGLE_TOL = 1e-6
"""Radians within which two uses that meet have the same u; at a pole, from which they are a step apart."""


@dataclass(frozen=True, slots=True, eq=False)
class ImportedEdge:
    curve: EdgeCurve
    span: tuple[float, float]
    start: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class ImportedUse:
    """An edge in a loop; on a quadric `near` is (u, v) in the edge's middle, which tells one turn from the next."""

    edge: int
    sense: int
    mid_parameters: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ImportedFace:
    """As a face of a patch complex; `origin` is the kernel's face that it is (a part of)."""

    carrier: Plane | Quadric
    sense: int
    loops: tuple[tuple[ImportedUse, ...], ...]
    source_face: int


@dataclass(frozen=True, slots=True, eq=False)
class ImportedBody:
    """`size` is the diagonal of the box around the vertices and edges."""

    vertices: tuple[Array, ...]
    edges: tuple[ImportedEdge, ...]
    faces: tuple[ImportedFace, ...]
    size: float


def sample_use(body: ImportedBody, face: ImportedFace, use: ImportedUse, t: Array | None = None) -> Array:
    """(u, v) along the use, in its own direction: at SAMPLES even parameters, or in the edge's direction at t (n,)."""
    assert not isinstance(face.carrier, Plane)
    edge = body.edges[use.edge]
    uv = follow_parameters(face.carrier, edge.curve, edge.span, use.mid_parameters, t, body.size)
    return uv if use.sense > 0 or t is not None else uv[::-1]


def unroll_face(body: ImportedBody, face: ImportedFace) -> ImportedFace:
    """The face with its loops laid out in (u, v), one use after another, holes within the outer loop's turn."""
    if isinstance(face.carrier, Plane):
        return face
    loops = [_chain_uses(body, face, loop) for loop in face.loops]
    polygons = [loop_polygon(body, face, loop) for loop in loops]
    areas = [signed_area(p) for p in polygons]
    outer = int(np.argmax(areas))
    if areas[outer] <= 0:
        raise UnsupportedFace("has no loop around it")
    low, high = polygons[outer].min(axis=0), polygons[outer].max(axis=0)
    first = np.array(
        [-p * np.floor(lo / p + ANGLE_TOL) if p else 0.0 for p, lo in zip(face.carrier.period, low, strict=True)]
    )
    low, high = low + first, high + first  # as the kernel has it, from the first turn on
    loops[outer] = _shift_loop(loops[outer], first)
    for i in range(len(loops)):
        if i != outer:
            middle = 0.5 * (polygons[i].min(axis=0) + polygons[i].max(axis=0))
            shift = [
                p * np.ceil((lo - m) / p) if p else 0.0
                for p, lo, m in zip(face.carrier.period, low, middle, strict=True)
            ]
            if (middle + shift > high).any():
                raise UnsupportedFace("has a hole that is not inside its outer loop")
            loops[i] = _shift_loop(loops[i], np.array(shift))
    return ImportedFace(face.carrier, face.sense, tuple(loops), face.source_face)


def _shift_loop(loop: tuple[ImportedUse, ...], by: Array) -> tuple[ImportedUse, ...]:
    return tuple(
        ImportedUse(use.edge, use.sense, use.mid_parameters + by) for use in loop if use.mid_parameters is not None
    )


def _chain_uses(body: ImportedBody, face: ImportedFace, loop: tuple[ImportedUse, ...]) -> tuple[ImportedUse, ...]:
    """The loop's uses with their `near`, each going on where the last one ends."""
    carrier = face.carrier
    assert not isinstance(carrier, Plane)
    period = np.array(carrier.period)
    result: list[ImportedUse] = []
    end = first = None
    for use in loop:
        uv = sample_use(body, face, use)
        shift = np.zeros(2)
        if end is not None:
            step = _pole_gap(body, face, use, end, uv)
            turns = np.divide(end + step - uv[0], period, out=np.zeros(2), where=period > 0)
            shift = period * np.round(turns)
        result.append(ImportedUse(use.edge, use.sense, uv[EDGE_SAMPLES // 2] + shift))
        end = uv[-1] + shift
        first = uv[0] + shift if first is None else first
    assert end is not None
    assert first is not None
    wanted = end + _pole_gap(body, face, loop[0], end, sample_use(body, face, loop[0]))
    if (np.abs(wanted - first)[period > 0] > 0.1).any():
        raise UnsupportedFace("has a loop that goes around its axis")
    return tuple(result)


def _pole_gap(body: ImportedBody, face: ImportedFace, use: ImportedUse, end: Array, uv: Array) -> Array:
    """Along a pole from the last use's end to where this one begins; zero elsewhere. The face lies on the step's left."""
    way = pole_direction(body, face, use)
    return np.array([pole_angle_step(end[0], uv[0, 0], way), 0.0]) if way else np.zeros(2)


def pole_direction(body: ImportedBody, face: ImportedFace, use: ImportedUse) -> int:
    """1 or -1 for a use that begins at a pole, the way in which u changes in the step before it; 0 for others."""
    edge = body.edges[use.edge]
    start = body.vertices[edge.start if use.sense > 0 else edge.end]
    if not is_at_pole(face.carrier, start[None], body.size)[0]:
        return 0
    if isinstance(face.carrier, ConicalSurface):
        return 1 if face.carrier.angle > 0 else -1
    assert not isinstance(face.carrier, Plane)
    return 1 if face.carrier.parameters(start)[1] < 0 else -1


def pole_angle_step(start: float, end: float, way: int) -> float:
    """The change of u from start to a u equivalent to end, in the given way, more than nothing and at most one turn."""
    turn = 2.0 * np.pi
    step = (end - start) % turn
    step = turn if step < ANGLE_TOL or step > turn - ANGLE_TOL else step
    if way > 0:
        return float(step)
    return float(step - turn) if step < turn else -turn


def loop_polygon(body: ImportedBody, face: ImportedFace, loop: tuple[ImportedUse, ...]) -> Array:
    """(u, v) along the loop, steps along poles included: (n, 2)."""
    return np.concatenate([sample_use(body, face, use) for use in loop])

"""Intermediate form of an imported CAD body, and its trimming loops unrolled in (u, v).

The half-edges of a loop are shifted by whole periods of the surface so that the loop is continuous in (u, v). Seams are still
present at this stage.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.carriers import ConicalSurface, EdgeCurve, Plane
from tpmscad.brep.conics import TWO_PI
from tpmscad.brep.free_form_surface import BodyCarrier, FreeFormSurface
from tpmscad.brep.loops import signed_area
from tpmscad.kernel.recognise.edge_curves import EDGE_SAMPLES, UnsupportedFace, follow_parameters, is_at_pole

ANGLE_TOL = 1e-6
"""Radians, or parameters of a free-form surface, up to which u of consecutive half-edges agrees;
a larger difference is a step along a pole."""

MAX_CLOSURE_GAP = 0.1
"""Gap in periodic parameters beyond which an unrolled loop does not close because it runs around the axis."""


@dataclass(frozen=True, slots=True, eq=False)
class ImportedEdge:
    """Edge on `curve` over `span` from vertex `start` to vertex `end`."""

    curve: EdgeCurve
    span: tuple[float, float]
    start: int
    end: int


@dataclass(frozen=True, slots=True, eq=False)
class ImportedUse:
    """Half-edge of a loop; on a quadric `mid_parameters` is (u, v) at the middle of the edge and selects the period."""

    edge: int
    sense: int
    mid_parameters: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ImportedFace:
    """Trimmed face; `source_face` is the index of the OCCT face of which it is a part."""

    carrier: BodyCarrier
    sense: int
    loops: tuple[tuple[ImportedUse, ...], ...]
    source_face: int


@dataclass(frozen=True, slots=True, eq=False)
class ImportedBody:
    """Body before assembly; `size` is the diagonal of the box of its vertices and edges.

    `move`: how far free-form faces were moved, so that they meet.
    """

    vertices: tuple[Array, ...]
    edges: tuple[ImportedEdge, ...]
    faces: tuple[ImportedFace, ...]
    size: float
    move: float = 0.0


def sample_use(body: ImportedBody, face: ImportedFace, use: ImportedUse, t: Array | None = None) -> Array:
    """(u, v) along a half-edge.

    If t is None, at EDGE_SAMPLES evenly spaced parameters in the direction of the half-edge; else at the parameters t (n,) of
    the edge.
    """
    assert not isinstance(face.carrier, Plane)
    edge = body.edges[use.edge]
    uv = follow_parameters(face.carrier, edge.curve, edge.span, use.mid_parameters, t, body.size)
    return uv if use.sense > 0 or t is not None else uv[::-1]


def unroll_face(body: ImportedBody, face: ImportedFace) -> ImportedFace:
    """The face with continuous loops in (u, v) and its holes inside the period of the outer loop.

    Raises UnsupportedFace if there is no outer loop, or if a loop runs around the axis.
    """
    if isinstance(face.carrier, Plane):
        return face
    loops = [_chain_uses(body, face, loop) for loop in face.loops]
    polygons = [loop_polygon(body, face, loop) for loop in loops]
    areas = [signed_area(p) for p in polygons]
    outer = int(np.argmax(areas))
    if areas[outer] <= 0:
        raise UnsupportedFace("has no loop around it")
    low, high = polygons[outer].min(axis=0), polygons[outer].max(axis=0)
    begins = [start for start, _ in face.carrier.domain] if isinstance(face.carrier, FreeFormSurface) else [0.0, 0.0]
    first = np.array(
        [
            -p * np.floor((lo - start) / p + ANGLE_TOL) if p else 0.0
            for p, lo, start in zip(face.carrier.period, low, begins, strict=True)
        ]
    )
    low, high = low + first, high + first  # OCCT too starts in the first period
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
    """The loop shifted by whole periods."""
    return tuple(
        ImportedUse(use.edge, use.sense, use.mid_parameters + by) for use in loop if use.mid_parameters is not None
    )


def _chain_uses(body: ImportedBody, face: ImportedFace, loop: tuple[ImportedUse, ...]) -> tuple[ImportedUse, ...]:
    """The loop's half-edges with mid-edge parameters, each continuous with its predecessor."""
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
    closing = end + _pole_gap(body, face, loop[0], end, sample_use(body, face, loop[0]))
    turn = np.where(period > 0, period, TWO_PI) / TWO_PI
    if (np.abs(closing - first) > MAX_CLOSURE_GAP * turn)[period > 0].any():
        raise UnsupportedFace("has a loop that goes around its axis")
    return tuple(result)


def _pole_gap(body: ImportedBody, face: ImportedFace, use: ImportedUse, end: Array, uv: Array) -> Array:
    """Step along a pole from the end of the last half-edge to the start of this one; zero elsewhere. The face is on its left."""
    u_sense = pole_direction(body, face, use)
    if not u_sense:
        return np.zeros(2)
    assert not isinstance(face.carrier, Plane)
    return np.array([pole_angle_step(end[0], uv[0, 0], u_sense, face.carrier.period[0]), 0.0])


def pole_direction(body: ImportedBody, face: ImportedFace, use: ImportedUse) -> int:
    """Sign of the change of u in the pole step before a half-edge that starts at a pole; 0 for other half-edges."""
    edge = body.edges[use.edge]
    start = body.vertices[edge.start if use.sense > 0 else edge.end]
    if not is_at_pole(face.carrier, start[None], body.size)[0]:
        return 0
    if isinstance(face.carrier, FreeFormSurface):
        return -min(face.carrier.poles_across_v(), key=lambda end: float(np.linalg.norm(end[1] - start)))[0]
    if isinstance(face.carrier, ConicalSurface):
        return 1 if face.carrier.angle > 0 else -1
    assert not isinstance(face.carrier, Plane)
    return 1 if face.carrier.parameters(start)[1] < 0 else -1


def pole_angle_step(start: float, end: float, u_sense: int, turn: float) -> float:
    """Change of u from `start` to a u equivalent to `end` with the sign of `u_sense`: nonzero and at most one turn.

    `turn` is the period of u; without one, 0, the step leads to `end`.
    """
    if not turn:
        return end - start
    step = (end - start) % turn
    step = turn if step < ANGLE_TOL or step > turn - ANGLE_TOL else step
    if u_sense > 0:
        return float(step)
    return float(step - turn) if step < turn else -turn


def loop_polygon(body: ImportedBody, face: ImportedFace, loop: tuple[ImportedUse, ...]) -> Array:
    """(u, v) along the loop, steps along poles included: (n, 2)."""
    return np.concatenate([sample_use(body, face, use) for use in loop])

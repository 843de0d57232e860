"""Judges of what is stated of a solid besides the solid: its size, its fraction, its walls, and the labels of its faces.

They work on a triangulation by the kernel and on the numbers of the request.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

OPPOSITE_COSINE = -0.998
"""Normals of two sides of a wall, within 3.6 degrees: sides that meet in an edge are a wedge, whose width is no wall's."""

MAX_FACES = 260
"""Faces up to which walls are measured, and labels are looked at."""

MAX_BYTES = 4_000_000
"""Size of a file up to which the kernel reads it again within the time of a request."""

FINE_ANGLE, COARSE_ANGLE = 0.1, 0.5
"""Between facets (radians) where walls are measured, and where only the size is. The fine one takes 24 s for 5000 faces, and
OCCT leaves slivers of 0.002 mm without triangles."""

SHARP_MEAN = 0.97
"""Length of the mean of the unit normals around a vertex below which it lies on a sharp edge: they differ by 28 degrees."""

NEIGHBOURS = 40
"""Nearest triangles among which the other side of a wall is sought."""


MAX_HALVINGS = 3
"""Of the deviation, until the kernel triangulates all faces."""


def triangulate(shape: Any, deviation: float, *, angle: float = FINE_ANGLE) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (n, 3) within the deviation of the faces of a shape, and triangles (m, 3), turned outwards.

    angle: between the normals of neighbouring facets, radians.
    """
    import build123d as bd
    from OCP.BRepBuilderAPI import BRepBuilderAPI_Copy
    from OCP.BRepMesh import BRepMesh_IncrementalMesh

    for halvings in range(MAX_HALVINGS + 1):
        copy, finer = BRepBuilderAPI_Copy(shape, False, False).Shape(), deviation / 2**halvings
        # build123d's deviations are relative to lengths of edges
        BRepMesh_IncrementalMesh(copy, finer, False, angle, False)
        try:
            vertices, triangles = bd.Compound(copy).tessellate(finer, angle)
            break
        except AttributeError:  # the kernel left a face without triangles
            if halvings == MAX_HALVINGS:
                raise
    return np.array([tuple(v) for v in vertices]), np.array(triangles)


def judge_size(model: Any, path: Path, vertices: np.ndarray, deviation: float) -> list[str]:
    """What the vertices contradict of the model's box, of that of its file, and of the size that is printed."""
    import tpmscad

    faults = []
    low, high = np.asarray(model.bounding_box, float)
    size = float(np.linalg.norm(high - low))
    inner_low, inner_high = vertices.min(axis=0), vertices.max(axis=0)
    if (inner_low < low - deviation).any() or (inner_high > high + deviation).any():  # chords of edges pass their faces
        faults.append(f"points of the solid lie outside its box {low} to {high}: {inner_low} to {inner_high}")
    if (inner_low > low + 4 * deviation).any() or (inner_high < high - 4 * deviation).any():
        faults.append(f"the box {low} to {high} is larger than the solid, which reaches {inner_low} to {inner_high}")
    if path.stat().st_size < MAX_BYTES:
        in_file = np.asarray(tpmscad.check_step(path).shape.bounds, float)
        if np.abs(in_file - (low, high)).max() > 1e-3 * size:
            faults.append(f"the file's box {in_file} is not the model's, {low} to {high}")
    printed = [float(n) for n in re.search(r": ([\d.e+-]+) x ([\d.e+-]+) x ([\d.e+-]+) mm", repr(model)).groups()]  # type: ignore[union-attr]
    if np.abs(np.array(printed) - (high - low)).max() > 1e-4 * size:
        faults.append(f"printed is {printed}, the box measures {high - low}")
    return faults


def judge_walls(
    report: Any, vertices: np.ndarray, triangles: np.ndarray, deviation: float, wall: float | None
) -> list[str]:
    """What sampled walls contradict of a print check's smallest wall; `wall` is the thickness that was asked for.

    Triangles at sharp edges are no samples: there a lip ends, whose sides meet in the edge and may be parallel for an instant.
    """
    found = report.smallest_wall
    corners = vertices[triangles]
    centers = corners.mean(axis=1)
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    length = np.linalg.norm(normals, axis=1)
    keep = length > 0
    centers, normals = centers[keep], normals[keep] / length[keep, None]
    at_edge = touch_sharp_edges(corners[keep], normals, deviation)
    distance, near = cKDTree(centers).query(centers, k=min(NEIGHBOURS, len(centers)))
    across = centers[near] - centers[:, None]
    inwards = -(across * normals[:, None]).sum(axis=-1)
    opposite = (normals[near] * normals[:, None]).sum(axis=-1) < OPPOSITE_COSINE
    is_wall = opposite & (inwards > -OPPOSITE_COSINE * distance) & (distance > 10 * deviation)
    is_wall &= ~at_edge[:, None] & ~at_edge[near]
    sampled = float(distance[is_wall].min(initial=np.inf))
    if found is None or found.value is None:
        return [f"no wall is stated, sampled is one of {sampled:.4g}"] if np.isfinite(sampled) else []
    faults = []
    if found.bound > sampled + 4 * deviation:
        faults.append(f"no wall below {found.bound:.4g} is stated, sampled is one of {sampled:.4g}")
    if found.bound > found.value * (1 + 1e-9):
        faults.append(f"the bound {found.bound:.6g} is above the wall attained, {found.value:.6g}")
    if wall is not None and found.value > wall + 4 * deviation:
        faults.append(f"the smallest wall is stated as {found.value:.4g}, asked for were {wall:.4g}")
    places = np.asarray(found.places, float)
    if abs(float(np.linalg.norm(places[1] - places[0])) - found.value) > 1e-6 * found.value + 1e-9:
        faults.append(f"the places {places.tolist()} are not {found.value:.6g} apart")
    return faults


def touch_sharp_edges(corners: np.ndarray, normals: np.ndarray, deviation: float) -> np.ndarray:
    """Whether triangles (m, 3, 3) have a corner where the unit normals (m, 3) of the triangles differ much: (m,)."""
    _, vertex = np.unique(np.round(corners.reshape(-1, 3) / (1e-3 * deviation)), axis=0, return_inverse=True)
    vertex = vertex.reshape(-1)
    count = np.bincount(vertex)
    mean = np.stack([np.bincount(vertex, np.repeat(normals[:, k], 3)) for k in range(3)], axis=-1) / count[:, None]
    return np.asarray((np.linalg.norm(mean, axis=-1) < SHARP_MEAN)[vertex].reshape(-1, 3).any(axis=1))


def judge_fraction(model: Any, envelope: float | None) -> list[str]:
    """What the volume of the request's body or box contradicts of the fraction that `measure` states."""
    import tpmscad

    if envelope is None:
        return []
    found = tpmscad.measure(model)
    faults = []
    if abs(found.envelope_volume - envelope) > 1e-6 * envelope:
        faults.append(f"the envelope ({found.envelope}) has {found.envelope_volume:.6g}, the request {envelope:.6g}")
    if abs(found.volume_fraction * envelope - model.volume) > 1e-6 * model.volume:
        faults.append(f"the fraction is stated as {found.volume_fraction:.6g}, it is {model.volume / envelope:.6g}")
    return faults


def judge_labels(model: Any, low: np.ndarray, high: np.ndarray, body: Any) -> list[str]:
    """Faces with the label of a side of the box, or of a face of the body, that do not lie there; and those without a label."""
    import build123d as bd

    faults, of_body = [], [] if body is None else bd.Shape.cast(body.wrapped).faces()
    size = float(np.linalg.norm(high - low))
    for solid in model.named_solids():
        for label, face in zip(solid.labels, bd.Shape.cast(solid.solid).faces(), strict=True):
            points = np.array([tuple(edge @ t) for edge in face.edges() for t in (0.0, 0.3, 0.7)])
            if not label:
                faults.append(f"a face about {points.mean(axis=0)} has no label")
            elif match := re.fullmatch(r"cap ([XYZ])([+-])", label):
                axis, side = "XYZ".index(match[1]), high if match[2] == "+" else low
                if np.abs(points[:, axis] - side[axis]).max() > 1e-6 * size:
                    faults.append(f"a face with the label {label} lies off {side[axis]:g} at {points.mean(axis=0)}")
            elif match := re.match(r"body (\d+)", label):
                owner = of_body[int(match[1])]
                off = max(owner.distance_to(bd.Vertex(*p.tolist())) for p in points)
                if off > 1e-5 * size:
                    faults.append(f"a face with the label {label} is {off:.3g} off that face of the body")
    return faults[:3]


def judge_statements(
    model: Any, path: Path, *, wall: float | None, envelope: float | None, body: Any, box: np.ndarray | None
) -> list[str]:
    """All that is wrong with what is stated of a model that was written to `path`.

    wall: the constant thickness that was asked for. envelope: the volume of the body or the box of the request. box: its corners
    (2, 3), if it is a box that caps close.
    """
    c = model.certificate
    deviation = max(c.tol, 1e-3 * c.volume / c.area)
    angle = FINE_ANGLE if c.n_faces <= MAX_FACES else COARSE_ANGLE
    vertices, triangles = triangulate(model.wrapped, deviation, angle=angle)
    faults = judge_size(model, path, vertices, deviation)
    if c.n_faces <= MAX_FACES:
        faults += judge_walls(model.check_print(), vertices, triangles, deviation, wall)
        faults += judge_fraction(model, envelope)
        corners = np.full((2, 3), np.nan) if box is None else box
        faults += judge_labels(model, corners[0], corners[1], body) if box is not None or body is not None else []
    return faults

"""Vertices, edges, faces and solids of a boundary representation as Part 21 entities, formatted in bulk from the arrays.

A surface or curve with several uses in one place is written once. Pcurves and degenerate edges at poles are omitted, which every
reader permits.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from tpmscad._typing import IntArray
from tpmscad.brep.boundary_representation import Brep
from tpmscad.brep.carriers import Plane
from tpmscad.brep.loops import signed_area
from tpmscad.brep.solid_names import name_pieces
from tpmscad.kernel.build.shell_nesting import ShellNesting
from tpmscad.kernel.step.geometry_entities import (
    PlacedGeometry,
    poles_of,
    write_curves,
    write_directions,
    write_points,
    write_surfaces,
)
from tpmscad.kernel.step.part21 import DataSection, format_reals, format_references, format_string
from tpmscad.splines.bspline import BSplineSurface


def write_solids(
    section: DataSection,
    brep: Brep,
    nesting: ShellNesting,
    name: str,
    labels: Sequence[str],
) -> tuple[list[int], list[int]]:
    """Write the solids of a closed boundary representation and return the numbers of the solids and of all faces.

    `name` is that of the first solid, the others have their place, too (`name_pieces`); `labels` are the names of the faces.
    """
    surfaces = PlacedGeometry.distinct(brep.faces.carrier, brep.faces.motion)
    curves = PlacedGeometry.distinct(brep.edges.curve, brep.edges.motion)
    poles, control = [poles_of(c) for c in brep.carriers], [poles_of(c) for c in brep.curves]
    surface_points, curve_points = surfaces.points(poles), curves.points(control)
    numbers = write_points(section, np.concatenate([brep.vertices, *surface_points, *curve_points]))
    sizes = [len(brep.vertices), *map(len, surface_points), *map(len, curve_points)]
    of_vertex, *of_rest = np.split(numbers, np.cumsum(sizes)[:-1])
    of_surface, of_curve = of_rest[: len(surface_points)], of_rest[len(surface_points) :]

    surface_number = write_surfaces(section, brep, surfaces, of_surface)
    curve_number = write_curves(section, brep, curves, of_curve)
    edge_number = _write_edges(section, brep, of_vertex, curve_number[curves.index])
    faces = _write_faces(section, brep, surface_number[surfaces.index], edge_number, labels)
    shells = section.extend(
        [
            f"CLOSED_SHELL('',{format_references((faces[nesting.faces_of_shell(s)]).tolist())})"
            for s in range(len(nesting.volume))
        ]
    )
    solids = []
    shell_of_use, edge = nesting.shell_of_face[brep.face_of_use], brep.uses.edge
    corners = [brep.vertices[brep.edges.start[edge[shell_of_use == outer]]] for outer, *_ in nesting.shells_of_solid]
    for own_name, (outer, *voids) in zip(name_pieces(name, corners), nesting.shells_of_solid, strict=True):
        solids.append(write_solid(section, own_name, shells[outer], [shells[v] for v in voids]))
    return solids, faces.tolist()


def write_solid(section: DataSection, name: str, outer: int, voids: Sequence[int]) -> int:
    """Write the MANIFOLD_SOLID_BREP or BREP_WITH_VOIDS of closed shells and return its number."""
    if not voids:
        return section.add(f"MANIFOLD_SOLID_BREP({format_string(name)},#{outer})")
    # The shell of a void bounds the void like a solid and is reversed here (advanced_brep_shape_representation, WR5).
    inner = section.extend([f"ORIENTED_CLOSED_SHELL('',*,#{shell},.F.)" for shell in voids])
    return section.add(f"BREP_WITH_VOIDS({format_string(name)},#{outer},{format_references(inner)})")


def _write_edges(section: DataSection, brep: Brep, points: IntArray, curve: IntArray) -> IntArray:
    """Write vertices and EDGE_CURVEs and return the numbers of the edges."""
    edges = brep.edges
    vertices = np.array(section.extend([f"VERTEX_POINT('',#{p})" for p in points.tolist()]))
    curve = curve.copy()
    straight = np.flatnonzero(curve == 0)
    along = brep.vertices[edges.end[straight]] - brep.vertices[edges.start[straight]]
    length = np.linalg.norm(along, axis=1)
    along_each = write_directions(section, along / length[:, None])
    vectors = section.extend(
        [f"VECTOR('',#{d},{r})" for d, r in zip(along_each, format_reals(length.tolist()), strict=True)]
    )
    origins = points[edges.start[straight]].tolist()
    curve[straight] = section.extend([f"LINE('',#{p},#{v})" for p, v in zip(origins, vectors, strict=True)])
    rows = np.column_stack([vertices[edges.start], vertices[edges.end], curve]).tolist()
    return np.array(section.extend([f"EDGE_CURVE('',#{a},#{b},#{c},.T.)" for a, b, c in rows]))


def _write_faces(
    section: DataSection, brep: Brep, surface: IntArray, edge: IntArray, labels: Sequence[str]
) -> IntArray:
    """Write one ADVANCED_FACE per face, named by its label, and return their numbers.

    Loops run counter-clockwise about the outward normal.
    """
    faces, uses = brep.faces, brep.uses
    outward = faces.sense[brep.face_of_use] > 0
    along = np.where((uses.sense > 0) == outward, "T", "F").tolist()
    oriented = section.extend(
        [f"ORIENTED_EDGE('',*,*,#{e},.{s}.)" for e, s in zip(edge[uses.edge].tolist(), along, strict=True)]
    )
    face_of_loop = np.repeat(np.arange(len(faces)), np.diff(faces.loop_start))
    turned = (faces.sense[face_of_loop] < 0).tolist()
    starts = faces.use_start.tolist()
    members = (oriented[a:b] for a, b in itertools.pairwise(starts))
    runs = (uses[::-1] if backwards else uses for uses, backwards in zip(members, turned, strict=True))
    loop = section.extend([f"EDGE_LOOP('',{format_references(run)})" for run in runs])
    kind = ["FACE_OUTER_BOUND" if outer else "FACE_BOUND" for outer in find_outer_loops(brep).tolist()]
    bounds = section.extend([f"{k}('',#{n},.T.)" for k, n in zip(kind, loop, strict=True)])
    quoted = {label: format_string(label) for label in set(labels)}
    first = faces.loop_start.tolist()
    quadric = np.array([not isinstance(c, BSplineSurface | Plane) for c in brep.carriers], bool)[faces.carrier]
    mirrored = quadric & (faces.motion.handedness < 0)  # S_u x S_v opposes that of the STEP surface
    rows = zip(
        (quoted[label] for label in labels), surface.tolist(), np.where(mirrored, -1, 1) * faces.sense, strict=True
    )
    return np.array(
        section.extend(
            [
                f"ADVANCED_FACE({label},{format_references(bounds[first[i] : first[i + 1]])},"
                f"#{s},.{'T' if sense > 0 else 'F'}.)"
                for i, (label, s, sense) in enumerate(rows)
            ]
        )
    )


def find_outer_loops(brep: Brep) -> np.ndarray:
    """Mask of the loops that are outer loops: a face's only loop, or the one that encloses the largest area."""
    faces = brep.faces
    counts = np.diff(faces.loop_start)
    outer = np.ones(len(faces.use_start) - 1, bool)
    for face in np.flatnonzero(counts > 1).tolist():
        loops = range(int(faces.loop_start[face]), int(faces.loop_start[face + 1]))
        areas = [_loop_area(brep, face, range(int(faces.use_start[j]), int(faces.use_start[j + 1]))) for j in loops]
        outer[loops.start : loops.stop] = np.arange(len(areas)) == int(np.argmax(areas))
    return outer


AREA_SAMPLES_PER_EDGE = 8
"""Points per edge for the area of a loop, which only distinguishes outer loops from holes."""


def _loop_area(brep: Brep, face: int, uses: range) -> float:
    """Signed area of a loop in its carrier's parameters, positive if counter-clockwise."""
    points = []
    carrier = brep.carriers[int(brep.faces.carrier[face])]
    for k in uses:
        e = int(brep.uses.edge[k])
        low, high = brep.edges.span[e].tolist()
        t = np.linspace(low, high, AREA_SAMPLES_PER_EDGE + 1)
        if isinstance(carrier, Plane):
            space = brep.edges.motion[e].apply(brep.curves[int(brep.edges.curve[e])](t))
            uv = carrier.parameters(brep.faces.motion[face].apply_inverse(space))
        else:
            uv = brep.pcurves[int(brep.uses.pcurve[k])](t)
        points.append((uv if brep.uses.sense[k] > 0 else uv[::-1])[:-1])
    return signed_area(np.concatenate(points))

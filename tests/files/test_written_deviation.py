"""Triangles keep the deviation asked and the one told, by foot points of their own, in each way in which they are made."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest
import trimesh
from OCP.BRep import BRep_Builder
from OCP.Geom import Geom_Line
from OCP.gp import gp_Dir, gp_Pnt
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import fields
from tpmscad.brep.boundary_representation import Brep, spline_faces
from tpmscad.brep.orthogonal_projection import project_to_patch
from tpmscad.errors import KernelError
from tpmscad.kernel.export.chord_crossings import find_crossing_uses
from tpmscad.kernel.export.edge_division import count_least_chords, divide_edges, explore_faces
from tpmscad.kernel.export.solid_mesh import count_open_sides, measure_meshes, mesh_solids
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of

pytestmark = pytest.mark.kernel

PLACES = np.array([[3, 3, 0], [0, 3, 3], [3, 0, 3], [2, 2, 2], [4, 1, 1], [1, 4, 1], [1, 1, 4]]) / 6.0
"""Points of a triangle in barycentric coordinates."""

START = np.linspace(0.0, 1.0, 17)
"""Parts of a patch from whose nearest point a foot is sought."""


def gyroid() -> tpmscad.Model:
    return tpmscad.lattice("gyroid", cell=10, thickness=1, reference="nodal", phase=(0, 0, 0), loose="keep")


@cache
def exchanger() -> Any:
    return tpmscad.fluid_domains(bd.Cylinder(4, 4), "gyroid", cell=8, thickness=0.8, tol=0.05)


WAYS: dict[str, tuple[Callable[[], tpmscad.Model], float]] = {
    "copies of faces": (gyroid, 0.036),
    "trimmed by a cylinder": (
        lambda: tpmscad.infill(bd.Cylinder(4, 4), "gyroid", cell=8, thickness=0.8, tol=0.05),
        0.05,
    ),
    "a field": (
        lambda: tpmscad.solidify(fields.sheet(fields.tpms("P", 10.0), -0.4, 0.4), ((0, 0, 0), (5, 5, 5)), tol=0.1),
        0.02,
    ),
    "a channel": (lambda: exchanger().plus, 0.03),
}


def distances_from_patches(brep: Brep, face: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances (n, k) of points (n, k, 3) from the spline surfaces of faces (n,); 0 where a face is on another surface."""
    found = np.zeros(points.shape[:2])
    for faces, surface in spline_faces(brep):
        (u0, u1), (v0, v1) = surface.domain
        uv = np.stack(np.meshgrid(u0 + (u1 - u0) * START, v0 + (v1 - v0) * START, indexing="ij"), axis=-1).reshape(
            -1, 2
        )
        tree = cKDTree(surface(*uv.T))
        chosen = np.flatnonzero(np.isin(face, faces))
        local = brep.faces.motion[face[chosen]][:, None].apply_inverse(points[chosen]).reshape(-1, 3)
        if len(chosen):
            distance = project_to_patch(surface, local, *uv[tree.query(local)[1]].T)[0]
            found[chosen] = distance.reshape(len(chosen), -1)
    return found


@pytest.mark.parametrize("way", WAYS)
def test_a_written_file_keeps_the_deviation(way: str, tmp_path: Path) -> None:
    make, deviation = WAYS[way]
    model = make()
    file = model.export(tmp_path / "part.stl", deviation=deviation)
    written = trimesh.load(file.path)
    assert written.is_watertight
    assert len(written.faces) == file.triangles
    number = {ShapeKey(face): i for i, face in enumerate(model.built.faces)}
    first, meshes = 0, measure_meshes([model.built], deviation, np.radians(20)).meshes
    for solid, mesh in zip(model.built.solids, meshes, strict=True):
        corners = written.triangles[first : first + len(mesh.triangles)]
        assert np.allclose(corners, mesh.points[mesh.triangles], atol=1e-5)
        face = np.array([number[ShapeKey(each)] for each in faces_of(solid)])[mesh.face]
        found = distances_from_patches(model.built.brep, face, PLACES @ corners)
        assert found.max() <= file.deviation + 1e-5
        assert file.deviation <= deviation
        first += len(mesh.triangles)


@pytest.mark.parametrize(
    ("body", "distance"),
    [
        (bd.Sphere(5), lambda p: 5 - np.linalg.norm(p, axis=-1)),
        (bd.Cone(3, 0, 4), lambda p: (3 - np.linalg.norm(p[..., :2], axis=-1)) * 0.8 - (p[..., 2] + 2) * 0.6),
        (bd.Torus(5, 2), lambda p: 2 - np.hypot(np.linalg.norm(p[..., :2], axis=-1) - 5, p[..., 2])),
    ],
)
def test_bodies_with_seams_and_poles_keep_the_deviation(body: bd.Part, distance: Callable[[Any], Any]) -> None:
    found = measure_meshes(body, 0.02, 0.5)
    (mesh,) = found.meshes
    at = PLACES @ mesh.points[mesh.triangles]
    off = np.abs(distance(at[~np.isclose(at[..., 2], at[:, :1, 2]).all(axis=1)]))
    assert 0.01 < off.max() <= found.deviation <= 0.02


def test_nodes_closer_than_occt_resolves_are_one() -> None:
    """The edge of an intersection may be a few times as long as its tolerance."""
    outline = bd.Polyline((0, 0), (10, 0), (10, 8), (10 - 3e-7, 8 + 3e-7), (0, 8), (0, 0))
    found = measure_meshes(bd.extrude(bd.make_face(outline), 5), 0.05, 0.5)
    assert len(found.meshes[0].triangles) == 12
    assert found.meshes[0].volume == pytest.approx(400, rel=1e-6)
    assert 2e-7 < found.deviation < 2e-6


def test_triangles_without_a_solid_keep_the_deviation() -> None:
    pytest.importorskip("manifold3d")
    part = tpmscad.infill_triangles(bd.Cylinder(3, 3), "P", cell=2, thickness=0.3, skin=0.3, deviation=0.01)
    assert part.deviation <= 0.01
    at = PLACES @ part.points[part.triangles[part.face > 0]]
    radius = np.linalg.norm(at[..., :2], axis=-1)
    off = np.minimum.reduce(
        [np.abs(radius - r) for r in (3.0, 2.7)] + [np.abs(np.abs(at[..., 2]) - h) for h in (1.5, 1.2)]
    )
    assert 0.004 < off.max() <= part.deviation


def test_edges_beside_their_faces_are_told() -> None:
    """A tolerant edge is off its faces by more than is asked: no triangles between its nodes keep that."""
    box = bd.Box(4, 4, 4)
    edge = box.edges()[0]
    start, along = edge @ 0, edge % 0
    moved = Geom_Line(gp_Pnt(start.X + 0.05, start.Y + 0.05, start.Z + 0.05), gp_Dir(along.X, along.Y, along.Z))
    BRep_Builder().UpdateEdge(edge.wrapped, moved, 0.1)
    with pytest.raises(KernelError, match=r"edges lie up to .* off their faces, more than deviation = 0.01: raise it"):
        measure_meshes(box, 0.01, 0.5)
    (mesh,) = mesh_solids(box, 0.01, 0.5)
    assert mesh.volume == pytest.approx(64, rel=1e-2)  # the body as it is, for what asks where it is solid


def thin_tube(wall: float) -> Any:
    """A tube whose circles begin at other angles, so that chords of the outer one cross those of the inner one."""
    return bd.Cylinder(5, 3) - bd.Rot(0, 0, 37) * bd.Cylinder(5 - wall, 3)


def test_of_chords_that_cross_the_longer_ones_of_a_cusp_or_a_sliver_are_divided() -> None:
    outlines = explore_faces([faces_of(thin_tube(0.03).wrapped)])
    division = divide_edges(outlines, 0.05, 0.35, count_least_chords(outlines))
    divided: set[float] = set()
    for r, face in enumerate(outlines.sources):
        edges = outlines.uses_of(r)
        found = find_crossing_uses(face, [division.placed[e] for e in edges.tolist()], outlines.ends[edges])
        divided |= {round(float(np.hypot(*division.placed[e][1][0, :2])), 6) for e in edges[found].tolist()}
    assert divided == {5.0}, "chords of the inner circle lie on the other side of it"


@pytest.mark.parametrize("wall", [0.03, 1e-3, 1e-4])
def test_a_wall_much_thinner_than_the_deviation_is_meshed_closed(wall: float) -> None:
    tube = thin_tube(wall)
    found = measure_meshes(tube.wrapped, 0.05, 0.35)
    (mesh,) = found.meshes
    assert found.deviation <= 0.05
    assert not count_open_sides(mesh.triangles)
    corners = mesh.points[mesh.triangles]
    volume = np.einsum("ij,ij->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6
    assert 0 < volume < 4 * tube.volume

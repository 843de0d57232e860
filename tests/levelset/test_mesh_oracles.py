"""Compiled loops of meshes against plain array oracles: shapes of polygons, smoothing steps, collapses, minimal faces."""

from __future__ import annotations

import numpy as np
import pytest

from tests.levelset.test_collapses import full_mesh, normals
from tests.shapes.cut_fields import FIELDS, HI, LO
from tpmscad.levelset.quadmesh import octree, quality
from tpmscad.levelset.quadmesh.octree_faces import (
    FACE_AXES,
    MinimalFaces,
    OctreeNodes,
    find_leaves,
    find_minimal_faces,
    pair_crossed_edges,
)
from tpmscad.levelset.quadmesh.simplification.collapse_candidates import SCORE_PER_SAVED_PATCH, rank_candidates
from tpmscad.levelset.quadmesh.simplification.collapses import CollapseSeed, plan_edit
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import PolygonMesh
from tpmscad.levelset.quadmesh.simplification.vertex_stars import (
    SurfaceVertices,
    build_vertex_stars,
    polygon_left_of,
)
from tpmscad.levelset.quadmesh.smoothing import (
    MAX_MOVE_FRACTION,
    MIN_BOX_SIDE_RATIO,
    place_vertices,
    step_along_surface,
)

NAMES = ("gyroid", "iwp", "ball cut by the box")


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-300)


def shaken(name: str) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices moved at random, normals there, fixed coordinates and polygons of a mesh."""
    mesh = full_mesh(name)
    move = 0.03 * np.random.default_rng(1).normal(size=mesh.vertices.shape)
    vertices = mesh.vertices + np.where(mesh.fixed, 0.0, move)
    return vertices, unit(FIELDS[name].gradient(vertices)), mesh.fixed, mesh.corners


def corner_sines(points: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Signed sines at the corners of one polygon (n, 3)."""
    side = np.roll(points, -1, axis=0) - points
    before = np.roll(side, 1, axis=0)
    size = np.linalg.norm(side, axis=1) * np.linalg.norm(before, axis=1)
    return np.einsum("ni,ni->n", np.cross(before, side), up) / size


@pytest.mark.parametrize("name", NAMES)
def test_corners_are_measured_as_by_arrays(name: str) -> None:
    vertices, up, fixed, polygons = shaken(name)
    found = quality.corner_distortion(vertices, up, fixed, polygons)
    for row, distortion in zip(polygons, found, strict=True):
        ids = row[row >= 0]
        p, n, f = vertices[ids], up[ids], fixed[ids]
        chords = [(i, k) for i in range(len(ids)) for k in range(i)]
        tilt = [abs(unit(p[k] - p[i]) @ n[end]) for i, k in chords for end in (i, k)]
        sine = corner_sines(p, n).min()
        size = np.linalg.norm(np.roll(p, -1, axis=0) - p, axis=1)
        if f.any(axis=1).sum() > 1:
            for k in range(len(ids)):
                common = f[k] & f[(k + 1) % len(ids)]
                if common.any():
                    chord = unit(np.where(common, 0, p[(k + 1) % len(ids)] - p[k]))
                    tilt += [abs(chord @ unit(np.where(common, 0, n[end % len(ids)]))) for end in (k, k + 1)]
                if (common & f[k - 1]).any():
                    sine = -1.0
        cosine = min(n[i] @ n[k] for i, k in chords)
        expected = max(
            quality.MIN_SIDE_RATIO * size.max() / size.min(),
            (1 - sine) / (1 - quality.MIN_CORNER_SINE),
            max(tilt) / quality.MAX_TILT_SINE,
            (1 - min(cosine, 1)) / (1 - quality.MIN_NORMAL_COSINE),
        )
        assert np.isclose(distortion, expected, rtol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_interiors_are_measured_as_by_arrays(name: str) -> None:
    vertices, up, fixed, polygons = shaken(name)
    found = quality.interior_distortion(FIELDS[name], vertices, up, fixed, polygons)
    assert (polygons[:, 3] < 0).any() or name == "ball cut by the box"
    for row, distortion in zip(polygons, found, strict=True):
        ids = np.where(row < 0, row[2], row)
        after = np.roll(ids, -1)
        start = np.vstack([0.5 * (vertices[ids] + vertices[after]), vertices[ids].mean(axis=0)])
        side = np.linalg.norm(vertices[ids] - vertices[after], axis=1)
        side = np.append(side, side.max())
        held = np.vstack([fixed[ids] & fixed[after], np.zeros(3, bool)])
        points = start
        for _ in range(quality.NEWTON_STEPS_FROM_MIDPOINTS):
            value, gradient = FIELDS[name].value_and_gradient(points)
            free = np.where(held, 0.0, gradient)
            step = -(value / np.maximum((free**2).sum(axis=1), 1e-300))[:, None] * free
            longest = quality.MAX_SAG_FRACTION * side
            points = points + np.minimum(1, longest / np.maximum(np.linalg.norm(step, axis=1), 1e-300))[:, None] * step
        sag = np.linalg.norm(points - start, axis=1)[side > 0] / side[side > 0]
        middle = unit(gradient)
        cosines = [middle[:4] * up[ids], middle[:4] * up[after], middle[4] * up[ids]]
        sine = 1.0
        if row[3] >= 0:
            quarters = [
                (np.array([vertices[ids[k]], *points[[k, 4, k - 1 if k else 3]]]),
                 np.array([up[ids[k]], *middle[[k, 4, k - 1 if k else 3]]]))
                for k in range(4)
            ]  # fmt: skip
            sine = min(corner_sines(p, n).min() for p, n in quarters)
        expected = max(
            sag.max() / quality.MAX_SAG_FRACTION,
            (1 - min(c.sum(axis=1).min() for c in cosines)) / (1 - quality.MIN_MIDPOINT_NORMAL_COSINE),
            (1 - sine) / (1 - quality.MIN_QUARTER_SINE),
        )
        assert np.isclose(distortion, expected, rtol=1e-11)


def test_vertices_step_towards_their_target_along_the_surface_and_to_the_level_set() -> None:
    rng = np.random.default_rng(2)
    old, gradient, value = rng.uniform(0, 1, (40, 3)), rng.normal(size=(40, 3)), 0.3 * rng.normal(size=40)
    target, shortest, max_step = rng.uniform(0, 1, (40, 3)), rng.uniform(0.1, 2, 40), rng.uniform(0.05, 0.5, 40)
    fixed = np.arange(120).reshape(40, 3) % 5 == 0  # at most one coordinate of a vertex
    free, longest = np.where(fixed, 0.0, gradient), np.minimum(max_step, MAX_MOVE_FRACTION * shortest)

    def step(target: np.ndarray, value: np.ndarray) -> np.ndarray:
        return step_along_surface(old, target, shortest, value, gradient, fixed, max_step) - old

    along, across = step(target, np.zeros(40)), step(old, value)
    np.testing.assert_allclose(step(target, value), along + across, atol=1e-14)
    assert not np.where(fixed, along, 0.0).any()
    assert not np.where(fixed, across, 0.0).any()
    np.testing.assert_allclose((along * free).sum(axis=1), 0, atol=1e-14)
    assert ((along * (target - old)).sum(axis=1) >= 0).all()
    size, reach = np.linalg.norm(across, axis=1), np.abs(value) / np.linalg.norm(free, axis=1)
    np.testing.assert_allclose(size, np.minimum(reach, max_step), rtol=1e-12)
    near = reach < max_step
    assert 0 < near.sum() < 40
    np.testing.assert_allclose((across * free).sum(axis=1)[near], -value[near], rtol=1e-12)
    assert (np.linalg.norm(along, axis=1) <= longest * (1 + 1e-12)).all()
    tangential = np.where(fixed, 0.0, target - old)
    tangential -= (tangential * unit(free)).sum(axis=1)[:, None] * unit(free)
    reaches = np.linalg.norm(tangential, axis=1) < longest
    assert 0 < reaches.sum() < 40
    np.testing.assert_allclose(along[reaches], tangential[reaches], atol=1e-14)


def test_vertices_are_placed_unless_that_leaves_their_sides_on_the_box_too_unequal() -> None:
    rng = np.random.default_rng(3)
    before, ids = rng.uniform(0, 1, (60, 3)), np.arange(10, 50)
    new, on_face = before[ids] + 0.3 * rng.normal(size=(40, 3)), np.arange(10, 40)
    neighbours = rng.permutation(60)[: 2 * len(on_face)].reshape(-1, 2)
    vertices = before.copy()
    place_vertices(vertices, ids, new, on_face, neighbours)
    expected = before.copy()
    expected[ids] = new

    def ratio(points: np.ndarray) -> np.ndarray:
        sides = np.linalg.norm(points[on_face][:, None] - points[neighbours], axis=2)
        return sides.min(axis=1) / sides.max(axis=1)

    stays = on_face[(ratio(expected) < MIN_BOX_SIDE_RATIO) & (ratio(expected) < ratio(before))]
    assert 0 < len(stays) < len(on_face)
    expected[stays] = before[stays]
    assert np.array_equal(vertices, expected)


@pytest.mark.parametrize("name", NAMES)
def test_ratings_are_those_of_the_planned_edits(name: str) -> None:
    """The worst of the polygons that the edit adds, and the patches that it saves, where it makes no doublets."""
    mesh = full_mesh(name)
    polygons = PolygonMesh(mesh)
    surface = SurfaceVertices(FIELDS[name], mesh.vertices, normals(mesh, name), mesh.fixed)
    stars = build_vertex_stars(polygons.rows, len(mesh.vertices))
    found = rank_candidates(stars, surface, np.array(sorted(polygons.corners_of)), np.inf)
    compared = {True: 0, False: 0}
    for k in np.flatnonzero(np.isfinite(found.score)).tolist():
        seed = found.seeds.seed(k)
        edit = plan_edit(polygons, seed)
        if edit is None or edit.doublets:
            continue
        after = surface
        applied = polygons.apply(edit)
        around = {f for v in edit.merges.values() for f in polygons.polygons_at_vertex[v]}.union(applied.new_numbers)
        rows = polygons.rows[list(around)]
        polygons.undo(applied)
        if seed.merges:
            goes, stays = np.array(seed.merges).T
            after = surface.append_merged_vertices(goes, stays)
            for i, v in enumerate(stays):
                rows[rows == v] = len(mesh.vertices) + i
        worst = quality.corner_distortion(after.vertices, after.normals, after.fixed, rows).max()
        assert np.isclose(found.score[k], worst - SCORE_PER_SAVED_PATCH * edit.patches_saved, rtol=0, atol=1e-12)
        compared[_is_diagonal(polygons, seed)] += 1
    assert min(compared.values()) > 5


def _is_diagonal(polygons: PolygonMesh, seed: CollapseSeed) -> bool:
    return len(seed.removed) == len(seed.merges) == 1 and len(polygons.corners_of[seed.removed[0]]) == 4


def test_stars_hold_the_polygons_round_each_vertex() -> None:
    mesh = full_mesh("gyroid")
    polygons = PolygonMesh(mesh)
    stars = build_vertex_stars(polygons.rows, len(mesh.vertices))
    for v, around in enumerate(polygons.polygons_at_vertex):
        entries = slice(stars.first[v], stars.first[v + 1])
        assert set(stars.polygon[entries].tolist()) == around
        assert (stars.rows[stars.polygon[entries], stars.slot[entries]] == v).all()
    half_edges = polygons.polygon_of_half_edge
    pairs = np.random.default_rng(4).integers(0, len(mesh.vertices), (300, 2)).tolist()
    for a, b in [*half_edges, *pairs]:
        assert polygon_left_of(stars, a, b) == half_edges.get((a, b), -1)


def test_the_next_free_candidate_changes_no_polygon_at_a_taken_vertex() -> None:
    mesh = full_mesh("iwp")
    polygons = PolygonMesh(mesh)
    surface = SurfaceVertices(FIELDS["iwp"], mesh.vertices, normals(mesh, "iwp"), mesh.fixed)
    stars = build_vertex_stars(polygons.rows, len(mesh.vertices))
    known = rank_candidates(stars, surface, np.array(sorted(polygons.corners_of)), 2.0)
    is_taken = np.random.default_rng(5).random(len(mesh.vertices)) < 0.07
    order, free = known.ranking(), []
    for place, k in enumerate(order.tolist()):
        seed = known.seeds.seed(k)
        changed = {f for pair in seed.merges for v in pair for f in polygons.polygons_at_vertex[v]} | {*seed.removed}
        if not any(is_taken[v] for f in changed for v in polygons.corners_of[f]):
            free.append(place)
    found = [known.find_next_free(order, 0, stars, is_taken)]
    while found[-1] < len(order):
        found.append(known.find_next_free(order, found[-1] + 1, stars, is_taken))
    assert found == [*free, len(order)]
    assert 0 < len(free) < len(order)


@pytest.mark.parametrize("solid_nodes", [None, 0.02, 0.2])
@pytest.mark.parametrize("name", ["gyroid", "ball"])
def test_the_level_set_crosses_no_minimal_face_away_from_the_leaves_near_it(
    name: str, solid_nodes: float | None
) -> None:
    """Single nodes in the solid, at random, cross faces at hanging nodes only."""
    rng = np.random.default_rng(6)
    tree = octree.uniform_octree(LO, HI, np.array((4, 5, 4)))
    for share in (0.3, 0.1):
        tree = octree.split_leaves(tree, rng.random(len(tree.size)) < share)
    nodes = OctreeNodes(tree, FIELDS[name])
    if solid_nodes is not None:
        nodes.values = np.where(rng.random(len(nodes.ids)) < solid_nodes, -1.0, 1.0)
    rows = []
    for axis, (b, c) in enumerate(FACE_AXES):
        for upper in (0, 1):
            origin, centre = tree.origin.copy(), tree.origin.copy()
            origin[:, axis] += upper * tree.size
            centre[:, axis] += upper * tree.size
            centre[:, [b, c]] += tree.size[:, None] // 2
            minimal = (tree.size == 1) | ~np.isin(nodes.flat_index(centre), nodes.ids)
            rows.append(np.column_stack([origin, np.full(len(origin), axis), tree.size])[minimal])
    faces = np.unique(np.concatenate(rows), axis=0)
    origin, axis = faces[:, :3], faces[:, 3]
    below, above = (find_leaves(tree, origin - shift * np.eye(3, dtype=int)[axis]) for shift in (1, 0))
    all_faces = MinimalFaces(origin, axis, faces[:, 4], below, above)
    near = find_minimal_faces(tree, nodes)
    assert len(near.axis) < len(axis) or solid_nodes == 0.2
    expected, found = (pair_crossed_edges(tree, nodes, FIELDS[name], each) for each in (all_faces, near))
    for each in ("edge", "half_plane", "cell", "plane"):
        assert np.array_equal(getattr(found, each), getattr(expected, each))

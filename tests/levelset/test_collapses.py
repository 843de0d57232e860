"""Laws of simplified meshes: the same closed two-manifold on the box and on the field, of fewer and well shaped polygons."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.shapes.cut_fields import FIELDS, HI, LO
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh, build_dual_mesh
from tpmscad.levelset.quadmesh.quality import corner_distortion
from tpmscad.levelset.quadmesh.simplification import collapse_candidates
from tpmscad.levelset.quadmesh.simplification.collapses import CollapseSeed, find_seeds, plan_edit
from tpmscad.levelset.quadmesh.simplification.greedy_simplification import simplify_mesh
from tpmscad.levelset.quadmesh.simplification.polygon_mesh import (
    MAX_VALENCE,
    MIN_VALENCE,
    MeshEdit,
    PolygonMesh,
    extract_mesh,
)
from tpmscad.levelset.quadmesh.simplification.vertex_stars import SurfaceVertices, build_vertex_stars
from tpmscad.levelset.quadmesh.smoothing import smooth_mesh


@cache
def full_mesh(name: str, seed: int = 4, share: float = 0.1) -> QuadMesh:
    rng = np.random.default_rng(seed)
    tree = octree.uniform_octree(LO, HI, np.array((4, 5, 4)))
    tree = octree.split_leaves(tree, rng.random(len(tree.size)) < share)
    field = FIELDS[name]
    return smooth_mesh(build_dual_mesh(tree, field), field, LO, HI)


@cache
def smaller(name: str) -> QuadMesh:
    return simplify_mesh(full_mesh(name), FIELDS[name], LO, HI).mesh()[0]


def patches(mesh: QuadMesh) -> int:
    return int(np.where(mesh.corners[:, 3] < 0, 3, 1).sum())


def euler(mesh: QuadMesh) -> int:
    return len(mesh.vertices) - len(mesh.side_ends) + len(mesh.corners)


def normals(mesh: QuadMesh, name: str) -> np.ndarray:
    slope = FIELDS[name].gradient(mesh.vertices)
    return slope / np.linalg.norm(slope, axis=1, keepdims=True)


def plan_edits_from(polygons: PolygonMesh, number: int) -> list[MeshEdit]:
    """All valid edits that start from one polygon: of the diagonals, found one by one, and of the other seeds."""
    polygon, n_fixed = polygons.corners_of[number], np.array(polygons.n_fixed)
    diagonals = [
        sorted(pair, key=lambda v: (n_fixed[v], v)) for pair in (polygon[::2], polygon[1::2]) if len(polygon) == 4
    ]
    seeds = [CollapseSeed(((a, b),), (number,)) for a, b in diagonals if not n_fixed[a]]
    found = find_seeds(build_vertex_stars(polygons.rows, len(n_fixed)), n_fixed, np.array([number]))
    seeds += [found.seed(row) for row in range(len(found))]
    return [edit for edit in (plan_edit(polygons, seed) for seed in dict.fromkeys(seeds)) if edit is not None]


def rows(mesh: QuadMesh) -> list[tuple[int, ...]]:
    return [tuple(v for v in corners if v >= 0) for corners in mesh.corners.tolist()]


@pytest.mark.parametrize("name", FIELDS)
class TestEverySimplifiedMesh:
    @pytest.mark.slow
    def test_has_fewer_patches(self, name: str) -> None:
        assert patches(smaller(name)) < 0.95 * patches(full_mesh(name))

    @pytest.mark.slow
    def test_is_the_same_surface(self, name: str) -> None:
        mesh = smaller(name)
        assert euler(mesh) == euler(full_mesh(name))
        ends = np.sort(mesh.side_ends, axis=1)
        assert len(np.unique(ends, axis=0)) == len(ends)
        assert (ends[:, 0] < ends[:, 1]).all()
        directed: dict[tuple[int, int], int] = {}
        for corners in mesh.corners.tolist():
            polygon = [v for v in corners if v >= 0]
            assert len(set(polygon)) == len(polygon)
            for a, b in zip(polygon, polygon[1:] + polygon[:1], strict=True):
                assert (a, b) not in directed
                directed[a, b] = 1
        for (a, b), plane in zip(mesh.side_ends.tolist(), mesh.side_plane, strict=True):
            assert directed.get((a, b), 0) + directed.get((b, a), 0) == (2 if plane < 0 else 1)

    def test_has_a_disk_or_half_disk_of_polygons_round_each_vertex(self, name: str) -> None:
        mesh = smaller(name)
        after: dict[int, dict[int, int]] = {}
        for corners in mesh.corners.tolist():
            polygon = [v for v in corners if v >= 0]
            for i, v in enumerate(polygon):
                after.setdefault(v, {})[polygon[(i + 1) % len(polygon)]] = polygon[i - 1]
        for v in range(len(mesh.vertices)):
            steps = after[v]
            starts = set(steps) - set(steps.values())
            assert len(starts) == int(mesh.fixed[v].any())
            at, seen = (next(iter(starts)) if starts else next(iter(steps))), 0
            while at in steps and seen < len(steps):
                at, seen = steps[at], seen + 1
            assert seen == len(steps)

    def test_ends_on_the_box_where_the_full_mesh_did(self, name: str) -> None:
        mesh, before = smaller(name), full_mesh(name)
        at = np.nonzero(mesh.fixed)
        assert np.isin(mesh.vertices[at], [0.0, *HI]).all()
        assert ((mesh.vertices == LO) | (mesh.vertices == HI) | ~mesh.fixed).all()
        on_box = np.flatnonzero(mesh.side_plane >= 0)
        axis, upper = np.divmod(mesh.side_plane[on_box], 2)
        bound = np.where(upper, HI[axis], LO[axis])
        points = mesh.vertices[mesh.side_ends[on_box]]
        assert (np.take_along_axis(points, axis[:, None, None], 2)[..., 0] == bound[:, None]).all()
        ends, old_ends = (m.vertices[m.fixed.sum(axis=1) == 2] for m in (mesh, before))
        assert len(ends) == len(old_ends)
        assert np.allclose(np.sort(ends, axis=0), np.sort(old_ends, axis=0), rtol=0, atol=1e-12)

    def test_lies_on_the_surface_with_polygons_no_worse_than_the_limit_or_than_before(self, name: str) -> None:
        mesh = smaller(name)
        assert (np.abs(FIELDS[name](mesh.vertices)) < 1e-9).all()
        assert ((mesh.vertices >= LO) & (mesh.vertices <= HI)).all()
        before, after = (
            corner_distortion(m.vertices, normals(m, name), m.fixed, m.corners).max() for m in (full_mesh(name), mesh)
        )
        assert after <= max(1.0, before)


@pytest.mark.slow
def test_simplification_is_the_same_bit_for_bit_once_more() -> None:
    once, again = smaller("gyroid"), simplify_mesh(full_mesh("gyroid"), FIELDS["gyroid"], LO, HI).mesh()[0]
    assert np.array_equal(once.vertices, again.vertices)
    assert np.array_equal(once.corners, again.corners)


@pytest.mark.slow
@pytest.mark.parametrize("name", FIELDS)
def test_collapses_planned_one_by_one_are_among_those_of_the_arrays(name: str) -> None:
    mesh = full_mesh(name)
    polygons = PolygonMesh(mesh)
    surface = SurfaceVertices(FIELDS[name], mesh.vertices, normals(mesh, name), mesh.fixed)
    numbers = np.array(sorted(polygons.corners_of))
    stars = build_vertex_stars(polygons.rows, len(mesh.vertices))
    found = collapse_candidates.rank_candidates(stars, surface, numbers, np.inf)
    into = {tuple(sorted(found.seeds.seed(k).merges)) for k in range(len(found))}
    one_by_one = {
        tuple(sorted(c.merges.items())) for n in numbers.tolist() for c in plan_edits_from(polygons, n) if c.merges
    }
    assert one_by_one <= into


@pytest.mark.slow
def test_undoing_the_history_from_its_end_restores_the_full_mesh() -> None:
    before = full_mesh("gyroid")
    found = simplify_mesh(before, FIELDS["gyroid"], LO, HI)
    mesh, numbers = found.mesh()
    for row, number in zip(rows(mesh), numbers.tolist(), strict=True):
        np.testing.assert_array_equal(
            mesh.vertices[list(row)], found._vertices[list(found.polygons.corners_of[number])]
        )
    for step in reversed(found.edits.values()):
        found.polygons.undo(step.applied)
    assert _state(found.polygons) == _state(PolygonMesh(before))


@pytest.mark.parametrize("name", ["gyroid", "iwp"])
def test_a_corner_of_the_box_edge_is_not_cut_off(name: str) -> None:
    mesh = full_mesh(name)
    polygons = PolygonMesh(mesh)
    on_edge = [v for v in np.flatnonzero(mesh.fixed.sum(axis=1) == 2) if len(polygons.polygons_at_vertex[v]) == 1]
    assert on_edge
    for v in on_edge:
        (number,) = polygons.polygons_at_vertex[v]
        polygon = polygons.corners_of[number]
        i = polygon.index(v)
        before, after = polygon[i - 1], polygon[(i + 1) % len(polygon)]
        assert polygons.plan_collapse({before: after}, [number]) is None
        assert polygons.plan_collapse({after: before}, [number]) is None


@given(draws=st.lists(st.tuples(st.integers(0, 10**6), st.integers(0, 3)), min_size=1, max_size=25))
@settings(max_examples=15, deadline=None)
def test_any_collapses_of_diagonals_keep_the_topology_and_can_be_taken_back(draws: list[tuple[int, int]]) -> None:
    mesh = full_mesh("schwarz_p")
    polygons = PolygonMesh(mesh)
    fixed = mesh.fixed.any(axis=1)
    for number, turn in draws:
        chosen = sorted(polygons.corners_of)[number % len(polygons.corners_of)]
        polygon = polygons.corners_of[chosen]
        a, b = polygon[turn % len(polygon)], polygon[(turn + len(polygon) // 2) % len(polygon)]
        if fixed[a] or fixed[b]:
            continue
        change = polygons.plan_collapse({a: b}, [chosen, polygons.polygon_of_half_edge.get((b, a), chosen)])
        if change is None:
            continue
        state = _state(polygons)
        made = polygons.apply(change)
        assert change.patches_saved > 0
        polygons.undo(made)
        assert _state(polygons) == state
        polygons.apply(change)
    after, _ = extract_mesh(polygons, mesh.vertices, mesh.size, sorted(polygons.corners_of))
    assert euler(after) == euler(mesh)
    assert np.array_equal(
        np.bincount(after.sides[after.sides >= 0], minlength=len(after.side_ends)),
        np.where(after.side_plane < 0, 2, 1),
    )


@pytest.mark.slow
@given(seed=st.integers(0, 10**6))
@settings(max_examples=15, deadline=None)
def test_collapses_at_random_stop_before_the_surface_changes(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = small(("ball", "schwarz_p", "gyroid")[seed % 3])
    polygons = PolygonMesh(mesh)
    for _ in range(300):
        chosen = int(rng.choice(sorted(polygons.corners_of)))
        found = plan_edits_from(polygons, chosen)
        if found:
            polygons.apply(found[rng.integers(len(found))])
    after, _ = extract_mesh(polygons, mesh.vertices, mesh.size, sorted(polygons.corners_of))
    assert len(after.corners) < 0.8 * len(mesh.corners)
    round_each = np.bincount(after.corners[after.corners >= 0])
    inner = ~after.fixed.any(axis=1)
    assert round_each[inner].min(initial=MIN_VALENCE) >= MIN_VALENCE
    assert round_each.max() <= max(MAX_VALENCE, np.bincount(mesh.corners[mesh.corners >= 0]).max())
    assert euler(after) == euler(mesh)
    assert np.array_equal(
        np.bincount(after.sides[after.sides >= 0], minlength=len(after.side_ends)),
        np.where(after.side_plane < 0, 2, 1),
    )


@cache
def small(name: str) -> QuadMesh:
    return build_dual_mesh(octree.uniform_octree(LO, HI, np.array((4, 4, 4))), FIELDS[name])


def _state(polygons: PolygonMesh) -> tuple[object, ...]:
    return (
        dict(polygons.corners_of),
        [set(a) for a in polygons.polygons_at_vertex],
        dict(polygons.polygon_of_half_edge),
        dict(polygons.plane_of_side),
    )


def test_a_polygon_with_two_consecutive_sides_in_a_face_of_the_box_is_beyond_the_limits() -> None:
    """The section of the box runs smoothly through the corner between them."""
    vertices = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
    up = np.tile([0.0, 0.0, 1.0], (4, 1))
    quad, triangle = np.array([[0, 1, 2, 3]]), np.array([[0, 1, 2, -1]])
    for axis, others in ((0, 1), (1, 0)):
        one_side, two_sides = np.zeros((4, 3), bool), np.zeros((4, 3), bool)
        one_side[[0, 1], axis] = one_side[1, others] = True  # up to an edge of the box, where the section turns
        two_sides[[0, 1, 2], axis] = True
        for corners in (quad, triangle):
            assert corner_distortion(vertices, up, one_side, corners)[0] <= 1
            assert corner_distortion(vertices, up, two_sides, corners)[0] > 1.5


def test_wider_limits_of_shape_leave_fewer_patches() -> None:
    name = "gyroid"
    narrow, wide = smaller(name), simplify_mesh(smaller(name), FIELDS[name], LO, HI, 1.5).mesh()[0]
    assert patches(wide) < patches(narrow)
    before, after = (corner_distortion(m.vertices, normals(m, name), m.fixed, m.corners) for m in (narrow, wide))
    assert np.count_nonzero(after > 1) > np.count_nonzero(before > 1)
    assert after.max() <= max(1.5, before.max())

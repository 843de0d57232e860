"""Laws of quad meshes: on any octree the dual mesh is a two-manifold of the field's topology, on the box and on the field."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tests.shapes.cut_fields import FIELDS, HI, LO
from tpmscad import fields
from tpmscad.errors import LevelSetError
from tpmscad.levelset.adaptive_search import MAX_DEPTH, MAX_DEPTH_OF_FEW
from tpmscad.levelset.field_solid import fit_field, fit_field_solid, measure_field_fit, simplify_field_fit
from tpmscad.levelset.quadmesh import octree
from tpmscad.levelset.quadmesh.dual_mesh import QuadMesh, build_dual_mesh
from tpmscad.levelset.quadmesh.patch_network import build_patch_network, match_networks
from tpmscad.levelset.quadmesh.smoothing import smooth_from_start, smooth_mesh
from tpmscad.levelset.quadmesh.vectors import corner_sines


def tree_of(seed: int, share: float, counts: tuple[int, int, int] = (5, 6, 4)) -> octree.Octree:
    rng = np.random.default_rng(seed)
    tree = octree.uniform_octree(LO, HI, np.array(counts))
    for _ in range(2):
        tree = octree.split_leaves(tree, rng.random(len(tree.size)) < share)
    return tree


def uses(mesh: QuadMesh) -> np.ndarray:
    return np.bincount(mesh.sides[mesh.sides >= 0], minlength=len(mesh.side_ends))


@given(seed=st.integers(0, 999), share=st.floats(0.0, 0.3))
@settings(max_examples=10, deadline=None)
def test_an_octree_fills_its_box_once_and_neighbours_differ_by_at_most_two(seed: int, share: float) -> None:
    tree = tree_of(seed, share)
    assert (tree.size**3).sum() == np.prod(tree.shape)
    at = np.argwhere(np.ones(tree.shape, bool))
    leaf_of_cell = tree.leaves_at(at).reshape(tree.shape)
    origin, size = tree.origin[leaf_of_cell.ravel()], tree.size[leaf_of_cell.ravel()]
    assert ((at >= origin) & (at < origin + size[:, None])).all()
    sizes = tree.size[leaf_of_cell]
    for step in np.ndindex(3, 3, 3):
        moved = tuple(slice(max(0, d - 1), n + min(0, d - 1)) for d, n in zip(step, sizes.shape, strict=True))
        back = tuple(slice(max(0, 1 - d), n + min(0, 1 - d)) for d, n in zip(step, sizes.shape, strict=True))
        ratio = sizes[moved] / sizes[back]
        assert ratio.max() <= 2
        assert ratio.min() >= 0.5


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize(("seed", "share"), [(0, 0.0), (1, 0.05), (2, 0.3)])
def test_inner_sides_join_two_polygons_and_those_on_the_box_belong_to_one(name: str, seed: int, share: float) -> None:
    mesh = build_dual_mesh(tree_of(seed, share), FIELDS[name])
    assert np.array_equal(uses(mesh), np.where(mesh.side_plane < 0, 2, 1))
    points = mesh.vertices[mesh.side_ends]
    on_box = mesh.side_plane >= 0
    axis, upper = np.divmod(mesh.side_plane[on_box], 2)
    bound = np.where(upper, HI[axis], LO[axis])
    assert (np.take_along_axis(points[on_box], axis[:, None, None], 2)[..., 0] == bound[:, None]).all()


@pytest.mark.parametrize("name", FIELDS)
def test_the_euler_characteristic_does_not_depend_on_the_octree(name: str) -> None:
    found = {
        len(m.vertices) - len(m.side_ends) + len(m.corners)
        for m in (
            build_dual_mesh(tree_of(seed, share, (10, 12, 8)), FIELDS[name]) for seed, share in ((0, 0.0), (5, 0.05))
        )
    }
    assert len(found) == 1


def test_the_surface_of_a_ball_is_a_sphere_and_cut_by_a_plane_a_disk() -> None:
    for name, expected in (("ball", 2), ("ball cut by the box", 1)):
        mesh = build_dual_mesh(tree_of(3, 0.2), FIELDS[name])
        assert len(mesh.vertices) - len(mesh.side_ends) + len(mesh.corners) == expected


@pytest.mark.parametrize("name", FIELDS)
def test_smoothed_vertices_are_on_the_surface_in_the_box_and_polygons_face_outwards(name: str) -> None:
    field = FIELDS[name]
    mesh = smooth_mesh(build_dual_mesh(tree_of(0, 0.0, (8, 9, 7)), field), field, LO, HI)
    slope = field.gradient(mesh.vertices)
    steep = np.linalg.norm(slope, axis=1)
    assert (np.abs(field(mesh.vertices)) < 1e-10 * steep * 10).all()
    assert ((mesh.vertices >= LO) & (mesh.vertices <= HI)).all()
    quads = mesh.corners[mesh.corners[:, 3] >= 0]
    assert corner_sines(mesh.vertices, quads, slope / steep[:, None]).min() > 0.2


def test_a_network_closes_its_patches_corner_by_corner_across_t_vertices() -> None:
    field = FIELDS["gyroid"]
    net = build_patch_network(smooth_mesh(build_dual_mesh(tree_of(4, 0.1), field), field, LO, HI), field)
    assert (net.piece > 0).any()

    def name(curve: int, where: int) -> int:
        """A vertex, or -1 - c for the middle of a curve: where is 0 at a curve's start, 1 at its middle, 2 at its end."""
        if where == 1:
            return -1 - curve
        if where == 0 and curve >= net.n_sides:
            return -1 - int(net.split_curve[curve - net.n_sides])
        return int(net.ends[curve, where // 2])

    for corners, curves, senses, pieces in zip(net.corners, net.curve, net.sense, net.piece, strict=True):
        for i in range(4):
            low, high = {0: (0, 2), 1: (0, 1), 2: (1, 2)}[int(pieces[i])]
            begin, end = (low, high) if senses[i] > 0 else (high, low)
            assert name(int(curves[i]), begin) == corners[i]
            assert name(int(curves[i]), end) == corners[(i + 1) % 4]


def test_a_split_changes_the_mesh_nearby_only() -> None:
    field = FIELDS["gyroid"]
    tree = octree.uniform_octree(LO, HI, np.array((8, 9, 7)))
    before = smooth_mesh(build_dual_mesh(tree, field), field, LO, HI)
    chosen = np.zeros(len(tree.size), bool)
    chosen[before.leaf[0]] = True
    after = smooth_mesh(build_dual_mesh(octree.split_leaves(tree, chosen), field), field, LO, HI, coarser=before)
    moved = ~np.isin(before.vertices[:, 0], after.vertices[:, 0])
    assert 0 < moved.sum() < 0.4 * len(moved)
    centre = tree.points(tree.origin[before.leaf[0]] + 0.5)
    assert np.linalg.norm(before.vertices[moved] - centre, axis=1).max() < 5 * tree.cell_edges.max()
    net, old = build_patch_network(after, field), build_patch_network(before, field)
    same = match_networks(net, old)
    assert (same.previous_patch >= 0).sum() > 0.5 * len(old.curve)
    at = np.flatnonzero(same.previous_patch >= 0)
    here, there = net.corners[at], old.corners[same.previous_patch[at]]
    whole = (here >= 0).all(axis=1)
    assert np.array_equal(net.vertices[here[whole]], old.vertices[there[whole]])
    assert np.array_equal(
        net.vertices[net.ends[same.previous_curve >= 0, 1]],
        old.vertices[old.ends[same.previous_curve[same.previous_curve >= 0], 1]],
    )


def folds(mesh: QuadMesh, field: fields.Field) -> np.ndarray:
    """Polygons (Q,) that turn over at a corner."""
    result = np.zeros(len(mesh.corners), bool)
    gradient = field.gradient(mesh.vertices)
    normals = gradient / np.linalg.norm(gradient, axis=1, keepdims=True)
    for n in (3, 4):
        rows = np.flatnonzero((mesh.corners >= 0).sum(axis=1) == n)
        result[rows] = (corner_sines(mesh.vertices, mesh.corners[rows, :n], normals) < 0).any(axis=1)
    return result


def test_polygons_that_a_split_folded_are_smoothed_again_from_their_start() -> None:
    field = next(iter(FIELDS.values()))
    mesh = smooth_mesh(build_dual_mesh(tree_of(0, 0.0, (10, 12, 8)), field), field, LO, HI)
    quads = mesh.corners[(mesh.corners[:, 3] >= 0) & ~mesh.fixed[mesh.corners].any(axis=(1, 2))]
    one, _, other, _ = quads[len(quads) // 2]
    vertices = mesh.vertices.copy()
    vertices[[one, other]] = vertices[[other, one]]  # opposite corners change places: the polygon turns over
    tangled = replace(mesh, vertices=vertices)
    folded = folds(tangled, field)
    assert folded.any()
    assert not folds(smooth_from_start(tangled, folded, field, LO, HI), field).any()


def blunt_cone(radius: float) -> fields.Field:
    """A cone, open downwards, whose tip is a hyperboloid with half this radius of curvature."""

    def hyperbola(x: np.ndarray, y: np.ndarray) -> np.ndarray:
        return np.sqrt((x - 0.47) ** 2 + (y - 0.53) ** 2 + radius**2)

    def value(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return z - 0.8 + 2 * hyperbola(x, y)

    def gradient(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
        return np.stack([2 * (x - 0.47) / hyperbola(x, y), 2 * (y - 0.53) / hyperbola(x, y), np.ones_like(z)])

    return fields.from_function(value, gradient)


@pytest.mark.slow
def test_a_tip_far_sharper_than_the_rest_of_a_surface_is_fitted_by_a_few_deep_leaves() -> None:
    fit = fit_field(blunt_cone(3e-4), np.zeros(3), np.ones(3), 1e-4)
    splits = np.log2(fit.fits[0].tree.size.max() / fit.fits[0].tree.size)
    assert MAX_DEPTH < splits.max() <= MAX_DEPTH_OF_FEW
    assert np.mean(splits > MAX_DEPTH) < 0.2
    solid = measure_field_fit(simplify_field_fit(fit))
    assert solid.deviation.to_reference <= 1e-4
    assert solid.continuity.tangent_jump_deg <= 0.01


@pytest.mark.slow
def test_an_edge_too_sharp_for_any_patch_is_refused_with_its_place() -> None:
    roof = fields.from_function(lambda x, y, z: z - 0.8 + np.abs(x - 0.47))
    with pytest.raises(LevelSetError, match="could not be fitted"):
        fit_field_solid(roof, np.zeros(3), np.ones(3), 1e-4)

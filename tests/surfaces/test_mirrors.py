"""Mirror surfaces: the mirrors keep the formula, the tetrahedron tells the whole surface, its measures are those of the solid."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree
from skimage.measure import marching_cubes, mesh_surface_area

from tpmscad import fields, surfaces
from tpmscad.errors import InvalidRequest, NoFoot
from tpmscad.surfaces.plane_waves import level_set_waves
from tpmscad.surfaces.reflection_group import MIRROR_TETRAHEDRA

NAMES = sorted(MIRROR_TETRAHEDRA)
OFFERED = [info.name for info in surfaces.CATALOGUE.values() if info.primitives == "mirrored"]
MOTIONS = {"schwarz_p": 48, "neovius": 48, "iwp": 48, "frd": 96}
"""Of Pm-3m in its cell, twice; of the mirrors of Im-3m, half of its 96; half of Fm-3m's 192."""
POINTS = np.random.default_rng(5).random((40, 3))
GRID = (1 - np.cos(np.pi * np.linspace(0, 1, 25))) / 2
LATTICE_POINTS = {"P": 1, "I": 2, "F": 4}


def field(name: str) -> fields.Field:
    """The formula as the fields read it: another parser, another evaluation."""
    return fields.tpms(name, 1.0)


@pytest.mark.parametrize("name", surfaces.CATALOGUE)
def test_the_waves_are_the_formula_with_its_derivatives(name: str) -> None:
    waves = level_set_waves(name, "nodal")
    np.testing.assert_allclose(waves.value(POINTS), field(name)(POINTS), rtol=0, atol=1e-13)
    np.testing.assert_allclose(waves.gradient(POINTS), field(name).gradient(POINTS), rtol=0, atol=1e-11)
    step = 1e-5
    slopes = [(waves.gradient(POINTS + step * e) - waves.gradient(POINTS - step * e)) / (2 * step) for e in np.eye(3)]
    np.testing.assert_allclose(waves.jet(POINTS)[2], np.stack(slopes, axis=-1), rtol=0, atol=1e-5)


def check_genus(sampled: fields.Field, info: surfaces.SurfaceRecord) -> None:
    """Euler's characteristic of the sampled solid, twice that of its surface, with neighbouring nodes joined periodically."""
    n = 56
    t = (np.arange(n) + 0.37) / n
    solid = sampled.on_grid(t, t + 0.001, t - 0.002) < 0
    euler = 0
    for corner in np.ndindex(2, 2, 2):
        cells = solid.copy()
        for axis in np.flatnonzero(corner):
            cells &= np.roll(cells, -1, axis)
        euler += (-1) ** sum(corner) * int(cells.sum())
    assert info.genus == 1 - euler / LATTICE_POINTS[info.space_group[0]]


@pytest.mark.parametrize("name", surfaces.CATALOGUE)
def test_the_genus_is_that_of_the_formula(name: str) -> None:
    check_genus(field(name), surfaces.CATALOGUE[name])


@pytest.mark.parametrize("name", NAMES)
def test_every_motion_keeps_the_formula_and_there_is_one_for_each_copy(name: str) -> None:
    mirrors = surfaces.mirror_symmetry(name)
    assert len(mirrors.motions) == MOTIONS[name]
    images = mirrors.motions[:, None].apply(POINTS)
    np.testing.assert_allclose(
        field(name)(images.reshape(-1, 3)).reshape(len(images), -1) - field(name)(POINTS), 0, atol=2e-13
    )
    assert len(
        np.unique(
            np.concatenate([mirrors.motions.rotation.reshape(-1, 9), mirrors.motions.translation], axis=1), axis=0
        )
    ) == len(images)


@pytest.mark.parametrize("name", NAMES)
def test_every_point_of_space_is_in_one_copy_of_the_tetrahedron(name: str) -> None:
    mirrors = surfaces.mirror_symmetry(name)
    corners = mirrors.edges.reshape(4, 3)
    shifts = np.stack(np.meshgrid(*[np.arange(-1, 3)] * 3, indexing="ij"), axis=-1).reshape(-1, 3)
    hits = np.zeros(len(POINTS), int)
    for motion in mirrors.motions:
        placed = motion.apply(corners)
        weights = np.linalg.solve((placed[1:] - placed[0]).T, (POINTS[:, None] - shifts - placed[0]).reshape(-1, 3).T)
        inside = (weights > 0).all(axis=0) & (weights.sum(axis=0) < 1)
        hits += inside.reshape(len(POINTS), -1).sum(axis=1)
    np.testing.assert_array_equal(hits, 1)


def test_only_the_tetrahedron_of_f_rd_is_halved_by_a_mirror_and_that_mirror_keeps_the_formula() -> None:
    assert [name for name in NAMES if surfaces.mirror_symmetry(name).middle is not None] == ["frd"]
    mirrors = surfaces.mirror_symmetry("frd")
    normal, offset = mirrors.middle
    images = POINTS - 2 * (POINTS @ normal - offset)[:, None] * normal
    np.testing.assert_allclose(field("frd")(images), field("frd")(POINTS), rtol=0, atol=2e-13)
    corners = mirrors.edges.reshape(4, 3)
    swapped = corners - 2 * (corners @ normal - offset)[:, None] * normal
    np.testing.assert_allclose(swapped, corners[[1, 0, 2, 3]], rtol=0, atol=1e-15)


@pytest.mark.parametrize("name", NAMES)
def test_the_piece_is_met_once_by_every_segment_and_squarely_by_every_wall(name: str) -> None:
    mirrors = surfaces.mirror_symmetry(name)
    (a, b), (c, d) = mirrors.edges
    s, t = GRID[:, None, None], GRID[None, :, None]
    along = np.linspace(0, 1, 101)[:, None, None, None]
    start, end = a + s * (b - a), c + t * (d - c)
    signs = np.sign(field(name)(start + along * (end - start)))
    assert (signs[0] > 0).all()
    assert (np.abs(np.diff(signs, axis=0)).sum(axis=0) == 2).all()
    sides = [(GRID, 0 * GRID), (0 * GRID + 1, GRID), (GRID, 0 * GRID + 1), (0 * GRID, GRID)]
    for (u, v), normal, offset in zip(sides, mirrors.wall_normals, mirrors.wall_offsets, strict=True):
        points, _ = mirrors.intersect_segments(u, v)
        np.testing.assert_allclose(field(name)(points), 0, atol=1e-13)
        np.testing.assert_allclose(points @ normal, offset, rtol=0, atol=1e-15)
        np.testing.assert_allclose(field(name).gradient(points) @ normal, 0, atol=1e-12)


@pytest.mark.parametrize("name", NAMES)
def test_the_area_is_that_of_a_triangulation_of_the_formula(name: str) -> None:
    n = 48
    t = np.linspace(0, 1, n + 1)
    vertices, triangles, *_ = marching_cubes(field(name).on_grid(t, t, t), 0.0, spacing=(1 / n,) * 3)
    assert surfaces.area(name, "nodal") == pytest.approx(mesh_surface_area(vertices, triangles), rel=1e-2)


def test_schwarz_p_has_the_measures_that_its_patches_give() -> None:
    from tpmscad.surfaces.curvature_integrals import measure_mirror_surface

    whole, pieces = surfaces.cell_measures("schwarz_p", "nodal"), measure_mirror_surface("schwarz_p")
    for name in (
        "area",
        "mean_curvature_integral",
        "gauss_curvature_integral",
        "fraction_below",
        "min_offset",
        "max_offset",
    ):
        assert getattr(pieces, name) == pytest.approx(getattr(whole, name), rel=1e-12, abs=1e-14)


@pytest.mark.slow
@pytest.mark.parametrize("name", OFFERED)
def test_volumes_on_either_side_are_those_of_the_points_at_that_distance(name: str) -> None:
    """Distances to a triangulation with its corners moved onto the level set, which know of no Steiner."""
    n, m = 56, 44
    t = np.arange(-n // 8, n + n // 8 + 1) / n
    corners, *_ = marching_cubes(field(name).on_grid(t, t, t), 0.0, spacing=(1 / n,) * 3)
    corners = corners.astype(float) + t[0]
    for _ in range(3):
        slope = field(name).gradient(corners)
        corners -= (field(name)(corners) / (slope**2).sum(axis=1))[:, None] * slope
    g = (np.arange(m) + 0.17) / m
    points = np.stack(np.meshgrid(g, g + 0.003, g - 0.004, indexing="ij"), axis=-1).reshape(-1, 3)
    _, nearest = cKDTree(corners).query(points)
    slope = field(name).gradient(corners[nearest])
    distance = ((points - corners[nearest]) * slope).sum(axis=1) / np.linalg.norm(slope, axis=1)

    def below(offset: float) -> float:
        return float(np.clip(0.5 + m * (offset - distance) / 2, 0, 1).mean())  # points count in part over two layers

    of = surfaces.cell_measures(name, "nodal")
    low, high = 0.7 * of.min_offset, 0.7 * of.max_offset
    assert surfaces.skeletal_volume_fraction(name, "nodal") == pytest.approx(below(0.0), abs=1.5e-3)
    assert surfaces.volume_fraction(name, "nodal", 0.0, high) == pytest.approx(below(high) - below(0.0), rel=1.2e-2)
    assert surfaces.volume_fraction(name, "nodal", low, 0.0) == pytest.approx(below(0.0) - below(low), rel=1.2e-2)


@pytest.mark.parametrize("name", OFFERED)
def test_the_offset_surface_turns_over_past_the_limit_and_not_before(name: str) -> None:
    mirrors, of = surfaces.mirror_symmetry(name), surfaces.cell_measures(name, "nodal")
    t = np.linspace(0, 1, 61)
    points, _ = mirrors.intersect_segments(t[:, None], t)
    slope = field(name).gradient(points)
    normal = slope / np.linalg.norm(slope, axis=-1, keepdims=True)

    def least(offset: float) -> float:
        moved = points + offset * normal
        du, dv = np.gradient(moved, axis=0), np.gradient(moved, axis=1)
        facing = (np.cross(du, dv) * normal).sum(axis=-1)
        return float((facing * np.sign(facing.sum())).min())

    for limit in (of.min_offset, of.max_offset):
        assert least(0.97 * limit) > 0
        assert least(1.05 * limit) < 0


@pytest.mark.parametrize("name", OFFERED)
def test_no_ball_smaller_than_the_limit_touches_the_surface_twice(name: str) -> None:
    """Curvature alone limits offsets: walls don't meet other parts of the surface before. |q - p|^2 / 2 n.(q - p) at all q."""
    mirrors, of = surfaces.mirror_symmetry(name), surfaces.cell_measures(name, "nodal")
    t = np.linspace(0, 1, 11)
    points = mirrors.intersect_segments(t[:, None], t)[0].reshape(-1, 3)
    slope = field(name).gradient(points)
    normal = slope / np.linalg.norm(slope, axis=1)[:, None]
    shifts = np.stack(np.meshgrid(*[[-2, -1, 0, 1]] * 3, indexing="ij"), axis=-1).reshape(-1, 1, 1, 3)
    images = mirrors.motions[:, None].apply(points) + shifts
    images = images.reshape(-1, 3)
    images = images[((images > points.min(axis=0) - 0.25) & (images < points.max(axis=0) + 0.25)).all(axis=1)]
    away = images - points[:, None]
    square, height = (away**2).sum(axis=-1), np.einsum("pqi,pi->pq", away, normal)
    for side, limit in ((1, of.max_offset), (-1, -of.min_offset)):
        ahead = (side * height > 0) & (square > 1e-8)
        assert (square[ahead] / (2 * side * height[ahead])).min() > (1 - 1e-6) * limit


@pytest.mark.parametrize("name", OFFERED)
@pytest.mark.parametrize("fraction", [0.05, 0.15])
def test_the_offsets_found_make_the_volume_fraction(name: str, fraction: float) -> None:
    low, high = surfaces.offsets_for(name, "nodal", fraction, "sheet", 5.0)
    assert surfaces.volume_fraction(name, "nodal", low / 5, high / 5) == pytest.approx(fraction, rel=1e-13)
    for side in "-+":
        at = surfaces.offsets_for(name, "nodal", 0.4 + fraction, "skeletal", 1.0, side)[0]
        assert surfaces.skeletal_volume_fraction(name, "nodal", at, side) == pytest.approx(0.4 + fraction, rel=1e-13)


def test_offsets_past_a_side_s_limit_are_answered_with_both_sides_limits() -> None:
    of = surfaces.cell_measures("iwp", "nodal")
    assert of.max_offset < -of.min_offset
    surfaces.check_offset("iwp", "nodal", 0.999 * of.min_offset)
    with pytest.raises(
        InvalidRequest, match=rf"between {10 * of.min_offset:.6g} and {10 * of.max_offset:.6g}, thickness below"
    ):
        surfaces.check_offset("iwp", "nodal", 1.001 * 10 * of.max_offset, 10.0)
    with pytest.raises(InvalidRequest, match=r"volume fraction 0\.97 is out of reach of a iwp sheet"):
        surfaces.thickness_for("iwp", "nodal", 0.97)


@pytest.mark.parametrize("name", OFFERED)
def test_a_foot_is_where_the_point_was_lifted_from(name: str) -> None:
    waves, of = level_set_waves(name, "nodal"), surfaces.cell_measures(name, "nodal")
    points, _ = surfaces.mirror_symmetry(name).intersect_segments(GRID[:, None], GRID)
    slope = waves.gradient(points)
    normal = slope / np.linalg.norm(slope, axis=-1, keepdims=True)
    for offset in (0.8 * of.min_offset, 0.01, 0.8 * of.max_offset):
        distance, along, foot = waves.project_to_level_set(points + offset * normal)
        np.testing.assert_allclose(distance, offset, rtol=0, atol=1e-12)
        np.testing.assert_allclose(along, normal, rtol=0, atol=1e-10)
        np.testing.assert_allclose(foot, points, rtol=0, atol=1e-11)
    with pytest.raises(NoFoot):
        waves.project_to_level_set(np.array([[0.5, 0.5, 0.5]]) + 1e-7)


@pytest.mark.parametrize("name", [i.name for i in surfaces.CATALOGUE.values() if i.primitives == "level set"])
def test_a_surface_of_level_set_patches_has_no_exact_ones(name: str) -> None:
    with pytest.raises(InvalidRequest, match="patches of its nodal level set are fitted"):
        surfaces.primitive_patch(name, "nodal")
    with pytest.raises(InvalidRequest, match="no mirror tetrahedron"):
        surfaces.mirror_symmetry(name)

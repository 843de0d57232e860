"""Coordinate maps: exact Jacobians, walls of true thickness, closed smooth lattices."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tpmscad import maps, surfaces
from tpmscad.brep.deviation import combine_deviations, measure_deviation
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.solid_properties import measure_solid
from tpmscad.errors import InvalidRequest
from tpmscad.lattices import copies, mapped_lattice
from tpmscad.lattices.mapped_deviation import SAMPLES_PER_PARAMETER
from tpmscad.lattices.mapped_surface import MappedSurface, require_regular
from tpmscad.lattices.self_contact import require_no_self_contact

RNG = np.random.default_rng(11)
POINTS = 10 * RNG.random((40, 3))


def bent(p: np.ndarray) -> np.ndarray:
    return np.stack([p[..., 0], p[..., 1], p[..., 2] + 2 * np.sin(0.3 * p[..., 0])], axis=-1)


MAPS = {
    "stretched": maps.stretching((1.0, 2.0, 0.7)),
    "graded": maps.grading(1, (1.0, 2.0), 10.0),
    "graded by a function": maps.grading(2, lambda z: 1 + 0.02 * z**2, 10.0),
    "cylinder": maps.cylinder(25.0),
    "sphere": maps.sphere(25.0),
    "sphere about a centre": maps.sphere(12.0, centre=(4.0, 5.0)),
    "sphere along the equator": maps.sphere(25.0, chart="equator"),
    "of the user": maps.as_map(bent),
    "composed": maps.composition(maps.as_map(bent), maps.stretching((1.0, 2.0, 0.7)), 10.0),
}


@pytest.mark.parametrize("name", MAPS)
def test_jacobians_are_the_derivatives(name: str) -> None:
    map, h = MAPS[name], 1e-4
    jacobian = map.jacobian(POINTS, 10.0)
    for axis in range(3):
        step = h * np.eye(3)[axis]
        difference = (map(POINTS + step) - map(POINTS - step)) / (2 * h)
        np.testing.assert_allclose(jacobian[..., axis], difference, rtol=0, atol=1e-8)


def test_a_user_map_gets_derivatives_to_eleven_digits() -> None:
    exact = 0.6 * np.cos(0.3 * POINTS[:, 0])
    np.testing.assert_allclose(MAPS["of the user"].jacobian(POINTS, 10.0)[:, 2, 0], exact, rtol=0, atol=1e-11)


@pytest.mark.parametrize(
    ("make", "match"),
    [
        (lambda: maps.cylinder(-3), "radius -3 must be"),
        (lambda: maps.cylinder("wide"), "radius 'wide' is not a number"),  # type: ignore[arg-type]
        (
            lambda: maps.sphere(5.0, chart="south"),
            "chart 'south' is unknown; choose one of 'pole', 'equator'",
        ),
        (lambda: maps.sphere(5.0, centre=(1.0,)), "centre .* must be two numbers"),
        (lambda: maps.stretching((1.0, -1.0, 1.0)), "three positive, finite numbers"),
        (lambda: maps.stretching((2.0,)), "must be three positive, finite numbers"),
        (lambda: maps.grading(3, (1.0, 2.0), 10.0), "axis 3 is none of 0, 1 and 2"),
        (lambda: maps.grading(0, (1.0, np.nan), 10.0), r"scale \(1.0, nan\) must be finite"),
        (lambda: maps.grading(0, (1.0, 2.0), 0.0), "length 0.0 must be"),
        (lambda: maps.grading(0, lambda x: 3 - x, 10.0), "scale -?[0-9.e-]+ of a grading must be positive"),
        (lambda: maps.as_map(3), "function 3 can't be called"),  # type: ignore[arg-type]
        (lambda: maps.as_map(lambda p: p * np.nan)(POINTS), "lambda> is not finite at .*: give a smooth map"),
    ],
)
def test_values_that_make_no_map_are_refused_at_once(make: Callable[[], maps.Map], match: str) -> None:
    with pytest.raises(InvalidRequest, match=match):
        make()


def test_a_dome_keeps_lengths_along_meridians_and_its_centre_on_the_pole() -> None:
    dome, along = maps.sphere(10.0), np.linspace(0.0, 25.0, 6)
    for turn in (0.0, 0.7, 2.0):
        points = dome(np.stack([along * np.cos(turn), along * np.sin(turn), 0 * along], axis=-1))
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 10, rtol=1e-14)
        np.testing.assert_allclose(np.arccos(points[:, 2] / 10), along / 10, rtol=0, atol=1e-12)
        np.testing.assert_allclose(np.arctan2(points[1:, 1], points[1:, 0]), turn, atol=1e-12)
    size = np.array([20.0, 30.0, 5.0])
    np.testing.assert_allclose(dome.over_block(size)([10.0, 15.0, 1.0]), [0, 0, 11], atol=1e-13)
    fixed = maps.sphere(10.0, centre=(4.0, 5.0))
    np.testing.assert_allclose(fixed.over_block(size)([4.0, 5.0, 1.0]), [0, 0, 11], atol=1e-13)


def mid(map: maps.Map, name: str = "gyroid") -> MappedSurface:
    placements = copies.place_whole_cells(name, (1, 1, 1), np.zeros(3))
    return MappedSurface(surfaces.primitive_patch(name), surfaces.patch_symmetry(name), placements, map, 10.0)


def test_a_map_that_folds_is_refused() -> None:
    fold = maps.Map(lambda p: np.stack([p[..., 0] ** 2 / 10 - p[..., 0], p[..., 1], p[..., 2]], axis=-1), name="fold")
    with pytest.raises(InvalidRequest, match=r"fold folds.*enlarge its radius"):
        mid(fold).orientation()


def test_a_jacobian_of_the_wrong_shape_or_that_is_not_finite_is_refused() -> None:
    for jacobian, match in (
        (lambda p: np.eye(3), r"Jacobian of user map returned shape \(3, 3\) for points of shape \(2, 3\)"),
        (
            lambda p: np.eye(3) / p[:, :1, None],
            r"Jacobian of user map is not finite at \[0\.0, 0\.0, 0\.0\]: give a smooth",
        ),
    ):
        with pytest.raises(InvalidRequest, match=match), np.errstate(divide="ignore", invalid="ignore"):
            maps.Map(lambda p: p, jacobian).jacobian(np.array([[1.0, 2.0, 3.0], [0.0, 0.0, 0.0]]), 1.0)
    cliff = maps.Map(lambda p: np.where(p > 0, 1.5e308, -1.5e308), name="cliff")
    with (
        pytest.raises(InvalidRequest, match=r"Jacobian of cliff is not finite at .*: give a smooth map"),
        np.errstate(all="ignore"),
    ):
        require_regular(cliff, np.zeros((1, 3)), 1.0)


@pytest.mark.slow
def test_a_map_with_a_branch_point_in_the_lattice_is_refused_with_place_amount_and_remedy() -> None:
    """Near the branch point of a square the normal turns too fast for neighbours, each fitted on its own, to meet."""

    def square(p: np.ndarray) -> np.ndarray:
        w = (p[..., 0] - 5.2 + 1j * (p[..., 1] - 5.1)) ** 2 / 5
        return np.stack([w.real, w.imag, p[..., 2]], axis=-1)

    surface = mid(maps.as_map(square))
    surface.orientation()  # regular at every sample
    fit = mapped_lattice.fit_mapped_layers(surface, (-0.025, 0.025), 0.05)
    match = r"under square neighbouring patches near \(.*\) differ by .*, more than .*: .*keep the lattice away"
    with pytest.raises(InvalidRequest, match=match):
        mapped_lattice.assemble_mapped_lattice(surface, *fit.surfaces, natural=True)


@pytest.mark.parametrize("name", ["graded", "cylinder"])
def test_walls_are_as_thick_as_asked_wherever_the_map_stretches(name: str) -> None:
    surface = mid(MAPS[name])
    u, v = RNG.random((2, 30))
    h = 1e-5
    for index in (0, 7):
        low, middle, high = (surface.shift(surface.points(u, v, index), d) for d in (-0.4, 0.0, 0.4))
        np.testing.assert_allclose(np.linalg.norm(high - low, axis=-1), 0.8, rtol=1e-9)
        along = surface.points(u + h, v, index).position - surface.points(u - h, v, index).position
        np.testing.assert_allclose(np.einsum("ni,ni->n", (high - middle) / 0.4, along) / (2 * h), 0, rtol=0, atol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["stretched", "cylinder", "of the user"])
def test_a_mapped_cell_is_closed_smooth_and_within_its_tolerance(name: str) -> None:
    surface = mid(MAPS[name])
    fit = mapped_lattice.fit_mapped_layers(surface, (-0.3, 0.3), 0.05)
    brep = mapped_lattice.assemble_mapped_lattice(surface, *fit.surfaces, natural=True)
    found, shape = measure_edge_continuity(brep, ("offset+", "offset-")), measure_solid(brep)
    assert fit.deviation.max <= 0.05
    assert found.gap < 1e-8
    assert found.tangent_jump_deg < 1e-6
    assert found.curvature_jump < 1e-6
    assert shape.closed
    assert len(shape.pieces) == 1


@pytest.mark.slow
def test_the_identity_map_gives_the_lattice_itself() -> None:
    surface = mid(maps.stretching((1.0, 1.0, 1.0)))
    fit = mapped_lattice.fit_mapped_layers(surface, (-0.3, 0.3), 1e-3)
    expected = 1000 * surfaces.volume_fraction("gyroid", "minimal", -0.03, 0.03)
    assert measure_solid(
        mapped_lattice.assemble_mapped_lattice(surface, *fit.surfaces, natural=True)
    ).volume == pytest.approx(expected, rel=1e-4)


def test_the_least_curvature_radius_of_an_unmapped_lattice_is_the_exact_one() -> None:
    limit = 10 * surfaces.primitive_patch("gyroid").max_offset
    reach, _ = mapped_lattice.find_greatest_reach(mid(maps.stretching((1.0, 1.0, 1.0))), (1.0,))
    assert 1 / reach == pytest.approx(limit, rel=1e-3)


def test_mirror_images_are_a_class_of_their_own_although_their_distances_are_equal() -> None:
    patch, turns = RNG.random((12, 3)), Rotation.random(9, random_state=3).as_matrix()
    samples = np.stack([(patch * (1, 1, (-1) ** k)) @ turn.T + k for k, turn in enumerate(turns)])
    classes = mapped_lattice.group_congruent(samples)
    assert classes.label.tolist() == [0, 1, 0, 1, 0, 1, 0, 1, 0]
    np.testing.assert_allclose(
        classes.motion[:, None].apply(samples[classes.first[classes.label]]), samples, atol=1e-12
    )


@pytest.mark.slow
def test_the_greatest_deviation_is_that_of_all_patches_measured_one_by_one() -> None:
    """The least degree on a small cylinder: patches differ, so that most of them are left out by their estimates."""
    surface = mid(maps.cylinder(12.0))
    fit = mapped_lattice.fit_mapped_layers(surface, (-0.3, 0.3), 0.05)
    each = []
    for layer, distance in zip(fit.surfaces, (-0.3, 0.3), strict=True):
        classes = mapped_lattice.group_congruent_patches(surface, (distance,))
        for patch, index in zip(layer.patches, classes.first.tolist(), strict=True):
            each.append(
                measure_deviation(
                    patch,
                    lambda u, v, d=distance, i=index: surface.shift(surface.points(u, v, i), d),
                    SAMPLES_PER_PARAMETER,
                )
            )
    oracle = combine_deviations(each)
    for name in ("max", "to_reference", "from_reference"):
        assert getattr(fit.deviation, name) == pytest.approx(getattr(oracle, name), rel=2e-3), name
    assert fit.deviation.rms == pytest.approx(oracle.rms, rel=0.02)
    assert min(d.max for d in each) < 0.7 * oracle.max


def test_cells_too_large_for_a_bend_are_refused_before_all_patches_are_fitted_with_place_and_size() -> None:
    def waves(p: np.ndarray) -> np.ndarray:
        return p + np.stack([0 * p[..., 0], 0 * p[..., 0], 4.5 * np.sin(0.9 * p[..., 0])], axis=-1)

    surface = mid(maps.Map(waves, name="waves"))
    with pytest.raises(
        InvalidRequest, match=r"(curvature radius of the mapped gyroid.* near \(|near \(.*where a cell measures)"
    ):
        mapped_lattice.require_patches_that_bend(surface, (-0.3, 0.3), (-0.3, 0.3), "mapped gyroid", 0.05)


def test_boxes_that_stay_boxes_are_told_from_those_that_do_not() -> None:
    size = np.array([10.0, 10.0, 10.0])
    low, high = mapped_lattice.map_box(MAPS["graded"], size)
    np.testing.assert_allclose([low, high], [[0, 0, 0], [10, 15, 10]], rtol=0, atol=1e-12)
    with pytest.raises(InvalidRequest, match="boundary='natural'"):
        mapped_lattice.map_box(MAPS["of the user"], size)


def test_a_graded_wall_reaches_half_its_local_thickness_from_the_mid_surface() -> None:
    symmetry, patch = surfaces.patch_symmetry("schwarz_p"), surfaces.primitive_patch("schwarz_p", "minimal")
    placements = copies.place_whole_cells("schwarz_p", (1, 1, 1), np.zeros(3))

    def thickness(p: np.ndarray) -> np.ndarray:
        return 0.5 + 0.05 * p[..., 2] + 0.02 * p[..., 0]

    mapped = MappedSurface(patch, symmetry, placements, MAPS["cylinder"], 10.0, thickness=thickness)
    u, v = RNG.random((2, 7))
    middle = mapped.points(u, v)
    for distance in (-0.5, 0.5):
        apart = mapped.shift(middle, distance) - middle.position
        np.testing.assert_allclose(
            apart, distance * thickness(middle.position)[..., None] * middle.normal, rtol=0, atol=1e-13
        )
    constant = MappedSurface(
        patch, symmetry, placements, MAPS["cylinder"], 10.0, thickness=lambda p: np.full(p.shape[:-1], 2.0)
    )
    plain = MappedSurface(patch, symmetry, placements, MAPS["cylinder"], 10.0)
    reach, _ = mapped_lattice.find_greatest_reach(plain, (1.0,))
    assert mapped_lattice.find_greatest_reach(constant, (1.0,))[0] == pytest.approx(2 * reach, rel=1e-12)


def test_a_wall_with_creases_is_smoothed_no_more_finely_than_its_tolerance_asks() -> None:
    """On a finer grid than that within the tolerance patches take degree 11, with poles up to 23 mm away in a cell of 10."""
    mapped = replace(
        mid(maps.Map(lambda p: p, name="none")),
        thickness=lambda p: np.clip(1.1 - 0.3 * np.abs(p[..., 2] - 4.3), 0.4, 1.0),
    )
    fit = mapped_lattice.fit_mapped_layers(mapped, (-0.5, 0.5), tol=0.05)
    assert fit.deviation.max < 0.05
    assert len(fit.notes) == 1
    poles = np.concatenate(
        [patch.poles.ravel() for layer in fit.surfaces if layer is not None for patch in layer.patches]
    )
    assert np.abs(poles).max() < 18.0


def test_a_wall_with_many_creases_takes_patches_of_two_spans_with_poles_near_the_surface() -> None:
    """One span of degree 14 would do, too, with poles 7,600 mm away; the ridges are a fifth of a cell apart."""

    def zigzag(p: np.ndarray) -> np.ndarray:
        return 0.8 + 0.5 * np.abs((p @ np.array([0.24, 0.3, 0.32])) % 2 - 1)

    mapped = replace(mid(maps.Map(lambda p: p, name="none")), thickness=zigzag)
    fit = mapped_lattice.fit_mapped_layers(mapped, (-0.5, 0.5), tol=0.05)
    assert fit.deviation.max < 0.05
    t = np.linspace(0, 1, 60)
    for layer, distance in zip(fit.surfaces, (-0.5, 0.5), strict=True):
        assert layer is not None
        for index, patch in enumerate(layer.patches):
            assert np.abs(patch.poles).max() < 14.0
            assert len(np.unique(patch.knots_u)) == 3
            exact = mapped.shift(mapped.points(*np.meshgrid(t, t, indexing="ij"), index), distance)
            near = cKDTree(exact.reshape(-1, 3)).query(patch.grid(t[::7], t[::7]).reshape(-1, 3))[0]
            assert near.max() < 0.1  # points are .05 apart
    brep = mapped_lattice.assemble_mapped_lattice(mapped, *fit.surfaces, natural=True)
    joints = measure_edge_continuity(brep, ("offset+", "offset-"))
    assert joints.gap < 1e-6
    assert joints.tangent_jump_deg < 1e-3
    assert measure_solid(brep).closed


def test_beyond_the_radius_of_curvature_a_wall_is_refused_only_where_a_body_holds_it() -> None:
    symmetry, patch = surfaces.patch_symmetry("gyroid"), surfaces.primitive_patch("gyroid")
    placements = copies.place_whole_cells("gyroid", (2, 1, 1), np.zeros(3))
    mapped = MappedSurface(patch, symmetry, placements, maps.cylinder(radius=10.0), 10.0)
    offsets, name = (-1.8, 1.8), "mapped gyroid"
    _, worst = mapped_lattice.find_greatest_reach(mapped, offsets)
    place = mapped.points(np.array([0.5]), np.array([0.5]), worst).position[0]
    for radius in (0.0, 30.0):
        held = replace(mapped, in_body=lambda p, radius=radius: np.linalg.norm(p - place, axis=1) < radius)
        if radius:
            with pytest.raises(InvalidRequest, match="passes the least curvature radius"):
                mapped_lattice.require_offsets_below_curvature_radius(held, offsets, name)
        else:
            mapped_lattice.require_offsets_below_curvature_radius(held, offsets, name)


def test_walls_of_graded_thickness_that_meet_are_refused_where_they_are_thick_only() -> None:
    """Schwarz P of cell 10 in the middle of its height, where a wall of 6.5 mm closes the necks."""
    symmetry, patch = surfaces.patch_symmetry("schwarz_p"), surfaces.primitive_patch("schwarz_p", "minimal")
    placements = copies.place_whole_cells("schwarz_p", (1, 1, 1), np.zeros(3))
    for peak, meets in ((0.5, False), (6.0, True)):
        mapped = MappedSurface(
            patch, symmetry, placements, MAPS["cylinder"], 10.0,
            thickness=lambda p, peak=peak: 0.5 + peak * np.exp(-((p[..., 2] - 5.0) ** 2)),
        )  # fmt: skip
        if meets:
            with pytest.raises(InvalidRequest, match="overlaps itself"):
                require_no_self_contact(mapped, (-0.5, 0.5))
        else:
            require_no_self_contact(mapped, (-0.5, 0.5))

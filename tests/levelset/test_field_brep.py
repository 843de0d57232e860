"""Laws of solids of fields, against closed forms and independent quadrature: no kernel."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.brep.connectivity import is_closed
from tpmscad.brep.edge_continuity import measure_edge_continuity
from tpmscad.brep.solid_properties import SolidProperties, measure_solid
from tpmscad.errors import InvalidRequest, LevelSetError
from tpmscad.fields.analysis import volume_quadrature
from tpmscad.fields.kinds.linear_extension import extend_linearly
from tpmscad.levelset.field_solid import FieldSolid, fit_field_solid
from tpmscad.levelset.fit import fit_quality

LO, HI, TOL = np.zeros(3), np.full(3, 10.0), 1e-2
GYROID = fields.tpms("gyroid", 10.0)
FIELDS = {
    "rod": (fields.rod(GYROID, -0.3), (1, 2, 0)),
    "sheet": (fields.sheet(GYROID, -0.3, 0.3), (3, 4, 0)),
    "corner on the level": (fields.rod(GYROID, 0.0), (1, 2, 0)),
    "ball": (fields.sphere((5.0, 5.2, 4.9), 4.0), (1, 0, 0)),
    "block with a hollow": (-fields.sphere((5.0, 5.2, 4.9), 4.0), (1, 0, 1)),
}


@cache
def made(name: str) -> tuple[FieldSolid, SolidProperties]:
    solid = fit_field_solid(FIELDS[name][0], LO, HI, TOL)
    return solid, measure_solid(solid.brep)


@pytest.mark.parametrize("name", FIELDS)
class TestEverySolid:
    @pytest.mark.slow
    def test_is_closed_with_the_fields_betti_numbers(self, name: str) -> None:
        solid, shape = made(name)
        assert is_closed(solid.brep)
        assert shape.betti == FIELDS[name][1]

    @pytest.mark.slow
    def test_has_the_volume_of_the_field(self, name: str) -> None:
        volume, uncertainty = volume_quadrature.integrate_volume(FIELDS[name][0], LO, HI, 0.25)
        assert abs(made(name)[1].volume - volume) < 1e-3 * volume + uncertainty

    def test_keeps_within_tol_and_smooth(self, name: str) -> None:
        solid, _ = made(name)
        assert solid.deviation.max <= TOL
        assert solid.continuity.tangent_jump_deg <= 1e-5

    @pytest.mark.slow
    def test_has_that_continuity_measured_on_the_brep(self, name: str) -> None:
        solid, _ = made(name)
        found = measure_edge_continuity(solid.brep, ("surface",))
        assert found.gap < 1e-12
        assert abs(found.tangent_jump_deg - solid.continuity.tangent_jump_deg) < 1e-5


def test_a_balls_volume_and_area_are_those_of_the_closed_form() -> None:
    _, shape = made("ball")
    assert shape.volume == pytest.approx(4 / 3 * np.pi * 4**3, rel=1e-4)
    assert shape.area == pytest.approx(4 * np.pi * 4**2, rel=1e-4)


def test_patches_lie_on_the_field_at_points_of_their_own() -> None:
    field, (solid, _) = FIELDS["rod"][0], made("rod")
    rng = np.random.default_rng(0)
    worst = 0.0
    for carrier in solid.brep.carriers:
        if hasattr(carrier, "poles"):
            value, slope = field.value_and_gradient(carrier(*rng.uniform(0, 1, (2, 20))))
            worst = max(worst, float((np.abs(value) / np.linalg.norm(slope, axis=1)).max()))
    assert 0 < worst <= 1.2 * solid.deviation.to_reference


@pytest.mark.slow
def test_a_thin_sheet_has_as_many_faces_as_a_thick_one() -> None:
    thin = fit_field_solid(fields.sheet(GYROID, -0.03, 0.03), LO, HI, TOL)
    assert thin.min_wall == pytest.approx(0.055, rel=0.05)
    assert abs(len(thin.brep.faces) - len(made("sheet")[0].brep.faces)) <= 0.2 * len(thin.brep.faces)


def test_a_level_through_a_corner_of_the_box_is_reported() -> None:
    assert "corner" in made("corner on the level")[0].notes[0]
    assert made("rod")[0].notes == ()


@pytest.mark.slow
def test_moving_a_level_off_a_corner_hardly_changes_the_volume_at_any_tolerance() -> None:
    solid = fit_field_solid(fields.rod(GYROID, 0.0), LO, HI, 0.08)
    assert "corner" in solid.notes[0]
    assert measure_solid(solid.brep).volume == pytest.approx(500.0, rel=5e-4)  # the gyroid halves its cell


@pytest.mark.parametrize(
    ("field", "tol", "message"),
    [
        (fields.sheet(GYROID, -0.02, 0.02), 0.1, "thick near"),
        (fields.rod(GYROID, 0.1) & fields.sphere((5, 5, 5), 4.0), 1e-2, "cross near"),
        (fields.sphere((50, 5, 5), 4.0), 1e-2, "no surface"),
        (
            fields.from_function(lambda p: np.where(p[:, 0] > 4.4, GYROID(p), GYROID(p - [1.0, 2.0, 3.0]))),
            1e-2,
            "jumps",
        ),
    ],
)
@pytest.mark.slow
def test_a_field_that_cannot_be_fitted_says_why(field: fields.Field, tol: float, message: str) -> None:
    with pytest.raises(LevelSetError, match=message):
        fit_field_solid(field, LO, HI, tol)


@pytest.mark.parametrize(("lo", "hi", "tol"), [(LO, LO, TOL), (LO, HI[:2], TOL), (LO, HI, 0.0), (LO, HI, 20.0)])
def test_bad_requests_are_refused(lo: np.ndarray, hi: np.ndarray, tol: float) -> None:
    with pytest.raises(InvalidRequest):
        fit_field_solid(GYROID, lo, hi, tol)


def test_volumes_by_columns_converge_to_closed_forms() -> None:
    ball, shell = fields.sphere((5, 5.1, 5.2), 3.0), fields.sheet(fields.sphere((5, 5.1, 5.2), 3.0), -0.02, 0.02)
    volume, uncertainty = volume_quadrature.integrate_volume(ball, LO, HI, 0.2)
    assert volume == pytest.approx(36 * np.pi, rel=1e-4)
    assert abs(volume - 36 * np.pi) < uncertainty < volume_quadrature.VOLUME_RTOL * volume
    exact = 4 / 3 * np.pi * (3.02**3 - 2.98**3)
    assert volume_quadrature.integrate_volume(shell, LO, HI, 0.2)[0] == pytest.approx(exact, rel=1e-3)


def test_the_uncertainty_of_a_volume_holds_where_one_refinement_changes_it_little() -> None:
    """A half ellipsoid small in its box: its errors on the first two grids are large, and nearly the same."""
    axes, centre, hi = np.array([4.1, 1.7, 1.9]), (11.6, 2.5, 0.7), np.array([20, 10, 14])
    terms = (f"(({x} - {c}) / {a})**2" for x, c, a in zip("xyz", centre, axes, strict=True))
    volume, uncertainty = volume_quadrature.integrate_volume(
        fields.expression(" + ".join(terms) + " - 1"), np.zeros(3), hi, 20 / 64
    )
    depth = centre[2] / axes[2]
    exact = np.pi * axes.prod() * (2 / 3 + depth - depth**3 / 3)
    assert abs(volume - exact) < uncertainty
    assert volume == pytest.approx(exact, rel=1e-3)


@pytest.mark.slow
def test_what_the_field_is_beyond_the_box_does_not_matter() -> None:
    rod, other = FIELDS["rod"][0], fields.rod(fields.tpms("schwarz_p", 3.0), 0.1)

    def either(p: np.ndarray, f: np.ndarray, g: np.ndarray) -> np.ndarray:
        beyond = (p[:, 1] < 0) | (p[:, 2] > 10)
        return np.where(beyond.reshape(-1, *[1] * (f.ndim - 1)), g, f)

    changed = fields.from_function(
        lambda p: either(p, rod(p), other(p)), lambda p: either(p, rod.gradient(p), other.gradient(p))
    )
    plain = fields.from_function(
        rod, rod.gradient
    )  # the periods of a periodic field stay alike, which takes more faces
    there, here = (fit_field_solid(f, LO, HI, TOL).brep for f in (changed, plain))
    assert len(there.faces) == pytest.approx(len(here.faces), rel=0.2)
    assert measure_solid(there).volume == pytest.approx(measure_solid(here).volume, rel=1e-4)


def test_a_patch_that_leaves_the_box_is_off_by_as_much_as_it_leaves_it() -> None:
    field = extend_linearly(fields.coordinate("z"), np.array([-1.0, -1.0, -1.0]), np.ones(3))
    poles = np.zeros((1, 4, 2, 3))
    poles[0, :, 1, 0] = 1.0
    poles[0, :, :, 1] = np.linspace(0.0, 1.0, 4)[:, None]
    poles[0, 1:3, 1, 0] = 1.4  # a side whose ends are on the box and which bulges by 3/4 of 0.4
    assert fit_quality.sample_patches(field, poles).distance[0] == pytest.approx(0.3, rel=0.02)
    poles[0, 1:3, 1, 0] = 1.0
    assert fit_quality.sample_patches(field, poles).distance[0] == pytest.approx(0.0, abs=1e-12)


def test_where_the_gradient_vanishes_a_patch_is_off_without_bound_and_without_a_warning() -> None:
    poles = np.zeros((1, 2, 2, 3))
    poles[0, 1, :, 0] = poles[0, :, 1, 1] = 1.0
    found = fit_quality.sample_patches(fields.constant(1.0), poles)
    assert found.distance[0] > 1e200
    assert found.mean_square_distance[0] == np.inf

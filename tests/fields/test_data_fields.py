"""Fields of data: samples, scattered points and formulas."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.field_notes import collect_notes

RNG = np.random.default_rng(11)
SPACING, ORIGIN = np.array([0.5, 0.4, 0.7]), np.array([1.0, -2.0, 0.5])
SHAPE = (7, 9, 8)
INDICES = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
SITES = ORIGIN + SPACING * INDICES
VALUES = RNG.normal(size=(5, 6, 7))


def cubic(p: np.ndarray) -> np.ndarray:
    x, y, z = np.moveaxis(np.asarray(p), -1, 0)
    return np.asarray(x**3 - 2 * x * y**2 + z**3 * y - x * y * z + 4)


class TestSampledField:
    def test_passes_through_the_samples(self) -> None:
        values = RNG.normal(size=SHAPE)
        np.testing.assert_allclose(fields.sampled(values, SPACING, ORIGIN)(SITES), values, atol=1e-13)

    def test_reproduces_cubic_polynomials_inside(self) -> None:
        field = fields.sampled(cubic(SITES), SPACING, ORIGIN)
        points = RNG.uniform(*field.domain, (500, 3))
        np.testing.assert_allclose(field(points), cubic(points), rtol=0, atol=1e-11)

    def test_has_the_same_bits_at_coordinates_of_any_shape_that_broadcast(self) -> None:
        field = fields.sampled(RNG.normal(size=SHAPE), SPACING, ORIGIN)
        x, y, z = np.array([1.3, 2.9, 3.4]), np.array([[-1.7], [0.2]]), np.array(2.1)
        points = np.stack(np.broadcast_arrays(x, y, z), axis=-1)
        np.testing.assert_array_equal(field.at(x, y, z), field(points))
        np.testing.assert_array_equal(np.stack(field.jet(x, y, z)[1:], axis=-1), field.gradient(points))
        assert field.at(x[1], y[0, 0], z) == field(points[0, 1])
        assert field(np.empty((0, 3))).shape == (0,)

    def test_has_the_box_of_its_samples_as_domain(self) -> None:
        np.testing.assert_allclose(
            fields.sampled(np.zeros(SHAPE), SPACING, ORIGIN).domain, (SITES[0, 0, 0], SITES[-1, -1, -1])
        )

    def test_is_solid_where_the_data_exceed_the_level(self) -> None:
        density = RNG.random(SHAPE)
        field = fields.sampled(density, SPACING, ORIGIN, level=0.4)
        assert ((field(SITES) < 0) == (density > 0.4)).all()

    def test_stays_near_its_end_values_far_outside(self) -> None:
        field = fields.sampled(cubic(SITES), SPACING, ORIGIN)
        far = np.array([[1e6, 0.0, 2.0], [1.0, -1e9, 2.0]])
        nearest = np.clip(far, *field.domain)
        assert (np.abs(field(far) - field(nearest)) < np.abs(cubic(SITES)).max()).all()
        np.testing.assert_allclose(field.gradient(far)[[0, 1], [0, 1]], 0, atol=1e-12)


class TestVolumeFraction:
    """The level follows from the part of the domain that is to be solid."""

    @pytest.mark.parametrize("centred", [False, True])
    def test_the_solid_fills_the_part_of_the_domain(self, centred: bool) -> None:
        density = gaussian_filter(RNG.normal(size=(12, 9, 10)), 1.2)
        field = fields.sampled(density, SPACING, ORIGIN, volume_fraction=0.3, centred=centred)
        low, high = np.array(field.domain)
        inside = field(low + (high - low) * RNG.random((200_000, 3))) < 0
        assert inside.mean() == pytest.approx(0.3, abs=0.005)  # five standard deviations
        level = float(re.search("level (.*) for a volume fraction of 0.3", " ".join(field.notes))[1])  # type: ignore[index]
        points = RNG.uniform(low, high, (50, 3))
        same = fields.sampled(density, SPACING, ORIGIN, level=level, centred=centred)
        np.testing.assert_allclose(field(points), same(points), atol=1e-5)

    def test_is_refused_beside_a_level_and_for_missing_values(self) -> None:
        with pytest.raises(InvalidRequest, match="either `level` or `volume_fraction`"):
            fields.sampled(VALUES, level=0, volume_fraction=0.5)
        with pytest.raises(InvalidRequest, match=r"without a value .* which have no volume: give `level`"):
            fields.sampled(np.where(VALUES > 1, np.nan, VALUES), volume_fraction=0.5)


class TestSmoothing:
    def test_a_wave_keeps_its_place_and_loses_what_a_gaussian_takes(self) -> None:
        x = np.arange(64.0)
        wave = np.sin(2 * np.pi * x / 16)[:, None, None] * np.ones((1, 8, 9))
        field = fields.sampled(wave, smoothing=2.0)
        kept = np.exp(-2 * (np.pi * 2.0 / 16) ** 2)
        np.testing.assert_allclose(
            field(np.stack([x, 3 + 0 * x, 4 + 0 * x], 1))[12:-12], kept * wave[12:-12, 0, 0], atol=3e-3
        )
        assert any("smoothed by a Gaussian of 2 samples" in note for note in field.notes)

    def test_missing_values_are_left_out(self) -> None:
        values = np.where(np.indices((10, 9, 8))[0] < 5, -3.0, np.nan)
        field = fields.sampled(values, smoothing=1.5)
        np.testing.assert_allclose(field([[0, 4, 4], [4, 4, 4], [3, 0, 7]]), -3.0, rtol=1e-12)
        assert field((5, 4, 4)) > 0

    @pytest.mark.parametrize(("noise", "smoothing", "told"), [(0.02, 0.0, False), (1.5, 0.0, True), (1.5, 1.0, False)])
    def test_rough_data_are_told(self, noise: float, smoothing: float, told: bool) -> None:
        """Noise as large as the values change from sample to sample; smoothed, it is none."""
        x, y, z = np.meshgrid(*[np.arange(30.0)] * 3, indexing="ij")
        ball = 10.0 - np.sqrt((x - 14) ** 2 + (y - 15) ** 2 + (z - 14.5) ** 2)
        values = ball + np.random.default_rng(4).normal(0, noise, ball.shape)
        notes = fields.sampled(values, 0.7, level=0.0, smoothing=smoothing).notes
        assert any("smoothing=1, one sample" in note for note in notes) == told
        assert not any("rough" in note for note in fields.sampled(values, 0.7).notes)


class TestSamplesOfCells:
    def test_passes_through_the_samples_and_is_reflected_at_the_ends(self) -> None:
        values = RNG.normal(size=SHAPE)
        field = fields.sampled(values, SPACING, ORIGIN, centred=True)
        np.testing.assert_allclose(field(SITES), values, atol=1e-13)
        inside = ORIGIN + SPACING * RNG.uniform(0, 0.5, (50, 3))
        beyond = 2 * np.array(field.domain[0]) - inside
        step = 1e-6 * SPACING[0] * np.array([1.0, 0, 0])
        at_end = np.where([True, False, False], np.array(field.domain[0]), inside)
        np.testing.assert_allclose(field(at_end + step), field(at_end), atol=1e-9)
        assert np.isfinite(field(beyond)).all()

    @pytest.mark.parametrize("thick", [1, 2, 3])
    def test_an_outer_cell_of_a_binary_density_is_solid_up_to_its_end(self, thick: int) -> None:
        density = (RNG.random((thick, 9, 8)) > 0.5).astype(float)
        field = fields.sampled(density, SPACING, ORIGIN, level=0.5, centred=True)
        for axis in range(3):
            for end in (0, -1):
                layer = np.take(SITES[:thick, :9, :8], [end], axis)
                layer[..., axis] = field.domain[end][axis]
                for part in np.linspace(0, 0.5, 6):
                    layer[..., axis] = field.domain[end][axis] + (1 + 2 * end) * part * SPACING[axis]
                    assert ((field(layer) < 0) == np.take(density > 0.5, [end], axis)).all()

    def test_a_plate_of_elements_has_the_size_of_its_elements(self) -> None:
        density = np.zeros((24, 12, 8))
        density[:, :6] = 1
        field = fields.sampled(density, 1.0, (0.5, 0.5, 0.5), level=0.5, centred=True)
        assert field.domain == ((0, 0, 0), (24, 12, 8))
        x, y, z = (np.linspace(a, b, 25) for a, b in zip(*field.domain, strict=True))
        assert ((field.on_grid(x, y, z) < 0)[:, y != 6] == (y < 6)[y != 6][None, :, None]).all()

    def test_one_layer_is_constant_across_it(self) -> None:
        field = fields.sampled(RNG.normal(size=(5, 1, 4)), centred=True)
        points = RNG.uniform(*field.domain, (50, 3))
        np.testing.assert_allclose(field(points), field(points * (1, 0, 1)), atol=1e-13)

    def test_what_was_assumed_is_told_until_it_is_said(self) -> None:
        assert "centred=True if they belong to cells" in fields.sampled(VALUES).notes[0]
        assert fields.sampled(VALUES, centred=False).notes == fields.sampled(VALUES, centred=True).notes == ()

    def test_the_notes_of_data_are_found_in_every_field_made_of_them(self) -> None:
        data = fields.sampled(VALUES)
        ball = fields.sphere((0, 0, 0), 1)
        for made in (
            data | ball,
            2 * fields.rotate(data, "z", 30),
            fields.rod(fields.tpms("gyroid"), fields.ramp(data, (0, 1), (0, 0.2))),
            fields.expression("max(d, x)", d=data),
            fields.union(ball, data, data + 1),
            fields.wall(ball, data),
        ):
            assert collect_notes(made) == data.notes
        assert collect_notes(ball) == collect_notes(2.0) == ()


class TestScatteredField:
    POINTS = RNG.uniform(0, 10, (300, 3))

    def test_interpolates_a_linear_function_everywhere_inside(self) -> None:
        field = fields.scattered(self.POINTS, self.POINTS @ (1.0, -2.0, 0.5) + 3)
        inside = RNG.uniform(*field.domain, (200, 3))
        np.testing.assert_allclose(field(inside), inside @ (1.0, -2.0, 0.5) + 3, atol=1e-6)

    def test_approaches_a_smooth_function_with_more_points(self) -> None:
        wave = fields.tpms("schwarz_p", 20.0)
        inside = RNG.uniform(2, 8, (300, 3))
        errors = []
        for n in (40, 300):
            field = fields.scattered(self.POINTS[:n], wave(self.POINTS[:n]), domain=((0, 0, 0), (10, 10, 10)))
            errors.append(np.abs(field(inside) - wave(inside)).max())
        assert errors[1] < 0.2 * errors[0]
        assert errors[1] < 0.05

    @pytest.mark.slow
    def test_nearest_points_are_enough_where_there_are_many(self, monkeypatch: pytest.MonkeyPatch) -> None:
        values = fields.tpms("schwarz_p", 20.0)(self.POINTS)
        whole = fields.scattered(self.POINTS, values)
        monkeypatch.setattr("tpmscad.fields.kinds.scattered_data.MAX_GLOBAL_POINTS", 100)
        inside = RNG.uniform(2, 8, (300, 3))
        local = fields.scattered(self.POINTS, values)
        difference = np.abs(local(inside) - whole(inside)).max()
        assert 0 < difference < 0.05


class TestExpression:
    def test_each_formula_of_the_catalogue_is_its_field(self) -> None:
        points = RNG.uniform(-20, 20, (300, 3))
        for name, record in fields.TPMS.items():
            field = fields.expression(record.formula, 10.0)
            nodal = fields.tpms(name, 10.0)
            np.testing.assert_allclose(field(points), nodal(points), atol=1e-12)
            np.testing.assert_allclose(field.gradient(points), nodal.gradient(points), atol=1e-12)
            assert field.periods() == pytest.approx((10.0,) * 3)

    @pytest.mark.parametrize(
        "formula",
        [
            "sin(x) + cos(2*y)*tan(z/4) - tanh(x*y)",
            "asin(x/9) * acos(y/9) + atan(z) + sinh(x/3) - cosh(y/2)",
            "exp(-x**2) + log(x + 9) - sqrt(y + 9) + abs(z - 1)",
            "hypot(x, y, z) + hypot(x, 2) + atan2(y + 9, x) + max(x, y, z) - min(x, 1)",
            "x^3 / (1 + y^2) - (x + 9)^0.5 + (y + 9)^-2 + (z + 9)^x + pi*e",
            "+x - -y * X + Z / 2",
        ],
    )
    def test_the_gradient_is_the_derivative(self, formula: str) -> None:
        field = fields.expression(formula)
        points = RNG.uniform(-2, 2, (400, 3))
        h = 1e-4
        quotient = np.stack([(field(points + h * e) - field(points - h * e)) / (2 * h) for e in np.eye(3)], axis=-1)
        wrong = np.abs(quotient - field.gradient(points)).max(axis=1) > 1e-5
        assert wrong.mean() < 0.01

    def test_named_fields_may_occur(self) -> None:
        gyroid, ball = fields.tpms("gyroid", 10.0), fields.sphere((0, 0, 0), 4)
        points = RNG.uniform(-5, 5, (50, 3))
        field = fields.expression("max(g, b) + 0*z", g=gyroid, b=ball)
        np.testing.assert_allclose(field(points), (gyroid & ball)(points), atol=1e-14)
        np.testing.assert_allclose(fields.expression("g", g=2)(points), 2.0)

    @pytest.mark.parametrize(
        ("formula", "periods"),
        [
            ("sin(x)*cos(y) + sin(3*z)", (10, 10, 10 / 3)),
            ("sin(x + 2*y) * cos(z)", (10, 5, 10)),
            ("sin(x) + sin(1.5*x) + cos(y) + cos(z)", None),
            ("sin(x) + y + cos(z)", None),
            ("sin(x) * cos(y)", None),
            ("sin(x*y) + cos(z)", None),
        ],
    )
    def test_periods_are_stated_where_the_formula_shows_them(
        self, formula: str, periods: tuple[float, float, float] | None
    ) -> None:
        found = fields.expression(formula, 10.0).periods()
        assert found == (None if periods is None else pytest.approx(periods))

    def test_capital_letters_are_model_units(self) -> None:
        field = fields.expression("X + Y + Z + x", period=2 * np.pi * 3)
        assert float(field((3.0, 4.0, 5.0))) == pytest.approx(13.0)

    def test_names_the_place_of_a_value_that_is_not_finite(self) -> None:
        with pytest.raises(InvalidRequest, match=r"value of 'log\(x\)' .* \(-1, 0, 2\)"):
            fields.expression("log(x)")((-1.0, 0.0, 2.0))
        with pytest.raises(InvalidRequest, match=r"gradient of 'sqrt\(x\)'"):
            fields.expression("sqrt(x)").gradient((0.0, 0.0, 2.0))

    def test_a_distance_has_a_gradient_on_its_axis(self) -> None:
        axis = (0.0, 0.0, 2.0)
        for formula in ("hypot(x, y) - 1", "sqrt(x^2 + y^2) - 1"):
            assert (fields.expression(formula).gradient(axis) == 0).all()

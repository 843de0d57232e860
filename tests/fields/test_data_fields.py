"""Fields of data: samples, scattered points and formulas."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.fields.data.image_files import read_image

RNG = np.random.default_rng(11)
SPACING, ORIGIN = np.array([0.5, 0.4, 0.7]), np.array([1.0, -2.0, 0.5])
SHAPE = (7, 9, 8)
INDICES = np.stack(np.meshgrid(*map(np.arange, SHAPE), indexing="ij"), axis=-1)
SITES = ORIGIN + SPACING * INDICES


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

    def test_survives_pickling(self) -> None:
        field = fields.sampled(RNG.normal(size=SHAPE), SPACING, ORIGIN)
        points = RNG.uniform(-3, 6, (20, 3))
        assert (pickle.loads(pickle.dumps(field))(points) == field(points)).all()

    @pytest.mark.parametrize(
        ("values", "keywords", "message"),
        [
            (np.zeros((5, 5)), {}, r"shape \(5, 5\)"),
            (np.zeros((5, 3, 5)), {}, "at least 4 samples"),
            (np.full((4, 4, 4), np.nan), {}, r"64 of 64 entries, the first at index \(0, 0, 0\)"),
            (np.zeros((4, 4, 4)), {"spacing": 0}, "spacing 0 must"),
            (np.zeros((4, 4, 4)), {"spacing": (1, 2)}, "spacing"),
            (np.zeros((4, 4, 4)), {"origin": (1, np.inf, 0)}, "origin"),
            (np.zeros((4, 4, 4)), {"level": "high"}, "level 'high'"),
            ([["a"]], {}, "no array of numbers"),
            ("density.txt", {}, "choose one of .npy"),
            ("absent.npy", {}, "no file"),
        ],
    )
    def test_refuses_what_is_no_volume(self, values: object, keywords: dict[str, object], message: str) -> None:
        with pytest.raises(InvalidRequest, match=message):
            fields.sampled(values, **keywords)  # type: ignore[arg-type]


class TestImageFiles:
    """Files written by other libraries are read back with their spacing and position."""

    VALUES = RNG.normal(size=(4, 5, 6))

    def check(self, path: Path) -> None:
        image = read_image(path)
        np.testing.assert_allclose(image.values, self.VALUES, rtol=1e-6)
        np.testing.assert_allclose(image.spacing, SPACING, rtol=1e-6)
        np.testing.assert_allclose(image.origin, ORIGIN, rtol=1e-6)

    def test_numpy(self, tmp_path: Path) -> None:
        np.save(tmp_path / "a.npy", self.VALUES)
        assert (fields.sampled(tmp_path / "a.npy", 2.0).domain[1] == 2.0 * (np.array(self.VALUES.shape) - 1)).all()

    @pytest.mark.parametrize("suffix", ["nii", "nii.gz"])
    @pytest.mark.parametrize("flipped", [False, True])
    def test_nifti(self, tmp_path: Path, suffix: str, flipped: bool) -> None:
        nibabel = pytest.importorskip("nibabel")
        affine = np.diag([*SPACING, 1.0])
        affine[:3, 3] = ORIGIN
        stored = self.VALUES
        if flipped:  # the usual patient coordinates: the first axis runs to the left
            stored = self.VALUES[::-1]
            affine[0, 3] += SPACING[0] * (len(stored) - 1)
            affine[0, 0] *= -1
        nibabel.save(nibabel.Nifti1Image(stored, affine), tmp_path / f"a.{suffix}")
        self.check(tmp_path / f"a.{suffix}")

    def test_a_turned_image_is_refused(self, tmp_path: Path) -> None:
        nibabel = pytest.importorskip("nibabel")
        affine = np.eye(4)
        affine[:2, :2] = [[0.8, -0.6], [0.6, 0.8]]
        nibabel.save(nibabel.Nifti1Image(self.VALUES, affine), tmp_path / "a.nii")
        with pytest.raises(InvalidRequest, match="resample"):
            read_image(tmp_path / "a.nii")

    def test_nrrd_with_exchanged_axes(self, tmp_path: Path) -> None:
        nrrd = pytest.importorskip("nrrd")
        directions = np.diag(SPACING)[[2, 1, 0]]
        header = {"space": "left-posterior-superior", "space directions": directions, "space origin": ORIGIN}
        nrrd.write(str(tmp_path / "a.nrrd"), np.ascontiguousarray(self.VALUES.transpose(2, 1, 0)), header)
        self.check(tmp_path / "a.nrrd")

    @pytest.mark.parametrize("suffix", ["vti", "vtk"])
    @pytest.mark.slow
    def test_vtk(self, tmp_path: Path, suffix: str) -> None:
        pytest.importorskip("vtkmodules")
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonDataModel import vtkImageData
        from vtkmodules.vtkIOLegacy import vtkStructuredPointsWriter
        from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

        data = vtkImageData()
        data.SetDimensions(*self.VALUES.shape)
        data.SetSpacing(*SPACING)
        data.SetOrigin(*ORIGIN)
        data.GetPointData().SetScalars(numpy_to_vtk(self.VALUES.ravel(order="F"), deep=True))
        writer = vtkXMLImageDataWriter() if suffix == "vti" else vtkStructuredPointsWriter()
        writer.SetFileName(str(tmp_path / f"a.{suffix}"))
        writer.SetInputData(data)
        writer.Write()
        self.check(tmp_path / f"a.{suffix}")

    def test_of_several_arrays_none_is_picked(self, tmp_path: Path) -> None:
        pytest.importorskip("vtkmodules")
        from vtkmodules.util.numpy_support import numpy_to_vtk
        from vtkmodules.vtkCommonDataModel import vtkImageData
        from vtkmodules.vtkIOXML import vtkXMLImageDataWriter

        data = vtkImageData()
        data.SetDimensions(*self.VALUES.shape)
        for name in ("density", "stress"):
            array = numpy_to_vtk(self.VALUES.ravel(order="F"), deep=True)
            array.SetName(name)
            data.GetPointData().AddArray(array)
        writer = vtkXMLImageDataWriter()
        writer.SetFileName(str(tmp_path / "a.vti"))
        writer.SetInputData(data)
        writer.Write()
        with pytest.raises(InvalidRequest, match=r"a\.vti holds 2 arrays, 'density', 'stress'"):
            read_image(tmp_path / "a.vti")

    def test_a_level_outside_the_data_is_refused_with_their_range(self) -> None:
        values = np.linspace(0.0, 2.0, 125).reshape(5, 5, 5)
        for level in (-0.1, 2.0, 7.0):
            with pytest.raises(InvalidRequest, match="which reach from 0 to 2"):
                fields.sampled(values, level=level)

    @pytest.mark.parametrize("suffix", ["npy", "vti", "vtk", "nrrd", "nii"])
    def test_a_broken_file_is_refused(self, tmp_path: Path, suffix: str, capfd: pytest.CaptureFixture[str]) -> None:
        (tmp_path / f"a.{suffix}").write_bytes(b"no image at all")
        with pytest.raises(InvalidRequest, match=f"a.{suffix}"):
            read_image(tmp_path / f"a.{suffix}")


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

    def test_a_csv_file_gives_the_field_of_its_columns(self, tmp_path: Path) -> None:
        values = self.POINTS @ (1.0, 2.0, -1.0)
        file = tmp_path / "points.csv"
        np.savetxt(file, np.column_stack([self.POINTS, values]), delimiter=",", header="x,y,z,v", comments="")
        inside = RNG.uniform(2, 8, (50, 3))
        assert fields.scattered(str(file), level=1.0)(inside) == pytest.approx(1.0 - inside @ (1.0, 2.0, -1.0))

    @pytest.mark.parametrize(
        ("call", "message"),
        [
            (lambda: fields.scattered("none.csv"), "there is no file none.csv"),
            (lambda: fields.scattered("none.csv", np.zeros(5)), "leave values out"),
            (lambda: fields.scattered(np.eye(3)), "give the values after them"),
        ],
    )
    def test_says_where_the_values_come_from(self, call: Callable[[], object], message: str) -> None:
        with pytest.raises(InvalidRequest, match=message):
            call()

    @pytest.mark.parametrize(
        ("points", "values", "message"),
        [
            (np.zeros((5, 2)), np.zeros(5), r"shape \(5, 2\)"),
            (np.zeros((5, 3)), np.zeros(4), r"shape \(4,\)"),
            (np.eye(3), np.zeros(3), "fewer than 4"),
            (np.repeat(POINTS[:4], 2, axis=0), np.zeros(8), "occurs twice"),
            (POINTS[:9] * (1, 1, 0), np.zeros(9), "one plane"),
            (POINTS[:5], np.array([0, 1, np.nan, 3, 4]), r"1 of 5 entries, the first at index \(2,\)"),
        ],
    )
    def test_refuses_points_that_determine_no_field(self, points: np.ndarray, values: np.ndarray, message: str) -> None:
        with pytest.raises(InvalidRequest, match=message):
            fields.scattered(points, values)

    def test_refuses_a_resolution_below_four(self) -> None:
        with pytest.raises(InvalidRequest, match=r"resolution \(3, 3, 3\)"):
            fields.scattered(self.POINTS, self.POINTS[:, 0], resolution=(3, 3, 3))


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

    @pytest.mark.parametrize(
        ("formula", "message"),
        [
            ("__import__('os').system('true')", "may not stand"),
            ("x.__class__", "may not stand"),
            ("(lambda: x)()", "may not stand"),
            ("[x for x in y]", "may not stand"),
            ("x if y else z", "may not stand"),
            ("x < y", "may not stand"),
            ("'text'", "may not stand"),
            ("True", "may not stand"),
            ("2j * x", "may not stand"),
            ("sin(x, y)", "one argument"),
            ("sin(u=x)", "may not stand"),
            ("max(x)", "two or more"),
            ("atan2(x)", "two arguments"),
            ("sine(x)", "did you mean 'sin'"),
            ("r + x", "'r' is unknown"),
            ("sin + x", r"write sin\(x\)"),
            ("x // 2", "operator"),
            ("x *", "cannot be read"),
            ("", "cannot be read"),
            ("x\x00", "cannot be read"),
            ("1e400 * x", "too large"),
            ("9" * 400 + "*x", "too large"),
            ("x / 0", "other than zero"),
            ("(" * 400 + "x" + ")" * 400, "cannot be read"),
            ("-" * 150 + "x", "deep"),
            ("x + " * 4000 + "x", "characters"),
            (3, "must be text"),
        ],
    )
    def test_refuses_everything_else(self, formula: str, message: str) -> None:
        with pytest.raises(InvalidRequest, match=message):
            fields.expression(formula)

    def test_refuses_names_that_have_a_meaning(self) -> None:
        with pytest.raises(InvalidRequest, match="another name"):
            fields.expression("x", x=1.0)

    def test_names_the_place_of_a_value_that_is_not_finite(self) -> None:
        with pytest.raises(InvalidRequest, match=r"value of 'log\(x\)' .* \(-1, 0, 2\)"):
            fields.expression("log(x)")((-1.0, 0.0, 2.0))
        with pytest.raises(InvalidRequest, match=r"gradient of 'sqrt\(x\)'"):
            fields.expression("sqrt(x)").gradient((0.0, 0.0, 2.0))

    def test_a_distance_has_a_gradient_on_its_axis(self) -> None:
        axis = (0.0, 0.0, 2.0)
        for formula in ("hypot(x, y) - 1", "sqrt(x^2 + y^2) - 1"):
            assert (fields.expression(formula).gradient(axis) == 0).all()

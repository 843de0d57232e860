"""Fields and triangle meshes as bodies: filled, within a skin, and divided into the domains of an exchanger."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.errors import InvalidRequest, LevelSetError
from tpmscad.results.model import Model
from tpmscad.solids.bodies import fitted_body
from tpmscad.solids.bodies.fitted_body import FittedBody, fit_field_body
from tpmscad.solids.skins import distance_skin
from tpmscad.stage_timer import StageTimer

trimesh = pytest.importorskip("trimesh")
pytestmark = [pytest.mark.kernel, pytest.mark.slow]

ELLIPSOID = fields.expression("x^2/1.69 + y^2 + z^2 - 16")
VOLUME = 4 / 3 * np.pi * 1.3 * 64
P: dict[str, Any] = {"surface": "schwarz_p", "cell": 5, "thickness": 0.6, "tol": 0.03, "phase": (0.1, 0.2, 0.3)}


def fraction_in_lattice(points: np.ndarray) -> float:
    """The part of points in the wall of P, by the normal distance of the nodal surface, .001 of the cell off."""
    distance = fields.normal_distance(fields.tpms("schwarz_p", 5.0, P["phase"]))
    return float((np.abs(distance(points)) < 0.3).mean())


def sample_box(field: Any, count: int = 40_000) -> np.ndarray:
    points = np.random.default_rng(1).uniform((-5.4, -4.2, -4.2), (5.4, 4.2, 4.2), (count, 3))
    return points[field(points) < 0]


@pytest.fixture(scope="module")
def filled() -> Model:
    return tpmscad.infill(ELLIPSOID, **P)


def test_the_solid_of_a_formula_is_filled(filled: Model, tmp_path: Path) -> None:
    certificate = filled.certificate
    assert certificate.met, certificate.shortfalls
    expected = fraction_in_lattice(sample_box(ELLIPSOID))
    assert certificate.volume / VOLUME == pytest.approx(expected, abs=0.01)
    assert certificate.figures["deviation of the body from its field"] <= 0.03
    assert "as body" in certificate.reference
    filled.export(tmp_path / "filled.step")  # which reads it back


def test_a_skin_keeps_its_thickness_and_the_lattice_within() -> None:
    model = tpmscad.infill(ELLIPSOID, skin=1.0, **P)
    certificate = model.certificate
    assert certificate.met, certificate.shortfalls
    note = next(note for note in certificate.notes if note.startswith("skin of 1 "))
    least, greatest = (float(word) for word in note.split(": ")[1].split(" thick")[0].split(" to "))
    assert 0.98 <= least <= greatest < 1.05
    points = sample_box(ELLIPSOID)
    depth = -fields.normal_distance(ELLIPSOID)(points)
    deep = points[depth > 1]
    expected = 1 - len(deep) / len(points) * (1 - fraction_in_lattice(deep))
    assert certificate.volume / VOLUME == pytest.approx(expected, abs=0.01)
    assert certificate.betti[2] == 2  # both channels are closed off
    assert model.bounding_box[1][0] == pytest.approx(5.2, abs=0.03)


def test_where_a_cavity_is_not_fitted_its_edges_are_rounded_more_and_it_is_told(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    round_ridges, widths = distance_skin._round_ridges, []

    def watch(values: np.ndarray, width: float) -> np.ndarray:
        widths.append(width)
        return round_ridges(values, width)

    def fail_first(*_: Any) -> distance_skin.DistanceCavity:
        if len(widths) == 1:
            raise LevelSetError("3 places could not be fitted")
        return distance_skin.DistanceCavity("the body", body.built.brep, body.field, (), ("fitted",))

    body = fit_field_body(fields.expression("x^2/4 + y^2 + z^2 - 4"), None, 0.1, StageTimer(None), is_default=False)
    assert isinstance(body, FittedBody)
    monkeypatch.setattr(distance_skin, "_round_ridges", watch)
    monkeypatch.setattr(distance_skin, "_fit_cavity", fail_first)
    told, rounded = distance_skin.erode_by_distance(body, 0.5).notes
    assert told == "fitted"
    assert "a Gaussian of 0.46 skins" in rounded
    assert widths[1] / widths[0] == pytest.approx(0.46 / distance_skin.SMOOTHING_WIDTHS[0])


def test_the_cavity_of_a_wedge_ends_bluntly_and_its_skin_is_nowhere_thinner() -> None:
    """Ten degrees to either side of the bisector x, a spacing of 1: five spacings after its end it is half as wide again."""
    x, y, _ = np.meshgrid(np.arange(0.0, 60.0), np.arange(-15.0, 16.0) + 0.3, np.arange(9.0), indexing="ij")
    wedge = np.abs(y) * np.cos(np.deg2rad(10)) - x * np.sin(np.deg2rad(10))
    rounded = distance_skin._round_ridges(wedge, 0.7)
    widths = [np.trapezoid(np.clip(0.5 - values[:, :, 4] - 3.0, 0, 1), axis=1) for values in (wedge, rounded)]
    beyond_end = [width[np.flatnonzero(width)[0] + 5] for width in widths]
    assert beyond_end[1] > 1.6 * beyond_end[0] > 2.5
    inside = (x > 10) & (x < 50) & (np.abs(y) < 10)  # what lies near the ends of the grid is not a wedge
    raised = (rounded - wedge)[inside]
    assert raised.min() > -0.02
    assert 0.8 < raised.max() < 1.2
    flat = inside & (np.abs(y) > 5)
    assert np.abs(rounded - wedge)[flat].max() < 1e-3


def test_smoothing_does_not_thin_a_skin_below_a_concave_edge() -> None:
    """There the distance is that from a line, which a Gaussian of variance s^2 lowers by s^2 / 2 r at the distance r."""
    x, y, _ = np.meshgrid(np.arange(30.0) - 14.6, np.arange(30.0) - 14.7, np.arange(9.0), indexing="ij")
    from_line = np.hypot(x, y)
    ring = (from_line > 2.5) & (from_line < 9)
    raised = (distance_skin._round_ridges(-from_line, 0.7) + from_line)[ring]
    assert raised.min() > -0.02
    assert raised.max() < 0.02


def test_the_domains_of_an_exchanger_share_faces_and_fill_the_body(filled: Model) -> None:
    domains = tpmscad.fluid_domains(ELLIPSOID, **P)
    assert domains.certificate.met, domains.certificate.shortfalls
    assert domains.volume == pytest.approx(VOLUME, rel=2e-3)
    assert domains.wall.volume == pytest.approx(filled.volume, rel=1e-6)
    faces = [
        {hash(face.wrapped) for face in model.solid.faces()} for model in (domains.wall, domains.plus, domains.minus)
    ]
    assert faces[0] & faces[1]
    assert faces[0] & faces[2]
    assert not faces[1] & faces[2]
    assert [contact.label for contact in domains.touches] == ["body"]
    assert domains.plus.openings == {"opening"}


def test_samples_that_end_at_their_box_are_closed_by_planes() -> None:
    axes = [np.linspace(-5, 5, 11), np.linspace(-5, 5, 11), np.linspace(0, 6, 7)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    half = fields.sampled(np.sqrt(x**2 + y**2 + z**2) - 4.1, spacing=1.0, origin=(-5, -5, 0))
    model = tpmscad.infill(half, skin=1.0, **P)
    assert model.certificate.met, model.certificate.shortfalls
    flat = [face for face in model.solid.faces() if face.geom_type == bd.GeomType.PLANE]
    assert len(flat) == 1
    assert flat[0].area == pytest.approx(np.pi * 4.1**2, rel=5e-3)


def test_the_bounds_of_a_body_stay_in_the_box_that_ends_it() -> None:
    """The poles of patches that a side cuts reach beyond it, where samples of the volume would be counted as solid."""
    x, y, z = np.meshgrid(*[np.arange(0, 4.1, 1.0)] * 3, indexing="ij")
    data = fields.sampled(np.cos(1.9 * x) + np.cos(1.7 * y + 0.4) + np.sin(1.8 * z), 1.0, (0, 0, 0))
    body = fit_field_body(data, None, 0.05, StageTimer(None), is_default=False)
    assert isinstance(body, FittedBody)
    low, high = np.array(body.cad.report.bounds)
    assert (low >= 0).all()
    assert (high <= 4).all()
    points = low + (high - low) * np.random.default_rng(4).random((100_000, 3))
    sampled = float((body.field(points) < 0).mean()) * float(np.prod(high - low))
    assert sampled == pytest.approx(body.cad.volume, rel=0.02)


def test_noisy_data_are_followed_to_a_tenth_of_their_spacing_unless_a_tolerance_is_asked_for() -> None:
    """The tolerance of a lattice of small cells is far below what samples say of their surface."""
    x, y, z = np.meshgrid(*[np.arange(-3.5, 3.6, 0.5)] * 3, indexing="ij")
    noise = np.random.default_rng(2).normal(0, 0.02, x.shape)
    data = fields.sampled(np.sqrt(x**2 + y**2 + z**2) - 2.2 + noise, 0.5, (-3.5, -3.5, -3.5))
    for field in (data, fields.smooth_intersection(data, fields.sphere((0, 0, 0), 4), width=0.1)):
        body = fit_field_body(field, data.domain, 1e-3, StageTimer(None), is_default=True)
        assert isinstance(body, FittedBody)
        assert body.measures.tol == pytest.approx(0.05)
        assert body.measures.deviation.max <= 0.05
    asked = fit_field_body(data, None, 0.02, StageTimer(None), is_default=False)
    assert isinstance(asked, FittedBody)
    assert asked.measures.tol == 0.02


def test_a_mesh_is_filled_and_its_distance_stated(tmp_path: Path) -> None:
    source = trimesh.creation.icosphere(3, 4.0)
    source.apply_scale((1.3, 1.0, 1.0))
    source.export(tmp_path / "part.stl")
    model = tpmscad.infill(tmp_path / "part.stl", **P)
    certificate = model.certificate
    assert certificate.met, certificate.shortfalls
    expected = fraction_in_lattice(sample_box(ELLIPSOID))
    assert certificate.volume / source.volume == pytest.approx(expected, abs=0.012)
    # the triangles lie up to .02 below the ellipsoid, and the patches between both
    there, back = (
        certificate.figures[f"distance of the {a} from the {b}"]
        for a, b in (("body", "triangles"), ("triangles", "body"))
    )
    assert 0.005 < there < 0.05
    assert 0.005 < back < 0.05
    on_body = [tuple(v) for face in model.solid.faces() for v in face.vertices()]
    points = np.array(on_body)
    outside = points[ELLIPSOID(points) > -0.3]
    assert len(outside)
    nearest = trimesh.proximity.closest_point_naive(source, outside)[1]
    assert nearest.max() < 1.2 * there + 1e-3
    assert any("part.stl" in note for note in certificate.notes)


def test_a_field_of_planes_and_spheres_is_an_exact_body() -> None:
    dome = fields.sphere((0, 0, 0), 4.0) & fields.halfspace((0, 0, 1), "z")
    model = tpmscad.infill(dome, **P)
    assert model.certificate.met
    kinds = {face.geom_type for face in model.solid.faces()}
    assert {bd.GeomType.PLANE, bd.GeomType.SPHERE} <= kinds


@pytest.mark.parametrize(
    ("body", "changed", "words"),
    [
        (fields.tpms("gyroid", 9.0), {}, "no bounds of the field"),
        (fields.from_function(lambda x, y, z: x**2 + y**2 + z**2 - 30), {}, "two corners as `box`"),
        (ELLIPSOID, {"skin": 1.0, "open_faces": [">Z"]}, "open_faces are plane faces of a CAD body"),
        (ELLIPSOID, {"skin": 5.0}, "a skin of 5 leaves nothing"),
        (ELLIPSOID, {"cell": 40}, "less than a cell"),
        (ELLIPSOID, {"box": ((20, 20, 20), (30, 30, 30))}, "no part of the surface of the field lies in its box"),
        (bd.Box(9, 9, 9), {"box": ((0, 0, 0), (5, 5, 5))}, "a CAD body has bounds of its own"),
        ("nowhere.stl", {}, "no file"),
    ],
)
def test_what_is_no_body_is_refused(body: Any, changed: dict[str, Any], words: str) -> None:
    with pytest.raises(InvalidRequest, match=words):
        tpmscad.infill(body, **{**P, **changed})


def test_a_mesh_that_is_not_fitted_is_sampled_at_another_spacing_unless_one_is_given(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    ball = trimesh.creation.icosphere(2, 5.0)
    both_outward = trimesh.util.concatenate([ball, trimesh.creation.icosphere(2, 3.0)])  # a full ball
    nested, coarse = fields.mesh(both_outward), fields.mesh(both_outward, spacing=0.8)
    fit, tried = fitted_body._fit_body, []

    def refuse_once(field: Any, *args: Any) -> Any:
        tried.append(field)
        if len(tried) == 1:
            raise LevelSetError("folded")
        return fit(coarse, *args)

    monkeypatch.setattr(fitted_body, "_fit_body", refuse_once)
    body = fit_field_body(nested, None, 0.3, StageTimer(None), is_default=False)
    assert isinstance(body, FittedBody)
    assert tried[1].spacing[0] == pytest.approx(2**-0.5 * tried[0].spacing[0])
    assert any("sampled at another spacing" in note for note in tried[1].notes)
    assert body.cad.volume == pytest.approx(ball.volume, rel=0.01)
    assert len(body.built.nesting.volume) == 1  # one shell, without a cavity at the inner triangles
    tried.clear()
    with pytest.raises(LevelSetError, match="folded"):
        fit_field_body(coarse, None, 0.3, StageTimer(None), is_default=False)

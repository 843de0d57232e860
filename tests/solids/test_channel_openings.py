"""Heat exchangers whose channels open at named faces: areas on the faces, distance of the channels, pieces, and refusals."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any

import build123d as bd
import numpy as np
import pytest
from scipy.spatial import cKDTree

import tpmscad
from tpmscad import fields
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.measure.shape_sampling import contains_points, sample_faces
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of
from tpmscad.kernel.step.face_labels import label_faces
from tpmscad.requests.channel_openings import resolve_channel_openings
from tpmscad.requests.lattice_options import FluidDomainsOptions
from tpmscad.requests.lattice_request import read_lattice_request
from tpmscad.results.domain_results import FluidDomains
from tpmscad.results.model import Model
from tpmscad.solids import ended_channels
from tpmscad.solids._fluid_domains import _resolve_openings, _resolve_transition
from tpmscad.solids.bodies.fitted_body import FittedBody
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.channel_reach import require_connected
from tpmscad.solids.ended_channels import ChannelEnds
from tpmscad.solids.matter.closed_channels import _open_fraction, _sample_body, extend_distance

pytestmark = pytest.mark.kernel

SIZE = np.array([20.0, 18.0, 16.0])
SKIN = 1.5
OPENINGS = {"+": ["<X", ">X"], "-": "<Y,>Y"}
ASKED: dict[str, Any] = {"surface": "gyroid", "cell": 10, "thickness": 1, "tol": 0.1, "openings": OPENINGS}
SMALL = (20.0, 10.0, 10.0)


@pytest.fixture(scope="module")
def domains() -> FluidDomains:
    return tpmscad.fluid_domains(bd.Box(*SIZE), **ASKED, skin=SKIN)


def measure_depths(channel: Model, axis: int) -> tuple[float, float]:
    """The least depths of a channel's faces in the box: below the sides of an axis, and below all others."""
    points = sample_faces(faces_of(channel.solid.wrapped), 0.3).points
    depth = (SIZE / 2 - np.abs(points)).min(axis=0)
    return float(depth[axis]), float(np.delete(depth, axis).min())


class TestCrossFlow:
    def test_each_channel_reaches_its_own_faces_only_and_ends_the_skin_before_others(
        self, domains: FluidDomains
    ) -> None:
        for channel, axis in ((domains.plus, 0), (domains.minus, 1)):
            assert measure_depths(channel, axis) == pytest.approx((0.0, SKIN), abs=1e-9)

    def test_the_channels_are_nowhere_nearer_than_the_thickness(self, domains: FluidDomains) -> None:
        plus, minus = (
            sample_faces(faces_of(each.solid.wrapped), 0.15).points for each in (domains.plus, domains.minus)
        )
        least = cKDTree(plus).query(minus)[0].min()
        assert 1.0 - 2 * 0.1 <= least <= 1.2

    def test_three_pieces_fill_the_body(self, domains: FluidDomains, tmp_path: Path) -> None:
        assert domains.certificate.met
        assert [len(model.certificate.pieces) for model in domains.domains.values()] == [1, 1, 1]
        assert domains.volume == pytest.approx(np.prod(SIZE), rel=1e-9)
        ended = "each channel ends 1.5 before the faces where it does not open; 52% of the body is wall"
        assert ended in domains.certificate.notes
        domains.export_step(tmp_path / "exchanger.step")  # which reads it back
        assert (tmp_path / "exchanger.step").read_text().count("MANIFOLD_SOLID_BREP(") == 3

    def test_the_wall_has_all_faces_of_the_channels_but_their_openings(self, domains: FluidDomains) -> None:
        wall = {ShapeKey(face) for face in faces_of(domains.wall.solid.wrapped)}
        for channel, axis in ((domains.plus, 0), (domains.minus, 1)):
            own = faces_of(channel.solid.wrapped)
            others = [face for face in own if ShapeKey(face) not in wall]
            assert 2 <= len(others) < len(own)
            points = sample_faces(others, 0.3).points
            np.testing.assert_allclose(np.abs(points[:, axis]), SIZE[axis] / 2, atol=1e-9)

    def test_openings_are_named_by_channel_and_side(self, domains: FluidDomains) -> None:
        assert domains.plus.openings == {"opening X+", "opening X-"}
        assert domains.minus.openings == {"opening Y+", "opening Y-"}
        assert "skin" in label_faces(domains.plus.patches)


@pytest.mark.slow
def test_a_channel_closes_gradually_over_a_transition() -> None:
    made = tpmscad.fluid_domains(bd.Box(*SIZE), **ASKED, skin=SKIN, transition=6)
    assert made.certificate.met
    assert [len(model.certificate.pieces) for model in made.domains.values()] == [1, 1, 1]
    assert made.volume == pytest.approx(np.prod(SIZE), rel=1e-7)
    for channel, axis in ((made.plus, 0), (made.minus, 1)):
        at_openings, elsewhere = measure_depths(channel, axis)
        assert at_openings == pytest.approx(0.0, abs=1e-9)
        assert elsewhere > SKIN - 0.1
    assert made.plus.openings == {"opening X+", "opening X-"}


@pytest.mark.parametrize("surface", ["diamond", "primitive", "iwp"])
def test_walls_of_other_surfaces_end_their_channels_in_a_box_of_one_cell(surface: str) -> None:
    made = tpmscad.fluid_domains(bd.Box(*SMALL), **(ASKED | {"surface": surface, "tol": 0.2}))
    assert made.certificate.met
    assert made.volume == pytest.approx(np.prod(SMALL), rel=1e-9)


def test_a_graded_wall_ends_its_channels() -> None:
    graded = ASKED | {"thickness": lambda points: 1.0 + 0.01 * points[:, 0], "tol": 0.2}
    with pytest.raises(tpmscad.InvalidRequest, match="the thickness of this wall varies: give skin="):
        tpmscad.fluid_domains(bd.Box(*SMALL), **graded)
    made = tpmscad.fluid_domains(bd.Box(*SMALL), **graded, skin=1)
    assert made.certificate.met
    assert made.volume == pytest.approx(np.prod(SMALL), rel=1e-9)


def test_what_is_kept_is_wall_and_no_opening() -> None:
    made = tpmscad.fluid_domains(bd.Box(*SMALL), **ASKED, keep=bd.Pos(3, 0, 0) * bd.Cylinder(2, 8))
    assert made.certificate.met
    assert made.volume == pytest.approx(np.prod(SMALL), rel=1e-9)
    assert "kept 0" in label_faces(made.wall.patches)
    assert made.plus.openings == {"opening X+", "opening X-"}
    axis = np.column_stack([np.full(9, 3.0), np.zeros(9), np.linspace(-3.9, 3.9, 9)])
    assert contains_points(made.wall.solid.wrapped, axis).all()


def test_channels_that_would_not_connect_their_openings_are_refused_with_a_skin_that_works() -> None:
    with pytest.raises(tpmscad.InvalidRequest, match=r"channel - falls into pieces .* a skin of 2\.6 works"):
        tpmscad.fluid_domains(bd.Box(*SMALL), **ASKED, skin=4)
    with pytest.raises(tpmscad.InvalidRequest, match=r"channel \+ does not reach body 0, an opening, .* a skin of \d"):
        tpmscad.fluid_domains(bd.Box(*SMALL), **ASKED, skin=4.99)
    body, request = KernelBody(read_body(bd.Box(*SMALL))), read_lattice_request("gyroid", cell=10, thickness=1)
    openings = resolve_channel_openings(body.cad, OPENINGS)
    require_connected(body, request, np.eye(3), ChannelEnds(openings, 2.6))


def test_where_the_body_cannot_be_eroded_a_transition_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise tpmscad.TrimmingError("its offset faces do not close")

    monkeypatch.setattr(ended_channels, "erode_body", fail)
    with pytest.raises(tpmscad.TrimmingError, match=r"cannot end 1 before .* give a positive `transition`"):
        tpmscad.fluid_domains(bd.Box(*SMALL), **ASKED)


def test_only_plane_openings_end_abruptly_unasked() -> None:
    body, request = KernelBody(read_body(bd.Cylinder(8, 20))), read_lattice_request("gyroid", cell=10, thickness=1)
    ends, sides = (resolve_channel_openings(body.cad, {"+": "<Z,>Z", "-": each}) for each in ("<Z", [0]))
    assert body.face_labels[0].startswith("body 0")
    assert _resolve_transition(body, ends, None, request) == 0.0
    assert _resolve_transition(body, sides, None, request) == 10.0
    assert _resolve_transition(body, sides, 3.0, request) == 3.0


def test_the_distance_is_exact_near_the_wall_and_grows_through_the_channels() -> None:
    request = read_lattice_request("gyroid", cell=10, thickness=1, tol=0.02)
    found = extend_distance(request)
    exact = fields.normal_distance(fields.tpms("gyroid", 10.0, request.phase, reference="minimal"))
    points = np.random.default_rng(1).uniform(0, 10, (4000, 3))
    distance = exact(points)
    near = np.abs(distance) < 0.5
    np.testing.assert_allclose(found.field(points)[near], distance[near], atol=2 * found.error)
    assert found.error < 0.01
    assert (np.abs(found.field(points)[~near]) > 0.5 - 0.01).all()
    assert found.high > 1.2


def test_steps_of_closed_faces_are_one_inside_and_zero_behind_the_skin() -> None:
    body = read_body(bd.Cylinder(8, 20))
    opened = resolve_channel_openings(body, {"+": [">Z", "<Z"], "-": ["<Z"]})
    samples = _sample_body(body)
    plus = _open_fraction(body, samples, opened.plus, 1.0, 4.0)
    minus = _open_fraction(body, samples, opened.minus, 1.0, 4.0)
    points = np.array([(0, 0, 9.9), (0, 0, 9.1), (0, 0, 0), (7.1, 0, 0), (0, 6.9, -9.9), (2.9, 0, -9.9)])
    np.testing.assert_allclose(plus(points)[[0, 1, 2, 5]], 1.0)
    assert plus(points)[3] == 0.0
    assert 0.0 < plus(points)[4] < 0.01
    np.testing.assert_allclose(minus(points)[[0, 1, 3]], 0.0)
    assert minus(points)[2] == 1.0


def test_a_port_in_the_plane_of_a_closed_face_is_told_from_it_by_the_bounded_face() -> None:
    with bd.SkipClean():
        part = bd.Box(10, 10, 8) + bd.Pos(10, 0, 0) * bd.Box(10, 10, 8)
    body = read_body(part)
    tops = [i for i, face in enumerate(faces_of(body.shape)) if bd.Face(face).center().Z > 3.9]
    left, right = sorted(tops, key=lambda i: bd.Face(faces_of(body.shape)[i]).center().X)
    opened = frozenset(range(len(faces_of(body.shape)))) - {right}
    fraction = _open_fraction(body, _sample_body(body), opened, 1.0, 4.0)
    np.testing.assert_allclose(fraction([(-1.0, 0.0, 3.5), (12.0, 0.0, 3.9)]), [1.0, 0.0], atol=1e-9)
    assert left != right


REFUSED: dict[str, tuple[dict[str, Any], str]] = {
    "a channel without an opening": ({"openings": {"+": ">X"}}, "the channel - opens nowhere.*name its faces"),
    "a third channel": ({"openings": {"+": ">X", "0": ">Y"}}, "names a channel '0'"),
    "an unknown face": ({"openings": {"+": [99], "-": ">Y"}}, "99 is no face of .* numbers from 0 to 5"),
    "no selector": ({"openings": {"+": "X", "-": ">Y"}}, "`openings` 'X' is no selector"),
    "no openings": ({"openings": None, "transition": 6}, "give openings="),
    "a skin without openings": (
        {"openings": None, "skin": 2},
        "skin is the wall along faces .* give openings=",
    ),
    "too short": (
        {"transition": 1.0},
        r"transition 1 is too short: .* 45 degrees; give at least \d",
    ),
    "too thick": ({"transition": 6, "thickness": 3.4}, "too thick for openings"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_refused_openings_name_the_remedy(name: str) -> None:
    changes, text = REFUSED[name]
    with pytest.raises(tpmscad.InvalidRequest, match=text):
        tpmscad.fluid_domains(bd.Box(20, 20, 20), **(ASKED | changes))


def test_the_body_of_a_field_has_no_faces_to_open() -> None:
    options = FluidDomainsOptions("part.step", "gyroid", openings=OPENINGS)
    body = FittedBody(*[None] * 5, SimpleNamespace(name="the egg"))  # type: ignore[arg-type]
    with pytest.raises(tpmscad.InvalidRequest, match="openings are faces of a CAD body; the egg has none"):
        _resolve_openings(options, body)


def test_openings_may_share_a_face() -> None:
    body = SimpleNamespace(shape=bd.Box(1, 1, 1).solid().wrapped, name="the box")
    found = resolve_channel_openings(body, {"+": [0, 1], "-": 1})  # type: ignore[arg-type]
    assert found.plus & found.minus == {1}

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
from tpmscad.kernel.measure.shape_sampling import sample_faces
from tpmscad.kernel.occt.exploration import faces_of
from tpmscad.requests.channel_openings import resolve_channel_openings
from tpmscad.requests.lattice_options import FluidDomainsOptions
from tpmscad.requests.lattice_request import read_lattice_request
from tpmscad.results.domain_results import FluidDomains
from tpmscad.solids._fluid_domains import _resolve_openings
from tpmscad.solids.bodies.fitted_body import FittedBody
from tpmscad.solids.matter.closed_channels import _open_fraction, _sample_body, extend_distance

pytestmark = pytest.mark.kernel

SIZE = np.array([20.0, 18.0, 16.0])
SKIN = 1.5
OPENINGS = {"+": ["<X", ">X"], "-": "<Y,>Y"}
ASKED: dict[str, Any] = {"surface": "gyroid", "cell": 10, "thickness": 1, "tol": 0.1, "transition": 6}


@pytest.fixture(scope="module")
def domains() -> FluidDomains:
    return tpmscad.fluid_domains(bd.Box(*SIZE), **ASKED, skin=SKIN, openings=OPENINGS)


@pytest.mark.slow
class TestCrossFlow:
    def test_each_channel_reaches_its_own_faces_only_and_keeps_the_skin_from_others(
        self, domains: FluidDomains
    ) -> None:
        for channel, axis in ((domains.plus, 0), (domains.minus, 1)):
            points = sample_faces(faces_of(channel.solid.wrapped), 0.3).points
            depth = (SIZE / 2 - np.abs(points)).min(axis=0)
            assert depth[axis] == pytest.approx(0.0, abs=1e-9)
            assert np.delete(depth, axis).min() > SKIN - 0.1

    def test_the_channels_are_nowhere_nearer_than_the_thickness(self, domains: FluidDomains) -> None:
        plus, minus = (
            sample_faces(faces_of(each.solid.wrapped), 0.15).points for each in (domains.plus, domains.minus)
        )
        least = cKDTree(plus).query(minus)[0].min()
        assert 1.0 - 2 * 0.1 <= least <= 1.2

    def test_three_pieces_fill_the_body(self, domains: FluidDomains, tmp_path: Path) -> None:
        assert domains.certificate.met
        assert [len(model.certificate.pieces) for model in domains.domains.values()] == [1, 1, 1]
        assert domains.volume == pytest.approx(np.prod(SIZE), rel=1e-7)
        domains.export_step(tmp_path / "exchanger.step")  # which reads it back
        assert (tmp_path / "exchanger.step").read_text().count("MANIFOLD_SOLID_BREP(") == 3

    def test_openings_are_named_by_channel_and_side(self, domains: FluidDomains) -> None:
        assert domains.plus.openings == {"opening X+", "opening X-"}
        assert domains.minus.openings == {"opening Y+", "opening Y-"}


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
    "no openings": ({"openings": None}, "give openings="),
    "a skin without openings": (
        {"openings": None, "transition": None, "skin": 2},
        "skin is the wall along faces .* give openings=",
    ),
    "too short": (
        {"openings": OPENINGS, "transition": 1.0},
        r"transition 1 is too short: .* 45 degrees; give at least \d",
    ),
    "too thick": ({"openings": OPENINGS, "thickness": 3.4}, "too thick for openings"),
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

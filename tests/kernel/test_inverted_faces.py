"""A face that was read as the rest of its sphere is found, and exchanged."""

from __future__ import annotations

import pytest

pytest.importorskip("OCP")

import build123d as bd
import numpy as np

from tpmscad.errors import InvalidRequest, NotQuadric
from tpmscad.kernel.body_import import body_brep, inverted_faces
from tpmscad.kernel.body_import.body_brep import brep_from_shape
from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.kernel.measure.mass_properties import face_moments
from tpmscad.kernel.occt.exploration import faces_of

pytestmark = pytest.mark.kernel

RADIUS = 10.0


def grooved_ball(turn: float) -> bd.Solid:
    """A ball with a groove round it, turned: two caps, each with an edge across the seam or about a pole."""
    groove = bd.Box(30, 30, 4) - bd.Cylinder(6, 4)
    return (bd.Rotation(turn, 0.4 * turn, 0) * (bd.Sphere(RADIUS) - bd.Pos(0, 0, 1) * groove)).solids()[0]


def spherical_faces(solid: bd.Solid) -> list[int]:
    return [i for i, face in enumerate(faces_of(solid.wrapped)) if bd.Face(face).geom_type == bd.GeomType.SPHERE]


@pytest.mark.parametrize("turn", [0.0, 90.0, 31.0])
@pytest.mark.parametrize("which", [0, 1])
def test_a_face_taken_for_the_rest_of_its_sphere_is_exchanged(turn: float, which: int) -> None:
    ball = grooved_ball(turn)
    index = spherical_faces(ball)[which]
    (covered,) = inverted_faces._sample_faces([faces_of(ball.wrapped)[index]])
    inverted = inverted_faces._exchange_face(ball.wrapped, index, ~covered, "the ball")
    # The kernel finds nothing wrong with a ball without the grooved ball.
    assert bd.Solid(inverted).is_valid
    assert face_moments(faces_of(inverted))[:, 1].sum() == pytest.approx(
        4 / 3 * np.pi * RADIUS**3 - ball.volume, rel=1e-6
    )

    body = read_body(inverted)
    assert body.volume == pytest.approx(ball.volume, rel=1e-9)
    assert f"face {index}" in body.notes[0]
    assert len(faces_of(body.shape)) == len(faces_of(ball.wrapped))
    moments = face_moments([face for solid in [body.shape] for face in faces_of(solid)])
    assert moments[:, 1].sum() == pytest.approx(ball.volume, rel=1e-9)
    brep_from_shape(body.shape)


def test_bodies_with_two_faces_on_one_sphere_stay_as_they_are() -> None:
    ball = grooved_ball(31.0).wrapped
    same, notes = inverted_faces.exchange_inverted_faces(ball, "the ball")
    assert same is ball
    assert notes == ()


def test_a_face_of_another_area_is_named() -> None:
    ball = grooved_ball(0.0).wrapped
    brep, source = body_brep.brep_and_source_faces(ball)
    faces = faces_of(ball)
    cap, other = spherical_faces(bd.Solid(ball))
    swapped = source.copy()
    swapped[source == cap], swapped[source == other] = other, cap
    with pytest.raises(NotQuadric, match=f"face {min(cap, other)} .* has the area"):
        body_brep._check_closed_and_volume(brep, swapped, faces, 20.0, 0.0, 0.0, 0.0)
    body_brep._check_closed_and_volume(brep, source, faces, 20.0, 0.0, 0.0, 0.0)


def test_faces_that_cover_each_other_whichever_is_exchanged_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    ball = grooved_ball(0.0).wrapped
    quarter = np.arange(inverted_faces.DIRECTIONS) % 4
    covered = np.array([quarter < 2, quarter % 2 == 0])  # either, exchanged, covers a quarter of the other
    monkeypatch.setattr(inverted_faces, "_sample_faces", lambda faces: covered)
    with pytest.raises(InvalidRequest, match="cover each other"):
        inverted_faces.exchange_inverted_faces(ball, "the ball")

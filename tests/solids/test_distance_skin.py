"""Skins of CAD bodies whose inner side is a level set of the distance, where offset faces fail."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad.errors import KernelError, LevelSetError
from tpmscad.results.model import Model
from tpmscad.solids.skins import distance_skin, filled_skin

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

P: dict[str, Any] = {"surface": "P", "cell": 8, "thickness": 0.8, "tol": 0.05}
SKIN = 1.5
SIZE, RADIUS = np.array([14.0, 12.0, 11.0]), 1.5


def block() -> bd.Part:
    return bd.Box(*SIZE) - bd.Pos(1, 0, 0) * bd.Cylinder(RADIUS, 30)


def sample_depths(points: np.ndarray) -> np.ndarray:
    """The depth of points in the block, negative outside: from its planes and its bore."""
    planes = (SIZE / 2 - np.abs(points)).min(axis=1)
    return np.asarray(np.minimum(planes, np.hypot(points[:, 0] - 1, points[:, 1]) - RADIUS))


def refuse(*_: Any, **__: Any) -> Any:
    raise KernelError("offset by the skin", "refused for this test")


@pytest.fixture(scope="module")
def filled() -> Any:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(filled_skin, "erode_body", refuse)
        return tpmscad.infill(block(), **P, skin=SKIN)


def test_where_offsets_fail_the_distance_gives_the_skin(filled: Model, tmp_path: Path) -> None:
    certificate = filled.certificate
    assert certificate.met, certificate.shortfalls
    note = next(note for note in certificate.notes if note.startswith("skin of 1.5 by the distance"))
    least, greatest = (float(word) for word in note.split(": ")[1].split(" thick")[0].split(" to "))
    assert 0.98 * SKIN <= least <= greatest <= 1.6 * SKIN
    filled.export_step(tmp_path / "filled.step")  # which reads it back


def test_the_faces_of_the_body_stay_exact(filled: Model) -> None:
    flat = [face for face in filled.solid.faces() if face.geom_type == bd.GeomType.PLANE]
    round_ = [face for face in filled.solid.faces() if face.geom_type == bd.GeomType.CYLINDER]
    assert sum(face.area for face in [*flat, *round_]) == pytest.approx(block().area, rel=1e-9)


def test_the_volume_is_that_of_the_skin_and_the_wall(filled: Model) -> None:
    """The least of skins is exact; what edges add when they are rounded is told, and part of it is wall as well."""
    note = next(note for note in filled.certificate.notes if note.startswith("the cavity is "))
    less, deeper = (float(part.split()[-1]) for part in note.split(" mm3")[:2])
    points = (np.random.default_rng(6).random((200_000, 3)) - 0.5) * SIZE
    depth = sample_depths(points)
    assert deeper == pytest.approx(float(np.prod(SIZE)) * (depth > SKIN).mean(), rel=0.02)
    wall = np.abs(tpmscad.fields.normal_distance(tpmscad.fields.tpms("P", 8.0))(points[depth > SKIN])) < 0.4
    exact = float(np.prod(SIZE)) * ((depth > 0).mean() - (~wall).sum() / len(points))
    assert exact * 0.995 < filled.certificate.volume < exact * 1.05
    assert filled.certificate.volume - exact == pytest.approx(less * (~wall).mean(), rel=0.25)


def test_open_faces_need_offset_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(filled_skin, "erode_body", refuse)
    body = block()
    with pytest.raises(KernelError, match=r"refused for this test.*cannot leave out open faces"):
        tpmscad.infill(body, **P, skin=SKIN, open_faces=[body.faces().sort_by(bd.Axis.Z)[-1]])


def test_a_skin_that_leaves_nothing_is_refused_at_once() -> None:
    with pytest.raises(tpmscad.errors.InvalidRequest, match="nowhere deeper than") as caught:
        tpmscad.infill(block(), **P, skin=7.5)
    assert "also tried" not in str(caught.value)


def test_a_distance_that_is_not_fitted_leaves_the_reason_of_the_offset_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: Any) -> Any:
        raise LevelSetError("no patches for this test")

    monkeypatch.setattr(filled_skin, "erode_body", refuse)
    monkeypatch.setattr(filled_skin, "erode_by_distance", fail)
    with pytest.raises(KernelError, match=r"refused for this test.*no patches for this test"):
        tpmscad.infill(block(), **P, skin=SKIN)


def test_what_lies_between_the_samples_of_the_distance_is_no_reason_to_call_a_skin_too_thick(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """A plate .2 deeper than its skin, with samples that are .3 apart at the least."""
    monkeypatch.setattr(filled_skin, "erode_body", refuse)
    monkeypatch.setattr(distance_skin, "MAX_SAMPLES", 20_000)
    with pytest.raises(
        KernelError, match=r"refused for this test.*skin by the distance: a skin of 0\.5 leaves nothing"
    ):
        tpmscad.infill(bd.Box(18, 14, 1.4), **P, skin=0.5)

"""Bodies with free-form faces: trimmed as others are, as by the kernel's boolean."""

from __future__ import annotations

from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.solids.test_face_groups import areas_of_groups
from tpmscad import fields
from tpmscad.errors import TrimmingError
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.kernel.measure.shape_sampling import sample_solid
from tpmscad.kernel.occt.bounding_boxes import enclosing_box
from tpmscad.kernel.occt.exploration import ShapeKey, faces_of
from tpmscad.solids.matter.lattice_block import LatticeBlock

pytestmark = [pytest.mark.kernel, pytest.mark.slow]

KERNEL_TOL = 1e-7
"""Distance, in mm, below which the kernel takes points for one (Precision::Confusion)."""

P: dict[str, Any] = {"surface": "P", "cell": 10, "thickness": 1, "tol": 0.1, "phase": (0.05, 0.1, 0.15)}


def prism() -> bd.Part:
    """An extruded spline profile."""
    points = [(6.5, 0), (3, 5), (-2, 5.5), (-6.5, 1.5), (-5, -4), (1, -5)]
    return bd.extrude(bd.make_face(bd.Spline(*points, periodic=True)), 11)


def flask() -> bd.Part:
    """A spline revolved."""
    side = bd.Spline((8, 0), (9, 4), (6, 10), (4, 15))
    return bd.revolve(
        bd.Plane.XZ * bd.make_face([*bd.Polyline((4, 15), (0, 15), (0, 0), (8, 0)).edges(), side]), bd.Axis.Z
    )


def domed_block() -> bd.Part:
    """A block under a free-form face."""
    outline = bd.Polyline((-6, 0), (-6, -9), (6, -9), (6, 0)) + bd.Spline((6, 0), (2, 2), (-2, 1), (-6, 0))
    return bd.extrude(bd.Plane.XZ * bd.make_face(outline), 5.5, both=True)


def tags_of_faces(part: tpmscad.Model) -> list[str]:
    """The tag of each face of the part's boundary representation."""
    return [part.patches.tags[tag] for tag in part.patches.faces.tag.tolist()]


def test_fluid_domains_of_a_free_form_body_share_their_faces() -> None:
    body = flask()
    found = tpmscad.fluid_domains(body, **P)
    wall, plus, minus = (set(map(ShapeKey, faces_of(part.wrapped))) for part in (found.wall, found.plus, found.minus))
    assert {part.trimmed_by for part in (found.wall, found.plus, found.minus)} == {"patches"}
    assert found.certificate.met
    assert not plus & minus
    on_lattice = sum(tag.startswith("offset") for tag in tags_of_faces(found.wall))
    assert len(wall & plus) + len(wall & minus) == on_lattice > 100
    volume = check_shape(body).volume
    assert found.wall.volume + found.plus.volume + found.minus.volume == pytest.approx(volume, rel=1e-9)


def refuse_to_trim(*_: Any, **__: Any) -> None:
    raise TrimmingError("not today")


def test_it_is_the_plain_boolean_and_has_its_groups_of_faces(monkeypatch: pytest.MonkeyPatch) -> None:
    body = domed_block()
    quick = tpmscad.infill(body, **P)
    assert quick.certificate.met
    assert quick.trimmed_by == "patches"
    assert "trimmed on the patches' parameters" in quick.certificate.notes
    monkeypatch.setattr(LatticeBlock, "cut", refuse_to_trim)
    slow = tpmscad.infill(body, **P)
    assert any("boolean: not today" in note for note in slow.certificate.notes)
    # Both ways place the cuts within the kernel's tolerance.
    moved = KERNEL_TOL * slow.certificate.area
    assert quick.certificate.volume == pytest.approx(slow.certificate.volume, rel=0, abs=moved)
    assert quick.certificate.area == pytest.approx(slow.certificate.area, rel=1e-6)
    assert quick.certificate.betti == slow.certificate.betti
    one, other = areas_of_groups(quick), areas_of_groups(slow)
    assert {f"body {n}" for n in range(len(body.faces()))} < one.keys()
    assert other == pytest.approx(one, rel=1e-6)


def test_fluid_domains_split_by_the_kernel_are_those_that_are_trimmed(monkeypatch: pytest.MonkeyPatch) -> None:
    asked = P | {"phase": (0.1, 0.2, 0.3)}
    body = bd.Box(11, 10.5, 10)
    trimmed = tpmscad.fluid_domains(body, **asked)
    assert "trimmed" in trimmed.certificate.notes[0]

    def refuse(*_: Any, **options: Any) -> None:
        raise TrimmingError("not today")

    monkeypatch.setattr("tpmscad.solids._fluid_domains.divide_body", refuse)
    split = tpmscad.fluid_domains(body, **asked)
    assert "split by the kernel" in split.certificate.notes[0]
    assert split.certificate.met, split.certificate.shortfalls
    for name in ("wall", "plus", "minus"):
        one, other = getattr(trimmed, name), getattr(split, name)
        assert other.volume == pytest.approx(one.volume, rel=5e-3)  # trimming may move the lattice within tol
        assert other.certificate.betti == one.certificate.betti
    for one, other in zip(trimmed.touches, split.touches, strict=True):
        assert other.face == one.face
        assert dict(other.areas) == pytest.approx(dict(one.areas), rel=0.02, abs=0.2)


def test_points_on_lines_lie_in_the_body_evenly() -> None:
    torus = bd.Torus(9, 3.5).solid().wrapped
    points = sample_solid(torus, 4096, 8)
    assert (np.hypot(np.hypot(points[:, 0], points[:, 1]) - 9, points[:, 2]) < 3.5).all()
    low, high = enclosing_box(torus)
    share = 2 * np.pi**2 * 9 * 3.5**2 / np.prod(high - low)
    assert len(points) / (4096 * 8) == pytest.approx(share, rel=0.03)
    assert np.abs(points.mean(axis=0)).max() < 0.3


def test_a_field_in_a_free_form_body() -> None:
    field = fields.rod(fields.tpms("P", 10.0), -0.4)
    body = prism()
    model = tpmscad.infill(body, field, tol=0.1)
    within = sample_solid(body.solid().wrapped, 4096, 8)
    assert model.certificate.valid
    assert model.certificate.volume == pytest.approx((field(within) < 0).mean() * body.volume, rel=0.03)

"""Loose pieces are left out of lattices, infills and solids of fields alike, and the certificate says so in plain words."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.results.certificate import describe_topology
from tpmscad.results.model import Model

pytestmark = pytest.mark.kernel

CORNERS: dict[str, Any] = {"cell": 10, "thickness": 1, "tol": 0.1, "phase": (0, 0, 0)}
"""A gyroid sheet whose box cuts two corners off."""


@pytest.fixture(scope="module")
def whole() -> Model:
    return tpmscad.lattice("gyroid", loose="keep", **CORNERS)


@pytest.fixture(scope="module")
def dropped() -> Model:
    return tpmscad.lattice("gyroid", **CORNERS)


def test_a_lattice_by_default_is_one_piece() -> None:
    certificate = tpmscad.lattice("gyroid", cell=10, thickness=1, tol=0.1).certificate
    assert certificate.met
    assert certificate.betti[0] == len(certificate.pieces) == 1
    assert certificate.dropped == ()


def test_the_volume_left_out_is_what_is_missing(whole: Model, dropped: Model) -> None:
    assert len(whole.certificate.pieces) == 3
    assert dropped.certificate.met
    assert dropped.certificate.pieces == whole.certificate.pieces[:1]
    assert dropped.certificate.dropped == pytest.approx(whole.certificate.pieces[1:], rel=1e-12)
    assert dropped.certificate.volume == pytest.approx(whole.certificate.pieces[0], rel=1e-12)
    assert dropped.certificate.betti == (1, *whole.certificate.betti[1:])


def test_the_certificate_warns_of_pieces_apart_with_their_places(whole: Model, dropped: Model) -> None:
    (warning,) = whole.certificate.warnings
    assert warning in str(whole.certificate)
    assert "3 pieces, apart from the largest: chip of " in warning
    chips = [tuple(solid.center()) for solid in whole.solid.solids()[1:]]
    places = [[float(x) for x in text.split(",")] for text in re.findall(r"near \(([^)]+)\)", warning)]
    assert np.linalg.norm(np.subtract(places, chips), axis=1).max() < 1.0
    assert dropped.certificate.warnings == ()


def test_arrays_kernel_and_file_agree_on_what_is_left(dropped: Model, whole: Model, tmp_path: Path) -> None:
    dropped.export_step(tmp_path / "one.step")
    read = tpmscad.check_step(tmp_path / "one.step")
    assert read.ok
    assert read.shape.solids == len(dropped.solid.solids()) == 1
    assert read.shape.faces == len(dropped.patches.faces) == len(dropped.solid.faces()) < len(whole.patches.faces)
    assert read.shape.volume == pytest.approx(dropped.certificate.volume, rel=1e-9)
    used = np.unique(dropped.patches.faces.carrier)
    assert used.tolist() == list(range(len(dropped.patches.carriers)))


def test_copies_of_one_cell_would_bring_the_pieces_back_and_are_refused(dropped: Model, tmp_path: Path) -> None:
    with pytest.raises(InvalidRequest, match=r"2 loose pieces were left out.*keep"):
        dropped.export_step(tmp_path / "cells.step", instanced=True)
    assert not (tmp_path / "cells.step").exists()


def test_the_field_of_a_solid_is_compared_with_all_of_its_pieces() -> None:
    balls = fields.union(fields.sphere((5.0, 5.0, 5.0), 3.0), fields.sphere((1.0, 1.0, 1.0), 0.5))
    box = ((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))
    one, two = (tpmscad.solidify(balls, box, tol=0.02, loose=loose).certificate for loose in ("drop", "keep"))
    assert one.met, one.shortfalls
    assert two.met, two.shortfalls
    assert (one.betti[0], two.betti[0]) == (1, 2)
    assert one.volume == pytest.approx(4 / 3 * np.pi * 27, rel=3e-3)
    assert sum(one.dropped) == pytest.approx(4 / 3 * np.pi * 0.125, rel=0.05)
    assert any("1 loose piece" in note for note in one.notes)


@pytest.mark.slow
def test_an_infill_loses_its_chips_too() -> None:
    body = bd.Box(10, 10, 10).moved(bd.Location((5, 5, 5)))
    kept, left = (tpmscad.infill(body, "gyroid", **CORNERS, loose=loose) for loose in ("keep", "drop"))
    assert len(kept.certificate.pieces) == 3
    assert len(left.certificate.pieces) == len(left.solid.solids()) == 1
    assert left.certificate.volume + sum(left.certificate.dropped) == pytest.approx(kept.certificate.volume, rel=1e-4)
    assert left.certificate.met


@pytest.mark.parametrize(
    ("betti", "words"),
    [
        ((1, 54, 0), "1 piece, 54 tunnels, no closed cavity"),
        ((3, 1, 2), "3 pieces, 1 tunnel, 2 closed cavities"),
        ((1, 0, 1), "1 piece, no tunnel, 1 closed cavity"),
    ],
)
def test_betti_numbers_are_said_in_plain_words(betti: tuple[int, int, int], words: str) -> None:
    assert describe_topology(betti) == words


def test_the_summary_has_units_and_keeps_the_names_of_bounds_for_the_verbose_one(whole: Model, dropped: Model) -> None:
    short, verbose = whole.certificate.summary(), whole.certificate.summary(verbose=True)
    assert "3 pieces, " in short
    assert " mm3" in short
    assert " mm2" in short
    assert not {"Filip", "Sederberg", "CPIA"} & {word for word in ("Filip", "Sederberg", "CPIA") if word in short}
    assert "Filip" in verbose
    assert "CPIA" in verbose
    assert str(whole.certificate) == short
    assert len(repr(whole.certificate)) < 200
    assert "left out: 2 loose pieces" in str(dropped.certificate)
    assert "left out" not in short


def test_a_closed_cavity_is_a_trap_and_the_certificate_warns() -> None:
    shell = fields.sheet(fields.expression("sqrt((x - 5)^2 + (y - 5)^2 + (z - 5)^2 + 0.01)"), 2.0, 3.0)
    certificate = tpmscad.solidify(shell, ((0.0, 0.0, 0.0), (10.0, 10.0, 10.0)), tol=0.05).certificate
    assert certificate.betti == (1, 0, 1)
    assert "1 closed cavity: powder or resin stays inside" in str(certificate)

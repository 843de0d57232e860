"""Solids of fields by the kernel: valid, closed, certified, and the same after a STEP file."""

from __future__ import annotations

from pathlib import Path

import pytest

from tpmscad import fields
from tpmscad.fields.analysis.betti_numbers import compute_betti_numbers
from tpmscad.kernel.measure.shape_report import check_step
from tpmscad.solids._solidify import solidify

pytestmark = pytest.mark.kernel

CELL = ((0.0, 0.0, 0.0), (10.0, 10.0, 10.0))


@pytest.mark.parametrize(
    "field",
    [
        fields.rod(fields.tpms("gyroid", 10.0), -0.3),
        fields.sheet(fields.tpms("schwarz_p", 10.0), -0.2, 0.2),
        -fields.sphere((5.0, 5.2, 4.9), 4.0),
    ],
    ids=["rod", "sheet", "hollow"],
)
def test_the_solid_meets_its_certificate_and_survives_step(field: fields.Field, tmp_path: Path) -> None:
    model = solidify(field, CELL, tol=1e-2)
    certificate = model.certificate
    assert certificate.met, certificate.shortfalls
    assert certificate.valid
    assert certificate.betti[0] == 1 == len(certificate.pieces)
    model.export_step(tmp_path / "solid.step")
    found = check_step(tmp_path / "solid.step")
    assert found.ok
    assert found.shape.faces == certificate.n_faces
    assert found.shape.volume == pytest.approx(certificate.volume, rel=1e-9)


def test_betti_numbers_of_a_wall_thinner_than_any_grid() -> None:
    import numpy as np

    lo, hi = np.zeros(3), np.full(3, 10.0)
    phi = fields.tpms("gyroid", 10.0)
    thick = compute_betti_numbers(fields.sheet(phi, -0.3, 0.3), lo, hi)
    assert thick == (3, 4, 0)
    assert compute_betti_numbers(fields.sheet(phi, -1e-6, 1e-6), lo, hi) == thick

"""Bodies filled with cores of sandwich panels, as fields and by name."""

from __future__ import annotations

from typing import Any

import build123d as bd
import numpy as np
import pytest

import tpmscad
from tests.fields.test_cores import CELL, FRACTIONS, THICKNESS
from tpmscad import fields
from tpmscad.catalogue import CORES
from tpmscad.errors import InvalidRequest

pytestmark = pytest.mark.kernel


@pytest.mark.parametrize("structure", CORES)
def test_a_body_is_filled_with_a_core_exactly(structure: str) -> None:
    body = bd.Pos(0.3, 0.2, 0) * bd.Cylinder(8, 5)
    field = fields.rotate(fields.core(structure, CELL, THICKNESS), "z", 20)
    model = tpmscad.infill(body, field, tol=0.05, progress=False)
    certificate = model.certificate
    assert certificate.met
    assert certificate.max_deviation == 0.0
    step = 0.02
    x, y = np.meshgrid(*(np.arange(-8 + step / 2, 8, step),) * 2)
    points = np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])
    inside = (points[:, 0] ** 2 + points[:, 1] ** 2 < 64) & (field(points + np.array([0.3, 0.2, 0])) < 0)
    assert model.volume == pytest.approx(5 * step**2 * inside.sum(), rel=2e-3)


def test_a_panel_by_name_has_closed_chambers_within_its_skin() -> None:
    cells, skin = (4, 3), 0.5
    body = bd.Box(*(CELL * n for n in cells), 6)
    model = tpmscad.infill(body, "square", cell=CELL, thickness=THICKNESS, skin=skin, phase=(0.5, 0, 0), progress=False)
    assert model.certificate.met
    assert model.certificate.betti == (1, 0, 12)
    # a row of voids ends at the skin, half a cell from the middle of the last wall
    void = (6 - 2 * skin) * (CELL * cells[0] - 2 * skin - 3 * THICKNESS) * (CELL * cells[1] - 2 * skin - 2 * THICKNESS)
    assert model.volume == pytest.approx(float(body.volume) - void, rel=1e-12)
    by_fraction = tpmscad.infill(
        body, "square", cell=CELL, volume_fraction=FRACTIONS["square"], skin=skin, phase=(0.5, 0, 0), progress=False
    )
    assert by_fraction.volume == pytest.approx(model.volume, rel=1e-9)


@pytest.mark.parametrize(
    ("keywords", "what"),
    [
        ({"cell": 3.0}, "exactly one of thickness, volume_fraction, porosity: got none"),
        ({"cell": (3.0, 3.0, 4.0), "thickness": 0.3}, "needs cell=, one number"),
        ({"cell": 3.0, "thickness": "0.3 + x"}, "one number, as its walls are planes"),
        ({"cell": 3.0, "thickness": 0.3, "kind": "skeletal"}, "takes no kind"),
        ({"cell": 3.0, "thickness": 0.3, "map": lambda p: p}, "a map takes a surface of the catalogue, or struts"),
    ],
)
def test_what_a_core_by_name_does_not_take_is_refused(keywords: dict[str, Any], what: str) -> None:
    with pytest.raises(InvalidRequest, match=what):
        tpmscad.infill(bd.Box(9, 9, 3), "honeycomb", progress=False, **keywords)

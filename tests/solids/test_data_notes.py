"""What was assumed of data stands in the certificate of every solid that is made of them."""

from __future__ import annotations

import numpy as np
import pytest

import tpmscad
from tpmscad import fields
from tpmscad.blending._blend import blend
from tpmscad.fields.data.field_notes import collect_notes

pytestmark = pytest.mark.kernel

X, Y, Z = np.mgrid[0:9, 0:9, 0:9] * 0.5
DENSITY = fields.sampled(3 - np.sqrt((X - 2) ** 2 + (Y - 2) ** 2 + (Z - 2) ** 2 + 0.01), 0.5, level=1.5)
BOX = ((0.0, 0.0, 0.0), (4.0, 4.0, 4.0))


def test_of_a_solid_in_a_box_and_in_a_body() -> None:
    assert DENSITY.notes
    for domain in (BOX, fields.box((0, 0, 0), (4, 4, 2))):
        assert set(DENSITY.notes) <= set(tpmscad.solidify(DENSITY, domain, tol=0.05).certificate.notes)


def test_of_a_lattice_whose_wall_is_graded_by_data() -> None:
    thickness = fields.sampled(0.3 + 0.02 * X, 1.0, (-2, -2, -2))
    stretched = tpmscad.maps.stretching((1, 1, 0.9))
    model = tpmscad.lattice("gyroid", cell=4, thickness=thickness, map=stretched, tol=0.05)
    assert set(thickness.notes) <= set(model.certificate.notes)


def test_of_a_blend() -> None:
    halves = [fields.box((0, 0, 0), (2, 4, 4)), fields.box((2, 0, 0), (4, 4, 4))]
    rods = fields.rod(fields.tpms("gyroid", 2.0), -0.2)
    structures = [rods, fields.rod(fields.tpms("schwarz_p", 2.0), fields.sampled(0.02 * X - 0.3, 0.5))]
    made = blend(structures, halves, [fields.box((1, 0, 0), (3, 4, 4))], method="initial", resolution=(24, 24, 24))
    assert collect_notes(made.field) == collect_notes(structures[1])

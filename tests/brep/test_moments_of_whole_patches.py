"""Moments of whole patches by tensor rules against line integrals round them, and a closed form."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.brep.moments import integral_properties
from tpmscad.brep.moments.tensor_gauss import whole_moments
from tpmscad.levelset.field_solid import fit_field_solid


@pytest.mark.slow
def test_patches_in_one_piece_or_two_a_side_have_the_moments_that_line_integrals_give(monkeypatch) -> None:
    field = fields.rod(fields.tpms("iwp", 10.0), fields.ramp("x", (0, 10), (-0.3, 0.4)))
    solid = fit_field_solid(field, np.array([0.5, 0.0, 0.0]), np.array([10.5, 8.0, 9.0]), 0.02).brep
    whole, _ = whole_moments(solid)
    surface = solid.faces.tag == solid.tags.index("surface")
    assert np.array_equal(whole, surface)
    fast = integral_properties.integrate_faces(solid)
    none = np.zeros(len(whole), bool), np.zeros((len(whole), 16))
    monkeypatch.setattr(integral_properties, "whole_moments", lambda brep: none)
    slow = integral_properties.integrate_faces(solid)
    assert np.allclose(fast.area, slow.area, rtol=1e-6)  # a square root, which no rule integrates exactly
    for name in ("normal", "first", "second"):
        assert np.allclose(getattr(fast, name), getattr(slow, name), rtol=1e-12, atol=1e-9), name

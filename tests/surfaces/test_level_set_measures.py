"""Measures of surfaces without primitives: lines of a grid against the stored ones, and against mirrored pieces."""

from __future__ import annotations

import numpy as np
import pytest

from tpmscad.surfaces.curvature_integrals import LEVEL_SET_MEASURES, CellMeasures, cell_measures, measure_level_set

pytestmark = pytest.mark.slow

NODAL = [name for name, reference in LEVEL_SET_MEASURES if reference == "nodal"]


def assert_alike(lines: CellMeasures, known: CellMeasures) -> None:
    assert lines.area == pytest.approx(known.area, rel=2e-5)
    assert lines.mean_curvature_integral == pytest.approx(known.mean_curvature_integral, abs=1e-3)
    assert lines.gauss_curvature_integral == pytest.approx(known.gauss_curvature_integral, rel=1e-12)
    assert lines.fraction_below == pytest.approx(known.fraction_below, abs=3e-5)
    limits = (lines.min_offset, lines.max_offset), (known.min_offset, known.max_offset)
    np.testing.assert_allclose(*limits, rtol=1e-6)


@pytest.mark.parametrize("name", NODAL)
def test_a_surface_that_is_not_stored_is_measured_as_well_as_its_lattices_need(name: str) -> None:
    assert_alike(measure_level_set(name, "nodal"), LEVEL_SET_MEASURES[name, "nodal"])


def test_lines_and_mirrored_pieces_agree() -> None:
    """Two parametrisations of one surface: quadrature over its piece converges to round-off."""
    assert_alike(measure_level_set("neovius", "nodal"), cell_measures("neovius", "nodal"))

"""Lattices of minimal surfaces that are series: from the request to the solid, and what the certificate says of the reference."""

from __future__ import annotations

import build123d as bd
import pytest

import tpmscad
from tpmscad import surfaces
from tpmscad.minimal_series import MINIMAL_SERIES
from tpmscad.solids.matter.patch_measures import MEAN_CURVATURE

pytestmark = pytest.mark.kernel

CELL, TOL = 10.0, 0.02


def test_a_minimal_lattice_has_the_volume_of_its_own_surface_and_states_its_residual() -> None:
    model = tpmscad.lattice("iwp", cell=CELL, thickness=0.5, reference="minimal", tol=TOL, progress=False)
    certificate = model.certificate
    assert certificate.met
    assert certificate.reference == "minimal iwp surface"
    assert certificate.figures[MEAN_CURVATURE] == MINIMAL_SERIES["iwp"].mean_curvature / CELL
    volume = {
        reference: CELL**3 * surfaces.volume_fraction("iwp", reference, -0.025, 0.025)
        for reference in ("minimal", "nodal")
    }
    assert model.volume == pytest.approx(volume["minimal"], rel=1e-4)
    assert abs(volume["nodal"] - volume["minimal"]) > 0.02 * model.volume


def test_the_wall_in_a_body_is_that_of_the_minimal_surface() -> None:
    body = bd.Box(CELL, CELL, CELL, align=(bd.Align.MIN,) * 3)
    model = tpmscad.infill(body, "iwp", cell=CELL, thickness=0.5, reference="minimal", tol=TOL, progress=False)
    assert model.certificate.met
    assert model.certificate.reference == "minimal iwp surface"
    assert model.volume == pytest.approx(CELL**3 * surfaces.volume_fraction("iwp", "minimal", -0.025, 0.025), rel=1e-3)


def test_a_minimal_level_set_lattice_has_the_porosity_that_its_measures_promise() -> None:
    model = tpmscad.lattice(
        "fischer_koch_s", cell=CELL, porosity=0.8, reference="minimal", tol=TOL, loose="keep", progress=False
    )
    assert model.certificate.met
    assert model.certificate.betti[0] == 1
    assert model.certificate.reference == "minimal fischer_koch_s surface"
    assert model.volume == pytest.approx(200.0, rel=1e-4)  # the area of the surface enters as a constant
    assert model.certificate.figures[MEAN_CURVATURE] == MINIMAL_SERIES["fischer_koch_s"].mean_curvature / CELL


def test_an_exact_surface_has_no_residual_to_state() -> None:
    model = tpmscad.lattice("schwarz_p", cell=CELL, thickness=1.0, tol=0.1, progress=False)
    assert MEAN_CURVATURE not in model.certificate.figures

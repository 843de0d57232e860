"""Solids of two networks that cut each other: valid by the kernel's full check, with its volume, and back from a STEP file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("OCP")

import tpmscad
from tpmscad import fields
from tpmscad.errors import InvalidRequest
from tpmscad.kernel.boolean.boolean_operations import OcctSolids
from tpmscad.kernel.measure.shape_report import check_shape, is_valid
from tpmscad.results.model import Model
from tpmscad.solids.combined_models import combine_models
from tpmscad.trimming.network_boolean import KEPT_PARTS

pytestmark = [pytest.mark.kernel, pytest.mark.slow]


@pytest.fixture(scope="module")
def operands() -> tuple[Model, Model]:
    gyroid = tpmscad.lattice("gyroid", cell=10, thickness=1, phase=(0, 0, 0))  # where the nodal field is
    spheres = fields.smooth_union(fields.sphere((3.1, 4.2, 5.3), 2.7), fields.sphere((6.4, 5.1, 4.6), 2.9), 0.8)
    return gyroid, tpmscad.solidify(spheres, ((-1, -1, -1), (11, 11, 11)), tol=0.02)


def test_a_lattice_and_a_field_solid_combine_to_valid_solids(operands: tuple[Model, Model], tmp_path: Path) -> None:
    first, second = operands
    made = {operation: combine_models(first, second, operation) for operation in KEPT_PARTS}
    for operation, model in made.items():
        assert model.certificate.met, (operation, model.certificate.shortfalls)
        assert is_valid(model.wrapped)
        report = check_shape(model.wrapped)
        assert report.closed
        assert report.volume == pytest.approx(model.volume, rel=1e-6)
        assert model.certificate.gap <= 1e-7
        assert model.certificate.notes == ()
    total = first.volume + second.volume
    assert made["union"].volume + made["intersection"].volume == pytest.approx(total, rel=1e-9)
    assert made["difference"].volume + made["intersection"].volume == pytest.approx(first.volume, rel=1e-9)
    path = tmp_path / "difference.step"
    made["difference"].export_step(path)
    assert tpmscad.check_step(path).shape.volume == pytest.approx(made["difference"].volume, rel=1e-6)


def test_the_volume_is_that_of_a_sample_of_both_fields(operands: tuple[Model, Model]) -> None:
    """Points told by the fields alone: the sample's error is 1 %, the nodal wall's volume is 0.2 % off."""
    spheres = fields.smooth_union(fields.sphere((3.1, 4.2, 5.3), 2.7), fields.sphere((6.4, 5.1, 4.6), 2.9), 0.8)
    wall = fields.wall(fields.tpms("gyroid", 10.0), 1.0)
    points = np.random.default_rng(3).uniform(0.0, 10.0, (200_000, 3))
    points = points[spheres(points) < 0]
    share = 1000.0 / 200_000 * np.count_nonzero(wall(points) < 0)
    assert combine_models(*operands, "intersection").volume == pytest.approx(share, rel=0.025)


def test_a_model_that_the_kernel_made_is_refused(operands: tuple[Model, Model]) -> None:
    kernel_made = replace(operands[1], built=OcctSolids((operands[1].wrapped,)))
    with pytest.raises(InvalidRequest, match="made by the kernel"):
        combine_models(operands[0], kernel_made, "union")

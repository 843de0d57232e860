"""Solids of two networks that cut each other: valid by the kernel's full check, with its volume, and back from a STEP file."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("OCP")

import tpmscad
from tpmscad import fields
from tpmscad.kernel.build.solids import BrepSolids
from tpmscad.kernel.measure.shape_report import check_shape
from tpmscad.results.model import Model
from tpmscad.solids.cut import build_valid_solids
from tpmscad.trimming.network_boolean import KEPT_PARTS, Operation, combine_networks

pytestmark = [pytest.mark.kernel, pytest.mark.slow]


def combine(first: Model, second: Model, operation: Operation) -> BrepSolids:
    result = combine_networks(first.patches, second.patches, operation, build=build_valid_solids, may_move=False)
    assert isinstance(result.built, BrepSolids)
    return result.built


def test_a_lattice_and_a_field_solid_combine_to_valid_solids(tmp_path: Path) -> None:
    phase = (0.2, 0.3, 0.1)
    first = tpmscad.lattice("schwarz_p", cell=10, thickness=1, phase=phase, tol=0.1)
    spheres = fields.smooth_union(fields.sphere((3.1, 4.2, 5.3), 2.7), fields.sphere((6.4, 5.1, 4.6), 2.9), 0.8)
    second = tpmscad.solidify(spheres, ((-1, -1, -1), (11, 11, 11)), tol=0.02)
    made = {operation: combine(first, second, operation) for operation in KEPT_PARTS}
    volumes = {}
    for operation, built in made.items():
        report = check_shape(built.shape)
        assert report.ok
        volumes[operation] = float(built.nesting.volume.sum())
        assert report.volume == pytest.approx(volumes[operation], rel=1e-6)
        assert built.brep.edges.deviation.max() <= 1e-7
    assert volumes["union"] + volumes["intersection"] == pytest.approx(first.volume + second.volume, rel=1e-9)
    assert volumes["difference"] + volumes["intersection"] == pytest.approx(first.volume, rel=1e-9)
    tpmscad.export_step(made["difference"].solid, tmp_path / "difference.step")  # which reads it back

    # points told by the fields alone: the sample's error is 1 %, the nodal wall's volume is 0.2 % off
    wall = fields.wall(fields.tpms("schwarz_p", 10.0, phase), 1.0)
    points = np.random.default_rng(3).uniform(0.0, 10.0, (200_000, 3))
    points = points[spheres(points) < 0]
    share = 1000.0 / 200_000 * np.count_nonzero(wall(points) < 0)
    assert volumes["intersection"] == pytest.approx(share, rel=0.025)

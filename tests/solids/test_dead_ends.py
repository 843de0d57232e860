"""Pieces of channels that the body cuts off become wall: volumes and areas move to it, and all else stays."""

from __future__ import annotations

from dataclasses import replace

import build123d as bd
import numpy as np
import pytest

from tpmscad.kernel.body_import.cad_body import read_body
from tpmscad.requests.lattice_request import read_lattice_request
from tpmscad.results.domain_results import MINUS, PLUS, WALL
from tpmscad.solids._fluid_domains import _trim_domains
from tpmscad.solids.bodies.kernel_body import KernelBody
from tpmscad.solids.matter.lattice_block import build_lattice_block
from tpmscad.stage_timer import StageTimer

pytestmark = pytest.mark.kernel


def test_the_wall_takes_in_the_chips_of_channels_that_close() -> None:
    body = KernelBody(read_body(bd.Box(12, 10, 9)))
    request = read_lattice_request("gyroid", cell=10, thickness=1, tol=0.1, phase=(0.4, 0.15, 0.2))
    block = build_lattice_block(request, np.eye(3), body.cad, StageTimer(False))
    opened, closing = (_trim_domains(replace(block, closes_channels=closes), body) for closes in (False, True))
    volumes = {name: opened[name].built.nesting.volume for name in opened}
    greatest, chip = volumes[PLUS]
    assert 0.0 < chip < 0.01 * greatest
    found = {name: closing[name].built.nesting.volume for name in closing}
    np.testing.assert_allclose(found[PLUS], [greatest], rtol=1e-12)
    np.testing.assert_allclose(found[MINUS], volumes[MINUS], rtol=1e-12)
    np.testing.assert_allclose(found[WALL], volumes[WALL] + chip, rtol=1e-9)
    assert closing[WALL].built.solid.is_valid
    assert sum(found[name].sum() for name in found) == pytest.approx(12 * 10 * 9, rel=1e-9)
    for face in range(6):
        areas = [sum(domains[name].areas[face] for name in domains) for domains in (opened, closing)]
        assert areas[1] == pytest.approx(areas[0], rel=1e-9)
        assert closing[PLUS].areas[face] <= opened[PLUS].areas[face] + 1e-9
    assert "a dead end of the channels, of up to 0.00345 mm3, that the body cuts off became wall" in closing[WALL].notes

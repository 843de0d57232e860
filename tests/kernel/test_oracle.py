"""The kernel's own constructions agree with tpmscad's where both can be had."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from tests.kernel import occt_oracle
from tests.shapes.kernel_shapes import CASES, drilled_dome, plane_box
from tests.shapes.misfits import volume
from tpmscad.brep import connectivity
from tpmscad.brep.boundary_representation import select_faces
from tpmscad.kernel.build.solids import build_faces, build_solids
from tpmscad.kernel.measure.shape_report import check_shape


@pytest.mark.parametrize("case", ["box of planes", "bent cube", "drilled dome", "mirrored box"])
def test_sewing_finds_the_solid_that_shared_edges_give(case: str) -> None:
    brep = CASES[case]()
    assert connectivity.is_closed(brep)
    lone = [
        build_faces(select_faces(brep, np.array([face])))[0] for face in range(len(brep.faces))
    ]  # nothing is shared
    (solid,) = occt_oracle.sew_solids(lone, 1e-6)
    report = check_shape(solid)
    assert report.closed
    assert abs(report.volume) == pytest.approx(volume(brep), rel=1e-12)


def test_the_kernels_boolean_cuts_a_built_solid() -> None:
    solid = build_solids(drilled_dome()).shape
    lower = check_shape(occt_oracle.intersect_with_box(solid, np.array([-1.0, -1.0, -1.0]), np.array([3.0, 4.0, 1.0])))
    box = check_shape(occt_oracle.intersect_with_box(build_solids(plane_box()).shape, np.zeros(3), np.ones(3)))
    assert box.volume == pytest.approx(1.0)
    assert lower.ok
    assert 6.0 - lower.volume == pytest.approx(0.6 * 0.6 * np.pi, rel=1e-3)  # a drilled near-ellipse of semi-axes 0.6

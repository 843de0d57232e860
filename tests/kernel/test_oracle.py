"""The kernel's own constructions agree with tpmscad's where both can be had."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.kernel

from kernel_shapes import CASES, drilled_dome, plane_box  # noqa: E402

from tpmscad import kernel  # noqa: E402
from tpmscad.kernel import oracle  # noqa: E402
from tpmscad.kernel.build import topods_faces  # noqa: E402
from tpmscad.patches import connectivity, measure  # noqa: E402
from tpmscad.patches.complex import Faces, PatchComplex, Uses  # noqa: E402


def lone_faces(complex: PatchComplex):
    """Each face built by itself, so that nothing is shared."""
    f, u = complex.faces, complex.uses
    for i in range(len(f)):
        loops = slice(f.loop_start[i], f.loop_start[i + 1] + 1)
        starts = f.use_start[loops]
        uses = slice(starts[0], starts[-1])
        one = slice(i, i + 1)
        faces = Faces(f.carrier[one], f.rotation[one], f.translation[one], f.sense[one], f.tag[one],
                      np.array([0, len(starts) - 1]), starts - starts[0])  # fmt: skip
        part = {"faces": faces, "uses": Uses(u.edge[uses], u.sense[uses], u.pcurve[uses])}
        yield topods_faces(PatchComplex(*[part.get(n, getattr(complex, n)) for n in PatchComplex.__slots__]))[0]


@pytest.mark.parametrize("case", ["box of planes", "bent cube", "drilled dome", "mirrored box"])
def test_sewing_finds_the_solid_that_shared_edges_give(case: str) -> None:
    complex = CASES[case]()
    assert connectivity.is_closed(complex)
    (solid,) = oracle.sewn(lone_faces(complex), 1e-6)
    report = kernel.check_shape(solid)
    assert report.closed
    assert abs(report.volume) == pytest.approx(measure.volume(measure.face_moments(complex))[0], rel=1e-12)


def test_the_kernels_boolean_cuts_a_built_solid() -> None:
    solid = kernel.build(drilled_dome()).shape
    lower = kernel.check_shape(oracle.common_with_box(solid, np.array([-1.0, -1.0, -1.0]), np.array([3.0, 4.0, 1.0])))
    box = kernel.check_shape(oracle.common_with_box(kernel.build(plane_box()).shape, np.zeros(3), np.ones(3)))
    assert box.volume == pytest.approx(1.0)
    assert lower.ok
    assert 6.0 - lower.volume == pytest.approx(0.6 * 0.6 * np.pi, rel=1e-3)  # a drilled near-ellipse of semi-axes 0.6

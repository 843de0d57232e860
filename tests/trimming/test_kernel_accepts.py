"""The kernel's own checks on trimmed lattices: valid, closed, the same volume."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from tpmscad.patches import measure
from tpmscad.patches.complex import PatchComplex
from tpmscad.trimming import trim_box

pytestmark = pytest.mark.kernel
kernel = pytest.importorskip("tpmscad.kernel")


@pytest.mark.parametrize("name", ["gyroid", "diamond", "schwarz_p"])
@pytest.mark.parametrize("layers", [(-0.05, 0.05), (None, 0.0)])
@pytest.mark.parametrize("phase", [(0.0, 0.0, 0.0), (0.11, 0.23, 0.37), (0.125 + 1.5e-8, 0.25, 0.0)])
def test_a_trimmed_cell_is_a_valid_solid_of_the_same_volume(
    name: str,
    layers: tuple[float | None, float | None],
    phase: tuple[float, float, float],
    cover: Callable[..., PatchComplex],
) -> None:
    trimmed = trim_box(cover(name, (1, 1, 1), phase, layers), np.zeros(3), np.full(3, 10.0))
    found = kernel.check_shape(kernel.build(trimmed).shape)
    assert found.valid
    assert found.volume == pytest.approx(float(measure.volume(measure.face_moments(trimmed))[0]), rel=1e-7)

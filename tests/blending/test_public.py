"""tpmscad.blend is the function of tpmscad.blending, where its weight specifications are."""

from __future__ import annotations

import numpy as np

import tpmscad
import tpmscad.blending
from tpmscad import fields
from tpmscad.blending._blend import blend


def test_the_public_function_is_that_of_the_room() -> None:
    structures = [fields.rod(fields.tpms(name, 10.0), level) for name, level in (("schwarz_p", -0.4), ("iwp", -1.0))]
    regions = [fields.box((0, 0, 0), (8, 10, 10)), fields.box((14, 0, 0), (22, 10, 10))]
    middle = [fields.box((8, 0, 0), (14, 10, 10))]
    called, direct = (f(structures, regions, middle, resolution=(33, 15, 15)) for f in (tpmscad.blend, blend))
    points = np.random.default_rng(0).random((50, 3)) * [22, 10, 10]
    np.testing.assert_array_equal(called.field(points), direct.field(points))
    assert tpmscad.blend is tpmscad.blending.blend is blend
    assert all(hasattr(tpmscad.blending, name) for name in tpmscad.blending.__all__)

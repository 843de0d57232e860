"""Points spread evenly over a solid, along lines that the kernel cuts at its faces: many points for one call."""

from __future__ import annotations

import numpy as np
from OCP.gp import gp_Dir, gp_Lin
from OCP.IntCurvesFace import IntCurvesFace_ShapeIntersector
from OCP.TopoDS import TopoDS_Solid
from scipy.stats import qmc

from tpmscad.kernel import convert
from tpmscad.kernel.body import bounds_of
from tpmscad.kernel.build import TOLERANCE
from tpmscad.patches.complex import Array


def points_within(solid: TopoDS_Solid, lines: int, each: int) -> Array:
    """Points in the solid (n, 3): of `lines` lines along the longest side of its box, `each` at random on that side's length.

    A line that meets the faces an odd number of times grazes an edge, and is left out.
    """
    low, high = bounds_of(solid)
    along = int(np.argmax(high - low))
    length = high[along] - low[along]
    starts = low + (high - low) * np.insert(
        qmc.Sobol(2, seed=np.random.default_rng(1)).random(lines), along, 0.0, axis=1
    )
    rng = np.random.default_rng(2)
    shooter = IntCurvesFace_ShapeIntersector()
    shooter.Load(solid, TOLERANCE)
    way = gp_Dir(*np.eye(3)[along].tolist())
    found = [np.zeros((0, 3))]
    for start in starts:
        shooter.Perform(gp_Lin(convert.point(start), way), -length, 2.0 * length)
        hits = np.sort([shooter.WParameter(i + 1) for i in range(shooter.NbPnt())])
        hits = hits[np.diff(hits, prepend=-np.inf) > TOLERANCE]
        if len(hits) % 2:
            continue
        t = length * rng.random(each)
        t = t[np.searchsorted(hits, t) % 2 == 1]
        found.append(start + t[:, None] * np.eye(3)[along])
    return np.concatenate(found)

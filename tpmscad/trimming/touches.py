"""Sides of patches that a face of the body touches, without crossing them there.

The topology is as if they kept apart. But the cut beside the side comes within the kernel's tolerance of it, and kernels take
that for a loop that crosses itself: the walls of holes that touch mirror planes of the lattice do it.
"""

from __future__ import annotations

from collections.abc import Sequence

from tpmscad.splines.bspline import Curve
from tpmscad.trimming.body import Body
from tpmscad.trimming.regions import Region
from tpmscad.trimming.strands import Crossings, Strands, points_on
from tpmscad.trimming.tool import TrimmingError


def check_touches(
    curves: Sequence[Curve], strands: Strands, crossings: Crossings, body: Body, faces: Sequence[Region]
) -> None:
    """TrimmingError where an edge of the lattice touches a face of the body."""
    points = points_on(curves, strands, crossings.touch_strand, crossings.touch)
    for f, region in enumerate(faces):
        at = points[crossings.touch_surface == body.surface[f]]
        at = at[region.contains(at)] if len(at) else at
        if len(at):
            raise TrimmingError(f"a face of the body touches a patch's side at {at[0].round(6)}")

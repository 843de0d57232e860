"""Solids of the primitive regions of fields: a box, a ball and a cylinder with ends, as exact shapes of the kernel."""

from __future__ import annotations

import numpy as np
from OCP.BRepPrimAPI import BRepPrimAPI_MakeBox, BRepPrimAPI_MakeCylinder, BRepPrimAPI_MakeSphere
from OCP.gp import gp_Ax2, gp_Dir, gp_Pnt
from OCP.TopoDS import TopoDS_Shape

from tpmscad.errors import InvalidRequest
from tpmscad.fields.kinds.primitive_regions import BoxRegion, CylinderRegion, SphereRegion

PrimitiveRegion = BoxRegion | SphereRegion | CylinderRegion
"""Regions of `tpmscad.fields` that stand for the solids they describe."""


def make_region_solid(region: PrimitiveRegion) -> TopoDS_Shape:
    """The solid of a finite primitive region; InvalidRequest if the region is infinite."""
    if isinstance(region, BoxRegion):
        if not np.isfinite([region.lo, region.hi]).all():
            raise InvalidRequest(f"the box from {list(region.lo)} to {list(region.hi)} is infinite: give every corner")
        return BRepPrimAPI_MakeBox(gp_Pnt(*region.lo), gp_Pnt(*region.hi)).Solid()
    if isinstance(region, SphereRegion):
        return BRepPrimAPI_MakeSphere(gp_Pnt(*region.center), region.radius).Solid()
    if region.height is None:
        raise InvalidRequest("the cylinder has no ends: give its height")
    foot = np.subtract(region.center, np.multiply(region.axis, region.height / 2))
    axes = gp_Ax2(gp_Pnt(*foot.tolist()), gp_Dir(*region.axis))
    return BRepPrimAPI_MakeCylinder(axes, region.radius, region.height).Solid()

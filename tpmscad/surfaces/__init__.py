"""Exact triply periodic minimal surfaces and their nodal namesakes, in the unit cubic cell."""

from tpmscad.surfaces.catalogue import CATALOGUE, SurfaceInfo, find
from tpmscad.surfaces.jet import Jet
from tpmscad.surfaces.patch import MARGIN, SurfacePatch, patch
from tpmscad.surfaces.symmetry import PatchSymmetry, symmetry
from tpmscad.surfaces.volume import (
    area,
    offsets_for,
    skeletal_offset_for,
    skeletal_volume_fraction,
    thickness_for,
    volume_fraction,
)

__all__ = [
    "CATALOGUE",
    "MARGIN",
    "Jet",
    "PatchSymmetry",
    "SurfaceInfo",
    "SurfacePatch",
    "area",
    "find",
    "offsets_for",
    "patch",
    "skeletal_offset_for",
    "skeletal_volume_fraction",
    "symmetry",
    "thickness_for",
    "volume_fraction",
]

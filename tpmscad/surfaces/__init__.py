"""Exact triply periodic minimal surfaces and their nodal namesakes, in the unit cubic cell."""

from tpmscad.surfaces.catalogue import CATALOGUE, SurfaceInfo, check_reference, find
from tpmscad.surfaces.jet import Jet
from tpmscad.surfaces.mirrors import MirrorSymmetry, has_mirrors, mirror_symmetry
from tpmscad.surfaces.patch import MARGIN, SurfacePatch, patch
from tpmscad.surfaces.symmetry import PatchSymmetry, symmetry
from tpmscad.surfaces.volume import (
    area,
    measures,
    offsets_for,
    skeletal_offset_for,
    skeletal_volume_fraction,
    thickness_for,
    volume_fraction,
    within_reach,
)


def motions(name: str) -> PatchSymmetry | MirrorSymmetry:
    """What the lattice of a catalogued surface is copied by: proper motions of its patch, or reflections of its piece."""
    return mirror_symmetry(name) if has_mirrors(name) else symmetry(name)


__all__ = [
    "CATALOGUE",
    "MARGIN",
    "Jet",
    "MirrorSymmetry",
    "PatchSymmetry",
    "SurfaceInfo",
    "SurfacePatch",
    "area",
    "check_reference",
    "find",
    "has_mirrors",
    "measures",
    "mirror_symmetry",
    "motions",
    "offsets_for",
    "patch",
    "skeletal_offset_for",
    "skeletal_volume_fraction",
    "symmetry",
    "thickness_for",
    "volume_fraction",
    "within_reach",
]

"""The choice of a source: a catalogued surface is made in one of three ways.

Its patches are copies of an exact primitive patch, reflections of a piece between mirrors, or fitted to one period of its
level set. The sources hide the difference; `lattice_source` is the only function that chooses.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

from tpmscad import surfaces
from tpmscad._typing import triple
from tpmscad.sources.exact_sources import CopiedPrimitive, ReflectedPieces
from tpmscad.sources.lattice_source import LatticeSource
from tpmscad.sources.level_set_source import LevelSetSource
from tpmscad.surfaces import MirrorSymmetry

CACHE_SIZE = 64
"""Sources kept: those of the catalogue with a few cells each."""


@lru_cache(maxsize=CACHE_SIZE)
def lattice_source(
    name: str,
    reference: str,
    cell: tuple[float, float, float] = (1.0, 1.0, 1.0),
    levels: tuple[float, float] | None = None,
) -> LatticeSource[Any]:
    """The source of lattices of a catalogued surface, by its name and reference ("minimal" or "nodal").

    `cell` holds the edges of the cell, `levels` the levels of the two sides of a wall if they are no offsets.
    """
    if surfaces.find_surface(name).primitives == "level set":
        return LevelSetSource(name, triple(edge / cell[0] for edge in cell), levels, reference)
    symmetry = surfaces.surface_symmetry(name, reference)
    if isinstance(symmetry, MirrorSymmetry):
        return ReflectedPieces(name, reference, symmetry)
    return CopiedPrimitive(name, reference, symmetry)

"""The lattice around a body: every patch that a box needs, in place and turned, as the body's coordinates have it.

Lattice coordinates x are those of `tpmscad.lattice`; the body's are R x, R the rotation: the lattice is anchored at the body's
origin and turned about it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from math import ceil, floor

import numpy as np

from tpmscad import surfaces
from tpmscad.errors import InvalidRequest
from tpmscad.patches import lattice as lattices
from tpmscad.patches import mapped as mappings
from tpmscad.patches.complex import Array, PatchComplex, scaled
from tpmscad.patches.deviation import Deviation
from tpmscad.patches.maps import stretched
from tpmscad.patches.primitive import fit_sheet
from tpmscad.request import LatticeRequest

MARGIN = 0.1237
"""Cells by which a block reaches beyond the body's box: no plane of it then lies in a symmetry plane that the body lies in."""

MOST_CELLS = 100_000
"""Cells that a body's box may span: a hundred patches each, beyond which memory ends."""


@dataclass(frozen=True, slots=True, eq=False)
class Cover:
    """Whole patches that cover the box from low to high, all in lattice coordinates: open, ragged outside; the fit's figures."""

    patches: PatchComplex
    low: Array
    high: Array
    deviation: Deviation
    bounds: Mapping[str, float]


def cover(request: LatticeRequest, low: Array, high: Array, progress: Callable[[float], None]) -> Cover:
    """The offset surfaces over the box from low to high (lattice coordinates, model units) and a margin around it."""
    edge = np.array(request.cell)
    low, high = low - MARGIN * edge, high + MARGIN * edge
    first, last = np.array([floor(v) for v in low / edge]), np.array([ceil(v) for v in high / edge])
    counts = last - first
    if np.prod(counts.astype(float)) > MOST_CELLS:
        raise InvalidRequest(
            f"the body's box spans {' x '.join(map(str, counts))} cells of {edge.tolist()}, more than {MOST_CELLS}: "
            "enlarge the cell, or cut the body"
        )
    cells, phase = (int(counts[0]), int(counts[1]), int(counts[2])), np.array(request.phase)
    if len(set(request.cell)) == 1:
        cell = request.cell[0]
        fit = fit_sheet(request.surface, request.reference, request.layers, cell, request.tol)
        patches = scaled(lattices.covering(surfaces.motions(request.surface), fit.sheet, cells, phase), cell)
        deviation, bounds = fit.deviation, fit.bounds
    else:
        patches, deviation = _stretched(request, cells, phase, progress)
        bounds = {}
    return Cover(moved(patches, np.eye(3), first * edge), low, high, deviation, bounds)


def moved(patches: PatchComplex, rotation: Array, shift: Array) -> PatchComplex:
    """The complex at R x + t."""
    edges, faces = patches.edges, patches.faces
    return replace(
        patches,
        vertices=patches.vertices @ rotation.T + shift,
        edges=replace(edges, rotation=rotation @ edges.rotation, translation=edges.translation @ rotation.T + shift),
        faces=replace(faces, rotation=rotation @ faces.rotation, translation=faces.translation @ rotation.T + shift),
    )


def _stretched(
    request: LatticeRequest, cells: tuple[int, int, int], phase: Array, progress: Callable[[float], None]
) -> tuple[PatchComplex, Deviation]:
    """Patches of a lattice whose cell has unequal edges, fitted class by class."""
    cell, name = request.cell[0], request.surface
    bend = stretched(tuple(edge / cell for edge in request.cell))
    patch, symmetry = surfaces.patch(name, request.reference), surfaces.symmetry(name)
    box = np.zeros(3), np.array(cells) * np.array(request.cell)
    reach = float(np.abs(request.offset).max())
    placements = mappings.reaching(patch, symmetry, bend, box, cells, phase, cell, reach)
    surface = mappings.MappedSurface(patch, symmetry, placements, bend, cell)
    mappings.within_curvature(surface, request.offset, f"stretched {name}")
    lower, upper, deviation = mappings.fit_layers(surface, request.layers, request.tol, progress)
    return mappings.assemble(surface, lower, upper, natural=False), deviation

"""Distance of points from the surface that a result was made from, for pictures of the deviation.

For an exact surface it is the difference between the signed distance from the mid surface, along the common normal, and the
offset asked for. Foot points on the mid surface are orthogonal projections on the nearest copy of its primitive patch; a surface
without a patch in closed form is a level set, with the normal distance of its field. For a field it is |f| / |grad f|, as the fit
measures it.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from tpmscad import fields
from tpmscad._typing import Array
from tpmscad.fields.field import Field, as_field
from tpmscad.fields.kinds.normal_distance import NormalDistance
from tpmscad.lattices.coordinate_maps import Map
from tpmscad.lattices.mapped_surface import grading
from tpmscad.requests.lattice_request import LatticeRequest
from tpmscad.sources.patched_surface import PatchedSurface

DistanceFunction = Callable[[Array], Array]
"""Points (n, 3), model units, to distances (n,)."""


def lattice_distance(request: LatticeRequest, mapping: Map | None, rotation: Array | None = None) -> DistanceFunction:
    """The distance of points from the offset surfaces of a lattice.

    mapping: the map of a mapped lattice, from cubic lattice coordinates to the model; None for one that repeats its cell.
    rotation (3, 3): from lattice coordinates to those of the points.
    """
    return partial(_measure_from_lattice, request, mapping, rotation)


def _measure_from_lattice(request: LatticeRequest, mapping: Map | None, rotation: Array | None, points: Array) -> Array:
    """The distance (n,) of points (n, 3) from the offset surfaces of a lattice."""
    edges, phase = np.array(request.cell), np.array(request.phase)
    offsets = np.array([d for d in request.layer_offsets if d is not None])
    local = points if rotation is None else points @ rotation
    if mapping is None:  # every cell is like the first
        local = edges * np.mod(local / edges - phase, 1.0)
    if request.levels is not None:
        phi = fields.tpms(request.surface, request.cell, reference=request.reference)
        each = [NormalDistance(phi - level)(local) for level in request.levels]
        return np.asarray(np.abs(each).min(axis=0))
    mid_surface = request.source.mid_surface(request.cell, request.cells, phase, mapping)
    if not isinstance(mid_surface, PatchedSurface):
        return np.asarray(np.abs(mid_surface(local)[:, None] - offsets).min(axis=1))
    # of a graded wall along the normal, which is exact to first order in its slope
    distance, foot = mid_surface.distance_and_foot(local)
    foot = foot - local if rotation is None else (foot - local) @ rotation.T
    unit, centre = grading(request.thickness, request.centre, points + foot)
    return np.asarray(np.abs((distance - centre)[:, None] - offsets * unit[:, None]).min(axis=1))


def field_distance(field: Any) -> DistanceFunction:
    """The distance of points from the level set {field = 0}, to first order in it."""
    return partial(_measure_from_level_set, as_field(field))


def _measure_from_level_set(reference: Field, points: Array) -> Array:
    """The distance (n,) of points (n, 3) from a level set, to first order in it."""
    return np.abs(reference(points)) / np.linalg.norm(reference.gradient(points), axis=1)

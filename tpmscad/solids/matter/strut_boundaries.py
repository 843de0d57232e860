"""The boundary of a field of struts, exactly, for the combinations of `combined_solids`."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from scipy.spatial import cKDTree

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, TrimmingError, format_point
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.lattices.strut_brep import build_strut_brep
from tpmscad.lattices.strut_contacts import DIAMETER_DIGITS, find_contact

OUTSIDE_RTOL = 1e-9
"""In sizes of the box: how far vertices of struts that its sides have cut may lie outside it."""

MAX_SETS = 12
"""Sets of struts of one diameter each that are cut by each other."""


def require_struts_apart(field: StrutsField) -> None:
    """InvalidRequest if struts touch outside their common nodes; it names the place, and a diameter at which they do not."""
    contact = find_contact(field.points, field.edges, field.radius, field.node_radius)
    if contact is None or contact.ratio > 1:
        return
    place = format_point(contact.place, 5)
    if contact.distance <= 1e-9 * contact.needed:
        raise InvalidRequest(f"{contact.what} near {place}: their axes meet, so join them by a node there")
    largest = 2 * field.radius * contact.ratio * (1 - DIAMETER_DIGITS)
    remedy = f"a diameter of at most {largest:.4g}"
    if field.node_radius > field.radius:
        remedy = f"a node_radius below {field.node_radius:g}, or both {1 / contact.ratio:.4g} times smaller"
    raise InvalidRequest(
        f"{contact.what} near {place}: there is {contact.distance:.4g} for {contact.needed:.4g} that a diameter of "
        f"{2 * field.radius:g} needs. Give {remedy}, or leave short struts out of the graph"
    )


def require_few_strut_sets(sets: Sequence[StrutsField]) -> None:
    """InvalidRequest for more sets of struts than are cut by each other, or for balls that are of two sets."""
    if len(sets) > MAX_SETS:
        low, high = (2 * f(each.radius for each in sets) for f in (min, max))
        raise InvalidRequest(
            f"{len(sets)} sets of struts, of diameters from {low:g} to {high:g}, are too many: those of each diameter are cut by "
            f"all others, for {MAX_SETS} at most. Round the diameters to fewer values"
        )
    balled = [each for each in sets if each.node_radius > each.radius]
    for first, second in combinations(balled, 2):
        if first.node_radius != second.node_radius:
            continue
        distance, _ = cKDTree(first.points).query(second.points)
        if distance.min() <= OUTSIDE_RTOL * first.node_radius:
            place = format_point(second.points[int(np.argmin(distance))], 5)
            raise InvalidRequest(
                f"struts of diameters {2 * first.radius:g} and {2 * second.radius:g} have the same ball of radius "
                f"{first.node_radius:g} near {place}: solids of struts of several diameters have no balls; leave node_radius out"
            )


def bound_struts(field: StrutsField) -> Brep:
    """The boundary of the struts, free ends included."""
    return build_strut_brep(field.points, field.edges, field.radius, field.node_radius)


def bound_struts_in_box(field: StrutsField, lo: Array, hi: Array) -> Brep:
    """The boundary of the part of struts in a box; TrimmingError unless nodes lie in its sides or keep clear of them."""
    size = float((hi - lo).max())
    depth = np.concatenate([field.points - lo, hi - field.points], axis=1)
    on_side = np.abs(depth) <= OUTSIDE_RTOL * size
    if not (on_side | (depth >= field.node_radius * (1 - OUTSIDE_RTOL))).all():
        raise TrimmingError("nodes lie near sides of the box, not in them")
    contact = find_contact(field.points, field.edges, field.radius, field.node_radius, (lo, hi))
    if contact is not None and contact.ratio <= 1:
        raise TrimmingError(f"{contact.what} in a side of the box near {format_point(contact.place, 5)}")
    brep = build_strut_brep(field.points, field.edges, field.radius, field.node_radius, (lo, hi))
    if (brep.vertices < lo - OUTSIDE_RTOL * size).any() or (brep.vertices > hi + OUTSIDE_RTOL * size).any():
        raise TrimmingError("a joint reaches through a side of the box that its node does not lie in")
    return brep

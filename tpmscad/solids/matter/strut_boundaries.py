"""The boundary of a field of struts, exactly, for the combinations of `combined_solids`."""

from __future__ import annotations

import numpy as np

from tpmscad._typing import Array
from tpmscad.brep.boundary_representation import Brep
from tpmscad.errors import InvalidRequest, TrimmingError, format_point
from tpmscad.fields.kinds.strut_graphs import StrutsField
from tpmscad.lattices.strut_brep import build_strut_brep
from tpmscad.lattices.strut_contacts import DIAMETER_DIGITS, find_contact

OUTSIDE_RTOL = 1e-9
"""In sizes of the box: how far vertices of struts that its sides have cut may lie outside it."""


def require_struts_apart(field: StrutsField) -> None:
    """InvalidRequest if struts touch outside their common nodes; it names the place, and a diameter at which they do not."""
    contact = find_contact(field.points, field.edges, field.node_radii, field.balls)
    if contact is None or contact.ratio > 1:
        return
    place = format_point(contact.place, 5)
    if contact.distance <= 1e-9 * contact.needed:
        raise InvalidRequest(f"{contact.what} near {place}: their axes meet, so join them by a node there")
    ratio = contact.ratio * (1 - DIAMETER_DIGITS)
    if not field.is_even:
        remedy = f"diameters {1 / ratio:.4g} times smaller"
    elif field.balls.max() > field.radii.max():
        remedy = f"a node_radius below {field.balls.max():g}, or both {1 / contact.ratio:.4g} times smaller"
    else:
        remedy = f"a diameter of at most {2 * field.radii.max() * ratio:.4g}"
    raise InvalidRequest(
        f"{contact.what} near {place}: there is {contact.distance:.4g} for {contact.needed:.4g} that "
        f"{'a diameter of ' if field.is_even else 'diameters up to '}{2 * field.radii.max():g} needs. Give {remedy}, leave short "
        "struts out of the graph, or make triangles or layers, for which struts may overlap: infill_triangles, infill_layers"
    )


def bound_struts(field: StrutsField) -> Brep:
    """The boundary of the struts, free ends included."""
    return build_strut_brep(field.points, field.edges, field.node_radii, field.balls)


def bound_struts_in_box(field: StrutsField, lo: Array, hi: Array) -> Brep:
    """The boundary of the part of struts in a box; TrimmingError unless nodes lie in its sides or keep clear of them."""
    size = float((hi - lo).max())
    depth = np.concatenate([field.points - lo, hi - field.points], axis=1)
    on_side = np.abs(depth) <= OUTSIDE_RTOL * size
    if not (on_side | (depth >= field.balls[:, None] * (1 - OUTSIDE_RTOL))).all():
        raise TrimmingError("nodes lie near sides of the box, not in them")
    contact = find_contact(field.points, field.edges, field.node_radii, field.balls, (lo, hi))
    if contact is not None and contact.ratio <= 1:
        raise TrimmingError(f"{contact.what} in a side of the box near {format_point(contact.place, 5)}")
    brep = build_strut_brep(field.points, field.edges, field.node_radii, field.balls, (lo, hi))
    if (brep.vertices < lo - OUTSIDE_RTOL * size).any() or (brep.vertices > hi + OUTSIDE_RTOL * size).any():
        raise TrimmingError("a joint reaches through a side of the box that its node does not lie in")
    return brep

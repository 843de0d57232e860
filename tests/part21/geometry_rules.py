"""Rules of items in their contexts and of geometry (ISO 10303-42, -43), the labels those of AP214 and AP242.

Evaluated: every WHERE rule of the entities in the table that can fail, and that poles form a rectangle. Not evaluated: those
about what the table has no entity for, and informal propositions.
"""

from __future__ import annotations

import math

from tests.part21.model import Item
from tests.part21.rules import rule


def dimension(item: Item) -> int:
    if "cartesian_point" in item.types:
        return len(item["coordinates"])
    if "direction" in item.types:
        return len(item["direction_ratios"])
    if "vector" in item.types:
        return dimension(item["orientation"])
    found = dimensions(item)
    return found.pop() if len(found) == 1 else 0


def dimensions(item: Item) -> set[int]:
    """Of the geometric contexts that an item is used in."""
    contexts = (item.model[r]["context_of_items"] for r in item.model.using_representations(item))
    return {c["coordinate_space_dimension"] for c in contexts if "geometric_representation_context" in c.types}


@rule("representation_item", "WR1")
def is_in_some_representation(item: Item) -> bool:
    return bool(item.model.using_representations(item))


@rule("geometric_representation_item", "WR1")
def is_in_geometric_contexts_only(item: Item) -> bool:
    used = (item.model[r]["context_of_items"] for r in item.model.using_representations(item))
    return all("geometric_representation_context" in c.types for c in used)


@rule("direction", "WR1")
def points_somewhere(item: Item) -> bool:
    return any(r != 0.0 for r in item["direction_ratios"])


@rule("vector", "WR1")
def has_no_negative_length(item: Item) -> bool:
    return item["magnitude"] >= 0.0


@rule("line", "WR1")
def runs_in_the_space_of_its_point(item: Item) -> bool:
    return dimension(item["dir"]) == dimension(item["pnt"])


@rule("axis2_placement_3d", "WR1")
def stands_in_space(item: Item) -> bool:
    return dimension(item["location"]) == 3


@rule("axis2_placement_3d", "WR2")
def has_an_axis_in_space(item: Item) -> bool:
    return item["axis"] is None or dimension(item["axis"]) == 3


@rule("axis2_placement_3d", "WR3")
def has_a_reference_in_space(item: Item) -> bool:
    return item["ref_direction"] is None or dimension(item["ref_direction"]) == 3


@rule("axis2_placement_3d", "WR4")
def has_no_axis_along_its_reference(item: Item) -> bool:
    given = [d["direction_ratios"] for d in (item["axis"], item["ref_direction"]) if d is not None]
    if [len(ratios) for ratios in given] != [3, 3]:
        return True  # nothing to cross, or another rule's matter
    (a, b, c), (x, y, z) = ([r / (math.hypot(*ratios) or 1.0) for r in ratios] for ratios in given)
    return math.hypot(b * z - c * y, c * x - a * z, a * y - b * x) > 0.0


@rule("axis2_placement_2d", "WR1")
def stands_in_the_plane(item: Item) -> bool:
    return dimension(item) == 2


def knots_fit(degree: int, poles: int, multiplicities: list[int], knots: list[float]) -> bool:
    """constraints_param_b_spline of ISO 10303-42; poles counts from one, its up_cp from nought."""
    inner, ends = multiplicities[1:-1], (multiplicities[0], multiplicities[-1])
    return (
        degree >= 1
        and poles > degree
        and sum(multiplicities) == degree + poles + 1
        and all(1 <= m <= degree + 1 for m in ends)
        and all(1 <= m <= degree for m in inner)
        and all(a < b for a, b in zip(knots, knots[1:], strict=False))
    )


@rule("b_spline_curve_with_knots", "WR1")
def has_the_knots_of_its_degree_and_poles(item: Item) -> bool:
    return knots_fit(item["degree"], len(item["control_points_list"]), item["knot_multiplicities"], item["knots"])


@rule("b_spline_curve_with_knots", "WR2")
def has_a_multiplicity_to_each_knot(item: Item) -> bool:
    return len(item["knot_multiplicities"]) == len(item["knots"])


@rule("b_spline_curve", "WR1")
def is_a_curve_with_knots(item: Item) -> bool:
    return "b_spline_curve_with_knots" in item.types


@rule("b_spline_surface", "WR1")
def is_a_surface_with_knots(item: Item) -> bool:
    return "b_spline_surface_with_knots" in item.types


@rule("b_spline_surface", "control_points")
def has_poles_in_rows_of_one_length(item: Item) -> bool:
    return len({len(row) for row in item["control_points_list"]}) == 1


@rule("b_spline_surface_with_knots", "WR1")
def has_the_u_knots_of_its_degree_and_poles(item: Item) -> bool:
    return knots_fit(item["u_degree"], len(item["control_points_list"]), item["u_multiplicities"], item["u_knots"])


@rule("b_spline_surface_with_knots", "WR2")
def has_the_v_knots_of_its_degree_and_poles(item: Item) -> bool:
    return knots_fit(item["v_degree"], len(item["control_points_list"][0]), item["v_multiplicities"], item["v_knots"])


@rule("b_spline_surface_with_knots", "WR3")
def has_a_multiplicity_to_each_u_knot(item: Item) -> bool:
    return len(item["u_multiplicities"]) == len(item["u_knots"])


@rule("b_spline_surface_with_knots", "WR4")
def has_a_multiplicity_to_each_v_knot(item: Item) -> bool:
    return len(item["v_multiplicities"]) == len(item["v_knots"])


@rule("rational_b_spline_curve", "WR1")
def has_a_weight_to_each_pole(item: Item) -> bool:
    return len(item["weights_data"]) == len(item["control_points_list"])


@rule("rational_b_spline_curve", "WR2")
def has_positive_weights(item: Item) -> bool:
    return all(w > 0.0 for w in item["weights_data"])


@rule("rational_b_spline_surface", "WR1")
def has_a_weight_to_each_pole_of_every_row(item: Item) -> bool:
    return [len(row) for row in item["weights_data"]] == [len(row) for row in item["control_points_list"]]


@rule("rational_b_spline_surface", "WR2")
def has_positive_weights_in_every_row(item: Item) -> bool:
    return all(w > 0.0 for row in item["weights_data"] for w in row)


@rule("definitional_representation", "WR1")
def is_in_parameter_space(item: Item) -> bool:
    return "parametric_representation_context" in item["context_of_items"].types


@rule("pcurve", "WR1")
def holds_one_item(item: Item) -> bool:
    return len(item["reference_to_curve"]["items"]) == 1


@rule("pcurve", "WR2")
def holds_a_curve(item: Item) -> bool:
    return "curve" in item["reference_to_curve"]["items"][0].types


@rule("pcurve", "WR3")
def holds_a_plane_curve(item: Item) -> bool:
    return dimension(item["reference_to_curve"]["items"][0]) == 2


@rule("surface_curve", "WR1")
def runs_in_space(item: Item) -> bool:
    return dimension(item["curve_3d"]) == 3


@rule("surface_curve", "WR2-WR3")
def has_the_parameter_curve_that_is_its_master(item: Item) -> bool:
    at = ["pcurve_s1", "pcurve_s2", "curve_3d"].index(item["master_representation"])
    return at == 2 or (at < len(item["associated_geometry"]) and "pcurve" in item["associated_geometry"][at].types)


@rule("surface_curve", "WR4")
def is_no_parameter_curve_in_space(item: Item) -> bool:
    return "pcurve" not in item["curve_3d"].types


@rule("seam_curve", "WR1")
def has_two_sides(item: Item) -> bool:
    return len(item["associated_geometry"]) == 2


@rule("seam_curve", "WR2")
def has_one_surface_on_both_sides(item: Item) -> bool:
    return len({(a["basis_surface"] if "pcurve" in a.types else a).number for a in item["associated_geometry"]}) == 1


@rule("seam_curve", "WR3-WR4")
def has_a_parameter_curve_on_either_side(item: Item) -> bool:
    return all("pcurve" in a.types for a in item["associated_geometry"])


@rule("degenerate_toroidal_surface", "WR1")
def has_a_tube_wider_than_its_ring(item: Item) -> bool:
    return item["major_radius"] < item["minor_radius"]


@rule("conical_surface", "WR1")
def has_no_negative_radius(item: Item) -> bool:
    return item["radius"] >= 0.0

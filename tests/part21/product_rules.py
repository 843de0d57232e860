"""Rules of products, contexts, units, properties, assemblies and colours (ISO 10303-41, -43, -44, -46, -517), the labels those of
AP214 and AP242.

Evaluated: every WHERE, UNIQUE and INVERSE rule of the entities in the table that can fail. Not evaluated: those about what the
table has no entity for, which hold of every file that passes the types (names and identifiers given by entities of their own,
mapped items, styles by context, of points and of curves); CAx-IF's practices, which are no rules of the schemas.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable

from tests.part21.model import Item
from tests.part21.rules import one_of, rule


def distinct(values: Iterable[object]) -> bool:
    return max(Counter(values).values(), default=0) <= 1


@rule("application_context", "INVERSE context_elements")
def has_elements(item: Item) -> bool:
    return bool(item.users("application_context_element.frame_of_reference"))


@rule("representation_context", "INVERSE representations_in_context")
def has_representations(item: Item) -> bool:
    return bool(item.users("representation.context_of_items"))


def length_exponent(unit: Item) -> float | None:
    """The power of length that a unit of length, angle, or products of these has; None if it is none of them."""
    if "derived_unit" in unit.types:
        powers = [(length_exponent(e["unit"]), e["exponent"]) for e in unit["elements"]]
        return None if any(p is None for p, _ in powers) else sum((p or 0.0) * exponent for p, exponent in powers)
    return (
        {"metre": 1.0, "radian": 0.0, "steradian": 0.0}.get(unit["si_unit.name"]) if "si_unit" in unit.types else None
    )


UNITS = {"length_unit": 1.0, "plane_angle_unit": 0.0, "solid_angle_unit": 0.0}
MEASURES = {"length_measure": 1.0, "positive_length_measure": 1.0, "area_measure": 2.0, "volume_measure": 3.0}


@rule("length_unit", "WR1")
def measures_length(item: Item) -> bool:
    return length_exponent(item) == UNITS["length_unit"]


@rule("plane_angle_unit", "WR1")
def measures_angles(item: Item) -> bool:
    return length_exponent(item) == UNITS["plane_angle_unit"]


@rule("solid_angle_unit", "WR1")
def measures_solid_angles(item: Item) -> bool:
    return length_exponent(item) == UNITS["solid_angle_unit"]


@rule("derived_unit", "WR1")
def is_no_bare_unit(item: Item) -> bool:
    return len(item["elements"]) > 1 or item["elements"][0]["exponent"] != 1.0


@rule("measure_with_unit", "WR1")
def has_a_unit_of_its_kind(item: Item) -> bool:
    kind, _ = item["value_component"]
    return kind not in MEASURES or length_exponent(item["unit_component"]) == MEASURES[kind]


@rule("uncertainty_measure_with_unit", "WR1")
def is_more_than_nought(item: Item) -> bool:
    return item["value_component"][1] > 0.0


@rule("product_definition_formation", "UR1")
def is_the_only_version_of_that_name(item: Item) -> bool:
    return distinct(f["id"] for f in item["of_product"].users("product_definition_formation.of_product"))


@rule("product_definition_shape", "UR1")
def is_the_only_shape(item: Item) -> bool:
    users = item["definition"].users("property_definition.definition")
    return sum("product_definition_shape" in u.types for u in users) == 1


@rule("product_definition_shape", "WR1")
def is_of_a_product_or_its_use(item: Item) -> bool:
    return not {"product_definition", "product_definition_relationship"}.isdisjoint(item["definition"].types)


@rule("product_definition_usage", "UR1")
def is_the_only_use_of_that_name(item: Item) -> bool:
    others = item["relating_product_definition"].users("product_definition_relationship.relating_product_definition")
    return distinct((u["id"], u["related_product_definition"].number) for u in others)


@rule("product_definition_usage", "WR1")
def uses_nothing_that_it_is_used_in(item: Item) -> bool:
    return acyclic(item, {item["related_product_definition"].number})


def acyclic(usage: Item, relatives: set[int]) -> bool:
    whole = usage["relating_product_definition"]
    if whole.number in relatives:
        return False
    above = whole.users("product_definition_relationship.related_product_definition")
    return all(acyclic(u, relatives | {whole.number}) for u in above if "product_definition_usage" in u.types)


@rule("shape_definition_representation", "WR1")
def defines_a_shape(item: Item) -> bool:
    return "product_definition_shape" in item["definition"].types


@rule("shape_definition_representation", "WR2")
def represents_a_shape(item: Item) -> bool:
    return "shape_representation" in item["used_representation"].types


@rule("shape_representation_relationship", "WR1")
def relates_a_shape(item: Item) -> bool:
    return "shape_representation" in item["rep_1"].types | item["rep_2"].types


@rule("representation_relationship_with_transformation", "WR1")
def moves_from_one_context_to_another(item: Item) -> bool:
    return item["rep_1"]["context_of_items"] is not item["rep_2"]["context_of_items"]


@rule("representation_relationship_with_transformation", "WR2", "ap242")
def moves_an_item_of_either(item: Item) -> bool:
    operator, using = item["transformation_operator"], item.model.using_representations
    return "item_defined_transformation" not in operator.types or (
        item["rep_1"].number in using(operator["transform_item_1"])
        and item["rep_2"].number in using(operator["transform_item_2"])
    )


@rule("context_dependent_shape_representation", "WR1")
def places_a_use_of_a_product(item: Item) -> bool:
    return "product_definition_relationship" in item["represented_product_relation"]["definition"].types


@rule("founded_item", "WR1")
def is_used(item: Item) -> bool:
    return bool(item.users())


@rule("colour_rgb", "WR1-WR3")
def is_within_the_cube(item: Item) -> bool:
    return all(0.0 <= item[c] <= 1.0 for c in ("red", "green", "blue"))


@rule("fill_area_style", "WR1")
def has_one_colour_at_most(item: Item) -> bool:
    return sum("fill_area_style_colour" in s.types for s in item["fill_styles"]) <= 1


@rule("surface_side_style", "WR1")
def has_one_style_of_a_kind(item: Item) -> bool:
    return distinct(s.types for s in item["styles"])


@rule("presentation_style_assignment", "WR1")
def has_one_style_of_a_kind_but_for_surfaces(item: Item) -> bool:
    return distinct(s.types for s in item["styles"] if "surface_style_usage" not in s.types)


@rule("presentation_style_assignment", "WR2-WR3")
def styles_each_side_once(item: Item) -> bool:
    sides = [s["side"] for s in item["styles"] if "surface_style_usage" in s.types]
    return len(sides) <= 1 or sorted(sides) == ["negative", "positive"]


@rule("styled_item", "WR1")
def has_one_style(item: Item) -> bool:
    return len(item["styles"]) == 1


@rule("styled_item", "WR2", "ap242")
def styles_no_styled_item(item: Item) -> bool:
    return "styled_item" not in item["item"].types


@rule("styled_item", "WR3", "ap242")
def styles_geometry(item: Item) -> bool:
    return "geometric_representation_item" in item["item"].types


PRESENTATION = "mechanical_design_geometric_presentation_representation"


@rule(PRESENTATION, "WR1")
def holds_styled_items(item: Item) -> bool:
    return all(one_of(i, "mapped_item", "styled_item", "axis2_placement_3d", "camera_model_d3") for i in item["items"])


@rule(PRESENTATION, "WR4")
def holds_styles_of_surfaces(item: Item) -> bool:
    return all(one_of(s, "point_style", "curve_style", "surface_style_usage") for s in styles(item))


@rule(PRESENTATION, "WR8")
def holds_styles_of_sides(item: Item) -> bool:
    return all("surface_side_style" in s["style"].types for s in styles(item) if "surface_style_usage" in s.types)


@rule(PRESENTATION, "WR9")
def fills_areas(item: Item) -> bool:
    sides = (s["style"] for s in styles(item) if "surface_style_usage" in s.types)
    return all("surface_style_fill_area" in element.types for side in sides for element in side["styles"])


def styles(presentation: Item) -> list[Item]:
    styled = [i for i in presentation["items"] if "styled_item" in i.types]
    return [style for i in styled for assignment in i["styles"] for style in assignment["styles"]]

"""Global rules of the application protocols AP214 and AP242 that bear on what tpmscad writes, the labels theirs.

Two are evaluated as they are meant: application_protocol_definition_required (the long form of AP214 asks for its own name,
automotive_design_lf, where every file has automotive_design) and coordinated_assembly_and_shape (printed so that it refuses the
very relation it is about). Left out: AP214's subtype_mandatory_founded_item, which as printed allows no style at all, and the
rules about names, roles, languages, effectivities, documents, tolerances, features, curve and text styles, mapped items and
composites, which hold of every file without them; of AP242's 58 global rules that leaves the one on entities that something
must refer to.
"""

from __future__ import annotations

from tests.part21.geometry_rules import dimensions
from tests.part21.model import Item, Model
from tests.part21.product_rules import distinct
from tests.part21.rules import global_rule

CATEGORIES = {
    "part",
    "raw material",
    "tool",
    "document",
    "functionality",
    "conceptual product",
    "alternative solution",
    "requirement",
    "physically realized product",
}


def categories(product: Item) -> list[str]:
    return [c["name"] for c in product.users("product_related_product_category.products")]


@global_rule("application_protocol_definition_required", "ap214")
def names_its_protocol(model: Model) -> bool:
    protocols = [
        d for c in model.all("application_context") for d in c.users("application_protocol_definition.application")
    ]
    return any(p["application_interpreted_model_schema_name"] == "automotive_design" for p in protocols)


@global_rule("compatible_dimension WR1", "ap214")
def has_points_of_the_dimension_of_their_contexts(model: Model) -> bool:
    return all(len(p["coordinates"]) == d for p in model.all("cartesian_point") for d in dimensions(p))


@global_rule("compatible_dimension WR2", "ap214")
def has_directions_of_the_dimension_of_their_contexts(model: Model) -> bool:
    return all(len(p["direction_ratios"]) == d for p in model.all("direction") for d in dimensions(p))


@global_rule("dimensionality_is_two_or_three", "ap214")
def is_in_the_plane_or_in_space(model: Model) -> bool:
    return all(c["coordinate_space_dimension"] in (2, 3) for c in model.all("geometric_representation_context"))


@global_rule("consistent_uncertainty", "ap214")
def has_one_uncertainty_of_a_name(model: Model) -> bool:
    return all(distinct(u["name"] for u in c["uncertainty"]) for c in model.all("global_uncertainty_assigned_context"))


DEPENDENT = {
    "ap214": (
        "colour_rgb",
        "derived_unit",
        "fill_area_style",
        "fill_area_style_colour",
        "measure_with_unit",
        "named_unit",
        "organization_role",
    ),
    "ap242": ("founded_item",),
}


@global_rule("dependent_instantiable", "ap214")
def has_nothing_that_must_be_used_and_is_not(model: Model) -> bool:
    return all(item.users() for entity in DEPENDENT["ap214"] for item in model.all(entity))


@global_rule("validate_dependently_instantiable_entity_data_types", "ap242")
def has_nothing_that_must_be_used_and_stands_alone(model: Model) -> bool:
    return all(item.users() for entity in DEPENDENT["ap242"] for item in model.all(entity))


@global_rule("coordinated_assembly_and_shape", "ap214")
def has_shapes_related_as_the_products_are(model: Model) -> bool:
    return all(is_placed(usage) for usage in model.all("next_assembly_usage_occurrence"))


def is_placed(usage: Item) -> bool:
    """Whether a relation between the shapes of part and assembly is bound to the use of the one in the other."""
    wanted = {
        frozenset((a, b))
        for a in shapes(usage["related_product_definition"])
        for b in shapes(usage["relating_product_definition"])
    }
    bound = "context_dependent_shape_representation.represented_product_relation"
    placements = [c for shape in usage.users("property_definition.definition") for c in shape.users(bound)]
    related = [c["representation_relation"] for c in placements]
    return any(frozenset((r["rep_1"].number, r["rep_2"].number)) in wanted for r in related)


def shapes(definition: Item) -> set[int]:
    return {
        r["used_representation"].number
        for p in definition.users("property_definition.definition")
        for r in p.users("property_definition_representation.definition")
        if "shape_definition_representation" in r.types
    }


@global_rule("product_requires_category", "ap214")
def has_products_with_categories(model: Model) -> bool:
    return all(categories(p) for p in model.all("product"))


@global_rule("product_requires_version", "ap214")
def has_products_with_versions(model: Model) -> bool:
    return all(p.users("product_definition_formation.of_product") for p in model.all("product"))


@global_rule("product_requires_id_owner", "ap214")
def has_parts_with_one_owner_of_their_name(model: Model) -> bool:
    def owners(product: Item) -> int:
        assignments = product.users("applied_organization_assignment.items")
        return sum(a["role"]["name"] == "id owner" for a in assignments)

    owned = {"part", "tool", "raw material"}
    return all(owners(p) == 1 for p in model.all("product") if owned & set(categories(p)))


@global_rule("restrict_product_category_for_product", "ap214")
def has_products_of_one_known_category(model: Model) -> bool:
    return all(sum(c in CATEGORIES for c in categories(p)) == 1 for p in model.all("product"))


@global_rule("restrict_product_definition_context_for_product WR1", "ap214")
def has_parts_where_parts_are_defined(model: Model) -> bool:
    definitions = (d for d in model.all("product_definition") if d["frame_of_reference"]["name"] == "part definition")
    return all({"part", "raw material", "tool"} & set(categories(d["formation"]["of_product"])) for d in definitions)


@global_rule("restrict_product_definitions_for_product_definition_relationship WR3", "ap214")
def assembles_definitions_of_parts(model: Model) -> bool:
    return all(
        usage[side]["frame_of_reference"]["name"] == "part definition"
        for usage in model.all("assembly_component_usage")
        for side in ("relating_product_definition", "related_product_definition")
    )


@global_rule("subtype_mandatory_colour_specification", "ap214")
def has_colours_in_red_green_and_blue(model: Model) -> bool:
    return all("colour_rgb" in c.types for c in model.all("colour_specification"))

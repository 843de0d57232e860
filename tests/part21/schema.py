"""The declarations of every entity that tpmscad writes: supertypes, attributes in order, their types, and what selects take.

All of them were read in the EXPRESS long form of AP214: ISO/DIS 10303-214:2007, schema AUTOMOTIVE_DESIGN, version 3 (file
data/ap214e3/AP214E3_2010.exp of the stepcode project). AP242, ISO/TS 10303-442, was read for B-spline surfaces, directions,
points, edges, loops and seams, relations with transformations, styled items and their styles, contexts and protocol definitions
and the global rules: in WG3 N8593 of 2015 (data/ap242/242_n8324_mim_lf.exp), which supersedes N8324 of the first edition, and in
WG12 N11521, a later edition (data/ap242/242_mim_lf.exp). It says the same, but lets representations be styled and products
elsewhere be assembled, too. Both take their geometry, topology, products and presentation from the same resources and constructs
(ISO 10303-41 to -46, -511, -514, -517). Some entities only the kernel's own writer needs. The header's are those of ISO 10303-21.

One line an entity: its name, supertypes after <, attributes after a colon. {a:b} is a set, [a:b] a list, ! of unique members,
? may be unset, and *name an inherited attribute that is derived here, which Part 21 writes as an asterisk.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

DECLARATIONS = """
advanced_brep_shape_representation < shape_representation
advanced_face < face_surface
application_context: application label
application_context_element: name label, frame_of_reference application_context
application_protocol_definition: status label, application_interpreted_model_schema_name label, application_protocol_year year_number, application application_context
applied_organization_assignment < organization_assignment: items {1:*}organization_item
assembly_component_usage < product_definition_usage: reference_designator identifier?
axis1_placement < placement: axis direction?
axis2_placement_2d < placement: ref_direction direction?
axis2_placement_3d < placement: axis direction?, ref_direction direction?
b_spline_curve < bounded_curve: degree INTEGER, control_points_list [2:*]cartesian_point, curve_form b_spline_curve_form, closed_curve LOGICAL, self_intersect LOGICAL
b_spline_curve_with_knots < b_spline_curve: knot_multiplicities [2:*]INTEGER, knots [2:*]parameter_value, knot_spec knot_type
b_spline_surface < bounded_surface: u_degree INTEGER, v_degree INTEGER, control_points_list [2:*][2:*]cartesian_point, surface_form b_spline_surface_form, u_closed LOGICAL, v_closed LOGICAL, self_intersect LOGICAL
b_spline_surface_with_knots < b_spline_surface: u_multiplicities [2:*]INTEGER, v_multiplicities [2:*]INTEGER, u_knots [2:*]parameter_value, v_knots [2:*]parameter_value, knot_spec knot_type
bounded_curve < curve
bounded_surface < surface
brep_with_voids < manifold_solid_brep: voids {1:*}oriented_closed_shell
cartesian_point < point: coordinates [1:3]length_measure
circle < conic: radius positive_length_measure
closed_shell < connected_face_set
colour
colour_rgb < colour_specification: red REAL, green REAL, blue REAL
colour_specification < colour: name label
conic < curve: position axis2_placement
conical_surface < elementary_surface: radius length_measure, semi_angle plane_angle_measure
connected_face_set < topological_representation_item: cfs_faces {1:*}face
context_dependent_shape_representation: representation_relation shape_representation_relationship, represented_product_relation product_definition_shape
curve < geometric_representation_item
cylindrical_surface < elementary_surface: radius positive_length_measure
definitional_representation < representation
degenerate_toroidal_surface < toroidal_surface: select_outer BOOLEAN
derived_unit: elements {1:*}derived_unit_element
derived_unit_element: unit named_unit, exponent REAL
direction < geometric_representation_item: direction_ratios [2:3]REAL
edge < topological_representation_item: edge_start vertex, edge_end vertex
edge_curve < edge, geometric_representation_item: edge_geometry curve, same_sense BOOLEAN
edge_loop < loop, path
elementary_surface < surface: position axis2_placement_3d
ellipse < conic: semi_axis_1 positive_length_measure, semi_axis_2 positive_length_measure
face < topological_representation_item: bounds {1:*}face_bound
face_bound < topological_representation_item: bound loop, orientation BOOLEAN
face_outer_bound < face_bound
face_surface < face, geometric_representation_item: face_geometry surface, same_sense BOOLEAN
file_description: description [1:*]STRING, implementation_level STRING
file_name: name STRING, time_stamp STRING, author [1:*]STRING, organization [1:*]STRING, preprocessor_version STRING, originating_system STRING, authorization STRING
file_schema: schema_identifiers [1:*]!STRING
fill_area_style < founded_item: name label, fill_styles {1:*}fill_style_select
fill_area_style_colour: name label, fill_colour colour
founded_item
functionally_defined_transformation: name label, description text?
geometric_representation_context < representation_context: coordinate_space_dimension dimension_count
geometric_representation_item < representation_item
global_uncertainty_assigned_context < representation_context: uncertainty {1:*}uncertainty_measure_with_unit
global_unit_assigned_context < representation_context: units {1:*}unit
item_defined_transformation: name label, description text?, transform_item_1 representation_item, transform_item_2 representation_item
length_unit < named_unit
line < curve: pnt cartesian_point, dir vector
loop < topological_representation_item
manifold_solid_brep < solid_model: outer closed_shell
measure_representation_item < representation_item, measure_with_unit
measure_with_unit: value_component measure_value, unit_component unit
mechanical_design_geometric_presentation_representation < representation
named_unit: dimensions dimensional_exponents
next_assembly_usage_occurrence < assembly_component_usage
organization: id identifier?, name label, description text?
organization_assignment: assigned_organization organization, role organization_role
organization_role: name label
oriented_closed_shell < closed_shell: closed_shell_element closed_shell, orientation BOOLEAN, *cfs_faces
oriented_edge < edge: edge_element edge, orientation BOOLEAN, *edge_start, *edge_end
parametric_representation_context < representation_context
path < topological_representation_item: edge_list [1:*]!oriented_edge
pcurve < curve: basis_surface surface, reference_to_curve definitional_representation
placement < geometric_representation_item: location cartesian_point
plane < elementary_surface
plane_angle_unit < named_unit
point < geometric_representation_item
presentation_style_assignment < founded_item: styles {1:*}presentation_style_select
product: id identifier, name label, description text?, frame_of_reference {1:*}product_context
product_category: name label, description text?
product_context < application_context_element: discipline_type label
product_definition: id identifier, description text?, formation product_definition_formation, frame_of_reference product_definition_context
product_definition_context < application_context_element: life_cycle_stage label
product_definition_formation: id identifier, description text?, of_product product
product_definition_relationship: id identifier, name label, description text?, relating_product_definition product_definition, related_product_definition product_definition
product_definition_shape < property_definition
product_definition_usage < product_definition_relationship
product_related_product_category < product_category: products {1:*}product
property_definition: name label, description text?, definition characterized_definition
property_definition_representation: definition represented_definition, used_representation representation
rational_b_spline_curve < b_spline_curve: weights_data [2:*]REAL
rational_b_spline_surface < b_spline_surface: weights_data [2:*][2:*]REAL
representation: name label, items {1:*}representation_item, context_of_items representation_context
representation_context: context_identifier identifier, context_type text
representation_item: name label
representation_relationship: name label, description text?, rep_1 representation, rep_2 representation
representation_relationship_with_transformation < representation_relationship: transformation_operator transformation
seam_curve < surface_curve
shape_definition_representation < property_definition_representation
shape_representation < representation
shape_representation_relationship < representation_relationship
si_unit < named_unit: prefix si_prefix?, name si_unit_name, *dimensions
solid_angle_unit < named_unit
solid_model < geometric_representation_item
spherical_surface < elementary_surface: radius positive_length_measure
styled_item < representation_item: styles {1:*}presentation_style_assignment, item representation_item
surface < geometric_representation_item
surface_curve < curve: curve_3d curve, associated_geometry [1:2]pcurve_or_surface, master_representation preferred_surface_curve_representation
surface_of_linear_extrusion < swept_surface: extrusion_axis vector
surface_of_revolution < swept_surface: axis_position axis1_placement
surface_side_style < founded_item: name label, styles {1:7}surface_style_element_select
surface_style_fill_area < founded_item: fill_area fill_area_style
surface_style_usage < founded_item: side surface_side, style surface_side_style_select
swept_surface < surface: swept_curve curve
topological_representation_item < representation_item
toroidal_surface < elementary_surface: major_radius positive_length_measure, minor_radius positive_length_measure
uncertainty_measure_with_unit < measure_with_unit: name label, description text?
vector < geometric_representation_item: orientation direction, magnitude length_measure
vertex < topological_representation_item
vertex_loop < loop: loop_vertex vertex
vertex_point < vertex, geometric_representation_item: vertex_geometry point
"""  # noqa: E501 - a declaration to a line, however long

ABSTRACT = {"organization_assignment"}

DEFINED = {
    "area_measure": "REAL",
    "dimension_count": "INTEGER",
    "identifier": "STRING",
    "label": "STRING",
    "length_measure": "REAL",
    "parameter_value": "REAL",
    "plane_angle_measure": "REAL",
    "positive_length_measure": "REAL",
    "text": "STRING",
    "volume_measure": "REAL",
    "year_number": "INTEGER",
}
"""Defined types and what they rest on."""

POSITIVE = {"dimension_count", "positive_length_measure"}
"""Defined types whose WHERE rule asks for more than zero."""

ENUMERATIONS = {
    "BOOLEAN": "T F",
    "LOGICAL": "T F U",
    "b_spline_curve_form": "polyline_form circular_arc elliptic_arc parabolic_arc hyperbolic_arc unspecified",
    "b_spline_surface_form": "plane_surf cylindrical_surf conical_surf spherical_surf toroidal_surf surf_of_revolution "
    "ruled_surf generalised_cone quadric_surf surf_of_linear_extrusion unspecified",
    "knot_type": "uniform_knots quasi_uniform_knots piecewise_bezier_knots unspecified",
    "preferred_surface_curve_representation": "curve_3d pcurve_s1 pcurve_s2",
    "si_prefix": "exa peta tera giga mega kilo hecto deca deci centi milli micro nano pico femto atto",
    "si_unit_name": "metre gram second ampere kelvin mole candela radian steradian hertz newton pascal joule watt coulomb volt "
    "farad ohm siemens weber tesla henry degree_celsius lumen lux becquerel gray sievert",
    "surface_side": "positive negative both",
}

SELECTS = {
    "axis2_placement": "axis2_placement_2d axis2_placement_3d",
    "characterized_definition": "characterized_object characterized_product_definition shape_definition",
    "characterized_product_definition": "product_definition product_definition_relationship",
    "fill_style_select": "fill_area_style_colour externally_defined_tile_style fill_area_style_tiles "
    "externally_defined_hatch_style fill_area_style_hatching",
    "measure_value": "area_measure length_measure parameter_value plane_angle_measure positive_length_measure volume_measure",
    "organization_item": "product",
    "pcurve_or_surface": "pcurve surface",
    "presentation_style_select": "pre_defined_presentation_style point_style curve_style surface_style_usage symbol_style "
    "fill_area_style text_style approximation_tolerance externally_defined_style null_style",
    "represented_definition": "general_property property_definition property_definition_relationship shape_aspect "
    "shape_aspect_relationship",
    "shape_definition": "product_definition_shape shape_aspect shape_aspect_relationship",
    "surface_side_style_select": "surface_side_style",
    "surface_style_element_select": "surface_style_fill_area surface_style_boundary surface_style_silhouette "
    "surface_style_segmentation_curve surface_style_control_grid surface_style_parameter_line surface_style_rendering",
    "transformation": "item_defined_transformation functionally_defined_transformation",
    "unit": "derived_unit named_unit",
}
"""What selects take; of measure_value and organization_item only what is written."""


@dataclass(frozen=True)
class Aggregate:
    """A set or list: least and greatest size (None: no limit), whether members differ by definition, and their type."""

    low: int
    high: int | None
    distinct: bool
    of: Aggregate | str


@dataclass(frozen=True)
class Attribute:
    name: str
    type: Aggregate | str
    optional: bool = False


@dataclass(frozen=True)
class Entity:
    name: str
    supertypes: tuple[str, ...]
    own: tuple[Attribute, ...]
    derived: frozenset[str]


AGGREGATE = re.compile(r"([{\[])(\d+):(\d+|\*)[}\]](!?)(.+)")


def _type(text: str) -> Aggregate | str:
    match = AGGREGATE.fullmatch(text)
    if not match:
        return text
    mark, low, high, unique, of = match.groups()
    return Aggregate(int(low), None if high == "*" else int(high), mark == "{" or unique == "!", _type(of))


def _entity(line: str) -> Entity:
    head, _, body = line.partition(":") if ": " in line else (line, "", "")
    name, _, supertypes = head.partition(" < ")
    fields = [f.split() for f in body.split(", ") if f]
    own = [Attribute(f[0], _type(f[1].removesuffix("?")), f[1].endswith("?")) for f in fields if len(f) == 2]
    derived = frozenset(f[0][1:] for f in fields if f[0].startswith("*"))
    return Entity(name.strip(), tuple(supertypes.split(", ")) if supertypes else (), tuple(own), derived)


ENTITIES = {e.name: e for e in map(_entity, DECLARATIONS.strip().splitlines())}


def ancestors(name: str) -> dict[str, None]:
    """The entity's supertypes, each once, in the order in which Part 21 writes their attributes; itself last."""
    found: dict[str, None] = {}
    for supertype in ENTITIES[name].supertypes:
        found.update(ancestors(supertype))
    return found | {name: None}


def members(select: str) -> set[str]:
    """Everything that a select takes, selects among its members resolved."""
    return {m for name in SELECTS[select].split() for m in (members(name) if name in SELECTS else {name})}

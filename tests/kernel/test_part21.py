"""The conformance check notices faults: a file is written, one thing in it changed, and the rule that forbids it is named."""

from __future__ import annotations

import re
import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
import part21
import part21_check
import pytest
from part21_rules import RULES

pytestmark = pytest.mark.kernel

from kernel_shapes import TURN, drilled_dome, hollow_box, plane_box  # noqa: E402
from round_shapes import frustum  # noqa: E402

from tpmscad import kernel  # noqa: E402

COLOURS = {"side": (1.0, 0.0, 0.0), "hole": (0.0, 0.0, 1.0)}
PAIR = kernel.Instances(np.stack([np.eye(3), TURN]), np.array([[0.0, 0.0, 0.0], [7.0, -2.0, 1.0]]))
SAMPLES = {
    "box": (plane_box, {}),
    "dome": (drilled_dome, {"colours": COLOURS}),
    "pair": (plane_box, {"instances": PAIR}),
    "void": (hollow_box, {}),
    "cone": (lambda: frustum(3, 1, 2), {}),
    "replicas": (drilled_dome, {"replicas": True}),
}


@lru_cache
def lines(sample: str, schema: str) -> tuple[str, dict[int, str]]:
    """The text before the data section, and the data section by number."""
    make, how = SAMPLES[sample]
    complex = make()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "part.step"
        kernel.write_step(complex, kernel.build(complex).nesting, path, schema=schema, **how)
        text = path.read_text()
    return text.split("DATA;\n")[0], {int(n): body for n, body in re.findall(r"^#(\d+)=(.*);$", text, re.M)}


def faults(sample: str, schema: str, *changes: tuple[str, str, str]) -> list[str]:
    """What is found after the changes: at a place, a pattern and what takes its place.

    A place is an entity's name, for the first instance of it; A>B is the first B that this refers to, A[1] the second. An empty
    place is a new instance. {A} in a replacement is the number of the instance at that place, {} that of the changed one.
    """
    head, bodies = lines(sample, schema)
    bodies = dict(bodies)

    def is_a(number: int, name: str) -> bool:
        return re.match(rf"(\(.*\)|){name}\(|\({name}\(", bodies[number]) is not None

    def find(place: str) -> int:
        among = list(bodies)
        for step in place.split(">"):
            name, index = re.fullmatch(r"(\w+)(?:\[(\d+)\])?", step).groups(default="0")
            number = [n for n in among if is_a(n, name)][int(index)]
            among = [int(n) for n in re.findall(r"#(\d+)", bodies[number])]
        return number

    for place, pattern, replacement in changes:
        number = find(place) if place else max(bodies) + 1
        new = re.sub(r"\{(.*?)\}", lambda m: str(find(m[1]) if m[1] else number), replacement)  # noqa: B023
        if place and not new and not pattern:
            del bodies[number]
        elif place:
            bodies[number], count = re.subn(pattern, new, bodies[number], count=1)
            assert count == 1, (place, pattern, bodies[number])
        else:
            bodies[number] = new
    text = head + "DATA;\n" + "".join(f"#{n}={b};\n" for n, b in bodies.items()) + "ENDSEC;\nEND-ISO-10303-21;\n"
    return part21_check.faults(part21.parse(text)[1], schema)


@pytest.mark.parametrize("schema", ["ap242", "ap214"])
@pytest.mark.parametrize("sample", SAMPLES)
def test_what_is_written_breaks_no_rule_but_that_replicas_carry_no_faces(sample: str, schema: str) -> None:
    found = faults(sample, schema)
    assert [f.split(":")[0] for f in found] == (["advanced_face.WR1"] if sample == "replicas" else [])


TYPES = {
    "too few attributes": ("box", ("VECTOR", r"#\d+,", "")),
    "too many": ("box", ("PLANE", r"\)$", r",$)")),
    "an entity of another type": ("box", ("EDGE_CURVE", r"#(\d+),#(\d+),#(\d+)", r"#\3,#\2,#\1")),
    "an entity that is not there": ("box", ("VERTEX_POINT", r"#\d+", "#999999")),
    "an unknown entity": ("box", ("PLANE", "PLANE", "PLAIN")),
    "an abstract entity": ("box", ("", "", "ORGANIZATION_ASSIGNMENT($,$)")),
    "an integer for a real": ("box", ("CARTESIAN_POINT", r"\(0\.0,", "(0,")),
    "a real for an integer": ("dome", ("B_SPLINE_CURVE_WITH_KNOTS", r"'',(\d),", r"'',\1.,")),
    "a measure of another type": ("box", ("UNCERTAINTY_MEASURE_WITH_UNIT", "LENGTH_MEASURE", "LABEL")),
    "a measure without its type": ("box", ("UNCERTAINTY_MEASURE_WITH_UNIT", r"LENGTH_MEASURE\((.*?)\)", r"\1")),
    "no measure at all": ("cone", ("CONICAL_SURFACE", r",[\d.]+\)$", ",$)")),
    "a radius of nought": ("cone", ("CIRCLE", r",[\d.]+\)$", ",0.)")),
    "an unknown word": ("dome", ("B_SPLINE_CURVE_WITH_KNOTS", "UNSPECIFIED", "UNKNOWN")),
    "unknown for true or false": ("box", ("EDGE_CURVE", r"\.T\.", ".U.")),
    "a string for a reference": ("box", ("PRODUCT_DEFINITION", r"#\d+", "'formation'")),
    "a derived attribute written out": ("box", ("ORIENTED_EDGE", r"\*,\*", r"$,$")),
    "an attribute said to be derived": ("box", ("VERTEX_POINT", r"#\d+", "*")),
    "an empty list": ("box", ("CLOSED_SHELL", r"\(#.*\)\)$", "())")),
    "a point of four coordinates": ("box", ("CARTESIAN_POINT", r"\(0\.0,", "(0.,0.,")),
    "a set with a member twice": ("box", ("CLOSED_SHELL", r"\(#(\d+),", r"(#\1,#\1,")),
    "a list of different members with one twice": ("box", ("EDGE_LOOP", r"\(#(\d+),", r"(#\1,#\1,")),
    "one thing where a set should be": ("box", ("PRODUCT", r"\((#\d+)\)\)$", r"\1)")),
    "part of a complex entity": ("box", ("LENGTH_UNIT", r"NAMED_UNIT\(\*\)", "")),
    "too much in a part": ("box", ("LENGTH_UNIT", r"LENGTH_UNIT\(\)", "LENGTH_UNIT($)")),
    "a solid as a definition": ("box", ("PROPERTY_DEFINITION", r"#\d+", "#{MANIFOLD_SOLID_BREP}")),
}


@pytest.mark.parametrize("fault", TYPES)
def test_values_that_the_schema_does_not_allow_are_noticed(fault: str) -> None:
    sample, *changes = TYPES[fault]
    found = faults(sample, "ap242", *changes)
    assert len(found) >= 1
    assert not any(f.startswith(tuple(r.name for r in RULES)) for f in found)


CURVE, SURFACE = "B_SPLINE_CURVE_WITH_KNOTS", "B_SPLINE_SURFACE_WITH_KNOTS"
FRAME, EDGE = "AXIS2_PLACEMENT_3D", "ORIENTED_EDGE>EDGE_CURVE"
SOLIDS, SHOWN = "ADVANCED_BREP_SHAPE_REPRESENTATION", "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION"
MOVE, USAGE = "REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION", "NEXT_ASSEMBLY_USAGE_OCCURRENCE"
SPACE, MEMBER = "GEOMETRIC_REPRESENTATION_CONTEXT", r"\(#(\d+)\)"
RULE_BREAKS = [
    ("representation_item.WR1", "box", ("", "", "CARTESIAN_POINT('',(1.,2.,3.))")),
    ("geometric_representation_item.WR1", "box", (SPACE, ".*", "REPRESENTATION_CONTEXT('','')")),
    ("direction.WR1", "box", ("DIRECTION", r"\(.*\)$", "('',(0.,-0.,0.))")),
    ("vector.WR1", "box", ("VECTOR", r",[\d.]+\)$", ",-1.)")),
    ("line.WR1", "box", ("VECTOR>DIRECTION", r"\('',.*", "('',(1.,0.))")),
    ("axis2_placement_3d.WR1", "box", (f"{FRAME}>CARTESIAN_POINT", r"\('',.*", "('',(1.,0.))")),
    ("axis2_placement_3d.WR2", "box", (f"{FRAME}>DIRECTION", r"\('',.*", "('',(1.,0.))")),
    ("axis2_placement_3d.WR3", "box", (f"{FRAME}>DIRECTION[1]", r"\('',.*", "('',(1.,0.))")),
    ("axis2_placement_3d.WR4", "box", (FRAME, r"(#\d+),#\d+\)$", r"\1,\1)")),
    ("b_spline_curve.WR1", "dome", (CURVE, r"_WITH_KNOTS(.*?\),\..*?\.,\..\.,\..\.).*", r"\1)")),
    ("b_spline_curve_with_knots.WR1", "dome", (CURVE, r"\(4,4\)", "(4,3)")),
    ("b_spline_curve_with_knots.WR1", "dome", (CURVE, r"\(4,4\)", "(3,5)")),
    ("b_spline_curve_with_knots.WR1", "dome", (CURVE, r"'',3,", "'',2,")),
    ("b_spline_curve_with_knots.WR1", "dome", (CURVE, r"\(0\.0,1\.0\)", "(1.0,1.0)")),
    ("b_spline_curve_with_knots.WR1", "dome", (CURVE, r"\(#\d+,", "(")),
    ("b_spline_curve_with_knots.WR2", "dome", (CURVE, r"\(0\.0,1\.0\)", "(0.0,0.5,1.0)")),
    ("b_spline_surface.WR1", "dome", (SURFACE, r"_WITH_KNOTS(.*?\)\),\..*?\.,\..\.,\..\.,\..\.).*", r"\1)")),
    ("b_spline_surface.control_points", "dome", (SURFACE, r"\(\(#\d+,", "((")),
    ("b_spline_surface_with_knots.WR1", "dome", (SURFACE, r"\(3,3\),", "(4,3),")),
    ("b_spline_surface_with_knots.WR1", "dome", (SURFACE, r"'',2,2,", "'',1,2,")),
    ("b_spline_surface_with_knots.WR2", "dome", (SURFACE, r"(\(3,3\)),\(3,3\)", r"\1,(3,2)")),
    ("b_spline_surface_with_knots.WR3", "dome", (SURFACE, r"\(0\.0,1\.0\),", "(0.0,0.5,1.0),")),
    ("b_spline_surface_with_knots.WR4", "dome", (SURFACE, r"(\(0\.0,1\.0\)),\(0\.0,1\.0\)", r"\1,(0.,0.5,1.)")),
    ("conical_surface.WR1", "cone", ("CONICAL_SURFACE", r",[\d.]+,", ",-1.,")),
    ("cartesian_transformation_operator.WR1", "replicas", ("CARTESIAN_TRANSFORMATION_OPERATOR_3D", r",1\.,", ",0.,")),
    ("cartesian_transformation_operator_3d.WR1", "replicas", (SPACE, r"CONTEXT\(3\)", "CONTEXT(2)")),
    ("surface_replica.WR1", "replicas", ("SURFACE_REPLICA", r"#\d+", "#{}")),
    ("oriented_edge.WR1", "box", ("ORIENTED_EDGE", r"#\d+", "#{ORIENTED_EDGE[1]}")),
    ("path.WR1", "box", ("EDGE_LOOP", r"(#\d+),(#\d+)", r"\2,\1")),
    ("path.WR1", "box", ("EDGE_LOOP>ORIENTED_EDGE[1]", r"#\d+", "#{EDGE_CURVE[11]}")),
    ("edge_loop.WR1", "box", ("EDGE_LOOP", r",#\d+\)\)$", "))")),
    ("face.WR2", "dome", ("FACE_BOUND", "FACE_BOUND", "FACE_OUTER_BOUND")),
    ("advanced_face.WR1", "box", ("PLANE", r"PLANE\('',#\d+\)", "SURFACE('')")),
    ("advanced_face.WR2", "box", (EDGE, r"EDGE_CURVE(.*),#\d+,\.T\.", r"EDGE\1")),
    ("advanced_face.WR3", "box", (f"{EDGE}>LINE", ".*", "CURVE('')")),
    ("advanced_face.WR4", "box", ("VERTEX_POINT", ".*", "VERTEX('')")),
    ("advanced_face.WR4", "box", ("", "", "POINT('')"), ("VERTEX_POINT", r"#\d+", "#{POINT}")),
    ("advanced_face.WR8", "box", ("EDGE_LOOP", ".*", "LOOP('')")),
    ("oriented_closed_shell.WR1", "void", ("ORIENTED_CLOSED_SHELL", r"#\d+", "#{}")),
    ("closed_shell.each edge once either way", "box", ("CLOSED_SHELL", r",#\d+\)\)$", "))")),
    ("closed_shell.each edge once either way", "box", ("FACE_OUTER_BOUND", r"\.T\.", ".F.")),
    (f"{SOLIDS.lower()}.WR1", "box", (SOLIDS, r"\(#", "(#{ADVANCED_FACE},#")),
    (f"{SOLIDS.lower()}.WR2", "box", (SOLIDS, r",#\d+\),", "),")),
    (f"{SOLIDS.lower()}.WR3", "box", ("ADVANCED_FACE", "ADVANCED_FACE", "FACE_SURFACE")),
    (f"{SOLIDS.lower()}.WR4", "void", ("BREP_WITH_VOIDS", r"#\d+", "#{ORIENTED_CLOSED_SHELL}")),
    (f"{SOLIDS.lower()}.WR5", "void", ("ORIENTED_CLOSED_SHELL", r"\.F\.", ".T.")),
    ("application_context.INVERSE context_elements", "box", ("", "", "APPLICATION_CONTEXT('another')")),
    ("representation_context.INVERSE representations_in_context", "box", ("", "", "REPRESENTATION_CONTEXT('','')")),
    ("length_unit.WR1", "box", ("LENGTH_UNIT", "METRE", "RADIAN")),
    ("plane_angle_unit.WR1", "box", ("PLANE_ANGLE_UNIT", "RADIAN", "SECOND")),
    ("solid_angle_unit.WR1", "box", ("SOLID_ANGLE_UNIT", "STERADIAN", "METRE")),
    ("derived_unit.WR1", "box", ("DERIVED_UNIT_ELEMENT", r"2\.", "1.")),
    ("measure_with_unit.WR1", "box", ("MEASURE_REPRESENTATION_ITEM", "VOLUME_MEASURE", "AREA_MEASURE")),
    ("measure_with_unit.WR1", "box", ("DERIVED_UNIT_ELEMENT", r"2\.", "3.")),
    ("uncertainty_measure_with_unit.WR1", "box", ("UNCERTAINTY_MEASURE_WITH_UNIT", r"1\.E-7", "0.")),
    ("product_definition_formation.UR1", "box", ("", "", "PRODUCT_DEFINITION_FORMATION('',$,#{PRODUCT})")),
    ("product_definition_shape.UR1", "box", ("", "", "PRODUCT_DEFINITION_SHAPE('','',#{PRODUCT_DEFINITION})")),
    ("product_definition_shape.WR1", "box", ("PRODUCT_DEFINITION_SHAPE", r"#\d+", "#{}")),
    ("product_definition_usage.UR1", "pair", (f"{USAGE}[1]", "'2'", "'1'")),
    ("product_definition_usage.WR1", "pair", (USAGE, r"#\d+,(#\d+)", r"\1,\1")),
    (
        "shape_definition_representation.WR1",
        "box",
        ("SHAPE_DEFINITION_REPRESENTATION", r"#\d+", "#{PROPERTY_DEFINITION}"),
    ),
    (
        "shape_definition_representation.WR2",
        "box",
        ("SHAPE_DEFINITION_REPRESENTATION", r"#\d+\)", "#{REPRESENTATION})"),
    ),
    ("shape_representation_relationship.WR1", "pair", (MOVE, r"#\d+,#\d+", "#{REPRESENTATION},#{REPRESENTATION[1]}")),
    (f"{MOVE.lower()}.WR1", "pair", (MOVE, r"(#\d+),#\d+", r"\1,\1")),
    (f"{MOVE.lower()}.WR2", "pair", ("ITEM_DEFINED_TRANSFORMATION", r"(#\d+),(#\d+)", r"\2,\1")),
    (
        "context_dependent_shape_representation.WR1",
        "pair",
        ("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION", r"#\d+\)", "#{PRODUCT_DEFINITION_SHAPE})"),
    ),
    ("founded_item.WR1", "dome", ("", "", "SURFACE_STYLE_FILL_AREA(#{FILL_AREA_STYLE})")),
    (
        "validate_dependently_instantiable_entity_data_types",
        "dome",
        ("", "", "SURFACE_STYLE_FILL_AREA(#{FILL_AREA_STYLE})"),
    ),
    ("colour_rgb.WR1-WR3", "dome", ("COLOUR_RGB", r"1\.0", "255.")),
    ("fill_area_style.WR1", "dome", ("FILL_AREA_STYLE", MEMBER, r"(#\1,#{FILL_AREA_STYLE_COLOUR[1]})")),
    ("surface_side_style.WR1", "dome", ("SURFACE_SIDE_STYLE", MEMBER, r"(#\1,#{SURFACE_STYLE_FILL_AREA[1]})")),
    (
        "presentation_style_assignment.WR1",
        "dome",
        ("PRESENTATION_STYLE_ASSIGNMENT", MEMBER, "(#{FILL_AREA_STYLE},#{FILL_AREA_STYLE[1]})"),
    ),
    (
        "presentation_style_assignment.WR2-WR3",
        "dome",
        ("PRESENTATION_STYLE_ASSIGNMENT", MEMBER, r"(#\1,#{SURFACE_STYLE_USAGE[1]})"),
    ),
    (
        "styled_item.WR1",
        "dome",
        ("STYLED_ITEM", MEMBER, "(#{PRESENTATION_STYLE_ASSIGNMENT},#{PRESENTATION_STYLE_ASSIGNMENT[1]})"),
    ),
    ("styled_item.WR2", "dome", ("STYLED_ITEM", r"#\d+\)$", "#{STYLED_ITEM[1]})")),
    ("styled_item.WR3", "dome", ("STYLED_ITEM", r"#\d+\)$", "#{CLOSED_SHELL})")),
    (f"{SHOWN.lower()}.WR1", "dome", (SHOWN, r"\(#", "(#{ADVANCED_FACE},#")),
    (f"{SHOWN.lower()}.WR4", "dome", ("PRESENTATION_STYLE_ASSIGNMENT", MEMBER, "(#{FILL_AREA_STYLE})")),
    (
        "application_protocol_definition_required",
        "box",
        ("APPLICATION_PROTOCOL_DEFINITION", "automotive_design", "config_control_design"),
    ),
    ("compatible_dimension WR1", "box", (f"{FRAME}>CARTESIAN_POINT", r"\('',.*", "('',(1.,0.))")),
    ("compatible_dimension WR2", "box", ("DIRECTION", r"\('',.*", "('',(1.,0.))")),
    ("dimensionality_is_two_or_three", "box", (SPACE, r"CONTEXT\(3\)", "CONTEXT(4)")),
    (
        "consistent_uncertainty",
        "box",
        ("", "", "UNCERTAINTY_MEASURE_WITH_UNIT(LENGTH_MEASURE(1.),#{LENGTH_UNIT},'distance_accuracy_value',$)"),
        (SPACE, MEMBER, r"(#\1,#{UNCERTAINTY_MEASURE_WITH_UNIT[1]})"),
    ),
    ("dependent_instantiable", "box", ("", "", "COLOUR_RGB('',0.,0.,0.)")),
    ("coordinated_assembly_and_shape", "pair", ("CONTEXT_DEPENDENT_SHAPE_REPRESENTATION", "", "")),
    ("product_requires_category", "box", ("PRODUCT_RELATED_PRODUCT_CATEGORY", "", "")),
    ("product_requires_version", "box", ("", "", "PRODUCT('a','a',$,(#{PRODUCT_CONTEXT}))")),
    ("product_requires_id_owner", "box", ("APPLIED_ORGANIZATION_ASSIGNMENT", "", "")),
    ("product_requires_id_owner", "box", ("ORGANIZATION_ROLE", "id owner", "author")),
    ("restrict_product_category_for_product", "box", ("PRODUCT_RELATED_PRODUCT_CATEGORY", "'part'", "'detail'")),
    (
        "restrict_product_definition_context_for_product WR1",
        "box",
        ("PRODUCT_RELATED_PRODUCT_CATEGORY", "'part'", "'document'"),
    ),
    (
        "restrict_product_definitions_for_product_definition_relationship WR3",
        "pair",
        ("PRODUCT_DEFINITION_CONTEXT", "'part definition'", "'physical occurrence'"),
    ),
    ("subtype_mandatory_colour_specification", "dome", ("COLOUR_RGB", ".*", "COLOUR_SPECIFICATION('red')")),
]
IMPLIED = {f"{SHOWN.lower()}.WR8", f"{SHOWN.lower()}.WR9"}
"""Rules that the table's lack of other side styles and other styles of sides already keeps."""


@pytest.mark.parametrize(("name", "sample", "changes"), [(n, s, c) for n, s, *c in RULE_BREAKS])
def test_a_broken_rule_is_named(name: str, sample: str, changes: list[tuple[str, str, str]]) -> None:
    schemas = next(r.schemas for r in RULES if r.name == name)
    for schema in schemas:
        assert name in [f.split(":")[0] for f in faults(sample, schema, *changes)]


def test_every_rule_can_be_broken() -> None:
    assert {r.name for r in RULES} - {name for name, *_ in RULE_BREAKS} == IMPLIED

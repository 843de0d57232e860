"""A small Part 21 parser and the attribute types of every entity that tpmscad writes, independent of the writer.

The table is taken from the EXPRESS of AP242 (ISO 10303-442, managed_model_based_3d_engineering) and agrees with AP214's for
these entities. Types are checked, references followed to entities of the right type; WHERE rules are not evaluated.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any

TOKEN = re.compile(
    r"\s*(?:(?P<string>'(?:[^']|'')*')|(?P<enum>\.[A-Z_0-9]+\.)|(?P<ref>#\d+)"
    r"|(?P<real>[+-]?\d+\.\d*(?:E[+-]?\d+)?)|(?P<int>[+-]?\d+)|(?P<name>[A-Z][A-Z0-9_]*)|(?P<mark>[()=;,$*]))"
)


@dataclass(frozen=True)
class Value:
    kind: str
    value: Any


@dataclass(frozen=True)
class Instance:
    """Partial entities: one for a simple instance, several for a complex one."""

    parts: dict[str, list[Value]]


def parse(text: str) -> tuple[str, dict[int, Instance]]:
    """The header section's text and the instances of the data section."""
    assert text.startswith("ISO-10303-21;\nHEADER;\n")
    assert text.endswith("ENDSEC;\nEND-ISO-10303-21;\n")
    header, data = text.split("DATA;\n", 1)
    data = data[: data.rindex("ENDSEC;")]
    tokens = tokenise(data)
    instances: dict[int, Instance] = {}
    at = 0

    def take(kind: str, value: str | None = None) -> str:
        nonlocal at
        found = tokens[at]
        assert found[0] == kind, (found, kind)
        assert value is None or found[1] == value, (found, value)
        at += 1
        return found[1]

    def arguments() -> list[Value]:
        nonlocal at
        take("mark", "(")
        values: list[Value] = []
        while tokens[at] != ("mark", ")"):
            if values:
                take("mark", ",")
            values.append(argument())
        take("mark", ")")
        return values

    def argument() -> Value:
        nonlocal at
        kind, value = tokens[at]
        if (kind, value) == ("mark", "("):
            return Value("list", arguments())
        at += 1
        if kind == "name":
            (inner,) = arguments()
            return Value("typed", (value, inner))
        return Value({"$": "unset", "*": "derived"}.get(value, kind), value)

    while at < len(tokens):
        number = int(take("ref")[1:])
        take("mark", "=")
        parts: dict[str, list[Value]] = {}
        if tokens[at] == ("mark", "("):
            at += 1
            while tokens[at] != ("mark", ")"):
                name = take("name")
                parts[name] = arguments()
            at += 1
            assert list(parts) == sorted(parts), "parts of a complex instance come in alphabetical order"
        else:
            name = take("name")
            parts[name] = arguments()
        take("mark", ";")
        assert number not in instances, f"#{number} twice"
        instances[number] = Instance(parts)
    return header, instances


def tokenise(text: str) -> list[tuple[str, str]]:
    tokens, at = [], 0
    while at < len(text.rstrip()):
        match = TOKEN.match(text, at)
        assert match, f"not Part 21: {text[at : at + 60]!r}"
        tokens.append((str(match.lastgroup), match.group(str(match.lastgroup))))
        at = match.end()
    return tokens


SUPERTYPES = {
    "LINE": "CURVE",
    "B_SPLINE_CURVE_WITH_KNOTS": "CURVE",
    "PLANE": "SURFACE",
    "B_SPLINE_SURFACE_WITH_KNOTS": "SURFACE",
    "SURFACE_REPLICA": "SURFACE",
    "FACE_OUTER_BOUND": "FACE_BOUND",
    "CARTESIAN_POINT": "REPRESENTATION_ITEM",
    "AXIS2_PLACEMENT_3D": "REPRESENTATION_ITEM",
    "MANIFOLD_SOLID_BREP": "REPRESENTATION_ITEM",
    "BREP_WITH_VOIDS": "REPRESENTATION_ITEM",
    "ADVANCED_FACE": "REPRESENTATION_ITEM",
    "STYLED_ITEM": "REPRESENTATION_ITEM",
    "MEASURE_REPRESENTATION_ITEM": "REPRESENTATION_ITEM",
    "ADVANCED_BREP_SHAPE_REPRESENTATION": "SHAPE_REPRESENTATION",
    "SHAPE_REPRESENTATION": "REPRESENTATION",
    "GLOBAL_UNIT_ASSIGNED_CONTEXT": "REPRESENTATION_CONTEXT",
    "PRODUCT_DEFINITION_SHAPE": "PROPERTY_DEFINITION",
    "NEXT_ASSEMBLY_USAGE_OCCURRENCE": "PRODUCT_DEFINITION_RELATIONSHIP",
    "LENGTH_UNIT": "NAMED_UNIT",
    "PLANE_ANGLE_UNIT": "NAMED_UNIT",
    "SOLID_ANGLE_UNIT": "NAMED_UNIT",
    "REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION": "REPRESENTATION_RELATIONSHIP",
}

# One word an attribute. S string, I integer, R real, B boolean, *: derived, $: may be unset, <...> a reference, [...] a list.
ATTRIBUTES = {
    "ADVANCED_BREP_SHAPE_REPRESENTATION": "S [<REPRESENTATION_ITEM>] <REPRESENTATION_CONTEXT>",
    "ADVANCED_FACE": "S [<FACE_BOUND>] <SURFACE> B",
    "APPLICATION_CONTEXT": "S",
    "APPLICATION_PROTOCOL_DEFINITION": "S S I <APPLICATION_CONTEXT>",
    "AXIS2_PLACEMENT_3D": "S <CARTESIAN_POINT> <DIRECTION> <DIRECTION>",
    "BREP_WITH_VOIDS": "S <CLOSED_SHELL> [<ORIENTED_CLOSED_SHELL>]",
    "B_SPLINE_CURVE_WITH_KNOTS": "S I [<CARTESIAN_POINT>] .UNSPECIFIED. L L [I] [R] .UNSPECIFIED.",
    "B_SPLINE_SURFACE_WITH_KNOTS": "S I I [[<CARTESIAN_POINT>]] .UNSPECIFIED. L L L [I] [I] [R] [R] .UNSPECIFIED.",
    "CARTESIAN_POINT": "S [R]",
    "CARTESIAN_TRANSFORMATION_OPERATOR_3D": "S S $ <DIRECTION> <DIRECTION> <CARTESIAN_POINT> R <DIRECTION>",
    "CLOSED_SHELL": "S [<ADVANCED_FACE>]",
    "COLOUR_RGB": "S R R R",
    "CONTEXT_DEPENDENT_SHAPE_REPRESENTATION": "<REPRESENTATION_RELATIONSHIP> <PRODUCT_DEFINITION_SHAPE>",
    "DERIVED_UNIT": "[<DERIVED_UNIT_ELEMENT>]",
    "DERIVED_UNIT_ELEMENT": "<NAMED_UNIT> R",
    "DIRECTION": "S [R]",
    "EDGE_CURVE": "S <VERTEX_POINT> <VERTEX_POINT> <CURVE> B",
    "EDGE_LOOP": "S [<ORIENTED_EDGE>]",
    "FACE_BOUND": "S <EDGE_LOOP> B",
    "FACE_OUTER_BOUND": "S <EDGE_LOOP> B",
    "FILL_AREA_STYLE": "S [<FILL_AREA_STYLE_COLOUR>]",
    "FILL_AREA_STYLE_COLOUR": "S <COLOUR_RGB>",
    "GEOMETRIC_REPRESENTATION_CONTEXT": "I",
    "GLOBAL_UNCERTAINTY_ASSIGNED_CONTEXT": "[<UNCERTAINTY_MEASURE_WITH_UNIT>]",
    "GLOBAL_UNIT_ASSIGNED_CONTEXT": "[<NAMED_UNIT>]",
    "ITEM_DEFINED_TRANSFORMATION": "S S <AXIS2_PLACEMENT_3D> <AXIS2_PLACEMENT_3D>",
    "LENGTH_UNIT": "",
    "LINE": "S <CARTESIAN_POINT> <VECTOR>",
    "MANIFOLD_SOLID_BREP": "S <CLOSED_SHELL>",
    "MEASURE_REPRESENTATION_ITEM": "S M <DERIVED_UNIT>",
    "MECHANICAL_DESIGN_GEOMETRIC_PRESENTATION_REPRESENTATION": "S [<STYLED_ITEM>] <REPRESENTATION_CONTEXT>",
    "NAMED_UNIT": "*",
    "NEXT_ASSEMBLY_USAGE_OCCURRENCE": "S S S <PRODUCT_DEFINITION> <PRODUCT_DEFINITION> $",
    "ORIENTED_CLOSED_SHELL": "S * <CLOSED_SHELL> B",
    "ORIENTED_EDGE": "S * * <EDGE_CURVE> B",
    "PLANE": "S <AXIS2_PLACEMENT_3D>",
    "PLANE_ANGLE_UNIT": "",
    "PRESENTATION_STYLE_ASSIGNMENT": "[<SURFACE_STYLE_USAGE>]",
    "PRODUCT": "S S S [<PRODUCT_CONTEXT>]",
    "PRODUCT_CONTEXT": "S <APPLICATION_CONTEXT> S",
    "PRODUCT_DEFINITION": "S S <PRODUCT_DEFINITION_FORMATION> <PRODUCT_DEFINITION_CONTEXT>",
    "PRODUCT_DEFINITION_CONTEXT": "S <APPLICATION_CONTEXT> S",
    "PRODUCT_DEFINITION_FORMATION": "S S <PRODUCT>",
    "PRODUCT_DEFINITION_SHAPE": "S S <PRODUCT_DEFINITION|PRODUCT_DEFINITION_RELATIONSHIP>",
    "PRODUCT_RELATED_PRODUCT_CATEGORY": "S $ [<PRODUCT>]",
    "PROPERTY_DEFINITION": "S S <PRODUCT_DEFINITION_SHAPE>",
    "PROPERTY_DEFINITION_REPRESENTATION": "<PROPERTY_DEFINITION> <REPRESENTATION>",
    "REPRESENTATION": "S [<REPRESENTATION_ITEM>] <REPRESENTATION_CONTEXT>",
    "REPRESENTATION_CONTEXT": "S S",
    "REPRESENTATION_RELATIONSHIP": "S S <REPRESENTATION> <REPRESENTATION>",
    "REPRESENTATION_RELATIONSHIP_WITH_TRANSFORMATION": "<ITEM_DEFINED_TRANSFORMATION>",
    "SHAPE_DEFINITION_REPRESENTATION": "<PROPERTY_DEFINITION> <SHAPE_REPRESENTATION>",
    "SHAPE_REPRESENTATION": "S [<REPRESENTATION_ITEM>] <REPRESENTATION_CONTEXT>",
    "SHAPE_REPRESENTATION_RELATIONSHIP": "",
    "SI_UNIT": "P U",
    "SOLID_ANGLE_UNIT": "",
    "STYLED_ITEM": "S [<PRESENTATION_STYLE_ASSIGNMENT>] <REPRESENTATION_ITEM>",
    "SURFACE_REPLICA": "S <SURFACE> <CARTESIAN_TRANSFORMATION_OPERATOR_3D>",
    "SURFACE_SIDE_STYLE": "S [<SURFACE_STYLE_FILL_AREA>]",
    "SURFACE_STYLE_FILL_AREA": "<FILL_AREA_STYLE>",
    "SURFACE_STYLE_USAGE": ".BOTH. <SURFACE_SIDE_STYLE>",
    "UNCERTAINTY_MEASURE_WITH_UNIT": "M <NAMED_UNIT> S S",
    "VECTOR": "S <DIRECTION> R",
    "VERTEX_POINT": "S <CARTESIAN_POINT>",
}  # fmt: skip

MEASURES = {"LENGTH_MEASURE", "AREA_MEASURE", "VOLUME_MEASURE"}


def kinds(instance: Instance) -> set[str]:
    found = set(instance.parts)
    for name in list(found):
        while name in SUPERTYPES:
            name = SUPERTYPES[name]
            found.add(name)
    return found


def faults(instances: dict[int, Instance]) -> list[str]:
    """What is wrong with the instances, by the table: empty for a conforming file."""
    found = []
    for number, instance in instances.items():
        for name, values in instance.parts.items():
            if name not in ATTRIBUTES:
                found.append(f"#{number} {name} is not in the table")
                continue
            wanted = ATTRIBUTES[name].split()
            if len(wanted) != len(values):
                found.append(f"#{number} {name} has {len(values)} attributes, not {len(wanted)}")
                continue
            for want, value in zip(wanted, values, strict=True):
                if not fits(want, value, instances):
                    found.append(f"#{number} {name}: {value} is no {want}")
    return found


def fits(want: str, value: Value, instances: dict[int, Instance]) -> bool:
    if want.startswith("["):
        return (
            value.kind == "list" and len(value.value) > 0 and all(fits(want[1:-1], v, instances) for v in value.value)
        )
    if want.startswith("<"):
        number = int(value.value[1:]) if value.kind == "ref" else -1
        return number in instances and bool(kinds(instances[number]) & set(want[1:-1].split("|")))
    if want.startswith("."):
        return value.kind == "enum" and value.value == want
    if want == "M":
        return value.kind == "typed" and value.value[0] in MEASURES and value.value[1].kind == "real"
    simple = {"S": "string", "I": "int", "R": "real", "*": "derived", "$": "unset"}
    if want in simple:
        return value.kind == simple[want]
    choices = {"B": {".T.", ".F."}, "L": {".T.", ".F.", ".U."}, "U": {".METRE.", ".RADIAN.", ".STERADIAN."}}
    if want == "P":
        return value.kind == "unset" or value.value == ".MILLI."
    return value.kind == "enum" and value.value in choices[want]


def of_kind(instances: dict[int, Instance], name: str) -> dict[int, list[Value]]:
    return {number: i.parts[name] for number, i in instances.items() if name in i.parts}


def numbers(value: Value) -> list[int]:
    return [int(v.value[1:]) for v in value.value]

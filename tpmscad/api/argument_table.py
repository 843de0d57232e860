"""The arguments of all public functions, declared once: their names, and what each takes.

One word has one meaning, so that an argument is declared by its name alone. Where a function gives a word a meaning of its own,
the entry begins with the function: "linear.offset". What no table can know (whether a surface is of the catalogue, whether
keywords fit each other) is checked by the function.
"""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from types import MappingProxyType

import numpy as np

from tpmscad.api.argument_kinds import (
    POINT,
    ArgumentKind,
    Refusal,
    WrongType,
    array_kind,
    choice_of,
    instance_of,
    one_or_three,
    read_array,
    read_callable,
    read_corners,
    read_count,
    read_direction,
    read_field,
    read_iterable,
    read_not_negative,
    read_number,
    read_path,
    read_positive,
    read_shape,
    read_unbounded_number,
    read_whole,
    sequence_of,
    tuple_of,
)

NUMBER = ArgumentKind("a number", "0.5", read_number)
POSITIVE = ArgumentKind("a positive number", "1.0", read_positive)
NOT_NEGATIVE = ArgumentKind("a number of at least 0", "0.1", read_not_negative)
COUNT = ArgumentKind("a whole number of at least 1", "2", read_count)
COUNTS = tuple_of(read_count, 3, "three whole numbers", "(40, 40, 40)")
LENGTHS = one_or_three(read_positive, "a positive number", "10.0")
PAIR = tuple_of(read_number, 2, "two numbers", "(0.0, 1.0)")
DIRECTION = ArgumentKind('an axis such as "x" or "-y", or a vector of three numbers', '"z"', read_direction)
BOX = ArgumentKind("two corners ((x0, y0, z0), (x1, y1, z1))", "((0, 0, 0), (10, 10, 10))", read_corners)
FIELD = ArgumentKind("a field, a function of points (..., 3), or a number", "fields.tpms('gyroid', 10)", read_field)
FIELDS = sequence_of(read_field, "a sequence of fields", "[fields.tpms('gyroid'), fields.tpms('diamond')]")
FUNCTION = ArgumentKind("a function of points (..., 3)", "lambda p: p[..., 0]", read_callable)
FLAG = instance_of("True or False", "True", bool)
TEXT = instance_of("text", '"gyroid"', str)
PATH = ArgumentKind("the path of a file", '"part.step"', read_path)
SHAPE = ArgumentKind("a build123d or CadQuery shape, or the path of a STEP file", '"part.step"', read_shape)
ANYTHING = ArgumentKind("anything", "", lambda value: value)
POINTS = ArgumentKind("an array of points (..., 3)", "(0.0, 0.0, 0.0)", read_array)
GRID_AXIS = ArgumentKind("a one-dimensional array of coordinates", "np.linspace(0, 10, 50)", read_array)
VALUES = array_kind("finite samples in an array of three dimensions", "np.zeros((9, 9, 9))", 3)
KNOTS = tuple_of(array_kind("numbers", "[0, 0, 1, 1]", 1).read, 3, "three knot vectors", "([0, 0, 1, 1],) * 3")
SIZES = tuple_of(array_kind("numbers", "(0, 40)", 1).read, 2, "positions and cell sizes there", "((0, 40), (4, 8))")


def _read_fraction(value: object) -> float:
    """A number between 0 and 1."""
    number = read_positive(value)
    if number >= 1:
        raise Refusal("must lie below 1")
    return number


def _read_record(value: object) -> object:
    """A record of the catalogue, known by what is read from it."""
    if not hasattr(value, "references"):
        raise Refusal("is no record of the catalogue")
    return value


def _read_weight(value: object) -> object:
    """A word, or a specification of a weight, known by its degree."""
    if not isinstance(value, str) and not hasattr(value, "degree"):
        raise WrongType("is no specification of a weight")
    return value


def _read_mask(value: object) -> object:
    """An array of bools."""
    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        raise Refusal("is no array of one shape") from None
    if array.dtype != bool:
        raise Refusal(f"holds {array.dtype}, not bool: compare the picture with a threshold, image < 128")
    return array


def _read_axis_number(value: object) -> int:
    """0, 1 or 2."""
    number = read_whole(value)
    if number not in (0, 1, 2):
        raise Refusal("is none of 0, 1 and 2")
    return number


def _read_flow(value: object) -> dict[str, str]:
    """A mapping of text to text."""
    if not isinstance(value, Mapping) or not all(isinstance(each, str) for pair in value.items() for each in pair):
        raise WrongType("is no dictionary of names and sides")
    return dict(value)


def _read_refinement(value: object) -> int | tuple[int, int]:
    """Cuts in all directions, or along a wall and through it."""
    if isinstance(value, list | tuple) and len(value) == 2:
        along, through = (read_whole(v) for v in value)
        least, result = min(along, through), (along, through)
    else:
        least = result = read_whole(value)
    if least < 0:
        raise Refusal("must be at least 0")
    return result


def _read_overhang(value: object) -> float:
    """An angle from vertical to horizontal."""
    angle = read_not_negative(value)
    if angle > 90:
        raise Refusal("is more than 90 degrees, a horizontal ceiling")
    return angle


def _read_domain(value: object) -> object:
    """The corners of a box, or a body."""
    return read_corners(value) if isinstance(value, list | tuple | np.ndarray) else read_shape(value)


DOMAIN = ArgumentKind(f"{BOX.text}, or {SHAPE.text}", BOX.example, _read_domain)
WEIGHT = ArgumentKind("a word, a LineWeightSpec or a VolumeWeightSpec", '"auto"', _read_weight)
FRACTION = ArgumentKind("a number between 0 and 1", "0.3", _read_fraction)
OFFSET = NUMBER.or_else(tuple_of(read_number, 2, "two numbers, the lower first", "")).but(example="(-0.5, 0.5)")
WALL_THICKNESS = ArgumentKind(
    f"{POSITIVE.text}, or {FUNCTION.text}", "1.0", lambda value: value if callable(value) else read_positive(value)
)
NAME_OR_FIELD = TEXT.or_else(ArgumentKind("a field or a function of points", "", read_callable))
ARRAY_OR_PATH = PATH.or_else(VALUES).but(
    "the path of an image, or an array of samples in three dimensions", VALUES.example
)
POINT_ROWS = array_kind("an array of points (n, 3)", "np.random.rand(50, 3)", 2)
POINT_TABLE = PATH.or_else(POINT_ROWS).but(
    "the path of a CSV file, or an array of points (n, 3)", "np.random.rand(50, 3)"
)

ARGUMENTS: Mapping[str, ArgumentKind] = MappingProxyType(
    {
        # lattices, infills, domains
        "surface": TEXT,
        "infill.surface": NAME_OR_FIELD,
        "TpmsInfill.surface": ANYTHING,
        "tpmsInfill.surface": NAME_OR_FIELD,
        "body": SHAPE,
        "TpmsInfill.body": ANYTHING,
        "cell": LENGTHS,
        "cells": one_or_three(read_count, "a whole number of at least 1", "(2, 2, 2)"),
        "thickness": POSITIVE,
        "lattice.thickness": WALL_THICKNESS,
        "Tpms.thickness": WALL_THICKNESS,
        "tpms.thickness": WALL_THICKNESS,
        "offset": OFFSET,
        "volume_fraction": FRACTION,
        "porosity": FRACTION,
        "pore_size": POSITIVE,
        "kind": choice_of("sheet", "skeletal"),
        "side": choice_of("-", "+"),
        "reference": TEXT.but(example='"nodal"'),
        "boundary": choice_of("box", "natural"),
        "phase": POINT,
        "rotation": POINT.but("three angles in degrees", "(0, 0, 45)"),
        "skin": POSITIVE,
        "open_faces": ArgumentKind("faces, their numbers, or text such as '>Z'", '">Z"', read_iterable),
        "loose": choice_of("drop", "keep"),
        "map": ArgumentKind("one of tpmscad.maps or a function of points", "maps.cylinder(20)", read_callable),
        "tol": POSITIVE.but(example="0.01"),
        "coordinate": ANYTHING,
        "direction": POINT,
        "count": COUNT,
        "degree": COUNT,
        "VolumeWeightSpec.count": COUNTS,
        "VolumeWeightSpec.degree": COUNTS.but(example="(3, 3, 3)"),
        "SphereRadius.centre": POINT,
        "progress": FLAG.or_else(ArgumentKind("a function of a stage and a fraction", "", read_callable)),
        "slab": one_or_three(read_count, "a whole number of at least 1", "(20, 20, 1)"),
        "homogenize.surface": TEXT.or_else(ANYTHING),
        "elements": choice_of("hexahedra", "tetrahedra"),
        "homogenize.size": POSITIVE.but(example="0.05"),
        "channel": ANYTHING,
        "permeability.size": POSITIVE.but(example="0.8"),
        "estimate_flow.channel": ANYTHING.but("the name of a surface, or fluid domains", '"gyroid"'),
        "estimate_flow.cell": POSITIVE.but(example="8.0"),
        "density": POSITIVE.but("a positive number, kg/m3", "998.0"),
        "viscosity": POSITIVE.but("a positive number, Pa s", "0.001"),
        "conductivity": POSITIVE.but("a positive number, W/(m K)", "0.6"),
        "specific_heat": POSITIVE.but("a positive number, J/(kg K)", "4180.0"),
        "volume_flow": POSITIVE.but("a positive number, m3/s", "1e-5"),
        "cross_section": POSITIVE.but("a positive number, mm2", "1024.0"),
        "permeability": POSITIVE.but("a positive number, mm2", "0.05"),
        "shift": NUMBER,
        "design_derivatives.cell": POSITIVE.but(example="10.0"),
        "elastic": FLAG,
        "youngs_modulus": POSITIVE.but(example="1.0"),
        "poisson_ratio": NOT_NEGATIVE.but(example="0.3"),
        "directions": POINTS,
        "mesh.size": POSITIVE.but(example="0.5"),
        "mesh_step.size": POSITIVE.but(example="0.5"),
        "order": COUNT,
        "periodic": FLAG,
        "per_turn": COUNT.but(example="12"),
        "version": choice_of("4.1", "2.2"),
        "folder": PATH.but("the path of a folder", '"case"'),
        "flow": ArgumentKind("sides by the names of groups", '{"channel +": "X+"}', _read_flow),
        "velocity": POSITIVE.but(example="0.01"),
        "time_stamp": TEXT.but(example='"2026-01-31T12:00:00"'),
        "executor": instance_of("an executor of concurrent.futures", "ProcessPoolExecutor(4)", Executor),
        "table": ANYTHING,
        "output": PATH.but(example='"results.csv"'),
        "metrics": FLAG,
        "properties": FLAG,
        "plot.x": TEXT.but(example='"porosity"'),
        "plot.y": TEXT.but(example='"E1"'),
        "plot.by": TEXT.but(example='"surface"'),
        "ax": ANYTHING,
        "Tpms.rotation": ANYTHING,
        "align": ANYTHING,
        "mode": ANYTHING,
        "self": ANYTHING,
        "centered": ANYTHING,
        "combine": ANYTHING,
        "clean": FLAG,
        # solids of fields, blends
        "field": FIELD,
        "domain": BOX,
        "solidify.domain": DOMAIN,
        "preview_solid.domain": DOMAIN,
        "structures": FIELDS,
        "regions": FIELDS,
        "blending_regions": FIELDS,
        "method": TEXT.but(example='"topological"'),
        "weight": WEIGHT.or_else(sequence_of(WEIGHT.read, "a sequence of these", "")),
        "resolution": COUNTS,
        "max_iterations": ArgumentKind("a whole number", "60", read_whole),
        "minimum_neck": POSITIVE,
        "max_change": NUMBER.but(example="1.0"),
        "keep_fraction": FLAG,
        "level_margin": NOT_NEGATIVE,
        "drop_intrinsic": FLAG,
        "specks": FLAG,
        # bodies, files, pictures
        "shape": SHAPE,
        "spacing": POSITIVE,
        "model": ANYTHING,
        "source": ANYTHING,
        "within": ANYTHING,
        "is_fluid": FLAG,
        "path": PATH,
        "picture": PATH.but(example='"part.png"'),
        "schema": TEXT.but(example='"ap242"'),
        "verify": choice_of("kernel"),
        "hexahedra.order": COUNT,
        "refine": ArgumentKind("a whole number of at least 0, or two of them", "1", _read_refinement),
        "serendipity": FLAG,
        "deviation": NUMBER.but(example="0.02"),
        "angle": NUMBER.but(example="20"),
        "chord_error": POSITIVE.but(example="0.01"),
        "min_wall": POSITIVE.but(example="0.3"),
        "min_gap": POSITIVE.but(example="0.3"),
        "max_overhang": ArgumentKind("an angle of 0 to 90 degrees", "45", _read_overhang),
        "build_direction": DIRECTION,
        "instanced": FLAG,
        "view": TEXT.or_else(POINT).but(example='"iso"'),
        "section": ANYTHING,
        "size": tuple_of(read_count, 2, "two whole numbers, width and height", "(1200, 900)"),
        "color_by": TEXT.but(example='"piece"'),
        "hide": TEXT.or_else(sequence_of(TEXT.read, "several", "")).but(example='"skin"'),
        # fields
        "lo": POINT,
        "hi": POINT,
        "box.lo": tuple_of(read_unbounded_number, 3, "three numbers, which may be infinite", "(0, 0, 0)"),
        "box.hi": tuple_of(read_unbounded_number, 3, "three numbers, which may be infinite", "(10, 10, 10)"),
        "sheet.lo": FIELD.but(example="-0.3"),
        "sheet.hi": FIELD.but(example="0.3"),
        "image_region.lo": array_kind("two or three numbers", "(0, 0)", 1),
        "image_region.hi": array_kind("two or three numbers", "(20, 20)", 1),
        "image_region.axis": choice_of("x", "y", "z"),
        "mask": ArgumentKind("an array of bools", "np.eye(4) > 0", _read_mask),
        "center": POINT,
        "radius": POSITIVE.but("a positive, finite number", "5.0"),
        "height": POSITIVE,
        "point": POINT,
        "normal": DIRECTION,
        "axis": DIRECTION,
        "origin": POINT,
        "slope": POINT,
        "linear.offset": NUMBER,
        "by": TEXT.or_else(FIELD).but('"x", "y", "z" or a field', '"x"'),
        "span": PAIR,
        "ramp.values": PAIR,
        "smooth": FLAG,
        "phi": FIELD,
        "c": FIELD.but(example="-0.4"),
        "wall.thickness": POSITIVE.or_else(FUNCTION),
        "fields": FIELD,
        "taken": FIELD,
        "first": FIELD,
        "second": FIELD,
        "width": POSITIVE,
        "vector": POINT,
        "factor": POSITIVE,
        "jacobian": FUNCTION.but("a function of points (n, 3) that returns (n, 3, 3)"),
        "step": POSITIVE.but(example="0.001"),
        "f": ArgumentKind("a function of points (n, 3) or of x, y, z", "lambda x, y, z: x", read_callable),
        "gradient": FUNCTION,
        "as_field.source": FIELD,
        "value": NUMBER,
        "name": TEXT,
        "period": LENGTHS,
        "expression.period": POSITIVE,
        "formula": TEXT.but(example='"sin(x) + 0.2*z"'),
        "named": FIELD,
        "coefficients": VALUES,
        "x": SIZES,
        "y": SIZES,
        "z": SIZES,
        "fraction": FIELD.but(example="0.3"),
        "threshold_for.kind": choice_of("rod", "pore", "sheet"),
        "graded_threshold.kind": choice_of("rod", "pore", "sheet"),
        "level": NUMBER.but(example="0.0"),
        "samples": COUNT.but(example="96"),
        "sampled.values": ARRAY_OR_PATH,
        "sampled.spacing": LENGTHS,
        "points": POINT_ROWS,
        "scattered.points": POINT_TABLE,
        "scattered.values": array_kind("an array (n,), a value for each point", "np.zeros(50)", 1),
        "scattered.resolution": one_or_three(read_count, "a whole number of at least 1", "40"),
        "smoothing": NOT_NEGATIVE,
        # maps
        "jacobian_function": FUNCTION,
        "from_middle": ANYTHING,
        "function": FUNCTION.but(example="lambda p: p"),
        "outer": FUNCTION.but("one of tpmscad.maps", "maps.cylinder(20)"),
        "inner": FUNCTION.but("one of tpmscad.maps", "maps.stretching((1, 1, 2))"),
        "scale": POSITIVE,
        "grading.scale": FUNCTION.or_else(tuple_of(read_positive, 2, "two positive numbers", "")).but(
            example="(1.0, 2.0)"
        ),
        "grading.axis": ArgumentKind("0, 1 or 2", "2", _read_axis_number),
        "length": POSITIVE.but(example="40.0"),
        "factors": tuple_of(read_positive, 3, "three positive, finite numbers, one for each axis", "(1.0, 1.0, 2.0)"),
        "poles": array_kind("a control net (U, V, W, 3) of finite numbers", "np.random.rand(4, 4, 4, 3)", 4),
        "knots": KNOTS,
        "degrees": tuple_of(read_count, 3, "three whole numbers of at least 1", "(3, 3, 3)"),
        "face_a": ANYTHING,
        "face_b": ANYTHING,
        "chart": choice_of("pole", "equator"),
        "centre": tuple_of(read_number, 2, "two numbers", "(0.0, 0.0)"),
        # surfaces
        "check_offset.offset": NUMBER,
        "check_offset.cell": POSITIVE,
        "offsets_for.cell": POSITIVE,
        "skeletal_volume_fraction.offset": NUMBER,
        "lower": NUMBER,
        "upper": NUMBER,
        "record": ArgumentKind("a record of the catalogue", "fields.TPMS['gyroid']", _read_record),
        # topology, whose functions check their samples once
        "values": ANYTHING,
        "dimension": ArgumentKind("0 or 2", "0", read_whole),
        "convention": choice_of("vertices", "top_cells", "strict"),
        "field_or_values": ANYTHING,
        "persistence_diagram.domain": BOX,
        "persistence_diagram.resolution": one_or_three(read_count, "a whole number of at least 1", "40"),
        "dimensions": sequence_of(read_whole, "some of 0, 1 and 2", "(0, 1, 2)"),
        "sublevel": FLAG,
        "min_persistence": NOT_NEGATIVE,
    }
)
"""What each argument takes, by its name, or by the names of the function and the argument."""


def find_kind(function: str, argument: str) -> ArgumentKind:
    """The kind of an argument of a function; LookupError if the table lacks it."""
    found = ARGUMENTS.get(f"{function}.{argument}") or ARGUMENTS.get(argument)
    if found is None:
        raise LookupError(f"declare what {argument} of {function} takes in tpmscad.api.argument_table")
    return found

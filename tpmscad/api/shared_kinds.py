"""The kinds that arguments share: numbers, points, fields, files and shapes, by name.

An argument is declared as the annotation of a parameter, `radius: Annotated[float, POSITIVE, "Radius, model units."]`.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence

from tpmscad.api.argument_kinds import (
    POINT,
    ArgumentKind,
    InvalidValue,
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
    restrict,
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
SHAPE = ArgumentKind("a build123d or CadQuery shape, or the path of a CAD file", '"part.step"', read_shape)
MESH = ArgumentKind("the path of a triangle mesh, or an object that holds one", '"part.stl"', read_shape)
ANYTHING = ArgumentKind("anything", "", lambda value: value)
POINTS = ArgumentKind("an array of points (..., 3)", "(0.0, 0.0, 0.0)", read_array)
GRID_AXIS = ArgumentKind("a one-dimensional array of coordinates", "np.linspace(0, 10, 50)", read_array)
VALUES = array_kind("finite samples in an array of three dimensions", "np.zeros((9, 9, 9))", 3)
KNOTS = tuple_of(array_kind("numbers", "[0, 0, 1, 1]", 1).read, 3, "three knot vectors", "([0, 0, 1, 1],) * 3")
SIZES = tuple_of(array_kind("numbers", "(0, 40)", 1).read, 2, "positions and cell sizes there", "((0, 40), (4, 8))")


def _read_record(value: object) -> object:
    """A record of the catalogue, known by what is read from it."""
    if not hasattr(value, "references"):
        raise InvalidValue("is no record of the catalogue")
    return value


def _read_mask(value: object) -> object:
    """An array of bools."""
    import numpy as np

    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        raise InvalidValue("is no array of one shape") from None
    if array.dtype != bool:
        raise InvalidValue(f"holds {array.dtype}, not bool: compare the picture with a threshold, image < 128")
    return array


def _read_flow(value: object) -> dict[str, str]:
    """A mapping of text to text."""
    if not isinstance(value, Mapping) or not all(isinstance(each, str) for pair in value.items() for each in pair):
        raise WrongType("is no dictionary of names and sides")
    return dict(value)


def _read_openings(value: object) -> dict[str, object]:
    """A mapping of "+" and "-" to faces; or text, the channels one after the other with a semicolon between them."""
    if isinstance(value, str):
        value = parse_openings(value.split(";"))
    if not isinstance(value, Mapping):
        raise WrongType("is no dictionary of channels and faces")
    unknown = [sign for sign in value if sign not in ("+", "-")]
    if unknown:
        raise InvalidValue(f"names a channel {unknown[0]!r}, and the channels are '+' and '-'")
    return {sign: read_iterable(faces) for sign, faces in value.items()}


def parse_openings(texts: Sequence[str]) -> dict[str, str]:
    """The faces of each channel of texts such as +=<X,>X."""
    found: dict[str, list[str]] = {}
    for text in texts:
        channel, equals, faces = text.partition("=")
        if not (equals and faces.strip()) or channel.strip() not in ("+", "-"):
            raise InvalidValue(f"names no channel with its faces in {text!r}: write '+=<X,>X' or '-=<Y,>Y'")
        found.setdefault(channel.strip(), []).append(faces.strip())
    return {channel: ",".join(faces) for channel, faces in found.items()}


def _read_pairs(value: object) -> object:
    """An array (m, 2) of whole numbers."""
    import numpy as np

    array = np.asarray(value)
    if array.ndim != 2 or array.shape[1] != 2 or not len(array):
        raise InvalidValue(f"of shape {array.shape} must be pairs of whole numbers (m, 2)")
    if array.dtype.kind not in "iu":
        raise WrongType(f"holds {array.dtype}, no whole numbers")
    return array


def _read_end_values(value: object) -> object:
    """An array (n,) or (n, 2) of positive numbers."""
    import numpy as np

    array = read_array(value)
    if array.ndim not in (1, 2) or array.shape[1:] not in ((), (2,)):
        raise InvalidValue(f"of shape {array.shape} must have one value or two for each edge, (m,) or (m, 2)")
    wrong = np.argwhere(~(array > 0) | ~np.isfinite(array))
    if len(wrong):
        raise InvalidValue(f"holds {array[tuple(wrong[0])]:g} at index {wrong[0][0]}, and must be positive throughout")
    return array


def _read_refinement(value: object) -> int | tuple[int, int]:
    """Cuts in all directions, or along a wall and through it."""
    if isinstance(value, list | tuple) and len(value) == 2:
        along, through = (read_whole(v) for v in value)
        least, result = min(along, through), (along, through)
    else:
        least = result = read_whole(value)
    if least < 0:
        raise InvalidValue("must be at least 0")
    return result


def _read_domain(value: object) -> object:
    """The corners of a box, or a body."""
    return read_corners(value) if isinstance(value, list | tuple) or hasattr(value, "ndim") else read_shape(value)


ANGLE = ArgumentKind(
    "a positive angle in degrees", "20.0", restrict(read_positive, lambda angle: angle < 90, "is no acute angle")
)
DOMAIN = ArgumentKind(f"{BOX.text}, or {SHAPE.text}", BOX.example, _read_domain)
FRACTION = ArgumentKind(
    "a number between 0 and 1", "0.3", restrict(read_positive, lambda number: number < 1, "must lie below 1")
)
OFFSET = NUMBER.or_else(tuple_of(read_number, 2, "two numbers, the lower first", "")).described_as(
    example="(-0.5, 0.5)"
)
OVERHANG = ArgumentKind(
    "an angle of 0 to 90 degrees",
    "45",
    restrict(read_not_negative, lambda angle: angle <= 90, "is more than 90 degrees, a horizontal ceiling"),
)
WALL_THICKNESS = ArgumentKind(
    f"{POSITIVE.text}, or {FUNCTION.text}", "1.0", lambda value: value if callable(value) else read_positive(value)
)


def _or_graded(kind: ArgumentKind) -> ArgumentKind:
    """A kind that takes functions of points and formulas as text, too."""
    text = f"{kind.text}, {FUNCTION.text}, or a formula of x, y and z as text"
    return ArgumentKind(text, kind.example, lambda v: v if callable(v) or names_coordinate(v) else kind.read(v))


def names_coordinate(value: object) -> bool:
    """Whether a value is text that names x, y or z, by which the formula of a grading is known."""
    return isinstance(value, str) and re.search(r"\b[xyzXYZ]\b", value) is not None


GRADED_THICKNESS, GRADED_FRACTION = _or_graded(POSITIVE), _or_graded(FRACTION)
GRADED_OFFSET = (
    _or_graded(NUMBER)
    .or_else(tuple_of(_or_graded(NUMBER).read, 2, "two of them, the lower first", ""))
    .described_as(example="(-0.5, 0.5)")
)
LABEL = ArgumentKind("a whole number", "1", read_whole).or_else(
    sequence_of(read_whole, "several", "").or_else(choice_of("all")).described_as('several, or "all"')
)
WHOLE_NUMBER = ArgumentKind("a whole number", "60", read_whole)
INDEX = ArgumentKind(
    "a whole number of at least 0", "0", restrict(read_whole, lambda number: number >= 0, "must be at least 0")
)
REFINEMENT = ArgumentKind("a whole number of at least 0, or two of them", "1", _read_refinement)
AXIS_NUMBER = ArgumentKind(
    "0, 1 or 2", "2", restrict(read_whole, lambda number: number in (0, 1, 2), "is none of 0, 1 and 2")
)
DIMENSIONS = sequence_of(read_whole, "some of 0, 1 and 2", "(0, 1, 2)")
CELL_COUNTS = one_or_three(read_count, "a whole number of at least 1", "(2, 2, 2)")
DEGREES = tuple_of(read_count, 3, "three whole numbers of at least 1", "(3, 3, 3)")
FACTORS = tuple_of(read_positive, 3, "three positive, finite numbers, one for each axis", "(1.0, 1.0, 2.0)")
SCALE = FUNCTION.or_else(tuple_of(read_positive, 2, "two positive numbers", "")).described_as(example="(1.0, 2.0)")
PICTURE_SIZE = tuple_of(read_count, 2, "two whole numbers, width and height", "(1200, 900)")
UNBOUNDED_POINT = tuple_of(read_unbounded_number, 3, "three numbers, which may be infinite", "(0, 0, 0)")
PAIR_OR_TRIPLE = array_kind("two or three numbers", "(0, 0)", 1)
POINT_ROWS = array_kind("an array of points (n, 3)", "np.random.rand(50, 3)", 2)
PAIR_ROWS = ArgumentKind("pairs of whole numbers (m, 2)", "[[0, 1], [1, 2]]", _read_pairs)
END_VALUES = ArgumentKind("an array of positive numbers, (m,) or (m, 2)", "[1.0, 0.8]", _read_end_values)
POINT_VALUES = array_kind("an array (n,), a value for each point", "np.zeros(50)", 1)
CONTROL_NET = array_kind("a control net (U, V, W, 3) of finite numbers", "np.random.rand(4, 4, 4, 3)", 4)
MASK = ArgumentKind("an array of bools", "np.eye(4) > 0", _read_mask)
POINT_TABLE = PATH.or_else(POINT_ROWS).described_as(
    "the path of a CSV file, or an array of points (n, 3)", "np.random.rand(50, 3)"
)


def _read_samples(value: object) -> object:
    """An array of VALUES, or of bools, in its own type: integers may be labels. NaN is a value that is missing."""
    import numpy as np

    try:
        array = np.asarray(value)
    except (TypeError, ValueError):
        raise InvalidValue("is no array of numbers of one shape") from None
    if array.dtype.kind == "f":
        VALUES.read(np.where(np.isnan(array), 0.0, array))
    else:
        VALUES.read(array.view(np.uint8) if array.dtype == bool else array)
    return array


SAMPLES = ArgumentKind("samples in an array of three dimensions", VALUES.example, _read_samples)
ARRAY_OR_PATH = PATH.or_else(SAMPLES).described_as(
    "the path of an image, or an array of samples in three dimensions", VALUES.example
)
FUNCTION_OF_POINTS_OR_XYZ = ArgumentKind(
    "a function of points (n, 3) or of x, y, z", "lambda x, y, z: x", read_callable
)
NAME_OR_FIELD = TEXT.or_else(ArgumentKind("a field or a function of points", "", read_callable))
MAP = ArgumentKind("one of tpmscad.maps or a function of points", "maps.cylinder(20)", read_callable)
FACES = ArgumentKind("faces, their numbers, or text such as '>Z'", '">Z"', read_iterable)
OPENINGS = ArgumentKind(
    "faces by the channels '+' and '-', or text such as '+=<X,>X; -=<Y,>Y'",
    '{"+": ["<X", ">X"], "-": ["<Y", ">Y"]}',
    _read_openings,
)
VIEW = TEXT.or_else(POINT).described_as(example='"iso"')
TEXTS = TEXT.or_else(sequence_of(TEXT.read, "several", ""))
FLOW = ArgumentKind("sides by the names of groups", '{"channel +": "X+"}', _read_flow)
RECORD = ArgumentKind("a record of the catalogue", "fields.TPMS['gyroid']", _read_record)
PROGRESS = FLAG.or_else(ArgumentKind("a function of a stage and a fraction", "", read_callable))

ONE_SOLID = COUNT.or_else(choice_of("largest")).described_as('the number of a solid from 1, or "largest"', '"largest"')
SOLID = COUNT.or_else(choice_of("largest", "all")).described_as(
    'the number of a solid from 1, "largest" or "all"', '"largest"'
)


def _read_executor(value: object) -> object:
    """An executor of concurrent.futures, known by what it does; Dask's is another class."""
    if not callable(getattr(value, "submit", None)) or not callable(getattr(value, "shutdown", None)):
        raise WrongType("must be an executor of concurrent.futures")
    return value


EXECUTOR = ArgumentKind("an executor of concurrent.futures", "ProcessPoolExecutor(4)", _read_executor)

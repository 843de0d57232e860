"""Recipes: the same fields and blends as in Python, and whatever is wrong told with file, line and key."""

from __future__ import annotations

import inspect
import pickle
import tomllib
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from PIL import Image

import tpmscad
from tpmscad import fields
from tpmscad.api.argument_kinds import POINT
from tpmscad.api.arguments import arguments_of
from tpmscad.api.public_calls import validate_call
from tpmscad.api.shared_kinds import FIELD, POSITIVE
from tpmscad.errors import NotMet, RecipeError
from tpmscad.recipe.blend_recipe import read_blend_recipe
from tpmscad.recipe.field_kinds import CONVENIENCES, field_kinds
from tpmscad.recipe.key_lines import find_key_lines
from tpmscad.recipe.recipe_keys import keys_of
from tpmscad.recipe.recipe_runs import SolidRun, run_blend_recipe
from tpmscad.recipe.solid_recipe import read_solid_recipe

POINTS = np.random.default_rng(3).uniform(-12, 12, (300, 3))
EXAMPLES = Path(__file__).parents[2] / "examples"

TRICKY = r"""
a = 1 # b = 2
"b c".d = [1,
  [2, 3], # ]
  "x]", 'y#]']
[t.u]
k = { p = 1, "q.r" = [ { s = 2 } ] }
m = '''[[not a table]]
n = 1 '''
o = '''''one''''' # "
p = "\"]"
q = 1979-05-27 07:32:00
[[arr]]
x = 1
[[arr]]
[arr.sub]
y = 2
[[arr.deep]]
[[arr.deep]]
z = inf
[t]
v = true
"""


def paths(value: Any, above: tuple[str | int, ...] = ()) -> Iterator[tuple[str | int, ...]]:
    items = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in items:
        yield (*above, key)
        yield from paths(inner, (*above, key))


class TestLines:
    def test_every_key_of_a_document_has_its_line(self) -> None:
        lines = find_key_lines(TRICKY)
        assert set(lines) == set(paths(tomllib.loads(TRICKY)))
        assert [lines["b c", "d", 2], lines["t", "u", "k", "q.r", 0, "s"], lines["t", "v"]] == [5, 7, 22]
        assert [lines["t", "u", "p"], lines["arr", 1, "sub", "y"], lines["arr", 1, "deep", 1, "z"]] == [11, 17, 20]

    @settings(max_examples=50)
    @given(st.data())
    def test_keys_are_found_where_they_were_written(self, data: st.DataObject) -> None:
        text, expected = "", {}

        def put(piece: str) -> None:
            nonlocal text
            text += piece

        def value(path: tuple[str | int, ...], depth: int) -> None:
            expected[path] = text.count("\n") + 1
            kind = data.draw(st.sampled_from("nsmla" if depth else "nsml"))
            if kind == "a":
                put("[")
                for index in range(data.draw(st.integers(0, 3))):
                    put(data.draw(st.sampled_from(["", "\n", " # ]\n\n"])))
                    value((*path, index), depth - 1)
                    put(data.draw(st.sampled_from([",", " ,\n"])))
                put("]")
            else:
                put({"n": "-3.5e2", "s": r'"a\"]#"', "m": '"""x\n"y"\n"""', "l": "'\\'"}[kind])

        for table in range(data.draw(st.integers(1, 3))):
            put(data.draw(st.sampled_from(["", "\n", "# [x]\n"])))
            array = data.draw(st.booleans())
            head = ("list", 0) if array else (f"t{table}",)
            if array and ("list", 0) in expected:
                continue
            expected[head] = expected[head[:1]] = text.count("\n") + 1
            put(f"[[{head[0]}]]\n" if array else f"[ {head[0]} ]\n")
            for key in range(data.draw(st.integers(0, 3))):
                put(f"{data.draw(st.sampled_from([f'k{key}', f'''{chr(34)}k{key}{chr(34)}''']))} = ")
                value((*head, f"k{key}"), 2)
                put("\n")
        assert set(expected) == set(paths(tomllib.loads(text)))
        assert dict(find_key_lines(text)) == expected


GYROID = fields.tpms("gyroid", 10.0)
UNIT = fields.bspline_unit(np.random.default_rng(5).normal(size=(4, 3, 5)), (4, 5, 6))
BALL, SLAB = fields.sphere((1, 2, 3), 6), fields.box((-2, -np.inf, -np.inf), (5, np.inf, np.inf))
NAMES = """
[fields.ball]
kind = "sphere"
center = [1, 2, 3]
radius = 6
[fields.slab]
kind = "box"
lo = [-2, -inf, -inf]
hi = [5, inf, inf]
[fields.gyroid]
kind = "tpms"
surface = "G"
period = 10
"""

SAME = {
    "tpms": [
        ("surface = 'P'\nperiod = [4, 5, 6]\nphase = [0, 0.5, 0.1]", fields.tpms("P", (4, 5, 6), (0, 0.5, 0.1))),
        ("surface = 'iwp'\nperiod = 4\nreference = 'minimal'", fields.tpms("iwp", 4, reference="minimal")),
    ],
    "bspline": [
        ("seed = 5\ncount = [4, 3, 5]\nperiod = [4, 5, 6]", UNIT),
        ("file = 'unit.npy'\nperiod = [4, 5, 6]", UNIT),
        ("coefficients = [[[1, 2], [3, 4]]]\nperiod = 3", fields.bspline_unit([[[1, 2], [3, 4]]], 3.0)),
    ],
    "cell_sizes": [
        (
            "of = 'gyroid'\ny = { at = [0, 20], sizes = [10, 5] }",
            fields.cell_sizes(GYROID, y=((0.0, 20.0), (10.0, 5.0))),
        )
    ],
    "rod": [
        ("surface = 'gyroid'\nperiod = 10\nlevel = -0.3", fields.rod(GYROID, -0.3)),
        (
            "surface = 'S'\nperiod = 9\nlevel = 0\nreference = 'minimal'",
            fields.rod(fields.tpms("S", 9, reference="minimal"), 0),
        ),
        ("of = 'gyroid'\nvolume_fraction = 0.3", fields.rod(GYROID, fields.threshold_for(GYROID, 0.3))),  # type: ignore[arg-type]
        (
            "of = 'gyroid'\nlevel = { kind = 'ramp', by = 'x', span = [0, 9], values = [-1, 1] }",
            fields.rod(GYROID, fields.ramp("x", (0, 9), (-1, 1))),
        ),
    ],
    "wall": [
        ("of = 'gyroid'\nthickness = 0.8", fields.wall(GYROID, 0.8)),
        (
            "surface = 'gyroid'\ncell = 10\nthickness = { kind = 'ramp', by = 'x', span = [0, 9], values = [0.4, 1] }",
            fields.wall(GYROID, fields.ramp("x", (0, 9), (0.4, 1))),
        ),
    ],
    "pore": [("of = 'gyroid'\nlevel = 0.4", fields.pore(GYROID, 0.4))],
    "sheet": [
        ("of = 'gyroid'\nlevels = [-0.2, 0.3]", fields.sheet(GYROID, -0.2, 0.3)),
        ("of = 'gyroid'\nvolume_fraction = 0.2", fields.sheet(GYROID, *fields.threshold_for(GYROID, 0.2, "sheet"))),  # type: ignore[misc]
    ],
    "box": [("lo = [-2, -inf, -inf]\nhi = [5, inf, inf]", SLAB)],
    "halfspace": [("point = [1, 2, 3]\nnormal = [1, 0, 2]", fields.halfspace((1, 2, 3), (1, 0, 2)))],
    "cylinder": [
        ("center = [1, 2, 3]\nradius = 4", fields.cylinder((1, 2, 3), 4)),
        ("center = [1, 2, 3]\nradius = 4\naxis = '-x'\nheight = 5", fields.cylinder((1, 2, 3), 4, "-x", 5)),
    ],
    "sphere": [("center = [1, 2, 3]\nradius = 6", BALL)],
    "union": [
        ("of = ['ball', 'slab']", BALL | SLAB),
        ("of = ['ball', 'slab']\nwidth = 2", fields.smooth_union(BALL, SLAB, 2)),
    ],
    "intersection": [
        ("of = ['ball', 'slab', 'gyroid']", BALL & SLAB & GYROID),
        ("of = ['ball', 'slab']\nwidth = 2", fields.smooth_intersection(BALL, SLAB, 2)),
    ],
    "difference": [
        ("of = 'ball'\nminus = ['slab', 'gyroid']", fields.difference(BALL, SLAB, GYROID)),
        ("of = 'ball'\nminus = ['slab']\nwidth = 2", fields.smooth_difference(BALL, SLAB, 2)),
    ],
    "smooth_union": [("first = 'ball'\nsecond = 'slab'\nwidth = 2", fields.smooth_union(BALL, SLAB, 2))],
    "smooth_intersection": [("first = 'ball'\nsecond = 'slab'\nwidth = 2", fields.smooth_intersection(BALL, SLAB, 2))],
    "smooth_difference": [("of = 'ball'\nminus = 'slab'\nwidth = 2", fields.smooth_difference(BALL, SLAB, 2))],
    "complement": [("of = 'ball'", ~BALL), ("field = 'ball'", ~BALL)],
    "constant": [("value = 2.5", fields.constant(2.5))],
    "coordinate": [("axis = '-y'\norigin = [1, 2, 3]", fields.coordinate("-y", (1, 2, 3)))],
    "normal_distance": [("of = 'gyroid'", fields.normal_distance(GYROID))],
    "bspline_unit": [("coefficients = [[[1, 2], [3, 4]]]\nperiod = 3", fields.bspline_unit([[[1, 2], [3, 4]]], 3.0))],
    "image_region": [
        (
            "mask = [[true, false], [false, true]]\nlo = [0, 0]\nhi = [5, 6]",
            fields.image_region(np.eye(2) > 0, (0, 0), (5, 6)),
        )
    ],
    "mix": [
        (
            "of = ['gyroid', 'ball']\nweight = { kind = 'ramp', by = 'x', span = [0, 9], values = [0, 1] }",
            GYROID + fields.ramp("x", (0, 9), (0, 1)) * (BALL - GYROID),
        )
    ],
    "sum": [("of = ['ball', 2, 'gyroid']", BALL + 2 + GYROID)],
    "product": [("of = ['ball', 2]", BALL * 2)],
    "linear": [("slope = [1, 2, 3]\noffset = 4", fields.linear((1, 2, 3), 4))],
    "clip": [("field = 'ball'\nlow = -1\nhigh = 0.5", fields.clip(BALL, -1, 0.5))],
    "ramp": [
        ("by = 'ball'\nspan = [-3, 3]\nvalues = [0, 1]", fields.ramp(BALL, (-3, 3), (0, 1))),
        ("by = 'y'\nspan = [-3, 3]\nvalues = [0, 1]\nsmooth = false", fields.ramp("y", (-3, 3), (0, 1), smooth=False)),
    ],
    "struts": [
        (
            "points = [[0, 0, 0], [2, 0, 0], [0, 2, 1]]\nedges = [[0, 1], [1, 2]]\ndiameter = 0.5",
            fields.struts([(0, 0, 0), (2, 0, 0), (0, 2, 1)], [(0, 1), (1, 2)], 0.5),
        )
    ],
    "strut_lattice": [
        (
            "structure = 'bcc'\ncell = 3\ncells = [1, 2, 1]\ndiameter = 0.4",
            fields.strut_lattice("bcc", cell=3, cells=(1, 2, 1), diameter=0.4),
        )
    ],
    "core": [
        (
            "structure = 'honeycomb'\ncell = 3\nthickness = 0.4\naxis = 'x'",
            fields.core("honeycomb", 3, 0.4, "x"),
        )
    ],
    "plate_lattice": [
        (
            "structure = 'fcc'\ncell = 3\ncells = [1, 2, 1]\nthickness = 0.4",
            fields.plate_lattice("fcc", cell=3, cells=(1, 2, 1), thickness=0.4),
        )
    ],
    "translate": [("of = 'gyroid'\nvector = [1, 2, 3]", fields.translate(GYROID, (1, 2, 3)))],
    "rotate": [("field = 'ball'\naxis = 'y'\nangle = 30", fields.rotate(BALL, "y", 30))],
    "scale": [("of = 'gyroid'\nfactor = 2", fields.scale(GYROID, 2))],
    "translated": [("of = 'gyroid'\nvector = [1, 2, 3]", fields.translate(GYROID, (1, 2, 3)))],
    "rotated": [("of = 'ball'\naxis = 'y'\nangle = 30", fields.rotate(BALL, "y", 30))],
    "scaled": [("of = 'gyroid'\nfactor = 2\ncenter = [1, 0, 0]", fields.scale(GYROID, 2, (1, 0, 0)))],
}
"""Of every kind tables and the fields that Python has for them; images and bodies, which need files, have tests of their own."""


def part(folder: Path, field: str) -> fields.Field:
    path = folder / "part.toml"
    path.write_text(f"tol = 0.1\ndomain = [[0, 0, 0], [1, 1, 1]]\n[field]\n{field}\n{NAMES}")
    return read_solid_recipe(path).field


def test_every_kind_is_tried() -> None:
    assert field_kinds().keys() - SAME.keys() == {
        "image",
        "body",
        "sampled",
        "labels",
        "scattered",
        "expression",
        "mesh",
        "beams",
        "wireframe",
    }


def names_of_fields(kind: type = fields.Field) -> set[str]:
    return {kind.__name__}.union(*(names_of_fields(inner) for inner in kind.__subclasses__()))


def test_every_field_function_whose_arguments_can_be_written_is_a_kind() -> None:
    functions = [getattr(fields, name) for name in fields.__all__ if callable(getattr(fields, name))]
    makers = {f for f in functions if inspect.signature(f).return_annotation in names_of_fields()}
    kinds = {*field_kinds().values(), *(getattr(fields, name) for name in CONVENIENCES.keys() & set(fields.__all__))}
    assert makers - kinds == {fields.as_field, fields.from_function, fields.warp}


def test_a_new_field_function_is_a_kind_by_itself(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @validate_call()
    def thicken(
        phi: Annotated[fields.Field, FIELD, "The field."],
        width: Annotated[float, POSITIVE, "Width, model units."],
        center: Annotated[tuple[float, float, float], POINT, "Centre, model units."] = (0.0, 0.0, 0.0),
    ) -> fields.Field:
        """Return a field for a test."""
        return fields.as_field(phi) - width * fields.sphere(center, 1)

    monkeypatch.setattr(fields, "thicken", thicken, raising=False)
    monkeypatch.setattr(fields, "__all__", [*fields.__all__, "thicken"])
    field_kinds.cache_clear()
    try:
        found = part(tmp_path, "kind = 'thicken'\nof = 'ball'\nwidth = 2")
        np.testing.assert_array_equal(found(POINTS), thicken(BALL, 2)(POINTS))
        with pytest.raises(RecipeError, match=r"line 6, field\.width: -2 must be positive"):
            part(tmp_path, "kind = 'thicken'\nof = 'ball'\nwidth = -2")
    finally:
        monkeypatch.undo()
        field_kinds.cache_clear()


@pytest.mark.parametrize("kind", field_kinds())
def test_the_keys_of_a_kind_are_the_arguments_of_its_function(kind: str) -> None:
    arguments, keys = arguments_of(field_kinds()[kind]), keys_of(field_kinds()[kind])
    words = [word for key in keys.values() for word in key.words]
    assert len(words) == len(set(words))
    assert keys.keys() <= arguments.keys() <= set(words)
    assert all(keys[name].argument is arguments[name] for name in keys) or kind in CONVENIENCES


@pytest.mark.parametrize(
    ("kind", "text", "expected"),
    [(kind, *case) for kind, cases in SAME.items() for case in cases],
    ids=[f"{kind} {k}" for kind, cases in SAME.items() for k in range(len(cases))],
)
def test_a_table_has_the_bits_of_the_field_it_describes(
    tmp_path: Path, kind: str, text: str, expected: fields.Field
) -> None:
    np.save(tmp_path / "unit.npy", UNIT.coefficients)
    found = part(tmp_path, f"kind = '{kind}'\n{text}")
    np.testing.assert_array_equal(found(POINTS), expected(POINTS))
    np.testing.assert_array_equal(found.gradient(POINTS), expected.gradient(POINTS))


@pytest.mark.parametrize("mode", ["1", "L", "LA", "P", "RGB", "RGBA", "I;16"])
@pytest.mark.parametrize("suffix", ["png", "tiff"])
def test_a_picture_is_read_as_it_is_seen(tmp_path: Path, mode: str, suffix: str) -> None:
    rng = np.random.default_rng(0)
    smooth = np.add.outer(np.linspace(0, 120, 13), np.linspace(0, 120, 21)) + rng.uniform(-9, 9, (13, 21))
    grey = smooth.astype(np.uint8)
    if mode == "I;16":
        drawn = Image.fromarray(grey.astype(np.uint16) * 257)
    else:
        drawn = Image.fromarray(grey).convert(mode, **({"dither": 0} if mode == "1" else {}))
    drawn.save(tmp_path / f"drawn.{suffix}")
    seen = np.asarray(drawn) * 1.0 if mode in ("1", "I;16") else np.asarray(drawn.convert("L")) / 255
    if mode == "I;16":
        seen = seen / 65535
    chosen = (seen < 0.45).T[:, ::-1]
    text = f"kind = 'image'\nfile = 'drawn.{suffix}'\nlo = [0, 0]\nhi = [21, 13]\nthreshold = 0.45\n"
    expected = fields.image_region(chosen, (0, 0), (21, 13))
    np.testing.assert_array_equal(part(tmp_path, text)(POINTS), expected(POINTS))
    lighter = part(tmp_path, text + "solid = 'light'\naxis = 'x'")
    np.testing.assert_array_equal(lighter(POINTS), fields.image_region(~chosen, (0, 0), (21, 13), axis="x")(POINTS))


def test_transparent_pixels_are_white(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    alpha, colours = rng.integers(0, 256, (13, 21)), rng.integers(0, 256, (13, 21, 3))
    Image.fromarray(np.dstack([colours, alpha]).astype(np.uint8)).save(tmp_path / "drawn.png")
    luma = colours / 255 @ [0.299, 0.587, 0.114]
    chosen = (alpha / 255 * luma + 1 - alpha / 255 < 0.45).T[:, ::-1]
    text = "kind = 'image'\nfile = 'drawn.png'\nlo = [0, 0]\nhi = [21, 13]\nthreshold = 0.45\n"
    np.testing.assert_array_equal(part(tmp_path, text)(POINTS), fields.image_region(chosen, (0, 0), (21, 13))(POINTS))


def test_a_stack_of_pictures_is_an_array_of_truth_values(tmp_path: Path) -> None:
    stack = np.random.default_rng(0).random((4, 5, 6)) > 0.5
    np.save(tmp_path / "stack.npy", stack)
    found = part(tmp_path, "kind = 'image'\nfile = 'stack.npy'\nlo = [0, 0, 0]\nhi = [4, 5, 6]")
    np.testing.assert_array_equal(found(POINTS), fields.image_region(stack, (0, 0, 0), (4, 5, 6))(POINTS))


@pytest.mark.kernel
def test_a_body_is_the_signed_distance_to_the_solid_of_a_step_file(tmp_path: Path) -> None:
    import build123d as bd

    bd.export_step(bd.Pos(1, 2, 3) * bd.Box(6, 5, 4), str(tmp_path / "block.step"))
    found = part(tmp_path, "kind = 'body'\nfile = 'block.step'")
    np.testing.assert_allclose(found(POINTS), fields.box((-2, -0.5, 1), (4, 4.5, 5))(POINTS), atol=1e-6)
    with pytest.raises(RecipeError, match=r"line 5, field\.file: there is no file .*absent\.step"):
        part(tmp_path, "kind = 'body'\nfile = 'absent.step'")


SCAFFOLD = """\
tol = 0.05
resolution = [26, 24, 24]
weight = "auto"
[[structures]]
kind = "rod"
surface = "schwarz_p"
period = 5
level = -0.3
[[structures]]
kind = "rod"
surface = "iwp"
period = 5
level = -0.9
[[regions]]
kind = "box"
lo = [0, 0, 0]
hi = [6, 9, 9]
[[regions]]
kind = "box"
lo = [6, 0, 0]
hi = [10, 9, 9]
[[blending_regions]]
kind = "box"
lo = [4, 0, 0]
hi = [8, 9, 9]
"""

WRONG = {
    "period = 5\nlevel = -0.9": ("period = -3\nlevel = -0.9", "line 12, structures[1].period: -3 must be positive"),
    'surface = "iwp"': (
        'surface = "ipw"',
        "line 11, structures[1].surface: unknown surface 'ipw': did",
    ),
    "hi = [6, 9, 9]": ("high = [6, 9, 9]", "line 17, regions[0].high: unknown key; did you mean 'hi'?"),
    "lo = [6, 0, 0]": (
        "lo = [6, 0]",
        "line 20, regions[1].lo: [6, 0] must be three numbers, which may be infinite, not 2",
    ),
    "hi = [10, 9, 9]": ("hi = [10, 9, '9']", "line 21, regions[1].hi[2]: '9' is not a number"),
    "lo = [4, 0, 0]": ("", "line 22, blending_regions[0]: the key 'lo' is missing"),
    "tol = 0.05": ("", "scaffold.toml: the key 'tol' is missing"),
    "tol = ": ("tolerance = ", "line 1, tolerance: unknown key; did you mean 'tol'?"),
    "[26, 24, 24]": ("[26, 24.5, 24]", "line 2, resolution[1]: 24.5 must be a whole number"),
    'weight = "auto"': ("weight = true", "line 3, weight: must be a table, not true"),
    '"auto"': ('"atuo"', "line 3, weight: 'atuo' is unknown; did you mean 'auto'?"),
    "level = -0.3": (
        "level = 'ramp'",
        "line 8, structures[0].level: 'ramp' names no field: define it as [fields.ramp]",
    ),
    "level = -0.9": ("level = 7", "line 9, structures[1]: rod threshold 7 makes everything solid"),
    '[[structures]]\nkind = "rod"\nsurface = "iwp"\nperiod = 5\nlevel = -0.9\n': ("", "1 structure given"),
    "hi = [8, 9, 9]": ("hi = [3, 9, 9]", "line 22, blending_regions[0]: box from"),
    'kind = "box"\nlo = [6': ('kind = "bx"\nlo = [6', "line 19, regions[1].kind: 'bx' is unknown; did you mean 'box'?"),
    "hi = [10, 9, 9]\n[[b": ("hi = [10, 9, 9\n[[b", "is not TOML"),
}


class TestScaffold:
    def test_a_recipe_blends_like_python(self, tmp_path: Path) -> None:
        path = tmp_path / "scaffold.toml"
        path.write_text(SCAFFOLD + "\n")
        found = run_blend_recipe(read_blend_recipe(path))
        structures = [fields.rod(fields.tpms(n, 5.0), c) for n, c in (("schwarz_p", -0.3), ("iwp", -0.9))]
        regions = [fields.box((0, 0, 0), (6, 9, 9)), fields.box((6, 0, 0), (10, 9, 9))]
        middle = [fields.box((4, 0, 0), (8, 9, 9))]
        expected = tpmscad.blend(structures, regions, middle, resolution=(26, 24, 24))
        np.testing.assert_array_equal(found.field(POINTS), expected.field(POINTS))
        assert found.domain == ((0, 0, 0), (10, 9, 9))
        # other processes get the blend to make a solid of
        np.testing.assert_array_equal(pickle.loads(pickle.dumps(found.field))(POINTS), expected.field(POINTS))

    @pytest.mark.parametrize("right", WRONG)
    def test_an_error_names_file_line_and_key(self, tmp_path: Path, right: str) -> None:
        wrong, words = WRONG[right]
        path = tmp_path / "scaffold.toml"
        assert right in SCAFFOLD
        path.write_text(SCAFFOLD.replace(right, wrong, 1))
        with pytest.raises(RecipeError) as caught:
            read_blend_recipe(path).run()
        assert "scaffold.toml" in str(caught.value)
        assert words in str(caught.value)

    def test_what_the_blend_finds_wrong_is_told_with_the_line_of_its_table(self, tmp_path: Path) -> None:
        path = tmp_path / "scaffold.toml"
        path.write_text(SCAFFOLD.replace("lo = [6, 0, 0]", "lo = [5, 0, 0]"))
        with pytest.raises(RecipeError, match=r"line 14, regions\[0\]: regions 0 and 1 overlap"):
            read_blend_recipe(path).run()
        path.write_text(SCAFFOLD.replace("period = 5\nlevel = -0.9", "period = 1\nlevel = -0.9"))
        with pytest.raises(RecipeError, match=r"line 9, structures\[1\]: structure 1 is under-sampled"):
            read_blend_recipe(path).run()

    @pytest.mark.parametrize(
        ("text", "kind", "entries"),
        [
            ("weight = 'x'", "LineWeight", None),
            ("weight = 'volume'", "VolumeWeight", None),
            ("weight = { kind = 'along', direction = 'x', count = 50 }", "LineWeight", 50),
            ("weight = [{ kind = 'volume', count = [20, 9, 8], degree = [2, 3, 3] }]", "VolumeWeight", 20 * 9 * 8),
        ],
    )
    def test_weights_are_those_asked_for(self, tmp_path: Path, text: str, kind: str, entries: int | None) -> None:
        path = tmp_path / "scaffold.toml"
        path.write_text(SCAFFOLD.replace('weight = "auto"', f"{text}\nmethod = 'initial'"))
        weight = read_blend_recipe(path).run().weights[0]
        assert type(weight).__name__ == kind
        assert entries is None or weight.coefficients.size == entries  # type: ignore[attr-defined]

    @pytest.mark.parametrize(
        ("kind", "degree", "meant"),
        [
            ("along", "", 3),
            ("along", ", degree = 2", 2),
            ("volume", "", (3, 3, 3)),
            ("volume", ", degree = [2, 3, 1]", (2, 3, 1)),
        ],
    )
    def test_weights_have_the_degree_asked_for(self, tmp_path: Path, kind: str, degree: str, meant: object) -> None:
        path = tmp_path / "scaffold.toml"
        named = "direction = 'x', count = 50" if kind == "along" else "count = [20, 9, 8]"
        text = f"weight = [{{ kind = '{kind}', {named}{degree} }}]"
        path.write_text(SCAFFOLD.replace('weight = "auto"', f"{text}\nmethod = 'initial'"))
        assert read_blend_recipe(path).options["weight"][0].degree == meant

    def test_a_blend_with_errors_left_is_not_passed_off(self, tmp_path: Path) -> None:
        path = tmp_path / "scaffold.toml"
        path.write_text(TORN)
        scaffold = read_blend_recipe(path)
        with pytest.raises(NotMet, match="errors left") as caught:
            run_blend_recipe(scaffold)
        assert caught.value.certificate.to_dict()["converged"] is False
        assert run_blend_recipe(scaffold, allow_errors=True).errors.remaining > 0


TORN = SCAFFOLD.replace("period = 5", "period = 2.5").replace("[26, 24, 24]", "[50, 36, 36]").replace(
    'weight = "auto"', 'method = "initial"'
).replace("level = -0.3", "level = -0.8").replace("level = -0.9", "level = -2")  # fmt: skip


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.toml")), ids=lambda path: path.stem)
@pytest.mark.slow
def test_an_example_holds_what_it_says(path: Path) -> None:
    if "structures" in tomllib.loads(path.read_text()):
        assert run_blend_recipe(read_blend_recipe(path)).converged
    else:
        assert 0 < SolidRun.read(path).describe()[1]["volume_fraction"] < 1

"""Fields of data and formulas in recipes: the same bits as in Python, and what is wrong in a file told with its line."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import RecipeError
from tpmscad.recipe.solid_recipe import read_solid_recipe

POINTS = np.random.default_rng(3).uniform(0, 4, (200, 3))
VALUES = np.random.default_rng(5).normal(size=(5, 6, 7))
SCATTERED = np.random.default_rng(7).uniform(0, 4, (40, 4))


def read_field(folder: Path, text: str) -> fields.Field:
    (folder / "part.toml").write_text(f"tol = 0.1\ndomain = [[0, 0, 0], [1, 1, 1]]\n[field]\n{text}\n")
    return read_solid_recipe(folder / "part.toml").field


def assert_same(found: fields.Field, expected: fields.Field) -> None:
    np.testing.assert_array_equal(found(POINTS), expected(POINTS))
    np.testing.assert_array_equal(found.gradient(POINTS), expected.gradient(POINTS))


@pytest.mark.parametrize(
    ("text", "keywords"),
    [
        ("", {}),
        ("level = 0.25", {"level": 0.25}),
        ("centred = true", {"centred": True}),
        ("spacing = [1, 0.5, 2]\norigin = [-1, 0, 1]", {"spacing": (1, 0.5, 2), "origin": (-1, 0, 1)}),
    ],
)
def test_voxels_of_a_file_are_the_sampled_field(tmp_path: Path, text: str, keywords: dict[str, object]) -> None:
    np.save(tmp_path / "density.npy", VALUES)
    assert_same(
        read_field(tmp_path, f'kind = "sampled"\nfile = "density.npy"\n{text}'),
        fields.sampled(VALUES, **keywords),  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(
    ("text", "label"), [("", 1), ("label = 2", 2), ("label = [1, 2]", [1, 2]), ('label = "all"', "all")]
)
def test_labels_of_a_file_are_the_smooth_region(tmp_path: Path, text: str, label: object) -> None:
    organs = np.random.default_rng(9).integers(0, 3, (5, 6, 7))
    np.save(tmp_path / "organs.npy", organs)
    found = read_field(tmp_path, f'kind = "labels"\nfile = "organs.npy"\nspacing = 0.7\n{text}')
    assert_same(found, fields.labels(organs, 0.7, label=label))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("head", "separator"), [("x,y,z,value\n", ","), ("# mm and MPa\n", ";"), ("", " "), ("X\tY\tZ\tstress\n", "\t")]
)
def test_a_table_of_points_is_the_scattered_field(tmp_path: Path, head: str, separator: str) -> None:
    rows = "\n".join(separator.join(map(repr, row)) for row in SCATTERED.tolist())
    (tmp_path / "points.csv").write_text(f"{head}{rows}\n\n")
    assert_same(
        read_field(tmp_path, 'kind = "scattered"\nfile = "points.csv"\nlevel = 1.5'),
        fields.scattered(SCATTERED[:, :3], SCATTERED[:, 3], level=1.5),
    )


def test_a_formula_may_name_other_fields(tmp_path: Path) -> None:
    text = """kind = "expression"
formula = "max(sin(x)*cos(y) + 0.2*Z, ball)"
cell = 3
names = { ball = { kind = "sphere", center = [2, 2, 2], radius = 1.5 } }"""
    ball = fields.sphere((2, 2, 2), 1.5)
    assert_same(read_field(tmp_path, text), fields.expression("max(sin(x)*cos(y) + 0.2*Z, ball)", period=3, ball=ball))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('kind = "sampled"\nfile = "flat.npy"', "holds an array of shape (3, 3)"),
        ('kind = "sampled"\nfile = "organs.npy"', "line 5, field.file: organs.npy holds the labels 0, 1, 2, 3"),
        ('kind = "labels"\nfile = "organs.npy"\nlabel = 7', "organs.npy holds no label 7"),
        ('kind = "labels"\nfile = "organs.npy"\nlabel = "bone"', "line 6, field.label: 'bone' is unknown"),
        ('kind = "sampled"\nfile = "flat.npy"\nframe = "LAS"', "line 6, field.frame"),
        ('kind = "sampled"\nfile = "absent.npy"', "line 5, field.file: there is no file"),
        ('kind = "expression"\nformula = "sin(x) +"', "formula"),
        ('kind = "expression"\nformula = "__import__(1)"', "__import__"),
        ('kind = "rod"\nsurface = "P"\ncell = 2\nlevel = 0\nof = 1', "give exactly one of 'of' and 'surface'"),
    ],
)
def test_what_is_wrong_is_told_with_its_line(tmp_path: Path, text: str, words: str) -> None:
    np.save(tmp_path / "flat.npy", np.zeros((3, 3)))
    np.save(tmp_path / "organs.npy", np.indices((4, 4, 4))[0])
    with pytest.raises(RecipeError, match=r"^part\.toml, line \d, field") as caught:
        read_field(tmp_path, text)
    assert words in str(caught.value)


@pytest.mark.slow
def test_a_ramp_grades_the_volume_fraction(tmp_path: Path) -> None:
    ramp = fields.ramp("z", (0, 4), (0.4, 0.2))
    phi = fields.tpms("gyroid", 2.0)
    low, high = fields.graded_threshold(phi, ramp, (0.2, 0.4), "sheet")  # type: ignore[misc]
    text = """kind = "sheet"
surface = "gyroid"
cell = 2
volume_fraction = { kind = "ramp", by = "z", span = [0, 4], values = [0.4, 0.2] }"""
    assert_same(read_field(tmp_path, text), fields.sheet(phi, low, high))


def test_the_mesh_of_a_file_is_a_field(tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(1, 5.0).export(tmp_path / "ball.stl")
    found = read_field(tmp_path, 'kind = "mesh"\nfile = "ball.stl"\nspacing = 0.7')
    assert_same(found, fields.mesh(tmp_path / "ball.stl", spacing=0.7))

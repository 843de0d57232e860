"""The dry run of a recipe: what making the solid would refuse before its fits, it refuses too, with the line of the recipe."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tpmscad import fields
from tpmscad.errors import LevelSetError, RecipeError, TpmscadError
from tpmscad.recipe.recipe_runs import SolidRun

pytestmark = pytest.mark.kernel

SHEET = 'kind = "sheet"\nsurface = "P"\ncell = 4\nlevels = [-0.4, 0.4]'
BOX = "[[0, 0, 0], [4, 4, 4]]"
CYLINDER = '{ kind = "cylinder", center = [2, 2, 2], radius = 2, height = 4 }'


def dry_run(folder: Path, field: str = SHEET, domain: str = BOX, tol: str = "0.05") -> tuple[str, dict[str, object]]:
    path = folder / "part.toml"
    path.write_text(f"tol = {tol}\ndomain = {domain}\n[field]\n{field}\n")
    return SolidRun.read(path).describe()


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"field": 'kind = "sphere"\ncenter = [99, 0, 0]\nradius = 1'}, LevelSetError, "no surface inside the box"),
        ({"field": SHEET.replace("-0.4", "0.3999")}, LevelSetError, "too thin for `tol`"),
        ({"field": 'kind = "expression"\nformula = "sqrt(x - 2)"'}, RecipeError, "not finite"),
        ({"tol": "5"}, RecipeError, "line 1, tol: tol 5"),
        ({"domain": '"absent.step"'}, RecipeError, "line 2, domain: there is no file"),
        ({"domain": '"empty.step"'}, TpmscadError, "empty.step"),
        ({"domain": CYLINDER.replace(", height = 4", "")}, RecipeError, "line 2, domain: a cylinder that is filled"),
        ({"domain": CYLINDER.replace("cylinder", "halfspace")}, RecipeError, "line 2, domain.kind: 'halfspace'"),
    ],
)
def test_what_would_fail_fails_in_the_dry_run(
    tmp_path: Path, given: dict[str, str], error: type[Exception], words: str
) -> None:
    (tmp_path / "empty.step").touch()
    with pytest.raises(error) as caught:
        dry_run(tmp_path, **given)
    assert words in str(caught.value)
    assert "fields." not in str(caught.value)


def test_surfaces_may_cross(tmp_path: Path) -> None:
    ball, plane = (
        '{ kind = "sphere", center = [2, 2, 2], radius = 1.5 }',
        '{ kind = "halfspace", point = [0, 0, 2.0], normal = "z" }',
    )
    _, content = dry_run(tmp_path, field=f'kind = "intersection"\nof = [{ball}, {plane}]')
    assert content["volume_fraction"] == pytest.approx(2 / 3 * np.pi * 1.5**3 / 64, rel=0.02)


def test_the_dry_run_tells_box_and_fraction(tmp_path: Path) -> None:
    field = 'kind = "halfspace"\npoint = [0, 0, 1]\nnormal = "z"'
    text, content = dry_run(tmp_path, field)
    assert content["volume_fraction"] == pytest.approx(0.25, abs=1e-3)
    assert "box (0, 0, 0) to (4, 4, 4), about 25" in text
    text, content = dry_run(tmp_path, field, CYLINDER)
    assert content["domain"]["kind"] == "cylinder"  # type: ignore[index]
    assert "box (0, 0, 0) to (4, 4, 4)" in text


def test_two_walls_mix_into_a_wall(tmp_path: Path) -> None:
    other = SHEET.replace('"P"', '"gyroid"').replace("\n", ", ")
    weight = '{ kind = "ramp", by = "z", span = [1, 3], values = [0, 1] }'
    field = f'kind = "mix"\nof = [{{ {SHEET.replace(chr(10), ", ")} }}, {{ {other} }}]\nweight = {weight}'
    dry_run(tmp_path, field)
    found = SolidRun.read(tmp_path / "part.toml").field
    points = np.random.default_rng(1).uniform(0, 4, (500, 3))
    w, p, g = (
        fields.ramp("z", (1, 3), (0, 1))(points),
        fields.tpms("P", 4.0)(points),
        fields.tpms("gyroid", 4.0)(points),
    )
    np.testing.assert_allclose(found(points), np.abs((1 - w) * p + w * g) - 0.4, atol=1e-12)


@pytest.mark.slow
def test_a_cylinder_as_domain_cuts_the_field_exactly(tmp_path: Path) -> None:
    (tmp_path / "part.toml").write_text(f"tol = 0.1\ndomain = {CYLINDER}\n[field]\n{SHEET}\n")
    run = SolidRun.read(tmp_path / "part.toml")
    model, _ = run.make(None)
    rng = np.random.default_rng(0)
    points = rng.uniform(0, 4, (200_000, 3))
    inside = (np.hypot(points[:, 0] - 2, points[:, 1] - 2) < 2) & (run.field(points) < 0)
    assert model.certificate.met
    assert model.certificate.volume == pytest.approx(64 * inside.mean(), rel=0.015)


@pytest.mark.slow
def test_an_array_is_solid_where_it_exceeds_the_level(tmp_path: Path) -> None:
    x, y, z = np.mgrid[0:17, 0:17, 0:17] * 0.5
    np.save(tmp_path / "density.npy", 5 - np.sqrt((x - 4) ** 2 + (y - 4) ** 2 + (z - 4) ** 2 + 0.1))
    run = SolidRun.sample(tmp_path / "density.npy", level=2.0, spacing=0.5)
    assert (run.domain, run.tol) == (((0, 0, 0), (8, 8, 8)), 0.05)
    model, _ = run.make(None)
    assert model.certificate.met
    assert model.certificate.volume == pytest.approx(4 / 3 * np.pi * 8.9**1.5, rel=5e-3)

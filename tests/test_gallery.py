"""The gallery of the guide: a page for every example, notebooks that are the scripts, models that hold what was packed."""

from __future__ import annotations

import ast
import base64
import gzip
import importlib
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted(path.stem for path in (ROOT / "examples").glob("*.py"))
MODELS = ROOT / "docs" / "gallery" / "models"


@pytest.fixture
def gallery_pages(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The module that writes the pages."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    yield importlib.import_module("gallery_pages")
    sys.modules.pop("gallery_pages")


def test_examples_that_the_continuous_integration_leaves_out_are_run_by_tests_at_a_small_size() -> None:
    left_out = re.search(r"^small='(.+)'$", (ROOT / ".ci" / "run").read_text(), re.MULTILINE)
    assert left_out is not None
    tests = (ROOT / "tests" / "studies" / "test_application_examples.py").read_text()
    for name in left_out[1].split("|"):
        assert name in EXAMPLES
        assert f'load("{name}")' in tests


def test_every_example_has_one_place_in_the_gallery(gallery_pages: Any) -> None:
    listed = [name for group in (*gallery_pages.GROUPS.values(), gallery_pages.SHARED) for name in group]
    assert sorted(listed) == EXAMPLES
    page = gallery_pages.describe_gallery()
    assert all(f":link: examples/{name}\n" in page for group in gallery_pages.GROUPS.values() for name in group)


def test_every_kept_picture_and_model_is_shown_by_the_page_of_its_example(gallery_pages: Any) -> None:
    shown: set[str] = set()
    for name, title in gallery_pages.list_examples().items():
        page = gallery_pages.describe_example(name, title, (ROOT / "examples" / f"{name}.py").read_text())
        shown |= set(re.findall(r"(?:gallery|_static)/([\w-]+\.png)", page)) | set(
            re.findall(r"models/(\w+\.js)", page)
        )
        assert f"{name}.ipynb" in page
    kept = {
        path.name for folder in (MODELS.parent, MODELS) for path in folder.iterdir() if path.suffix in (".png", ".js")
    }
    assert shown == kept


def test_the_picture_of_an_examples_own_name_stands_first(gallery_pages: Any) -> None:
    kept = {path.stem for path in MODELS.parent.glob("*.png")}
    named = [name for name in EXAMPLES if name in kept]
    assert [gallery_pages.find_pictures(name)[0].stem for name in named] == named


def meaning(code: str) -> list[str]:
    """The statements of a program without its docstring, those of its main program as if they stood there."""
    found = []
    for node in ast.parse(code).body:
        if isinstance(node, ast.If) and "__name__" in ast.unparse(node.test):
            found += [ast.dump(inner) for inner in node.body]
        elif not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            found.append(ast.dump(node))
    return found


@pytest.mark.parametrize("name", EXAMPLES)
def test_a_notebook_runs_what_the_script_runs(name: str, gallery_pages: Any) -> None:
    text = (ROOT / "examples" / f"{name}.py").read_text()
    notebook = json.loads(json.dumps(gallery_pages.make_notebook(name, text)))
    code = ["".join(cell["source"]) for cell in notebook["cells"] if cell["cell_type"] == "code"]
    given = code.pop(0) if code[0].startswith("__file__") else ""
    assert meaning("\n".join(code)) == meaning(text)
    assert bool(given) == ("__file__" in text)
    assert len({cell["id"] for cell in notebook["cells"]}) == len(notebook["cells"])


def unpack_parts(model: dict[str, Any]) -> list[tuple[np.ndarray, np.ndarray]]:
    """Points and triangles of a packed model, as the view reads them, with loops in place of array operations."""
    stream = iter(gzip.decompress(base64.b64decode(model["data"])))

    def numbers(count: int, width: int) -> list[int]:
        values = [0] * count
        for byte in range(width):
            for i in range(count):
                values[i] |= next(stream) << (8 * byte)
        return values

    parts = []
    for part in model["parts"]:
        columns = []
        for low in model["low"]:
            total, column = 0, []
            for step in numbers(part["vertices"], 2):
                total = (total + step) % 65536
                column.append(low + model["step"] * total)
            columns.append(column)
        fresh, corners = 0, []
        for back in numbers(3 * part["triangles"], 3):
            corners.append(fresh - back)
            fresh += back == 0
        parts.append((np.array(columns).T, np.array(corners).reshape(-1, 3)))
    assert next(stream, None) is None
    return parts


def enclosed_volume(points: np.ndarray, triangles: np.ndarray) -> float:
    return float(np.einsum("ij,ij->", points[triangles[:, 0]], np.cross(*points[triangles[:, 1:]].swapaxes(0, 1))) / 6)


@pytest.mark.kernel
def test_a_packed_mesh_is_the_mesh_within_a_step_of_its_grid() -> None:
    from benchmarks.view_files import GRID, ViewPart, pack_parts

    rng = np.random.default_rng(4)
    corners = rng.uniform((-3, 5, 0), (4, 6, 90), (200, 3))
    triangles = rng.permutation(np.arange(200).repeat(3)).reshape(-1, 3)
    parts = [
        ViewPart(str(k), (1.0, 0.5, 0.0), corners * (k + 1), triangles, np.arange(200) % (k + 1)) for k in range(2)
    ]
    model = json.loads(json.dumps(pack_parts(parts)))
    extent = np.ptp(np.concatenate([part.points for part in parts]), axis=0).max()
    for part, (points, corner) in zip(parts, unpack_parts(model), strict=True):
        assert np.abs(points[corner] - part.points[part.triangles]).max() <= 0.51 * extent / (GRID - 1) + 1e-5
    assert model["parts"][0]["vertices"] == 200 < model["parts"][1]["vertices"], "split between groups"


@pytest.mark.parametrize("path", sorted(MODELS.glob("*.js")), ids=lambda path: path.stem)
def test_a_kept_model_is_small_and_holds_solids(path: Path) -> None:
    text = path.read_text()
    assert len(text) <= 480_000
    name, model = json.loads(f"[{text.removeprefix('showPart(').rstrip().removesuffix(');')}]")
    assert name == path.stem
    for points, triangles in unpack_parts(model):
        assert triangles.max() < len(points)
        assert enclosed_volume(points, triangles) > 0

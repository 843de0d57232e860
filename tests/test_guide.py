"""The guide: its scripts run as they stand there, its generated pages name what is public."""

from __future__ import annotations

import importlib
import re
import struct
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import tpmscad

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted((ROOT / "docs" / "guide").glob("*.md"))
SCRIPT = re.compile(r"^```python\n(.*?)^```$", re.MULTILINE | re.DOTALL)
QUICK = ("conventions", "first_solid", "sweeps")
"""Pages whose scripts take about a second; the others are marked slow."""

SCRIPTS = [(page.stem, number, text) for page in PAGES for number, text in enumerate(SCRIPT.findall(page.read_text()))]


def marks_of(page: str, script: str) -> list[pytest.MarkDecorator]:
    """The marks of a script by what it imports and how long it takes."""
    marks = [pytest.mark.kernel]
    if page not in QUICK or "properties=True" in script:
        marks.append(pytest.mark.slow)
    if "cadquery" in script:
        marks.append(pytest.mark.frontend)
    return marks


@pytest.mark.parametrize(
    ("page", "script"),
    [
        pytest.param(page, script, marks=marks_of(page, script), id=f"{page}-{number}")
        for page, number, script in SCRIPTS
    ],
)
def test_a_script_of_the_guide_runs(page: str, script: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.chdir(tmp_path)
    exec(compile(script, f"{page}.md", "exec"), {"__name__": "__main__"})
    for name in re.findall(r'(?:export|write|export_step)\((?:\w+, )?"([\w.]+)"\)', script):
        assert (tmp_path / name).stat().st_size > 0


def test_every_page_of_the_guide_is_in_the_index() -> None:
    index = (ROOT / "docs" / "index.md").read_text()
    assert all(f"guide/{page.stem}" in index for page in PAGES)
    assert len(SCRIPTS) >= 10


@pytest.fixture
def generated_pages(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """The module that writes pages of the guide."""
    monkeypatch.syspath_prepend(str(ROOT / "docs"))
    yield importlib.import_module("generated_pages")
    sys.modules.pop("generated_pages")


@pytest.mark.kernel
def test_the_page_of_examples_shows_every_kept_model_and_picture_of_an_example(generated_pages: Any) -> None:
    from benchmarks import gallery  # loads the kernel

    page = generated_pages.describe_examples()
    shown = re.findall(r'<model-viewer src="../_static/([^"]+)"', page)
    models = sorted((ROOT / "docs" / "gallery" / "models").iterdir())
    assert sorted(shown) == [path.name for path in models] == [f"{name}.glb" for name in sorted(gallery.VIEWS)]
    for path in models:
        head = path.read_bytes()[:12]
        assert struct.unpack("<4sII", head) == (b"glTF", 2, path.stat().st_size)
        assert path.stat().st_size <= gallery.VIEW_BYTES
    pictures = re.findall(r"!\[[^]]*\]\(../gallery/([^)]+)\)", page)
    assert sorted(pictures) == sorted(path.name for path in (ROOT / "docs" / "gallery").glob("*.png"))
    assert all(generated_pages.find_pictures(name.removesuffix(".glb")) for name in shown), "seen without the script"
    assert page.count("integrity=") == page.count("<script") == 1
    assert '"gallery/models"' in (ROOT / "docs" / "conf.py").read_text()


@pytest.mark.kernel
def test_the_generated_pages_hold_all_public_functions_and_examples(generated_pages: Any) -> None:
    page = generated_pages.describe_module("tpmscad", "Solids", set())
    assert ".. autofunction:: sweep" in page
    for name in tpmscad.__all__:
        if callable(getattr(tpmscad, name)):
            assert f":: {name}\n" in page
    examples = generated_pages.describe_examples()
    assert all(path.name in examples for path in (ROOT / "examples").glob("*.py"))


@pytest.mark.kernel
def test_every_public_module_has_a_page_with_names(generated_pages: Any) -> None:
    described: set[int] = set()
    for module, title in generated_pages.MODULES.items():
        assert (
            ":: "
            in generated_pages.describe_module(module, title, described).split("currentmodule", 1)[1].split("\n", 1)[1]
        ), module

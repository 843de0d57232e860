"""The check of a built guide, on small folders; the cheat sheet calls what there is; pages of the guide have pictures."""

from __future__ import annotations

import ast
import inspect
import re
import runpy
from pathlib import Path
from typing import Any

import pytest

import tpmscad
from tpmscad import fields

ROOT = Path(__file__).resolve().parents[1]
PICTURE = re.compile(r"!\[[^]]+\]\(([^)]+\.png)\)")
PICTURE_BYTES = 50_000


find_faults = runpy.run_path(str(ROOT / "scripts" / "check_site.py"))["find_faults"]

WHOLE = '<a href="b/two.html#here">two</a><a href="https://example.org/">away</a><img src="data:image/png;base64,">'
FAULTS = {
    '<a href="three.html">': "not there",
    '<a href="b/two.html#nowhere">': "a place that the page has not",
    '<a href="#top">': "a place that the page has not",
    '<img src="lost.png">': "not there",
    '<script src="https://cdn.example.org/x.js"></script>': "loads https://cdn.example.org/x.js",
    '<link rel="stylesheet" href="//fonts.example.org/y.css">': "loads //fonts.example.org/y.css",
}


def make_site(folder: Path, page: str) -> Path:
    (folder / "b").mkdir()
    (folder / "one.html").write_text(page)
    (folder / "b" / "two.html").write_text(
        '<p id="here"><a href="../one.html">one</a><link rel="canonical" href="https://x.org/">'
    )
    return folder


def test_a_whole_site_has_no_faults(tmp_path: Path) -> None:
    assert find_faults(make_site(tmp_path, WHOLE)) == []


@pytest.mark.parametrize(("page", "said"), FAULTS.items())
def test_a_fault_of_a_site_is_named_with_its_page(page: str, said: str, tmp_path: Path) -> None:
    (fault,) = find_faults(make_site(tmp_path, WHOLE + page))
    assert said in fault
    assert fault.startswith("one.html ")


CHEAT_SHEET = (ROOT / "docs" / "reference" / "cheat_sheet.md").read_text()
CALLS = [
    node
    for block in re.findall(r"^```python\n(.*?)^```$", CHEAT_SHEET, re.MULTILINE | re.DOTALL)
    for node in ast.walk(ast.parse(block))
    if isinstance(node, ast.Call) and re.match(r"(tpmscad|fields|model)\.\w+$", ast.unparse(node.func))
]


@pytest.mark.kernel
@pytest.mark.parametrize("call", CALLS, ids=lambda call: ast.unparse(call.func))
def test_a_call_of_the_cheat_sheet_fits_its_function(call: ast.Call) -> None:
    home, _, name = ast.unparse(call.func).partition(".")
    function = getattr({"tpmscad": tpmscad, "fields": fields, "model": tpmscad.Model}[home], name)
    places: list[Any] = [None] * (len(call.args) + (home == "model"))
    inspect.signature(function).bind(*places, **{word.arg: None for word in call.keywords if word.arg})


@pytest.mark.parametrize("page", sorted((ROOT / "docs" / "guide").glob("*.md")), ids=lambda path: path.stem)
def test_a_page_of_the_guide_shows_a_small_picture(page: Path) -> None:
    shown = [page.parent / name for name in PICTURE.findall(page.read_text())]
    assert shown
    assert max(path.stat().st_size for path in shown) <= PICTURE_BYTES


def test_every_picture_of_the_guide_is_drawn_by_its_script_and_shown() -> None:
    pages = "".join(path.read_text() for path in (ROOT / "docs").rglob("*.md") if "_generated" not in path.parts)
    drawn = re.findall(r'^    "(\w+)": draw_', (ROOT / "benchmarks" / "guide_pictures.py").read_text(), re.MULTILINE)
    kept = sorted(path.stem for path in (ROOT / "docs" / "guide" / "pictures").glob("*.png"))
    assert kept == sorted(drawn)
    assert all(f"pictures/{name}.png" in pages for name in kept)

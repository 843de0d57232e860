"""Documents name files that exist, and link to each other."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])


def missing_paths(text: str, folder: Path) -> list[str]:
    """Relative links that lead nowhere, and paths in backticks that are neither below the root nor below the package.

    What the build of the site generates is its own to check.
    """
    links = [target.split("#")[0] for target in re.findall(r"\]\((?!https?:)([^)#][^)]*)\)", text)]
    paths = re.findall(r"`([\w./-]+(?:\.py|/))`", text)
    lost = [t for t in links if not t.startswith("_generated/") and not (folder / t).exists()]
    return lost + [path for path in paths if not ((ROOT / path).exists() or (ROOT / "tpmscad" / path).exists())]


@pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: path.name)
def test_a_document_names_files_that_exist(path: Path) -> None:
    assert not missing_paths(path.read_text(), path.parent)


def test_a_lost_file_is_noticed() -> None:
    assert missing_paths("see `brep/no_such_module.py`", ROOT) == ["brep/no_such_module.py"]
    assert missing_paths("see [the guide](no_such_page.md)", ROOT) == ["no_such_page.md"]

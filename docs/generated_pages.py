"""Pages of the guide that are made from the code: reference, keys of recipes, commands, the catalogue and the gallery."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import command_pages
import gallery_pages
import reference_pages

from tpmscad.recipe.key_reference import format_reference


def write_all(folder: Path) -> None:
    """Write the generated pages into a folder, and nothing else is left there; what has not changed keeps its date."""
    pages: dict[str, str | bytes] = {
        **reference_pages.make_reference(),
        **command_pages.make_commands(),
        **gallery_pages.make_gallery(),
        "recipe_keys.txt": format_reference(None, width=100),
        "catalogue.txt": run_command("surfaces"),
    }
    contents = {folder / name: text.encode() if isinstance(text, str) else text for name, text in pages.items()}
    for path, content in contents.items():
        path.parent.mkdir(parents=True, exist_ok=True)
        if not path.exists() or path.read_bytes() != content:
            path.write_bytes(content)
    for path in folder.rglob("*"):
        if path.is_file() and path not in contents:
            path.unlink()


def run_command(*arguments: str) -> str:
    """What `tpmscad` prints."""
    command = [sys.executable, "-m", "tpmscad", *arguments]
    plain = {**os.environ, "TERM": "dumb", "NO_COLOR": "1", "COLUMNS": "100"}
    return subprocess.run(command, capture_output=True, text=True, check=True, env=plain).stdout

"""Files that are whole or not there: written aside in the same folder, then renamed."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from tpmscad.errors import InvalidRequest

STEP_SUFFIXES = (".step", ".stp")


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """A new name beside `path` to write to; renamed to `path` at the end, removed if anything goes wrong."""
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield aside
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def validate_step_path(path: str | os.PathLike[str]) -> Path:
    """The path, if a STEP file can be put there."""
    path = Path(path)
    if path.suffix.lower() not in STEP_SUFFIXES:
        raise InvalidRequest(f"{path} ends in {path.suffix!r}: give it a name ending in {' or '.join(STEP_SUFFIXES)}")
    if not path.parent.is_dir():
        raise InvalidRequest(f"the folder {path.parent} of {path.name} does not exist: make it first")
    return path

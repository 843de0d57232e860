"""Atomic writing of files: a file is complete or absent."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from tpmscad.errors import InvalidRequest


@contextmanager
def atomic_write(path: Path) -> Iterator[Path]:
    """Temporary path in the folder of `path`; renamed to `path` on success, removed on failure."""
    aside = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        yield aside
        os.replace(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def validate_output_path(path: str | os.PathLike[str], suffixes: Sequence[str]) -> Path:
    """The path, if its folder exists and it ends in one of the suffixes; else InvalidRequest."""
    path = Path(path)
    if path.suffix.lower() not in suffixes:
        raise InvalidRequest(f"{path} ends in {path.suffix!r}: give it a name ending in {' or '.join(suffixes)}")
    if not path.parent.is_dir():
        raise InvalidRequest(f"the folder {path.parent} of {path.name} does not exist: make it first")
    return path

"""The manifest of a lattice in slabs: a JSON file with the request and, for each file, what it holds and its hash.

A later run with the same request keeps the files whose hash the manifest knows. The manifest is written anew after every file,
so that an interrupted run loses no work.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from tpmscad.atomic_file import atomic_write
from tpmscad.files.slab_files import SlabFile, SlabOriginal, hash_file


@dataclass(slots=True)
class Manifest:
    """The state of a run: rows by file name, hashes of the originals, certificates as plain values, and what was kept."""

    path: Path
    request: dict[str, Any]
    rows: dict[str, SlabFile] = field(default_factory=dict)
    originals: list[str] = field(default_factory=list)
    certificates: list[dict[str, Any]] = field(default_factory=list)

    def add(self, row: SlabFile) -> None:
        """Note a finished file."""
        self.rows[row.file] = row
        self._write()

    def begin(self, originals: Sequence[SlabOriginal]) -> None:
        """Take note of the originals; files that were copied from others are written again."""
        hashes = [original.sha256 for original in originals]
        if hashes != self.originals:
            self.rows.clear()
        self.originals = hashes
        self.certificates = [original.certificate.to_dict() for original in originals]

    def _write(self) -> None:
        content = {
            "request": self.request,
            "originals": self.originals,
            "certificates": self.certificates,
            "slabs": [asdict(row) for row in self.rows.values()],
        }
        with atomic_write(self.path) as aside:
            aside.write_text(json.dumps(content, indent=1, allow_nan=False) + "\n", encoding="ascii")


def open_manifest(path: Path, request: dict[str, Any]) -> Manifest:
    """The manifest of an earlier run of the request, with the rows of files that are there and whole; else an empty one."""
    known = _read_json(path)
    request = json.loads(json.dumps(request))
    if known.get("request") != request:
        return Manifest(path, request)
    rows: dict[str, SlabFile] = {}
    for entry in known["slabs"]:
        values = {f.name: entry[f.name] for f in fields(SlabFile)}
        row = SlabFile(**values | {"origin": tuple(values["origin"]), "cells": tuple(values["cells"])})
        file = path.parent / row.file
        if file.is_file() and file.stat().st_size == row.size and hash_file(file) == row.sha256:
            rows[row.file] = row
    return Manifest(path, request, rows, known["originals"], known["certificates"])


def _read_json(path: Path) -> dict[str, Any]:
    """The content of a manifest; nothing if it is not there or not readable."""
    try:
        content = json.loads(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return {}
    return content if isinstance(content, dict) else {}

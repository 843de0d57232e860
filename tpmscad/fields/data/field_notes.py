"""What was assumed of the data that a field is made of."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

from tpmscad.fields.field import Field


def collect_notes(field: Any) -> tuple[str, ...]:
    """The notes of a field and of all fields that it is made of, each once."""
    notes: dict[str, None] = {}
    seen: set[int] = set()
    pending = [field]
    while pending:
        part = pending.pop()
        if id(part) in seen:
            continue
        seen.add(id(part))
        if isinstance(part, list | tuple):
            pending.extend(reversed(part))
        elif isinstance(part, Field) and is_dataclass(part):
            notes.update(dict.fromkeys(getattr(part, "notes", ())))
            pending.extend(getattr(part, each.name) for each in reversed(fields(part)))
    return tuple(notes)

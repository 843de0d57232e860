"""What was assumed of the data that a field is made of."""

from __future__ import annotations

from typing import Any

from tpmscad.fields.field import Field


def collect_notes(field: Any) -> tuple[str, ...]:
    """The notes of a field and of all fields that it is made of, each once."""
    notes: dict[str, None] = {}
    seen: set[int] = set()
    pending: list[Any] = [field]
    while pending:
        part = pending.pop()
        if id(part) in seen:
            continue
        seen.add(id(part))
        if isinstance(part, list | tuple):
            pending.extend(reversed(part))
        elif isinstance(part, Field):
            notes.update(dict.fromkeys(getattr(part, "notes", ())))
            pending.extend(getattr(part, name) for name in reversed(getattr(part, "__dataclass_fields__", {})))
    return tuple(notes)

"""The data that a field is made of: what was assumed of them, and how finely they are sampled."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from tpmscad.fields.field import Field

DEFAULT_TOL_SPACINGS = 0.1
"""In spacings of samples: the tolerance of a solid of data if none is asked for, also where that of a lattice, which follows from
its cell, is less: in a bone of voxels of .5 mm a cell of 1.2 mm would ask for .0012. Noise is no surface to follow so closely."""


def collect_notes(field: Any) -> tuple[str, ...]:
    """The notes of a field and of all fields that it is made of, each once."""
    return tuple(dict.fromkeys(note for part in _iterate_parts(field) for note in getattr(part, "notes", ())))


def find_least_spacing(field: Field) -> float | None:
    """The least spacing of samples that a field is made of, model units; None of formulas."""
    boxes = [(part, box) for part in _iterate_parts(field) if (box := part.data_box()) is not None]
    # a moved part counts as it lies, and not as its own field does, too
    inner = {id(each) for part, _ in boxes for each in _iterate_parts(part) if each is not part}
    steps = (min(getattr(part, "spacing", (box.least_step,))) for part, box in boxes if id(part) not in inner)
    return min(steps, default=None)


def _iterate_parts(field: Any) -> Iterator[Any]:
    """A field and all fields that it is made of, each once."""
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
            yield part
            pending.extend(getattr(part, name) for name in reversed(getattr(part, "__dataclass_fields__", {})))

"""Values of a recipe replaced from outside, as a sweep does: the key is written as in messages, `structures[1].level`."""

from __future__ import annotations

import copy
import re
from collections.abc import Mapping
from typing import Any

from tpmscad.errors import RecipeError
from tpmscad.recipe.key_lines import KeyPath

_KEY = re.compile(r"[A-Za-z0-9_-]+(?:\[\d+\])*(?:\.[A-Za-z0-9_-]+(?:\[\d+\])*)*")
_PART = re.compile(r"([A-Za-z0-9_-]+)|\[(\d+)\]")


def read_key_path(key: str) -> KeyPath:
    """The keys and indices of `structures[1].level`: ("structures", 1, "level"); RecipeError if it is none of this form."""
    if not _KEY.fullmatch(key):
        raise RecipeError(f"{key!r} is no key of a recipe: write it as tol or structures[0].level")
    return tuple(int(index) if index else name for name, index in _PART.findall(key))


def replace_values(document: dict[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """A copy of a document with other values; a last key may be new. RecipeError names the part that is not there."""
    changed: dict[str, Any] = copy.deepcopy(document)
    for key, value in changes.items():
        *parents, last = read_key_path(key)
        holder: Any = changed
        for part in parents:
            holder = holder[part] if _holds(holder, part) else None
        is_place = isinstance(holder, dict) if isinstance(last, str) else _holds(holder, last)
        if not is_place:
            raise RecipeError(f"{key}: the recipe has no such place; name tables and entries of arrays that it has")
        holder[last] = list(value) if isinstance(value, tuple) else value
    return changed


def _holds(holder: Any, part: str | int) -> bool:
    """Whether a table has a key, or an array an entry."""
    if isinstance(part, str):
        return isinstance(holder, dict) and part in holder
    return isinstance(holder, list) and part < len(holder)

"""Entries of a TOML document with their positions, so that every error names the file, the line and the key.

Values can be replaced from outside, as a sweep does: the key is written as in messages, `structures[1].level`.
"""

from __future__ import annotations

import copy
import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from tpmscad.api.argument_kinds import show_value
from tpmscad.errors import RecipeError
from tpmscad.recipe.key_lines import KeyPath, find_key_lines

SUGGESTION_CUTOFF = 0.5
"""Least similarity (ratio of difflib) of a suggested word: "tol" is suggested for "tolerance"."""

_KEY = re.compile(r"[A-Za-z0-9_-]+(?:\[\d+\])*(?:\.[A-Za-z0-9_-]+(?:\[\d+\])*)*")
_PART = re.compile(r"([A-Za-z0-9_-]+)|\[(\d+)\]")


@dataclass(frozen=True, slots=True)
class Document:
    """A TOML file: its values, and the line of every key."""

    file: Path
    lines: Mapping[KeyPath, int]
    values: dict[str, Any]

    @property
    def top(self) -> Entry:
        """The top table."""
        return Entry(self, (), self.values)


@dataclass(frozen=True, slots=True)
class Entry:
    """A value of a document (a table, an array, a string, a number or a boolean) and its key path.

    `active_names` are the fields under `[fields.NAME]` that are being read when this entry is.
    """

    document: Document
    path: KeyPath
    value: Any
    active_names: tuple[str, ...] = ()

    def __getitem__(self, key: str) -> Entry:
        """The entry of a key of this table; RecipeError if the key is missing."""
        if key not in self.value:
            raise self.error(f"the key {key!r} is missing")
        return self.part(key)

    def part(self, *place: str | int) -> Entry:
        """The entry at keys and indices below this one, which must be there."""
        inner = self.value
        for key in place:
            inner = inner[key]
        return replace(self, path=(*self.path, *place), value=inner)

    def items(self) -> list[Entry]:
        """The entries of an array."""
        if not isinstance(self.value, list):
            raise self.error(f"must be an array [...], not {self.value_text}")
        return [self.part(k) for k in range(len(self.value))]

    def table(self, *known: str) -> Entry:
        """This entry; RecipeError unless it is a table without other keys than `known` (any keys if there are none)."""
        if not isinstance(self.value, dict):
            raise self.error(f"must be a table, not {self.value_text}")
        for key in self.value:
            if known and key not in known:
                raise self.part(key).error(f"unknown key; {suggest_word(key, known)}")
        return self

    def word(self, known: Sequence[str]) -> str:
        """The value; RecipeError if it is not one of the known words."""
        if not isinstance(self.value, str):
            raise self.error(f"must be a string, not {self.value_text}")
        if self.value not in known:
            raise self.error(f"{self.value!r} is unknown; {suggest_word(self.value, known)}")
        return self.value

    def sibling_file(self) -> Path:
        """The path of an existing file, which this string gives relative to the folder of the document."""
        named = self.document.file.parent / self.value
        if not named.is_file():
            raise self.error(f"there is no file {named}")
        return named

    @property
    def value_text(self) -> str:
        """The value in one line, for messages."""
        if isinstance(self.value, dict):
            return "a table"
        return str(self.value).lower() if isinstance(self.value, bool) else show_value(self.value)

    @property
    def key(self) -> str:
        """The key path as it is written: structures[1].period."""
        parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in self.path)
        return "".join(parts).removeprefix(".")

    def error(self, message: str) -> RecipeError:
        """A RecipeError with the file, the line and the key of this entry before `message`."""
        name, lines, known = self.document.file.name, self.document.lines, self.path
        while known and known not in lines:
            known = known[:-1]
        where = f"{name}, line {lines[known]}" if known else name
        return RecipeError(f"{where}, {self.key}: {message}" if self.key else f"{where}: {message}")

    def locate(self, message: str, given: Mapping[str, Entry] | None = None) -> RecipeError:
        """The error with the line of the entry that the message is about, or that of this table.

        This is the entry whose name begins the message, or the last one whose name it quotes, or the one whose file begins it, or
        whose text it quotes. `given` are the entries by
        the names that messages use, by default those of this table.
        """
        given = {key: self.part(key) for key in self.value} if given is None else given
        quoted = re.findall(r"'([^']+)'", message)[::-1]
        first = re.split(r"[ `:'=\[]", message.lstrip("`'"))[0]
        about = [given[word] for word in (first, *quoted) if word in given]
        about += [entry for entry in given.values() if isinstance(entry.value, str) and Path(entry.value).name == first]
        about += [entry for word in quoted for entry in given.values() if entry.value == word]
        return (about[0] if about else self).error(message)


def suggest_word(word: str, known: Sequence[str]) -> str:
    """The most similar of the known words, or all of them."""
    near = get_close_matches(word, known, n=1, cutoff=SUGGESTION_CUTOFF)
    return f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(known)}"


def read_document(file: Path, changes: Mapping[str, Any] | None = None) -> Entry:
    """The top table of a TOML file, with other values for some keys; RecipeError if the file is not valid TOML."""
    try:
        text = file.read_text("utf-8-sig")  # editors of Windows begin a file with a byte order mark
        values = tomllib.loads(text)
        lines = find_key_lines(text)
    except tomllib.TOMLDecodeError as error:
        raise RecipeError(f"{file.name} is not TOML: {error}") from error
    except UnicodeDecodeError as error:
        raise RecipeError(f"{file.name} is not TOML, which must be UTF-8 text: {error}") from error
    except RecursionError:
        raise RecipeError(f"{file.name} has arrays or tables nested too deeply: a recipe needs a few levels") from None
    except ValueError as error:  # such as a whole number of more digits than Python reads
        raise RecipeError(f"{file.name} holds a value that cannot be read: {error}") from error
    return Document(file, lines, replace_values(values, changes) if changes else values).top


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

"""Entries of a TOML document with their positions, so that every error names the file, the line and the key."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from difflib import get_close_matches
from pathlib import Path
from typing import Any

from tpmscad.api.argument_kinds import GREATEST, show_value
from tpmscad.errors import RecipeError
from tpmscad.recipe.key_changes import replace_values
from tpmscad.recipe.key_lines import KeyPath, find_key_lines

SUGGESTION_CUTOFF = 0.5
"""Least similarity (ratio of difflib) of a suggested word: "tol" is suggested for "tolerance"."""


@dataclass(frozen=True, slots=True)
class Entry:
    """A value of the document (a table, an array, a string, a number or a boolean), its key path and the line of every key."""

    file: Path
    lines: dict[KeyPath, int]
    path: KeyPath
    value: Any

    def __getitem__(self, key: str) -> Entry:
        """The entry of a key of this table; RecipeError if the key is missing."""
        found = self.get(key)
        if found is None:
            raise self.error(f"the key {key!r} is missing")
        return found

    def get(self, key: str) -> Entry | None:
        """The entry of a key of this table, or None."""
        if key not in self.value:
            return None
        return replace(self, path=(*self.path, key), value=self.value[key])

    def items(self) -> list[Entry]:
        """The entries of an array."""
        if not isinstance(self.value, list):
            raise self.error(f"must be an array [...], not {self.value_text}")
        return [replace(self, path=(*self.path, k), value=value) for k, value in enumerate(self.value)]

    def table(self, *known: str) -> Entry:
        """This entry; RecipeError unless it is a table without other keys than `known` (any keys if there are none)."""
        if not isinstance(self.value, dict):
            raise self.error(f"must be a table, not {self.value_text}")
        for key in self.value:
            if known and key not in known:
                wrong = replace(self, path=(*self.path, key))
                raise wrong.error(f"unknown key; {suggest_word(key, known)}")
        return self

    def number(self) -> float:
        """The value as a float; RecipeError if it is not a finite number."""
        if isinstance(self.value, bool) or not isinstance(self.value, int | float):
            raise self.error(f"must be a number, not {self.value_text}")
        if isinstance(self.value, float) and not math.isfinite(self.value):
            raise self.error(f"{self.value} must be finite")
        if abs(self.value) > GREATEST:
            raise self.error(f"{show_value(self.value)} is beyond {GREATEST:g}, the greatest number taken")
        return float(self.value)

    def positive(self) -> float:
        """The value as a float; RecipeError if it is not a positive number."""
        if self.number() <= 0:
            raise self.error(f"{self.value:g} must be positive")
        return self.number()

    def integer(self, least: int = 1) -> int:
        """The value; RecipeError if it is not an integer of at least `least`."""
        if isinstance(self.value, bool) or not isinstance(self.value, int):
            raise self.error(f"must be a whole number, not {self.value_text}")
        if self.value < least:
            raise self.error(f"{self.value} must be at least {least}")
        return self.value

    def boolean(self) -> bool:
        """The value; RecipeError if it is not true or false."""
        if not isinstance(self.value, bool):
            raise self.error(f"must be true or false, not {self.value_text}")
        return self.value

    def string(self, choices: Sequence[str] = ()) -> str:
        """The value; RecipeError if it is not a string, or not one of `choices` if there are any."""
        if not isinstance(self.value, str):
            raise self.error(f"must be a string, not {self.value_text}")
        if choices and self.value not in choices:
            raise self.error(f"{self.value!r} is unknown; {suggest_word(self.value, choices)}")
        return self.value

    def numbers(self, count: int) -> tuple[float, ...]:
        """The values of an array of `count` finite numbers."""
        return tuple(item.number() for item in self.array_of_length(count, "numbers"))

    def array_of_length(self, count: int, what: str) -> list[Entry]:
        """The entries of an array of length `count`; `what` names them in the error."""
        items = self.items()
        if len(items) != count:
            raise self.error(f"must be {count} {what}, not {len(items)}")
        return items

    def sibling_file(self) -> Path:
        """The path of an existing file, which this string gives relative to the folder of the document."""
        named = self.file.parent / self.string()
        if not named.is_file():
            raise self.error(f"there is no file {named}")
        return named

    @property
    def value_text(self) -> str:
        """A short description of the value, for messages."""
        if isinstance(self.value, dict):
            return "a table"
        if isinstance(self.value, list):
            return f"an array of {len(self.value)}"
        return f"{str(self.value).lower()}" if isinstance(self.value, bool) else f"{self.value!r}"

    @property
    def key(self) -> str:
        """The key path as it is written: structures[1].period."""
        parts = (f"[{part}]" if isinstance(part, int) else f".{part}" for part in self.path)
        return "".join(parts).removeprefix(".")

    def error(self, message: str) -> RecipeError:
        """A RecipeError with the file, the line and the key of this entry before `message`."""
        known = self.path
        while known and known not in self.lines:
            known = known[:-1]
        where = f"{self.file.name}, line {self.lines[known]}" if known else self.file.name
        return RecipeError(f"{where}, {self.key}: {message}" if self.key else f"{where}: {message}")

    def locate(self, message: str) -> RecipeError:
        """The error with the line of the key of this table that the message begins with, or that of the table."""
        first = message.split(" ", 1)[0].strip("`:'=")
        return (self[first] if first in self.value else self).error(message)


def suggest_word(word: str, known: Sequence[str]) -> str:
    """The most similar of the known words, or all of them."""
    near = get_close_matches(word, known, n=1, cutoff=SUGGESTION_CUTOFF)
    return f"did you mean {near[0]!r}?" if near else f"choose one of {', '.join(known)}"


def read_document(file: Path, changes: Mapping[str, Any] | None = None) -> Entry:
    """The top table of a TOML file, with other values for some keys; RecipeError if the file is not valid TOML."""
    try:
        text = file.read_text("utf-8-sig")  # editors of Windows begin a file with a byte order mark
        values = tomllib.loads(text)
        lines = dict(find_key_lines(text))
    except tomllib.TOMLDecodeError as error:
        raise RecipeError(f"{file.name} is not TOML: {error}") from error
    except UnicodeDecodeError as error:
        raise RecipeError(f"{file.name} is not TOML, which must be UTF-8 text: {error}") from error
    except RecursionError:
        raise RecipeError(f"{file.name} has arrays or tables nested too deeply: a recipe needs a few levels") from None
    except ValueError as error:  # such as a whole number of more digits than Python reads
        raise RecipeError(f"{file.name} holds a value that cannot be read: {error}") from error
    return Entry(file, lines, (), replace_values(values, changes) if changes else values)

"""On which line each key of a TOML document stands: what the standard library's parser does not tell.

A scanner of documents that `tomllib` has accepted already, so it needs to know where keys and values begin and end, not what is
allowed. (TOML Kit keeps a document's style, but not where its keys are.)
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator, Mapping

KeyPath = tuple[str | int, ...]
"""Keys and places in arrays, from the top: ("structures", 1, "period")."""

_GAP = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")
_BARE = re.compile(r"[A-Za-z0-9_-]+")
_PLAIN = re.compile(r"[^,\]}#\r\n]+")
_STRINGS = (
    re.compile(r'"""(?:\\.|[^\\])*?"{3,5}(?!")', re.DOTALL),
    re.compile(r"'''.*?'{3,5}(?!')", re.DOTALL),
    re.compile(r'"(?:\\.|[^"\\])*"'),
    re.compile(r"'[^']*'"),
)


def find_key_lines(text: str) -> Mapping[KeyPath, int]:
    """The line, from 1, of every key and of every entry of an array; of a table's header for the table and those above it."""
    scanner = _Scanner(text)
    scanner.document()
    return scanner.lines


class _Scanner:
    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[KeyPath, int] = {}
        self._lengths: dict[KeyPath, int] = {}

    def document(self) -> None:
        table: KeyPath = ()
        self._skip(_GAP)
        while self.at < len(self.text):
            if self._take("[["):
                parent, last = self._table(self._key())
                array = (*parent, last)
                index = self._lengths.get(array, 0)
                self._lengths[array] = index + 1
                table = (*array, index)
                self._note(table)
                self._take("]]")
            elif self._take("["):
                parent, last = self._table(self._key())
                table = (*parent, last)
                self._note(table)
                self._take("]")
            else:
                self._pair(table)
            self._skip(_GAP)

    def _table(self, keys: list[str]) -> tuple[KeyPath, str]:
        """Where a header points: of the arrays of tables on its way the last entry."""
        path: KeyPath = ()
        for key in keys[:-1]:
            path = (*path, key)
            if path in self._lengths:
                path = (*path, self._lengths[path] - 1)
        return path, keys[-1]

    def _pair(self, table: KeyPath) -> None:
        path = (*table, *self._key())
        self._note(path)
        self._take("=")
        self._skip(_SPACE)
        self._value(path)

    def _value(self, path: KeyPath) -> None:
        if self._take("["):
            for index in self._until("]"):
                self._note((*path, index))
                self._value((*path, index))
        elif self._take("{"):
            for _ in self._until("}"):
                self._pair(path)
        elif not any(self._skip(pattern) for pattern in _STRINGS):
            self._skip(_PLAIN)

    def _until(self, end: str) -> Iterator[int]:
        """Counts the entries up to a closing bracket, standing at each in turn."""
        index = 0
        self._skip(_GAP)
        while not self._take(end):
            yield index
            index += 1
            self._skip(_GAP)
            self._take(",")
            self._skip(_GAP)

    def _key(self) -> list[str]:
        """A dotted key, the spaces around it skipped."""
        parts = []
        while True:
            self._skip(_SPACE)
            start = self.at
            if any(self._skip(pattern) for pattern in _STRINGS[2:]):
                parts.append(tomllib.loads(f"key = {self.text[start : self.at]}")["key"])
            else:
                self._skip(_BARE)
                parts.append(self.text[start : self.at])
            self._skip(_SPACE)
            if not self._take("."):
                return parts

    def _note(self, path: KeyPath) -> None:
        line = self.text.count("\n", 0, self.at) + 1
        for length in range(1, len(path) + 1):
            self.lines.setdefault(path[:length], line)

    def _skip(self, pattern: re.Pattern[str]) -> bool:
        found = pattern.match(self.text, self.at)
        if found is None:
            return False
        self.at = found.end()
        return True

    def _take(self, token: str) -> bool:
        if not self.text.startswith(token, self.at):
            return False
        self.at += len(token)
        return True

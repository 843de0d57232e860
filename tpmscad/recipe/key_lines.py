"""The line of every key in a TOML document, which the parser of the standard library does not report.

The scanner reads documents that `tomllib` has already accepted. It therefore finds where keys and values begin and end, and
does not check what is allowed.
"""

from __future__ import annotations

import re
import tomllib
from bisect import bisect_left
from collections.abc import Iterator, Mapping

KeyPath = tuple[str | int, ...]
"""Keys and indices in arrays, from the top table: ("structures", 1, "period")."""

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
    """The line, counted from 1, of every key and array entry; a table has the line of its first header."""
    scanner = _KeyLineScanner(text)
    scanner.scan_document()
    return scanner.lines


class _KeyLineScanner:
    """A position in the text, and the lines of the keys found before it."""

    def __init__(self, text: str) -> None:
        self.text = text
        self.at = 0
        self.lines: dict[KeyPath, int] = {}
        self._lengths: dict[KeyPath, int] = {}
        self._line_ends = [match.start() for match in re.finditer("\n", text)]

    def scan_document(self) -> None:
        """Record the line of every key of the document."""
        table: KeyPath = ()
        self._skip(_GAP)
        while self.at < len(self.text):
            if self._take("[["):
                parent, last = self._resolve_header(self._scan_key())
                array = (*parent, last)
                index = self._lengths.get(array, 0)
                self._lengths[array] = index + 1
                table = (*array, index)
                self._record_line(table)
                self._take("]]")
            elif self._take("["):
                parent, last = self._resolve_header(self._scan_key())
                table = (*parent, last)
                self._record_line(table)
                self._take("]")
            else:
                self._scan_pair(table)
            self._skip(_GAP)

    def _resolve_header(self, keys: list[str]) -> tuple[KeyPath, str]:
        """The path of the table around a header, and its last key; arrays of tables on the way stand for their last entry."""
        path: KeyPath = ()
        for key in keys[:-1]:
            path = (*path, key)
            if path in self._lengths:
                path = (*path, self._lengths[path] - 1)
        return path, keys[-1]

    def _scan_pair(self, table: KeyPath) -> None:
        path = (*table, *self._scan_key())
        self._record_line(path)
        self._take("=")
        self._skip(_SPACE)
        self._scan_value(path)

    def _scan_value(self, path: KeyPath) -> None:
        if self._take("["):
            for index in self._iterate_items("]"):
                self._record_line((*path, index))
                self._scan_value((*path, index))
        elif self._take("{"):
            for _ in self._iterate_items("}"):
                self._scan_pair(path)
        elif not any(self._skip(pattern) for pattern in _STRINGS):
            self._skip(_PLAIN)

    def _iterate_items(self, end: str) -> Iterator[int]:
        """The indices of the entries up to a closing bracket; the position is at each entry in turn."""
        index = 0
        self._skip(_GAP)
        while not self._take(end):
            yield index
            index += 1
            self._skip(_GAP)
            self._take(",")
            self._skip(_GAP)

    def _scan_key(self) -> list[str]:
        """The parts of a dotted key; the spaces around them are skipped."""
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

    def _record_line(self, path: KeyPath) -> None:
        """Record the current line for a path, and for the tables above it that have none yet."""
        line = bisect_left(self._line_ends, self.at) + 1
        for length in range(1, len(path) + 1):
            self.lines.setdefault(path[:length], line)

    def _skip(self, pattern: re.Pattern[str]) -> bool:
        """Move past a match of the pattern; False if there is none here."""
        found = pattern.match(self.text, self.at)
        if found is None:
            return False
        self.at = found.end()
        return True

    def _take(self, token: str) -> bool:
        """Move past a token; False if it is not here."""
        if not self.text.startswith(token, self.at):
            return False
        self.at += len(token)
        return True

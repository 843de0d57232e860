"""The entities of a Part 21 file as arrays, read from its text by a scanner of its own.

The scanner shares nothing with the writers. An entity is its *template*, the text with each number replaced by a mark, and the
row of its numbers: `#7=CARTESIAN_POINT('',(1.5,0.,2.));` has the template `CARTESIAN_POINT('',(&,&,&))` and the row (1.5, 0, 2).
A file of millions of entities has a few hundred templates. Marks: `#` a reference, `@` an integer, `&` a real. `EntityRows` holds
entities by their number against the template that is expected, for what checks a file's text.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tpmscad._compiled_loops import njit_cached
from tpmscad._typing import Array, BoolArray, IntArray
from tpmscad.errors import KernelError

CHUNK_BYTES = 1 << 25
"""Bytes of text that are scanned at a time."""

MAX_NUMBER_RATIO = 100
"""Entity numbers may exceed the number of entities by this factor; a writer numbers them consecutively."""

ROUND_OFF = 1e-12
"""Difference of directions, radii and lengths, relative to their size, that comes from another order of operations."""

_NUMBER = re.compile(r"'(?:[^']|'')*'|(?<=[(,])(#\d+|[+-]?\d+(?:\.\d*(?:E[+-]?\d+)?)?)")

_EXACT_POWERS = np.array([10.0**k for k in range(23)])
"""The powers of ten that are floats: a quotient or product of one and an integer below 2^53 is rounded once, hence exact."""


@dataclass(frozen=True, slots=True, eq=False)
class EntityTable:
    """The entities of a data section, in file order.

    number (n,): entity numbers. template (n,): index into `templates`. start (n + 1,): the numbers of entity i are
    values[start[i] : start[i + 1]]. place (n, 2): first byte and end of its text in the file. frame: the text around
    the data section. row: position of each entity number, -1 where there is none.
    """

    number: IntArray
    template: IntArray
    templates: tuple[str, ...]
    start: IntArray
    values: Array
    place: IntArray
    frame: tuple[bytes, bytes]
    row: IntArray

    def positions(self, numbers: Array | IntArray) -> IntArray:
        """Positions of entities in the table, -1 where there is none."""
        asked = np.asarray(numbers).astype(np.int64)
        inside = (asked >= 0) & (asked < len(self.row))
        return self.row[asked] if inside.all() else np.where(inside, self.row[asked * inside], -1)

    def keywords(self) -> tuple[str, ...]:
        """Keyword of each template, "" for complex entities."""
        return tuple(t[: t.find("(")] for t in self.templates)


def require(condition: Any, what: str) -> None:
    """KernelError that names what differs, unless the condition holds."""
    if not np.all(condition):
        raise KernelError("export_step", f"the text of the file is not what was meant: {what}")


class EntityRows:
    """The numbers of entities that are asked for by number and template, and which entities were."""

    def __init__(self, table: EntityTable) -> None:
        self.table = table
        self.keyword = table.keywords()
        self.known = np.zeros(len(table.number), bool)

    def rows(self, numbers: Array | IntArray, template: str) -> Array:
        """Numbers (n, m) in the entities of the given numbers, all of which must have the template."""
        at = self.table.positions(numbers)
        require(at >= 0, f"a reference leads nowhere instead of to {template}")
        wanted = [i for i, t in enumerate(self.table.templates) if t == template]
        require(np.isin(self.table.template[at], wanted), f"there is another entity in place of {template}")
        self.known[at] = True
        start = self.table.start[at]
        return self.table.values[start[:, None] + np.arange(len(template_marks(template)))]

    def with_keyword(self, keyword: str) -> IntArray:
        """Positions of the entities with a keyword."""
        return np.flatnonzero(np.isin(self.table.template, [i for i, k in enumerate(self.keyword) if k == keyword]))

    def points(self, numbers: Array) -> Array:
        """Coordinates of points (n, 3)."""
        return self.rows(numbers, "CARTESIAN_POINT('',(&,&,&))")

    def directions(self, numbers: Array) -> Array:
        """Components of directions (n, 3)."""
        return self.rows(numbers, "DIRECTION('',(&,&,&))")

    def frames(self, numbers: Array) -> Array:
        """Origin, axis and reference direction (n, 3, 3) of placements."""
        origin, axis, x = self.rows(numbers, "AXIS2_PLACEMENT_3D('',#,#,#)").T
        return np.stack([self.points(origin), self.directions(axis), self.directions(x)], axis=1)


def template_marks(template: str) -> str:
    """The marks of a template in order, strings left out."""
    return "".join(re.findall(r"[#@&]", re.sub(r"'(?:[^']|'')*'", "", template)))


def agree(read: Array, meant: Array) -> BoolArray:
    """Whether rows (n, m) agree to round-off: (n,)."""
    size = np.maximum(1.0, np.abs(meant).max(axis=1, initial=0.0))
    return np.asarray(np.abs(read - meant).max(axis=1, initial=0.0) <= ROUND_OFF * size, bool)


def read_entity_table(path: Path) -> EntityTable:
    """The entities of a file; KernelError if its text is no exchange structure or ends early."""
    with path.open("rb") as file:
        rest = file.read(CHUNK_BYTES)
        begin = rest.find(b"\nDATA;\n") + 7
        if begin < 7 or not rest.startswith(b"ISO-10303-21;\n"):
            raise KernelError("read text", "the file has no header or no data section")
        head, rest, at = rest[:begin], rest[begin:], begin
        parts, samples = [], dict[int, str]()
        while True:
            more = file.read(CHUNK_BYTES)
            cut = len(rest) if not more else rest.rfind(b";\n") + 2
            if not more:
                cut = rest.rfind(b"ENDSEC;\n")
                if cut < 0:
                    raise KernelError("read text", "the data section does not end")
            text = np.frombuffer(rest, np.uint8)[:cut]
            parts.append(_scan_chunk(text, rest, at, samples))
            at, rest = at + cut, rest[cut:] + more
            if not more:
                break
    number, code, count, values, place = (np.concatenate(column) for column in zip(*parts, strict=True))
    codes, template = np.unique(code, return_inverse=True)
    if number.max(initial=0) > MAX_NUMBER_RATIO * len(number):
        raise KernelError("read text", f"an entity has the number {number.max()}, though there are {len(number)}")
    row = np.full(int(number.max(initial=0)) + 1, -1)
    row[number] = np.arange(len(number))
    return EntityTable(
        number,
        template.ravel(),
        tuple(samples[c] for c in codes.tolist()),
        np.concatenate([[0], np.cumsum(count)]),
        values,
        place,
        (head, rest),
        row,
    )


def _scan_chunk(text: Any, raw: bytes, at: int, samples: dict[int, str]) -> tuple[Any, ...]:
    """Columns of the entities of a piece of text; new templates are added to `samples` by their hash."""
    n_entities = int(np.count_nonzero(text == ord("="))) + 1
    n_values = int(np.count_nonzero((text == ord(",")) | (text == ord("(")))) + 1
    number, code, count = np.empty(n_entities, np.int64), np.empty(n_entities, np.int64), np.empty(n_entities, np.int64)
    values, slow, place = np.empty(n_values), np.empty((n_values, 3), np.int64), np.empty((n_entities, 2), np.int64)
    n, m, k, stop = _scan(text, _EXACT_POWERS, number, code, count, values, slow, place)
    if stop < len(text):
        raise KernelError("read text", f"no entity at byte {at + stop}: {raw[stop : stop + 40]!r}")
    for i, first, end in slow[:k].tolist():
        values[i] = float(raw[first:end])
    new, where = np.unique(code[:n], return_index=True)
    for c, i in zip(new.tolist(), where.tolist(), strict=True):
        if c not in samples:
            first, end = place[i].tolist()
            samples[c] = make_template(raw[first:end].decode("latin-1").split("=", 1)[1].rstrip(";\n"))
    return number[:n], code[:n], count[:n], values[:m], place[:n] + at


def make_template(body: str) -> str:
    """The text of an entity with its numbers replaced by marks; strings stay."""

    def mark(found: re.Match[str]) -> str:
        number = found.group(1)
        if number is None:
            return found.group(0)
        return "#" if number[0] == "#" else "&" if "." in number else "@"

    return _NUMBER.sub(mark, body)


@njit_cached
def _scan(
    text: Any, powers: Any, number: Any, code: Any, count: Any, values: Any, slow: Any, place: Any
) -> tuple[int, int, int, int]:
    """Numbers of entities, values and values left to Python, and where the scan stopped: the end, or where no entity begins."""
    n, m, k, at, size = 0, 0, 0, 0, len(text)
    while at < size:
        begin = at
        if text[at] != 35:  # '#'
            return n, m, k, begin
        at += 1
        value = 0
        while at < size and 48 <= text[at] <= 57:
            value = 10 * value + text[at] - 48
            at += 1
        if at >= size or text[at] != 61:  # '='
            return n, m, k, begin
        number[n] = value
        at += 1
        first_value, h, before, quoted = m, np.uint64(0xCBF29CE484222325), 0, False
        while at < size:
            c = text[at]
            if quoted:
                quoted = c != 39
            elif c == 59:  # ';'
                break
            elif c == 39:
                quoted = True
            elif (before == 40 or before == 44) and (48 <= c <= 57 or c == 35 or c == 43 or c == 45):
                end, mark, exact, found = _scan_number(text, powers, at)
                if mark:
                    values[m] = found
                    if not exact:
                        slow[k, 0], slow[k, 1], slow[k, 2] = m, at, end
                        k += 1
                    m += 1
                    h = (h ^ np.uint64(mark)) * np.uint64(0x100000001B3)
                    at, before = end, mark
                    continue
            h = (h ^ np.uint64(c)) * np.uint64(0x100000001B3)
            before = c
            at += 1
        if at + 1 >= size or text[at + 1] != 10:
            return n, m, k, begin
        at += 2
        code[n], count[n] = np.int64(h), m - first_value
        place[n, 0], place[n, 1] = begin, at
        n += 1
    return n, m, k, at


@njit_cached
def _scan_number(text: Any, powers: Any, at: int) -> tuple[int, int, bool, float]:
    """End, mark (0: no number), whether the value is exact, and value of the number or reference that begins at `at`."""
    size, mark = len(text), 64  # '@'
    negative = text[at] == 45
    if text[at] == 35:
        mark = 35
    if text[at] < 48:
        at += 1
    digits, mantissa, scale = 0, np.int64(0), 0
    while at < size and (48 <= text[at] <= 57 or (text[at] == 46 and mark == 64)):
        if text[at] == 46:  # '.'
            if digits == 0:
                return at, 0, False, 0.0
            mark = 38  # '&'
        else:
            if digits < 18:
                mantissa = 10 * mantissa + (text[at] - 48)
            if mark == 38:
                scale -= 1
            digits += 1
        at += 1
    if digits == 0:
        return at, 0, False, 0.0
    if mark == 38 and at < size and text[at] == 69:  # 'E'
        at += 1
        minus = text[at] == 45
        if text[at] < 48:
            at += 1
        power = 0
        while at < size and 48 <= text[at] <= 57:
            power = 10 * power + text[at] - 48
            at += 1
        scale += -power if minus else power
    exact = bool(digits <= 18 and mantissa < 9007199254740992 and -22 <= scale <= 22)
    value = float(mantissa)
    if exact:
        value = value / powers[-scale] if scale < 0 else value * powers[scale]
    return at, mark, exact, -value if negative else value
